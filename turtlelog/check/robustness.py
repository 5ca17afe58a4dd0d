"""Robustness of a formula at every time: the distance from the opposite verdict.

The margin of `a <= b` is b - a, that of `a == b` is -|a - b|. `and` takes the minimum, `or` the
maximum, `not` the negative. Texts and truth values have a margin of inf or -inf. Signals keep each
value until the next value. After the end of a settled trace, signals keep the last value forever;
after any other end, they are unknown.
"""

import functools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from textwrap import shorten
from typing import Final, Protocol

import numpy as np

from turtlelog.check.formula_trace import (
    FormulaTrace,
    RunEnding,
    Signals,
    Steps,
    align_steps,
    combine_steps,
    compute_until,
    convert_window,
    list_names,
    negate_steps,
    slide_maximum,
    slide_minimum,
)
from turtlelog.errors import CheckError
from turtlelog.expressions import (
    Comparison,
    Expression,
    Kind,
    Logic,
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
from turtlelog.measure.reductions import Values


def compute_robustness(
    signals: Signals, expression: Expression, *, window_ns: tuple[int, int] | None = None
) -> Steps:
    """Return the margin of a formula at every time of a trace.

    The margin is positive if the formula holds, negative if it does not, and NaN if this is
    unknown.

    Args:
        signals: Mapping from a name to (time_ns, values) of a signal, or to a constant; None for no
            value. Times do not decrease. Of several values at one time, the last is used.
        expression: A formula, temporal or not.
        window_ns: First and last time of the trace [ns]. Default: from the first time at which
            every used signal has a value, to the last time of any signal.

    Raises:
        ExpressionError: If a name is unknown or operand types do not match.
        CheckError: If a signal is invalid, or has no value at the first time.
    """
    trace = FormulaTrace.open(signals, expression, window_ns=window_ns)
    return walk_formula(expression, trace).margins


@dataclass(frozen=True, slots=True, kw_only=True)
class CriticalPart:
    """A comparison or truth value whose margin at a time [ns] is that of the whole formula."""

    node: Node
    time_ns: int


class Part(Protocol):
    """A part of a formula, with its margins over the trace."""

    @property
    def margins(self) -> Steps:
        """Margin at every time."""

    def find_critical(self, time_ns: int) -> CriticalPart:
        """Return the origin of the part's margin at a time; the first of several origins."""

    def find_violation(self) -> int | None:
        """Return the first time at which a part required at the beginning is violated [ns].

        For `always`, the result is the first time in the window at which the body fails. For
        `eventually`, it is the end of the window; for `until`, the end of the window or the first
        failure of the left side, whichever is earlier. For `and`, it is the first time of the
        parts, for `or` the last, and for `implies` that of the right side. For any other part, it
        is the beginning. `not always` is an `eventually not`, and `not eventually` an `always not`.
        A window is cut at the trace's end. If a window begins beyond the end, no time of the trace
        violates it, and the result is None.
        """


_MOST_VALUES: Final = 8_000_000
"""Largest total number of values of a formula's parts: 130 MB including their times."""
_ANY_PARTS: Final = 20
"""Number of comparisons and operators that are always allowed, however long the recording is."""


def walk_formula(
    expression: Expression, trace: FormulaTrace, *, exact: bool = False, unknown: float = math.nan
) -> Part:
    """Return a formula with its margins over a trace; the options are those of `PartReader`."""
    return PartReader(expression, trace, exact=exact, unknown=unknown).visit(expression.root, 1)


class PartReader:
    """Builder of parts of a formula; parts are not stored, because their columns are long.

    With `exact`, 1 for true and -1 for false replace margins: this decides margins of 0, for which
    `<` and `<=` differ. An unknown part has the value `unknown`: NaN, which makes dependent parts
    unknown; -inf, the worst value for the whole formula; or inf, the best value.
    """

    def __init__(
        self, expression: Expression, trace: FormulaTrace, *, exact: bool, unknown: float
    ) -> None:
        self.trace = trace
        rows = max((len(steps.time_ns) for steps in trace.signals.values()), default=1)
        self._rows, self._left = rows, max(_MOST_VALUES, _ANY_PARTS * rows)
        self._expression, self._exact, self._unknown = expression, exact, unknown

    def visit(self, node: Node, sign: int) -> Part:
        """Return a part of the formula; `sign` is -1 below `not` and left of `implies`.

        Raises:
            CheckError: If the parts of the formula have too many values together.
        """
        part = self._make(node, sign)
        self._left -= len(part.margins.values)
        if self._left < 0:
            raise CheckError(
                f"the formula {shorten(self._expression.text, 60)} has too many comparisons and"
                f" operators for {self._rows:,} samples. Split it into several checks, or the"
                " recording into parts"
            )
        return part

    def _make(self, node: Node, sign: int) -> Part:
        match node:
            case Logic(operator="implies", operands=(left, right)):
                return _Joined("implies", [_Negated(self, left, sign), self.visit(right, sign)])
            case Logic(operator=operator, operands=operands):
                return _Joined(operator, [self.visit(operand, sign) for operand in operands])
            case Prefix(operator="not", operand=operand):
                return _Negated(self, operand, sign)
            case Temporal():
                return _Windowed(self, node, sign)
            case Until():
                return _Until(self, node, sign)
        return _Leaf(self, node, sign)

    def look_ahead(
        self, node: Temporal | Until, look: Callable[..., Steps], sides: list[Steps], sign: int
    ) -> Steps:
        """Return the result of a window over margins at every time."""
        trace, (first_ns, last_ns) = self.trace, convert_window(node)
        if trace.ending is not RunEnding.UNDECLARED or last_ns is not None:
            return look(*sides, first_ns, last_ns)
        recorded = [side.cut(trace.start_ns, trace.end_ns) for side in sides]
        found = look(*recorded, first_ns, None)
        return found.end_with(sign * self._unknown, from_ns=trace.end_ns - first_ns + 1)

    def clip_window(self, node: Temporal | Until, time_ns: int) -> tuple[int, int]:
        """Return the window of a node at a time [ns], limited to the trace's end."""
        first_ns, last_ns = convert_window(node)
        end_ns = self.trace.end_ns
        last_ns = end_ns if last_ns is None else time_ns + last_ns
        return min(end_ns, time_ns + first_ns), min(end_ns, last_ns)

    def begins_beyond(self, node: Temporal | Until) -> bool:
        """Whether the window of a node begins after the trace's end."""
        return self.trace.start_ns + convert_window(node)[0] > self.trace.end_ns

    def measure_leaf(self, node: Node, sign: int) -> Steps:
        """Return the margins of a comparison, or of a truth value."""
        for part in iterate_nodes(node):
            if isinstance(part, Temporal | Until):
                fail_at(self._expression, part, "expected no temporal operator in a comparison")
        names = self.trace.signals.keys() & list_names(node)
        signals = {name: self.trace.signals[name] for name in names}
        values, time_ns = self.trace.constants, np.array([self.trace.start_ns])
        if signals:
            time_ns, columns = align_steps([*signals.values()])
            values = {**values, **dict(zip(signals, columns, strict=True))}
        if isinstance(node, Comparison):
            operands = [evaluate_node(self._expression, part, values) for part in node.operands]
            check_comparison(self._expression, node, operands)
            pairs = zip(operands, node.operators, operands[1:], strict=False)
            margins = functools.reduce(np.minimum, [self._measure(*pair) for pair in pairs])
        else:
            found = evaluate_node(self._expression, node, values)
            require_kind(self._expression, node, found, Kind.TRUTH)
            margins = self._weigh(found)
        if not math.isnan(self._unknown):
            margins = np.where(np.isnan(margins), sign * self._unknown, margins)
        steps = Steps(time_ns=time_ns, values=np.broadcast_to(margins, time_ns.shape))
        if self.trace.ending is RunEnding.SETTLED or not signals:
            return steps
        return steps.end_with(sign * self._unknown, from_ns=self.trace.end_ns + 1)

    def _measure(self, left: Operand, operator: str, right: Operand) -> Values:
        if self._exact or not {left.kind, right.kind} <= {Kind.NUMBER, Kind.UNKNOWN}:
            return self._weigh(compare_operands(left, operator, right))
        if operator in {">", ">="}:
            left, right = right, left
        with np.errstate(all="ignore"):
            margins = right.data - left.data
        margins = np.where(left.data == right.data, 0.0, margins)  # avoids inf - inf
        if operator in {"==", "!="}:
            return np.abs(margins) if operator == "!=" else -np.abs(margins)
        return margins

    def _weigh(self, truth: Operand) -> Values:
        """Return the margins of truth values, which have no distance."""
        weight = 1.0 if self._exact else math.inf
        margins = np.where(truth.data > 0, weight, -weight)
        return np.where(np.isnan(truth.data), np.nan, margins)


class _Leaf:
    def __init__(self, reader: PartReader, node: Node, sign: int) -> None:
        self._reader, self._node, self._sign = reader, node, sign
        self.margins = reader.measure_leaf(node, sign)

    def find_critical(self, time_ns: int) -> CriticalPart:
        node = self._node
        if not isinstance(node, Comparison) or len(node.operators) == 1:
            return CriticalPart(node=node, time_ns=time_ns)
        found = [_Leaf(self._reader, link, self._sign) for link in split_comparison(node)]
        return min(found, key=lambda link: _read(link, time_ns)).find_critical(time_ns)

    def find_violation(self) -> int | None:
        return self._reader.trace.start_ns


class _Negated:
    def __init__(self, reader: PartReader, operand: Node, sign: int) -> None:
        self._reader, self._operand, self._sign = reader, operand, sign
        self._part = reader.visit(operand, -sign)
        self.margins = negate_steps(self._part.margins)

    def find_critical(self, time_ns: int) -> CriticalPart:
        return self._part.find_critical(time_ns)

    def find_violation(self) -> int | None:
        window = self._operand
        if not isinstance(window, Temporal):
            return self._reader.trace.start_ns
        turned = replace(
            window,
            operator="eventually" if window.operator == "always" else "always",
            operand=Prefix(operator="not", operand=window.operand),
        )
        return find_violation(self._reader.visit(turned, self._sign))


class _Joined:
    def __init__(self, operator: str, parts: list[Part]) -> None:
        self._operator, self._parts = operator, parts
        combine = np.minimum if operator == "and" else np.maximum
        self.margins = combine_steps(combine, [part.margins for part in parts])

    def find_critical(self, time_ns: int) -> CriticalPart:
        whole = _read(self, time_ns)
        *others, last = self._parts
        decisive = (part for part in others if _read(part, time_ns) == whole)
        return next(decisive, last).find_critical(time_ns)

    def find_violation(self) -> int | None:
        parts = self._parts[1:] if self._operator == "implies" else self._parts
        found = [find_violation(part) for part in parts]
        known = [time_ns for time_ns in found if time_ns is not None]
        if self._operator == "or":
            return max(known) if len(known) == len(found) else None
        return min(known, default=None)


class _Windowed:
    def __init__(self, reader: PartReader, node: Temporal, sign: int) -> None:
        self._reader, self._node = reader, node
        self._body = reader.visit(node.operand, sign)
        slide = slide_minimum if node.operator == "always" else slide_maximum
        self.margins = reader.look_ahead(node, slide, [self._body.margins], sign)

    def find_critical(self, time_ns: int) -> CriticalPart:
        body = self._body.margins.cut(*self._reader.clip_window(self._node, time_ns))
        find = np.argmin if self._node.operator == "always" else np.argmax
        return self._body.find_critical(int(body.time_ns[find(body.values)]))

    def find_violation(self) -> int | None:
        start_ns, end_ns = self._reader.clip_window(self._node, self._reader.trace.start_ns)
        if self._reader.begins_beyond(self._node):
            return None
        if self._node.operator == "eventually":
            return end_ns
        return _find_failure(self._body, start_ns, end_ns)


class _Until:
    def __init__(self, reader: PartReader, node: Until, sign: int) -> None:
        self._reader, self._node = reader, node
        self._left, self._right = reader.visit(node.left, sign), reader.visit(node.right, sign)
        sides = [self._left.margins, self._right.margins]
        self.margins = reader.look_ahead(node, compute_until, sides, sign)

    def find_critical(self, time_ns: int) -> CriticalPart:
        start_ns, end_ns = self._reader.clip_window(self._node, time_ns)
        left, right = (part.margins.cut(time_ns, end_ns) for part in (self._left, self._right))
        marks = np.unique([time_ns, start_ns])
        begun = Steps(time_ns=marks, values=marks >= start_ns)
        times, (held, coming, is_open) = align_steps([left, right, begun])
        lasting = np.minimum.accumulate(held)
        reached = np.where(is_open, np.minimum(lasting, coming), -np.inf)
        best = int(np.argmax(reached))
        if coming[best] <= lasting[best]:
            return self._right.find_critical(int(times[best]))
        return self._left.find_critical(int(times[np.argmin(held[: best + 1])]))

    def find_violation(self) -> int | None:
        begin_ns = self._reader.trace.start_ns
        _, end_ns = self._reader.clip_window(self._node, begin_ns)
        failed_ns = _find_failure(self._left, begin_ns, end_ns)
        if failed_ns is not None:
            return failed_ns
        return None if self._reader.begins_beyond(self._node) else end_ns


def find_violation(part: Part) -> int | None:
    """Return the first violation of a part that is required at the start [ns]."""
    return part.find_violation() if part.margins.values[0] < 0 else None


def is_relieved(expression: Expression, trace: FormulaTrace, failed_ns: int) -> bool:
    """Return whether the right side of an `until` begins at the time at which its left side ends.

    This violates the formula, because the sides must hold together at one time.
    """
    root = expression.root
    if not isinstance(root, Until) or failed_ns < trace.start_ns + convert_window(root)[0]:
        return False
    reader = PartReader(expression, trace, exact=True, unknown=-math.inf)
    left, right = (reader.visit(side, 1) for side in (root.left, root.right))
    return _read(left, failed_ns) < 0 < _read(right, failed_ns)


def read_margin(whole: Part) -> float:
    """Return the margin of a formula at the beginning."""
    return float(whole.margins.values[0])


def _read(part: Part, time_ns: int) -> float:
    return float(part.margins.values[part.margins.find_piece(time_ns)])


def split_comparison(node: Comparison) -> Iterator[Comparison]:
    """Yield the two-sided comparisons of a chain, as results name them."""
    for operator, *sides in zip(node.operators, node.operands, node.operands[1:], strict=False):
        yield Comparison(operators=(operator,), operands=tuple(sides))


def _find_failure(part: Part, start_ns: int, end_ns: int) -> int | None:
    cut = part.margins.cut(start_ns, end_ns)
    failed = cut.values < 0
    return int(cut.time_ns[failed.argmax()]) if failed.any() else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
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

    def enter(self, node: Temporal) -> "Place":
        """Return the place of the operand of a window operator at this place."""
        is_always = (node.operator == "always") is not self.is_denied
        is_first = is_always and not self.windows
        return Place(
            is_denied=self.is_denied,
            start_s=self.start_s + node.start_s,
            end_s=self.end_s + node.end_s,
            body=node.operand if is_first else None,
            is_body_denied=self.is_denied,
            windows=self.windows + 1,
        )

    def deny(self) -> "Place":
        """Return the place of the operand of `not` at this place."""
        return replace(self, is_denied=not self.is_denied, beside=())


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """A comparison in a formula, and the operators above it."""

    node: Comparison
    place: Place


def list_compared(node: Node, place: Place = Place()) -> Iterator[Compared]:
    """Yield the comparisons of a formula, with the operators above each."""
    match node:
        case Comparison():
            beside = tuple(one for one in place.beside if one is not node)
            yield Compared(node=node, place=replace(place, beside=beside))
        case Temporal(operand=operand):
            yield from list_compared(operand, place.enter(node))
        case Until():
            for side in node.list_children():
                window = Temporal(operator="eventually", end_s=node.end_s, operand=side)
                yield from list_compared(side, place.enter(window))
        case Logic(operands=operands):
            both = "or" if place.is_denied else "and"
            together = [one for one in operands if isinstance(one, Comparison)]
            beside = tuple(together) if node.operator == both else ()
            for number, operand in enumerate(operands):
                is_condition = node.operator == "implies" and number == 0
                inner = replace(place.deny() if is_condition else place, beside=beside)
                yield from list_compared(operand, inner)
        case Prefix(operator="not", operand=operand):
            yield from list_compared(operand, place.deny())
