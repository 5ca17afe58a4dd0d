"""A viewer without a window that takes data, and what it has loaded."""

import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from turtlelog.show.rerun.connection import build_url, find_free_port, wait_for_viewer
from turtlelog.show.rerun.viewer import ViewerProcess, start_viewer

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

PATIENCE_S = 20.0


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
def start_headless() -> Iterator[Headless]:
    port = find_free_port()
    options = ["--headless", "--port", str(port), "--hide-welcome-screen"]
    with start_viewer([*options, "--window-size", "640x400"]) as process:
        try:
            client = wait_for_viewer(process, port)
        except ConnectionError as err:
            pytest.skip(f"no viewer can run here: {err}")
        yield Headless(process, client, build_url(port))
