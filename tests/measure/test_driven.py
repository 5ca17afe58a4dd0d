"""Metrics of motion and commands, held against robots whose answers are known in closed form."""

import math
from dataclasses import replace

import numpy as np
import pytest

import turtlelog as tl
from tests.measure.driven import make_driven_run, respond
from tests.measure.driven_robots import AT_20_HZ, drive, measure, read, tell
from turtlelog.measure import Status
from turtlelog.measure.metrics.travel import compute_spectral_arc_length
from turtlelog.measure.pose_quality import describe_poses
from turtlelog.measure.rates import read_rates, thin_poses
from turtlelog.measure.signals import sign_speeds
from turtlelog.run.angles import wrap_angle


def test_an_arc_is_as_long_as_it_is_and_turns_as_far() -> None:
    angle = 0.3 * np.arange(0.0, 30.0, 0.05)  # past a full turn: headings wrap
    run = make_driven_run(AT_20_HZ)
    run = replace(
        run,
        poses=replace(
            run.poses,
            time_ns=np.arange(len(angle)) * 50_000_000,
            xy_m=np.column_stack([2.0 * np.sin(angle), 2.0 - 2.0 * np.cos(angle)]),
            heading_rad=np.asarray(wrap_angle(angle)),
        ),
    )
    assert read(run, "run.path_length") == pytest.approx(2.0 * angle[-1], rel=1e-5)
    assert read(run, "run.total_turning") == pytest.approx(math.degrees(angle[-1]))
    assert read(run, "run.net_displacement") == pytest.approx(4.0 * abs(math.sin(angle[-1] / 2.0)))
    assert read(run, "run.measured_speed_max") == pytest.approx(0.6, rel=1e-4)
    assert read(run, "run.measured_turn_rate_mean") == pytest.approx(0.3)


@pytest.mark.parametrize("reports", [True, False])
def test_a_sinusoidal_speed_has_its_peak_and_mean(*, reports: bool) -> None:
    phase = 2.0 * np.pi * AT_20_HZ / 4.0
    way = 0.5 * 4.0 / (2.0 * np.pi) * (1.0 - np.cos(phase))
    run = make_driven_run(AT_20_HZ, speed=(0.5 * np.sin(phase), way), reports=reports)
    assert read(run, "run.measured_speed_max") == pytest.approx(0.5, rel=2e-3)
    assert read(run, "run.measured_speed_mean") == pytest.approx(1.0 / np.pi, rel=5e-3)


def test_driving_backwards_is_a_negative_rate_and_a_positive_largest() -> None:
    run = drive(steps=[(2.0, -0.2), (10.0, 0.0)])
    rates = read_rates(run, "speed")
    assert rates is not None
    assert rates.values.min() == pytest.approx(-0.2)
    assert read(run, "run.measured_speed_max") == pytest.approx(0.2)
    assert read(run, "run.speed_lag") == pytest.approx(0.05 + 0.1 * math.log(2.0), abs=0.02)


@pytest.mark.parametrize(("back_s", "is_signed"), [(0.8, False), (1.2, True), (10.0, True)])
@pytest.mark.parametrize("noise_m", [0.0, 0.002])
def test_speeds_without_a_sign_get_that_of_the_poses(
    back_s: float, noise_m: float, *, is_signed: bool
) -> None:
    """Twenty seconds are driven; where a twentieth leads back, nothing is told from noise."""
    speed = 0.5 * np.where(back_s > AT_20_HZ, -1.0, 1.0)
    way = np.cumsum(speed) * 0.05
    run = make_driven_run(AT_20_HZ, speed=(np.abs(speed), way), reports=True, noise_m=noise_m)
    rates = read_rates(run, "speed")
    assert rates is not None
    assert np.count_nonzero(rates.values < 0.0) == pytest.approx(20 * back_s * is_signed, abs=2)


@pytest.mark.parametrize("noise_m", [0.005, 0.02, 0.5])
def test_noise_gives_reported_speeds_no_sign(noise_m: float) -> None:
    speed = (np.full(400, 0.02), 0.02 * AT_20_HZ)
    assert (
        sign_speeds(make_driven_run(AT_20_HZ, speed=speed, reports=True, noise_m=noise_m)) is None
    )


@pytest.mark.parametrize(("goal_m", "has_line"), [(0.0, False), (0.19, False), (0.21, True)])
def test_no_line_leads_to_a_goal_at_the_start_of_laps(goal_m: float, *, has_line: bool) -> None:
    way = 1.0 - np.cos(0.1 * np.pi * np.append(AT_20_HZ, 20.0))
    time_s = np.append(AT_20_HZ, 20.0)
    run = make_driven_run(time_s, speed=(np.zeros(401), way), goal_xy_m=(0.0, goal_m))
    assert (run.goal_line is not None) is has_line
    for name in ("run.cross_track_max", "run.cross_track_rms", "final.cross_track"):
        assert tell(run, name)[0] == ("ok" if has_line else "absent")
        assert has_line or "where the robot starts" in tell(run, name)[1]


@pytest.mark.parametrize(("apart_m", "status"), [(2e-6, "no_motion"), (6e-6, "ok")])
def test_a_closed_loop_has_no_straightness(apart_m: float, status: str) -> None:
    way = 1.0 - np.cos(0.1 * np.pi * AT_20_HZ)
    way[-1] = apart_m
    run = make_driven_run(AT_20_HZ, speed=(np.zeros(400), way))
    assert tell(run, "run.straightness")[0] == status


def test_turtlesim_reports_what_it_applied_with_the_sign_of_the_motion() -> None:
    run = drive(steps=[(2.0, -0.2), (10.0, 0.0)], reports=True)
    poses = run.poses
    assert poses.measured_speed_m_s is not None
    applied = replace(
        poses,
        speed_m_s=np.abs(poses.measured_speed_m_s),
        turn_rate_rad_s=poses.measured_turn_rate_rad_s,
        measured_speed_m_s=None,
        measured_turn_rate_rad_s=None,
    )
    rates = read_rates(replace(run, poses=applied), "speed")
    assert rates is not None
    assert rates.values == pytest.approx(poses.measured_speed_m_s, abs=1e-12)


def test_one_pose_moves_nowhere() -> None:
    run = drive(AT_20_HZ[:1])
    metrics = tl.measure_run(run)
    for name in ("run.measured_speed_max", "run.rest_share", "run.speed_lag", "run.speed_steps"):
        assert (metrics[name].status, metrics[name].reason) == (Status.TOO_SHORT, "1 pose")
    assert metrics["run.net_displacement"].value == 0.0


@pytest.mark.parametrize(("hz", "is_seen"), [(5.1, True), (5.0, True), (4.97, True), (4.9, False)])
def test_smoothness_takes_five_poses_a_second(hz: float, *, is_seen: bool) -> None:
    found = measure(drive(np.arange(0.0, 20.0, 1.0 / hz)), "run.spectral_arc_length")
    assert (found.status is Status.TOO_SHORT) != is_seen
    assert is_seen or found.reason == "poses at 4.9 Hz, and it takes 5 Hz"


def test_poses_at_1_hz_still_tell_how_far_and_how_fast() -> None:
    run = drive(np.arange(0.0, 20.0, 1.0))
    assert read(run, "run.path_length") == pytest.approx(read(drive(), "run.path_length"), rel=0.02)
    assert read(run, "run.measured_speed_max") == pytest.approx(0.4, rel=0.01)
    assert tell(run, "run.spectral_arc_length")[0] == "too_short"


def test_a_single_wrong_rate_is_left_out_of_the_largest() -> None:
    run = drive(reports=True)
    rates = np.array(run.poses.measured_speed_m_s)
    rates[200] = -143.6
    broken = replace(run, poses=replace(run.poses, measured_speed_m_s=rates))
    assert read(broken, "run.measured_speed_max") == pytest.approx(0.4, abs=1e-6)
    found = read_rates(broken, "speed")
    assert found is not None
    assert found.outliers == 1


def test_two_poses_at_nearly_one_time_make_no_rate() -> None:
    time_s = np.sort(np.append(AT_20_HZ, 9.0001))
    run = drive(time_s, noise_m=1e-3)
    assert read(run, "run.measured_speed_max") < 0.6  # 1 mm over 0.1 ms is 10 m/s


@pytest.mark.parametrize(
    ("name", "within"),
    [
        ("run.speed_lag", 0.003),
        ("run.speed_rise_time", 0.03),
        ("run.speed_settling_time", 0.04),
        ("run.spectral_arc_length", 0.05),
        ("run.rest_time", 0.2),
        ("run.speed_tracking_rms", 0.002),
    ],
)
def test_a_noisy_copy_changes_little(name: str, within: float) -> None:
    noisy = drive(noise_m=2e-4)
    assert read(noisy, name) == pytest.approx(read(drive(), name), abs=within)


@pytest.mark.parametrize(("noise_m", "status"), [(5e-3, "undetermined"), (1e-3, "ok")])
def test_where_noise_reaches_the_threshold_there_is_no_smoothness(
    noise_m: float, status: str
) -> None:
    assert tell(drive(noise_m=noise_m), "run.spectral_arc_length")[0] == status


@pytest.mark.parametrize(("speed", "share"), [(0.009, 1.0), (0.011, 0.0)])
def test_what_is_slower_than_a_centimetre_a_second_stands(speed: float, share: float) -> None:
    run = make_driven_run(AT_20_HZ, speed=(np.full(400, speed), speed * AT_20_HZ))
    assert read(run, "run.rest_share") == share


@pytest.mark.parametrize(("rate", "share"), [(0.018, 1.0), (0.022, 0.0)])
def test_what_turns_slower_than_a_degree_a_second_stands(rate: float, share: float) -> None:
    run = make_driven_run(AT_20_HZ, turn=(np.full(400, rate), rate * AT_20_HZ))
    assert read(run, "run.rest_share") == share


@pytest.mark.parametrize(("stop_s", "is_known"), [(0.24, True), (0.26, False)])
def test_rest_between_poses_of_a_robot_that_moved_is_not_guessed(
    stop_s: float, *, is_known: bool
) -> None:
    """Localisation publishes after a quarter of a metre; each fifth leg ends with a stop."""
    legs_s = np.tile([0.25, 0.25, 0.25, 0.25, 0.25 + stop_s], 20)
    is_stop = legs_s > 0.25
    time_s = np.append(0.0, np.cumsum(legs_s))
    way_m = 0.25 * np.arange(len(time_s), dtype=np.float64)
    run = make_driven_run(time_s, speed=(np.zeros(len(time_s)), way_m))
    status, reason = tell(run, "run.rest_time")
    assert (status == "ok") is is_known
    assert is_known or reason.endswith(f"up to {stop_s * is_stop.sum():.2g} s of rest")


@pytest.mark.parametrize("step_s", [0.01, 0.02, 0.05])
@pytest.mark.parametrize(("size_m", "size_rad"), [(0.0025, 0.0), (0.0, 0.005)])
def test_what_swings_beyond_the_threshold_does_not_rest(
    size_m: float, size_rad: float, step_s: float
) -> None:
    """At 2 Hz it is back at its place after half a second."""
    time_s = np.arange(0.0, 20.0, step_s)
    for share, rests in ((0.95, 1.0), (1.1, 0.0)):
        side = share * np.cos(4.0 * np.pi * time_s)
        run = make_driven_run(time_s, speed=(side, size_m * side), turn=(side, size_rad * side))
        assert read(run, "run.rest_share") == rests


def test_rest_reaches_up_to_its_edges() -> None:
    run = drive(steps=[(5.0, 0.3), (10.0, 0.0)], lag_s=0.0, dead_s=0.0)
    assert read(run, "run.rest_time") == pytest.approx(14.95, abs=0.1)


def test_a_minimum_jerk_movement_is_as_smooth_as_can_be() -> None:
    share = np.linspace(0.0, 1.0, 101)
    bell = 30.0 * share**2 * (1.0 - share) ** 2
    found = compute_spectral_arc_length(bell, 100.0)
    assert found == pytest.approx(-1.41, abs=0.01)  # as in the paper: -1.41
    twice = compute_spectral_arc_length(np.concatenate([bell, bell]), 100.0)
    assert found is not None
    assert twice is not None
    assert twice < found


def test_a_longer_rest_around_a_movement_changes_no_smoothness() -> None:
    share = np.linspace(0.0, 1.0, 101)
    bell = 30.0 * share**2 * (1.0 - share) ** 2
    padded = np.concatenate([np.zeros(150), bell, np.zeros(150)])
    found = compute_spectral_arc_length(padded, 100.0)
    assert found == pytest.approx(compute_spectral_arc_length(bell, 100.0), abs=0.01)


@pytest.mark.parametrize(("tolerance_m", "at_s"), [(0.1, 9.0), (0.01, 9.9)])
def test_the_goal_is_reached_within_a_distance_in_metres(tolerance_m: float, at_s: float) -> None:
    way = np.minimum(np.arange(0.0, 20.0, 0.05) * 0.1, 1.0)
    run = make_driven_run(AT_20_HZ, speed=(np.zeros(400), way), goal_xy_m=(1.0, 0.0))
    metric = measure(run, "run.time_to_goal", goal_tolerance_m=tolerance_m)
    assert metric.value == pytest.approx(at_s, abs=0.01)
    short = replace(run, goal_xy_m=(1.2, 0.0))
    metric = measure(short, "run.time_to_goal", goal_tolerance_m=tolerance_m)
    assert metric.reason == f"the run ends further from the goal than {tolerance_m:g} m"


def test_turtlesim_stops_a_second_after_its_last_command() -> None:
    """Another robot goes on: nobody knows for how long."""
    asked = [(2.0, 0.5), (3.0, 0.0), (8.0, 0.3), (9.0, 0.0)]
    at_s, values = np.array([2.0, 8.0]), np.array([0.5, 0.3])
    run = make_driven_run(
        AT_20_HZ,
        speed=respond(AT_20_HZ, asked, 0.0),
        commands=(at_s, values, np.zeros(2)),
        reports=True,
    )
    assert read(run, "run.speed_tracking_rms") > 0.4
    poses = run.poses
    applied = replace(
        poses,
        speed_m_s=poses.measured_speed_m_s,
        turn_rate_rad_s=poses.measured_turn_rate_rad_s,
        measured_speed_m_s=None,
        measured_turn_rate_rad_s=None,
    )
    turtle = replace(run, poses=applied)
    assert read(turtle, "run.speed_tracking_rms") == pytest.approx(0.0, abs=1e-6)
    assert read(turtle, "run.speed_lag") == pytest.approx(0.0, abs=1e-3)
    assert read(turtle, "run.speed_steps") == 3.0  # the last stop is held for no time


def test_poses_that_had_one_time_in_their_file_are_not_differenced() -> None:
    time_ns = np.arange(200) // 2 * 100_000_000
    time_ns[1::2] += 1  # as they are moved on where they are read
    rows = thin_poses(time_ns)
    assert rows.tolist() == list(range(0, 200, 2))


@pytest.mark.parametrize(
    ("quantum_m", "rise", "settling"),
    # At 20 Hz a quantum of 5 mm is one of 0.1 m/s: of the response a third. 1 mm is 7 % of it.
    [
        (0.0, "ok", "ok"),
        (0.0005, "ok", "ok"),
        (0.001, "ok", "undetermined"),
        (0.005, "undetermined", "undetermined"),
    ],
)
def test_what_quantised_poses_cannot_show_has_no_value(
    quantum_m: float, rise: str, settling: str
) -> None:
    run = drive(steps=[(0.0, 0.0), (4.0, 0.3), (8.0, 0.0), (12.0, 0.3)], lag_s=0.2, dead_s=0.15)
    if quantum_m:
        xy_m = np.round(run.poses.xy_m / quantum_m) * quantum_m
        run = replace(run, poses=replace(run.poses, xy_m=xy_m))
    found = [measure(run, f"run.speed_{name}_time") for name in ("rise", "settling")]
    assert [metric.status for metric in found] == [rise, settling]
    for metric, truth_s in zip(
        found, (math.log(9.0) * 0.2, 0.15 + math.log(20.0) * 0.2), strict=True
    ):
        # To two poses.
        assert metric.value is None or abs(metric.value - truth_s) < 0.1


def test_a_robot_that_drives_sideways_is_not_said_to_stand() -> None:
    run = drive()
    aside = replace(run.poses, xy_m=run.poses.xy_m[:, ::-1].copy())
    found = measure(replace(run, poses=aside), "run.spectral_arc_length")
    assert (found.value, found.reason) == (None, "the robot does not drive forward or back")


@pytest.mark.parametrize("silent_s", [0.02, 3.0])
def test_the_time_from_the_last_pose_to_the_last_command_is_without_poses(silent_s: float) -> None:
    end_s = float(AT_20_HZ[-1])
    commands = np.array([0.0, end_s + silent_s]), np.zeros(2), np.zeros(2)
    run = make_driven_run(AT_20_HZ, speed=(AT_20_HZ * 0.0, AT_20_HZ * 0.0), commands=commands)
    gap = tl.measure_run(run)["run.largest_pose_gap"]
    assert gap.value == pytest.approx(max(silent_s, 0.05))


@pytest.mark.parametrize(("late_s", "is_told"), [(0.02, False), (0.03, True), (0.3, True)])
def test_a_motion_before_its_commands_is_told(late_s: float, *, is_told: bool) -> None:
    steps = [(2.0 + at_s, 0.3 * (at_s % 4.0 == 0.0)) for at_s in np.arange(0.0, 16.0, 2.0).tolist()]
    moved = respond(AT_20_HZ, steps, 0.0)
    at_s, speeds = (np.array(one) for one in zip(*steps, strict=True))
    run = make_driven_run(
        AT_20_HZ, speed=moved, reports=True, commands=(at_s + late_s, speeds, 0.0 * speeds)
    )
    metrics = tl.measure_run(run)
    assert metrics["run.speed_lag"].value == pytest.approx(-late_s, abs=0.03)
    assert ("leads" in describe_poses(run, metrics)) is is_told
    reason = tl.identify_robot(run).speed.reason
    assert late_s < 0.1 or "the motion may lead the commands" in reason
