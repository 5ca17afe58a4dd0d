"""How robots answer their commands, of which lags and overshoots are known in closed form."""

import math
from dataclasses import replace

import numpy as np
import pytest

import turtlelog as tl
from tests.measure.driven import make_driven_run, publish, respond
from tests.measure.driven_robots import AT_20_HZ, STEPS, drive, measure, read, tell
from turtlelog.measure.metrics.following import _SCATTER, _has_second
from turtlelog.measure.pose_quality import describe_poses


@pytest.mark.parametrize("axis", ["speed", "turn_rate"])
@pytest.mark.parametrize("hz", [5.0, 20.0, 62.5, 1000.0])
@pytest.mark.parametrize("reports", [True, False])
def test_a_first_order_lag_is_found(axis: str, hz: float, *, reports: bool) -> None:
    run = drive(np.arange(0.0, 20.0, 1.0 / hz), axis=axis, lag_s=0.2, dead_s=0.1, reports=reports)
    period_s = max(1.0 / hz, 0.05 if not reports else 0.0)
    lag_s, tau_s = 0.1 + 0.2 * math.log(2.0), 0.2
    assert read(run, f"run.{axis}_lag") == pytest.approx(lag_s, abs=0.01 + period_s / 3.0)
    assert read(run, f"run.{axis}_steps") == len(STEPS)
    rise_s = read(run, f"run.{axis}_rise_time")
    assert rise_s == pytest.approx(math.log(9.0) * tau_s, abs=0.005 + period_s**2 / tau_s)
    settled_s = 0.1 + math.log(20.0) * tau_s
    found_s = read(run, f"run.{axis}_settling_time")
    assert found_s == pytest.approx(settled_s, abs=0.005 + period_s / 2.0)
    assert read(run, f"run.{axis}_overshoot") == 0.0


def test_the_lag_of_a_pure_delay_is_the_delay_to_a_fraction_of_the_period() -> None:
    run = drive(lag_s=0.0, dead_s=0.123)
    assert read(run, "run.speed_lag") == pytest.approx(0.123, abs=1e-3)


def test_the_lag_does_not_depend_on_the_gain() -> None:
    run = drive(lag_s=0.1)
    halved = replace(run, poses=replace(run.poses, xy_m=run.poses.xy_m / 2.0))
    assert read(halved, "run.speed_lag") == pytest.approx(read(run, "run.speed_lag"), abs=1e-4)


def test_the_tracking_error_of_a_delayed_step_is_the_step_while_it_lasts() -> None:
    run = drive(steps=[(2.0, 0.3), (12.0, 0.3)], lag_s=0.0, dead_s=0.5)
    last_s = 19.9  # of the commands
    expected = 0.3 * math.sqrt(0.5 / (last_s - 2.0))
    assert read(run, "run.speed_tracking_rms") == pytest.approx(expected, rel=0.01)


def test_a_second_order_answer_has_its_overshoot() -> None:
    zeta, omega = 0.5, 6.0
    damped = omega * math.sqrt(1.0 - zeta**2)
    since_s = np.maximum(np.arange(0.0, 8.0, 0.01) - 2.0, 0.0)
    ring = np.cos(damped * since_s) + zeta * omega / damped * np.sin(damped * since_s)
    rate = 0.4 * (1.0 - np.exp(-zeta * omega * since_s) * ring)
    time_s = np.arange(0.0, 8.0, 0.01)
    way = np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2.0 * 0.01)])
    at_s, values = publish([(0.0, 0.0), (2.0, 0.4)], 8.0)
    commands = at_s, values, np.zeros(len(at_s))
    run = make_driven_run(time_s, speed=(rate, way), commands=commands, reports=True)
    overshoot = 100.0 * math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2))
    assert read(run, "run.speed_overshoot") == pytest.approx(overshoot, rel=0.01)


@pytest.mark.parametrize(("held_s", "count"), [(0.95, 0.0), (1.05, 1.0)])
def test_a_step_holds_for_a_second(held_s: float, count: float) -> None:
    run = drive(steps=[(0.0, 0.0), (2.0, 0.3), (2.0 + held_s, 0.1), (2.3 + held_s, 0.0)])
    assert read(run, "run.speed_steps") == count


@pytest.mark.parametrize(("held_s", "count"), [(0.45, 0.0), (0.55, 1.0)])
def test_what_a_step_leads_from_holds_for_half_a_second(held_s: float, count: float) -> None:
    ramp = [(1.0 + 0.05 * number, 0.01 * number) for number in range(1, 20)]
    run = drive(steps=[(0.0, 0.0), *ramp, (2.0, 0.2), (2.0 + held_s, 0.4)])
    assert read(run, "run.speed_steps") == count


@pytest.mark.parametrize(("size", "count"), [(0.036, 1.0), (0.044, 2.0)])
def test_a_step_is_a_tenth_of_the_largest_command(size: float, count: float) -> None:
    run = drive(steps=[(0.0, 0.0), (4.0, 0.4), (8.0, 0.4 - size)])
    assert read(run, "run.speed_steps") == count


def test_a_stick_makes_no_steps() -> None:
    beats = np.arange(0.0, 20.0, 0.1)
    stick = [(float(at), 0.2 + 0.1 * math.sin(at)) for at in beats]
    run = drive(steps=stick)
    assert read(run, "run.speed_steps") == 0.0
    reason = "no command is held for 1 s after one that was for 0.5 s"
    assert tell(run, "run.speed_rise_time") == ("no_step", reason)
    assert read(run, "run.speed_lag") == pytest.approx(0.05 + 0.1, abs=0.03)  # tau: it is slow


def describe_answers(run: tl.Run) -> dict[str, str]:
    return describe_poses(run, tl.measure_run(run))


@pytest.mark.parametrize(("lag_s", "is_short"), [(0.1, False), (0.9, True)])
def test_rise_times_of_steps_that_end_too_early_are_told(lag_s: float, *, is_short: bool) -> None:
    run = drive(np.arange(0.0, 20.0, 0.02), lag_s=lag_s, reports=True)
    short_s = math.log(9.0) * lag_s - read(run, "run.speed_rise_time")
    assert (short_s > 0.1) == is_short
    told = describe_answers(run).get("short_rises")
    assert told == ("speed by up to about 0.4 s" if is_short else None)
    assert short_s == pytest.approx(0.4 if is_short else 0.0, abs=0.15)


def test_noise_that_passes_the_end_of_a_rise_early_is_told() -> None:
    run = drive(np.arange(0.0, 20.0, 0.05), lag_s=0.3, noise_m=0.0005)
    assert read(run, "run.speed_rise_time") < 0.9 * math.log(9.0) * 0.3
    assert describe_answers(run)["short_rises"].startswith("speed by up to about 0.")


@pytest.mark.parametrize("stops", [True, False])
def test_a_silence_in_which_the_robot_stops_is_no_held_command(*, stops: bool) -> None:
    time_s = np.arange(0.0, 40.0, 0.02)
    starts_s = np.arange(2.0, 36.0, 4.0)
    bursts = np.concatenate([start + np.arange(0.0, 2.0, 0.1) for start in starts_s])
    values = np.repeat(np.resize([0.4, -0.3, 0.2], len(starts_s)), 20)
    commands = bursts, values, np.zeros(len(bursts))
    steps = [
        (float(start), float(value)) for start, value in zip(starts_s, values[::20], strict=True)
    ]
    ends = [(start + 2.4, 0.0) for start, _ in steps]  # by a watchdog of 0.5 s
    driven = respond(time_s, sorted([*steps, *ends]) if stops else steps, 0.1, 0.05)
    run = make_driven_run(time_s, speed=driven, commands=commands, reports=True)
    assert read(run, "run.speed_lag") == pytest.approx(0.05 + 0.1 * math.log(2.0), abs=0.02)
    assert read(run, "run.speed_rise_time") == pytest.approx(math.log(9.0) * 0.1, abs=0.01)
    told = describe_answers(run).get("silences")
    assert told == ("8 silences of the commands, 16 s in all" if stops else None)


def test_a_robot_that_still_speeds_up_in_a_silence_does_not_stop() -> None:
    """A program that pauses after each step of a slow robot is no watchdog."""
    time_s = np.arange(0.0, 60.0, 0.02)
    steps = [(float(start), 0.5) for start in np.arange(2.0, 54.0, 8.0)]
    steps += [(start + 4.0, 0.0) for start, _ in steps]
    sent_s = np.concatenate(
        [[start, *(start + 0.7 + np.arange(0.0, 3.3, 0.1))] for start, _ in sorted(steps)]
    )
    values = np.repeat([value for _, value in sorted(steps)], 34)
    driven = respond(time_s, sorted(steps), 1.2, 0.05)
    commands = sent_s, values, np.zeros(len(sent_s))
    run = make_driven_run(time_s, speed=driven, commands=commands, reports=True)
    assert "silences" not in describe_answers(run)


def test_commands_that_add_up_to_nearly_nothing_are_one() -> None:
    steps = [(2.0, 0.3), (4.0, 0.3 + 1e-12), (6.0, 1e-17), (7.0, 0.0)]
    assert read(drive(steps=steps), "run.speed_steps") == 2.0


@pytest.mark.parametrize("name", ["tracking_rms", "lag", "steps", "rise_time", "overshoot"])
def test_without_commands_nothing_follows(name: str) -> None:
    run = make_driven_run(AT_20_HZ, speed=respond(AT_20_HZ, STEPS, 0.1))
    assert tell(run, f"run.speed_{name}") == ("absent", "the recording holds no commands")


def test_two_poses_have_a_rate_and_no_lag() -> None:
    run = drive(np.array([0.0, 4.0]), steps=[(-1.0, 0.5), (3.0, 0.5)], lag_s=0.0, dead_s=0.0)
    assert read(run, "run.measured_speed_max") == pytest.approx(0.5)
    assert tell(run, "run.speed_lag")[0] == "too_short"


def test_commands_that_never_change_tell_no_lag() -> None:
    run = drive(steps=[(0.0, 0.2), (10.0, 0.2)])
    reason = "the commands do not change: nothing shows how late the robot follows"
    assert tell(run, "run.speed_lag") == ("undetermined", reason)


def test_commands_that_repeat_themselves_tell_no_lag() -> None:
    """From before the first pose on, so that nothing shows where they begin."""
    beats = np.arange(-5.0, 20.0, 0.1)
    wave = [(float(at), 0.2 + 0.1 * math.sin(2.0 * math.pi * at)) for at in beats]
    reason = "several shifts fit alike: the commands repeat themselves"
    assert tell(drive(steps=wave), "run.speed_lag") == ("undetermined", reason)


@pytest.mark.parametrize(
    ("correlations", "repeats"),
    [
        ([0.2, 1.0, 0.89, 0.96], True),
        ([0.2, 1.0, 0.89, 0.94], False),
        ([0.2, 1.0, 0.91, 0.96], False),
        ([0.96, 0.89, 1.0, 0.2], True),
    ],
)
def test_a_second_shift_is_as_good_and_behind_a_valley(
    correlations: list[float], *, repeats: bool
) -> None:
    found = np.array(correlations)
    assert _has_second(found, int(found.argmax())) == repeats


@pytest.mark.parametrize(
    ("dead_s", "is_known"), [(1.95, True), (2.05, False), (-0.45, True), (-0.55, False)]
)
def test_a_lag_is_looked_for_from_half_a_second_before_to_two_after(
    dead_s: float, *, is_known: bool
) -> None:
    metric = measure(drive(lag_s=0.0, dead_s=dead_s), "run.speed_lag")
    if is_known:
        assert metric.value == pytest.approx(dead_s, abs=2e-3)
    else:
        assert metric.reason == "no shift from -0.5 to 2 s fits best"


@pytest.mark.parametrize(("gain", "answers"), [(0.52, True), (0.48, False)])
def test_a_step_is_answered_by_half_of_it(gain: float, *, answers: bool) -> None:
    at_s, values = publish(STEPS, 20.0)
    rate, way = respond(AT_20_HZ, STEPS, 0.1)
    run = make_driven_run(
        AT_20_HZ,
        speed=(gain * rate, gain * way),
        commands=(at_s, values, np.zeros(len(at_s))),
    )
    assert (measure(run, "run.speed_rise_time").value is not None) == answers


@pytest.mark.parametrize(("share", "is_seen"), [(0.19, True), (0.21, False)])
def test_settling_is_not_seen_in_wide_scatter(share: float, *, is_seen: bool) -> None:
    run = drive(steps=[(2.0, 0.4), (10.0, 0.0)], reports=True)
    measured = run.poses.measured_speed_m_s
    assert measured is not None
    off = 0.4 * share / _SCATTER * np.tile([1.0, -1.0], len(measured) // 2)
    poses = replace(run.poses, measured_speed_m_s=measured + off)
    found = measure(replace(run, poses=poses), "run.speed_settling_time")
    assert (found.value is not None) == is_seen


@pytest.mark.parametrize(("share", "is_seen"), [(0.39, True), (0.43, False)])
def test_a_rise_is_not_seen_if_the_rate_scatters_before_it(share: float, *, is_seen: bool) -> None:
    run = drive(steps=[(2.0, 0.4)], reports=True)
    measured = run.poses.measured_speed_m_s
    assert measured is not None
    off = 0.4 * share / _SCATTER * np.tile([1.0, -1.0], len(measured) // 2)
    before = np.where(AT_20_HZ < 2.0, measured + off, measured)
    poses = replace(run.poses, measured_speed_m_s=before)
    found = measure(replace(run, poses=poses), "run.speed_rise_time")
    assert (found.value is not None) == is_seen


@pytest.mark.parametrize(("finest", "is_seen"), [(0.036, True), (0.044, False)])
def test_a_rise_is_not_seen_if_the_rate_is_coarser_than_a_tenth(
    finest: float, *, is_seen: bool
) -> None:
    run = drive(steps=[(2.0, 0.4)], reports=True)
    measured = run.poses.measured_speed_m_s
    assert measured is not None
    ticks = np.diff(np.floor(np.cumsum(np.append(0.0, measured + 0.3 * finest)) / finest)) * finest
    poses = replace(run.poses, measured_speed_m_s=ticks)
    found = measure(replace(run, poses=poses), "run.speed_rise_time")
    assert (found.value is not None) == is_seen


def test_a_robot_that_does_not_listen_tells_no_lag() -> None:
    at_s, values = publish(STEPS, 20.0)
    other = [(3.1, 0.3), (4.4, 0.1), (9.7, 0.2), (12.3, 0.4), (15.9, 0.1)]
    run = make_driven_run(
        AT_20_HZ,
        speed=respond(AT_20_HZ, other, 0.1),
        commands=(at_s, values, np.zeros(len(at_s))),
    )
    reason = "the motion does not change as the commands do"
    assert tell(run, "run.speed_lag") == ("undetermined", reason)


def test_a_robot_that_turns_the_other_way_is_told_from_one_that_does_not_listen() -> None:
    run = drive(axis="turn_rate")
    other = replace(run.commands, turn_rate_rad_s=-run.commands.turn_rate_rad_s)
    reason = "the motion changes against the commands: the signs of one are reversed"
    reversed_run = replace(run, commands=other)
    assert tell(reversed_run, "run.turn_rate_lag") == ("undetermined", reason)


def test_a_robot_that_stands_answers_no_step() -> None:
    at_s, values = publish(STEPS, 20.0)
    run = make_driven_run(AT_20_HZ, commands=(at_s, values, np.zeros(len(at_s))))
    reason = "the robot does not do half of any step of its commands while it is held"
    assert tell(run, "run.speed_rise_time") == ("not_reached", reason)
    assert read(run, "run.rest_share") == 1.0


@pytest.mark.parametrize(("hz", "is_seen"), [(5.0, True), (4.97, True), (4.9, False)])
def test_a_rise_takes_five_poses_a_second(hz: float, *, is_seen: bool) -> None:
    run = drive(np.arange(0.0, 20.0, 1.0 / hz), lag_s=0.3)
    metric = measure(run, "run.speed_rise_time")
    assert (metric.value is not None) == is_seen
    assert is_seen or metric.reason == "poses at 4.9 Hz, and it takes 5 Hz"


def test_commands_at_1_hz_are_held() -> None:
    often, seldom = drive(hz=10.0), drive(hz=1.0)
    assert read(seldom, "run.speed_lag") == pytest.approx(read(often, "run.speed_lag"), abs=0.01)
    assert read(seldom, "run.speed_steps") == len(STEPS)


def test_a_step_within_a_gap_of_the_poses_is_not_judged() -> None:
    kept = AT_20_HZ[(AT_20_HZ < 7.8) | (AT_20_HZ > 8.4)]
    run = drive(kept, steps=[(0.0, 0.0), (8.0, 0.4)])
    assert read(run, "run.speed_steps") == 1.0
    assert tell(run, "run.speed_rise_time")[0] == "not_reached"


def test_commands_outside_the_poses_make_no_steps() -> None:
    early = drive(steps=[(-3.0, 0.2), (10.0, 0.0)])
    assert read(early, "run.speed_steps") == 1.0
    late = make_driven_run(
        AT_20_HZ, commands=(np.array([30.0, 32.0]), np.array([0.1, 0.3]), np.zeros(2))
    )
    assert read(late, "run.speed_steps") == 0.0
    assert tell(late, "run.speed_lag")[0] == "too_short"


@pytest.mark.parametrize(("noise_m", "status"), [(1e-3, "undetermined"), (2e-4, "ok")])
def test_where_noise_hides_the_answer_it_is_said(noise_m: float, status: str) -> None:
    assert tell(drive(noise_m=noise_m), "run.speed_settling_time")[0] == status
