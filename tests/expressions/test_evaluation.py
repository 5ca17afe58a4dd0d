import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from tests.expressions.trees import (
    FUNCTIONS,
    NUMBERS,
    TRUTHS,
    apply,
    compute_with_python,
    exact_numbers,
    truths,
)
from turtlelog.errors import ExpressionError
from turtlelog.expressions import Node, evaluate_expression, format_expression, parse_expression

SOME_NUMBER = st.floats(-1e6, 1e6) | st.sampled_from([0.0, -0.0, 1e200, math.inf])
KNOWN_TRUTHS = dict.fromkeys(TRUTHS, st.booleans())
UNKNOWN_NUMBERS = dict.fromkeys(NUMBERS, st.none() | SOME_NUMBER)
VALUES = st.fixed_dictionaries(
    {**UNKNOWN_NUMBERS, **dict.fromkeys(TRUTHS, st.none() | st.booleans())}
)
ROWS = st.lists(st.fixed_dictionaries({**UNKNOWN_NUMBERS, **KNOWN_TRUTHS}), min_size=1, max_size=5)


def evaluate(text: str, **values: Any) -> Any:
    return evaluate_expression(parse_expression(text), values)


def agree(found: float | None, expected: float | None) -> bool:
    if found is None or expected is None:
        return found is expected
    return found == expected or math.isclose(found, expected, rel_tol=1e-12, abs_tol=1e-15)


@settings(deadline=None)
@given(exact_numbers | truths, VALUES)
def test_arithmetic_and_logic_are_those_of_python(tree: Node, values: dict[str, Any]) -> None:
    """Hypothesis makes deep expressions, which take long to draw."""
    found = evaluate_expression(parse_expression(format_expression(tree)), values)
    expected = compute_with_python(tree, values)
    assert found == expected
    assert (found is None) == (expected is None)


@settings(deadline=None)
@given(st.sampled_from(["sin", "cos", "deg", "rad", "log"]), SOME_NUMBER)
def test_functions_are_those_of_python(name: str, value: float) -> None:
    expected = apply(FUNCTIONS[name], value)
    assert agree(evaluate(f"{name}(x)", x=value), expected)


@settings(deadline=None)
@given(st.sampled_from(["atan2", "hypot"]), SOME_NUMBER, SOME_NUMBER)
def test_functions_of_two_are_those_of_python(name: str, left: float, right: float) -> None:
    expected = apply(FUNCTIONS[name], left, right)
    assert agree(evaluate(f"{name}(x, y)", x=left, y=right), expected)


@settings(deadline=None)
@given(st.floats(-50, 50), st.integers(-400, 400).map(float))
def test_powers_are_those_of_python(base: float, exponent: float) -> None:
    expected = apply(math.pow, base, exponent)
    assert agree(evaluate("x**y", x=base, y=exponent), expected)


@settings(deadline=None)
@given(truths | exact_numbers, ROWS)
def test_columns_give_what_their_rows_give(tree: Node, rows: list[dict[str, Any]]) -> None:
    """Hypothesis evaluates each expression over columns and row by row."""
    expression = parse_expression(format_expression(tree))
    expected = [evaluate_expression(expression, row) for row in rows]
    columns = {name: make_column([row[name] for row in rows]) for name in rows[0]}
    found = np.broadcast_to(evaluate_expression(expression, columns), len(rows))
    known = [None if isinstance(item, float) and math.isnan(item) else item for item in found]
    assert known == expected


def make_column(values: list[Any]) -> Any:
    return np.array([np.nan if value is None else value for value in values])


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("no > 1", None),
        ("not no > 1", None),
        ("no > 1 and false", False),
        ("no > 1 and true", None),
        ("no > 1 or true", True),
        ("no > 1 or false", None),
        ("false implies no > 1", True),
        ("no > 1 implies true", True),
        ("1 < no < 3", None),
        ("3 < 1 < no", False),
        ("no == no", None),
        ("no == 'a'", None),
        ("no + 1", None),
        ("no ** 0", None),
        ("1 ** no", None),
        ("no", None),
        ("min(no, 1)", None),
    ],
)
def test_what_has_no_value_stays_unknown(text: str, expected: object) -> None:
    assert evaluate(text, no=None) is expected


@pytest.mark.parametrize(
    "text",
    [
        "1 / 0",
        "0 / 0",
        "inf / 0",
        "0 ** -1",
        "10 ** 400",
        "1e308 * 10",
        "1e308 + 1e308",
        "sqrt(-1)",
        "log(0)",
        "log(-1)",
        "(-8) ** 0.5",
        "inf - inf",
        "0 * inf",
        "sin(inf)",
    ],
)
def test_poles_overflows_and_foreign_domains_have_no_value(text: str) -> None:
    assert evaluate(text) is None


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("inf", math.inf),
        ("-inf < 1 < inf", True),
        ("1 / inf", 0.0),
        ("deg(rad(90))", pytest.approx(90.0)),
        ("max(1, 3, 2)", 3.0),
        ("'rotate'", "rotate"),
        ("true", True),
        ("1 < 2 == true", None),
    ],
)
def test_constants_have_their_value(text: str, expected: Any) -> None:
    if expected is None:
        with pytest.raises(ExpressionError, match="column 7: expected two of a kind around =="):
            evaluate(text)
        return
    assert evaluate(text) == expected


def test_texts_and_truths_can_be_equal() -> None:
    values = {"name": "paper", "law.wrap_error": True}
    expression = parse_expression("name == 'paper' and law.wrap_error == true and name != 'x'")
    assert evaluate_expression(expression, values) is True


def test_a_column_with_unknown_rows_says_so() -> None:
    assert evaluate("x > 1", x=np.array([0.0, 2.0])).dtype == np.bool_
    assert evaluate("x > 1", x=np.array([0.0, np.nan, 2.0])).tolist() == [False, None, True]
    assert np.isnan(evaluate("1 / x", x=np.array([0.0]))).all()


def test_a_column_of_texts_is_compared_row_by_row() -> None:
    phases = np.array(["rotate", "translate"])
    assert evaluate("phase == 'rotate'", phase=phases).tolist() == [True, False]


@pytest.mark.parametrize(
    ("text", "column", "problem"),
    [
        ("n + 1 < t", 7, "expected two of a kind around <, found a number and a text"),
        ("t < t", 3, "expected numbers around <, found a text"),
        ("n < 1 < b", 7, "expected two of a kind around <, found a number and true or false"),
        ("b <= b", 3, "expected numbers around <=, found true or false"),
        ("n and b", 1, "expected true or false, found n, a number; compare it, for example n <= 2"),
        ("b and b and n + 1", 15, "expected true or false, found a number"),
        ("not t", 5, "expected true or false, found t, a text"),
        ("b implies 3", 11, "expected true or false, found a number"),
        ("n * (t + 1)", 6, "expected a number, found t, a text"),
        ("-b", 2, "expected a number, found b, true or false"),
        ("abs(n < 1)", 7, "expected a number, found true or false"),
        ("min(1, 'a')", 8, "expected a number, found a text"),
        ("always(b)", 1, "expected no always here: it needs signals over time"),
        ("b until[0, 1] b", 3, "expected no until here: it needs signals over time"),
        ("law.kp_liner > 1", 1, 'unknown name "law.kp_liner"; did you mean law.kp_linear'),
        ("1 < zzzzz", 5, 'unknown name "zzzzz"; there are n, t, b, law.kp_linear'),
        ("odd > 1", 1, "odd: expected a number, text or truth, found list"),
    ],
)
def test_wrong_kinds_and_names_are_found_with_their_column(
    text: str, column: int, problem: str
) -> None:
    values = {"n": 1, "t": "a", "b": True, "law.kp_linear": 2.0, "odd": [None]}
    with pytest.raises(ExpressionError) as caught:
        evaluate_expression(parse_expression(text, source="spec"), values)
    assert str(caught.value).startswith(f"spec: column {column}: {problem}")
    assert caught.value.column == column


def test_nothing_of_python_is_in_reach() -> None:
    for text in ("__import__('os').system('true')", "x.__class__.__mro__", "open('f')"):
        with pytest.raises(ExpressionError):
            evaluate_expression(parse_expression(text), {"x": 1})
