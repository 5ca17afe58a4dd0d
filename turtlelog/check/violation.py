"""When a formula is first violated."""

import math

from turtlelog.check.deciding import clip_window
from turtlelog.check.robustness import Margins
from turtlelog.check.signals import Trace
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
        if not isinstance(node, Temporal | Until):
            return self._trace.start_ns
        start_ns, end_ns = clip_window(node, self._trace.start_ns, self._trace)
        if isinstance(node, Temporal):
            is_always = node.operator == "always"
            return self._find_failure(node.operand, start_ns, end_ns) if is_always else end_ns
        failed_ns = self._find_failure(node.left, self._trace.start_ns, end_ns)
        return end_ns if failed_ns is None else failed_ns

    def _find_failure(self, node: Node, start_ns: int, end_ns: int) -> int | None:
        cut = self._truths.compute(node).cut(start_ns, end_ns)
        failed = cut.values < 0
        return int(cut.time_ns[failed.argmax()]) if failed.any() else None
