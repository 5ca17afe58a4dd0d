"""A comparison inside a formula, and the band in which it requires a measured value to stay."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.charts.curves import Curve
from turtlelog.check.formula import find_formula_unit
from turtlelog.check.formula_trace import FormulaTrace
from turtlelog.check.robustness import walk_formula
from turtlelog.expressions import (
    Call,
    Comparison,
    Expression,
    Kind,
    Logic,
    Name,
    Node,
    Prefix,
    Temporal,
    Until,
    evaluate_node,
    format_expression,
    iterate_nodes,
)
from turtlelog.measure import MIRRORED, list_signals
from turtlelog.run import Run

Values = NDArray[np.float64]

_TURNED: Final = {"<": ">=", "<=": ">", ">": "<=", ">=": "<", "==": "!=", "!=": "=="}
"""Required operator, by the operator of a comparison that must be false."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Place:
    """The operators above a part of a formula.

    Attributes:
        is_denied: Whether the formula requires the part to be false.
        start_s: Earliest time at which the part is required, from the beginning [s].
        end_s: Latest time at which the part is required [s].
        body: Part below the innermost window; None if the part is not below `always` alone.
        is_body_denied: Whether the formula requires the body to be false.
        windows: Number of windows above the part.
        beside: Comparisons that are required together with this part.
    """

    is_denied: bool = False
    start_s: float = 0.0
    end_s: float = 0.0
    body: Node | None = None
    is_body_denied: bool = False
    windows: int = 0
    beside: tuple[Comparison, ...] = ()

    def enter(self, node: Temporal) -> "_Place":
        is_always = (node.operator == "always") is not self.is_denied
        is_first = is_always and not self.windows
        return _Place(
            is_denied=self.is_denied,
            start_s=self.start_s + node.start_s,
            end_s=self.end_s + node.end_s,
            body=node.operand if is_first else None,
            is_body_denied=self.is_denied,
            windows=self.windows + 1,
        )

    def deny(self) -> "_Place":
        return replace(self, is_denied=not self.is_denied, beside=())


@dataclass(frozen=True, slots=True, kw_only=True)
class Leaf:
    """A comparison in a formula, and the operators above it."""

    node: Comparison
    place: _Place

    def list_links(self) -> list[str]:
        """Return the two-sided comparisons, as results name them."""
        return [format_expression(link) for link in _split(self.node)]

    def find_failing(
        self, formula: Expression, trace: FormulaTrace, time_ns: NDArray[np.int64]
    ) -> NDArray[np.bool_]:
        """Return the times at which the comparison is required and the formula fails."""
        first_ns = trace.start_ns + self.place.start_s * 1e9
        last_ns = min(trace.start_ns + self.place.end_s * 1e9, trace.end_ns)
        asked = (time_ns >= first_ns) & (time_ns <= last_ns)
        if self.place.body is None:
            return np.asarray(asked)
        margins = walk_formula(replace(formula, root=self.place.body), trace, exact=True).margins
        pieces = np.searchsorted(margins.time_ns, time_ns, side="right") - 1
        failing = margins.values[np.maximum(pieces, 0)] * (
            -1.0 if self.place.is_body_denied else 1.0
        )
        return np.asarray(asked & (failing < 0.0))


def _split(node: Comparison) -> Iterator[Comparison]:
    for operator, left, right in zip(
        node.operators, node.operands, node.operands[1:], strict=False
    ):
        yield Comparison(operators=(operator,), operands=(left, right))


def list_leaves(node: Node, place: _Place = _Place()) -> Iterator[Leaf]:
    """Yield the comparisons of a formula, with the operators above each."""
    match node:
        case Comparison():
            beside = tuple(one for one in place.beside if one is not node)
            yield Leaf(node=node, place=replace(place, beside=beside))
        case Temporal(operand=operand):
            yield from list_leaves(operand, place.enter(node))
        case Until():
            for side in node.list_children():
                window = Temporal(operator="eventually", end_s=node.end_s, operand=side)
                yield from list_leaves(side, place.enter(window))
        case Logic(operands=operands):
            both = "or" if place.is_denied else "and"
            together = [one for one in operands if isinstance(one, Comparison)]
            beside = tuple(together) if node.operator == both else ()
            for number, operand in enumerate(operands):
                is_condition = node.operator == "implies" and number == 0
                inner = replace(place.deny() if is_condition else place, beside=beside)
                yield from list_leaves(operand, inner)
        case Prefix(operator="not", operand=operand):
            yield from list_leaves(operand, place.deny())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Band:
    """A measured side as a curve, its limits, the rows beyond the limits, and their excess."""

    name: str
    unit: str
    curve: Curve
    low: Values | None
    high: Values | None
    excess: Values
    is_beyond: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Ends:
    """Ends of a band, None for no end, and whether an end is excluded."""

    low: Values | None = None
    high: Values | None = None
    is_strict: bool = False

    def narrow(self, other: "_Ends") -> "_Ends":
        """Return the intersection of both bands."""
        lows = [end for end in (self.low, other.low) if end is not None]
        highs = [end for end in (self.high, other.high) if end is not None]
        return _Ends(
            low=np.fmax.reduce(lows) if lows else None,
            high=np.fmin.reduce(highs) if highs else None,
            is_strict=self.is_strict or other.is_strict,
        )


class BandReader:
    """Reader of a comparison's measured value and its limits, at the rows of the signals."""

    def __init__(
        self, run: Run, formula: Expression, leaf: Leaf, signals: Mapping[str, Any]
    ) -> None:
        self._run, self._formula, self._leaf = run, formula, leaf
        columns = {
            name: signals[name]
            for name in _list_names(leaf.node)
            if isinstance(signals.get(name), tuple)
        }
        self._signals = columns
        longest = max(columns.values(), key=lambda column: len(column[0]))[0]
        others = [time_ns for time_ns, _ in columns.values()]
        one = all(np.array_equal(time_ns, longest) for time_ns in others)
        self._time_ns = longest if one else np.unique(np.concatenate(others))
        start_ns = max(int(time_ns[0]) for time_ns in others)
        self._time_ns = self._time_ns[self._time_ns >= start_ns]
        self._values = {
            name: signals.get(name) if name not in columns else self._hold(*columns[name])
            for name in formula.names
        }

    def _hold(self, time_ns: NDArray[np.int64], values: NDArray[Any]) -> NDArray[Any]:
        return values[np.searchsorted(time_ns, self._time_ns, side="right") - 1]

    def read(self, decided_by: str) -> Band | None:
        """Return the band of the deciding comparison, with its other end, if any."""
        links = [*_split(self._leaf.node)]
        decisive = next(link for link in links if format_expression(link) == decided_by)
        # The side that changes with time; the first side if both change.
        left, right = decisive.operands
        measured = left if names_signals(left, self._signals) else right
        is_magnitude, bare = False, measured
        if isinstance(measured, Call) and measured.function == "abs":
            is_magnitude, bare = True, measured.arguments[0]
        shown = self._evaluate(bare)
        if shown is None:
            return None
        ends = self._find_ends(links, measured, is_magnitude=is_magnitude)
        if ends is None:
            return None
        for link in (part for node in self._leaf.place.beside for part in _split(node)):
            names = [name for name in _list_names(link) if name not in self._signals]
            if any(isinstance(self._values[name], tuple) for name in names):
                continue  # it uses other signals than the deciding comparison
            more = self._find_ends([link], measured, is_magnitude=is_magnitude)
            ends = ends if more is None else ends.narrow(more)
        low, high, excess = ends.low, ends.high, np.full(len(shown), -np.inf)
        excess = excess if high is None else np.fmax(excess, shown - high)
        excess = excess if low is None else np.fmax(excess, low - shown)
        unit, factor = find_scale(self._find_unit(measured))
        known = list_signals(self._run.declaration)
        curve = Curve(
            start_ns=self._run.start_ns,
            time_ns=self._time_ns,
            values=shown * factor,
            # In steps if one of its signals is held.
            holds=any(
                known[name].resampling == "hold" for name in _list_names(bare) if name in known
            ),
        )
        return Band(
            name=format_expression(bare),
            unit=unit,
            curve=curve,
            low=None if low is None else low * factor,
            high=None if high is None else high * factor,
            excess=excess * factor,
            is_beyond=excess >= 0.0 if ends.is_strict else excess > 0.0,
        )

    def _find_ends(
        self, links: Sequence[Comparison], measured: Node, *, is_magnitude: bool
    ) -> "_Ends | None":
        """Return the ends that comparisons require; None if a comparison requires anything else."""
        ends = _Ends()
        for link in links:
            if measured not in link.operands:
                continue
            operator, limit = self._read_link(link, measured)
            if limit is None or operator in {"==", "!="}:
                return None
            if operator in {">", ">="} and is_magnitude:
                return None
            is_high = operator in {"<", "<="}
            high = limit if is_high else None
            low = (-limit if is_magnitude else None) if is_high else limit
            ends = ends.narrow(_Ends(low=low, high=high, is_strict=operator in {"<", ">"}))
        return ends

    def _read_link(self, link: Comparison, measured: Node) -> tuple[str, Values | None]:
        operator: str = link.operators[0]
        if link.operands[0] != measured:
            operator, limit = MIRRORED[operator], link.operands[0]
        else:
            limit = link.operands[1]
        return _TURNED[operator] if self._leaf.place.is_denied else operator, self._evaluate(limit)

    def _evaluate(self, node: Node) -> Values | None:
        found = evaluate_node(self._formula, node, self._values)
        if found.kind is not Kind.NUMBER:
            return None
        return np.broadcast_to(np.asarray(found.data, np.float64), self._time_ns.shape).copy()

    def _find_unit(self, node: Node) -> str:
        """Return the unit of the measured value; for a sum, the common unit of its parts."""
        if isinstance(node, Call) and node.function == "deg":
            return "deg"
        if isinstance(node, Call) and node.function not in {"abs", "min", "max"}:
            return ""
        if isinstance(node, Name):
            return find_formula_unit(node.name, self._run.declaration) or ""
        operator = getattr(node, "operator", "")
        children = node.list_children()
        if operator in {"*", "/", "**"} or not children:
            return ""
        found = {self._find_unit(child) for child in children if _list_names(child)}
        return found.pop() if len(found) == 1 else ""


def _list_names(node: Node) -> list[str]:
    return [part.name for part in iterate_nodes(node) if isinstance(part, Name)]


def names_signals(node: Node, signals: Mapping[str, Any]) -> bool:
    """Return whether any node below a node is a signal."""
    return any(isinstance(signals.get(name), tuple) for name in _list_names(node))


def find_scale(unit: str) -> tuple[str, float]:
    """Return the unit in which a check's message shows values, and its conversion factor."""
    return ("deg", math.degrees(1.0)) if unit == "rad" else (unit, 1.0)
