"""Rates of odometry that cannot be the robot's own, and those that can."""

import numpy as np
import pytest

from tests.log.runs import find_shared
from turtlelog.log import read_run
from turtlelog.log.planar_poses import MOVED_M, Values
from turtlelog.log.ros2.reported_motion import (
    LATERAL,
    SPEED,
    TURN_RATE,
    TURNED_RAD,
    judge_rates,
)

COUNT = 200
TIME_NS = np.arange(COUNT) * 50_000_000
SPEED_M_S, TURN_RAD_S = 0.4, 0.3


def drive(way_m: float = 4.0, turned_rad: float = 3.0, **reported: float) -> dict[str, Values]:
    """Return poses on an arc, beside reported rates of 0 unless they are given."""
    share = np.linspace(0.0, 1.0, COUNT)
    heading_rad = turned_rad * share
    steps = np.diff(way_m * share, prepend=0.0)
    none = dict.fromkeys((SPEED, LATERAL, TURN_RATE), 0.0) | reported
    return {
        "x": np.cumsum(steps * np.cos(heading_rad)),
        "y": np.cumsum(steps * np.sin(heading_rad)),
        "heading": heading_rad,
        **{name: np.full(COUNT, value) for name, value in none.items()},
    }


def test_twists_that_were_never_set_report_no_rates() -> None:
    columns, notes = judge_rates(TIME_NS, drive())

    assert {SPEED, TURN_RATE, LATERAL}.isdisjoint(columns)
    assert "taken as not reported" in notes["reported_rates"]


@pytest.mark.parametrize(("share", "is_kept"), [(0.9, True), (1.1, False)])
@pytest.mark.parametrize("axis", ["place", "heading"])
def test_a_robot_that_stands_reports_that_it_does(
    axis: str, share: float, *, is_kept: bool
) -> None:
    by = {"place": {"way_m": share * MOVED_M, "turned_rad": 0.0}}
    by["heading"] = {"way_m": 0.0, "turned_rad": share * TURNED_RAD}

    columns, notes = judge_rates(TIME_NS, drive(**by[axis]))

    assert (SPEED in columns) is is_kept
    assert (notes == {}) is is_kept


def test_a_jump_of_a_robot_that_stands_is_no_motion() -> None:
    poses = drive(way_m=0.0, turned_rad=0.0)
    poses["x"][90:] = 3.0

    columns, notes = judge_rates(TIME_NS, poses)

    assert SPEED in columns
    assert notes == {}


def test_one_rate_that_was_never_set_leaves_the_other() -> None:
    no_turn, notes = judge_rates(TIME_NS, drive(**{SPEED: SPEED_M_S}))
    no_speed, _ = judge_rates(TIME_NS, drive(**{TURN_RATE: TURN_RAD_S}))

    assert SPEED in no_turn
    assert TURN_RATE not in no_turn
    assert notes["reported_rates"].startswith("turn rate of all twists")
    assert TURN_RATE in no_speed
    assert SPEED not in no_speed


def test_a_robot_that_drives_straight_does_report_its_turn_rate() -> None:
    columns, notes = judge_rates(TIME_NS, drive(turned_rad=0.0, **{SPEED: SPEED_M_S}))

    assert TURN_RATE in columns
    assert notes == {}


@pytest.mark.parametrize("turned_rad", [0.0, 0.5])
def test_noise_of_the_heading_is_no_turn(turned_rad: float) -> None:
    poses = drive(turned_rad=turned_rad, **{SPEED: SPEED_M_S})
    poses["heading"] = poses["heading"] + np.random.default_rng(1).normal(0.0, 0.05, COUNT)

    columns, _ = judge_rates(TIME_NS, poses)

    assert (TURN_RATE in columns) is (turned_rad == 0.0)


def test_twists_along_the_axes_of_the_world_are_turned_into_the_robots() -> None:
    poses = drive(**{TURN_RATE: TURN_RAD_S})
    way_m_s = 4.0 / (TIME_NS[-1] / 1e9)
    poses[SPEED] = way_m_s * np.cos(poses["heading"])
    poses[LATERAL] = way_m_s * np.sin(poses["heading"])

    columns, notes = judge_rates(TIME_NS, poses)

    assert columns[SPEED] == pytest.approx(way_m_s)
    assert LATERAL not in columns
    assert "along the axes of the world" in notes["reported_rates"]


@pytest.mark.parametrize(("missing", "is_turned"), [(0.29, True), (0.30, False)])
def test_twists_are_turned_that_fit_the_worlds_axes_three_times_better(
    missing: float, *, is_turned: bool
) -> None:
    # Twists that are too short by a share of 1 m/s are as far from the way; turned by 60 degrees
    # they are (1 - (1 - share) + (1 - share)^2)^0.5 from it: 3.07 and 2.96 times as far.
    way_m, angle_rad = TIME_NS / 1e9, 0.5
    columns = {
        "x": way_m * np.cos(angle_rad),
        "y": way_m * np.sin(angle_rad),
        "heading": np.full(COUNT, np.pi / 3.0),
        SPEED: np.full(COUNT, (1.0 - missing) * np.cos(angle_rad)),
        LATERAL: np.full(COUNT, (1.0 - missing) * np.sin(angle_rad)),
    }

    _, notes = judge_rates(TIME_NS, columns)

    assert (notes != {}) is is_turned


def test_a_robot_that_moves_sideways_keeps_its_twists() -> None:
    poses = drive(turned_rad=0.0)
    angle_rad = 2.0  # it looks across its way
    along = {"heading": np.full(COUNT, angle_rad)}
    way_m_s = 4.0 / (TIME_NS[-1] / 1e9)
    along[SPEED] = np.full(COUNT, way_m_s * np.cos(angle_rad))
    along[LATERAL] = np.full(COUNT, -way_m_s * np.sin(angle_rad))

    columns, notes = judge_rates(TIME_NS, poses | along)

    assert (columns[SPEED] == along[SPEED]).all()
    assert notes == {}


def test_a_filter_without_rates_is_measured_by_its_poses() -> None:
    run = read_run(f"{find_shared('robots', 'sim_time')}:/odom_kf")

    assert run.poses.measured_speed_m_s is None
    assert run.poses.measured_turn_rate_rad_s is None
    assert "though the poses move" in run.notes["reported_rates"]
