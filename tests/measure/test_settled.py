"""Whether a response has settled: as the law says that ended it, or as long as it stayed."""

import math

import numpy as np
import pytest

import turtlelog as tl
from tests.measure.runs import GOAL_M, PERIOD_NS, Values, make_straight_run, set_times
from turtlelog.measure.step_response import find_swing_period
from turtlelog.run import Run

TIME_S = np.arange(2000) * PERIOD_NS / 1e9
SETTLED_S = math.log(50.0)
"""When an exponential of 1 s is within 2 %."""


def make_run(values: Values, end_s: float, stop_reason: str | None) -> Run:
    """Return a run of a response in shares of the step, stopped at a time."""
    return make_straight_run(GOAL_M * values[end_s >= TIME_S], stop_reason=stop_reason)


def settle(run: Run, name: str = "translate.settling_time") -> tl.Metric:
    return tl.measure_run(run, only=[name])[name]


def simulate(name: str, **changes: float) -> Run:
    values = {key.replace("__", "."): value for key, value in changes.items()}
    return tl.simulate_run(tl.override_scenario(tl.load_scenario(name), values))


@pytest.mark.parametrize("end_s", [45.0, 50.0])
def test_a_limit_cycle_does_not_settle(end_s: float) -> None:
    metric = settle(
        simulate("paper", law__kp_angular=50.0, max_duration_s=end_s), "rotate.settling_time"
    )
    assert (metric.value, metric.status) == (None, tl.measure.Status.NOT_REACHED)
    assert "s, and settling takes at least 1 s in the band" in metric.reason


def test_a_rotation_that_the_law_ended_settles_however_short_it_stays() -> None:
    metrics = tl.measure_run(simulate("textbook", law__kp_angular=50.0, law__kp_linear=50.0))
    settled, duration = metrics["rotate.settling_time"], metrics["rotate.duration"]
    assert settled.value == pytest.approx(2.2139, abs=1e-4)
    assert 0.0 < (duration.value or 0.0) - (settled.value or 0.0) < 0.1


@pytest.mark.parametrize(("end_s", "is_settled"), [(2.4, False), (2.7, True)])
def test_a_rotation_cut_in_its_pause_was_ended_by_the_law(end_s: float, is_settled: bool) -> None:  # noqa: FBT001
    """At Kp = 10 the rotation is in the band from 2.21 s and ends at 2.46 s."""
    whole = settle(simulate("paper-kp10"), "rotate.settling_time")
    cut = settle(simulate("paper-kp10", max_duration_s=end_s + 0.064), "rotate.settling_time")
    assert cut.value == (whole.value if is_settled else None)


@pytest.mark.parametrize(
    ("stop_reason", "is_settled"),
    [
        (None, False),
        ("max_duration", False),
        ("interrupted", False),
        ("timeout", False),
        ("standstill", True),
        ("within_tolerance", True),
        ("finished", True),
    ],
)
@pytest.mark.parametrize("name", ["translate.settling_time", "run.time_to_goal"])
def test_a_run_that_was_cut_or_timed_out_must_have_stayed(
    name: str,
    stop_reason: str | None,
    is_settled: bool,  # noqa: FBT001
) -> None:
    response = -np.expm1(-TIME_S)
    short = settle(make_run(response, SETTLED_S + 0.95, stop_reason), name)
    if is_settled:
        assert short.value == pytest.approx(SETTLED_S, abs=1e-4)
    else:
        assert short.status is tl.measure.Status.NOT_REACHED
        assert "settling takes at least 1 s in the band" in short.reason
    long = settle(make_run(response, SETTLED_S + 1.05, stop_reason), name)
    assert long.value == pytest.approx(SETTLED_S, abs=1e-4)


@pytest.mark.parametrize(("held_ns", "settled_s"), [(10**9 - 1, None), (10**9, 0.5)])
def test_a_cut_run_has_settled_once_it_stayed_for_a_whole_second(
    held_ns: int, settled_s: float | None
) -> None:
    """On the line from 0 to 1 it enters the band of 0.5 at 0.5 s, to the last bit."""
    run = make_straight_run(GOAL_M * np.array([0.0, 1.0, 1.0]), stop_reason=None)
    run = set_times(run, [0, 10**9, 10**9 // 2 + held_ns])
    name = "translate.settling_time"
    assert tl.measure_run(run, tl.MeasureSettings(band=0.5), only=[name])[name].value == settled_s


def swing(amplitude: float, period_s: float, *, until_s: float, offset: float = 0.0) -> Values:
    """Return a response that goes round its reference until a time, and stands there then."""
    angle = 2.0 * math.pi * TIME_S / period_s
    moving = 1.0 - amplitude * np.cos(angle) + offset
    return np.where(until_s >= TIME_S, moving, 1.0)


@pytest.mark.parametrize(("offset", "until_s"), [(0.0, 13.5), (0.025, 12.0)])
def test_a_slow_oscillation_must_have_ended_for_a_whole_period(
    offset: float, until_s: float
) -> None:
    """On both sides and on one, in the band for more than 1 s at a time, of a period of 6 s."""
    values = swing(0.03, 6.0, until_s=until_s, offset=offset)
    values[0] = 0.0
    entered = settle(make_run(values, 30.0, None))
    assert entered.value is not None
    assert until_s - 3.0 < entered.value < until_s
    for held_s, expected in ((5.4, None), (6.6, entered.value)):
        assert settle(make_run(values, entered.value + held_s, None)).value == expected
        assert settle(make_run(values, entered.value + held_s, "standstill")).value is not None


@pytest.mark.parametrize("end_s", np.arange(7.0, 20.0, 0.7))
def test_a_slow_limit_cycle_does_not_settle_wherever_it_is_cut(end_s: float) -> None:
    values = swing(0.03, 6.0, until_s=100.0)
    values[0] = 0.0
    assert settle(make_run(values, float(end_s), None)).value is None


def test_an_offset_within_the_band_is_no_oscillation() -> None:
    """Past the reference once, and 1.5 % beyond it from then on."""
    values = np.minimum(1.0 - np.cos(np.minimum(TIME_S, math.pi)), 1.015)
    settled = settle(make_run(values, 3.0, None))
    assert settled.value == pytest.approx(math.acos(0.02), abs=1e-3)


@pytest.mark.parametrize(("amplitude", "period_s"), [(0.45, 0.0), (0.55, 4.0)])
def test_a_swing_is_half_of_the_band(amplitude: float, period_s: float) -> None:
    values = amplitude * np.sin(2.0 * math.pi * TIME_S / 4.0)
    found = find_swing_period(TIME_S, values, reference=0.0, half_width=1.0)
    assert found == pytest.approx(period_s, abs=0.04)


@pytest.mark.parametrize(("apart_s", "period_s"), [(0.9, 0.0), (1.1, 1.6)])
def test_stretches_on_one_side_are_two_swings_where_a_second_lies_between(
    apart_s: float, period_s: float
) -> None:
    first = (TIME_S > 1.0) & (TIME_S < 1.5)
    second = (1.5 + apart_s < TIME_S) & (2.0 + apart_s > TIME_S)
    values = np.where(first | second, 1.0, 0.0)
    found = find_swing_period(TIME_S, values, reference=0.0, half_width=1.0)
    assert found == pytest.approx(period_s, abs=0.04)


@pytest.mark.parametrize(("again_s", "period_s"), [(np.nextafter(1.0, 0.0), 0.0), (1.0, 1.0)])
def test_stretches_a_whole_second_apart_are_two_swings(again_s: float, period_s: float) -> None:
    time_s, values = np.array([0.0, 0.5, again_s, 1.5, 2.0]), np.array([1.0, 0.0, 1.0, 0.0, 0.0])
    assert find_swing_period(time_s, values, reference=0.0, half_width=1.0) == period_s


def test_a_response_without_a_swing_has_no_period() -> None:
    for values in (np.zeros(5), np.ones(5), np.array([1.0, 0.0, 0.0, 0.0, 0.0])):
        assert find_swing_period(TIME_S[:5], values, reference=0.0, half_width=1.0) == 0.0
