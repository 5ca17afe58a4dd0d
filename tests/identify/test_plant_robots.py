"""The simulator's own robots with limits: identified from their recordings, simulated again."""

from functools import cache
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from tests.identify.plant_robots import (
    KINDS,
    Keys,
    draw_robot,
    drive_robot,
    list_truth,
    turn_as_advised,
)
from tests.known import known
from turtlelog.identify import AxisModel, build_robot_scenario
from turtlelog.identify.axis_fit import NORMAL_95
from turtlelog.run import Run

SEED = 5
ROBOTS = 8
FIELDS = {
    "acceleration": "rate_limit",
    "bound": "bound",
    "deadband": "deadband",
    "friction": "friction",
    "reverse_gain": "reverse_gain",
}
LIMITED = [kind for kind, limits in KINDS.items() if limits]


@cache
def identify(kind: str, seed: int = SEED) -> tuple[Keys, Run, tl.RobotModel]:
    keys, log = draw_robot(kind, seed)
    run = drive_robot(keys, log, seed)
    return keys, run, tl.identify_robot(run)


def list_found(axis: AxisModel) -> dict[str, Any]:
    return {name: getattr(axis, field) for name, field in FIELDS.items()}


@pytest.mark.everyday("two")
@pytest.mark.parametrize("kind", KINDS)
def test_a_robot_has_the_limits_of_its_plant_and_no_other(kind: str) -> None:
    """Each robot is identified once, by the first of these tests that asks for it."""
    _, _, model = identify(kind)
    for axis in model.axes:
        found = {name for name, one in list_found(axis).items() if one is not None}
        assert found == {*KINDS[kind]}
        assert axis.doubts == ()


@pytest.mark.everyday("two")
@pytest.mark.parametrize("kind", LIMITED)
def test_intervals_hold_the_limits_of_the_plant(kind: str) -> None:
    """Each robot is identified once, by the first of these tests that asks for it."""
    keys, _, model = identify(kind)
    for axis in model.axes:
        truth = list_truth(keys, axis)
        for name in KINDS[kind]:
            found, value = known(getattr(axis, FIELDS[name])), truth[FIELDS[name]]
            assert found.low <= value <= found.high
            if name != "deadband":  # which is between two commands
                assert found.value == pytest.approx(value, rel=5e-3)


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_no_limit_is_known_more_finely_than_its_effect_is_measured(share: float) -> None:
    """A bound that a log shows to a millionth has the least interval, of 1e-4 on either side."""
    found = known(identify("two")[2].speed.bound)
    least = 2.0 * NORMAL_95 * 1e-4 * found.value
    assert (found.high - found.low >= share * least) is (share < 1.0)


@pytest.mark.everyday("two")
@pytest.mark.parametrize("kind", LIMITED)
def test_dead_time_and_time_constant_are_those_of_the_loop_without_its_limits(kind: str) -> None:
    """Each robot is identified once, by the first of these tests that asks for it."""
    keys, _, model = identify(kind)
    for axis in model.axes:
        truth = list_truth(keys, axis)
        for name in ("dead_time_s", "lag_s", "total_delay_s"):
            assert known(getattr(axis, name)).value == pytest.approx(truth[name], abs=2e-3)


@pytest.mark.everyday("two")
@pytest.mark.parametrize("kind", ["two", "all"])
def test_the_scenario_has_the_limits_in_its_plant_and_says_so(kind: str) -> None:
    keys, run, model = identify(kind)
    robot = build_robot_scenario(model, run)
    plant = tl.scenario.flatten_scenario(robot.scenario)
    for axis in model.axes:
        key = "plant.speed_" if axis.axis == "speed" else "plant.turn_"
        assert {name for name in FIELDS if f"{key}{name}" in plant} == {*KINDS[kind]}
        for name in KINDS[kind]:
            value = known(getattr(axis, FIELDS[name])).value
            assert plant[f"{key}{name}"] == pytest.approx(value, rel=1e-5)
        for name in ("gain", "lag_s", "dead_time_s"):
            assert plant[f"{key}{name}"] == pytest.approx(keys[f"{key}{name}"], rel=0.02)
    assert not any("limits.acceleration" in key for key in plant)
    said = " ".join(robot.notes)
    assert "limits of its own in the plant, as identified: bound" in said
    assert tl.scenario.parse_scenario(robot.text) == robot.scenario


@pytest.mark.everyday("two")
@pytest.mark.parametrize("kind", KINDS)
def test_the_recommended_gain_overshoots_turns_of_the_plant_by_no_more_than_was_wanted(
    kind: str,
) -> None:
    """Each robot is identified once, and gains are searched over dozens of steps of all sizes."""
    keys, run, model = identify(kind)
    assert max(turn_as_advised(model, run, keys)) <= 6.0


@pytest.mark.thorough
@pytest.mark.parametrize("kind", KINDS)
def test_intervals_of_95_percent_hold_in_many_robots(kind: str) -> None:
    """Eight robots of each kind are identified, both axes of each."""
    held = []
    for seed in range(ROBOTS):
        keys, _, model = identify(kind, seed)
        for axis in model.axes:
            truth = list_truth(keys, axis)
            found = {name: getattr(axis, name) for name in truth}
            pairs = [(one, truth[name]) for name, one in found.items() if one is not None]
            held += [one.low <= value <= one.high for one, value in pairs]
    assert len(held) >= 4 * ROBOTS
    assert np.mean(held) >= 0.9
