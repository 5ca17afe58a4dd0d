"""The comparison and the moment from which a formula's margin comes, however deep it stands."""

from dataclasses import dataclass

import numpy as np

from turtlelog.check.robustness import Margins, convert_window
from turtlelog.check.signals import Trace
from turtlelog.check.steps import Steps, align_steps
from turtlelog.expressions import Comparison, Logic, Node, Prefix, Temporal, Until


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """Where a margin comes from.

    Attributes:
        node: A comparison of two sides, or what is true or false by itself.
        time_ns: When its margin is that of the whole [ns].
    """

    node: Node
    time_ns: int


def find_decision(margins: Margins, root: Node, trace: Trace) -> Decision:
    """Return where the margin at the beginning of a trace comes from; of several places the first.

    Args:
        margins: Known at the beginning.
        root: The whole formula.
        trace: That the margins are of.
    """
    return _Descent(margins, trace).find(root, 1, trace.start_ns)


class _Descent:
    def __init__(self, margins: Margins, trace: Trace) -> None:
        self._margins, self._trace = margins, trace

    def find(self, node: Node, sign: int, time_ns: int) -> Decision:
        match node:
            case Prefix(operator="not", operand=operand):
                return self.find(operand, -sign, time_ns)
            case Logic():
                return self._find_in_logic(node, sign, time_ns)
            case Temporal(operator=operator, operand=operand):
                body = self._margins.compute(operand, sign).cut(*self._clip(node, time_ns))
                best = np.argmin(body.values) if operator == "always" else np.argmax(body.values)
                return self.find(operand, sign, int(body.time_ns[best]))
            case Until():
                return self._find_in_until(node, sign, time_ns)
            case Comparison(operators=operators, operands=operands) if len(operators) > 1:
                pairs = zip(operators, operands, operands[1:], strict=False)
                links = [Comparison(operators=(op,), operands=(a, b)) for op, a, b in pairs]
                least = min(links, key=lambda link: self._read(link, sign, time_ns))
                return Decision(node=least, time_ns=time_ns)
        return Decision(node=node, time_ns=time_ns)

    def _read(self, node: Node, sign: int, time_ns: int) -> float:
        found = self._margins.compute(node, sign)
        return float(found.values[found.find_piece(time_ns)])

    def _find_in_logic(self, node: Logic, sign: int, time_ns: int) -> Decision:
        whole = self._read(node, sign, time_ns)
        *others, last = node.operands
        if node.operator == "implies":
            others = [Prefix(operator="not", operand=others[0])]
        for part in others:
            if self._read(part, sign, time_ns) == whole:
                return self.find(part, sign, time_ns)
        return self.find(last, sign, time_ns)

    def _find_in_until(self, node: Until, sign: int, time_ns: int) -> Decision:
        start_ns, end_ns = self._clip(node, time_ns)
        sides = [self._margins.compute(side, sign) for side in (node.left, node.right)]
        left, right = (side.cut(time_ns, end_ns) for side in sides)
        marks = np.unique([time_ns, start_ns])
        begun = Steps(time_ns=marks, values=marks >= start_ns)
        times, (held, coming, is_open) = align_steps([left, right, begun])
        lasting = np.minimum.accumulate(held)
        reached = np.where(is_open, np.minimum(lasting, coming), -np.inf)
        best = int(np.argmax(reached))
        if coming[best] <= lasting[best]:
            return self.find(node.right, sign, int(times[best]))
        return self.find(node.left, sign, int(times[np.argmin(held[: best + 1])]))

    def _clip(self, node: Temporal | Until, time_ns: int) -> tuple[int, int]:
        return clip_window(node, time_ns, self._trace)


def clip_window(node: Temporal | Until, time_ns: int, trace: Trace) -> tuple[int, int]:
    """Return the window of a node as it stands at a time [ns], cut at the end of the trace."""
    first_ns, last_ns = convert_window(node)
    last_ns = trace.end_ns if last_ns is None else time_ns + last_ns
    return min(trace.end_ns, time_ns + first_ns), min(trace.end_ns, last_ns)
