import errno
import io
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, make_reader
from mcap.writer import MCAP0_MAGIC
from rosbags.highlevel import AnyReader

from tests.log.live import read_messages, read_rest, start_recording, wait_for_tick
from tests.log.runs import assert_same
from tests.log.strict import check_strictly
from turtlelog.errors import LogError
from turtlelog.log import read_recording, replace_when_complete, write_recording
from turtlelog.log.engine.columns import read_columns
from turtlelog.log.recording.recorder import Recorder, create_file
from turtlelog.run import Run
from turtlelog.scenario import Scenario, get_preset, override_scenario
from turtlelog.simulate import Tick, iterate_ticks, simulate_run

POSE = 2  # number of its channel


def make_scenario(preset: str = "paper", **values: Any) -> Scenario:
    changes = {key.replace("__", "."): value for key, value in values.items()}
    return override_scenario(get_preset(preset), changes)


def record(
    path: Path, scenario: Scenario, create: Callable[[Path], BinaryIO] = create_file
) -> None:
    record_ticks(path, scenario, iterate_ticks(scenario), create)


def record_ticks(
    path: Path,
    scenario: Scenario,
    ticks: Iterable[Tick],
    create: Callable[[Path], BinaryIO] = create_file,
) -> None:
    with Recorder(path, scenario, create=create) as recorder:
        for tick in ticks:
            recorder.receive(tick)


def assert_same_columns(found: Path, expected: Path) -> None:
    one, two = read_columns(found), read_columns(expected)
    assert one.keys() == two.keys()
    for topic, columns in two.items():
        for name in ("log_time_ns", "publish_time_ns", "sequence"):
            assert_same(getattr(one[topic], name), getattr(columns, name), f"{topic} {name}")
        for name, values in columns.fields.items():
            assert_same(one[topic].fields[name].tolist(), values.tolist(), f"{topic} {name}")


@pytest.mark.parametrize(
    "scenario",
    [
        *map(make_scenario, ["paper-kp1", "paper-kp10", "textbook"]),
        make_scenario("textbook", loop__pose_precision="float64", goal__heading_rad=1.0),
        make_scenario("paper-kp10", max_duration_s=3.0),
        make_scenario("paper", limits__speed_m_s=float("inf"), law__kp_linear=200.0),
    ],
    ids=["kp1", "kp10", "textbook", "float64", "cut off in the pause", "at the wall"],
)
def test_a_live_recording_equals_one_written_at_once(scenario: Scenario, tmp_path: Path) -> None:
    live, once = tmp_path / "live.mcap", tmp_path / "once.mcap"
    record(live, scenario)
    run = simulate_run(scenario)
    write_recording(run, once)
    check_strictly(live)
    assert_same(read_recording(live), run)
    assert_same_columns(live, once)


def test_rosbags_reads_a_live_recording(tmp_path: Path) -> None:
    scenario = make_scenario("paper-kp4")
    record(tmp_path / "a.mcap", scenario)
    run = simulate_run(scenario)
    with AnyReader([tmp_path / "a.mcap"]) as bag:
        found = [(connection.topic, time_ns) for connection, time_ns, _ in bag.messages()]
    for topic, columns in (("pose", run.poses), ("control", run.samples)):
        times = [time_ns for name, time_ns in found if name == f"/turtle1/{topic}"]
        assert times == columns.time_ns.tolist()


def test_chunks_hold_64_kib_where_the_clock_does_not_cut_them(tmp_path: Path) -> None:
    record(tmp_path / "a.mcap", make_scenario("paper-kp1"))
    sizes = [chunk.uncompressed_size for chunk in check_strictly(tmp_path / "a.mcap").chunk_indexes]
    assert len(sizes) > 3
    assert all(2**16 <= size < 2**16 + 4096 for size in sizes[:-1])


def test_every_chunk_can_be_read_alone(tmp_path: Path) -> None:
    record(tmp_path / "a.mcap", make_scenario("paper-kp1"))
    data, summary = (tmp_path / "a.mcap").read_bytes(), check_strictly(tmp_path / "a.mcap")
    header_end = 8 + 9 + int.from_bytes(data[9:17], "little")
    for chunk in summary.chunk_indexes[1:]:
        start = chunk.chunk_start_offset
        alone = data[:header_end] + data[start : start + chunk.chunk_length]
        footer = b"\x02" + (20).to_bytes(8, "little") + bytes(20)
        stream = io.BytesIO(alone + footer + MCAP0_MAGIC)
        messages = NonSeekingReader(stream, validate_crcs=True).iter_messages()
        topics = {channel.topic for _, channel, _ in messages}
        assert topics >= {"/turtle1/pose", "/turtle1/control", "/turtle1/cmd_vel"}


def test_every_tick_is_safe_at_once_where_asked(tmp_path: Path) -> None:
    scenario, path = make_scenario(), tmp_path / "a.mcap"
    recorder = Recorder(path, scenario, flush_s=0.0)
    for number, tick in zip(range(1, 21), iterate_ticks(scenario), strict=False):
        recorder.receive(tick)
        assert sum(message.channel_id == POSE for message in read_messages(path)) == number
    recorder.close()


def test_nothing_is_kept_longer_than_asked(tmp_path: Path) -> None:
    scenario, path = make_scenario(), tmp_path / "a.mcap"
    ticks = iterate_ticks(scenario)
    with Recorder(path, scenario, flush_s=0.05) as recorder:
        recorder.receive(next(ticks))
        assert read_messages(path) == []
        time.sleep(0.06)
        recorder.receive(next(ticks))
        assert [m.log_time for m in read_messages(path) if m.channel_id == POSE] == [0, 16_000_000]


def test_an_unfinished_file_says_from_the_start_what_it_is(tmp_path: Path) -> None:
    scenario, path = make_scenario("paper-kp4"), tmp_path / "a.mcap"
    with Recorder(path, scenario):
        data = path.read_bytes()
    assert data.index(b"scenario.toml") < len(data)
    assert b"format_version" in data
    assert b'name = "paper-kp4"' in data


def test_the_last_head_of_a_file_holds_the_stop_reason(tmp_path: Path) -> None:
    record(tmp_path / "a.mcap", make_scenario("paper-kp10"))
    with (tmp_path / "a.mcap").open("rb") as stream:
        heads = [head.metadata for head in make_reader(stream).iter_metadata()]
    assert [head.get("stop_reason") for head in heads] == [None, "standstill"]
    assert all(head["name"] == "paper-kp10" for head in heads)


def test_an_existing_file_is_refused_and_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"mine")
    with pytest.raises(LogError, match=r"^\S+a\.mcap: expected a new file, found one"):
        Recorder(path, make_scenario())
    assert path.read_bytes() == b"mine"


def test_a_second_recorder_on_the_same_file_is_refused(tmp_path: Path) -> None:
    path, scenario = tmp_path / "a.mcap", make_scenario(max_duration_s=0.5)
    with Recorder(path, scenario) as recorder:
        with pytest.raises(LogError, match="expected a new file, found one"):
            Recorder(path, scenario)
        for tick in iterate_ticks(scenario):
            recorder.receive(tick)
    assert_same(read_recording(path), simulate_run(scenario))


def test_a_place_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"^\S+a\.mcap: expected a place that can be written"):
        Recorder(tmp_path / "missing" / "a.mcap", make_scenario())


def test_a_closed_recorder_takes_nothing_more(tmp_path: Path) -> None:
    scenario = make_scenario()
    recorder = Recorder(tmp_path / "a.mcap", scenario)
    recorder.close()
    recorder.close()
    with pytest.raises(LogError, match="expected a recording in progress, found a closed one"):
        recorder.receive(next(iterate_ticks(scenario)))
    check_strictly(tmp_path / "a.mcap")


def record_half(path: Path, error: BaseException) -> None:
    scenario = make_scenario()
    with Recorder(path, scenario) as recorder:
        for _, tick in zip(range(100), iterate_ticks(scenario), strict=False):
            recorder.receive(tick)
        raise error


@pytest.mark.parametrize(
    ("error", "stop_reason"),
    [(KeyboardInterrupt(), "interrupted"), (SystemExit(1), "interrupted"), (ValueError(), None)],
)
def test_a_loop_that_is_left_by_an_error_leaves_a_whole_file(
    error: BaseException, stop_reason: str | None, tmp_path: Path
) -> None:
    with pytest.raises(type(error)):
        record_half(tmp_path / "a.mcap", error)
    check_strictly(tmp_path / "a.mcap")
    run = read_recording(tmp_path / "a.mcap")
    assert (len(run.poses), run.stop_reason) == (100, stop_reason)


def test_signals_act_as_before_once_the_recorder_is_closed(tmp_path: Path) -> None:
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    record(tmp_path / "a.mcap", make_scenario(max_duration_s=0.5))
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


# Full disks.


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
    safe = f"found: No space left on device: {times[-1] / 1e9:.3f} s are safe"
    assert message == f"{path}: expected room for the recording, {safe}"


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
    with pytest.raises(LogError, match="found: No space left on device: its head alone is safe"):
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


# Ends from outside.


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends processes in other ways")
@pytest.mark.parametrize("after_s", [0.4, 1.7, 2.6])
def test_a_kill_loses_at_most_the_last_second(after_s: float, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    process = start_recording(path)
    wait_for_tick(process, after_s)
    process.kill()
    last_ns = max(read_rest(process), int(after_s * 1e9))
    times = [message.log_time for message in read_messages(path) if message.channel_id == POSE]
    assert times == list(range(0, 16_000_000 * len(times), 16_000_000))
    assert last_ns - times[-1] < 1.1e9 if times else last_ns < 1.1e9
    assert b"scenario.toml" in path.read_bytes()


OWN_LOOP = """
import sys, time
from turtlelog.log.recording.recorder import Recorder
from turtlelog.scenario import get_preset
from turtlelog.simulate import iterate_ticks

scenario = get_preset("paper")
with Recorder(sys.argv[1], scenario) as recorder:
    for tick in iterate_ticks(scenario):
        recorder.receive(tick)
        print(tick.time_ns, flush=True)
        time.sleep(0.005)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends processes in other ways")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_to_a_loop_of_ones_own_finishes_the_file(
    number: signal.Signals, tmp_path: Path
) -> None:
    path = tmp_path / "a.mcap"
    process = start_recording(path, OWN_LOOP)
    wait_for_tick(process, 0.7)
    process.send_signal(number)
    last_ns = read_rest(process)
    check_strictly(path)
    run = read_recording(path)
    assert run.stop_reason == "interrupted"
    assert run.poses.time_ns[-1] >= last_ns
    assert process.returncode in {-signal.SIGINT, 128 + signal.SIGTERM}


def test_a_signal_amid_a_flush_waits_for_its_end(tmp_path: Path) -> None:
    scenario, path = make_scenario(), tmp_path / "a.mcap"

    class Interrupted(io.FileIO):
        """Ctrl-C comes in the middle of every write."""

        def write(self, data: Any, /) -> int:
            count = super().write(bytes(data)[: len(data) // 2 + 1])
            if self.tell() > 10_000:
                signal.raise_signal(signal.SIGINT)
            return count

    ticks = list(iterate_ticks(scenario))
    left = iter(ticks)
    with pytest.raises(KeyboardInterrupt):
        record_ticks(path, scenario, left, lambda path: Interrupted(path, "x+"))
    check_strictly(path)
    assert len(read_recording(path).poses) == len(ticks) - len(list(left))


def test_a_file_that_another_program_replaced_is_told(tmp_path: Path) -> None:
    path, scenario = tmp_path / "a.mcap", make_scenario(max_duration_s=0.5)
    recorder = Recorder(path, scenario)
    for tick in iterate_ticks(scenario):
        recorder.receive(tick)
    path.unlink()  # as somebody does who knows no lock
    write_recording(simulate_run(scenario), path)
    with pytest.raises(LogError, match="expected it to stay, found it replaced meanwhile"):
        recorder.close()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows replaces no file that is open")
def test_what_writes_at_once_leaves_a_recording_in_progress_alone(tmp_path: Path) -> None:
    path, scenario = tmp_path / "a.mcap", make_scenario(max_duration_s=0.5)
    whole = simulate_run(scenario)
    with Recorder(path, scenario) as recorder:
        for tick in iterate_ticks(scenario):
            recorder.receive(tick)
        for write in (write_recording, export_poses):
            with pytest.raises(
                LogError, match=r"a\.mcap: expected .*, found a live recording of it"
            ):
                write(whole, path)
    assert len(read_recording(path).poses) == len(whole.poses)
    assert [found.name for found in tmp_path.iterdir()] == ["a.mcap"]
    write_recording(whole, path)  # it has come to its end


def export_poses(_run: Run, path: Path) -> None:
    with replace_when_complete(path) as temporary:
        temporary.write_bytes(b"poses")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows replaces no file that is open")
def test_a_recording_that_begins_while_another_is_written_is_not_replaced(tmp_path: Path) -> None:
    path, scenario = tmp_path / "a.mcap", make_scenario(max_duration_s=0.5)

    def write_late(recorders: ExitStack) -> None:
        with replace_when_complete(path) as temporary:
            temporary.write_bytes(b"late")
            recorders.enter_context(Recorder(path, scenario))

    with ExitStack() as recorders, pytest.raises(LogError, match="found a live recording of it"):
        write_late(recorders)
    assert path.read_bytes().startswith(b"\x89MCAP")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows replaces no file that is open")
def test_a_killed_recorder_blocks_nobody(tmp_path: Path) -> None:
    path, whole = tmp_path / "a.mcap", simulate_run(make_scenario(max_duration_s=0.5))
    process = start_recording(path)
    wait_for_tick(process, 0.3)
    with pytest.raises(LogError, match="found a live recording of it"):
        write_recording(whole, path)
    process.kill()
    read_rest(process)
    write_recording(whole, path)
    assert len(read_recording(path).poses) == len(whole.poses)
