"""Formula and signals -> finding: does it hold, by what margin, and where is that decided."""

import math
from collections import ChainMap
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from turtlelog.check.formula_trace import (
    FormulaTrace,
    RunEnding,
    Signals,
    check_names,
    find_ending,
    find_span,
    read_signals,
)
from turtlelog.check.robustness import CriticalPart, FormulaWalk
from turtlelog.check.vocabulary import (
    ROBOT_VALUES,
    TRAJECTORY_VALUES,
    find_kind,
    find_robot_unit,
    find_trajectory_unit,
)
from turtlelog.display import format_html, format_number
from turtlelog.errors import UndecidedError
from turtlelog.escapes import escape_controls
from turtlelog.expressions import (
    Call,
    Comparison,
    Expression,
    Kind,
    Name,
    Node,
    Temporal,
    Until,
    evaluate_node,
    format_expression,
    iterate_nodes,
    parse_expression,
)
from turtlelog.measure import explain_no_signal, find_metric_kind, list_metrics, list_signals
from turtlelog.run import Run
from turtlelog.run.loops import Declaration

_NO_VALUE: Final = "no value: "

_TOO_SHORT: Final = "the recording ends before the formula's window does"

_BEYOND: Final = "its window begins after the end, where the last values hold"


@dataclass(frozen=True, slots=True, kw_only=True)
class FormulaResult:
    """Verdict and margin of a formula at the beginning of a trace. Times count from there.

    Attributes:
        formula: Text of the formula.
        holds: The verdict; None if it is unknown.
        margin: Change of every number that the verdict withstands, in the unit of the comparison
            that decides: positive where it holds. inf or -inf if nothing with a distance decides;
            None if it is unknown.
        margin_s: Time from which the margin comes [s]; None if it is unknown.
        decided_by: The comparison from which the margin comes then.
        value: Left side of that comparison; None if that is no number.
        limit: Limit of the comparison; None if that is no number.
        unit: Unit of the three, as signals and metrics of these names have it; empty if it is not
            plain.
        first_violation_s: First time at which it is violated [s]; None if it is not, or where that
            is after the end of the trace.
        values: Value of every name at the first violation, or else at `margin_s`, or else at the
            beginning; None for no value.
        is_covered: Whether the trace is long enough for all that the formula looks ahead; a run
            that was cut is never long enough for a window without an end.
        reason: One clause where the verdict is unknown, or where no time of the trace violates it.
    """

    formula: str
    holds: bool | None
    margin: float | None
    margin_s: float | None
    first_violation_s: float | None
    values: Mapping[str, Any]
    is_covered: bool
    decided_by: str = ""
    value: float | None = None
    limit: float | None = None
    unit: str = ""
    reason: str = ""

    def __bool__(self) -> bool:
        """Whether it holds.

        Raises:
            UndecidedError: If that is unknown.
        """
        if self.holds is None:
            raise UndecidedError(f"{self.formula}: undecided: {self.reason}")
        return self.holds

    def __repr__(self) -> str:
        word = {True: "holds", False: "violated", None: "undecided"}[self.holds]
        margin = "" if self.margin is None else f", margin {format_number(self.margin, self.unit)}"
        return f"<FormulaResult {escape_controls(self.formula)}: {word}{margin}>"

    def _repr_html_(self) -> str:
        rows = [
            ("value", format_number(self.value, self.unit)),
            ("limit", format_number(self.limit, self.unit)),
            ("margin", format_number(self.margin, self.unit)),
            ("margin at [s]", self.margin_s),
            ("first violation at [s]", self.first_violation_s),
            ("decided by", self.decided_by),
            ("reason", self.reason),
        ]
        return format_html(rows, title=repr(self))


def check_formula(
    signals: Run | Signals,
    expression: Expression | str,
    *,
    window_ns: tuple[int, int] | None = None,
    ending: RunEnding = RunEnding.SETTLED,
    declaration: Declaration | None = None,
) -> FormulaResult:
    """Check a formula at the beginning of a trace; over a run as `check_run` does.

    Args:
        signals: A run, or by name: (time_ns, values) of a signal, or a constant, None for no
            value. Times do not decrease; of values at one time the last one holds.
        expression: A formula or its text, temporal or not.
        window_ns: First and last time [ns] of the trace; by default from the first moment at
            which every signal used has a value to the last time of any.
        ending: Knowledge of the time after that; by default the last values hold for ever.
        declaration: Declaration of the law that ran, which says the units of its loops' metrics.

    Raises:
        ExpressionError: If a name is not there or the kinds do not go together.
        CheckError: If a signal is no signal, or has no value at the first time.
    """
    if isinstance(signals, Run):
        return check_run(signals, expression, window_ns=window_ns)
    expression = _parse(expression)
    trace = FormulaTrace.open(signals, expression, window_ns=window_ns, ending=ending)
    holds, margin, critical = _decide(expression, trace)
    failed_ns = _find_violation(expression, trace) if holds is False else None
    values = trace.read_values(trace.start_ns if failed_ns is None else failed_ns)
    unknown = FormulaResult(
        formula=expression.text,
        holds=None,
        margin=None,
        margin_s=None,
        first_violation_s=None if failed_ns is None else (failed_ns - trace.start_ns) / 1e9,
        values=values,
        is_covered=_is_covered(expression, trace),
    )
    if critical is None:
        return replace(unknown, reason=_explain_unknown(expression, trace))
    decisive = trace.read_values(critical.time_ns)
    sides = read_sides(expression, critical.node, decisive, declaration or Declaration())
    return replace(
        unknown,
        holds=holds,
        margin=margin + 0.0,
        margin_s=(critical.time_ns - trace.start_ns) / 1e9,
        values=decisive if failed_ns is None else values,
        decided_by=format_expression(critical.node),
        value=sides.value,
        limit=sides.limit,
        unit=sides.unit,
        reason="" if holds or failed_ns is not None else _BEYOND,
    )


def _parse(expression: Expression | str) -> Expression:
    return parse_expression(expression) if isinstance(expression, str) else expression


def check_run(
    run: Run, expression: Expression | str, *, window_ns: tuple[int, int] | None = None
) -> FormulaResult:
    """Check a formula over a run's signals, metrics and parameters.

    If the run was truncated, the time after its end is unknown.

    Args:
        run: Time zero is its first sample.
        expression: A formula, or its text, over the run's signals and states, its metrics and its
            parameters. A metric of a loop that its law does not declare has no value.
        window_ns: First and last time [ns]; by default from time zero to the run's end, of commands
            without samples from the first one on. After one that ends earlier, such as a phase, its
            last values hold.

    Raises:
        ExpressionError: If a name is not there or the kinds do not go together.
        CheckError: If a signal has no value at the first time.
    """
    expression = _parse(expression)
    others = {name: None for name in expression.names if find_kind(run, name) is not None}
    kinds: Any = others, list_metrics(run.declaration), list_signals(run.declaration)
    known = ChainMap[str, Any](*kinds)  # no copy of 200 names for each of many checks
    own: Any = run.parameters
    check_names(expression, known.new_child(own))
    signals = read_signals(run, expression.names)
    window_ns = window_ns or find_span(run, expression.names)
    ending = find_ending(run) if window_ns[1] >= run.end_ns else RunEnding.SETTLED
    found = check_formula(
        signals, expression, window_ns=window_ns, ending=ending, declaration=run.declaration
    )
    lacking = [name for name in signals if signals[name] is None and name in known]
    reasons = dict.fromkeys(explain_no_signal(run, name) for name in lacking if name not in others)
    if found.holds is None and found.reason.startswith(_NO_VALUE) and any(reasons):
        return replace(found, reason=f"{found.reason} ({'; '.join(filter(None, reasons))})")
    return found


_Decision = tuple[bool, float, CriticalPart] | tuple[None, float, None]
"""Whether a formula holds, its margin, and where that comes from."""


def _decide(expression: Expression, trace: FormulaTrace) -> _Decision:
    """Return the verdict; of long traces there is one walk at a time.

    If part is unknown, the whole may still be decided: by the margins in which the unknown counts
    as badly, or as well, as it can.
    """
    walk = FormulaWalk(expression, trace)
    margin = walk.margin
    if not (math.isnan(margin) or margin == 0):
        return margin > 0, margin, walk.find_critical()
    del walk
    for holds, unknown in ((True, -math.inf), (False, math.inf)):
        if (FormulaWalk(expression, trace, exact=True, unknown=unknown).margin > 0) is holds:
            walk = FormulaWalk(expression, trace, unknown=unknown)
            return holds, walk.margin, walk.find_critical()
    return None, margin, None


def _find_violation(expression: Expression, trace: FormulaTrace) -> int | None:
    """Return the first violation; unknown parts count as well as they can: None unless sure."""
    return FormulaWalk(expression, trace, exact=True, unknown=math.inf).find_violation()


def _explain_unknown(expression: Expression, trace: FormulaTrace) -> str:
    if trace.ending is not RunEnding.SETTLED:
        settled = replace(trace, ending=RunEnding.SETTLED)
        if _decide(expression, settled)[0] is not None:
            return f"{_TOO_SHORT}, and {trace.ending.value}{_advise(expression, trace)}"
    missing = [name for name, value in trace.constants.items() if value is None]
    return f"{_NO_VALUE}{', '.join(missing)}" if missing else "a number has no value"


def _advise(expression: Expression, trace: FormulaTrace) -> str:
    """Return what to ask of a trace that was cut in place of a window without an end."""
    recorded_ms = (trace.end_ns - trace.start_ns) // 10**6
    nodes = iterate_nodes(expression.root)
    is_open = any(isinstance(node, Temporal | Until) and math.isinf(node.end_s) for node in nodes)
    if not is_open or not recorded_ms:
        return ""
    return f"; a window with an end, such as [0, {recorded_ms / 1e3:.10g}], asks of what it holds"


def _is_covered(expression: Expression, trace: FormulaTrace) -> bool:
    is_cut = trace.ending in {RunEnding.CUT, RunEnding.LOST}
    reach_s = _measure_reach(expression.root, is_cut=is_cut)
    return trace.start_ns + reach_s * 1e9 <= trace.end_ns


def _measure_reach(node: Node, *, is_cut: bool) -> float:
    """Return how far a formula looks ahead [s].

    Windows without an end count to their start, where the run was not cut.
    """
    children = node.list_children()
    below = max((_measure_reach(child, is_cut=is_cut) for child in children), default=0.0)
    if not isinstance(node, Temporal | Until):
        return below
    return below + (node.start_s if math.isinf(node.end_s) and not is_cut else node.end_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sides:
    """Value and limit of a comparison; None if it has no such numbers."""

    value: float | None = None
    limit: float | None = None
    unit: str = ""


def read_sides(
    expression: Expression, node: Node, values: Mapping[str, Any], declaration: Declaration
) -> Sides:
    """Return the sides of a comparison of two.

    Args:
        expression: That it is part of.
        node: The comparison; of anything else the sides are None.
        values: What its names stand for.
        declaration: Declaration of the law, which says the units of its loops' metrics.
    """
    if not isinstance(node, Comparison):
        return Sides()
    names = {part.name for part in iterate_nodes(node) if isinstance(part, Name)}
    units = {
        name: unit for name in names if (unit := find_formula_unit(name, declaration)) is not None
    }
    measured, limit = node.operands
    if _is_measured(limit, units) and not _is_measured(measured, units):
        measured, limit = limit, measured
    sides = [evaluate_node(expression, side, values) for side in (measured, limit)]
    if any(side.kind is not Kind.NUMBER for side in sides):
        return Sides()
    return Sides(
        value=float(sides[0].data), limit=float(sides[1].data), unit=_find_unit(measured, units)
    )


def find_formula_unit(name: str, declaration: Declaration) -> str | None:
    """Return the unit of a signal or metric, None if the name is of neither.

    Empty for a metric of a loop that is not declared, whose unit depends on what it controls.
    """
    if name in list_signals(declaration):
        return list_signals(declaration)[name].unit
    if name in list_metrics(declaration):
        return list_metrics(declaration)[name].unit
    if name in ROBOT_VALUES:
        return find_robot_unit(name)
    if name in TRAJECTORY_VALUES:
        return find_trajectory_unit(name)
    other = find_metric_kind(name)
    return None if other is None else "" if " or " in other.unit else other.unit


def _is_measured(node: Node, units: Mapping[str, str]) -> bool:
    return any(isinstance(part, Name) and part.name in units for part in iterate_nodes(node))


def _find_unit(node: Node, units: Mapping[str, str]) -> str:
    """Return the unit of what is measured, empty if it is not plain."""
    if isinstance(node, Call) and node.function in {"abs", "min", "max"}:
        found = {_find_unit(argument, units) for argument in node.arguments}
        return found.pop() if len(found) == 1 else ""
    if isinstance(node, Call) and node.function == "deg":
        return "deg"
    return units.get(node.name, "") if isinstance(node, Name) else ""
