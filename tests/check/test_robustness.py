import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from tests.check.formulas import HALF_NS, Column, Definition, formulas, signals
from turtlelog.check import Steps, compute_robustness
from turtlelog.errors import CheckError, ExpressionError
from turtlelog.expressions import Node, format_expression, parse_expression

Trace = dict[str, Column]

SECOND_NS = 2 * HALF_NS
X = (np.arange(5) * SECOND_NS, np.array([0.0, 3.0, 1.0, 4.0, 2.0]))


def compute(text: str, **trace: Any) -> Steps:
    return compute_robustness(trace, parse_expression(text))


def read_at(function: Steps, time_ns: int) -> float:
    return float(function.values[function.find_piece(time_ns)])


def list_steps(function: Steps) -> list[tuple[float, float]]:
    return list(zip(function.time_ns / 1e9, function.values, strict=True))


@settings(deadline=None)
@given(formulas, signals)
def test_margins_are_those_of_the_definitions_at_every_moment(tree: Node, trace: Trace) -> None:
    expression = parse_expression(format_expression(tree))
    found = compute_robustness(trace, expression, window_ns=(0, 60 * HALF_NS))
    expected = Definition(tree, trace)
    moments = range(61)
    assert [read_at(found, at * HALF_NS) for at in moments] == [expected(at) for at in moments]
    assert (np.diff(found.time_ns) > 0).all()
    assert found.time_ns[0] == 0


@pytest.mark.parametrize(
    ("text", "steps"),
    [
        ("x >= 1", [(0, -1), (1, 2), (2, 0), (3, 3), (4, 1)]),
        ("eventually[0, 1](x > 0)", [(0, 3), (2, 4), (4, 2)]),
        ("eventually[0.25, 0.5](x > 0)", [(0, 0), (0.5, 3), (1.75, 1), (2.5, 4), (3.75, 2)]),
        ("always[1, 1](x > 0)", [(0, 3), (1, 1), (2, 4), (3, 2)]),
        ("always(x > 0)", [(0, 0), (1, 1), (3, 2)]),
        ("always[2.5, inf](x > 0)", [(0, 1), (0.5, 2)]),
        ("eventually[100, 200](x > 0)", [(0, 2)]),
        ("x < 2 until x > 2", [(0, -1), (1, -1), (2, -1), (3, -2), (4, 0)]),
    ],
)
def test_windows_change_where_their_ends_meet_steps(
    text: str, steps: list[tuple[float, float]]
) -> None:
    found = compute(text, x=X)
    moments = [*(time_s for time_s, _ in steps), 50.0]
    expected = [*(value for _, value in steps), steps[-1][1]]
    assert [read_at(found, round(time_s * 1e9)) for time_s in moments] == expected


def test_signals_of_different_times_are_joined_by_hold() -> None:
    y = (np.array([0, 3]) * HALF_NS, np.array([10.0, 20.0]))
    found = compute("x + y > 0", x=X, y=y)
    assert list_steps(found) == [(0, 10), (1, 13), (1.5, 23), (2, 21), (3, 24), (4, 22)]


def test_a_trace_begins_where_all_its_signals_have_a_value() -> None:
    y = (np.array([3, 4]) * HALF_NS, np.array([10.0, 20.0]))
    assert list_steps(compute("x + y > 0", x=X, y=y))[0] == (1.5, 13)


def test_of_values_at_one_time_the_last_one_holds() -> None:
    x = (np.array([0, 1, 1, 1, 2]), np.array([1.0, -5.0, -6.0, 2.0, 3.0]))
    assert compute("always(x > 0)", x=x).values[0] == 1.0


def test_a_window_cuts_the_trace() -> None:
    found = compute_robustness(
        {"x": X}, parse_expression("always(x > 0)"), window_ns=(HALF_NS * 3, HALF_NS * 5)
    )
    assert list_steps(found)[0] == (1.5, 1.0)


@pytest.mark.parametrize(
    ("text", "margin"),
    [
        ("x == 1", -1.0),
        ("x != 3", 3.0),
        ("-1 < x < 3", 1.0),
        ("not x > 2", 2.0),
        ("x > 2 implies x > 9", 2.0),
        ("phase == 'rotate'", math.inf),
        ("phase != 'rotate'", -math.inf),
        ("flag", math.inf),
        ("flag == false", -math.inf),
        ("true and x < 3", 3.0),
        ("gain >= 2 or x > 5", 0.5),
        ("x < inf", math.inf),
        ("inf <= inf", 0.0),
        ("nothing > 1", math.nan),
        ("x / 0 > 1", math.nan),
        ("law == 'p'", math.inf),
    ],
)
def test_margins_of_comparisons(text: str, margin: float) -> None:
    phase = (X[0], np.array(["rotate"] * 3 + ["translate"] * 2))
    flag = (X[0], np.array([True, False, True, True, True]))
    found = compute(text, x=X, phase=phase, flag=flag, gain=2.5, nothing=None, law="p")
    assert found.values[0] == pytest.approx(margin, nan_ok=True)


@settings(deadline=None)
@given(st.lists(st.integers(0, 40), min_size=1), st.integers(0, 20), st.integers(0, 20))
def test_margins_do_not_depend_on_where_the_clock_begins(
    gaps: list[int], first: int, length: int
) -> None:
    text = f"always[{first}, {first + length}](eventually[0, {length}](x > 3))"
    times, values = np.cumsum(gaps) * 10**8, np.sin(np.arange(len(gaps)))
    found = compute(text, x=(times, values))
    moved = compute(text, x=(times + 10**18, values))
    assert np.array_equal(moved.time_ns, found.time_ns + 10**18)
    assert np.array_equal(moved.values, found.values)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("always(x)", "column 8: expected true or false, found x, a number"),
        ("always(x > 1) > 2", "column 1: expected no temporal operator in a comparison"),
        ("y > 1", 'column 1: unknown name "y"; there are x, phase'),
        ("always(phse == 'a')", 'column 8: unknown name "phse"; did you mean phase'),
        ("always(x > 1 and phase > 'a')", "column 24: expected numbers around >, found a text"),
        ("x > 1 and phase == 2", "column 17: expected two of a kind around =="),
    ],
)
def test_errors_point_at_the_column_of_the_formula(text: str, problem: str) -> None:
    with pytest.raises(ExpressionError) as caught:
        compute(text, x=X, phase=(X[0], np.array(["a"] * 5)))
    assert problem in str(caught.value)


@pytest.mark.parametrize(
    ("column", "problem"),
    [
        ((np.array([0.0, 1.0]), np.zeros(2)), "expected times as int64 nanoseconds, found float64"),
        ((np.array([0], np.uint64), np.zeros(1)), "int64 nanoseconds, found uint64"),
        ((np.array([0, 1]), np.zeros(3)), r"expected as many times .* found \(2,\) and \(3,\)"),
        ((np.array([], np.int64), np.zeros(0)), "must not be empty"),
        ((np.array([0, 2, 1]), np.zeros(3)), "do not decrease, found 1 after 2 at row 2"),
    ],
)
def test_columns_that_are_no_signal_are_refused(column: Column, problem: str) -> None:
    with pytest.raises(CheckError, match=f"^signal 'x': .*{problem}"):
        compute("x > 1", x=column)


def test_a_window_before_the_first_value_is_refused() -> None:
    expression = parse_expression("x > 1")
    with pytest.raises(CheckError, match="expected a value at -5 ns, found its first at 0 ns"):
        compute_robustness({"x": X}, expression, window_ns=(-5, 10))
    with pytest.raises(CheckError, match="expected an end after its start, found 9, 8"):
        compute_robustness({"x": X}, expression, window_ns=(9, 8))


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 8, 9, 10, 99, 1000])
def test_until_is_right_for_every_length(count: int) -> None:
    rng = np.random.default_rng(count)
    held, coming = rng.normal(size=(2, count))
    times = np.arange(count) * SECOND_NS
    found = compute("a > 0 until b > 0", a=(times, held), b=(times, coming))
    expected: list[float] = []
    after = -math.inf
    for left, right in zip(held[::-1], coming[::-1], strict=True):
        after = min(left, max(right, after))
        expected.insert(0, after)
    assert found.values.tolist() == expected


@pytest.mark.parametrize("length_s", [0.5, 3.0, 40.0, 900.0, 1200.0])
def test_long_uneven_windows_are_right(length_s: float) -> None:
    rng = np.random.default_rng(7)
    times = np.cumsum(rng.integers(1, 10**9, 2000))
    values = rng.normal(size=2000)
    found = compute(f"eventually[1, {1 + length_s}](x > 0)", x=(times, values))
    for at in rng.integers(times[0], times[-1], 300):
        first = np.searchsorted(times, at + 10**9, side="right") - 1
        last = np.searchsorted(times, at + 10**9 + round(length_s * 1e9), side="right")
        assert read_at(found, int(at)) == values[first:last].max()


def join_comparisons(count: int) -> str:
    return " and ".join(f"x < {number}" for number in range(count))


def test_a_formula_of_many_parts_is_refused_for_a_long_signal_before_it_fills_the_memory() -> None:
    count = 400_000
    x = np.arange(count) * SECOND_NS, np.zeros(count)
    assert len(compute(join_comparisons(18), x=x).values)
    expected = r"too many comparisons and operators for 400,000 samples\. Split it into several"
    with pytest.raises(CheckError, match=expected):
        compute(join_comparisons(21), x=x)
    assert len(compute(join_comparisons(200), x=X).values)
