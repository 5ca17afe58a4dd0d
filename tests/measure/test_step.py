import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtlelog.measure import find_overshoot, find_settling_time

STEPS = st.floats(-10.0, 10.0).filter(lambda step: abs(step) > 1e-3)


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


@given(tau_s=st.floats(0.05, 5.0), step=STEPS)
def test_an_exponential_settles_after_ln_50_time_constants(tau_s: float, step: float) -> None:
    time_s = np.linspace(0.0, 8.0 * tau_s, 4001)
    values = step * (1.0 - np.exp(-time_s / tau_s))
    found = find_settling_time(time_s, values, initial=0.0, reference=step, band=0.02)
    assert found == pytest.approx(math.log(50.0) * tau_s, rel=1e-6)


def test_a_ramp_settles_where_the_line_enters_the_band() -> None:
    time_s, values = np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.5, 1.0])
    found = find_settling_time(time_s, values, initial=0.0, reference=1.0, band=0.1)
    assert found == pytest.approx(1.8)


def test_settling_counts_the_last_entry_from_either_side() -> None:
    time_s = np.arange(6.0)
    values = np.array([0.0, 1.0, 1.0, 1.5, 1.0, 1.0])
    found = find_settling_time(time_s, values, initial=0.0, reference=1.0, band=0.1)
    assert found == pytest.approx(3.8)


def test_a_response_that_ends_outside_the_band_does_not_settle() -> None:
    time_s, values = np.arange(3.0), np.array([0.0, 1.0, 0.9])
    assert find_settling_time(time_s, values, initial=0.0, reference=1.0, band=0.02) is None
