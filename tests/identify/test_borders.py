"""What counts and what does not: a case on each side of each border."""

from copy import copy
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import turtlelog as tl
from tests.identify.robots import Log, build_run, make_run
from tests.identify.test_drift import drive
from tests.known import known
from turtlelog.cli.identify import format_robot
from turtlelog.identify import AxisModel, Estimate
from turtlelog.identify.axis_fit import fit_axis
from turtlelog.identify.axis_motion import MEMORY_S, read_axis_motion
from turtlelog.identify.fit_values import cover_parts, describe_fit
from turtlelog.identify.refused_axes import refuse_begun
from turtlelog.identify.robot_noise import find_outlying_steps
from turtlelog.identify.silent_stops import find_silent_stops

find_stops = partial(find_silent_stops, memory_s=MEMORY_S)

QUIET = Log(duration_s=12.0, jitter_s=0.0)


def _format(model: tl.RobotModel) -> str:
    text = format_robot(model, [Path("a")], shows_details=True)
    return " ".join(text.split())


def turn_at(rate: NDArray[np.float64], time_s: NDArray[np.float64]) -> tl.Run:
    """Return a robot on the spot with these rates, commanded to turn from 2 s on."""
    heading = np.concatenate([[0.0], np.cumsum(rate[:-1] * np.diff(time_s))])
    commands = np.array([2.0, 4.0]), np.zeros(2), np.array([1.0, -1.0])
    return build_run(time_s, np.zeros((len(time_s), 2)), heading, commands)


@pytest.mark.parametrize(("size", "count"), [(7.9, 0), (8.1, 1)])
def test_an_outlier_is_further_off_than_noise_can_be(size: float, count: int) -> None:
    noise = np.tile([1.0, -1.0], 50)
    assert np.count_nonzero(find_outlying_steps(np.append(noise, size * 1.4826))) == count


@pytest.mark.parametrize(("size", "count"), [(7.9, 0), (8.1, 1)])
def test_rounding_of_poses_that_a_rest_does_not_show_is_no_outlier(size: float, count: int) -> None:
    residual = np.append(np.zeros(50), size * 2.0**0.5 * 1e-7)
    assert np.count_nonzero(find_outlying_steps(residual, 1e-7)) == count


def test_an_interval_from_poses_of_32_bits_contains_the_truth() -> None:
    keys = {"law.kp_linear": 2.0, "law.kp_angular": 2.0}
    run = tl.simulate_run(tl.override_scenario(tl.load_scenario("lagged"), keys))
    axis = tl.identify_robot(run).turn_rate
    for found, truth in ((axis.gain, 1.0), (axis.dead_time_s, 0.08), (axis.lag_s, 0.1)):
        assert known(found).low <= truth <= known(found).high
    assert known(axis.gain).high - known(axis.gain).low < 0.02


@pytest.mark.parametrize(("rounded", "is_doubted"), [(0.45, True), (0.55, False)])
def test_parts_of_a_motion_may_differ_by_rounding(rounded: float, *, is_doubted: bool) -> None:
    """The rate of a robot rises by a tenth halfway, which no model explains."""
    time_s = np.arange(0.0, 12.0, 0.05)
    rate = np.where(time_s < 7.0, 1.0, 1.2) * ((time_s >= 2.0) & (time_s < 10.0))
    rate += np.random.default_rng(1).normal(0.0, 1e-3, len(time_s))
    fit = fit_axis([read_axis_motion(turn_at(np.asarray(rate, float), time_s), "turn_rate")])
    whitening = copy(fit.whitening)
    whitening.noise = replace(whitening.noise, rounded=rounded)
    found = cover_parts(describe_fit("turn_rate", fit, 0), replace(fit, whitening=whitening))
    assert bool(found.doubts) is is_doubted


@pytest.mark.parametrize("seed", [0, 1, 4])
def test_a_log_without_time_constant_shows_that_it_is_short(seed: int) -> None:
    """The best time constant is 0, or 5 ms, or 0.5 ms: only longer ones show what is too long."""
    run = drive({"plant.turn_dead_time_s": 0.34, "plant.turn_lag_s": 0.0})
    noise = np.random.default_rng(seed).normal(0.0, 1e-3, len(run.poses))
    run = replace(run, poses=replace(run.poses, heading_rad=run.poses.heading_rad + noise))
    found = describe_fit("turn_rate", fit_axis([read_axis_motion(run, "turn_rate")]), 0)
    assert known(found.lag_s).low == 0.0
    assert known(found.lag_s).high < 0.01
    assert known(found.dead_time_s).low > 0.33
    assert known(found.dead_time_s).high >= 0.34


@pytest.mark.parametrize(("apart_s", "is_sparse"), [(0.36, False), (0.44, True)])
def test_advice_for_sparse_poses_is_to_record_more(apart_s: float, *, is_sparse: bool) -> None:
    time_s = np.arange(0.0, 12.0, apart_s)
    rate = np.where((time_s >= 2.0) & (time_s < 10.0), 1.0, 0.0)
    advice = tl.identify_robot(turn_at(rate, time_s)).turn_rate.advice
    assert ("record poses at most 0.4 s apart, and step the turn rate" in advice) is is_sparse


def test_of_residuals_of_zero_none_is_an_outlier() -> None:
    assert not find_outlying_steps(np.array([0.0, 0.0, 0.0, 1.0])).any()


@pytest.mark.parametrize(("gap_s", "steps"), [(0.99, 1), (1.01, 0)])
def test_a_long_step_hides_what_happened_in_it(gap_s: float, steps: int) -> None:
    time_s = np.concatenate([np.arange(0.0, 3.0, 0.05), 2.95 + gap_s + np.arange(0.0, 2.0, 0.05)])
    motion = read_axis_motion(turn_at(np.where(time_s > 2.0, 1.0, 0.0), time_s), "turn_rate")
    assert np.count_nonzero(motion.duration_s > 0.5) == steps


@pytest.mark.parametrize(("apart_s", "poses"), [(0.9e-3, 0), (1.1e-3, 1)])
def test_of_two_poses_at_once_the_later_one_is_left_out(apart_s: float, poses: int) -> None:
    time_s = np.sort(np.append(np.arange(0.0, 6.0, 0.05), 3.0 + apart_s))
    motion = read_axis_motion(turn_at(np.where(time_s > 2.0, 1.0, 0.0), time_s), "turn_rate")
    assert np.count_nonzero(motion.duration_s < 0.01) == poses


@pytest.mark.parametrize("start_s", [0.0, 2.0])
@pytest.mark.parametrize(("rate", "begins_s"), [(0.019, 2.0), (0.021, 5.0)])
def test_a_robot_that_moves_before_its_first_command_is_not_known_yet(
    rate: float, begins_s: float, start_s: float
) -> None:
    """A recording that starts with the commands has one step that shows it."""
    time_s = np.arange(start_s, 8.0, 0.05)
    moving = time_s >= max(2.0, start_s + 0.04)
    motion = read_axis_motion(turn_at(np.where(moving, 1.0, rate), time_s), "turn_rate")
    assert motion.time_s[motion.first[0]] == pytest.approx(begins_s, abs=0.06)


@pytest.mark.parametrize(
    ("ahead", "back", "begins_s"), [(71, 50, 2.0), (72, 49, 5.0), (5, 3, 2.0), (4, 3, 5.0)]
)
def test_a_robot_rests_before_its_first_command_if_its_way_is_noise(
    ahead: int, back: int, begins_s: float
) -> None:
    """A sum of 21 unit steps of 121 has 1.9 standard deviations; seven steps show no scatter."""
    apart_s = 2.0 / (ahead + back)
    time_s = np.arange(0.0, 8.0, apart_s)
    rate = np.where(np.arange(len(time_s)) < ahead, 1.0, -1.0)
    rate[ahead + back :] = 1.0
    motion = read_axis_motion(turn_at(rate, time_s), "turn_rate")
    assert motion.time_s[motion.first[0]] == pytest.approx(begins_s, abs=1.1 * apart_s)


@pytest.mark.parametrize(("change_s", "refusal"), [(4.98, "begun"), (5.02, None)])
def test_a_command_must_change_after_unseen_commands_have_faded(
    change_s: float, refusal: str | None
) -> None:
    time_s = np.arange(2.0, 10.0, 0.05)
    run = turn_at(np.where(time_s < change_s, 1.0, -1.0), time_s)
    times_ns = np.rint(np.array([2.0, change_s]) * 1e9).astype(np.int64)
    run = replace(run, commands=replace(run.commands, time_ns=times_ns))
    motions = [read_axis_motion(run, "turn_rate")]
    refused = refuse_begun([run], motions, "turn_rate")
    assert (refused and refused.refusal) == refusal


def test_a_closed_loop_shows_the_gain_from_its_first_pose_on_and_nothing_without_it() -> None:
    """Two identifications."""
    keys = {"law.kp_angular": 3.0, "law.kp_linear": 2.0, "goal.x_m": 5.0, "goal.y_m": 9.0}
    run = tl.simulate_run(tl.override_scenario(tl.load_scenario("lagged"), keys))
    axis = tl.identify_robot(run).turn_rate
    assert known(axis.gain).value == pytest.approx(1.0, abs=1e-4)
    assert known(axis.dead_time_s).value == pytest.approx(0.08, abs=1e-4)
    late = tl.identify_robot(run.slice(0.4)).turn_rate
    told = "earlier commands may act in the first 3 s, and after that the commanded turn rate does"
    assert told in late.reason
    assert late.advice.startswith("begin to record while the robot rests, and step the turn rate")


@pytest.mark.parametrize(("silence_s", "stops"), [(0.68, 0), (0.75, 1)])
def test_a_silence_must_be_long_to_be_a_stop(silence_s: float, stops: int) -> None:
    time_s = np.arange(0.0, 4.0, 0.01)
    moved = np.where(time_s[:-1] < 1.25, 0.01, 0.0)
    command_s = np.array([0.0, 0.5, 1.0, 1.0 + silence_s, 2.0, 2.5, 3.0, 3.5])
    command = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    found = find_stops(command_s, command, time_s, moved)
    assert len(found) == stops
    assert all(stop.stop_s == pytest.approx(1.25, abs=0.06) for stop in found)


@pytest.mark.parametrize(
    ("silence_s", "wait_s", "stops"),
    [
        *((0.49, 0.75, 0), (0.52, 0.75, 1), (1.38, 0.75, 1), (1.47, 0.75, 0)),
        *((0.62, 1.0, 0), (0.72, 1.0, 1)),
    ],
)
def test_silences_as_long_as_that_of_a_known_stop_may_hide_another(
    silence_s: float, wait_s: float, stops: int
) -> None:
    # Commanded again and again, the robot stops after the last command at 3 s.
    time_s = np.arange(0.0, 6.0, 0.01)
    moved = np.where(time_s[:-1] < 3.0 + wait_s, 0.01, 0.0)
    later_s = np.arange(1.0 + silence_s, 2.95, 0.2)
    command_s = np.array([*np.arange(0.0, 1.01, 0.2), *later_s, 3.0])
    found = find_stops(command_s, np.ones(len(command_s)), time_s, moved)
    assert [stop.is_seen for stop in found] == [False] * stops + [True]
    assert found[-1].stop_s == pytest.approx(3.0 + wait_s, abs=0.06)
    assert all(stop.stop_s < 1.0 + silence_s < stop.end_s for stop in found[:-1])


@pytest.mark.parametrize(("share", "stops"), [(0.05, 1), (0.2, 0)])
def test_a_robot_that_still_moves_has_not_stopped(share: float, stops: int) -> None:
    time_s = np.arange(0.0, 4.0, 0.01)
    moved = np.where(time_s[:-1] < 1.5, 0.01, share * 0.01)
    found = find_stops(np.array([0.0]), np.array([1.0]), time_s, moved)
    assert len(found) == stops


@pytest.mark.parametrize(("share", "stops"), [(0.24, 1), (0.26, 0)])
def test_a_robot_that_follows_a_slow_command_has_not_stopped(share: float, stops: int) -> None:
    # Before the slow command it was fast: what is left is little of that.
    time_s = np.arange(0.0, 4.0, 0.01)
    moved = 0.01 * np.where(time_s[:-1] < 1.2, 1.0, share * 0.05)
    command = np.array([1.0, 0.05])
    found = find_stops(np.array([0.0, 1.0]), command, time_s, moved)
    assert len([stop for stop in found if stop.begin_s == 1.0]) == stops


def test_noise_of_poses_does_not_hide_that_a_slow_robot_stops() -> None:
    time_s = np.arange(0.0, 4.0, 0.05)
    for seed in range(20):
        noise_m = np.random.default_rng(seed).normal(0.0, 2e-4, len(time_s))
        way_m = 0.036 * np.minimum(time_s, 1.5) + noise_m
        found = find_stops(np.array([0.0]), np.array([0.04]), time_s, np.diff(way_m))
        assert [stop.stop_s for stop in found] == pytest.approx([1.5], abs=0.11)


@pytest.mark.parametrize(("steps", "status"), [(49, "not_identifiable"), (50, "ok")])
def test_few_steps_tell_nothing(steps: int, status: str) -> None:
    time_s = np.arange(0.0, 10.0, 0.05)
    rate = np.where(time_s > 2.2, 1.0, 0.0) * np.where(time_s > 4.2, -1.0, 1.0)
    run = turn_at(rate, time_s)
    begins_s = read_axis_motion(run, "turn_rate").time_s
    cut = run.slice(end_s=float(begins_s[steps]) + 1e-3)
    cut = replace(cut, commands=run.commands)
    assert len(read_axis_motion(cut, "turn_rate").moved) == steps
    found = tl.identify_robot(cut).turn_rate
    assert found.status == status
    assert status == "ok" or "expected at least 50 steps" in found.reason


def test_of_a_long_log_a_part_is_used_and_said(monkeypatch: pytest.MonkeyPatch) -> None:
    run = make_run(QUIET, 1)
    whole = tl.identify_robot(run)
    assert whole.notes == ()
    used = whole.turn_rate.steps
    for most, notes in ((used, 0), (used - 1, 1)):
        monkeypatch.setattr("turtlelog.identify.robot_identification.MOST_STEPS", most)
        found = tl.identify_robot(run)
        told = [note for note in found.notes if f"of {used} steps" in note and "turn" in note]
        assert len(told) == notes


def test_a_short_delay_known_within_a_step_is_a_value() -> None:
    time_s = np.arange(0.0, 8.0, 0.05)
    rate = np.where(time_s > 2.0 - 1e-9, 1.0, 0.0) - np.where(time_s > 4.0 - 1e-9, 2.0, 0.0)
    noise = np.random.default_rng(1).normal(0.0, 1e-3, len(time_s))
    run = turn_at(rate, time_s)
    heading = np.clip(run.poses.heading_rad + noise, -3.1, 3.1)
    seen = replace(run.poses, heading_rad=heading)
    found = tl.identify_robot(replace(run, poses=seen)).turn_rate
    assert found.status == "ok"
    assert known(found.dead_time_s).low == 0.0


def say_axis(explained: float, whiteness: float) -> str:
    value = Estimate(value=1.0, low=0.9, high=1.1)
    axis = AxisModel(
        axis="speed",
        status="ok",
        gain=value,
        dead_time_s=value,
        lag_s=value,
        total_delay_s=value,
        explained=explained,
        whiteness=whiteness,
    )
    turns = AxisModel(axis="turn_rate", status="not_identifiable", reason="x", advice="y")
    return _format(tl.RobotModel(files=("a",), speed=axis, turn_rate=turns))


@pytest.mark.parametrize(
    ("product_s2", "told"),
    [
        (0.0099, "the time constant is the sum of two, whose product is 0.0099 s^2"),
        (0.0100, "with two time constants of about 100 ms"),
        (0.0101, "oscillates: its damping ratio is 1.00"),
        (0.0400, "oscillates: its damping ratio is 0.50"),
    ],
)
def test_a_second_order_oscillates_only_if_its_interval_says_so(
    product_s2: float, told: str
) -> None:
    value = Estimate(value=0.2, low=0.19, high=0.21)
    product = Estimate(value=product_s2, low=product_s2 - 5e-5, high=product_s2 + 5e-5, unit="s^2")
    axis = AxisModel(
        axis="speed",
        status="ok",
        model="second_order",
        gain=value,
        lag_s=value,
        lag_product_s2=product,
        explained=0.9,
    )
    turns = AxisModel(axis="turn_rate", status="not_identifiable", reason="x", advice="y")
    model = tl.RobotModel(files=("a",), speed=axis, turn_rate=turns)
    assert told in _format(model)


def test_the_text_says_what_the_residual_shows() -> None:
    little, curve = "Most changes of the motion do not follow", "The rest is a curve, not noise"
    for explained, whiteness in ((0.51, 0.51), (0.49, 0.51), (0.51, 0.49)):
        text = say_axis(explained, whiteness)
        assert (little in text, curve in text) == (explained < 0.5, whiteness < 0.5)
