"""Robots that no structure is like: doubted where intervals miss, and gains that suit them."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from tests.identify.limited_robots import Limited, turn_as_advised, turn_on_the_spot
from tests.identify.robots import Log, build_run
from tests.identify.strange_robots import KINDS, Strange, draw_robot
from tests.known import known
from turtlelog.identify import AxisModel, Estimate, build_robot_scenario
from turtlelog.run import Run

LOG = Log(duration_s=20.0, poses_hz=25.0)
ROBOTS = 10


@cache
def identify(damping: float) -> tuple[Run, tl.RobotModel]:
    run = turn_on_the_spot(Strange(damping=damping), LOG, 2)
    return run, tl.identify_robot(run)


def test_a_plain_robot_in_small_steps_is_the_exact_one() -> None:
    log = replace(LOG, duration_s=6.0)
    runs = [turn_on_the_spot(truth, log, 2) for truth in (Limited(), Strange())]
    headings = [run.poses.heading_rad for run in runs]
    np.testing.assert_allclose(headings[1], headings[0], atol=1e-5)


@pytest.mark.parametrize("damping", [0.4, 0.6])
def test_the_advised_gain_of_a_robot_that_oscillates_overshoots_no_more_than_was_wanted(
    damping: float,
) -> None:
    run, model = identify(damping)
    assert known(model.turn_rate.lag_s).value == pytest.approx(0.1, abs=3e-3)
    assert max(turn_as_advised(model, run, Strange(damping=damping))) <= 6.0


def test_the_scenario_of_a_robot_that_oscillates_has_a_longer_dead_time_and_says_so() -> None:
    run, model = identify(0.4)
    robot = build_robot_scenario(model, run)
    plant: Any = robot.scenario.plant
    longer_s = model.turn_rate.oscillation_delay_s
    assert longer_s == pytest.approx(0.5 * 0.1 * (2.0 * 0.4) ** -3.0, rel=0.05)
    assert plant.turn_dead_time_s == pytest.approx(0.07 + longer_s, abs=3e-3)
    assert (plant.turn_oscillates, plant.speed_oscillates) == (True, None)
    assert "because it oscillates" in " ".join(robot.notes)


@pytest.mark.parametrize(("product", "oscillates"), [(0.0025, False), (0.0026, True)])
def test_only_a_pair_of_complex_poles_needs_a_longer_dead_time(
    product: float, *, oscillates: bool
) -> None:
    lag_s = Estimate(value=0.1, low=0.1, high=0.1)
    axis = AxisModel(
        axis="turn_rate",
        status="ok",
        lag_s=lag_s,
        lag_product_s2=Estimate(value=product, low=product, high=product, unit="s^2"),
    )
    assert (axis.oscillation_delay_s > 0.0) is oscillates


@pytest.mark.thorough
@pytest.mark.parametrize("kind", KINDS)
def test_a_strange_robot_is_doubted_or_intervals_hold_and_advice_suits_it(kind: str) -> None:
    """Ten robots of a kind are identified and turned by the advised gain.

    One kind is an exception. Of robots with dry friction one in five misses without a doubt, by
    some hundredths of the gain.
    """
    fine: list[bool] = []
    suits: list[bool] = []
    for seed in range(ROBOTS):
        truth, log = draw_robot(kind, seed)
        run = turn_on_the_spot(truth, log, seed)
        model = tl.identify_robot(run)
        axis, true = model.turn_rate, truth.list_truth()
        found = {name: getattr(axis, name) for name in ("gain", "total_delay_s")}
        held = [one.low <= true[name] <= one.high for name, one in found.items() if one]
        fine += [bool(axis.doubts)] if axis.doubts else held
        suits.append(max(turn_as_advised(model, run, truth)) <= 6.0)
    assert np.mean(fine) >= (0.6 if kind == "dry friction" else 0.85)
    assert np.mean(suits) >= 0.9


@pytest.mark.parametrize(("falling_s", "reason"), [(0.1, "rising and falling"), (0.4, "")])
def test_a_robot_that_brakes_faster_than_it_accelerates_is_refused_for_that(
    falling_s: float, reason: str
) -> None:
    """A search for a structure that is none takes longer."""
    time_s = np.arange(0.0, 55.0, 0.02)
    levels = np.array([0.0, 0.5, -1.0, 1.0, -0.5, 0.25, -0.75, 0.75, -0.25] * 3)
    command_s = np.cumsum(np.full(len(levels), 2.0)) - 1.0
    rate, rates = 0.0, []
    for now_s in time_s.tolist():
        wanted = float(levels[max(np.searchsorted(command_s, now_s - 0.1, side="right") - 1, 0)])
        lag_s = 0.4 if abs(wanted) > abs(rate) else falling_s
        rate += (wanted - rate) * (1.0 - np.exp(-0.02 / lag_s))
        rates.append(rate)
    heading_rad = np.cumsum(rates) * 0.02
    commands = command_s, np.zeros(len(levels)), levels
    run = build_run(time_s, np.zeros((len(time_s), 2)), heading_rad, commands)
    axis = tl.identify_robot(run).turn_rate
    assert axis.is_known is not bool(reason)
    assert reason in axis.reason
    assert axis.advice == ""


def test_a_drive_with_an_emergency_stop_is_refused_with_advice_for_one_without() -> None:
    """A search for a structure that is none takes longer."""
    time_s = np.arange(0.0, 55.0, 0.02)
    levels = np.array([0.0, 0.5, -1.0, 1.0, -0.5, 0.25, -0.75, 0.75, -0.25] * 3)
    command_s = np.cumsum(np.full(len(levels), 2.0)) - 1.0
    held = levels[np.maximum(np.searchsorted(command_s, time_s - 0.1, side="right") - 1, 0)]
    rate, rates = 0.0, []
    for now_s, command in zip(time_s.tolist(), held.tolist(), strict=True):
        is_stopped = now_s > 40.0
        lag_s = 0.05 if is_stopped else 0.2
        rate += (0.9 * command * (not is_stopped) - rate) * (1.0 - np.exp(-0.02 / lag_s))
        rates.append(rate)
    commands = command_s, np.zeros(len(levels)), levels
    run = build_run(time_s, np.zeros((len(time_s), 2)), np.cumsum(rates) * 0.02, commands)
    axis = tl.identify_robot(run).turn_rate
    assert "between earlier and later commands" in axis.reason
    drive = "step the turn rate ten times for 2 s"
    assert axis.advice == f"{drive}, while no emergency stop and no other program acts"
