"""Robots with limits: what is found of them, what is doubted, and gains that suit them."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from tests.identify.limited_robots import (
    Limited,
    draw_robot,
    find_headings,
    turn_as_advised,
    turn_on_the_spot,
)
from tests.identify.robots import Log, build_run, draw_steps, make_run, wrap
from tests.known import known
from turtlelog.identify import (
    AxisModel,
    Estimate,
    build_robot_scenario,
    predict_axis,
    read_robot_notes,
    structure_choice,
)
from turtlelog.identify.axis_fit import fit_axis
from turtlelog.identify.axis_motion import read_axis_motion
from turtlelog.identify.fit_values import cover_rivals, describe_fit
from turtlelog.identify.held_response import HeldResponse, Structure, hold_commands, limit_within
from turtlelog.identify.refused_axes import refuse_fit
from turtlelog.identify.structure_choice import choose_structure
from turtlelog.run import Run

LOG = Log(duration_s=25.0, poses_hz=25.0)
TRUTHS = {
    "acceleration": Limited(acceleration=2.0),
    "ramp": Limited(ramp=2.0),
    "bound": Limited(bound=0.7),
    "stop": Limited(stop=0.7),
    "both": Limited(acceleration=2.5, bound=0.8),
    "friction": Limited(friction=0.2),
    "deadband": Limited(deadband=0.3),
    "direction": Limited(reverse=0.8),
}


@cache
def identify(kind: str) -> tuple[Run, tl.RobotModel]:
    run = turn_on_the_spot(TRUTHS[kind], LOG, 2)
    return run, tl.identify_robot(run)


@pytest.mark.everyday("within", "bound")
@pytest.mark.parametrize(
    "truth",
    [
        Limited(acceleration=2.0),
        Limited(ramp=2.0),
        Limited(acceleration=1.0, bound=0.5),
        Limited(stop=0.6),
        Limited(acceleration=2.0, stop=0.6),
    ],
    ids=["within", "before", "bound", "stop", "both"],
)
def test_the_robots_turn_as_small_steps_in_time_do(truth: Limited) -> None:
    step_s, at_s = 1e-4, np.array([0.4, 0.7, 1.3, 2.0])
    command_s, turns = np.array([0.1, 0.5, 0.55, 1.2]), np.array([1.0, -1.4, 0.2, 0.9])
    heading = rate = asked = 0.0
    headings = []
    for tick in range(20_000):
        held = np.searchsorted(command_s + truth.dead_time_s, tick * step_s, side="right")
        wanted = truth.ask(float(turns[held - 1])) if held else 0.0
        asked += float(np.clip(wanted - asked, -truth.ramp * step_s, truth.ramp * step_s))
        heading += rate * step_s
        most = truth.acceleration
        rate += float(np.clip((asked - rate) / truth.lag_s, -most, most)) * step_s
        rate = float(np.clip(rate, -truth.stop, truth.stop))
        headings.append(heading)
    rows = np.rint(at_s / step_s).astype(int) - 1
    found = find_headings(truth, command_s, turns, at_s)
    np.testing.assert_allclose(found, np.array(headings)[rows], atol=5e-4)


@pytest.mark.everyday(
    "both-bound-0.8", "both-rate_limit-2.5", "direction-reverse_gain-0.76", "friction-friction-0.2"
)
@pytest.mark.parametrize(
    ("kind", "field", "value"),
    [
        ("acceleration", "rate_limit", 2.0),
        ("ramp", "rate_limit", 2.0),
        ("bound", "bound", 0.7),
        ("stop", "bound", 0.7),
        ("both", "bound", 0.8),
        ("both", "rate_limit", 2.5),
        ("friction", "friction", 0.2),
        ("direction", "reverse_gain", 0.95 * 0.8),
    ],
)
def test_a_limit_is_found_where_there_is_one(kind: str, field: str, value: float) -> None:
    """Each robot is identified once, by the first of these tests that asks for it."""
    found = known(getattr(identify(kind)[1].turn_rate, field))
    assert found.value == pytest.approx(value, rel=5e-3)
    assert found.low < value < found.high


@pytest.mark.parametrize(("reverse", "is_found"), [(0.95, True), (0.96, False)])
def test_noise_hides_a_gain_backwards_that_differs_little(
    reverse: float, *, is_found: bool
) -> None:
    """Two robots are identified; the gain of the first lowers the sum of squares by 22 to 26."""
    run = turn_on_the_spot(Limited(reverse=reverse), replace(LOG, noise_rad=0.2), 2)
    found = tl.identify_robot(run).turn_rate.reverse_gain
    assert (found is not None) is is_found
    assert found is None or found.low < 0.95 * reverse < found.high


@pytest.mark.parametrize(("each", "is_found"), [(0.45, False), (0.55, True)])
def test_a_limit_must_predict_steps_that_were_not_fitted(
    each: float, *, is_found: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(structure_choice, "compare_predictions", lambda *_: each)
    found = tl.identify_robot(turn_on_the_spot(TRUTHS["direction"], LOG, 2)).turn_rate
    assert (found.reverse_gain is not None) is is_found


def test_a_deadband_is_found_if_only_the_beginning_shows_it() -> None:
    """The last third has no small command."""
    truth, log = draw_robot("deadband", 9306)
    log = replace(log, noise_rad=4.0 * log.noise_rad, duration_s=25.0)
    found = known(tl.identify_robot(turn_on_the_spot(truth, log, 9306)).turn_rate.deadband)
    assert found.low < truth.deadband <= found.high


@pytest.mark.parametrize("kind", TRUTHS)
def test_a_limit_leaves_gain_and_delays_as_they_are(kind: str) -> None:
    truth, found = TRUTHS[kind], identify(kind)[1].turn_rate
    delays_s = known(found.dead_time_s), known(found.lag_s), known(found.total_delay_s)
    assert known(found.gain).value == pytest.approx(truth.gain, rel=2e-3)
    for delay, value in zip(delays_s, (0.07, 0.1, 0.17), strict=True):
        assert delay.value == pytest.approx(value, abs=2e-3)
        assert delay.high - delay.low < 0.01
    assert found.doubts == ()


def test_where_a_limit_acts_is_told() -> None:
    kinds = "acceleration", "ramp", "bound", "stop"
    found = [identify(kind)[1].turn_rate for kind in kinds]
    assert [axis.limit_acts for axis in found] == ["within_lag", "before_lag", "", ""]
    assert [axis.bound_acts for axis in found] == ["", "", "command", "rate"]


def test_a_deadband_lies_between_the_commands_that_do_nothing_and_those_that_do() -> None:
    found = known(identify("deadband")[1].turn_rate.deadband)
    assert found.low < 0.3 <= found.high


def test_a_deadband_is_found_among_many_magnitudes_of_commands() -> None:
    log = replace(LOG, hold_s=(0.1, 0.3))
    found = known(
        tl.identify_robot(turn_on_the_spot(TRUTHS["deadband"], log, 3)).turn_rate.deadband
    )
    assert found.low < 0.3 <= found.high
    assert found.high - found.low < 0.05


@pytest.mark.parametrize(("off", "is_told"), [(0.0099, False), (0.0111, True)])
def test_a_doubt_is_told_where_it_changes_a_recommended_gain(off: float, *, is_told: bool) -> None:
    sure_s = Estimate(value=0.1, low=0.1, high=0.1)
    found = AxisModel(
        axis="turn_rate",
        status="ok",
        gain=Estimate(value=0.9, low=0.9, high=0.9, unit="1"),
        dead_time_s=sure_s,
        lag_s=sure_s,
        total_delay_s=Estimate(value=0.2, low=0.2, high=0.2),
    )
    gain = Estimate(value=0.9, low=0.9, high=0.9 * (1.0 + off), unit="1")
    rival = replace(found, gain=gain)
    covered = cover_rivals(found, Structure(), [(Structure(order="second_order"), rival)])
    assert known(covered.gain).high == gain.high
    assert bool(covered.doubts) is is_told


def test_limits_of_rivals_are_covered_too() -> None:
    found = identify("acceleration")[1].turn_rate
    limit = known(found.rate_limit)
    other = replace(found, rate_limit=replace(limit, low=1.5, high=2.2))
    covered = known(cover_rivals(found, Structure(), [(Structure(), other)]).rate_limit)
    assert (covered.value, covered.low, covered.high) == (limit.value, 1.5, 2.2)


@pytest.mark.parametrize("kind", ["acceleration", "ramp", "bound", "stop", "both", "direction"])
def test_advised_gains_overshoot_by_no_more_than_was_wanted(kind: str) -> None:
    run, model = identify(kind)
    assert max(turn_as_advised(model, run, TRUTHS[kind])) <= 6.0


def test_the_scenario_has_the_command_at_which_the_bound_is_reached() -> None:
    run, model = identify("bound")
    limit = build_robot_scenario(model, run).scenario.limits.turn_rate_rad_s
    assert limit == pytest.approx(0.7 / 0.95, rel=0.01)


@pytest.mark.parametrize("kind", ["acceleration", "both", "stop", "friction", "direction"])
def test_the_model_predicts_the_motion_of_a_robot_with_limits(kind: str) -> None:
    run, model = identify(kind)
    way, _ = predict_axis(model.turn_rate, run, run.poses.time_ns / 1e9)
    off = np.unwrap(run.poses.heading_rad) - way
    assert float(np.std(off)) < 0.02  # of turns by 10 rad


def test_a_limit_within_the_loop_that_is_never_reached_changes_nothing() -> None:
    at_s, values = np.array([0.1, 0.5, 0.9]), np.array([1.0, -1.0, 0.3])
    commands, time_s = hold_commands(at_s, values), np.linspace(0.0, 2.0, 50)
    plain = HeldResponse([commands], 0.2)
    limited = HeldResponse([limit_within(commands, 1e-3, 0.2)], 0.2)
    (way, rate), (other_way, other_rate) = (
        response.evaluate(response.place(time_s)) for response in (plain, limited)
    )
    np.testing.assert_allclose(other_rate, rate, atol=1e-12)
    np.testing.assert_allclose(other_way - other_way[0], way - way[0], atol=1e-12)


BRAKING = Limited(lag_s=0.2, braking=0.45)


@cache
def identify_braking() -> tuple[Run, tl.RobotModel]:
    run = turn_on_the_spot(BRAKING, LOG, 2)
    return run, tl.identify_robot(run)


def test_a_curve_that_no_model_explains_makes_intervals_wider_and_a_doubt() -> None:
    _, model = identify_braking()
    found, noted = model.turn_rate, " ".join(model.notes)
    total_s = known(found.total_delay_s)
    assert total_s.low <= 0.07 + 0.45 * 0.2 + 0.03
    assert total_s.high >= 0.07 + 0.2 - 0.03
    assert "No model explains the turn rate completely" in noted
    assert "between rising and falling commands" in noted


def test_in_doubt_advice_has_the_longer_delay_and_says_so() -> None:
    run, model = identify_braking()
    axis, robot = model.turn_rate, build_robot_scenario(model, run)
    plant: Any = robot.scenario.plant
    assert axis.advised_delay_s == known(axis.total_delay_s).high
    delay_s = plant.turn_dead_time_s + plant.turn_lag_s
    assert delay_s >= known(axis.total_delay_s).high - 1e-5
    assert plant.turn_gain == pytest.approx(known(axis.gain).high, rel=1e-4)
    doubt, note = read_robot_notes(robot.text)
    assert doubt == f"Doubt: {axis.doubts[0]}"
    assert note.startswith("Note: The speed is never commanded, and so its dynamics are unknown.")
    assert max(turn_as_advised(model, run, BRAKING)) <= 6.0


def test_structures_that_the_log_does_not_tell_apart_are_both_covered() -> None:
    truth, log = draw_robot("ramp before", 12)
    log = replace(log, noise_rad=12.0 * log.noise_rad, duration_s=20.0)
    found: AxisModel = tl.identify_robot(turn_on_the_spot(truth, log, 12)).turn_rate
    dead_time_s = known(found.dead_time_s)
    assert dead_time_s.low <= truth.dead_time_s <= dead_time_s.high
    assert "within the velocity loop" in found.doubts[0]
    assert "before the time constant" in found.doubts[0]


@pytest.mark.parametrize("acceleration", [2.0, 3.0])
@pytest.mark.parametrize("seed", [2, 7])
def test_a_time_constant_that_only_rounds_ramps_leaves_the_total_delay_known(
    seed: int, acceleration: float
) -> None:
    """The slope of such a time constant shows no error where the best one is 0."""
    truth = Limited(acceleration=acceleration, lag_s=1e-3)
    found = tl.identify_robot(turn_on_the_spot(truth, LOG, seed)).turn_rate
    total, lag = known(found.total_delay_s), known(found.lag_s)
    assert total.low <= truth.dead_time_s + truth.lag_s <= total.high
    assert total.low > 0.067
    assert total.high < 0.09
    assert lag.low <= truth.lag_s <= lag.high


def test_a_robot_that_one_lag_explains_has_neither_limits_nor_doubts() -> None:
    found = tl.identify_robot(turn_on_the_spot(Limited(), LOG, 2)).turn_rate
    limits = found.rate_limit, found.bound, found.deadband, found.friction, found.reverse_gain
    assert limits == (None,) * 5
    assert found.doubts == ()
    assert found.advised_delay_s == known(found.total_delay_s).value


@pytest.mark.parametrize(("small", "is_told"), [(0.5, False), (0.9, False), (0.96, True)])
def test_commands_of_one_size_leave_the_gain_of_others_unknown(
    small: float, *, is_told: bool
) -> None:
    time_s = np.arange(0.5, 14.5, 0.05)
    sizes = np.array([1.0, -small, small, 0.0, -1.0])
    turns = time_s, sizes[(time_s / 0.9).astype(int) % 5]
    run = make_run(replace(LOG, duration_s=15.0), 2, speed=(time_s, 0.0 * time_s), turn=turns)
    notes = " ".join(tl.identify_robot(run).notes)
    assert ("All turn rate commands have the same magnitude" in notes) is is_told


@pytest.mark.parametrize(("small", "is_known"), [(0.5, True), (0.7, False)])
def test_a_gain_of_commands_that_all_reach_the_bound_is_unknown(
    small: float, *, is_known: bool
) -> None:
    """Two robots with many limits to try are identified; forward, 0.63 rad/s reaches the bound."""
    found, _ = identify_sizes([1.0, -0.3, small, -0.6, 1.3, -0.5, 0.0, -1.2])
    assert found.is_known is is_known
    assert is_known or "every positive command reaches the limit of 0.6 rad/s" in found.reason
    assert is_known or f"also to less than {small} rad/s" in found.advice
    assert not is_known or known(found.gain).low < 0.95 < known(found.gain).high


@pytest.mark.parametrize(("small", "is_told"), [(0.5, False), (0.7, True)])
def test_a_gain_of_negative_commands_that_all_reach_the_bound_is_a_note(
    small: float, *, is_told: bool
) -> None:
    found, notes = identify_sizes([-1.0, 0.3, -small, 0.6, -1.3, 0.5, 0.0, 1.2], reverse=1.0)
    assert known(found.gain).low < 0.95 < known(found.gain).high
    assert ("Every negative command of the turn rate reaches the limit" in notes) is is_told


@pytest.mark.parametrize(
    ("high", "said"), [(9.9, "0 to 9.9, is wider"), (10.1, "0 to more than 10, is wider")]
)
def test_a_gain_that_the_bound_hides_is_refused_with_the_commands_that_show_it(
    high: float, said: str
) -> None:
    """A robot with a bound is identified once for several tests, which takes 2 s."""
    motions = [read_axis_motion(identify("bound")[0], "turn_rate")]
    fit = fit_axis(motions)
    found = replace(
        describe_fit("turn_rate", fit, 9),
        gain=Estimate(value=1.0, low=0.0, high=high, unit="1"),
        bound=Estimate(value=0.7, low=0.69, high=0.71, unit="rad/s"),
    )
    refused = refuse_fit("turn_rate", motions, fit, found)
    assert refused is not None
    assert said in refused.reason
    assert refused.advice == "step the turn rate ten times for 2 s, also to less than 0.7 rad/s"
    coupled = refuse_fit("turn_rate", motions, fit, replace(found, bound_acts="scaled"))
    plain = refuse_fit("turn_rate", motions, fit, replace(found, bound=None))
    assert coupled is not None
    assert coupled.advice == "step the turn rate ten times for 2 s, while the speed rests"
    assert plain is not None
    assert plain.advice == "step the turn rate ten times for 2 s"


def test_a_command_that_is_below_the_bound_for_a_moment_is_not_enough() -> None:
    found, _ = identify_sizes([1.0, -0.3, 0.7, -0.6, 1.3, -0.5, 0.0, -1.2], once=0.4)
    assert "nearly every positive command reaches the limit of 0.6 rad/s" in found.reason
    assert "at least 0.857;" in found.reason


def identify_sizes(
    sizes: list[float], reverse: float = 0.8, once: float = 0.0
) -> tuple[AxisModel, str]:
    """Return what is found of a robot with a bound, driven by commands of some sizes in turn.

    One message is another one.
    """
    rng, time_s = np.random.default_rng(3), np.arange(0.5, 24.0, 0.05)
    turns = np.array(sizes)[(time_s / 0.73).astype(int) % len(sizes)]
    turns[250] = once or turns[250]
    at_s = np.arange(0.0, 25.0, 0.04)
    heading = find_headings(Limited(bound=0.6, reverse=reverse), time_s, turns, at_s)
    seen = wrap(heading + rng.normal(0.0, 5e-4, len(at_s)))
    run = build_run(at_s, np.zeros((len(at_s), 2)), seen, (time_s, 0.0 * turns, turns))
    model = tl.identify_robot(run)
    return model.turn_rate, " ".join(model.notes)


@pytest.mark.parametrize(
    ("truth", "seed"),
    [
        (Limited(gain=0.88, lag_s=0.23, acceleration=1.9, bound=0.5), 4),
        (Limited(gain=1.08, lag_s=0.127, acceleration=3.65, bound=1.2), 5),
    ],
    ids=["low bound", "wheels"],
)
def test_a_search_does_not_end_at_another_structure(truth: Limited, seed: int) -> None:
    """Two limits of the turn rate are searched, which takes 2 s.

    A low bound leaves changes so small that a search that begins with a weak limit of the
    acceleration finds none; a limit of the wheels explains more than any other first part.
    """
    rng = np.random.default_rng(seed)
    (time_s, speeds), (_, turns) = (draw_steps(rng, LOG, 1.5) for _ in range(2))
    at_s = np.arange(0.0, LOG.duration_s, 1.0 / LOG.poses_hz)
    heading = find_headings(truth, time_s, turns, at_s)
    seen = wrap(heading + rng.normal(0.0, LOG.noise_rad, len(at_s)))
    run = build_run(at_s, np.zeros((len(at_s), 2)), seen, (time_s, speeds, turns))
    fit, _ = choose_structure(fit_axis([read_axis_motion(run, "turn_rate")]))
    assert fit.model.structure == Structure(order="limited_within", bound="command")
    assert fit.parameters[:3] == pytest.approx([truth.gain, 0.07, truth.lag_s], rel=0.02)
