"""Limits of the jerk and of the wheels' acceleration: what is found, said and simulated of them."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from tests.identify.limited_robots import (
    Limited,
    find_headings,
    turn_as_advised,
    turn_on_the_spot,
)
from tests.identify.robots import Log, Truth, build_run, find_changes, respond, wrap
from tests.identify.strange_robots import Strange, draw_robot
from tests.identify.wheel_robots import Wheeled, drive_wheels
from tests.known import known
from turtlelog.cli.identify import format_robot
from turtlelog.identify import Estimate, build_robot_scenario, predict_axis, read_robot_notes
from turtlelog.identify.axis_fit import fit_axis, list_ends
from turtlelog.identify.axis_model import has_sure_wheels
from turtlelog.identify.axis_motion import read_axis_motion
from turtlelog.identify.held_response import HeldResponse, Structure, hold_commands, limit_softly
from turtlelog.identify.robot_noise import StepNoise, Whitening, fit_noise
from turtlelog.identify.structure_choice import is_rival
from turtlelog.run import Run

LOG = Log(duration_s=25.0, poses_hz=25.0)
SOFT = Strange(ramp=3.0, jerk=20.0)
WHEELED = Wheeled(wheel=Limited(gain=0.95, acceleration=0.9), turn_gain=0.9, track_m=0.3)


@cache
def identify_soft() -> tuple[Run, tl.RobotModel]:
    run = turn_on_the_spot(SOFT, LOG, 2)
    return run, tl.identify_robot(run)


@cache
def identify_wheels() -> tuple[Run, tl.RobotModel]:
    run = drive_wheels(WHEELED, LOG, 2)
    return run, tl.identify_robot(run)


def test_a_limit_of_the_jerk_is_no_dead_time() -> None:
    """A robot is simulated in steps of 1 ms and identified once for four tests."""
    found = identify_soft()[1].turn_rate
    assert (found.limit_acts, found.doubts) == ("before_lag", ())
    jerk_time_s = known(found.jerk_time_s)
    assert jerk_time_s.low <= 3.0 / 20.0 <= jerk_time_s.high
    assert jerk_time_s.value == pytest.approx(3.0 / 20.0, rel=0.05)
    for name in ("gain", "dead_time_s", "lag_s", "total_delay_s"):
        one = known(getattr(found, name))
        assert one.low <= SOFT.list_truth()[name] <= one.high


def test_the_scenario_limits_the_jerk_of_commands() -> None:
    run, model = identify_soft()
    found, limits = model.turn_rate, build_robot_scenario(model, run).scenario.limits
    gain, acceleration = known(found.gain).value, known(found.rate_limit).value
    expected = acceleration / gain / known(found.jerk_time_s).value
    assert limits.turn_jerk_rad_s3 == pytest.approx(expected, rel=1e-4)
    assert max(turn_as_advised(model, run, SOFT)) <= 6.0


def test_a_jerk_that_is_limited_once_per_period_is_half_a_period_early() -> None:
    """The robot is identified once, by the first of these tests that asks for it."""
    run, model = identify_soft()
    robot, found = build_robot_scenario(model, run), model.turn_rate
    hard = replace(model, turn_rate=replace(found, jerk_time_s=None))
    plain = build_robot_scenario(hard, run)
    period_s = robot.scenario.loop.period_s or robot.scenario.plant.period_s
    later, sooner = (one.scenario.plant.turn_dead_time_s for one in (robot, plain))
    assert later == pytest.approx(sooner + 0.5 * period_s, abs=2e-6)
    told = f"the dead time of the turn rate is {500.0 * period_s:.3g} ms longer for it."
    assert told in " ".join(robot.notes)
    assert told not in " ".join(plain.notes)


def test_the_model_predicts_turns_with_a_limited_jerk() -> None:
    run, model = identify_soft()
    way, _ = predict_axis(model.turn_rate, run, run.poses.time_ns / 1e9)
    assert float(np.std(np.unwrap(run.poses.heading_rad) - way)) < 0.01  # of turns by 10 rad


@pytest.mark.parametrize("jerk_time_s", [0.05, 0.2])
def test_commands_follow_the_s_curves_of_a_plan_in_small_steps(jerk_time_s: float) -> None:
    """Some commands arrive before the curve to the one before has ended."""
    command_s = np.array([0.3, 0.9, 1.0, 2.0, 2.6, 3.3, 4.5])
    turns = np.array([1.2, -0.7, 0.1, 0.25, 0.2, 1.4, 0.0])
    at_s, truth = np.arange(0.0, 6.0, 0.05), Strange(ramp=3.0, jerk=3.0 / jerk_time_s)
    wanted = find_headings(truth, command_s, turns, at_s)
    commands = limit_softly(hold_commands(command_s, truth.gain * turns), 1.0 / 3.0, jerk_time_s)
    response = HeldResponse([commands], truth.lag_s)
    way, _ = response.evaluate(response.place(at_s - truth.dead_time_s))
    np.testing.assert_allclose(way - way[0], wanted, atol=2e-5)


@pytest.mark.parametrize(("less", "is_one"), [(1.9, False), (2.1, True)])
def test_a_limit_of_the_jerk_is_a_rival_long_before_it_is_sure(
    less: float, *, is_one: bool
) -> None:
    fit = fit_axis([read_axis_motion(identify_soft()[0], "turn_rate")])
    before, soft = (
        replace(fit, model=replace_structure(fit.model, order), cost=fit.cost - by)
        for order, by in (("limited_before", 0.0), ("limited_softly", less))
    )
    assert is_rival(before, soft) is is_one
    assert not is_rival(fit, replace(before, cost=fit.cost - 5.9))


def test_of_two_minima_the_one_that_is_likelier_by_its_own_noise_is_taken() -> None:
    """The curve of the jerk that is nearer by the noise of the ramp is off by 10 ms."""
    truth, log = draw_robot("jerk", 32023)
    found = tl.identify_robot(turn_on_the_spot(truth, log, 32023)).turn_rate
    assert known(found.jerk_time_s).value == pytest.approx(truth.ramp / truth.jerk, rel=0.03)
    for name in ("dead_time_s", "total_delay_s"):
        one = known(getattr(found, name))
        assert one.low <= truth.list_truth()[name] <= one.high


@pytest.mark.parametrize(
    ("costs", "kept"),
    [
        ([100.0, 109.9], 2),
        ([100.0, 110.1], 1),
        ([100.0, 100.0 + 9e-5], 1),
        ([100.0 + 1.1e-4, 100.0], 2),
    ],
    ids=["near", "far", "same", "other"],
)
def test_searches_that_end_in_different_minima_of_nearly_one_cost_are_kept(
    costs: list[float], kept: int
) -> None:
    ends = [*list_ends([(np.array([cost]), cost) for cost in costs])]
    assert len(ends) == kept
    assert float(ends[0][0]) == min(costs)


def replace_structure(model: Any, order: Any) -> Any:
    return type(model)(model.motions, Structure(order=order))


@pytest.mark.parametrize("axis", ["speed", "turn_rate"])
def test_the_limit_of_the_wheels_acceleration_is_found_on_each_axis(axis: str) -> None:
    """A robot with two wheels is simulated and identified once for four tests."""
    found = getattr(identify_wheels()[1], axis)
    true = WHEELED.list_truth(found)
    assert (found.limit_acts, found.doubts) == ("at_wheels", ())
    for name in ("gain", "total_delay_s", "rate_limit", "rate_limit_beside"):
        one = known(getattr(found, name))
        assert one.low <= true[name] <= one.high
        assert one.value == pytest.approx(true[name], rel=0.03)


def test_answer_and_scenario_name_the_limit_of_the_wheels_acceleration() -> None:
    run, model = identify_wheels()
    said = " ".join(format_robot(model, [Path("robot.mcap")]).split())
    assert "The wheels limit the acceleration of both axes together: a turn rate that" in said
    robot = build_robot_scenario(model, run)
    plant: Any = robot.scenario.plant
    assert plant.speed_acceleration == pytest.approx(0.9, rel=0.03)
    assert any("The plant has no such limit" in note for note in read_robot_notes(robot.text))


def test_the_model_predicts_turns_of_wheels_with_a_limited_acceleration() -> None:
    run, model = identify_wheels()
    way, _ = predict_axis(model.turn_rate, run, run.poses.time_ns / 1e9)
    assert float(np.std(np.unwrap(run.poses.heading_rad) - way)) < 0.01  # of turns by 10 rad


@pytest.mark.parametrize("slip", [1e-4, 3e-2, 1.0])
def test_the_likeliest_noise_is_that_of_the_steps(slip: float) -> None:
    rng = np.random.default_rng(5)
    count, sensing = 4000, 1e-6
    poses = rng.normal(0.0, np.sqrt(sensing), count + 1)
    moved = np.diff(poses) + rng.normal(0.0, np.sqrt(slip * sensing), count)
    steps, never = np.ones(count), np.zeros(count, dtype=bool)
    noise = fit_noise(moved, steps, steps, never).noise
    assert noise.sensing == pytest.approx(sensing, rel=0.15)
    assert noise.slip == pytest.approx(slip * sensing, rel=0.5)


@pytest.mark.parametrize("turn_rad", [0.0, 0.3])
def test_the_error_of_a_pose_adds_up_on_the_way_that_bends(turn_rad: float) -> None:
    """The steps before and after a pose are measured in two directions."""
    rng = np.random.default_rng(6)
    errors_m = rng.normal(0.0, 1.0, (20_001, 2))
    along_rad = turn_rad * np.arange(20_000)
    direction = np.column_stack([np.cos(along_rad), np.sin(along_rad)])
    moved = np.sum(np.diff(errors_m, axis=0) * direction, axis=1)
    steps, never = np.ones(20_000), np.zeros(20_000, dtype=bool)
    noise = StepNoise(slip=1e-5, sensing=1.0)
    white = Whitening(noise, steps, np.cos(turn_rad) * steps, never).apply(moved)
    assert float(np.mean(white**2)) == pytest.approx(1.0, abs=0.05)
    assert abs(float(np.mean(white[1:] * white[:-1]))) < 0.03


def drive_car(seed: int) -> Run:
    """Return a car whose turn rate is its speed times the tangent of its steering by its length."""
    rng, dead_time_s, length_m = np.random.default_rng(seed), 0.1, 0.33
    time_s = np.arange(0.0, 40.0, 0.05)
    speeds, steers = np.zeros(len(time_s)), np.zeros(len(time_s))
    for row in range(60, len(time_s) - 80, 40):
        speeds[row : row + 40] = rng.choice([0.5, 1.0, 1.5])
        steers[row + 20 : row + 60] = rng.choice([-0.3, -0.15, 0.15, 0.3])
    fine_s = np.arange(0.0, 40.0, 2e-3)
    speed = respond(Truth(dead_time_s=dead_time_s, lag_s=0.3), fine_s, find_changes(time_s, speeds))
    steer = respond(Truth(dead_time_s=dead_time_s, lag_s=0.2), fine_s, find_changes(time_s, steers))
    heading_rad = np.cumsum(speed[0] * np.tan(steer[0]) / length_m) * 2e-3
    ways = speed[0][:, None] * np.column_stack([np.cos(heading_rad), np.sin(heading_rad)])
    xy_m = np.cumsum(ways, axis=0) * 2e-3
    rows = np.arange(0, len(fine_s), 10)
    seen_m = xy_m[rows] + rng.normal(0.0, 5e-4, (len(rows), 2))
    seen_rad = wrap(heading_rad[rows] + rng.normal(0.0, 1e-3, len(rows)))
    turns = speeds * np.tan(steers) / length_m
    return build_run(fine_s[rows], seen_m, seen_rad, (time_s, speeds, turns))


def test_a_car_has_no_limit_of_the_wheels_acceleration() -> None:
    """Its turn rate is not linear, and fits several structures equally badly."""
    model = tl.identify_robot(drive_car(3))
    assert [axis.limit_acts for axis in model.axes] == ["", ""]
    assert known(model.speed.lag_s).value == pytest.approx(0.3, abs=2e-3)
    assert known(model.turn_rate.gain).value == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("ends", "is_sure"), [((0.1, 2.0), True), ((0.0, 2.0), False), ((0.1, np.inf), False)]
)
def test_a_limit_of_the_wheels_needs_a_finite_interval(
    ends: tuple[float, float], *, is_sure: bool
) -> None:
    limit, other = (Estimate(value=1.0, low=low, high=high) for low, high in ((0.5, 1.5), ends))
    axis = replace(identify_wheels()[1].turn_rate, rate_limit=limit, rate_limit_beside=other)
    assert has_sure_wheels(axis) is is_sure
