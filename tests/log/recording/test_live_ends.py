import io
import os
import re
import signal
import struct
import subprocess
import sys
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from tests.log.live import PROGRAM, ROOT, read_messages, read_rest, start_recording, wait_for_tick
from tests.log.recording.ticks import POSE, make_scenario, record, record_ticks
from tests.log.strict import check_strictly
from turtlelog.errors import LogError
from turtlelog.log import read_recording, replace_when_complete, write_recording
from turtlelog.log.file_access import MCAP0_MAGIC
from turtlelog.log.recording.recorder import Recorder
from turtlelog.run import Run
from turtlelog.simulate import iterate_ticks, simulate_run

STOPS = [
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
    if hasattr(signal, name)
]


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
    before = [signal.getsignal(number) for number in STOPS]
    record(tmp_path / "a.mcap", make_scenario(max_duration_s=0.5))
    assert [signal.getsignal(number) for number in STOPS] == before


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


@pytest.mark.everyday("15", "2")
@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends processes in other ways")
@pytest.mark.parametrize("number", STOPS)
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
    assert process.returncode == (-number if number == signal.SIGINT else 128 + number)


@pytest.mark.thorough
@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="Windows has no terminal that hangs up")
def test_a_loop_that_ignores_the_end_of_its_terminal_goes_on(tmp_path: Path) -> None:
    ignoring = "import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
    for program in (OWN_LOOP, PROGRAM):
        path = tmp_path / f"{len(program)}.mcap"
        process = start_recording(path, ignoring + program)
        wait_for_tick(process, 0.3)
        process.send_signal(signal.SIGHUP)
        wait_for_tick(process, 1.0)
        process.terminate()
        read_rest(process)
        assert read_recording(path).end_ns >= 1e9


RANDOM_MOMENTS = """
import os, random, signal, sys, time
from contextlib import ExitStack
from pathlib import Path
from turtlelog.log.recording.recorder import Recorder
from turtlelog.simulate.collect import run_live
from turtlelog.stop_signals import hold_stop
from turtlelog.scenario import get_preset, override_scenario

SCENARIO = override_scenario(get_preset("paper"), {"law.kp_angular": 0.0001})

def record(path):
    with ExitStack() as closing:
        os.write(begun[1], b"x")
        with hold_stop():
            recorder = Recorder(path, SCENARIO, flush_s=0.0)
            closing.callback(recorder.close)
        run_live(SCENARIO, [recorder], realtime=False)

draw = random.Random(0)
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
    for count in (1, 2):
        for moment in range(10):
            begun = os.pipe()
            child = os.fork()
            if not child:
                signal.signal(number, signal.default_int_handler)
                try:
                    try:
                        record(Path(sys.argv[1]) / f"{number}-{count}-{moment}.mcap")
                    except KeyboardInterrupt:
                        os._exit(0)
                    os._exit(0)
                except KeyboardInterrupt:  # the second signal, on the way out
                    os._exit(0)
            os.read(begun[0], 1)
            for _ in range(count):
                time.sleep(draw.uniform(0.0, 0.05))
                os.kill(child, number)
            assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
"""


@pytest.mark.thorough
@pytest.mark.skipif(not hasattr(os, "fork"), reason="Windows ends processes in other ways")
def test_a_signal_at_any_moment_tears_no_write(tmp_path: Path) -> None:
    """Sixty recorders are ended at random moments.

    The second of two signals may come while Python is on its way from the first to `close`: then
    the file lacks its end.
    """
    subprocess.run([sys.executable, "-c", RANDOM_MOMENTS, tmp_path], check=True, cwd=ROOT)
    paths = list(tmp_path.iterdir())
    assert len(paths) > 60  # the others were asked to end before they had begun
    unfinished = [path for path in paths if not path.read_bytes().endswith(MCAP0_MAGIC)]
    for path in unfinished:
        _, count, _ = path.stem.split("-")
        assert count == "2"
        check_records(path)
    for path in {*paths} - {*unfinished}:
        check_strictly(path)
        assert b"interrupted" in path.read_bytes()  # in the head, which is not compressed
    assert len(unfinished) < len(paths) / 2


def check_records(path: Path) -> None:
    """Hold that a file without an end consists of whole records."""
    data = path.read_bytes()
    place = len(MCAP0_MAGIC)
    while place < len(data):
        _, length = struct.unpack_from("<BQ", data, place)
        place += 9 + length
    assert place == len(data) > len(MCAP0_MAGIC)


@pytest.mark.parametrize("number", STOPS)
def test_a_signal_amid_a_flush_waits_for_its_end(number: signal.Signals, tmp_path: Path) -> None:
    scenario, path = make_scenario(), tmp_path / "a.mcap"

    class Interrupted(io.FileIO):
        """A signal comes in the middle of every write."""

        def write(self, data: Any, /) -> int:
            count = super().write(bytes(data)[: len(data) // 2 + 1])
            if self.tell() > 10_000:
                signal.raise_signal(number)
            return count

    ticks = list(iterate_ticks(scenario))
    left = iter(ticks)
    with pytest.raises((KeyboardInterrupt, SystemExit)):
        record_ticks(path, scenario, left, lambda path: Interrupted(path, "x+"))
    check_strictly(path)
    assert len(read_recording(path).poses) == len(ticks) - len(list(left))


def replace(path: Path) -> None:
    path.unlink()  # as somebody does who knows no lock
    path.write_bytes(b"somebody else's")


def move(path: Path) -> None:
    path.rename(path.with_name("moved.mcap"))


def move_and_replace(path: Path) -> None:
    move(path)
    path.write_bytes(b"somebody else's")


LOSSES = [
    (Path.unlink, "deleted: its {s} s are lost"),
    (replace, "deleted: its {s} s are lost"),
    (move, "moved: {s} s are safe where it is now"),
    (move_and_replace, "moved: {s} s are safe where it is now"),
]


@pytest.mark.skipif(sys.platform == "win32", reason="Windows deletes no file that is open")
@pytest.mark.parametrize(("lose", "found"), LOSSES)
def test_a_recording_that_loses_its_file_ends_with_the_next_chunk(
    lose: Callable[[Path], object], found: str, tmp_path: Path
) -> None:
    path, scenario = tmp_path / "a.mcap", make_scenario()
    ticks = iterate_ticks(scenario)
    with Recorder(path, scenario, flush_s=1000.0) as recorder:
        for _, tick in zip(range(100), ticks, strict=False):
            recorder.receive(tick)
        recorder.flush()
        lose(path)
        recorder.receive(next(ticks))
        expected = "a.mcap: expected a file that stays, found it " + found.format(s="1.600")
        with pytest.raises(LogError, match=rf"{re.escape(expected)}\Z"):
            recorder.flush()
        with pytest.raises(LogError, match="found a closed one"):
            recorder.receive(next(ticks))


@pytest.mark.skipif(sys.platform == "win32", reason="Windows deletes no file that is open")
@pytest.mark.parametrize(("lose", "found"), LOSSES)
def test_a_file_that_is_lost_at_the_end_is_told(
    lose: Callable[[Path], object], found: str, tmp_path: Path
) -> None:
    path, scenario = tmp_path / "a.mcap", make_scenario(max_duration_s=0.5)
    recorder = Recorder(path, scenario)
    for tick in iterate_ticks(scenario):
        recorder.receive(tick)
    lose(path)
    with pytest.raises(LogError, match=re.escape(found.format(s="0.496"))):
        recorder.close()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows moves no file that is open")
def test_a_moved_recording_is_whole_where_it_is(tmp_path: Path) -> None:
    path, moved, scenario = tmp_path / "a.mcap", tmp_path / "b.mcap", make_scenario()
    with Recorder(path, scenario, flush_s=0.0) as recorder:
        ticks = iterate_ticks(scenario)
        recorder.receive(next(ticks))
        path.rename(moved)
        with pytest.raises(LogError, match=r"found it moved: 0\.016 s are safe"):
            recorder.receive(next(ticks))
    check_strictly(moved)
    assert read_recording(moved).notes == {"recording_failed": "the file was moved"}


def test_a_loop_may_change_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    scenario = make_scenario(max_duration_s=0.5)
    with Recorder("a.mcap", scenario, flush_s=0.0) as recorder:
        (tmp_path / "elsewhere").mkdir()
        monkeypatch.chdir(tmp_path / "elsewhere")
        for tick in iterate_ticks(scenario):
            recorder.receive(tick)
    check_strictly(tmp_path / "a.mcap")


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
