"""Noise of poses: its size, and what rest and path are without it."""

from dataclasses import replace

import numpy as np
import pytest

import turtlelog as tl
from tests.measure.driven import Values, make_driven_run, publish
from tests.measure.driven_robots import read, tell
from turtlelog.measure.breaks import find_jumps
from turtlelog.measure.pose_noise import (
    find_dither_step,
    find_pose_resolution,
    find_scatter,
    measure_noise,
    measure_rate_noise,
)
from turtlelog.measure.pose_quality import describe_poses
from turtlelog.run import Origin, take_rows
from turtlelog.run.angles import wrap_angle

SMOOTH = "run.spectral_arc_length"
AT_10_HZ = np.arange(0.0, 100.0, 0.1)


def scatter(run: tl.Run, position_m: float, heading_rad: float = 0.0) -> tl.Run:
    random, poses = np.random.default_rng(1), run.poses
    xy_m = poses.xy_m + random.normal(0.0, position_m, poses.xy_m.shape)
    headings_rad = poses.heading_rad + random.normal(0.0, heading_rad, len(poses))
    return replace(run, poses=replace(poses, xy_m=xy_m, heading_rad=headings_rad))


def rest_half(time_s: Values = AT_10_HZ) -> tl.Run:
    way = np.minimum(time_s, 50.0) * 0.8
    return make_driven_run(time_s, speed=(np.zeros(len(time_s)), way))


@pytest.mark.parametrize(
    ("position_m", "heading_rad"),
    [(0.0, 0.0), (0.001, 0.0), (0.005, 0.005), (0.02, 0.01), (0.03, 0.0), (0.0, 0.04)],
)
def test_noise_does_not_hide_rest(position_m: float, heading_rad: float) -> None:
    run = scatter(rest_half(), position_m, heading_rad)
    assert read(run, "run.rest_share") == pytest.approx(0.5, abs=0.025)


@pytest.mark.parametrize(("position_m", "status"), [(0.03, "ok"), (0.05, "undetermined")])
def test_rest_has_no_value_if_noise_hides_it(position_m: float, status: str) -> None:
    assert tell(scatter(rest_half(), position_m), "run.rest_time")[0] == status


@pytest.mark.parametrize(("speed", "share"), [(0.005, 1.0), (0.018, 0.0)])
def test_noisy_rest_has_the_threshold_of_any_rest(speed: float, share: float) -> None:
    run = make_driven_run(AT_10_HZ, speed=(np.zeros(1000), speed * AT_10_HZ))
    assert read(scatter(run, 0.005), "run.rest_share") == pytest.approx(share, abs=0.06)


@pytest.mark.parametrize("noise_m", [0.0014, 0.0016, 0.0025, 0.004, 0.006])
def test_noisy_poses_each_second_show_driving_to_and_fro_and_rest(noise_m: float) -> None:
    time_s = np.arange(900.0) + np.random.default_rng(2).uniform(-0.2, 0.2, 900)
    way = 2.0 * np.abs(np.mod(0.05 * np.minimum(time_s, 600.0) + 1.0, 2.0) - 1.0)
    run = make_driven_run(time_s, speed=(np.zeros(900), way))
    assert read(scatter(run, noise_m), "run.rest_time") == pytest.approx(300.0, abs=6.0)


def test_noisy_poses_beside_gaps_show_no_rest_of_a_robot_that_drives_on() -> None:
    time_s = np.arange(0.0, 600.0, 0.05)
    time_s = time_s[np.mod(time_s, 20.0) > 4.0]
    xy_m = np.column_stack([2.0 * np.sin(0.2 * time_s), np.sin(0.4 * time_s)])
    run = rest_half(time_s)
    run = scatter(replace(run, poses=replace(run.poses, xy_m=xy_m)), 0.01)
    assert read(run, "run.rest_share") == 0.0


def test_the_size_of_noise_is_found_while_the_robot_turns() -> None:
    heading_rad = 0.5 * AT_10_HZ
    xy_m = np.column_stack([np.sin(heading_rad), -np.cos(heading_rad)])
    run = rest_half()
    turning = replace(run.poses, xy_m=xy_m, heading_rad=np.asarray(wrap_angle(heading_rad)))
    noisy = scatter(replace(run, poses=turning), 0.01, 0.005)
    found = measure_noise(noisy.poses)
    assert found.position_m == pytest.approx(0.01, rel=0.25)
    assert found.heading_rad == pytest.approx(0.005, rel=0.25)
    assert measure_rate_noise(noisy)[0] == pytest.approx(0.01 * 2**0.5 / 0.1, rel=0.25)


@pytest.mark.parametrize("is_course", [True, False])
def test_courses_that_scatter_slowly_are_noise_and_headings_may_not_be(*, is_course: bool) -> None:
    """A satellite receiver at 5 Hz scatters by 2 cm, on a circle of 20 m."""
    time_s = np.arange(0.0, 120.0, 0.2)
    xy_m = 20.0 * np.column_stack([np.sin(time_s / 20.0), 1.0 - np.cos(time_s / 20.0)])
    run = rest_half(time_s)
    run = scatter(replace(run, poses=replace(run.poses, xy_m=xy_m)), 0.02)
    x_m, y_m = np.diff(run.poses.xy_m[::3], axis=0).T
    course_rad = np.interp(time_s, time_s[::3][1:], np.unwrap(np.arctan2(y_m, x_m)))
    poses = replace(run.poses, heading_rad=wrap_angle(course_rad))
    run = replace(run, poses=poses, origin=Origin(has_courses=is_course))
    turning_rad = find_scatter(run).turning_rad
    assert (turning_rad is not None) is is_course
    assert turning_rad is None or turning_rad < np.abs(np.diff(course_rad)).sum() / 2.0


@pytest.mark.parametrize(
    ("noise_rad", "spin_rad_s", "told"),
    [(0.0, 6.0, None), (0.01, 0.0, "0.2 rad/s"), (0.01, 6.0, "0.2 rad/s"), (0.01, 12.0, None)],
)
def test_noise_of_turn_rates_is_told(noise_rad: float, spin_rad_s: float, told: str | None) -> None:
    time_s = np.arange(0.0, 60.0, 0.05)
    spin = np.where(time_s < 0.5, spin_rad_s, 0.0), spin_rad_s * np.minimum(time_s, 0.5)
    run = scatter(make_driven_run(time_s, turn=spin), 0.0, noise_rad)
    assert describe_poses(run, tl.measure_run(run)).get("rate_noise") == told


@pytest.mark.parametrize("period_s", [0.1, 0.2])
@pytest.mark.parametrize(
    ("along_m", "aside_m", "is_noise"), [(0.05, 0.05, True), (0.1, 0.0, False)]
)
def test_a_robot_that_drives_to_and_fro_has_no_noise(
    along_m: float, aside_m: float, period_s: float, *, is_noise: bool
) -> None:
    time_s = np.arange(0.0, 60.0, period_s)
    run = make_driven_run(time_s, speed=(np.zeros(len(time_s)), 0.3 * time_s))
    random = np.random.default_rng(2)
    off_m = random.normal(0.0, 1.0, (len(time_s), 2)) * np.array([along_m, aside_m])
    moved = replace(run, poses=replace(run.poses, xy_m=run.poses.xy_m + off_m))
    assert (find_scatter(moved).path_m is not None) is (is_noise or period_s < 0.15)


@pytest.mark.parametrize("jump_m", [0.0, 0.4, 2.0])
def test_a_relocalisation_is_no_noise(jump_m: float) -> None:
    time_s = np.arange(0.0, 22.0, 0.5)
    run = make_driven_run(time_s, speed=(np.zeros(44), np.minimum(0.4 * time_s, 6.0)))
    xy_m = run.poses.xy_m + np.where(time_s < 11.0, 0.0, jump_m)[:, None]
    run = replace(run, poses=replace(run.poses, xy_m=xy_m))
    assert measure_noise(run.poses).position_m < 1e-9
    assert read(run, "run.rest_time") == pytest.approx(7.0, abs=0.5)


@pytest.mark.parametrize("noise_m", [0.0, 0.01])
def test_a_marker_ahead_of_the_axle_has_only_its_noise(noise_m: float) -> None:
    time_s = np.arange(0.0, 40.0, 0.2)
    heading_rad = np.cumsum(np.where((time_s % 8.0 > 4.0) & (time_s % 8.0 < 5.2), 0.3, 0.0))
    poses = make_driven_run(time_s).poses
    xy_m = np.column_stack([np.cos(heading_rad), np.sin(heading_rad)])
    poses = replace(poses, xy_m=xy_m, heading_rad=wrap_angle(heading_rad))
    noise = measure_noise(scatter(replace(rest_half(time_s), poses=poses), noise_m).poses)
    assert noise.position_m == pytest.approx(noise_m, rel=0.3, abs=1e-9)


@pytest.mark.parametrize(("swing_rad", "hz"), [(0.1, 1.5), (0.3, 1.1)])
def test_a_robot_that_swings_at_slow_poses_turns_as_it_is_told(swing_rad: float, hz: float) -> None:
    """A wall follower with odometry at 5 Hz."""
    time_s = np.arange(0.0, 60.0, 0.2)
    heading_rad = swing_rad * np.sin(2.0 * np.pi * hz * time_s)
    run = make_driven_run(time_s, speed=(np.zeros(300), 0.2 * time_s), turn=(time_s, heading_rad))
    assert find_scatter(run).turning_rad is None


@pytest.mark.parametrize(("speed", "told"), [(0.001, True), (0.02, False), (0.0, False)])
@pytest.mark.parametrize("noise_m", [0.0, 0.0002])
def test_creeping_that_counts_as_rest_is_told(speed: float, noise_m: float, *, told: bool) -> None:
    run = make_driven_run(AT_10_HZ, speed=(np.zeros(1000), speed * AT_10_HZ))
    run = scatter(run, noise_m)
    metrics = tl.measure_run(run)
    crept = describe_poses(run, metrics).get("crept")
    assert (crept is not None) is told
    reason = tell(make_driven_run(AT_10_HZ, speed=(np.zeros(1000), 0.001 * AT_10_HZ)), SMOOTH)[1]
    assert reason == "it drives no faster than 0.001 m/s, which counts as rest"


@pytest.mark.parametrize("scale", [1e150, 1e200, 1e300])
def test_notes_on_poses_do_not_depend_on_their_size(scale: float) -> None:
    random = np.random.default_rng(3)
    xy_m = random.normal(size=(1000, 2))
    run = rest_half()
    small, large = (
        replace(run, poses=replace(run.poses, xy_m=factor * xy_m)) for factor in (1.0, scale)
    )
    assert find_scatter(large).path_m == pytest.approx(scale * (find_scatter(small).path_m or 0.0))
    assert measure_noise(large.poses).position_m > scale * 0.5
    assert describe_poses(large, tl.measure_run(large)).keys() >= {"path_without_scatter"}


def test_noise_hides_no_rest_of_a_robot_that_drives_on() -> None:
    run = make_driven_run(AT_10_HZ, speed=(np.zeros(1000), 0.5 * AT_10_HZ))
    assert read(scatter(run, 0.05), "run.rest_share") == 0.0


def test_a_robot_that_turns_to_and_fro_hides_no_rest() -> None:
    """At 5 Hz turning to and fro looks like noise of the heading."""
    time_s = np.arange(0.0, 60.0, 0.2)
    swing_rad = np.where(time_s < 50.0, 0.2 * np.sin(2.0 * np.pi * 1.5 * time_s), 0.0)
    way = 0.2 * np.minimum(time_s, 50.0)
    run = make_driven_run(time_s, speed=(time_s, way), turn=(time_s, swing_rad))
    assert read(run, "run.rest_time") == pytest.approx(10.0, abs=0.3)


def stop_and_go(
    hz: float = 100.0, *, step_m: float = 0.0, tick_m: float = 0.0, jump_m: float = 0.0
) -> tl.Run:
    """Return arcs with stops, rounded to `step_m` or seen by wheels that count ticks."""
    fine_s = np.arange(0.0, 62.0, 1e-3)
    is_on = np.mod(fine_s, 12.0) < 6.0
    asked = np.where(is_on, 0.5, 0.0), np.where(is_on, 0.3, 0.0)
    lag = np.exp(-np.arange(0.0, 1.0, 1e-3) / 0.1)
    speed, turn = (np.convolve(one, lag / lag.sum())[: len(fine_s)] for one in asked)
    way, angle = np.cumsum(speed) * 1e-3, np.cumsum(turn) * 1e-3
    way[(fine_s > 3.0).argmax() :] += jump_m
    rows = np.arange(0, 60_000, round(1e3 / hz))
    time_s, way, angle = fine_s[rows], way[rows], angle[rows]
    if tick_m:
        left, right = (np.rint((way + side * angle) / tick_m) * tick_m for side in (-0.08, 0.08))
        way, angle = (left + right) / 2.0, (right - left) / 0.16
    steps, mean = np.diff(way, prepend=0.0), angle - np.diff(angle, prepend=0.0) / 2.0
    xy_m = np.cumsum(np.column_stack([steps * np.cos(mean), steps * np.sin(mean)]), axis=0)
    if step_m:
        xy_m = np.rint(xy_m / step_m) * step_m
    at_s, values = publish(
        [(float(one), 0.5 * (one % 12.0 < 1.0)) for one in range(0, 60, 6)], 60.0
    )
    run = make_driven_run(time_s, commands=(at_s, values, 0.6 * values))
    poses = replace(
        run.poses,
        xy_m=xy_m,
        heading_rad=np.asarray(wrap_angle(angle)),
        measured_speed_m_s=steps * hz if tick_m else None,
        measured_turn_rate_rad_s=np.diff(angle, prepend=0.0) * hz if tick_m else None,
    )
    return replace(run, poses=poses)


@pytest.mark.parametrize(("hz", "step_m"), [(50.0, 0.001), (200.0, 0.001), (100.0, 0.01)])
def test_rounded_positions_jump_nowhere_and_rest(hz: float, step_m: float) -> None:
    run = stop_and_go(hz, step_m=step_m)
    assert find_pose_resolution(run) == pytest.approx((step_m, 0.0))
    assert find_jumps(run) == ()
    share = read(stop_and_go(hz), "run.rest_share")
    assert read(run, "run.rest_share") == pytest.approx(share, abs=0.02)


@pytest.mark.parametrize("every", ["alternate", "lost"])
def test_steps_of_other_durations_are_no_resolution(every: str) -> None:
    """One pose in ten is lost, or steps of 10 and 20 ms alternate."""
    run = stop_and_go(100.0)
    rows = np.arange(len(run.poses))
    is_kept = np.random.default_rng(1).random(len(rows)) > 0.1
    kept = rows[is_kept] if every == "lost" else rows[rows % 3 != 1]
    run = replace(run, poses=take_rows(run.poses, kept))
    assert find_pose_resolution(run) == (0.0, 0.0)


@pytest.mark.parametrize(("jump_m", "is_found"), [(0.0022, False), (0.0045, True)])
def test_a_jump_beyond_the_resolution_is_found(jump_m: float, *, is_found: bool) -> None:
    run = stop_and_go(step_m=0.001, jump_m=jump_m)
    assert [jump.row for jump in find_jumps(run)] == ([301] if is_found else [])
    assert len(find_jumps(stop_and_go(jump_m=jump_m))) == 1


def test_ticks_of_encoders_jump_nowhere_and_show_no_rise_time() -> None:
    run = stop_and_go(50.0, tick_m=0.002)
    assert find_pose_resolution(run) == pytest.approx((0.001, 0.0125), rel=1e-3)
    assert find_jumps(run) == ()
    assert tell(run, "run.turn_rate_rise_time")[0] == "undetermined"
    assert tell(stop_and_go(50.0, tick_m=0.00002), "run.turn_rate_rise_time")[0] == "ok"
    told = describe_poses(run, tl.measure_run(run))["resolution"]
    assert told == "1 mm (0.05 m/s over 20 ms) and 0.716 deg (0.625 rad/s over 20 ms)"


@pytest.mark.parametrize(("step_m", "is_told"), [(0.001, True), (0.0006, False)])
def test_a_resolution_is_told_from_3_percent_of_the_largest_rate(
    step_m: float, *, is_told: bool
) -> None:
    run = stop_and_go(20.0, step_m=step_m)
    assert ("resolution" in describe_poses(run, tl.measure_run(run))) is is_told


@pytest.mark.parametrize(("count", "step"), [(9, 0.0), (10, 0.01)])
def test_a_resolution_takes_ten_steps_there_and_back(count: int, step: float) -> None:
    steps = np.append(0.0, np.tile([0.01, 0.0, 0.0], count))
    assert find_dither_step(steps) == pytest.approx(step)


@pytest.mark.parametrize(("even", "step"), [(18, 0.01), (20, 0.0)])
def test_a_twentieth_of_the_steps_of_rounded_positions_dithers(even: int, step: float) -> None:
    steps = np.tile(np.append(np.full(even, 0.02), 0.03), 30)
    assert find_dither_step(np.append(steps, 0.02)) == pytest.approx(step, rel=1e-6)


@pytest.mark.parametrize(("off", "step"), [(9, 0.01), (11, 0.0)])
def test_nine_tenths_of_the_changes_are_multiples_of_the_resolution(off: int, step: float) -> None:
    steps = np.tile([0.02, 0.03], 101)[:-1]  # with 200 changes
    steps[3 : 3 + 2 * off : 2] += 0.0025  # changes two of them by a quarter of the resolution
    assert find_dither_step(steps) == pytest.approx(step)


def test_repeated_poses_have_no_resolution() -> None:
    time_s = np.arange(0.0, 60.0, 0.02)
    way = 0.3 * np.floor(time_s / 0.1 + 1e-6)
    assert find_pose_resolution(make_driven_run(time_s, speed=(way, way))) == (0.0, 0.0)
    stops = np.where(time_s % 4.0 < 2.0, 0.02, 0.055)  # at two rates it is a tick of 0.3 m
    coarse = 0.3 * np.floor(np.cumsum(stops) / 0.3)
    found = find_pose_resolution(make_driven_run(time_s, speed=(coarse, coarse)))
    assert found == pytest.approx((0.3, 0.0))


@pytest.mark.parametrize("start_m", [900.0, 999.0])
def test_the_coarsest_part_of_a_log_has_its_resolution(start_m: float) -> None:
    """Seven digits are 0.1 mm below 1 km, and 1 mm beyond."""
    run = stop_and_go()
    xy_m = run.poses.xy_m + np.array([start_m, 100.0])
    digits = np.where(xy_m < 1000.0, 1e-4, 1e-3)
    run = replace(run, poses=replace(run.poses, xy_m=np.rint(xy_m / digits) * digits))
    assert find_pose_resolution(run)[0] == pytest.approx(1e-4 if start_m < 990.0 else 1e-3)
    assert find_jumps(run) == ()


def swing(noise_m: float) -> tl.Run:
    """Return a robot at 20 Hz to and fro, whose way through medians is too short."""
    time_s = np.arange(0.0, 60.0, 0.05)
    angle = 1.2 * np.sin(1.3 * time_s)
    forth = np.abs((time_s % 2.0) - 1.0)
    run = make_driven_run(time_s, speed=(forth, 0.5 * forth), turn=(angle, angle))
    return scatter(run, noise_m)


@pytest.mark.parametrize(("noise_m", "is_noise"), [(0.005, False), (0.03, True)])
def test_a_path_to_and_fro_is_longer_than_through_medians_without_noise(
    noise_m: float, *, is_noise: bool
) -> None:
    """A robot that turns back each second is hardly moved by the noise of a small scatter."""
    assert (find_scatter(swing(noise_m)).path_m is not None) is is_noise


@pytest.mark.parametrize(("noise_m", "is_noisy"), [(0.0038, False), (0.0042, True)])
def test_headings_scatter_if_noise_makes_a_quarter_of_the_steps(
    noise_m: float, *, is_noisy: bool
) -> None:
    """At 10 Hz and 0.25 m/s."""
    run = make_driven_run(AT_10_HZ, speed=(AT_10_HZ, 0.25 * AT_10_HZ))
    run = scatter(run, noise_m, 0.02)
    heading_rad = run.poses.heading_rad + 0.03 * np.cumsum(np.ones(1000))
    run = replace(run, poses=replace(run.poses, heading_rad=np.asarray(wrap_angle(heading_rad))))
    assert find_scatter(run).path_m is None
    assert (find_scatter(run).turning_rad is not None) is is_noisy
