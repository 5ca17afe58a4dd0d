"""When a formula is first violated."""

import math
from dataclasses import replace

from turtlelog.check.deciding import clip_window
from turtlelog.check.robustness import Margins, convert_window
from turtlelog.check.signals import Trace
from turtlelog.expressions import Expression, Logic, Node, Prefix, Temporal, Until


def find_first_violation(expression: Expression, trace: Trace) -> int | None:
    """Return the first time at which a formula is violated [ns], None where it holds.

    Of `always` this is the first time in its window at which its body fails; of `eventually`, the
    end of its window, when what was to come has not; of `until`, the end of its window or the
    first time at which its left side fails, whichever comes first; of `and`, the first of any
    part's; of `or`, the last of its parts'; of `implies`, the right side's; of anything else, the
    beginning. `not always` is an `eventually not`, and `not eventually` an `always not`. A window
    that reaches beyond the trace's end ends there; where it begins beyond, no time of the trace
    violates it: None. Unknown parts count as well as they can: None unless it surely fails.
    """
    return _Search(expression, trace).find(expression.root)


class _Search:
    def __init__(self, expression: Expression, trace: Trace) -> None:
        self._truths = Margins(expression, trace, exact=True, unknown=math.inf)
        self._trace = trace

    def find(self, node: Node) -> int | None:
        """Return the first violation of part of the formula that is to hold at the start."""
        node = _turn_inside_out(node)
        if not self._truths.compute(node).values[0] < 0:
            return None
        if isinstance(node, Logic):
            return self._find_in_logic(node)
        if not isinstance(node, Temporal | Until):
            return self._trace.start_ns
        start_ns, end_ns = clip_window(node, self._trace.start_ns, self._trace)
        is_beyond = self._trace.start_ns + convert_window(node)[0] > self._trace.end_ns
        last_ns = None if is_beyond else end_ns
        if isinstance(node, Until):
            failed_ns = self._find_failure(node.left, self._trace.start_ns, end_ns)
            return last_ns if failed_ns is None else failed_ns
        if node.operator == "eventually" or is_beyond:
            return last_ns
        return self._find_failure(node.operand, start_ns, end_ns)

    def _find_in_logic(self, node: Logic) -> int | None:
        parts = node.operands[1:] if node.operator == "implies" else node.operands
        found = [self.find(part) for part in parts]
        known = [time_ns for time_ns in found if time_ns is not None]
        if node.operator == "or":
            return max(known) if len(known) == len(found) else None
        return min(known, default=None)

    def _find_failure(self, node: Node, start_ns: int, end_ns: int) -> int | None:
        cut = self._truths.compute(node).cut(start_ns, end_ns)
        failed = cut.values < 0
        return int(cut.time_ns[failed.argmax()]) if failed.any() else None


def _turn_inside_out(node: Node) -> Node:
    """Return `not always[...] f` as `eventually[...] not f`, and the other way round."""
    if not (isinstance(node, Prefix) and isinstance(node.operand, Temporal)):
        return node
    window = node.operand
    return replace(
        window,
        operator="eventually" if window.operator == "always" else "always",
        operand=replace(node, operand=window.operand),
    )
