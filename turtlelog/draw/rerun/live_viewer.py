"""Runs in a viewer while they grow: a running loop, and a recording that somebody else writes."""

import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Final

from turtlelog.draw.rerun.live_scene import LiveScene, connect_scene
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
from turtlelog.log import RecordingTail
from turtlelog.run import Run
from turtlelog.scenario import Scenario
from turtlelog.simulate import RunCollector, Tick

_BATCH_S: Final = 0.05
_SHARE: Final = 5
"""Between two batches passes at least so many times what the last one took of a processor."""

_LAST_S: Final = 8.0
"""So long the end of a run waits for a viewer that does not answer."""

_POLL_S: Final = 0.1
_QUIET_S: Final = 3.0
"""A file that nobody writes, and that has not grown for so long, will not grow any more."""

_ADVICE: Final = (
    "`turtlelog view FILE --partial --snapshot X.png` makes a picture of what is there so far"
)


class LiveViewer:
    """Shows the ticks of a running loop, in batches, in the viewer at an address.

    A sink of `run_live`. It only takes the ticks; a thread draws them. A viewer that is slow, hangs
    or goes away costs the loop nothing; `lost` says so afterwards.

    Attributes:
        lost: Why the viewer does not show all of the run, one clause; empty if it does.
    """

    def __init__(self, scenario: Scenario, url: str) -> None:
        """Begin to connect.

        Args:
            scenario: What runs.
            url: Address of the viewer, as `rerun+http://127.0.0.1:9876/proxy`.

        Raises:
            ShowError: If nothing answers there.
        """
        require_viewer(url)
        self.lost = ""
        self._collector = RunCollector(scenario)
        self._ticks: SimpleQueue[Tick | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._show, args=(url,), name="viewer", daemon=True)
        self._thread.start()

    def receive(self, tick: Tick) -> None:
        """Take a tick."""
        if not self.lost:
            self._ticks.put(tick)

    def close(self, notes: Mapping[str, str]) -> None:  # noqa: ARG002
        """Wait until all is shown, but not for a viewer that hangs."""
        self._ticks.put(None)
        self._thread.join(_LAST_S)
        if self._thread.is_alive():
            self.lost = self.lost or f"no answer for {_LAST_S:g} s"

    def _show(self, url: str) -> None:
        try:
            with connect_scene(url) as scene:
                self._draw(scene)
        except Exception as err:
            self.lost = " ".join(str(err).split()) or type(err).__name__

    def _draw(self, scene: LiveScene) -> None:
        is_over, wait_s = False, _BATCH_S
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
            wait_s = max(_BATCH_S, _SHARE * (time.thread_time() - start_s))

    def _take(self, until_s: float) -> bool:
        """Collect ticks until a time, and return whether they have come to an end."""
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
    """Open a viewer without a recording, and yield it with its address; it ends with the block.

    Args:
        advice: Advice if no window can be opened, in one clause.

    Raises:
        ShowError: If none can.
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
    """Show a recording that grows until it is finished, and return its run.

    Each chunk is read once, as soon as it stands in the file. A file that ends without its end,
    since its recorder was killed, is shown up to there.

    Args:
        path: A recording by turtlelog; one that is finished is shown as it is.
        url: A viewer that runs, as `rerun+http://127.0.0.1:9876/proxy`; otherwise one is opened,
            and when the recording has ended, the call waits until its window is closed.

    Raises:
        LogError: If the file is no recording by turtlelog, or holds no pose when it ends.
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
            with connect_scene(url) as scene:
                run = _show_growth(tail, scene)
        except ConnectionError as err:
            if viewer is None or not viewer.has_ended:
                raise ShowError(f"viewer: expected it to stay, found: {err}") from err
            return tail.read_last_run()
        if viewer is not None:
            viewer.wait()
    return run


def _show_growth(tail: RecordingTail, scene: LiveScene) -> Run:
    """Draw what comes until there is nothing more to come."""
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
