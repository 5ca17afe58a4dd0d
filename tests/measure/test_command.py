import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from turtlelog.measure.metric import Found, Missing
from turtlelog.measure.metrics.commands_and_theory import (
    measure_effort,
    measure_largest_jump,
    measure_largest_slew_rate,
    measure_longest_saturation,
    measure_reversals,
    measure_total_variation,
)
from turtlelog.measure.response import CommandStretch, compute_hold_times

BURST_S = np.array([0.0, 0.0, 0.0, 1.0, 3.0])
VALUES = np.array([9.0, -9.0, 1.0, 2.0, -1.0])


def make_stretch(
    values: np.ndarray,
    time_s: np.ndarray | None = None,
    *,
    end_s: float | None = None,
    limit: float | None = None,
) -> CommandStretch:
    """Return held commands, without times one per second."""
    time_s = np.arange(len(values), dtype=np.float64) if time_s is None else time_s
    end_s = float(time_s[-1]) if end_s is None else end_s
    answered_ns = (1e9 * time_s).astype(np.int64)
    return CommandStretch(
        time_s=time_s, values=values, wanted=None, limit=limit, end_s=end_s, answered_ns=answered_ns
    )


def test_commands_hold_until_the_next_and_all_but_the_last_of_a_burst_not_at_all() -> None:
    held_s = compute_hold_times(BURST_S, 3.5)
    assert held_s.tolist() == [0.0, 0.0, 1.0, 2.0, 0.5]
    found = measure_effort(make_stretch(VALUES, BURST_S, end_s=3.5))
    assert isinstance(found, Found)
    assert found.value == pytest.approx(1.0 + 2.0 * 4.0 + 0.5)


def test_the_last_command_holds_no_less_than_no_time() -> None:
    assert compute_hold_times(np.array([0.0, 1.0]), 0.5).tolist() == [1.0, 0.0]


def test_every_command_of_a_burst_counts_as_a_change() -> None:
    commands = make_stretch(VALUES)
    assert measure_total_variation(commands) == Found(18.0 + 10.0 + 1.0 + 3.0)
    assert measure_largest_jump(commands) == Found(18.0, 1.0)


def test_a_burst_has_one_slew_rate() -> None:
    assert measure_largest_slew_rate(make_stretch(VALUES, BURST_S)) == Found(1.5, BURST_S[4])
    assert isinstance(measure_largest_slew_rate(make_stretch(VALUES[:3], np.zeros(3))), Missing)
    assert isinstance(measure_largest_slew_rate(make_stretch(VALUES[:1])), Missing)


def test_one_command_does_not_change() -> None:
    assert measure_largest_jump(make_stretch(VALUES[:1])) == Found(0.0, 0.0)
    assert measure_total_variation(make_stretch(VALUES[:1])) == Found(0.0)


def test_the_longest_stretch_is_measured_in_time_not_in_rows() -> None:
    values = np.array([2.0, 2.0, 2.0, 0.0, 2.0])
    long = make_stretch(values, end_s=9.0, limit=2.0)
    assert measure_longest_saturation(long) == Found(5.0, 4.0)
    short = make_stretch(values[:4], end_s=9.0, limit=2.0)
    assert measure_longest_saturation(short) == Found(3.0, 0.0)
    never = make_stretch(values, end_s=9.0, limit=3.0)
    assert measure_longest_saturation(never) == Found(0.0)


@pytest.mark.parametrize(
    ("values", "count"),
    [([1.0, -1.0, 1.0], 2), ([1.0, 0.0, 0.0, 1.0], 0), ([1.0, 0.0, -1.0], 1), ([0.0, 0.0], 0)],
)
def test_zeros_are_no_reversal(values: list[float], count: int) -> None:
    assert measure_reversals(make_stretch(np.array(values))) == Found(count)


@given(arrays(np.float64, st.integers(1, 40), elements=st.floats(-5.0, 5.0)))
def test_the_other_sign_gives_the_same_figures(values: np.ndarray) -> None:
    time_s = np.linspace(0.0, 1.0, len(values), dtype=np.float64)
    commands, other = make_stretch(values, time_s), make_stretch(-values, time_s)
    for measure in (
        measure_effort,
        measure_total_variation,
        measure_largest_jump,
        measure_largest_slew_rate,
        measure_reversals,
    ):
        assert measure(commands) == measure(other)
