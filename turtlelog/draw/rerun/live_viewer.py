"""Growing runs in a viewer or a notebook: a running loop, or a recording that grows."""

import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path
from queue import Empty, SimpleQueue
from tempfile import TemporaryDirectory
from typing import Final

from rerun.notebook import Viewer

from turtlelog.draw.rerun.entities import APPLICATION_ID
from turtlelog.draw.rerun.rrd_file import abandon_stream, require_enabled
from turtlelog.draw.rerun.run_scene import GrowingStream, LiveScene, write_run_rrd
from turtlelog.draw.rerun.viewer import (
    ViewerProcess,
    build_url,
    find_free_port,
    require_recordings,
    require_viewer,
    start_viewer,
    wait_for_viewer,
)
from turtlelog.errors import ShowError
from turtlelog.libraries import load_library
from turtlelog.log import RecordingTail
from turtlelog.run import Run
from turtlelog.scenario import Scenario
from turtlelog.simulate import RunCollector, Tick

_BATCH_S: Final = 0.05
"""Shortest time between two batches for a separate viewer [s]: 20 pictures per second."""

_WIDGET_BATCH_S: Final = 0.2
"""Shortest time between two batches for a notebook [s]. A browser without a graphics card takes two
to four batches per second; each batch takes equally long, however short it is."""

_SHARE: Final = 5
"""Shortest time between two batches, as a multiple of the last batch's processor time."""

_LAST_S: Final = 8.0
"""Time that the end of a run waits for a viewer that does not answer [s]."""

_POLL_S: Final = 0.1
_QUIET_S: Final = 3.0
"""Time without growth after which a file without a writer counts as final [s]."""

_ADVICE: Final = (
    "`turtlelog view FILE --partial --snapshot X.png` makes a picture of what is there so far"
)


WIDGET_SIZE: Final = (960, 640)
"""Width and height that fit a cell of JupyterLab on a small screen [pixels]."""


class LiveViewer:
    """Sink that shows the ticks of a running loop, in batches, in a notebook or another viewer.

    The viewer is a sink for `run_live`. The sink only collects the ticks, and a thread draws them.
    A viewer that is slow, hangs or disappears does not delay the loop; afterwards, `lost` gives the
    reason.

    Attributes:
        lost: Reason why the viewer does not show the complete run, in one clause; empty if it does.
    """

    def __init__(
        self,
        scenario: Scenario,
        url: str | None = None,
        *,
        size: tuple[int, int] = WIDGET_SIZE,
    ) -> None:
        """Show an empty widget below the present cell, or start to connect to a viewer.

        Args:
            scenario: Scenario that runs.
            url: Address of the viewer, as `rerun+http://127.0.0.1:9876/proxy`. Default: a widget of
                the notebook (extra `notebook`).
            size: Width and height of the widget [pixels].

        Raises:
            ShowError: If no viewer answers at the address, or there is no notebook.
            LibraryError: If the extra `notebook` is not installed.
        """
        if url is None:
            scene, self._batch_s = _keep_scene(WidgetStream(size), size), _WIDGET_BATCH_S
        else:
            require_viewer(url)
            scene, self._batch_s = _connect_scene(url), _BATCH_S
        self.lost = ""
        self._collector = RunCollector(scenario)
        self._ticks: SimpleQueue[Tick | None] = SimpleQueue()
        self._thread = threading.Thread(
            target=self._show, args=(scene,), name="viewer", daemon=True
        )
        self._thread.start()

    def receive(self, tick: Tick) -> None:
        """Collect a tick."""
        if not self.lost:
            self._ticks.put(tick)

    def close(self, notes: Mapping[str, str]) -> None:  # noqa: ARG002
        """Wait until everything is shown. A viewer that hangs is abandoned."""
        self._ticks.put(None)
        self._thread.join(_LAST_S)
        if self._thread.is_alive():
            self.lost = self.lost or f"no answer for {_LAST_S:g} s"

    def _show(self, opened: AbstractContextManager[LiveScene]) -> None:
        try:
            with opened as scene:
                self._draw(scene)
        except Exception as err:
            self.lost = " ".join(str(err).split()) or type(err).__name__

    def _draw(self, scene: LiveScene) -> None:
        is_over, wait_s = False, self._batch_s
        while not is_over:
            is_over = self._take(time.monotonic() + wait_s)
            if not self._collector.has_samples:
                continue
            start_s = time.thread_time()
            run = self._collector.build_run()
            if is_over:
                scene.finish(run)
            else:
                scene.update(run)
            wait_s = max(self._batch_s, _SHARE * (time.thread_time() - start_s))

    def _take(self, until_s: float) -> bool:
        """Collect ticks until a time, and return whether all ticks have arrived."""
        ticks: list[Tick] = []
        while (left_s := until_s - time.monotonic()) > 0.0:
            try:
                tick = self._ticks.get(timeout=left_s)
            except Empty:
                break
            if tick is None:
                self._collector.take(ticks)
                return True
            ticks.append(tick)
        self._collector.take(ticks)
        return False


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


def follow_recording(path: str | Path, url: str | None = None) -> Run:
    """Show a growing recording until it is finished, and return the run.

    Each chunk is read once, as soon as it is complete in the file. If the recorder was killed, the
    existing part of the file is shown.

    Args:
        path: A recording by turtlelog. A finished recording is shown directly.
        url: Address of a running viewer, as `rerun+http://127.0.0.1:9876/proxy`. By default, a
            viewer is opened, and after the end of the recording the call waits until its window is
            closed.

    Raises:
        LogError: If the file is not a recording by turtlelog, or contains no pose at its end.
        ShowError: If there is no such file, no window can be opened, or the viewer at the address
            goes away.
    """
    require_recordings([path])
    with ExitStack() as closing:
        tail = closing.enter_context(RecordingTail(path))
        viewer = None
        if url is None:
            viewer, url = closing.enter_context(open_window(_ADVICE))
        else:
            require_viewer(url)
        try:
            with _connect_scene(url) as scene:
                run = _show_growth(tail, scene)
        except ConnectionError as err:
            if viewer is None or not viewer.has_ended:
                raise ShowError(f"viewer: expected it to stay, found: {err}") from err
            return tail.read_last_run()
        if viewer is not None:
            viewer.wait()
    return run


def _show_growth(tail: RecordingTail, scene: LiveScene) -> Run:
    """Draw new data until the recording ends."""
    grown_s = time.monotonic()
    while not tail.is_finished:
        run = tail.read_run()
        if run is not None:
            scene.update(run)
            grown_s = time.monotonic()
        elif time.monotonic() - grown_s > _QUIET_S and not tail.is_live:
            break
        time.sleep(0.0 if tail.is_finished else _POLL_S)
    run = tail.read_last_run()
    scene.finish(run)
    return run


@contextmanager
def _connect_scene(url: str) -> Iterator[LiveScene]:
    """Yield a scene in the viewer at an address, as `rerun+http://127.0.0.1:9876/proxy`.

    Raises:
        ShowError: If the address is invalid, or Rerun is disabled.
    """
    stream = GrowingStream(APPLICATION_ID)
    require_enabled(stream, "viewer")
    stream.set_log_time_enabled(False)
    try:
        stream.connect_grpc(url)
    except Exception as err:
        raise ShowError(f"{url}: expected the address of a viewer: {err}") from err
    with _keep_scene(stream) as scene:
        yield scene


@contextmanager
def _keep_scene(stream: GrowingStream, size: tuple[int, int] | None = None) -> Iterator[LiveScene]:
    """Yield the scene of a stream. The stream ends with the block."""
    try:
        yield LiveScene(stream, size)
    finally:
        abandon_stream(stream)


_READY_S: Final = 30.0
"""Time for the page to load the viewer, compressed 17 MB, at 5 Mbit/s [s]. The data for a page that
takes longer are kept and shown later."""


def build_run_widget(run: Run, size: tuple[int, int]) -> Viewer:
    """Return a notebook widget of this width and height [pixels] with the recording of a run.

    The page gets the recording in one message. Rerun itself would send one message per part; a
    browser without a graphics card often shows nothing after hundreds of messages.

    Raises:
        ShowError: If the environment disables Rerun.
    """
    with TemporaryDirectory(prefix="turtlelog-") as folder:
        file = Path(folder, "run.rrd")
        try:
            write_run_rrd(run, file, size=size)
        except ShowError as err:
            raise ShowError(str(err).replace(str(file), run.name)) from err
        data = file.read_bytes()
    viewer = _build_viewer(size)
    viewer._viewer.send_rrd(data)
    return viewer


class WidgetStream(GrowingStream):
    """Stream of a growing run into a widget below the present cell, one message per round."""

    def __init__(self, size: tuple[int, int]) -> None:
        """Show a widget of this width and height [pixels], and wait until its page is ready.

        Raises:
            ShowError: If this is no notebook, or the environment disables Rerun.
            LibraryError: If the extra `notebook` is not installed.
        """
        super().__init__(APPLICATION_ID)
        require_enabled(self, "widget")
        self.set_log_time_enabled(False)
        load_library("rerun_notebook")
        _require_notebook()
        self._memory, self._viewer = self.memory_recording(), _build_viewer(size)
        _show_page(self._viewer)

    def flush(self, *, timeout_sec: float = 0.0) -> None:  # noqa: ARG002
        """Send what was drawn since the last time. The page never delays this."""
        self._viewer._viewer.send_rrd(self._memory.drain_as_bytes())


def _build_viewer(size: tuple[int, int]) -> Viewer:
    width, height = size
    return Viewer(width=width, height=height, use_global_recording=False)


def _show_page(viewer: Viewer) -> None:
    """Show a widget and wait until its page sends a message that it can receive data.

    From version 7.4 on, ipykernel passes the message to the thread that used the widget last, but
    this thread is waiting here. Without a last user, the message stays in the thread in which
    JupyterLab handles messages of widgets.
    """
    vars(viewer._viewer.comm).pop("_reply_subshell_id", None)
    viewer.display()
    viewer._viewer.block_until_ready(_READY_S)


def _require_notebook() -> None:
    from IPython import get_ipython  # with the extra only

    if not hasattr(get_ipython(), "kernel"):
        raise ShowError(
            "LiveViewer: there is no notebook here that could show a widget; give the address of a"
            " viewer, for example rerun+http://127.0.0.1:9876/proxy"
        )
