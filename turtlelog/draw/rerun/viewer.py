"""Rerun's native viewer as a child process: its windows, and pictures of it without a display."""

import os
import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import IO, TYPE_CHECKING, Final
from urllib.parse import urlsplit

from turtlelog.charts.time_plots import TIMELINE, WALL_TIMELINE
from turtlelog.draw.rerun.entities import TICKS
from turtlelog.errors import ShowError
from turtlelog.log import replace_when_complete

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

_PATIENCE_S: Final = 5.0

LOCAL: Final = "127.0.0.1"  # loopback address, which other machines cannot reach

_START_S: Final = 30.0
_ANSWER_S: Final = 5.0
_SCHEMES: Final = frozenset({"rerun", "rerun+http", "rerun+https"})
_RETRY_S: Final = 0.1

_NO_TELEMETRY: Final = {"CI": "1"}
"""Environment that disables Rerun's telemetry, which has no option for a single viewer."""

_PROOF_PIXELS: Final = 16
"""Longest side of the picture that proves that a viewer draws [pixels], the cheapest."""


class ViewerProcess:
    """A started viewer, with its messages on stderr."""

    def __init__(self, process: "subprocess.Popen[bytes]", messages: IO[bytes]) -> None:
        self._process, self._messages = process, messages

    @property
    def process_id(self) -> int:
        """The process id."""
        return self._process.pid

    @property
    def has_ended(self) -> bool:
        """Whether the process has ended."""
        return self._process.poll() is not None

    def wait(self) -> int:
        """Wait for the end of the process and return its exit code."""
        return self._process.wait()

    def read_error(self) -> str:
        """Return the viewer's error message in one line, without places in its source."""
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
    """Return the viewer's binary, as the `rerun` script adds a process; ShowError without one."""
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
def open_window(advice: str) -> Iterator[tuple[ViewerProcess, str]]:
    """Open a viewer without a recording until the block ends, and yield it with its address.

    Args:
        advice: Advice if no window can be opened, in one clause.

    Raises:
        ShowError: If no window can be opened.
    """
    port = find_free_port()
    options = ["--port", str(port), "--hide-welcome-screen", "--expect-data-soon"]
    with start_viewer(options) as viewer:
        try:
            wait_for_viewer(viewer, port)
        except ConnectionError as err:
            raise ShowError(
                f"viewer: expected a window, found: {err}; without a display {advice}"
            ) from err
        yield viewer, build_url(port)


@contextmanager
def start_viewer(options: Sequence[str]) -> Iterator[ViewerProcess]:
    """Start a viewer that listens only on this machine, and end it after the block."""
    # Only Linux has a command that ends a viewer whose parent was killed.
    setpriv = shutil.which("setpriv") if sys.platform == "linux" else None
    guard = [] if setpriv is None else [setpriv, "--pdeathsig", "TERM"]
    # The viewer leaves a folder in the temporary folder, so it gets a folder of its own.
    with TemporaryFile() as messages, TemporaryDirectory(prefix="turtlelog-") as folder:
        process = subprocess.Popen(
            [*guard, find_viewer(), "--bind", LOCAL, *options],
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
    """Raise ShowError if there is no path, or no file at a path."""
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
    """Return the address at which a viewer receives data."""
    return f"rerun+http://{LOCAL}:{port}/proxy"


def require_viewer(url: str) -> None:
    """Raise ShowError if the text is not a viewer's address, or nothing answers there."""
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
    """Return a client as soon as the viewer has drawn something; ConnectionError if it never does.

    An answer alone is not sufficient: without a graphics driver, the viewer listens first and ends
    when it begins to draw.
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


_LOAD_S: Final = 60.0
_PICTURES: Final = 20
_PAUSE_S: Final = 0.1
_NOTICE_S: Final = 3.5
_TINY: Final = 16  # longest side of a picture that nobody sees [pixels]
_LAST_BREATH_S: Final = 2.0
_ZOOM_STEP: Final = 0.1
_ROUNDING_S: Final = 1e-3  # rounding of times, which are printed in milliseconds
_OTHER_TIMELINES: Final = frozenset({TICKS, WALL_TIMELINE, "log_time", "log_tick"})
"""Timelines that do not count seconds from an event of the run."""

_PACKAGES: Final = "mesa-vulkan-drivers libvulkan1"


@dataclass(frozen=True, slots=True, kw_only=True)
class ShownView:
    """One view of the layout."""

    name: str  # title of the view
    kind: str  # rerun's class of view, such as `TimeSeries`
    is_visible: bool  # whether the layout shows it
    problems: tuple[str, ...]  # warnings and errors of the view


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewReport:
    """Report of the viewer on a recording."""

    views: tuple[ShownView, ...]  # views of the layout
    entities: tuple[str, ...]  # loaded entity paths, including properties
    messages: tuple[str, ...]  # warnings and errors that the viewer logged


class Camera:
    """A headless viewer that takes pictures one after another; `open_camera` starts it."""

    def __init__(
        self, viewer: ViewerProcess, client: "ViewerClient", size: tuple[int, int]
    ) -> None:
        self._viewer, self._client, self._size = viewer, client, size
        self._is_ready = False
        self._last_log = 0

    def take(
        self,
        rrd_path: str | Path,
        png_path: str | Path,
        *,
        at_s: float | None = None,
        timeline: str = TIMELINE,
    ) -> ViewReport:
        """Write a picture of a recording, as `write_snapshot` does."""
        require_recordings([rrd_path])
        client = self._client
        try:
            _open(client, Path(rrd_path), self._last_log)
            if self._is_ready:  # leave the previous layout
                client.run_command("recording.reset_blueprint_to_default")
                client.take_screenshot(max_size=_TINY)
            else:  # let the viewer draw until its welcome messages have disappeared
                deadline = time.monotonic() + _NOTICE_S
                while time.monotonic() < deadline:
                    client.take_screenshot(max_size=_TINY)
                self._is_ready = True
            client.run_command("ui.toggle_top_panel")
            _set_time(client, at_s, timeline)
            picture = _take_picture(client)
            report = _read_report(client, self._last_log)
            client.close("all")
            self._last_log = max((entry.sequence for entry in client.get_logs()), default=0)
        except (RuntimeError, OSError) as err:
            if _has_ended(self._viewer):
                raise _describe_lack(self._viewer.read_error()) from err
            width, height = self._size
            raise ShowError(
                f"viewer: expected a picture of {width}x{height} pixels, found: {err}"
            ) from err
        with replace_when_complete(png_path, raising=ShowError) as part_path:
            part_path.write_bytes(picture)
        return report


@contextmanager
def open_camera(*, size: tuple[int, int] = (1600, 900), zoom: float = 1.0) -> Iterator[Camera]:
    """Start a headless viewer for any number of pictures, and end it after the block.

    The arguments are as in `write_snapshot`. ShowError if the viewer cannot start.
    """
    port = find_free_port()
    width, height = size
    options = ["--headless", "--port", str(port), "--hide-welcome-screen"]
    with start_viewer([*options, "--window-size", f"{width}x{height}"]) as viewer:
        try:
            client = wait_for_viewer(viewer, port)
        except ConnectionError as err:
            raise _describe_lack(str(err)) from err
        for _ in range(round((zoom - 1.0) / _ZOOM_STEP)):
            client.run_command("ui.zoom_in_ui")
        yield Camera(viewer, client, size)


def write_snapshot(
    rrd_path: str | Path,
    png_path: str | Path,
    *,
    at_s: float | None = None,
    timeline: str = TIMELINE,
    size: tuple[int, int] = (1600, 900),
    zoom: float = 1.0,
) -> ViewReport:
    """Write a picture of a recording as the viewer shows it, and return the viewer's report.

    Args:
        rrd_path: The recording.
        png_path: The picture. An existing file is replaced when the new one is complete.
        at_s: Position of the time cursor [s]. Default: the end.
        timeline: Timeline of the cursor: `sim_time`, or for several runs also that of a phase, such
            as `translate_time`.
        size: Width and height of the window [pixels].
        zoom: Scale of letters and lines, in steps of 0.1; at least 1.

    Raises:
        ShowError: If the viewer cannot start, or the recording cannot be shown.
    """
    require_recordings([rrd_path])
    with open_camera(size=size, zoom=zoom) as camera:
        return camera.take(rrd_path, png_path, at_s=at_s, timeline=timeline)


def _has_ended(viewer: ViewerProcess) -> bool:
    """Return whether the viewer has ended or is ending. Without graphics, it answers briefly."""
    deadline = time.monotonic() + _LAST_BREATH_S
    while not viewer.has_ended and time.monotonic() < deadline:
        time.sleep(_PAUSE_S)
    return viewer.has_ended


def _describe_lack(found: str) -> ShowError:
    return ShowError(
        f"viewer: expected a graphics adapter or a software one (on Debian: apt-get install"
        f" {_PACKAGES}), found: {found}"
    )


def _open(client: "ViewerClient", path: Path, last_log: int) -> None:
    client.open(str(path.resolve()))
    deadline = time.monotonic() + _LOAD_S
    while (state := client.get_state()).loading or not state.views:
        found = client.get_logs(after_sequence=last_log)
        errors = [entry.message for entry in found if entry.level == "ERROR"]
        if errors:
            raise ShowError(f"{path}: expected a recording, found: {errors[0].splitlines()[0]}")
        if time.monotonic() > deadline:
            raise ShowError(f"{path}: expected a recording that loads in {_LOAD_S:g} s")
        time.sleep(_PAUSE_S)


def _set_time(client: "ViewerClient", at_s: float | None, name: str) -> None:
    """Set the cursor to a time, or to the end. A recording without times has no cursor."""
    starts_ns: dict[str, int] = {}
    ends_ns: dict[str, int] = {}
    for recording in client.get_state().recordings:
        for timeline in recording.timelines:
            if timeline.end is not None and timeline.name not in _OTHER_TIMELINES:
                start_ns = timeline.end if timeline.start is None else timeline.start
                starts_ns[timeline.name] = min(start_ns, starts_ns.get(timeline.name, start_ns))
                ends_ns[timeline.name] = max(timeline.end, ends_ns.get(timeline.name, 0))
    if name == TIMELINE and name not in ends_ns and len(ends_ns) == 1:
        (name,) = ends_ns  # the own timeline of an identified robot
    if name in ends_ns:
        cursor_s = ends_ns[name] / 1e9 if at_s is None else at_s
        _require_inside(cursor_s, name, starts_ns[name] / 1e9, ends_ns[name] / 1e9)
        client.set_time(name, duration=cursor_s, play_state="paused")
    elif at_s is not None or name != TIMELINE:
        known = " or ".join(sorted(ends_ns)) or "one, of which there is none"
        raise ShowError(f"timeline: expected {known}, found {name}")


def _require_inside(cursor_s: float, name: str, start_s: float, end_s: float) -> None:
    """Raise an error if the recording has no data at a time, because the picture would be empty."""
    if not start_s - _ROUNDING_S <= cursor_s <= end_s + _ROUNDING_S:
        raise ShowError(
            f"at: expected {start_s:.3f} to {end_s:.3f} s, where {name} begins and ends,"
            f" found {cursor_s:g}"
        )


def _take_picture(client: "ViewerClient") -> bytes:
    """Return the first picture that equals the previous one: views settle over some frames."""
    before, picture = None, _shoot(client)
    for _ in range(_PICTURES):
        if picture == before:
            break
        time.sleep(_PAUSE_S)
        before, picture = picture, _shoot(client)
    return picture


def _shoot(client: "ViewerClient") -> bytes:
    """Return a picture. Retry after Rerun's timeout of 15 s, which is too short for many runs."""
    deadline = time.monotonic() + _LOAD_S
    while True:
        try:
            return client.take_screenshot()
        except (RuntimeError, OSError) as err:
            if "Deadline expired" not in str(err) or time.monotonic() > deadline:
                raise


def _read_report(client: "ViewerClient", last_log: int) -> ViewReport:
    return ViewReport(
        views=tuple(
            ShownView(
                name=view.name,
                kind=view.view_class,
                is_visible=view.visible,
                problems=tuple(
                    ": ".join(filter(None, (report.severity, report.summary, report.details)))
                    for report in view.reports
                ),
            )
            for view in client.get_state().views
        ),
        entities=tuple(
            entity.entity_path for entity in client.get_recording_schema(paths_only=True).entities
        ),
        messages=tuple(
            f"{entry.level}: {entry.message}"
            for entry in client.get_logs(after_sequence=last_log)
            if entry.level in {"WARN", "ERROR"}
        ),
    )
