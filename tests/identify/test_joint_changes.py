"""Axes whose commands change together: a robot that brakes first seems to turn late."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from tests.identify.limited_robots import Limited, find_headings
from tests.identify.robots import Values, build_run, wrap
from tests.identify.wheel_robots import Wheeled
from tests.known import known
from turtlelog.identify import AxisModel, build_robot_scenario
from turtlelog.identify.axis_motion import read_axis_motion
from turtlelog.identify.fit_values import find_joint_changes
from turtlelog.identify.held_response import hold_commands
from turtlelog.run import Run

SEGMENT_S = 1.5
COUNT = 20
AT_S = np.arange(0.0, SEGMENT_S * COUNT + 1.0, 0.05)
SENT_S = np.arange(0.5, SEGMENT_S * COUNT, 0.05)
QUICK, SLOW = Limited(dead_time_s=0.05), Limited(dead_time_s=0.3)
BRAKING = Wheeled(wheel=Limited(acceleration=1.0, lag_s=0.05), turn_gain=0.95, track_m=0.24)


def drive_and_turn(alone: int = 0) -> tuple[Values, Values]:
    """Return commands that drive and turn in turns; some turns also change their direction."""
    number = ((SENT_S - 0.5) / SEGMENT_S).astype(int)
    turns = np.where(number % 2, np.where(number // 2 % 2, 0.5, -0.5), 0.0)
    for row in 2 * np.arange(alone) + 3:
        turns[(number == row) & (SENT_S - 0.5 - SEGMENT_S * row > 0.75)] *= -1.0
    return np.where(number % 2, 0.0, 0.5), turns


def drive_braking(commands: tuple[Values, Values]) -> Run:
    """Return the run of a robot whose wheels must brake before they turn it."""
    poses = BRAKING.drive(SENT_S, commands, AT_S)
    return build_noisy(poses[:, :2], poses[:, 2], commands)


def drive_slow(speed: Limited, turn_rate: Limited, commands: tuple[Values, Values]) -> Run:
    """Return the run of a robot without a limit, whose axes have delays of their own."""
    way_m = find_headings(speed, SENT_S, commands[0], AT_S)
    heading = find_headings(turn_rate, SENT_S, commands[1], AT_S)
    middle = 0.5 * (heading[1:] + heading[:-1])
    steps = np.diff(way_m)[:, None] * np.column_stack([np.cos(middle), np.sin(middle)])
    return build_noisy(np.vstack([np.zeros(2), np.cumsum(steps, axis=0)]), heading, commands)


def build_noisy(xy_m: Values, heading: Values, commands: tuple[Values, Values]) -> Run:
    rng = np.random.default_rng(4)
    seen = wrap(heading + rng.normal(0.0, 5e-4, len(AT_S)))
    seen_m = xy_m + rng.normal(0.0, 2e-4, xy_m.shape)
    return build_run(AT_S, seen_m, seen, (SENT_S, *commands))


@cache
def identify_braking() -> tuple[Run, tl.RobotModel]:
    run = drive_braking(drive_and_turn())
    return run, tl.identify_robot(run)


def is_doubted(axis: AxisModel) -> bool:
    return any("only waits for the" in doubt for doubt in axis.doubts)


def test_a_turn_that_always_waits_for_the_brakes_has_no_narrow_delay() -> None:
    """A robot is driven in arcs of 2 ms and identified for two tests, which takes 2 s.

    It turns 0.1 s after a command, or 0.4 s after one that also brakes it.
    """
    found = identify_braking()[1].turn_rate
    assert is_doubted(found)
    for name in ("dead_time_s", "total_delay_s"):
        one = known(getattr(found, name))
        assert one.low <= BRAKING.list_truth(found)[name] < 0.3 < one.high


def test_advice_for_such_a_robot_has_the_longer_delay_and_its_doubt() -> None:
    run, model = identify_braking()
    robot = build_robot_scenario(model, run)
    plant: Any = robot.scenario.plant
    assert plant.turn_dead_time_s + plant.turn_lag_s > 0.4
    assert any("only waits for the speed" in note for note in robot.notes)


def test_a_few_turns_that_change_alone_show_the_limit_of_the_wheels() -> None:
    found = tl.identify_robot(drive_braking(drive_and_turn(alone=2))).turn_rate
    total = known(found.total_delay_s)
    assert found.limit_acts == "at_wheels"
    assert not is_doubted(found)
    assert total.low <= BRAKING.list_truth(found)["total_delay_s"] <= total.high < 0.15


@pytest.mark.parametrize(("alone", "doubted"), [(2, True), (3, False)])
def test_one_change_alone_in_ten_shows_the_delay(alone: int, *, doubted: bool) -> None:
    commands = drive_and_turn(alone)
    found = tl.identify_robot(drive_slow(QUICK, SLOW, commands)).turn_rate
    assert known(found.dead_time_s).value == pytest.approx(SLOW.dead_time_s, abs=5e-3)
    assert is_doubted(found) is doubted


def test_axes_with_equal_delays_do_not_wait_for_each_other() -> None:
    model = tl.identify_robot(drive_slow(QUICK, QUICK, drive_and_turn()))
    assert not any(is_doubted(axis) for axis in model.axes)


def test_a_turn_that_may_have_no_delay_at_all_is_refused_with_what_to_drive() -> None:
    quick = Limited(dead_time_s=0.0, lag_s=1e-4)
    found = tl.identify_robot(drive_slow(quick, SLOW, drive_and_turn())).turn_rate
    assert "the interval of the total delay, 0 to 0.4" in found.reason
    assert found.advice == "step the turn rate ten times for 2 s, while the speed rests"


@pytest.mark.parametrize(("later_s", "joint"), [(0.09, True), (0.11, False), (-0.11, False)])
def test_changes_within_a_tenth_of_a_second_are_joint(later_s: float, *, joint: bool) -> None:
    time_s = np.array([1.0, 2.0, 3.0])
    value = np.array([0.5, 0.0, 0.5])
    motion = read_axis_motion(identify_braking()[0], "turn_rate")
    commands, beside = (hold_commands(one, value) for one in (time_s, time_s + later_s))
    both = replace(motion, commands=commands, beside=beside)
    assert find_joint_changes(both).tolist() == [joint] * 3
    assert not find_joint_changes(replace(both, beside=None)).any()
