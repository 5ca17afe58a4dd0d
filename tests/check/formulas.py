"""Random formulas and traces, and what the definitions, word by word, make of them.

All times and windows are whole numbers of half seconds, so that the moments at which a margin can
change are known beforehand.
"""

import math
from collections.abc import Callable, Mapping

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

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
    Until,
)

HALF_NS = 500_000_000

Column = tuple[NDArray[np.int64], NDArray[np.float64]]

small = st.integers(-6, 6).map(float)
constants = st.integers(0, 6).map(lambda value: Number(value=float(value)))
names = st.sampled_from(["x", "y"]).map(lambda name: Name(name=name))
numbers = (
    names
    | st.builds(Arithmetic, operator=st.sampled_from(["+", "-", "*"]), left=names, right=constants)
    | st.builds(Call, function=st.just("abs"), arguments=st.tuples(names))
)
comparisons = st.builds(
    Comparison,
    operators=st.sampled_from([("<",), ("<=",), (">",), (">=",), ("==",), ("!=",)]),
    operands=st.tuples(numbers, numbers | constants),
)
windows = st.one_of(
    st.tuples(st.integers(0, 8), st.integers(0, 15)).map(lambda pair: (pair[0], sum(pair))),
    st.tuples(st.integers(0, 8), st.just(math.inf)),
)


def build_formulas(below: st.SearchStrategy[Node]) -> st.SearchStrategy[Node]:
    return st.one_of(
        st.builds(
            Logic,
            operator=st.sampled_from(["and", "or", "implies"]),
            operands=st.tuples(below, below),
        ),
        st.builds(Prefix, operator=st.just("not"), operand=below),
        windows.flatmap(lambda ends: build_temporal(below, *ends)),
    )


def build_temporal(
    below: st.SearchStrategy[Node], first: int, last: float
) -> st.SearchStrategy[Node]:
    window = {"start_s": st.just(first / 2), "end_s": st.just(last / 2)}
    operators = st.sampled_from(["always", "eventually"])
    return st.one_of(
        st.builds(Temporal, operator=operators, operand=below, **window),
        st.builds(Until, left=below, right=below, **window),
    )


formulas = st.recursive(comparisons, build_formulas, max_leaves=5)


@st.composite
def columns(draw: st.DrawFn) -> Column:
    """A signal from time 0 on, at uneven times."""
    gaps = draw(st.lists(st.integers(1, 5), max_size=8))
    times = np.cumsum([0, *gaps]).astype(np.int64) * HALF_NS
    values = draw(st.lists(small, min_size=len(times), max_size=len(times)))
    return times, np.array(values)


signals = st.fixed_dictionaries({"x": columns(), "y": columns()})


class Definition:
    """A formula's margin (or, of truths, 1 and -1) at a time in half seconds, by definition."""

    def __init__(self, node: Node, trace: Mapping[str, Column], *, truth: bool = False) -> None:
        self.node, self.trace, self.truth = node, trace, truth
        self.last = max(int(times[-1]) // HALF_NS for times, _ in trace.values())
        self.found: dict[tuple[int, int], float] = {}

    def __call__(self, time: int) -> float:
        return self.at(self.node, time)

    def at(self, part: Node, time: int) -> float:
        time = min(time, self.last)  # after the last step everything is constant
        if (id(part), time) not in self.found:
            self.found[id(part), time] = self.compute(part, time)
        return self.found[id(part), time]

    def compute(self, part: Node, time: int) -> float:
        if isinstance(part, Comparison):
            left, right = (read_number(side, self.trace, time) for side in part.operands)
            return compare(left, part.operators[0], right, truth=self.truth)
        if isinstance(part, Prefix):
            return -self.at(part.operand, time)
        if isinstance(part, Logic):
            return JOINS[part.operator](*(self.at(side, time) for side in part.operands))
        assert isinstance(part, Temporal | Until)
        first = time + int(part.start_s * 2)
        unbounded = math.isinf(part.end_s)
        end = max(first, self.last) if unbounded else time + int(part.end_s * 2)
        if isinstance(part, Until):
            return max(
                min(self.at(part.right, now), self.hold(part.left, time, now))
                for now in range(first, end + 1)
            )
        return JOINS[part.operator](*(self.at(part.operand, now) for now in range(first, end + 1)))

    def hold(self, part: Node, first: int, end: int) -> float:
        return min(self.at(part, now) for now in range(first, end + 1))


def smallest(*margins: float) -> float:
    return min(margins)


def largest(*margins: float) -> float:
    return max(margins)


JOINS: dict[str, Callable[..., float]] = {
    "and": smallest,
    "or": largest,
    "always": smallest,
    "eventually": largest,
    "implies": lambda left, right: max(-left, right),
}


def read_number(node: Node, trace: Mapping[str, Column], time: int) -> float:
    if isinstance(node, Number):
        return node.value
    if isinstance(node, Name):
        times, values = trace[node.name]
        return float(values[np.flatnonzero(times <= time * HALF_NS)[-1]])
    if isinstance(node, Call):
        return abs(read_number(node.arguments[0], trace, time))
    assert isinstance(node, Arithmetic)
    left, right = (read_number(side, trace, time) for side in (node.left, node.right))
    return {"+": left + right, "-": left - right, "*": left * right}[node.operator]


def compare(left: float, operator: str, right: float, *, truth: bool) -> float:
    distance = right - left if operator in {"<", "<="} else left - right
    if operator == "==":
        distance = -abs(left - right)
    if operator == "!=":
        distance = abs(left - right)
    if not truth:
        return distance
    return 1.0 if distance > 0 or (distance == 0 and operator in {"<=", ">=", "=="}) else -1.0


def write_for_rtamt(node: Node) -> str:
    """Return a formula as rtamt writes it; every part in parentheses."""
    if isinstance(node, Number):
        return repr(node.value)
    if isinstance(node, Name):
        return node.name
    sides = [write_for_rtamt(child) for child in node.list_children()]
    if isinstance(node, Call):
        return f"abs({sides[0]})"
    if isinstance(node, Prefix):
        return f"(not ({sides[0]}))"
    if isinstance(node, Temporal):
        return f"({node.operator}{write_window(node)} ({sides[0]}))"
    word = f" {find_word(node)} "
    return f"({word.join(f'({side})' for side in sides)})"


def find_word(node: Node) -> str:
    if isinstance(node, Until):
        return f"until{write_window(node)}"
    if isinstance(node, Comparison):
        return node.operators[0].replace("!=", "!==")
    assert isinstance(node, Logic | Arithmetic)
    return "->" if node.operator == "implies" else node.operator


def write_window(node: Temporal | Until) -> str:
    """Without an end is up to 100 s there, which is beyond all traces, unless it begins at 0."""
    if (node.start_s, node.end_s) == (0.0, math.inf):
        return ""
    return f"[{node.start_s}:{min(node.end_s, 100.0)}]"
