"""Robots of known truth, by a simulator that shares no code with the fit."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

import turtlelog as tl
from tests.identify.robots import Log, Truth, draw_log, make_run, respond, turn_with_limit
from tests.identify.scores import (
    PARAMETERS,
    Score,
    identify_logs,
    score_limited,
    score_models,
    score_robots,
)
from tests.identify.whole_way import fit_whole_way
from tests.known import known
from turtlelog.identify import AxisModel
from turtlelog.identify.axis_motion import AXES, Axis, read_axis_motion
from turtlelog.run import CommandColumns
from turtlelog.run.columns import take_rows

ROBOTS = 100
NOISE_M = 2e-4
"""The noise at which the error of the dead time is claimed [m]."""


def step_up(truth: Truth, since_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return rate and way after a step of the command by 1, shape (2, n)."""
    one, other = truth.lag_s, truth.second_lag_s
    since_s = np.maximum(since_s - truth.dead_time_s, 0.0)
    if not one:
        return truth.gain * np.array([since_s > 0.0, since_s])
    kept = [lag * np.exp(-since_s / lag) if lag else 0.0 * since_s for lag in (one, other)]
    rate = 1.0 - (kept[0] - kept[1]) / (one - other)
    way = since_s - one - other + (one * kept[0] - other * kept[1]) / (one - other)
    return truth.gain * np.array([rate, way])


@pytest.mark.parametrize("lags_s", [(0.0, 0.0), (0.2, 0.0), (1e-4, 0.0), (0.3, 0.15)])
def test_the_robots_answer_the_sum_of_the_responses_to_single_steps(
    lags_s: tuple[float, float],
) -> None:
    truth = Truth(gain=0.9, dead_time_s=0.1, lag_s=lags_s[0], second_lag_s=lags_s[1])
    at_s, by = np.array([1.0, 1.05, 1.7, 4.0]), np.array([0.5, -1.2, 0.9, 0.3])
    time_s = np.linspace(0.013, 6.0, 333)
    alone = [
        step_up(truth, time_s - begin_s) * size for begin_s, size in zip(at_s, by, strict=True)
    ]
    np.testing.assert_allclose(respond(truth, time_s, (at_s, by)), sum(alone), atol=1e-13)


@cache
def identify_all() -> list[tuple[Log, tl.Run, tl.RobotModel]]:
    return [*identify_logs((seed, draw_log(seed, duration_s=25.0)) for seed in range(ROBOTS))]


@cache
def score_all() -> Score:
    return score_models(identify_all())


@pytest.mark.thorough
@pytest.mark.parametrize("name", PARAMETERS)
def test_intervals_of_95_percent_hold_the_truth_and_are_not_padded(name: str) -> None:
    """A share of 95 % shows in many robots: the first of these tests identifies them all."""
    assert 0.90 <= score_all().find_coverage(name) <= 0.995


@pytest.mark.thorough
def test_hardly_any_well_excited_axis_is_refused() -> None:
    score = score_all()
    assert score.axes == 2 * ROBOTS
    assert score.refused <= 0.05 * score.axes


@pytest.mark.thorough
def test_the_dead_time_is_found_within_two_milliseconds() -> None:
    """The first of these tests identifies all robots of first order."""
    assert score_all().find_median_error("dead_time_s", 1.5 * NOISE_M) < 2e-3


@pytest.mark.thorough
def test_robots_of_first_order_get_no_second() -> None:
    assert score_all().of_second_order <= 0.01 * score_all().axes


@pytest.mark.thorough
@pytest.mark.parametrize("name", PARAMETERS)
def test_intervals_hold_where_there_is_no_dead_time_or_no_lag(name: str) -> None:
    """The first of these tests identifies all robots at the borders."""
    assert score_edges().find_coverage(name) >= 0.90


@pytest.mark.thorough
def test_intervals_hold_the_dead_time_in_a_closed_loop_whose_robot_slips() -> None:
    """40 runs are identified; the commands follow the noise."""
    holds = []
    for seed in range(40):
        keys = {"seed": seed, "goal.x_m": 2.0 + 0.1 * seed, "loop.start_backlog": 10}
        keys |= {"disturbance.noise_speed": 0.01, "disturbance.noise_turn_rate": 0.02}
        keys |= {"law.kp_angular": 1.5, "plant.turn_gain": 0.9}
        run = tl.simulate_run(tl.override_scenario(tl.load_scenario("lagged"), keys))
        delays = [axis.dead_time_s for axis in tl.identify_robot(run).axes if axis.dead_time_s]
        holds += [delay.low <= 0.08 <= delay.high for delay in delays]
    assert len(holds) >= 78
    assert np.mean(holds) >= 0.88  # 72 of 79; 57 if only each error alone is the larger one


@cache
def score_edges() -> Score:
    return score_robots((seed, draw_log(seed, 25.0, at_edge=True)) for seed in range(20))


@pytest.mark.thorough
def test_a_fit_of_the_whole_way_agrees_on_all_robots() -> None:
    """All robots are fitted once more, in another way."""
    apart, is_nearer = (
        {axis: np.array([pair[row] for pair in compare_with_whole_way(axis)]) for axis in AXES}
        for row in (0, 1)
    )
    assert apart["turn_rate"].shape == apart["speed"].shape == (ROBOTS, 4)
    assert apart["turn_rate"].max() <= 1.0
    # Headings that are off bend the whole way of the speed, but not its steps: intervals of the way
    # hold for 86 % of these values, intervals of the steps for 97 %.
    assert np.mean((apart["speed"] <= 1.0) | is_nearer["speed"]) >= 0.99
    assert apart["speed"].max() <= 1.6


@cache
def compare_with_whole_way(axis: Axis) -> list[tuple[list[float], list[bool]]]:
    """Return how far both fits are apart, as shares of what their intervals allow.

    The second of each pair is whether the fit of steps is nearer to the truth, and its interval
    holds it.
    """
    compared = []
    for log, run, model in identify_all():
        values, halves = fit_whole_way(run, axis)
        found = [known(getattr(getattr(model, axis), name)) for name in PARAMETERS]
        truth: Truth = getattr(log, axis)
        dead_time_s = truth.dead_time_s + log.least_transport_s
        true = truth.gain, dead_time_s, truth.lag_s, dead_time_s + truth.lag_s
        apart = [
            abs(value - one.value) / np.hypot(half, one.high - one.value)
            for one, value, half in zip(found, values, halves, strict=True)
        ]
        is_nearer = [
            abs(one.value - its) < abs(value - its) and one.low <= its <= one.high
            for one, value, its in zip(found, values, true, strict=True)
        ]
        compared.append((apart, is_nearer))
    return compared


TWO_LAGS = Truth(gain=0.9, dead_time_s=0.1, lag_s=0.3, second_lag_s=0.15)


def test_a_second_lag_is_found_where_there_is_one() -> None:
    found = tl.identify_robot(make_run(Log(turn_rate=TWO_LAGS, duration_s=40.0), 1)).turn_rate
    assert found.model == "second_order"
    assert known(found.lag_s).value == pytest.approx(0.45, abs=5e-3)
    assert known(found.lag_product_s2).value == pytest.approx(0.045, abs=2e-3)
    assert known(found.dead_time_s).value == pytest.approx(0.1, abs=5e-3)


def test_a_limit_of_the_acceleration_is_found_where_there_is_one() -> None:
    truth = Truth(dead_time_s=0.1, lag_s=0.05)
    found = tl.identify_robot(turn_with_limit(truth, Log(duration_s=30.0), 3.0, seed=2)).turn_rate
    assert known(found.rate_limit).value == pytest.approx(3.0, rel=0.01)
    assert known(found.total_delay_s).value == pytest.approx(0.15, abs=5e-3)


def identify_turns(command: NDArray[np.float64], log: Log, seed: int = 3) -> AxisModel:
    time_s = np.arange(0.5, log.duration_s, 0.05)
    still = time_s, np.zeros(len(time_s))
    return tl.identify_robot(make_run(log, seed, speed=still, turn=(time_s, command))).turn_rate


SHORT = Log(duration_s=30.0)


@pytest.mark.thorough
@pytest.mark.parametrize("name", [*PARAMETERS, "rate_limit"])
def test_intervals_hold_the_truth_of_robots_whose_acceleration_is_limited(name: str) -> None:
    """The first of these tests identifies 16 robots with one unknown more."""
    score = score_all_limited()
    assert (score.axes, score.refused, score.of_second_order) == (16, 0, 16)
    assert score.find_coverage(name) >= 0.85  # 14 of 16; stairs instead of ramps had 13


@cache
def score_all_limited() -> Score:
    return score_limited(range(16))


def test_an_axis_that_is_never_commanded_has_no_value() -> None:
    run = make_run(SHORT, 1)
    still = replace(run.commands, speed_m_s=np.zeros(len(run.commands)))
    model = tl.identify_robot(replace(run, commands=still))
    assert model.speed.status == "not_identifiable"
    assert model.speed.reason == "the speed is never commanded"
    assert (model.speed.refusal, model.speed.is_idle) == ("never_commanded", True)
    assert model.speed.advice == "step the speed ten times for 2 s"
    assert model.turn_rate.status == "ok"
    assert all(getattr(model.speed, name) is None for name in PARAMETERS)


def test_a_command_that_never_changes_tells_nothing() -> None:
    found = identify_turns(np.full(590, 0.5), SHORT)
    assert found.reason == "the commanded turn rate never changes"


@pytest.mark.parametrize(("ramp_s", "status"), [(2.2, "not_identifiable"), (1.8, "ok")])
def test_slow_ramps_tell_nothing(ramp_s: float, status: str) -> None:
    time_s = np.arange(0.5, 30.0, 0.05)
    command = np.abs((time_s / ramp_s + 1.0) % 2.0 - 1.0)
    command = np.where(time_s < 1.0, 0.0, command - command[time_s >= 1.0][0])
    found = identify_turns(command, SHORT)
    assert found.status == status
    assert status == "ok" or "in ramps: within 0.1 s it changes by at most" in found.reason


def test_a_robot_that_does_not_follow_has_no_value() -> None:
    still = Truth(gain=0.0)
    model = tl.identify_robot(make_run(Log(speed=still, turn_rate=still, duration_s=30.0), 1))
    assert [axis.status for axis in model.axes] == ["not_identifiable"] * 2


@pytest.mark.everyday("log0")
@pytest.mark.parametrize("log", [SHORT, replace(SHORT, noise_rad=5e-3, poses_hz=12.0)])
def test_a_robot_that_turns_the_wrong_way_round_is_told_so(log: Log) -> None:
    swapped = Truth(gain=-0.9, dead_time_s=0.12, lag_s=0.2)
    model = tl.identify_robot(make_run(replace(log, turn_rate=swapped), 3))
    assert model.speed.is_known
    reason = "the turn rate follows its commands with the opposite sign: gain -0.9"
    assert model.turn_rate.reason.startswith(reason)
    assert model.turn_rate.advice.endswith("its left and its right motor may be swapped")


@pytest.mark.thorough
def test_what_follows_no_command_has_no_opposite_sign() -> None:
    """Several robots are identified, each on both axes."""
    for seed, truth in enumerate([Truth(gain=0.0)] * 2 + [Truth(dead_time_s=1.7)] * 2):
        model = tl.identify_robot(make_run(replace(SHORT, speed=truth, turn_rate=truth), seed))
        assert not any(axis.is_known or "opposite" in axis.reason for axis in model.axes)


def test_headings_that_are_wrong_wherever_they_wrap_do_not_count() -> None:
    # So many headings beside the wrap that wrong steps are more than one in a hundred.
    log = replace(draw_log(1001), wrap_faults=True)
    found = tl.identify_robot(make_run(log, 1001)).turn_rate
    assert found.outliers > 0.01 * found.steps
    dead_time_s = known(found.dead_time_s)
    assert dead_time_s.low <= log.turn_rate.dead_time_s <= dead_time_s.high


def test_a_wide_interval_is_no_value() -> None:
    noisy = Log(duration_s=10.0, noise_m=0.1, noise_rad=1.0)
    model = tl.identify_robot(make_run(noisy, 1))
    assert [axis.status for axis in model.axes] == ["not_identifiable"] * 2


def test_a_dead_time_beyond_the_largest_has_no_value() -> None:
    late = Truth(dead_time_s=1.7, lag_s=0.1)
    model = tl.identify_robot(make_run(Log(turn_rate=late, duration_s=40.0), 1))
    assert "the best dead time is the largest that is tried, 1.5 s" in model.turn_rate.reason
    in_time = Truth(dead_time_s=1.4, lag_s=0.1)
    model = tl.identify_robot(make_run(Log(turn_rate=in_time, duration_s=40.0), 1))
    assert known(model.turn_rate.dead_time_s).value == pytest.approx(1.4, abs=2e-3)


def test_runs_of_one_robot_are_fitted_together() -> None:
    runs = [make_run(SHORT, seed, name=f"run{seed}") for seed in (1, 2)]
    together, alone = tl.identify_robot(runs), tl.identify_robot(runs[0])
    widths = [known(found.turn_rate.gain) for found in (together, alone)]
    assert widths[0].high - widths[0].low < widths[1].high - widths[1].low
    assert together.files == ("run1", "run2")
    assert together.notes == ()


@pytest.mark.thorough
def test_what_differs_between_runs_is_told() -> None:
    slower = Log(duration_s=30.0, turn_rate=Truth(gain=0.9))
    runs = [make_run(SHORT, 1, name="new"), make_run(slower, 2, name="worn")]
    notes = tl.identify_robot(runs).notes
    assert any("differs from all runs together in the turn rate: gain 0.9" in n for n in notes)


def test_jumps_are_outliers_and_told() -> None:
    model = tl.identify_robot(make_run(Log(duration_s=30.0, jumps=2), 4))
    assert model.turn_rate.outliers == 2
    assert {event.axis for event in model.events} == {"speed", "turn_rate"}
    assert known(model.turn_rate.dead_time_s).value == pytest.approx(0.1, abs=2e-3)


@pytest.mark.parametrize(("share", "is_told"), [(5e-4, False), (2e-3, True)])
def test_outliers_of_rounding_are_not_told(share: float, *, is_told: bool) -> None:
    run = make_run(Log(duration_s=30.0, noise_m=0.0, noise_rad=0.0, jitter_s=0.0), 4)
    heading_rad = run.poses.heading_rad.copy()
    largest_rad = np.abs(np.diff(np.unwrap(heading_rad))).max()
    heading_rad[400:] += share * largest_rad
    moved = replace(run, poses=replace(run.poses, heading_rad=heading_rad))
    model = tl.identify_robot(moved)
    assert model.turn_rate.outliers > 0
    assert any(event.axis == "turn_rate" for event in model.events) is is_told


def test_what_the_correlation_says_lies_near_dead_time_and_lag() -> None:
    found = tl.identify_robot(make_run(Log(duration_s=40.0), 5)).turn_rate
    delay_s = known(found.correlation_delay_s)
    assert delay_s.value == pytest.approx(0.2, abs=0.05)
    assert delay_s.low <= delay_s.value <= delay_s.high <= delay_s.low + delay_s.value


def stop_by_itself(wait_s: float, silence_s: float, truth: Truth = SHORT.turn_rate) -> tl.Run:
    """Return a robot that stops some time after the last command; of that no command tells."""
    log = replace(SHORT, turn_rate=truth)
    begins_s = np.arange(1.0, 28.0, 1.0 + silence_s)
    sent_s = begins_s[:, None] + np.arange(0.0, 1.0, 0.05)
    turns = np.repeat(np.linspace(-1.5, 1.5, len(begins_s)), sent_s.shape[1])
    heard_s = np.column_stack([sent_s, sent_s[:, -1] + wait_s]).ravel()
    obeyed = np.column_stack([turns.reshape(sent_s.shape), 0.0 * begins_s]).ravel()
    run = make_run(log, 1, speed=(heard_s, 0.0 * heard_s), turn=(heard_s, obeyed))
    commands = CommandColumns(
        time_ns=np.rint(sent_s.ravel() * 1e9).astype(np.int64),
        speed_m_s=0.0 * turns,
        lateral_speed_m_s=0.0 * turns,
        turn_rate_rad_s=turns,
    )
    return replace(run, commands=commands)


def test_a_robot_that_stops_by_itself_is_no_slow_robot() -> None:
    model = tl.identify_robot(stop_by_itself(0.5, 2.0))
    assert known(model.turn_rate.gain).value == pytest.approx(1.0, abs=2e-3)
    assert known(model.turn_rate.lag_s).value == pytest.approx(0.1, abs=3e-3)
    (note,) = model.notes
    assert "The turn rate stops by itself where no command comes, 8 times" in note
    for wait_s in model.turn_rate.silent_stops_s:
        assert wait_s == pytest.approx(0.5 + 0.1 + 0.1 * np.log(2.0), abs=0.1)


@pytest.mark.parametrize("silence_s", [1.0, 1.5, 2.0])
def test_a_slow_robot_that_stops_by_itself_has_its_own_delays(silence_s: float) -> None:
    """It is not at rest when the next command comes."""
    truth = Truth(gain=0.9, dead_time_s=0.15, lag_s=0.4)
    model = tl.identify_robot(stop_by_itself(0.5, silence_s, truth))
    axis = model.turn_rate
    assert (axis.model, axis.doubts) == ("first_order", ())
    assert known(axis.gain).value == pytest.approx(0.9, abs=5e-3)
    assert known(axis.dead_time_s).value == pytest.approx(0.15, abs=5e-3)
    assert known(axis.lag_s).value == pytest.approx(0.4, abs=1e-2)
    assert len(axis.silent_stops_s) >= 8
    for wait_s in axis.silent_stops_s:
        assert wait_s == pytest.approx(0.5 + 0.15 + 0.4 * np.log(2.0), abs=0.1)


def test_a_robot_that_holds_commands_sent_once_does_not_stop() -> None:
    run = make_run(SHORT, 4)
    changes = np.diff(run.commands.turn_rate_rad_s, prepend=np.nan) != 0.0
    changes |= np.diff(run.commands.speed_m_s, prepend=np.nan) != 0.0
    once = replace(run, commands=take_rows(run.commands, changes))
    assert [read_axis_motion(once, axis).stops for axis in AXES] == [(), ()]


def test_poses_that_a_program_repeats_do_not_delay_the_motion() -> None:
    """A pose that changes at 10 Hz is recorded at 50 Hz."""
    run = make_run(replace(SHORT, poses_hz=50.0, jitter_s=0.0), 2)
    held = np.arange(len(run.poses)) // 5 * 5
    poses = replace(run.poses, xy_m=run.poses.xy_m[held], heading_rad=run.poses.heading_rad[held])
    model = tl.identify_robot(replace(run, poses=poses))
    for axis in model.axes:
        assert known(axis.dead_time_s).value == pytest.approx(0.1, abs=3e-3)
        assert known(axis.lag_s).value == pytest.approx(0.1, abs=5e-3)
        assert known(axis.explained) > 0.9


def test_no_runs_are_refused() -> None:
    with pytest.raises(tl.errors.IdentifyError, match="runs: must not be empty"):
        tl.identify_robot([])
