"""Runs of the lagged robot: their recorded scenario is tested, and nothing is guessed."""

from dataclasses import replace
from typing import Any

import pytest

from turtlelog.explain import attribute_scenario, identify_run
from turtlelog.run import Run
from turtlelog.scenario import get_preset, override_scenario
from turtlelog.simulate import simulate_run

ROBOT = {
    "plant.kind": "lagged",
    "plant.turn_gain": 1.5,
    "plant.turn_lag_s": 0.1,
    "plant.turn_dead_time_s": 0.08,
    "plant.speed_gain": 3.0,
    "goal.x_m": 7.0,
    "goal.y_m": 6.5,
}


@pytest.fixture(scope="module")
def run() -> Run:
    return simulate_run(override_scenario(get_preset("textbook"), ROBOT))


def test_recorded_scenario_of_a_robot_is_simulated_again_exactly(run: Run) -> None:
    found = identify_run(run)
    assert found.resimulation is not None
    assert found.resimulation.is_exact
    assert found.is_recorded
    assert found.findings["law.kp_linear"].value == 1.0
    assert "it holds another plant" in found.notes[0]


def test_what_a_robot_does_not_tell_is_unknown_without_its_scenario(run: Run) -> None:
    found = identify_run(replace(run, scenario_is_complete=False))
    assert found.notes == (
        "its plant is lagged: a loop is identified from commands only around turtlesim",
    )
    findings = found.findings
    unknown = ("dead_time.rotate", "law.kp_angular", "loop.start_backlog", "loop.queue_policy")
    assert {findings[key].value for key in unknown} == {None}
    assert findings["limits.speed_m_s"].value == 1.0


def test_robot_that_moves_faster_than_its_commands_does_not_jump(run: Run) -> None:
    # three times the commanded speed, where two could be a pose that is missing
    assert not any("jump" in note for note in identify_run(run).notes)


def test_robot_of_another_lag_is_told_by_its_samples(run: Run) -> None:
    other: dict[str, Any] = {**run.parameters, "plant.turn_lag_s": 0.11}
    found = identify_run(replace(run, parameters=other))
    assert found.scenario is None
    assert found.notes[-1].startswith("the recorded scenario reproduces the first")


def test_metric_of_a_robot_is_divided_among_the_effects() -> None:
    delayed = {"loop.transport_delay_ticks": 2, "law.pause_ticks": 10}
    found = attribute_scenario(
        override_scenario(get_preset("textbook"), {**ROBOT, **delayed}), metric="rotate.overshoot"
    )
    assert {"delay", "pause"} <= set(found.causes)
    assert found.resimulated != found.without_all
