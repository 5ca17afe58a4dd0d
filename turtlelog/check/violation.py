"""Where a formula is decided: the first time it is violated, and the time its margin comes from."""

import math

import numpy as np

from turtlelog.check.robustness import Margins, convert_window
from turtlelog.check.signals import Trace
from turtlelog.check.steps import Steps, Times, Values
from turtlelog.expressions import Expression, Logic, Node, Temporal, Until


def find_first_violation(expression: Expression, trace: Trace) -> int | None:
    """Return the first time at which a formula is violated [ns], None where it holds.

    Of `always` this is the first time in its window at which its body fails; of `eventually`, the
    end of its window, when what was to come has not; of `until`, the end of its window or the
    first time at which its left side fails, whichever comes first; of `and`, the first of any
    part's; of `implies`, the right side's; of anything else, the beginning. Times beyond the
    trace's end are its end. Unknown parts count as well as they can: None unless it surely fails.
    """
    return _Search(expression, trace).find(expression.root)


def find_margin_time(margins: Margins, root: Node, trace: Trace) -> int:
    """Return the first time from which a formula's margin comes [ns]."""
    node = _find_decisive(margins, root)
    start_ns, end_ns = _clip_window(node, trace)
    if not isinstance(node, Temporal):
        return start_ns
    body = margins.compute(node.operand)
    times, values = _cut(body, start_ns, end_ns)
    best = np.argmin(values) if node.operator == "always" else np.argmax(values)
    return int(times[best])


class _Search:
    def __init__(self, expression: Expression, trace: Trace) -> None:
        self._truths = Margins(expression, trace, exact=True, unknown=math.inf)
        self._trace = trace

    def find(self, node: Node) -> int | None:
        """Return the first violation of part of the formula that is to hold at the start."""
        if not self._truths.compute(node).values[0] < 0:
            return None
        if isinstance(node, Logic) and node.operator != "or":
            parts = node.operands if node.operator == "and" else node.operands[1:]
            found = [self.find(part) for part in parts]
            return min((time_ns for time_ns in found if time_ns is not None), default=None)
        start_ns, end_ns = _clip_window(node, self._trace)
        match node:
            case Temporal(operator="always", operand=operand):
                return self._find_failure(operand, start_ns, end_ns)
            case Temporal():
                return end_ns
            case Until(left=left):
                first_ns = self._trace.start_ns
                failed_ns = self._find_failure(left, first_ns, end_ns)
                return end_ns if failed_ns is None else failed_ns
        return start_ns

    def _find_failure(self, node: Node, start_ns: int, end_ns: int) -> int | None:
        times, values = _cut(self._truths.compute(node), start_ns, end_ns)
        failed = values < 0
        return int(times[failed.argmax()]) if failed.any() else None


def _find_decisive(margins: Margins, node: Node) -> Node:
    """Return the part of and, or, implies whose margin is the whole's, however deep."""
    whole = margins.compute(node).values[0]
    while isinstance(node, Logic):
        counted = node.operands[1:] if node.operator == "implies" else node.operands
        parts = [part for part in counted if margins.compute(part).values[0] == whole]
        if not parts:
            break
        node = parts[0]
    return node


def _clip_window(node: Node, trace: Trace) -> tuple[int, int]:
    """Return the window of a node at the trace's start, cut at its end; else the start twice."""
    if not isinstance(node, Temporal | Until):
        return trace.start_ns, trace.start_ns
    first_ns, last_ns = convert_window(node)
    end_ns = trace.end_ns if last_ns is None else min(trace.end_ns, trace.start_ns + last_ns)
    return min(trace.end_ns, trace.start_ns + first_ns), end_ns


def _cut(function: Steps, start_ns: int, end_ns: int) -> tuple[Times, Values]:
    """Return the steps of a function in a window, the first moved to its beginning."""
    first, last = function.find_piece(start_ns), function.find_piece(end_ns)
    times = np.maximum(function.time_ns[first : last + 1], start_ns)
    return times, function.values[first : last + 1]
