import numpy as np
import pytest
from hypothesis import given, strategies as st

from turtlelog.measure.metrics.sampling_times import (
    compute_jitter,
    compute_rate,
    compute_spread,
    count_burst_rows,
    count_missing,
    find_percentile,
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


@pytest.mark.parametrize(
    ("rows", "p50", "p95", "p99"),
    [
        (1, 1.0, 1.0, 1.0),
        (20, 10.5, 19.0, 20.0),
        (50, 25.5, 48.0, 50.0),
        (200, 100.5, 190.0, 198.0),
    ],
)
def test_percentiles_are_periods_that_so_many_do_not_exceed(
    rows: int, p50: float, p95: float, p99: float
) -> None:
    ordered_s = np.arange(1.0, rows + 1.0)
    assert [find_percentile(ordered_s, percent) for percent in (50, 95, 99)] == [p50, p95, p99]


@given(st.lists(st.floats(0.0, 10.0), min_size=1, max_size=300), st.sampled_from([50, 95, 99]))
def test_so_many_percent_of_the_periods_are_no_longer(periods: list[float], percent: int) -> None:
    ordered_s = np.sort(np.array(periods))
    found = find_percentile(ordered_s, percent)
    assert 100 * np.count_nonzero(ordered_s <= found) >= percent * len(ordered_s)
    if percent != 50:
        assert 100 * np.count_nonzero(ordered_s < found) < percent * len(ordered_s)


def test_no_time_has_no_rate() -> None:
    assert compute_rate(np.zeros(3)) is None
    assert compute_rate(np.zeros(0)) is None
    assert compute_jitter(np.zeros(1)) is None


@given(st.sets(st.integers(0, 500), min_size=1), st.integers(0, 2**40))
def test_missing_numbers_are_those_that_were_taken_out(kept: set[int], first: int) -> None:
    sequence = np.array(sorted(kept)) + first
    assert count_missing(sequence) == max(kept) - min(kept) + 1 - len(kept)
