"""Random expressions, and what Python's own operators make of them."""

import math
import operator
from collections.abc import Callable, Mapping
from typing import Any

from hypothesis import strategies as st

from turtlelog.expressions import (
    Arithmetic,
    Call,
    Comparison,
    Logic,
    Name,
    Node,
    Number,
    Prefix,
    Temporal,
    Text,
    Truth,
    Until,
)

NUMBERS = ["a", "b", "law.kp_linear"]
TRUTHS = ["p", "q", "law.wrap_error"]
SPECIAL = st.sampled_from([0.0, 0.5, 1.0, 2.0, 3.0, 10.0, 1e-3, 1e308, math.inf])
POSITIVE = SPECIAL | st.floats(min_value=0.0, max_value=1e6)

OPERATORS: dict[str, Callable[[Any, Any], Any]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
    "**": operator.pow,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
FUNCTIONS: dict[str, Callable[..., Any]] = {
    "abs": abs,
    "min": min,
    "max": max,
    "sqrt": math.sqrt,
    "sin": math.sin,
    "cos": math.cos,
    "atan2": math.atan2,
    "hypot": math.hypot,
    "deg": math.degrees,
    "rad": math.radians,
    "log": math.log,
}
ARITY = {"min": (2, 4), "max": (2, 4), "atan2": (2, 2), "hypot": (2, 2)}

NUMBER_LEAVES = st.builds(Number, value=POSITIVE) | st.builds(Name, name=st.sampled_from(NUMBERS))
TRUTH_LEAVES = st.builds(Truth, value=st.booleans()) | st.builds(Name, name=st.sampled_from(TRUTHS))
TEXTS = st.builds(Text, value=st.text(st.characters(exclude_characters="'\n"), max_size=5))


EXACT = ("+", "-", "*", "/", "abs", "min", "max", "sqrt")
"""What IEEE 754 rounds correctly: every implementation gives the same bits."""


def build_numbers(
    below: st.SearchStrategy[Node], words: tuple[str, ...] = (*OPERATORS, *FUNCTIONS)
) -> st.SearchStrategy[Node]:
    signs = [word for word in words if word in {"+", "-", "*", "/", "**"}]
    functions = [word for word in words if word in FUNCTIONS]
    return st.one_of(
        st.builds(Arithmetic, operator=st.sampled_from(signs), left=below, right=below),
        st.builds(Prefix, operator=st.just("-"), operand=below),
        st.sampled_from(functions).flatmap(lambda name: build_call(name, below)),
    )


def build_call(name: str, below: st.SearchStrategy[Node]) -> st.SearchStrategy[Node]:
    least, most = ARITY.get(name, (1, 1))
    arguments = st.lists(below, min_size=least, max_size=most).map(tuple)
    return st.builds(Call, function=st.just(name), arguments=arguments)


def build_comparison(numbers: st.SearchStrategy[Node]) -> st.SearchStrategy[Node]:
    signs = st.sampled_from(["<", "<=", ">", ">=", "==", "!="])
    return st.lists(signs, min_size=1, max_size=3).flatmap(
        lambda found: st.builds(
            Comparison,
            operators=st.just(tuple(found)),
            operands=st.tuples(*[numbers] * (len(found) + 1)),
        )
    )


def build_truths(below: st.SearchStrategy[Node]) -> st.SearchStrategy[Node]:
    joined = st.builds(
        Logic,
        operator=st.sampled_from(["and", "or"]),
        operands=st.lists(below, min_size=2, max_size=4).map(tuple),
    )
    implied = st.builds(Logic, operator=st.just("implies"), operands=st.tuples(below, below))
    return joined | implied | st.builds(Prefix, operator=st.just("not"), operand=below)


def build_temporal(below: st.SearchStrategy[Node]) -> st.SearchStrategy[Node]:
    window = st.tuples(st.floats(0, 1e3), st.floats(0, 1e3) | st.just(math.inf)).map(sorted)
    return window.flatmap(
        lambda ends: st.one_of(
            st.builds(
                Temporal,
                operator=st.sampled_from(["always", "eventually"]),
                start_s=st.just(ends[0]),
                end_s=st.just(ends[1]),
                operand=below,
            ),
            st.builds(
                Until, start_s=st.just(ends[0]), end_s=st.just(ends[1]), left=below, right=below
            ),
        )
    )


numbers = st.recursive(NUMBER_LEAVES, build_numbers, max_leaves=8)
exact_numbers = st.recursive(NUMBER_LEAVES, lambda below: build_numbers(below, EXACT), max_leaves=8)
truths = st.recursive(TRUTH_LEAVES | build_comparison(exact_numbers), build_truths, max_leaves=8)
temporal = st.recursive(
    TRUTH_LEAVES | build_comparison(numbers | TEXTS),
    lambda below: build_truths(below) | build_temporal(below),
    max_leaves=8,
)


def compute_with_python(node: Node, values: Mapping[str, Any]) -> Any:
    """Return what Python's operators, one by one, make of a tree; None is unknown."""
    if isinstance(node, Number | Truth):
        return node.value
    if isinstance(node, Name):
        return values[node.name]
    parts = [compute_with_python(child, values) for child in node.list_children()]
    if isinstance(node, Comparison):
        pairs = zip(parts, node.operators, parts[1:], strict=False)
        return conjoin([apply(OPERATORS[sign], left, right) for left, sign, right in pairs])
    if isinstance(node, Logic):
        return join(node.operator, parts)
    return apply(find_function(node), *parts)


def find_function(node: Node) -> Callable[..., Any]:
    if isinstance(node, Arithmetic):
        return OPERATORS[node.operator]
    if isinstance(node, Call):
        return FUNCTIONS[node.function]
    assert isinstance(node, Prefix)
    return operator.neg if node.operator == "-" else operator.not_


def apply(function: Callable[..., Any], *parts: Any) -> Any:
    """Return a result; None where a part has none, Python refuses, or a pole is infinite."""
    if None in parts:
        return None
    try:
        found = function(*parts)
    except (ZeroDivisionError, OverflowError, ValueError):
        return None
    if isinstance(found, bool):
        return found
    if isinstance(found, complex) or math.isnan(found):
        return None
    return None if math.isinf(found) and not any(map(math.isinf, parts)) else found


def join(operator_: str, parts: list[Any]) -> Any:
    if operator_ == "implies":
        return join("or", [apply(operator.not_, parts[0]), parts[1]])
    if operator_ == "and":
        return conjoin(parts)
    return apply(operator.not_, conjoin([apply(operator.not_, part) for part in parts]))


def conjoin(parts: list[Any]) -> Any:
    if False in parts:
        return False
    return None if None in parts else True
