"""A viewer without a window that takes data, and what it has loaded."""

import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from matplotlib.image import imread
from numpy.typing import NDArray

from turtlelog.draw.rerun.viewer import (
    ViewerProcess,
    build_url,
    find_free_port,
    start_viewer,
    wait_for_viewer,
)

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

PATIENCE_S = 60.0


@dataclass(frozen=True)
class Headless:
    process: ViewerProcess
    client: "ViewerClient"
    url: str

    def kill(self) -> None:
        """End it as a crash would, by its own process id."""
        os.kill(self.process.process_id, getattr(signal, "SIGKILL", signal.SIGTERM))

    @contextmanager
    def hold(self) -> Iterator[None]:
        """Let it hang for a while."""
        os.kill(self.process.process_id, signal.SIGSTOP)
        try:
            yield
        finally:
            os.kill(self.process.process_id, signal.SIGCONT)

    def wait_for_end(self, end_ns: int) -> None:
        """Return when the run has arrived up to a time."""
        deadline = time.monotonic() + PATIENCE_S
        while not any(end >= end_ns for end in self.list_ends()):
            assert time.monotonic() < deadline, self.list_ends()
            time.sleep(0.05)

    def open(self, path: Path) -> None:
        self.client.open(str(path))

    def wait_for_time(self, time_ns: int) -> None:
        """Return when the cursor of the recording stands at a time."""
        deadline = time.monotonic() + PATIENCE_S
        while (found := self.list_times()) != [time_ns]:
            assert time.monotonic() < deadline, found
            self.client.take_screenshot(max_size=16)  # it moves when the viewer paints

    def picture_view(self, name: str, timeline: str) -> NDArray[np.float64]:
        """Return a view of what is loaded, the cursor at the end, shape (rows, columns, 3)."""
        deadline = time.monotonic() + PATIENCE_S
        while self.client.get_state().loading:
            assert time.monotonic() < deadline
            time.sleep(0.05)
        (line,) = [
            line
            for recording in self.client.get_state().recordings
            for line in recording.timelines
            if line.name == timeline
        ]
        end = line.end or 0
        if timeline == "tick":
            self.client.set_time(timeline, sequence=end, play_state="paused")
        else:
            self.client.set_time(timeline, duration=end / 1e9, play_state="paused")
        before, picture = b"", self._take_view(name, deadline)
        while picture != before:
            assert time.monotonic() < deadline
            time.sleep(0.1)
            before, picture = picture, self._take_view(name, deadline)
        return np.asarray(imread(BytesIO(picture)), dtype=np.float64)[..., :3]

    def _take_view(self, name: str, deadline: float) -> bytes:
        """Return a picture of a view; a layout that is exchanged gives its views other ids."""
        while True:
            (view,) = [view for view in self.client.get_state().views if view.name == name]
            try:
                return self.client.take_screenshot(view.view_id)
            except ConnectionError as err:
                if "not found" not in str(err) or time.monotonic() > deadline:
                    raise
                time.sleep(0.05)

    def list_times(self) -> list[int]:
        found = [recording.current_time for recording in self.client.get_state().recordings]
        return [at for at in found if at is not None]

    def list_ends(self) -> list[int]:
        recordings = self.client.get_state().recordings
        lines = [line for recording in recordings for line in recording.timelines]
        return [line.end for line in lines if line.name == "sim_time" and line.end is not None]

    def list_entities(self) -> set[str]:
        schema = self.client.get_recording_schema(paths_only=True)
        return {entity.entity_path for entity in schema.entities}


@contextmanager
def start_headless(size: str = "640x400") -> Iterator[Headless]:
    port = find_free_port()
    options = ["--headless", "--port", str(port), "--hide-welcome-screen"]
    with start_viewer([*options, "--window-size", size]) as process:
        try:
            client = wait_for_viewer(process, port)
        except ConnectionError as err:
            pytest.skip(f"no viewer can run here: {err}")
        yield Headless(process, client, build_url(port))
