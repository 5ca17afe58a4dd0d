import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from turtlelog.measure.metrics.commands import (
    compute_effort,
    compute_total_variation,
    count_reversals,
    find_largest_jump,
    find_largest_slew_rate,
    find_longest_held,
)
from turtlelog.measure.response import compute_hold_times

BURST_S = np.array([0.0, 0.0, 0.0, 1.0, 3.0])
VALUES = np.array([9.0, -9.0, 1.0, 2.0, -1.0])


def test_commands_hold_until_the_next_and_all_but_the_last_of_a_burst_not_at_all() -> None:
    held_s = compute_hold_times(BURST_S, 3.5)
    assert held_s.tolist() == [0.0, 0.0, 1.0, 2.0, 0.5]
    assert compute_effort(held_s, VALUES) == pytest.approx(1.0 + 2.0 * 4.0 + 0.5)


def test_the_last_command_holds_no_less_than_no_time() -> None:
    assert compute_hold_times(np.array([0.0, 1.0]), 0.5).tolist() == [1.0, 0.0]


def test_every_command_of_a_burst_counts_as_a_change() -> None:
    assert compute_total_variation(VALUES) == 18.0 + 10.0 + 1.0 + 3.0
    assert find_largest_jump(VALUES) == (18.0, 1)


def test_a_burst_has_one_slew_rate() -> None:
    assert find_largest_slew_rate(BURST_S, VALUES) == (1.5, 4)
    assert find_largest_slew_rate(np.zeros(3), VALUES[:3]) is None
    assert find_largest_slew_rate(np.zeros(1), VALUES[:1]) is None


def test_one_command_does_not_change() -> None:
    assert find_largest_jump(VALUES[:1]) == (0.0, 0)
    assert compute_total_variation(VALUES[:1]) == 0.0


def test_the_longest_stretch_is_measured_in_time_not_in_rows() -> None:
    held_s = np.array([1.0, 1.0, 1.0, 1.0, 5.0])
    mask = np.array([True, True, True, False, True])
    assert find_longest_held(held_s, mask) == (5.0, 4)
    assert find_longest_held(held_s, mask & (held_s < 5.0)) == (3.0, 0)
    assert find_longest_held(held_s, ~mask & mask) is None


@pytest.mark.parametrize(
    ("values", "count"),
    [([1.0, -1.0, 1.0], 2), ([1.0, 0.0, 0.0, 1.0], 0), ([1.0, 0.0, -1.0], 1), ([0.0, 0.0], 0)],
)
def test_zeros_are_no_reversal(values: list[float], count: int) -> None:
    assert count_reversals(np.array(values)) == count


@given(arrays(np.float64, st.integers(1, 40), elements=st.floats(-5.0, 5.0)))
def test_the_other_sign_gives_the_same_figures(values: np.ndarray) -> None:
    time_s = np.linspace(0.0, 1.0, len(values), dtype=np.float64)
    held_s = compute_hold_times(time_s, float(time_s[-1]))
    assert compute_effort(held_s, values) == compute_effort(held_s, -values)
    assert compute_total_variation(values) == compute_total_variation(-values)
    assert find_largest_jump(values) == find_largest_jump(-values)
    assert find_largest_slew_rate(time_s, values) == find_largest_slew_rate(time_s, -values)
    assert count_reversals(values) == count_reversals(-values)
