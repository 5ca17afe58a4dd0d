import re
import signal
import sys
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap.records import Message

from tests.log.live import PROGRAM, read_messages, read_rest, start_recording, wait_for_tick
from tests.log.recording.strange import make_strange
from tests.log.runs import assert_same
from tests.log.strict import check_strictly
from turtlelog.errors import LogError, SimulationError
from turtlelog.log import read_recording
from turtlelog.log.recording.recorder import Recorder
from turtlelog.run import Run
from turtlelog.scenario import Scenario, get_preset, override_scenario
from turtlelog.simulate import Tick, simulate_run
from turtlelog.simulate.collect import Sink, run_live

TICK_S = 0.016


def make_scenario(preset: str = "paper", **values: Any) -> Scenario:
    changes = {key.replace("__", "."): value for key, value in values.items()}
    return override_scenario(get_preset(preset), changes)


class Clock:
    """A clock that goes on only while somebody sleeps or works."""

    def __init__(self, oversleep_s: float = 0.0) -> None:
        self.time_s, self.sleeps, self._oversleep_s = 100.0, [0.0], oversleep_s

    def monotonic(self) -> float:
        return self.time_s

    def sleep(self, duration_s: float) -> None:
        self.sleeps.append(duration_s)
        self.time_s += duration_s + self._oversleep_s


class Watcher:
    """Notes when ticks come, and works on some of them."""

    def __init__(
        self, clock: Clock | None = None, work_s: Mapping[int, float] | None = None
    ) -> None:
        self.ticks: list[Tick] = []
        self.times_s: list[float] = []
        self.notes: Mapping[str, str] | None = None
        self._clock, self._work_s = clock or Clock(), work_s or {}

    def receive(self, tick: Tick) -> None:
        self._clock.time_s += self._work_s.get(len(self.ticks), 0.0)
        self.ticks.append(tick)
        self.times_s.append(self._clock.time_s)

    def close(self, notes: Mapping[str, str]) -> None:
        assert self.notes is None
        self.notes = dict(notes)


class Interrupter(Watcher):
    """Sends a signal when it has seen so many ticks."""

    def __init__(self, number: signal.Signals, after: int, times: int = 1) -> None:
        super().__init__()
        self._number, self._after, self._times = number, after, times

    def receive(self, tick: Tick) -> None:
        super().receive(tick)
        if self._after <= len(self.ticks) < self._after + self._times:
            signal.raise_signal(self._number)


class Failing(Watcher):
    def receive(self, tick: Tick) -> None:
        raise LogError("disk full")


@pytest.mark.parametrize("preset", ["paper-kp10", "textbook"])
def test_a_live_run_is_the_run_simulated_at_once(preset: str) -> None:
    watcher = Watcher()
    run = run_live(get_preset(preset), [watcher], realtime=False)
    assert_same(run, simulate_run(get_preset(preset)))
    assert [tick.time_ns for tick in watcher.ticks] == run.poses.time_ns.tolist()
    assert watcher.ticks[-1].stop_reason == run.stop_reason
    assert watcher.notes == {}


def test_ticks_come_at_their_time_by_the_clock() -> None:
    clock = Clock()
    watcher = Watcher(clock)
    run_live(make_scenario(max_duration_s=2.0), [watcher], realtime=True, clock=clock)
    expected = [100.0 + tick.time_ns / 1e9 for tick in watcher.ticks]
    assert watcher.times_s == pytest.approx(expected, abs=1e-9)


def test_a_clock_that_oversleeps_makes_no_drift() -> None:
    clock = Clock(oversleep_s=0.004)
    watcher = Watcher(clock)
    run = run_live(make_scenario(max_duration_s=20.0), [watcher], realtime=True, clock=clock)
    assert watcher.times_s[-1] - 100.0 == pytest.approx(20.0 + 0.004, abs=0.016)
    assert run.notes == {}


def test_ticks_that_come_late_are_counted_and_caught_up() -> None:
    clock = Clock()
    watcher = Watcher(clock, {10: 0.1})
    run = run_live(make_scenario(max_duration_s=1.0), [watcher], realtime=True, clock=clock)
    # 0.1 s of work at the 10th tick: it and those after it until the lag is below one tick.
    assert run.notes == watcher.notes == {"late_ticks": "5, by up to 0.084 s"}
    assert watcher.times_s[30] == pytest.approx(100.0 + 30 * TICK_S)


def test_ticks_of_a_robot_are_late_by_its_own_period() -> None:
    clock = Clock()
    watcher = Watcher(clock, {10: 0.18})
    scenario = make_scenario("lagged", max_duration_s=1.0)
    # The next three come 0.13, 0.08 and 0.03 s late; the last by less than its period of 0.05 s.
    run = run_live(scenario, [watcher], realtime=True, clock=clock)
    assert run.notes == {"late_ticks": "2, by up to 0.130 s"}


def test_a_run_that_keeps_no_time_never_sleeps() -> None:
    clock = Clock()
    run_live(make_scenario(max_duration_s=1.0), realtime=False, clock=clock)
    assert clock.sleeps == [0.0]


@pytest.mark.realtime
def test_a_real_clock_paces_a_run() -> None:
    start = time.monotonic()
    run_live(make_scenario(max_duration_s=0.5), realtime=True)
    assert 0.49 < time.monotonic() - start < 5.0


def read_phases(path: Path) -> list[Message]:
    with path.open("rb") as stream:
        return [found[2] for found in make_reader(stream).iter_messages(["/turtle1/phase"])]


def interrupt(number: signal.Signals, sinks: list[Watcher], **values: Any) -> Run:
    return run_live(make_scenario(**values), sinks, realtime=False)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_run_at_the_next_tick(number: signal.Signals) -> None:
    interrupter, watcher = Interrupter(number, 50), Watcher()
    run = interrupt(number, [interrupter, watcher])
    assert len(run.poses) == len(watcher.ticks) == 51
    assert run.stop_reason == watcher.ticks[-1].stop_reason == "interrupted"
    assert run.events[-1].text == "The run ended: interrupted."
    assert watcher.notes == {}


def test_handlers_are_restored_after_a_run() -> None:
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    interrupt(signal.SIGTERM, [Interrupter(signal.SIGTERM, 50)])
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def test_a_second_signal_ends_the_run_at_once_and_closes_the_sinks() -> None:
    class Twice(Watcher):
        def receive(self, tick: Tick) -> None:
            super().receive(tick)
            if len(self.ticks) == 50:
                signal.raise_signal(signal.SIGINT)
                signal.raise_signal(signal.SIGINT)

    twice = Twice()
    with pytest.raises(KeyboardInterrupt):
        run_live(make_scenario(), [twice], realtime=False)
    assert (len(twice.ticks), twice.notes) == (50, {})


def test_a_signal_before_the_first_sample_is_an_interrupt(tmp_path: Path) -> None:
    scenario = make_scenario(loop__start_backlog=10)
    recorder = Recorder(tmp_path / "a.mcap", scenario)
    with pytest.raises(KeyboardInterrupt):
        run_live(scenario, [recorder, Interrupter(signal.SIGINT, 3)], realtime=False)
    check_strictly(tmp_path / "a.mcap")
    assert read_recording(tmp_path / "a.mcap").stop_reason == "interrupted"


def test_a_signal_at_the_very_end_changes_nothing() -> None:
    expected = simulate_run(make_scenario(max_duration_s=0.8))
    run = interrupt(signal.SIGINT, [Interrupter(signal.SIGINT, 51)], max_duration_s=0.8)
    assert len(expected.poses) == 51
    assert_same(run, expected)


def test_a_run_in_another_thread_leaves_signals_alone() -> None:
    found: list[Run] = []
    thread = threading.Thread(
        target=lambda: found.append(run_live(make_scenario(max_duration_s=0.5), realtime=False))
    )
    thread.start()
    thread.join()
    assert found[0].stop_reason == "max_duration"


def test_all_sinks_are_closed_where_one_fails() -> None:
    first, failing, last = Watcher(), Failing(), Watcher()
    with pytest.raises(LogError, match="disk full"):
        run_live(make_scenario(), [first, failing, last], realtime=False)
    assert (first.notes, failing.notes, last.notes) == ({}, {}, {})


def test_all_sinks_are_closed_where_the_law_fails(tmp_path: Path) -> None:
    law = tmp_path / "law.py"
    law.write_text(
        "from turtlelog.laws import SequentialP\n"
        "class Fails(SequentialP):\n"
        "    def step(self, time_ns, pose):\n"
        "        if time_ns > 10**9: raise ValueError('no more')\n"
        "        return super().step(time_ns, pose)\n",
        encoding="utf-8",
    )
    scenario = make_scenario("textbook", law__kind=f"{law}:Fails")
    recorder = Recorder(tmp_path / "a.mcap", scenario)
    with pytest.raises(SimulationError, match="no more"):
        run_live(scenario, [recorder], realtime=False)
    check_strictly(tmp_path / "a.mcap")
    run = read_recording(tmp_path / "a.mcap")
    assert (run.poses.time_ns[-1], run.stop_reason) == (1_008_000_000, "law_failed")


@pytest.mark.parametrize(
    ("fails", "reason"),
    [
        ("raises", "ValueError: out of ideas"),
        ("nan", "expected a finite command (below 3.4e+38), found speed nan"),
    ],
)
def test_a_law_that_fails_leaves_a_recording_that_says_why(
    fails: str, reason: str, tmp_path: Path
) -> None:
    scenario, watcher, clock = make_strange(tmp_path, fails=fails), Watcher(), Clock()
    recorder = Recorder(tmp_path / "a.mcap", scenario)
    sinks: list[Sink] = [recorder, watcher, Watcher(clock, {3: 0.1})]
    with pytest.raises(SimulationError, match=re.escape(reason)) as caught:
        run_live(scenario, sinks, realtime=True, clock=clock)
    assert watcher.ticks[-1].stop_reason == "law_failed"
    check_strictly(tmp_path / "a.mcap")
    run = read_recording(tmp_path / "a.mcap")
    assert_same(run, caught.value.run)
    assert (len(run.samples), run.stop_reason, run.is_complete) == (4, "law_failed", False)
    assert run.notes.keys() == {"late_ticks"}
    assert (run.events[-1].kind, run.events[-1].time_ns) == ("stop", run.poses.time_ns[-1])
    assert run.events[-1].text.startswith("The run ended: law failed: law ")
    assert reason in run.events[-1].text
    spans = [message.data[8:-1].decode() for message in read_phases(tmp_path / "a.mcap")]
    assert spans == ["two"]


def test_a_law_that_fails_at_its_first_pose_leaves_the_poses(tmp_path: Path) -> None:
    law = tmp_path / "law.py"
    law.write_text(
        "from turtlelog.laws import SequentialP\n"
        "class Fails(SequentialP):\n"
        "    def reset(self, start, goal, path): raise ValueError('no start')\n",
        encoding="utf-8",
    )
    scenario = make_scenario("paper", law__kind=f"{law}:Fails")
    with pytest.raises(SimulationError, match="no start") as caught:
        run_live(scenario, [Recorder(tmp_path / "a.mcap", scenario)], realtime=False)
    assert caught.value.run is None
    run = read_recording(tmp_path / "a.mcap")
    assert (len(run.poses), len(run.samples), run.stop_reason) == (5, 0, "law_failed")


def test_an_interrupted_recording_comes_back_as_the_run(tmp_path: Path) -> None:
    scenario = make_scenario()
    with Recorder(tmp_path / "a.mcap", scenario) as recorder:
        run = run_live(scenario, [recorder, Interrupter(signal.SIGINT, 100)], realtime=False)
    assert run.stop_reason == "interrupted"
    assert_same(read_recording(tmp_path / "a.mcap"), run)


def test_the_notes_of_a_run_are_recorded(tmp_path: Path) -> None:
    scenario, clock = make_scenario(max_duration_s=1.0), Clock()
    with Recorder(tmp_path / "a.mcap", scenario) as recorder:
        sinks: list[Sink] = [recorder, Watcher(clock, {10: 0.1})]
        run = run_live(scenario, sinks, realtime=True, clock=clock)
    assert_same(read_recording(tmp_path / "a.mcap"), run)
    assert "late_ticks" in run.notes


@pytest.mark.realtime
@pytest.mark.skipif(sys.platform == "win32", reason="Windows ends processes in other ways")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_to_the_process_finishes_the_file(number: signal.Signals, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    process = start_recording(path, PROGRAM)
    wait_for_tick(process, 0.7)
    process.send_signal(number)
    last_ns = read_rest(process)
    assert process.returncode == 0
    check_strictly(path)
    run = read_recording(path)
    assert (run.poses.time_ns[-1], run.stop_reason) == (last_ns, "interrupted")
    assert len(read_messages(path)) > 100
