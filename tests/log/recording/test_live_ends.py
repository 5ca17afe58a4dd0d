import io
import signal
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from tests.log.live import read_messages, read_rest, start_recording, wait_for_tick
from tests.log.recording.ticks import POSE, make_scenario, record, record_ticks
from tests.log.strict import check_strictly
from turtlelog.errors import LogError
from turtlelog.log import read_recording, replace_when_complete, write_recording
from turtlelog.log.recording.recorder import Recorder
from turtlelog.run import Run
from turtlelog.simulate import iterate_ticks, simulate_run


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


@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends processes in other ways")
@pytest.mark.realtime
@pytest.mark.parametrize("after_s", [0.4, 1.7])
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
