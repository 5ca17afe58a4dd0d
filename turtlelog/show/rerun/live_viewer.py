"""A running loop in a viewer, from a thread of its own: whatever the viewer does, the loop runs."""

import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from queue import Empty, SimpleQueue
from typing import Final

from turtlelog.errors import ShowError
from turtlelog.scenario import Scenario
from turtlelog.show.rerun.connection import (
    build_url,
    find_free_port,
    require_viewer,
    wait_for_viewer,
)
from turtlelog.show.rerun.live_scene import LiveScene, connect_scene
from turtlelog.show.rerun.viewer import ViewerProcess, start_viewer
from turtlelog.simulate import RunCollector, Tick

_BATCH_S: Final = 0.05
_SHARE: Final = 5
"""Between two batches passes at least so many times what the last one took of a processor."""

_LAST_S: Final = 8.0
"""So long the end of a run waits for a viewer that does not answer."""


class LiveViewer:
    """Shows the ticks of a running loop, in batches, in the viewer at an address.

    A sink of `run_live`. It only takes the ticks; a thread draws them. A viewer that is slow, hangs
    or goes away costs the loop nothing; `lost` says so afterwards.

    Attributes:
        lost: Why the viewer does not show all of the run, one clause; empty where it does.
    """

    def __init__(self, scenario: Scenario, url: str) -> None:
        """Begin to connect.

        Args:
            scenario: What runs.
            url: Where the viewer is, as `rerun+http://127.0.0.1:9876/proxy`.

        Raises:
            ShowError: Where nothing answers there.
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
        advice: What to do where no window can be opened, in one clause.

    Raises:
        ShowError: Where none can.
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
