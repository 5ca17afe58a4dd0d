"""Finding a viewer: a port of its own, and the moment when it answers."""

import socket
import time
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

from turtlelog.errors import ShowError
from turtlelog.show.rerun.viewer import ViewerProcess

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

LOCAL: Final = "127.0.0.1"
"""The address of this machine that no other one can reach."""

_START_S: Final = 30.0
_ANSWER_S: Final = 5.0
_SCHEMES: Final = frozenset({"rerun", "rerun+http", "rerun+https"})
_PAUSE_S: Final = 0.1
_PROOF_PIXELS: Final = 16
"""Longest side of the picture that shows that a viewer draws: the smallest costs the least."""


def find_free_port() -> int:
    """Return a port of this machine that is free now."""
    with socket.socket() as probe:
        probe.bind((LOCAL, 0))
        return int(probe.getsockname()[1])


def build_url(port: int) -> str:
    """Return where a viewer takes data."""
    return f"rerun+http://{LOCAL}:{port}/proxy"


def require_viewer(url: str) -> None:
    """Refuse an address where nothing takes data.

    Raises:
        ShowError: Where it is no address of a viewer, or nothing answers there.
    """
    try:
        parts = urlsplit(url)
        is_address = bool(parts.hostname and parts.port) and parts.scheme in _SCHEMES
    except ValueError:
        is_address = False
    if not is_address:
        raise ShowError(f"{url}: expected a viewer's address, as {build_url(9876)}")
    try:
        socket.create_connection((parts.hostname or "", parts.port or 0), _ANSWER_S).close()
    except OSError as err:
        raise ShowError(
            f"{url}: expected a viewer that runs, found: {err.strerror or err}"
        ) from err


def wait_for_viewer(viewer: ViewerProcess, port: int) -> "ViewerClient":
    """Return a client as soon as the viewer has drawn something.

    An answer alone proves nothing: without a graphics driver the viewer listens first, and dies
    when it begins to draw.

    Raises:
        ConnectionError: Where it ended, or never drew anything.
    """
    from rerun.experimental import ViewerClient

    deadline = time.monotonic() + _START_S
    while True:
        try:
            client = ViewerClient.connect(build_url(port))
            client.take_screenshot(max_size=_PROOF_PIXELS)
        except Exception as err:
            if not viewer.has_ended and time.monotonic() < deadline:
                time.sleep(_PAUSE_S)
                continue
            found = viewer.read_error() if viewer.has_ended else f"no picture in {_START_S:g} s"
            raise ConnectionError(found) from err
        return client
