import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.log.runs import assert_same
from turtlelog.errors import SimulationError
from turtlelog.laws import Decision, Pose
from turtlelog.log import Recorder, read_recording
from turtlelog.runner import run_live
from turtlelog.scenario import Scenario, get_preset, override_scenario
from turtlelog.simulate import collect_run, iterate_ticks, simulate_run, step_budget
from turtlelog.simulate.step_budget import StepBudget, StepBudgetError

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
    return sum(thread.name in {"step", "step end"} for thread in threading.enumerate())


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
    with pytest.raises(StepBudgetError, match=r"sample 12 took 3\S+ ms of a budget of 200 ms$"):
        run_live(scenario, [recorder], realtime=False, step_budget_s=0.2)
    run = read_recording(tmp_path / "a.mcap")
    assert (len(run.samples), run.stop_reason, run.is_complete) == (12, "step_budget", False)
    assert run.events[-1].text.startswith("The run ended: step budget: law ")
    assert " sample 12 took 3" in run.events[-1].text
    assert run.events[-1].text.endswith(" ms of a budget of 200 ms.")


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
