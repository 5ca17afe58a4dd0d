"""Rates, rest and lags of robots whose poses are missing, repeated or displaced for a while."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

import turtlelog as tl
from tests.measure.driven import make_driven_run
from tests.measure.driven_robots import AT_20_HZ, drive, read, tell
from turtlelog.measure.pose_quality import describe_poses
from turtlelog.run import take_rows


def keep(run: tl.Run, is_kept: NDArray[np.bool_]) -> tl.Run:
    return replace(run, poses=take_rows(run.poses, np.flatnonzero(is_kept)))


def hold(run: tl.Run, is_new: NDArray[np.bool_]) -> tl.Run:
    """Return a run whose poses repeat the last new one, as a log of another program's topic."""
    rows = np.maximum.accumulate(np.where(is_new, np.arange(len(is_new)), 0))
    poses = run.poses
    held = replace(poses, xy_m=poses.xy_m[rows], heading_rad=poses.heading_rad[rows])
    return replace(run, poses=held)


@pytest.mark.parametrize(("missing_s", "share"), [(4.0, 0.0), (0.15, 0.0)])
def test_time_without_poses_is_neither_rest_nor_motion(missing_s: float, share: float) -> None:
    """A robot circles, and is where it was after the gap."""
    way = 0.3 * AT_20_HZ - np.where(AT_20_HZ > 8.0, 0.3 * missing_s, 0.0)
    run = make_driven_run(AT_20_HZ, speed=(np.full(400, 0.3), way))
    cut = keep(run, (AT_20_HZ <= 8.0) | (8.0 + missing_s < AT_20_HZ))
    assert read(cut, "run.rest_share") == share
    lasts = missing_s > 4 * 0.05
    assert (read(cut, "run.measured_speed_mean") == pytest.approx(0.3, abs=1e-9)) is lasts


@pytest.mark.parametrize("reports", [False, True])
@pytest.mark.parametrize(
    ("name", "within"),
    [("run.speed_tracking_rms", 0.006), ("run.speed_lag", 0.01), ("run.measured_speed_max", 0.01)],
)
def test_a_gap_while_it_drives_changes_no_answer_to_commands(
    name: str, within: float, *, reports: bool
) -> None:
    whole = drive(reports=reports)
    cut = keep(whole, (AT_20_HZ < 10.0) | (AT_20_HZ > 15.5))
    assert read(cut, name) == pytest.approx(read(whole, name), abs=within)


def test_a_gap_that_spans_all_commands_leaves_no_tracking_error() -> None:
    cut = keep(drive(), (AT_20_HZ < 1.9) | (AT_20_HZ > 19.9))
    assert tell(cut, "run.speed_tracking_rms")[0] == "too_short"


@pytest.mark.parametrize(
    ("name", "within"),
    [
        ("run.measured_speed_max", 0.005),
        ("run.rest_time", 0.25),
        ("run.spectral_arc_length", 0.3),
        ("run.speed_tracking_rms", 0.03),
    ],
)
def test_repeated_poses_are_measured_where_they_change(name: str, within: float) -> None:
    time_s = np.arange(0.0, 20.0, 0.01)
    held = hold(drive(time_s), np.arange(len(time_s)) % 10 == 0)
    assert read(held, name) == pytest.approx(read(drive(time_s), name), abs=within)
    assert tl.measure.describe_breaks(held)["repeated"].endswith("they change at 10 Hz")


def test_a_robot_that_rests_repeats_no_poses() -> None:
    assert "repeated" not in tl.measure.describe_breaks(drive(lag_s=0.0))


@pytest.mark.parametrize(("aside_m", "rest_s"), [(0.0, 8.0), (2.0, 0.0)])
def test_a_repeated_pose_is_rest_unless_the_next_is_far(aside_m: float, rest_s: float) -> None:
    time_s = np.arange(0.0, 20.0, 0.01)
    way = 0.2 * np.where(time_s < 6.0, time_s, np.maximum(time_s - 8.0, 6.0))
    way = way + np.where(time_s > 14.0, aside_m, 0.0)
    run = make_driven_run(time_s, speed=(np.zeros(2000), way))
    held = hold(run, (np.arange(2000) % 10 == 0) & ((time_s < 6.05) | (time_s > 14.05)))
    assert read(held, "run.rest_time") == pytest.approx(rest_s, abs=0.25)
    assert read(held, "run.measured_speed_max") == pytest.approx(0.2, rel=0.01)


@pytest.mark.parametrize("leap_m", [0.5, 5.0])
def test_a_jump_is_no_speed(leap_m: float) -> None:
    run = drive()
    xy_m = run.poses.xy_m + np.where(AT_20_HZ < 9.0, 0.0, leap_m)[:, None]
    moved = replace(run, poses=replace(run.poses, xy_m=xy_m))
    assert read(moved, "run.measured_speed_max") == pytest.approx(0.4, abs=1e-3)
    for name in ("run.spectral_arc_length", "run.speed_tracking_rms"):
        assert read(moved, name) == pytest.approx(read(run, name), abs=0.3)


@pytest.mark.parametrize(("spread", "is_steady"), [(0, True), (1, False)])
def test_positions_at_a_rate_of_their_own_are_no_jumps(spread: int, *, is_steady: bool) -> None:
    """A receiver at 1 Hz beside a compass at 20 Hz; a robot that moves on now and then jumps."""
    every = np.arange(400)
    late = (spread * 9 * np.sin(every // 20)).astype(int)
    is_new = (every - late) % 20 == 0
    run = make_driven_run(
        AT_20_HZ,
        speed=(np.full(400, 0.8), 0.8 * AT_20_HZ),
        turn=(np.zeros(400), 0.01 * np.sin(every)),
    )
    rows = np.maximum.accumulate(np.where(is_new, every, 0))
    held = replace(run, poses=replace(run.poses, xy_m=run.poses.xy_m[rows]))
    assert (not tl.measure.find_jumps(held)) is is_steady
    fastest = read(held, "run.measured_speed_max")
    assert (fastest == pytest.approx(0.8, rel=0.01)) is is_steady


@pytest.mark.parametrize("hz", [10.0, 20.0, 25.0, 50.0, 100.0])
@pytest.mark.parametrize("reports", [False, True])
def test_lags_and_rise_times_are_known_to_the_resolution_that_is_told(
    hz: float, *, reports: bool
) -> None:
    """A robot without a time constant, whose commands are in step with its poses."""
    run = drive(np.arange(0.0, 20.0, 1.0 / hz), lag_s=0.0, dead_s=0.15, reports=reports)
    metrics = tl.measure_run(run)
    step_s = float(describe_poses(run, metrics)["rate_step"].removesuffix(" ms")) / 1e3
    assert step_s == pytest.approx(1.0 / hz if reports or hz <= 20.0 else 0.05, abs=0.011)
    lag_s, rise_s = metrics["run.speed_lag"].value, metrics["run.speed_rise_time"].value
    assert lag_s == pytest.approx(0.15, abs=0.51 * step_s)
    assert rise_s is not None
    assert 0.0 <= rise_s <= 2.0 * step_s + 1e-9
