import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from turtlelog.measure.reductions import fold_at_zero, integrate
from turtlelog.measure.step_response import compute_rms, integrate_square, integrate_time_weighted

VALUES = arrays(np.float64, st.integers(2, 30), elements=st.floats(-10.0, 10.0, width=16))


def test_a_ramp_through_zero_is_integrated_exactly() -> None:
    time_s, error = np.array([0.0, 4.0]), np.array([3.0, -1.0])
    folded_s, step_s, magnitude = fold_at_zero(time_s, error, None)
    assert folded_s.tolist() == [0.0, 3.0, 4.0]
    assert integrate(step_s, magnitude, None) == pytest.approx(5.0, rel=1e-12)
    # The triangles' areas times where their centres of mass are.
    expected = 4.5 * 1.0 + 0.5 * (3.0 + 2.0 / 3.0)
    assert integrate_time_weighted(folded_s, step_s, magnitude) == pytest.approx(expected)
    assert integrate_square(np.diff(time_s), error) == pytest.approx(27.0 / 3.0 + 1.0 / 3.0)


@pytest.mark.parametrize(("period_s", "tolerance"), [(1e-2, 1e-4), (1e-4, 1e-8)])
def test_an_exponential_error_has_the_integrals_of_its_closed_form(
    period_s: float, tolerance: float
) -> None:
    time_s = np.arange(0.0, 40.0, period_s)
    error, step_s = np.exp(-time_s), np.diff(time_s)
    assert integrate(step_s, error, None) == pytest.approx(1.0, abs=tolerance)
    assert integrate_square(step_s, error) == pytest.approx(0.5, abs=tolerance)
    assert integrate_time_weighted(time_s, step_s, error) == pytest.approx(1.0, abs=tolerance)


@given(VALUES)
def test_integrals_of_lines_agree_with_fine_sums(values: np.ndarray) -> None:
    time_s = np.arange(len(values), dtype=np.float64)
    fine_s = np.linspace(0.0, time_s[-1], 20_001)
    fine = np.interp(fine_s, time_s, values)
    step = fine_s[1]
    scale = 1e-3 * (1.0 + np.abs(values).max() ** 2) * (1.0 + time_s[-1] ** 2)
    folded_s, step_s, magnitude = fold_at_zero(time_s, values, None)
    for found, signal in (
        (integrate(step_s, magnitude, None), np.abs(fine)),
        (integrate_square(np.diff(time_s), values), fine**2),
        (integrate_time_weighted(folded_s, step_s, magnitude), fine_s * np.abs(fine)),
    ):
        assert found == pytest.approx(float(signal[1:].sum()) * step, abs=scale)


@given(VALUES, st.floats(0.1, 10.0))
def test_rms_does_not_depend_on_the_unit_of_time(values: np.ndarray, scale: float) -> None:
    step_s = np.full(len(values) - 1, 0.016)
    assert compute_rms(step_s * scale, values, None) == pytest.approx(
        compute_rms(step_s, values, None)
    )


def test_rms_of_a_sawtooth_is_its_height_over_root_three() -> None:
    assert compute_rms(np.array([2.0]), np.array([0.0, 3.0]), None) == pytest.approx(math.sqrt(3.0))


def test_one_moment_has_its_own_magnitude() -> None:
    assert compute_rms(np.zeros(0), np.array([-2.0]), None) == 2.0


def test_zeros_and_touching_add_no_rows() -> None:
    time_s = np.arange(5.0)
    for values in ([0.0, 1.0, 0.0, -1.0, 0.0], [0.0] * 5, [1.0, 0.0, 1.0, 0.0, 1.0]):
        folded_s, _, magnitude = fold_at_zero(time_s, np.array(values), None)
        assert folded_s.tolist() == time_s.tolist()
        assert magnitude.tolist() == [abs(value) for value in values]
