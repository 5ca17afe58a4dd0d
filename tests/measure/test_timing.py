import numpy as np
import pytest
from hypothesis import given, strategies as st

from turtlelog.measure.timing import (
    compute_jitter,
    compute_rate,
    compute_spread,
    count_burst_rows,
    count_missing,
)


def test_equal_periods_have_no_spread_and_no_jitter() -> None:
    periods_s = np.full(999, 0.016)
    assert compute_rate(periods_s) == pytest.approx(62.5)
    assert compute_spread(periods_s) == 0.0
    assert compute_jitter(periods_s) == 0.0


def test_a_drift_spreads_without_jitter() -> None:
    drift_s = np.linspace(0.01, 0.02, 1001)
    assert compute_spread(drift_s) == pytest.approx(0.01 / np.sqrt(12.0), rel=1e-2)
    assert compute_jitter(drift_s) == pytest.approx(1e-5)


def test_alternating_periods_jitter_by_their_difference() -> None:
    periods_s = np.tile([0.015, 0.017], 500)
    assert compute_jitter(periods_s) == pytest.approx(0.002)
    assert compute_spread(periods_s) == pytest.approx(0.001)


def test_a_burst_counts_its_rows_and_leaves_the_rate_alone() -> None:
    periods_s = np.diff([0.0, 1.0, 1.0, 1.0, 2.0])
    assert count_burst_rows(periods_s) == 2
    assert compute_rate(periods_s) == 2.0


def test_no_time_has_no_rate() -> None:
    assert compute_rate(np.zeros(3)) is None
    assert compute_rate(np.zeros(0)) is None
    assert compute_jitter(np.zeros(1)) is None


@given(st.sets(st.integers(0, 500), min_size=1), st.integers(0, 2**40))
def test_missing_numbers_are_those_that_were_taken_out(kept: set[int], first: int) -> None:
    sequence = np.array(sorted(kept)) + first
    assert count_missing(sequence) == max(kept) - min(kept) + 1 - len(kept)
