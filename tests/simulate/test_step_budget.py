import inspect
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from tests.log.runs import assert_same
from turtlelog.check.recording_fixture import SimulatedRuns
from turtlelog.errors import SimulationError
from turtlelog.laws import Decision, Pose
from turtlelog.log import Recorder, read_recording
from turtlelog.replay import replay_law
from turtlelog.scenario import Scenario, get_preset, override_scenario
from turtlelog.simulate import collect_run, iterate_ticks, simulate_many, simulate_run, step_budget
from turtlelog.simulate.collect import run_live
from turtlelog.simulate.step_budget import StepBudget, StepBudgetError
from turtlelog.sweep import prepare_sweep
from turtlelog.sweep.tune_candidates import Candidates

POSE = Pose(0.0, 0.0, 0.0)
DECISION = Decision(speed_m_s=0.0, turn_rate_rad_s=0.0)
MUCH_S = 5.0
"""A budget that no machine is too busy for."""

LAW = """
import time
from turtlelog.laws import SequentialP

class Own(SequentialP):
    samples = -1

    def step(self, time_ns, pose):
        self.samples += 1
        if self.samples == 12:
            {body}
        return super().step(time_ns, pose)
"""


def make_scenario(folder: Path, body: str) -> Scenario:
    path = folder / "own.py"
    path.write_text(LAW.format(body=body), encoding="utf-8")
    return override_scenario(get_preset("textbook"), {"law.kind": f"{path}:Own"})


def count_threads() -> int:
    return sum(thread.name in {"loop", "step", "step end"} for thread in threading.enumerate())


def wait_until(holds: Callable[[], bool], most_s: float = 20.0) -> None:
    end_s = time.monotonic() + most_s
    while not holds():
        assert time.monotonic() < end_s
        time.sleep(0.01)


def test_a_budget_that_is_kept_changes_nothing(tmp_path: Path) -> None:
    scenario = make_scenario(tmp_path, "pass")
    found = collect_run(scenario, iterate_ticks(scenario, step_budget_s=MUCH_S))
    assert_same(found, simulate_run(scenario))


def test_a_built_in_law_has_a_budget_as_well() -> None:
    scenario = get_preset("textbook")
    found = collect_run(scenario, iterate_ticks(scenario, step_budget_s=MUCH_S))
    assert_same(found, simulate_run(scenario))
    with pytest.raises(StepBudgetError, match=r"law sequential-p, sample 0 took .* of 1e-06 ms"):
        collect_run(scenario, iterate_ticks(scenario, step_budget_s=1e-9))


def test_a_step_that_takes_too_long_ends_the_run_and_its_recording(tmp_path: Path) -> None:
    scenario = make_scenario(tmp_path, "time.sleep(0.3)")
    recorder = Recorder(tmp_path / "a.mcap", scenario)
    with pytest.raises(
        StepBudgetError, match=r"sample 12 took 3\S+ ms of a budget of 200 ms, at 0\.192 s; "
    ):
        run_live(scenario, [recorder], realtime=False, step_budget_s=0.2)
    run = read_recording(tmp_path / "a.mcap")
    assert (len(run.samples), run.stop_reason, run.is_complete) == (12, "step_budget", False)
    assert run.events[-1].text.startswith("The run ended: step budget: law ")
    assert " sample 12 took 3" in run.events[-1].text
    assert "--step-budget-ms 1200, in Python step_budget_s=1.2" in run.events[-1].text


def test_a_step_just_within_its_budget_goes_on(tmp_path: Path) -> None:
    scenario = make_scenario(tmp_path, "time.sleep(0.3)")
    run = collect_run(scenario, iterate_ticks(scenario, step_budget_s=MUCH_S))
    assert run.stop_reason == "standstill"


def test_a_step_that_never_returns_ends_the_run_and_is_ended(tmp_path: Path) -> None:
    before = count_threads()
    scenario = make_scenario(tmp_path, "while True: pass")
    start_s = time.monotonic()
    with pytest.raises(StepBudgetError, match="sample 12 took more than 1100 ms of a budget of"):
        run_live(scenario, realtime=False, step_budget_s=0.1)
    assert time.monotonic() - start_s < 20.0
    wait_until(lambda: count_threads() <= before)


def test_a_step_that_catches_what_ends_it_ends_the_run_and_is_ended_again() -> None:
    caught: list[BaseException] = []

    def step(time_ns: int, pose: Pose) -> Decision:
        while len(caught) < 3:
            try:
                while True:
                    pass
            except BaseException as err:
                caught.append(err)
        return DECISION

    budget = StepBudget(step, 0.05)
    with pytest.raises(StepBudgetError, match="took more than 1050 ms of a budget of 50 ms"):
        budget(0, POSE)
    wait_until(lambda: len(caught) == 3)


def test_a_step_that_nothing_ends_does_not_hold_the_run_up() -> None:
    released = threading.Event()

    def step(time_ns: int, pose: Pose) -> Decision:
        # As code in C would: no exception is raised in it while it waits.
        released.wait()
        return DECISION

    budget = StepBudget(step, 0.05)
    with pytest.raises(StepBudgetError, match="took more than 1050 ms of a budget of 50 ms"):
        budget(0, POSE)
    released.set()


def test_what_ends_a_step_hits_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    """However near to its own end the step is."""
    monkeypatch.setattr(step_budget, "_PATIENCE_S", 0.01)
    monkeypatch.setattr(step_budget, "_AGAIN_S", 0.005)
    unhandled: list[object] = []
    monkeypatch.setattr(threading, "excepthook", unhandled.append)
    monkeypatch.setattr(sys, "unraisablehook", unhandled.append)
    before = count_threads()
    for late_s in np.linspace(-0.002, 0.002, 40):

        def step(time_ns: int, pose: Pose, takes_s: float = 0.011 + late_s) -> Decision:
            end_s = time.perf_counter() + takes_s
            while time.perf_counter() < end_s:
                pass
            return DECISION

        with pytest.raises(StepBudgetError, match="took "):
            StepBudget(step, 0.001)(0, POSE)
    wait_until(lambda: count_threads() <= before)
    assert unhandled == []


def test_what_a_law_raises_comes_as_without_a_budget(tmp_path: Path) -> None:
    scenario = make_scenario(tmp_path, "raise ValueError('no more')")
    with pytest.raises(SimulationError, match="no more") as plain:
        simulate_run(scenario)
    with pytest.raises(SimulationError) as caught:
        run_live(scenario, realtime=False, step_budget_s=MUCH_S)
    assert str(caught.value) == str(plain.value)
    assert caught.value.run.stop_reason == "law_failed"


def test_a_step_computes_in_the_context_of_its_caller() -> None:
    def step(time_ns: int, pose: Pose) -> Decision:
        np.float64(1.0) / np.float64(0.0)
        return DECISION

    budget = StepBudget(step, MUCH_S)
    with np.errstate(divide="ignore"):
        assert budget(0, POSE) is DECISION
    with np.errstate(divide="raise"), pytest.raises(FloatingPointError):
        StepBudget(step, MUCH_S)(0, POSE)


def test_the_thread_of_a_run_ends_with_it() -> None:
    before = count_threads()
    run_live(get_preset("textbook"), realtime=False, step_budget_s=MUCH_S)
    wait_until(lambda: count_threads() <= before)


@pytest.mark.parametrize("budget_s", [0.0, -1.0, float("nan"), float("inf")])
def test_a_budget_is_a_time_above_0(budget_s: float) -> None:
    with pytest.raises(SimulationError, match="step_budget_s: expected a time above 0 s, found"):
        run_live(get_preset("textbook"), realtime=False, step_budget_s=budget_s)


LATE = r"own\.py:Own, sample 12 took more than 1000 ms of a budget of 1000 ms, at 0\.192 s; a slow"
"""Of the law above with the least budget whose steps are not timed one by one."""


@pytest.mark.parametrize(
    "call",
    [
        *(simulate_run, simulate_many, iterate_ticks, run_live, prepare_sweep, Candidates),
        SimulatedRuns.simulate,
    ],
    ids=lambda call: call.__name__,
)
def test_a_step_has_ten_seconds_unless_set(call: Callable[..., object]) -> None:
    assert inspect.signature(call).parameters["step_budget_s"].default == 10.0


def test_a_long_budget_that_is_kept_changes_nothing(tmp_path: Path) -> None:
    scenario = make_scenario(tmp_path, "time.sleep(0.5)")
    found = simulate_run(scenario, step_budget_s=1.0)
    assert_same(found, simulate_run(scenario, step_budget_s=None))


def test_a_step_beyond_a_long_budget_ends_the_run_at_its_tick(tmp_path: Path) -> None:
    before, scenario = count_threads(), make_scenario(tmp_path, "while True: time.sleep(0.01)")
    with pytest.raises(StepBudgetError, match=LATE) as caught:
        simulate_run(scenario, step_budget_s=1.0)
    require_end(caught.value)
    assert caught.value.run.poses.time_ns[-1] == 12 * 16_000_000
    wait_until(lambda: count_threads() <= before)


def require_end(error: SimulationError) -> None:
    run = error.run
    assert run is not None
    assert (len(run.samples), run.stop_reason, run.is_complete) == (12, "step_budget", False)
    assert run.events[-1].text == f"The run ended: step budget: {error}."


CATCHING = "exec('for _ in range(30):\\n try: time.sleep(.01)\\n except BaseException: _ = 0')"


@pytest.mark.parametrize(
    "body",
    [
        "time.sleep(3)",
        "until = time.time() + 3\n            while time.time() < until: " + CATCHING,
    ],
    ids=["it waits in C", "it catches everything"],
)
def test_a_step_that_cannot_be_ended_does_not_hold_a_run_up(
    tmp_path: Path, body: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(step_budget, "_PATIENCE_S", 0.1)
    stdout, scenario = sys.stdout, make_scenario(tmp_path, body)
    with pytest.raises(StepBudgetError, match=LATE) as caught:
        simulate_run(scenario, step_budget_s=1.0)
    require_end(caught.value)
    assert sys.stdout is stdout


def test_a_step_is_ended_in_any_thread(tmp_path: Path) -> None:
    scenario = make_scenario(tmp_path, "while True: time.sleep(0.01)")
    with ThreadPoolExecutor(1) as pool, pytest.raises(StepBudgetError, match=LATE):
        pool.submit(simulate_run, scenario, step_budget_s=1.0).result()


def test_a_law_that_never_begins_has_its_budget_too(tmp_path: Path) -> None:
    path = tmp_path / "own.py"
    text = (
        LAW.format(body="pass") + "    def __init__(self, p):\n        while True: time.sleep(.01)"
    )
    path.write_text(text, encoding="utf-8")
    scenario = override_scenario(get_preset("textbook"), {"law.kind": f"{path}:Own"})
    with pytest.raises(StepBudgetError, match=r"took more than 1000 .*before its first"):
        simulate_run(scenario, step_budget_s=1.0)


def test_who_looks_at_a_step_in_a_debugger_has_all_the_time(tmp_path: Path) -> None:
    debugger = "exec('def look():\\n time.sleep(1.6)', {'__name__': 'pdb', 'time': time}, found)"
    scenario = make_scenario(tmp_path, f"found = {{}}; {debugger}; found['look']()")
    assert simulate_run(scenario, step_budget_s=1.0).stop_reason == "standstill"


def test_ticks_that_nobody_takes_leave_no_thread(tmp_path: Path) -> None:
    before, scenario = count_threads(), make_scenario(tmp_path, "pass")
    ticks = iterate_ticks(scenario)
    assert next(ticks).time_ns == 0
    del ticks
    wait_until(lambda: count_threads() <= before)


def test_a_live_run_computes_each_tick_when_it_is_due(tmp_path: Path) -> None:
    scenario = make_scenario(tmp_path, "pass")
    ticks = iterate_ticks(scenario, one_by_one=True)
    assert [next(ticks).time_ns for _ in range(3)] == [0, 16_000_000, 32_000_000]


def test_a_law_on_recorded_poses_has_its_budget_too(tmp_path: Path) -> None:
    run = simulate_run(get_preset("textbook"))
    scenario = make_scenario(tmp_path, "while True: time.sleep(0.01)")
    with pytest.raises(StepBudgetError, match=LATE):
        replay_law(run, scenario, step_budget_s=1.0)
