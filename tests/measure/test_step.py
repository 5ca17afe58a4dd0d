import math

import control
import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray

from turtlelog.measure import find_overshoot, find_settling_time
from turtlelog.measure.reductions import find_crossing_rows
from turtlelog.measure.step_response import (
    find_decay_ratio,
    find_level_time,
    find_peak_row,
    find_rise,
    find_undershoot,
)

Values = NDArray[np.float64]

STEPS = st.floats(-10.0, 10.0).filter(lambda step: abs(step) > 1e-3)
LEVELS = (0.1, 0.5, 0.9, 0.98)


def sample_exponential(tau_s: float, initial: float, step: float) -> tuple[Values, Values]:
    """Rows stand on the crossings of 10 %, 50 %, 90 % and 98 %: there nothing is interpolated."""
    crossings = [-tau_s * math.log(1.0 - level) for level in LEVELS]
    time_s = np.union1d(np.linspace(0.0, 8.0 * tau_s, 200), crossings)
    return time_s, initial + step * -np.expm1(-time_s / tau_s)


def sample_second_order(zeta: float, *, rows: int = 20_001) -> tuple[Values, Values]:
    """The unit step response of w^2 / (s^2 + 2 zeta w s + w^2) at w = 1 rad/s, over 40 s."""
    time_s = np.linspace(0.0, 40.0, rows)
    damped = math.sqrt(1.0 - zeta**2)
    decay = np.exp(-zeta * time_s)
    swing = np.cos(damped * time_s) + zeta / damped * np.sin(damped * time_s)
    return time_s, 1.0 - decay * swing


@given(initial=st.floats(-5.0, 5.0), step=STEPS, beyond=st.floats(0.0, 2.0))
def test_overshoot_is_the_share_of_the_step_beyond_the_reference(
    initial: float, step: float, beyond: float
) -> None:
    values = initial + step * np.array([0.0, 0.5, 1.0 + beyond, 1.0])
    found = find_overshoot(values, initial=initial, reference=initial + step)
    assert found == pytest.approx(beyond, abs=1e-9)


def test_overshoot_is_negative_where_the_response_stays_short() -> None:
    values = np.array([0.0, 0.4, 0.75])
    assert find_overshoot(values, initial=0.0, reference=1.0) == pytest.approx(-0.25)
    assert find_overshoot(-values, initial=0.0, reference=-1.0) == pytest.approx(-0.25)


@given(tau_s=st.floats(0.05, 5.0), initial=st.floats(-5.0, 5.0), step=STEPS)
def test_an_exponential_has_the_times_of_its_closed_form(
    tau_s: float, initial: float, step: float
) -> None:
    time_s, values = sample_exponential(tau_s, initial, step)
    ends = {"initial": initial, "reference": initial + step}
    rise = find_rise(time_s, values, **ends)
    assert rise[1] - rise[0] == pytest.approx(math.log(9.0) * tau_s, rel=1e-9)
    settled = find_settling_time(time_s, values, **ends, band=0.02)
    assert settled == pytest.approx(math.log(50.0) * tau_s, rel=1e-9)
    delay = find_level_time(time_s, values, level=0.5, **ends)
    assert delay == pytest.approx(math.log(2.0) * tau_s, rel=1e-9)


@pytest.mark.parametrize("period_s", [0.016, 0.004])
def test_between_rows_the_error_is_that_of_the_line(period_s: float) -> None:
    time_s = np.arange(0.0, 8.0, period_s)
    found = find_settling_time(time_s, -np.expm1(-time_s), initial=0.0, reference=1.0, band=0.02)
    assert found is not None
    # |y''| / |y'| = 1 / tau of an exponential.
    assert 0.0 <= found - math.log(50.0) <= period_s**2 / 8.0


@pytest.mark.parametrize("zeta", [0.1, 0.3, 0.5, 0.8])
def test_a_second_order_response_peaks_as_its_closed_form(zeta: float) -> None:
    damped = math.sqrt(1.0 - zeta**2)
    time_s = np.union1d(np.linspace(0.0, 40.0, 4001), np.arange(1, 4) * math.pi / damped)
    decay = np.exp(-zeta * time_s)
    swing = np.cos(damped * time_s) + zeta / damped * np.sin(damped * time_s)
    values = 1.0 - decay * swing
    peak = math.exp(-math.pi * zeta / damped)
    assert find_overshoot(values, initial=0.0, reference=1.0) == pytest.approx(peak, rel=1e-9)
    row = find_peak_row(values, initial=0.0, reference=1.0)
    assert time_s[row] == pytest.approx(math.pi / damped, rel=1e-9)
    decayed = find_decay_ratio(1.0 - values, initial=0.0, reference=1.0, memory=None)
    assert decayed is not None
    assert decayed[0] == pytest.approx(peak**2, rel=1e-9)
    assert time_s[decayed[1]] == pytest.approx(3.0 * math.pi / damped, rel=1e-9)


@pytest.mark.parametrize("zeta", [0.2, 0.5, 0.9])
def test_step_info_agrees_where_it_is_right(zeta: float) -> None:
    time_s, values = sample_second_order(zeta)
    info = control.step_info(values, T=time_s, yfinal=1.0)
    period_s = time_s[1]
    ends = {"initial": 0.0, "reference": 1.0}
    rise = find_rise(time_s, values, **ends)
    # It takes whole rows, the first on the other side of a crossing.
    assert rise[1] - rise[0] == pytest.approx(info["RiseTime"], abs=period_s)
    settled = find_settling_time(time_s, values, **ends, band=0.02)
    assert settled == pytest.approx(info["SettlingTime"], abs=period_s)
    overshoot = find_overshoot(values, **ends)
    assert 100.0 * overshoot == pytest.approx(info["Overshoot"], rel=1e-9)
    assert time_s[find_peak_row(values, **ends)] == info["PeakTime"]


def test_a_ramp_has_its_times_exactly() -> None:
    time_s, values = np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.5, 1.0])
    found = find_settling_time(time_s, values, initial=0.0, reference=1.0, band=0.1)
    assert found == pytest.approx(1.8, rel=1e-12)
    assert find_rise(time_s, values, initial=0.0, reference=1.0) == pytest.approx((0.2, 1.8))


def test_settling_counts_the_last_entry_from_either_side() -> None:
    time_s = np.arange(6.0)
    values = np.array([0.0, 1.0, 1.0, 1.5, 1.0, 1.0])
    found = find_settling_time(time_s, values, initial=0.0, reference=1.0, band=0.1)
    assert found == pytest.approx(3.8)


def test_settling_through_the_band_ends_at_its_near_edge() -> None:
    values = np.array([0.0, 1.5, 0.95])
    found = find_settling_time(np.arange(3.0), values, initial=0.0, reference=1.0, band=0.1)
    assert found == pytest.approx(1.0 + 0.4 / 0.55)


def test_a_response_that_ends_outside_the_band_does_not_settle() -> None:
    time_s, values = np.arange(3.0), np.array([0.0, 1.0, 0.9])
    settled_s = find_settling_time(time_s, values, initial=0.0, reference=1.0, band=0.02)
    assert math.isnan(settled_s)


def test_a_response_that_never_comes_to_90_percent_does_not_rise() -> None:
    values = np.array([0.0, 0.5, 0.8])
    assert math.isnan(find_rise(np.arange(3.0), values, initial=0.0, reference=1.0)[1])


def test_undershoot_counts_what_goes_back_behind_the_start() -> None:
    values = np.array([0.0, -0.3, 0.5, 1.0])
    assert find_undershoot(values, initial=0.0, reference=1.0) == (0.3, 1)
    assert find_undershoot(-values, initial=0.0, reference=-1.0) == (0.3, 1)
    assert find_undershoot(values, initial=-0.5, reference=1.0)[0] < 0.0


@pytest.mark.parametrize(
    ("values", "rows"),
    [
        ([0.0, 2.0, 0.0], [1, 2]),
        ([0.0, 1.0, 0.0], []),  # touches
        ([0.0, 1.0, 1.0, 2.0], [3]),  # stands on it and goes on
        ([1.0, 1.0, 1.0], []),
        ([1.0, 2.0, 0.0], [2]),
    ],
)
def test_crossings_lead_from_one_side_to_the_other(values: list[float], rows: list[int]) -> None:
    assert find_crossing_rows(np.array(values), 1.0, None).tolist() == rows


def test_a_decay_ratio_needs_a_second_peak_that_has_passed() -> None:
    swing = np.array([0.0, 1.4, 0.8, 1.1, 1.05])
    ends = {"initial": 0.0, "reference": 1.0}
    assert find_decay_ratio(1.0 - swing, **ends, memory=None) == pytest.approx((0.25, 3))
    for values in (swing[:4], swing[:3], np.ones(3)):
        assert math.isnan(find_decay_ratio(1.0 - values, **ends, memory=None)[0])


@given(zeta=st.floats(0.05, 0.9), scale=STEPS, offset=st.floats(-5.0, 5.0))
def test_a_step_the_other_way_gives_the_same_figures(
    zeta: float, scale: float, offset: float
) -> None:
    time_s, unit = sample_second_order(zeta, rows=2001)
    figures = []
    for factor, start in ((1.0, 0.0), (scale, offset)):
        values, ends = start + factor * unit, {"initial": start, "reference": start + factor}
        rise = find_rise(time_s, values, **ends)
        figures.append(
            [
                *rise,
                find_overshoot(values, **ends),
                find_undershoot(values, **ends)[0],
                find_level_time(time_s, values, level=0.5, **ends),
            ]
        )
    assert figures[1] == pytest.approx(figures[0], rel=1e-6, abs=1e-9)


@given(zeta=st.floats(0.2, 0.9), count=st.integers(1, 200))
def test_settled_rows_at_the_end_change_nothing(zeta: float, count: int) -> None:
    time_s, values = sample_second_order(zeta, rows=2001)
    longer_s = np.append(time_s, time_s[-1] + 0.02 * np.arange(1, count + 1))
    longer = np.append(values, np.full(count, values[-1]))
    ends = {"initial": 0.0, "reference": 1.0}
    assert find_rise(time_s, values, **ends) == find_rise(longer_s, longer, **ends)
    assert find_overshoot(values, **ends) == find_overshoot(longer, **ends)
    assert find_decay_ratio(1.0 - values, **ends, memory=None) == pytest.approx(
        find_decay_ratio(1.0 - longer, **ends, memory=None), nan_ok=True
    )
    settled = find_settling_time(time_s, values, **ends, band=0.02)
    assert settled == find_settling_time(longer_s, longer, **ends, band=0.02)
    assert len(find_crossing_rows(values, 1.0, None)) == len(find_crossing_rows(longer, 1.0, None))
