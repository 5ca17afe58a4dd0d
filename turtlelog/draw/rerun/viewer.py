"""Rerun's native viewer, as a child process that ends with its block, and where it answers."""

import os
import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import IO, TYPE_CHECKING, Final
from urllib.parse import urlsplit

from turtlelog.errors import ShowError

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

_PATIENCE_S: Final = 5.0

LOCAL: Final = "127.0.0.1"
"""The address of this machine that no other one can reach."""

_START_S: Final = 30.0
_ANSWER_S: Final = 5.0
_SCHEMES: Final = frozenset({"rerun", "rerun+http", "rerun+https"})
_RETRY_S: Final = 0.1

_NO_TELEMETRY: Final = {"CI": "1"}
"""Rerun sends no telemetry where this is set; it has no option for a single viewer."""

_PROOF_PIXELS: Final = 16
"""Longest side of the picture that shows that a viewer draws: the smallest costs the least."""


class ViewerProcess:
    """A viewer that was started, and what it has said on stderr."""

    def __init__(self, process: "subprocess.Popen[bytes]", messages: IO[bytes]) -> None:
        self._process, self._messages = process, messages

    @property
    def process_id(self) -> int:
        """The number by which the system knows it."""
        return self._process.pid

    @property
    def has_ended(self) -> bool:
        """Whether the process is gone."""
        return self._process.poll() is not None

    def wait(self) -> int:
        """Wait for its end and return its exit code."""
        return self._process.wait()

    def read_error(self) -> str:
        """Return what it said about a failure, in one line without places in its source."""
        self._messages.seek(0)
        lines = self._messages.read().decode(errors="replace").splitlines()
        errors = [line for line in lines if re.search(r"^Error:|panicked at", line)]
        if not errors:
            return f"exit code {self._process.poll()}"
        return re.sub(
            r"^(Error: |thread '.*' panicked at )|(os error )?at \S+\.rs:\d+: ", "", errors[0]
        )

    def end(self) -> None:
        """End the process if it has not ended."""
        if self.has_ended:
            return
        self._process.terminate()
        try:
            self._process.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def find_viewer() -> Path:
    """Return the viewer's binary; the `rerun` script would put a process of its own in between.

    Raises:
        ShowError: If there is none.
    """
    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    package = find_spec("rerun_cli")
    binary = Path(package.origin).with_name(name) if package and package.origin else Path(name)
    if not binary.is_file():
        raise ShowError(f"{binary}: the viewer that comes with rerun-sdk is not there")
    return binary


def open_viewer(paths: Sequence[str | Path]) -> None:
    """Open recordings in a window and wait until it is closed.

    Raises:
        ShowError: If a file is missing, or no window can be opened.
    """
    require_recordings(paths)
    with start_viewer(["--port", "auto", *(str(path) for path in paths)]) as viewer:
        if viewer.wait():
            raise ShowError(
                f"viewer: the window failed ({viewer.read_error().rstrip('.')});"
                " without a display `turtlelog view FILE --snapshot X.png` makes a picture,"
                " `--save X.rrd` a file to open elsewhere"
            )


@contextmanager
def start_viewer(options: Sequence[str]) -> Iterator[ViewerProcess]:
    """Start a viewer that listens on this machine only, and end it on the way out."""
    # The viewer leaves a folder behind in the temporary one: give it its own.
    with TemporaryFile() as messages, TemporaryDirectory(prefix="turtlelog-") as folder:
        process = subprocess.Popen(
            [*_find_guard(), find_viewer(), "--bind", LOCAL, *options],
            env={**os.environ, **_NO_TELEMETRY, "TMPDIR": folder, "TEMP": folder, "TMP": folder},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=messages,
        )
        viewer = ViewerProcess(process, messages)
        try:
            yield viewer
        finally:
            viewer.end()


def require_recordings(paths: Sequence[str | Path]) -> None:
    """Raise ShowError where there is no path, or no file at one."""
    if not paths:
        raise ShowError("viewer: no recording to open")
    for path in paths:
        if not Path(path).is_file():
            raise ShowError(f"{path}: expected a recording, found no such file")


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
        ShowError: If it is no address of a viewer, or nothing answers there.
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
        ConnectionError: If it ended, or never drew anything.
    """
    from rerun.experimental import ViewerClient

    deadline = time.monotonic() + _START_S
    while True:
        try:
            client = ViewerClient.connect(build_url(port))
            client.take_screenshot(max_size=_PROOF_PIXELS)
        except Exception as err:
            if not viewer.has_ended and time.monotonic() < deadline:
                time.sleep(_RETRY_S)
                continue
            found = viewer.read_error() if viewer.has_ended else f"no picture in {_START_S:g} s"
            raise ConnectionError(found) from err
        return client


def _find_guard() -> list[str]:
    """Return what ends a viewer whose parent was killed; only Linux knows how to."""
    guard = shutil.which("setpriv") if sys.platform == "linux" else None
    return [] if guard is None else [guard, "--pdeathsig", "TERM"]
