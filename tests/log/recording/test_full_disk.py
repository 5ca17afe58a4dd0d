import errno
import io
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.log.live import read_messages
from tests.log.recording.ticks import POSE, make_scenario, record, record_ticks
from tests.log.runs import assert_same
from tests.log.strict import check_strictly
from turtlelog.errors import LogError
from turtlelog.log import read_recording
from turtlelog.log.recording.recorder import Recorder
from turtlelog.run import Run
from turtlelog.simulate import iterate_ticks, simulate_run


class FullDisk(io.FileIO):
    """A file on a disk that has room for so many bytes; some writes take only half."""

    def __init__(self, path: Path, room: int) -> None:
        super().__init__(path, "x+")
        self._room = room

    def write(self, data: Any, /) -> int:
        free = self._room - self.tell()
        if free <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return super().write(bytes(data)[: min(free, len(data) // 2 + 1)])


def fill(path: Path, room: int) -> tuple[str, Run]:
    """Record until the disk is full; return the error, and the run that was recorded."""
    scenario = make_scenario(law__kp_angular=0.0001)
    with pytest.raises(LogError, match=r"\A[^\n]+\Z") as caught:
        record(path, scenario, lambda path: FullDisk(path, room))
    return str(caught.value), simulate_run(scenario)


@pytest.mark.parametrize("room", [35_000, 50_000, 62_345, 100_000])
def test_a_full_disk_is_one_line_and_leaves_what_came_before(room: int, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    message, run = fill(path, room)
    times = [message.log_time for message in read_messages(path) if message.channel_id == POSE]
    assert times == run.poses.time_ns[: len(times)].tolist()
    assert len(times) > 200
    safe = f"No space left on device: {times[-1] / 1e9:.3f} s are safe"
    assert message == f"{path}: no room for the recording: {safe}"


def test_where_the_summary_fits_a_full_disk_leaves_a_whole_file(tmp_path: Path) -> None:
    # Half a chunk is taken away again, which makes room for the summary.
    finished = []
    for room in range(30_000, 60_000, 5_000):
        path = tmp_path / f"{room}.mcap"
        fill(path, room)
        if path.read_bytes().endswith(b"\x89MCAP0\r\n"):
            check_strictly(path)
            assert read_recording(path).notes == {"recording_failed": "No space left on device"}
            finished.append(room)
    assert finished


@pytest.mark.thorough
def test_a_full_disk_never_leaves_half_a_record(tmp_path: Path) -> None:
    for number, room in enumerate(np.random.default_rng(0).integers(12_000, 50_000, 12).tolist()):
        path = tmp_path / f"{number}.mcap"
        fill(path, room)
        data, place = path.read_bytes(), 8
        while place < len(data) and data[place:] != b"\x89MCAP0\r\n":
            place += 9 + int.from_bytes(data[place + 1 : place + 9], "little")
        assert place == len(data) or data[place:] == b"\x89MCAP0\r\n"


def test_no_room_for_the_head_leaves_no_file(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with pytest.raises(
        LogError, match="no room for the recording: No space left on device: its head alone is safe"
    ):
        Recorder(path, make_scenario(), create=lambda path: FullDisk(path, 100))
    assert not path.exists()


class FailsAtClose(io.FileIO):
    def close(self) -> None:
        if not self.closed:
            super().close()
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_failure_at_closing_is_one_line(tmp_path: Path) -> None:
    scenario = make_scenario(max_duration_s=0.5)
    recorder = Recorder(tmp_path / "a.mcap", scenario, create=lambda path: FailsAtClose(path, "x+"))
    for tick in iterate_ticks(scenario):
        recorder.receive(tick)
    with pytest.raises(LogError, match=r"a\.mcap: expected the system to keep .* No space left"):
        recorder.close()
    assert_same(read_recording(tmp_path / "a.mcap"), simulate_run(scenario))


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A real file system of one megabyte."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(folder)]
    try:
        subprocess.run(command, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError) as err:
        pytest.skip(f"no file system can be mounted here: {err}")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.thorough
def test_a_real_disk_that_is_full_is_one_line_and_leaves_what_came_before(small_disk: Path) -> None:
    path = small_disk / "a.mcap"
    scenario = make_scenario(law__kp_angular=0.0001, max_duration_s=1000.0)
    ticks = list(iterate_ticks(scenario))
    left = iter(ticks)
    with pytest.raises(LogError, match=r"No space left on device: .* s are safe") as caught:
        record_ticks(path, scenario, left)
    times = [message.log_time for message in read_messages(path) if message.channel_id == POSE]
    given = len(ticks) - len(list(left))
    assert f": {times[-1] / 1e9:.3f} s are safe" in str(caught.value)
    assert len(times) > 5_000
    assert given - len(times) < 300
