"""Formula and signals -> margin at every moment: how far a formula is from changing its verdict.

The margin of `a <= b` is b - a, of `a == b` -|a - b|; and is the smaller, or the larger, not the
negative; what has no distance (texts, truths) has a margin of inf or -inf. Signals hold each value
until the next. After the end of a trace that is settled they hold the last one for ever; after any
other end what is said of them is unknown.
"""

import functools
import math
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.check.cut import Ending
from turtlelog.check.signals import Signals, Trace
from turtlelog.check.steps import (
    Steps,
    align_steps,
    combine_steps,
    compute_until,
    negate_steps,
    slide_maximum,
    slide_minimum,
)
from turtlelog.expressions import (
    Comparison,
    Expression,
    Kind,
    Logic,
    Name,
    Node,
    Operand,
    Prefix,
    Temporal,
    Until,
    check_comparison,
    compare_operands,
    evaluate_node,
    fail_at,
    iterate_nodes,
    require_kind,
)

Values = NDArray[np.float64]

_LONGEST_S: Final = 1e18
"""Beyond all traces."""


def compute_robustness(
    signals: Signals, expression: Expression, *, window_ns: tuple[int, int] | None = None
) -> Steps:
    """Return the margin of a formula at every moment of a trace.

    Positive where it holds, negative where it does not, nan where that is unknown.

    Args:
        signals: By name: (time_ns, values) of a signal, or a constant, None for no value. Times
            do not decrease; of values at one time the last one holds.
        expression: A formula, temporal or not.
        window_ns: First and last time [ns] of the trace; by default from the first moment at
            which every signal used has a value to the last time of any.

    Raises:
        ExpressionError: Where a name is not there or the kinds do not go together.
        CheckError: Where a signal is no signal, or has no value at the first time.
    """
    trace = Trace.open(signals, expression, window_ns=window_ns)
    return Margins(expression, trace).compute(expression.root)


class Margins:
    """The margins of a formula and its parts over one trace.

    Args:
        expression: A formula.
        trace: The signals that it names.
        exact: Whether to give 1 for true and -1 for false instead: this decides margins of 0,
            where `<` and `<=` differ.
        unknown: What an unknown part counts for: nan, which makes unknown what it touches; -inf,
            as badly for the whole formula as it can; or inf, as well as it can.
    """

    def __init__(
        self,
        expression: Expression,
        trace: Trace,
        *,
        exact: bool = False,
        unknown: float = math.nan,
    ) -> None:
        self._expression = expression
        self._trace = trace
        self._exact = exact
        self._unknown = unknown
        self._found: dict[tuple[int, int], tuple[Node, Steps]] = {}

    def compute(self, node: Node, sign: int = 1) -> Steps:
        """Return the margin of part of the formula at every moment.

        Args:
            node: Any part that is true or false.
            sign: -1 where the part counts against the formula: below `not`, left of `implies`.
        """
        key = id(node), sign
        if key not in self._found:
            # Kept beside its margin, a node keeps its id.
            self._found[key] = node, self._compute(node, sign)
        return self._found[key][1]

    def _compute(self, node: Node, sign: int) -> Steps:
        match node:
            case Logic(operator=operator, operands=operands):
                return self._join(operator, operands, sign)
            case Prefix(operator="not", operand=operand):
                return negate_steps(self.compute(operand, -sign))
            case Temporal(operator=operator, operand=operand):
                slide = slide_minimum if operator == "always" else slide_maximum
                return self._look_ahead(node, slide, [operand], sign)
            case Until(left=left, right=right):
                return self._look_ahead(node, compute_until, [left, right], sign)
        return self._compute_leaf(node, sign)

    def _join(self, operator: str, operands: tuple[Node, ...], sign: int) -> Steps:
        if operator == "implies":
            left, right = operands
            parts = [negate_steps(self.compute(left, -sign)), self.compute(right, sign)]
            return combine_steps(np.maximum, parts)
        parts = [self.compute(operand, sign) for operand in operands]
        return combine_steps(np.minimum if operator == "and" else np.maximum, parts)

    def _look_ahead(
        self, node: Temporal | Until, look: Callable[..., Steps], parts: list[Node], sign: int
    ) -> Steps:
        trace, (first_ns, last_ns) = self._trace, convert_window(node)
        sides = [self.compute(part, sign) for part in parts]
        if trace.ending is not Ending.UNDECLARED or last_ns is not None:
            return look(*sides, first_ns, last_ns)
        recorded = [side.cut(trace.start_ns, trace.end_ns) for side in sides]
        found = look(*recorded, first_ns, None)
        return found.end_with(sign * self._unknown, from_ns=trace.end_ns - first_ns + 1)

    def _compute_leaf(self, node: Node, sign: int) -> Steps:
        """Return the margin of a comparison or a truth by itself."""
        for part in iterate_nodes(node):
            if isinstance(part, Temporal | Until):
                fail_at(self._expression, part, "expected no temporal operator in a comparison")
        time_ns, values = self._read(node)
        if isinstance(node, Comparison):
            margins = self._compare(node, values)
        else:
            found = evaluate_node(self._expression, node, values)
            require_kind(self._expression, node, found, Kind.TRUTH)
            margins = self._weigh(found)
        if not math.isnan(self._unknown):
            margins = np.where(np.isnan(margins), sign * self._unknown, margins)
        steps = Steps(time_ns=time_ns, values=np.broadcast_to(margins, time_ns.shape))
        if self._trace.ending is Ending.SETTLED or not self._name_signals(node):
            return steps
        return steps.end_with(sign * self._unknown, from_ns=self._trace.end_ns + 1)

    def _name_signals(self, node: Node) -> list[str]:
        names = [part.name for part in iterate_nodes(node) if isinstance(part, Name)]
        return [name for name in names if name in self._trace.signals]

    def _read(self, node: Node) -> tuple[NDArray[np.int64], Mapping[str, Any]]:
        """Return the common steps of the signals below a node, and the values by name."""
        signals = {name: self._trace.signals[name] for name in self._name_signals(node)}
        if not signals:
            return np.array([self._trace.start_ns]), self._trace.constants
        time_ns, columns = align_steps(list(signals.values()))
        return time_ns, {**self._trace.constants, **dict(zip(signals, columns, strict=True))}

    def _compare(self, node: Comparison, values: Mapping[str, Any]) -> Values:
        operands = [evaluate_node(self._expression, part, values) for part in node.operands]
        check_comparison(self._expression, node, operands)
        pairs = zip(operands, node.operators, operands[1:], strict=False)
        margins = [self._measure(*pair) for pair in pairs]
        return functools.reduce(np.minimum, margins)

    def _measure(self, left: Operand, operator: str, right: Operand) -> Values:
        if self._exact or not {left.kind, right.kind} <= {Kind.NUMBER, Kind.UNKNOWN}:
            return self._weigh(compare_operands(left, operator, right))
        if operator in {">", ">="}:
            left, right = right, left
        with np.errstate(all="ignore"):
            margins = right.data - left.data
        margins = np.where(left.data == right.data, 0.0, margins)  # not inf - inf
        if operator in {"==", "!="}:
            return np.abs(margins) if operator == "!=" else -np.abs(margins)
        return margins

    def _weigh(self, truth: Operand) -> Values:
        """Return the margins of what is true or false and has no distance between."""
        weight = 1.0 if self._exact else math.inf
        margins = np.where(truth.data > 0, weight, -weight)
        return np.where(np.isnan(truth.data), np.nan, margins)


def convert_window(node: Temporal | Until) -> tuple[int, int | None]:
    """Return the ends of a node's window [ns], None for no end."""
    last_ns = None if math.isinf(node.end_s) else _convert(node.end_s)
    return _convert(node.start_s), last_ns


def _convert(time_s: float) -> int:
    return round(min(time_s, _LONGEST_S) * 1e9)
