"""Check of a formula over signals, over a run, and as a specification asks: verdict and margin."""

import math
from collections import ChainMap
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from turtlelog import expressions
from turtlelog.check import spec
from turtlelog.check.formula_trace import (
    FormulaTrace,
    RunEnding,
    Signals,
    check_names,
    find_ending,
    find_span,
    find_window,
    list_names,
    measure_reach,
    read_signals,
)
from turtlelog.check.result import CheckResult, Grown, Verdict, find_metric_violation
from turtlelog.check.robustness import (
    CriticalPart,
    find_violation,
    is_relieved,
    read_margin,
    walk_formula,
)
from turtlelog.display import format_html, format_number
from turtlelog.errors import CheckError, ExpressionError, UndecidedError
from turtlelog.escapes import escape_controls
from turtlelog.measure import (
    COMMANDED,
    SIGNALS,
    Metric,
    explain_no_signal,
    list_metrics,
    list_signals,
)
from turtlelog.run import Run
from turtlelog.run.loops import Declaration

_TOO_SHORT: Final = "the recording ends before the formula's window does"
_BEYOND: Final = "its window begins after the end, where the last values hold"
_UNTIL: Final = "its left side ends when its right side begins, but must hold then too"


@dataclass(frozen=True, slots=True, kw_only=True)
class FormulaResult:
    """Verdict and margin of a formula at the beginning of a trace. Times count from the beginning.

    Attributes:
        formula: Text of the formula.
        holds: Verdict; None if the verdict is unknown.
        margin: Robustness: the change of every number that the verdict withstands, in the unit of
            the deciding comparison; positive if the formula holds. inf or -inf if no comparison
            with a distance decides; None if the margin is unknown.
        margin_s: Time of the margin [s]; None if the margin is unknown.
        decided_by: The comparison that gives the margin at this time.
        value: Left side of the deciding comparison; None if it is not a number.
        limit: Right side of the deciding comparison; None if it is not a number.
        unit: Unit of margin, value and limit, from signals and metrics with these names; empty if
            it is not simple.
        first_violation_s: Time of the first violation [s]; None if there is no violation, or if it
            is after the end of the trace.
        values: Value of every name at the first violation, or else at `margin_s`, or else at the
            beginning; None for no value.
        is_covered: Whether the trace covers all windows of the formula. A run that was cut off
            never covers a window without an end.
        reason: One clause if the verdict is unknown, if no time of the trace violates it, or if the
            sides of `until` do not overlap.
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
        """Whether the formula holds; UndecidedError if the verdict is unknown."""
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
    expression: expressions.Expression | str,
    *,
    window_ns: tuple[int, int] | None = None,
    ending: RunEnding = RunEnding.SETTLED,
    declaration: Declaration | None = None,
) -> FormulaResult:
    """Check a formula at the beginning of a trace; `check_run` does so for a run.

    Args:
        signals: A run, or a mapping from names to signals (time_ns, values) or constants; None for
            no value. Times do not decrease. Of several values at one time, the last is used.
        expression: A formula or its text, temporal or not.
        window_ns: First and last time of the trace [ns]. Default: from the first time at which
            every used signal has a value, to the last time of any signal.
        ending: Knowledge of the time after the end. Default: the last values are held.
        declaration: Declaration of the law, for the units of its loops' metrics.

    Raises:
        ExpressionError: If a name is unknown or operand types do not match.
        CheckError: If a signal is invalid, or has no value at the first time.
    """
    if isinstance(signals, Run):
        return check_run(signals, expression, window_ns=window_ns)
    if not isinstance(signals, Mapping):
        raise CheckError(f"signals: expected a Run or values by name, found {signals!r:.60}")
    expression = _parse(expression)
    trace = FormulaTrace.open(signals, expression, window_ns=window_ns, ending=ending)
    return _judge_trace(expression, trace, declaration)


def _judge_trace(
    expression: expressions.Expression,
    trace: FormulaTrace,
    declaration: Declaration | None,
    explain_none: Callable[[str], str] = lambda _: "",
) -> FormulaResult:
    """Return the verdict. `explain_none` returns why a name has no value; empty if unknown."""
    holds, margin, critical = _decide(expression, trace)
    failed_ns = None
    if holds is False:  # a violation is certain only with unknown parts at their best
        failed_ns = find_violation(walk_formula(expression, trace, exact=True, unknown=math.inf))
    values = trace.read_values(trace.start_ns if failed_ns is None else failed_ns)
    is_cut = trace.ending in {RunEnding.CUT, RunEnding.LOST}
    reach_s = measure_reach(expression.root, is_cut=is_cut)
    unknown = FormulaResult(
        formula=expression.text,
        holds=None,
        margin=None,
        margin_s=None,
        first_violation_s=None if failed_ns is None else (failed_ns - trace.start_ns) / 1e9,
        values=values,
        is_covered=trace.start_ns + reach_s * 1e9 <= trace.end_ns,
    )
    if critical is None:
        return replace(unknown, reason=_explain_unknown(expression, trace, explain_none))
    decisive = trace.read_values(critical.time_ns)
    sides = _read_sides(expression, critical.node, decisive, declaration or Declaration())
    return replace(
        unknown,
        holds=holds,
        margin=margin + 0.0,
        margin_s=(critical.time_ns - trace.start_ns) / 1e9,
        values=decisive if failed_ns is None else values,
        decided_by=expressions.format_expression(critical.node),
        reason="" if holds else _explain_violation(expression, trace, failed_ns),
        **sides,
    )


def _parse(expression: expressions.Expression | str) -> expressions.Expression:
    if isinstance(expression, str):
        return expressions.parse_expression(expression)
    if not isinstance(expression, expressions.Expression):
        raise ExpressionError(f"expression: expected a formula, found {expression!r:.60}")
    return expression


def check_run(
    run: Run, expression: expressions.Expression | str, *, window_ns: tuple[int, int] | None = None
) -> FormulaResult:
    """Check a formula over a run's signals, metrics and parameters.

    If the run was truncated, the time after its end is unknown.

    Args:
        run: Run to check; time zero is its first sample.
        expression: A formula, or its text, over the run's signals and states, its metrics and its
            parameters. If the run's law does not declare a loop, the metrics of this loop have no
            value.
        window_ns: First and last time [ns]. Default: from time zero to the run's end; for commands
            without samples, from the first command. After an earlier end, such as that of a phase,
            the last values of the window are held.

    Raises:
        ExpressionError: If a name is unknown or operand types do not match.
        CheckError: If a signal has no value at the first time.
    """
    expression = _parse(expression)
    others = {name: None for name in expression.names if spec.find_kind(run, name) is not None}
    kinds: Any = others, list_metrics(run.declaration), list_signals(run.declaration)
    known = ChainMap[str, Any](*kinds)  # avoids copying 200 names for each of many checks
    own: Any = run.parameters
    check_names(expression, known.new_child(own))
    signals = read_signals(run, expression.names)
    window_ns = window_ns or find_span(run, expression.names)
    ending = find_ending(run) if window_ns[1] >= run.end_ns else RunEnding.SETTLED
    trace = FormulaTrace.open(signals, expression, window_ns=window_ns, ending=ending)

    def explain_none(name: str) -> str:
        return explain_no_signal(run, name) if name in known and name not in others else ""

    return _judge_trace(expression, trace, run.declaration, explain_none)


_Decision = tuple[bool, float, CriticalPart] | tuple[None, float, None]
"""Whether a formula holds, its margin, and the origin of the margin."""


def _decide(expression: expressions.Expression, trace: FormulaTrace) -> _Decision:
    """Return the verdict, with only one walk over a long trace in memory.

    If a part is unknown, two margins may decide: with the unknown part at its worst, and at its
    best.
    """
    whole = walk_formula(expression, trace)
    margin = read_margin(whole)
    if not (math.isnan(margin) or margin == 0):
        return margin > 0, margin, whole.find_critical(trace.start_ns)
    del whole
    for holds, unknown in ((True, -math.inf), (False, math.inf)):
        exact = walk_formula(expression, trace, exact=True, unknown=unknown)
        if (read_margin(exact) > 0) is holds:
            del exact
            whole = walk_formula(expression, trace, unknown=unknown)
            return holds, read_margin(whole), whole.find_critical(trace.start_ns)
    return None, margin, None


def _explain_unknown(
    expression: expressions.Expression, trace: FormulaTrace, explain_none: Callable[[str], str]
) -> str:
    if trace.ending is not RunEnding.SETTLED:
        settled = replace(trace, ending=RunEnding.SETTLED)
        if _decide(expression, settled)[0] is not None:
            recorded_ms = (trace.end_ns - trace.start_ns) // 10**6
            nodes = expressions.iterate_nodes(expression.root)
            is_open = any(
                isinstance(n, expressions.Temporal | expressions.Until) and math.isinf(n.end_s)
                for n in nodes
            )
            window = f"such as [0, {recorded_ms / 1e3:.10g}], asks of what it holds"
            advice = f"; a window with an end, {window}" if is_open and recorded_ms else ""
            return f"{_TOO_SHORT}, and {trace.ending.value}{advice}"
    missing = [name for name, value in trace.constants.items() if value is None]
    if not missing:
        return "a number has no value"
    reasons = dict.fromkeys(filter(None, map(explain_none, missing)))
    why = f" ({'; '.join(reasons)})" if reasons else ""
    return f"no value: {', '.join(missing)}{why}"


def _explain_violation(
    expression: expressions.Expression, trace: FormulaTrace, failed_ns: int | None
) -> str:
    """Return a clause on a violation beyond the trace, or of sides of `until` that do not meet."""
    if failed_ns is None:
        return _BEYOND
    return _UNTIL if is_relieved(expression, trace, failed_ns) else ""


def _read_sides(
    expression: expressions.Expression,
    node: expressions.Node,
    values: Mapping[str, Any],
    declaration: Declaration,
) -> dict[str, Any]:
    """Return value, limit and unit of a comparison of numbers; nothing for any other node."""
    if not isinstance(node, expressions.Comparison):
        return {}
    found = {name: spec.find_formula_unit(name, declaration) for name in list_names(node)}
    units = {name: unit for name, unit in found.items() if unit is not None}
    measured, limit = node.operands
    if units.keys().isdisjoint(list_names(measured)) and units:  # the limit names all of them
        measured, limit = limit, measured
    sides = [expressions.evaluate_node(expression, side, values) for side in (measured, limit)]
    if any(side.kind is not expressions.Kind.NUMBER for side in sides):
        return {}
    value, limit_value = (float(side.data) for side in sides)
    return {"value": value, "limit": limit_value, "unit": spec.find_common_unit(measured, units)}


def judge_check(
    check: spec.Check,
    run: Run,
    *,
    file: str,
    metrics: Mapping[str, Metric] | None = None,
    grown: Grown | None = None,
) -> CheckResult:
    """Return the result of one check. A metric without a value fails it, whatever the formula.

    `metrics` are those that the check names, if already measured. Values of metrics at poses of
    this run are added to `grown`.
    """
    metrics = spec.measure_named([check], run) if metrics is None else metrics
    return _Judge(check, run, file, metrics, {} if grown is None else grown)()


class _Judge:
    def __init__(
        self, check: spec.Check, run: Run, file: str, metrics: Mapping[str, Metric], grown: Grown
    ) -> None:
        self._check, self._run, self._file = check, run, file
        self._metrics, self._grown = metrics, grown

    def __call__(self) -> CheckResult:
        check, formula = self._check, self._check.formula
        if check.when is not None and (skipped := self._judge_condition(check.when)) is not None:
            return skipped
        spec.require_known_names(formula, over_time=check.kind == "holds", run=self._run)
        if lacking := self._find_lacking(formula):
            return self._leave_open(lacking)
        if check.kind == "holds":
            return self._judge_over_time()
        found = self._check_values(formula)
        failed_s = None if found.holds else self._find_moment(found.limit)
        return replace(self._describe(found), first_violation_s=failed_s)

    def _check_values(self, formula: expressions.Expression) -> FormulaResult:
        values: dict[str, Any] = {
            name: self._metrics[name].value if name in self._metrics else self._run.parameters[name]
            for name in formula.names
        }
        return check_formula(values, formula, declaration=self._run.declaration)

    def _judge_condition(self, condition: expressions.Expression) -> CheckResult | None:
        """Return the reason why a check is skipped or undecided; None if it applies."""
        spec.require_known_names(condition, over_time=False, run=self._run)
        if lacking := self._find_lacking(condition):
            return self._leave_open(f"when: {lacking}")
        found = self._check_values(condition)
        if found.holds is None:
            return self._leave_open(f"when: {found.reason}")
        if found.holds:
            return None
        values = ", ".join(f"{name} = {value}" for name, value in found.values.items())
        return self._build(Verdict.SKIPPED, reason=f"only when {condition.text}; here {values}")

    def _judge_over_time(self) -> CheckResult:
        check, run, names = self._check, self._run, self._check.formula.names
        window_ns = find_window(run, check.phase) if check.phase else find_span(run, names)
        if window_ns is None:
            return self._leave_open(spec.describe_missing_phase(run, check.phase or ""))
        found = check_run(run, check.formula, window_ns=window_ns)
        begun_s = (window_ns[0] - run.start_ns) / 1e9
        value_s, failed_s = (
            None if time_s is None else time_s + begun_s
            for time_s in (found.margin_s, found.first_violation_s)
        )
        if not any(name in list_signals(run.declaration) for name in names):
            # Formulas of metrics alone hold always or never: the time of a metric is more
            # informative.
            value_s, failed_s = None, None if found.holds else self._find_moment(found.limit)
        told = self._describe(found)
        nodes = expressions.iterate_nodes(check.formula.root)
        is_timed = any(isinstance(n, expressions.Temporal | expressions.Until) for n in nodes)
        if found.holds and not is_timed and window_ns[0] < window_ns[1] and value_s is not None:
            reason = f"judged at {begun_s:.3f} s alone; always(...) asks of every time"
            told = replace(told, reason=reason)
        has_others = any(name in SIGNALS and name not in COMMANDED for name in names)
        if begun_s > 0.0 and not told.reason and not check.phase and has_others:
            told = replace(told, reason=f"judged from the first command on, at {begun_s:.3f} s")
        return replace(told, value_s=value_s, first_violation_s=failed_s)

    def _describe(self, found: FormulaResult) -> CheckResult:
        is_finite = found.margin is not None and math.isfinite(found.margin)
        nodes = expressions.iterate_nodes(self._check.formula.root)
        comparisons = sum(len(n.operators) for n in nodes if isinstance(n, expressions.Comparison))
        return replace(
            self._build(Verdict.PASS if found.holds else Verdict.FAIL, reason=found.reason),
            value=found.value,
            limit=found.limit,
            margin=found.margin if is_finite else None,
            unit=found.unit,
            decided_by=found.decided_by if comparisons > 1 else "",
            is_decided=found.holds is not None,
        )

    def _leave_open(self, reason: str) -> CheckResult:
        return replace(self._build(Verdict.FAIL, reason=reason), is_decided=False)

    def _build(self, verdict: Verdict, *, reason: str) -> CheckResult:
        return CheckResult(
            file=self._file,
            check=self._check.name,
            verdict=verdict,
            expected=self._check.describe(),
            reason=reason,
            names=spec.choose_signals(self._check.formula.names, self._run.declaration),
            judged=self._check,
        )

    def _find_lacking(self, formula: expressions.Expression) -> str:
        """Return the names without a value, with reasons; empty if all names have a value."""
        lacking = []
        for name in formula.names:
            if name in list_signals(self._run.declaration):
                continue
            metric = self._metrics.get(name)
            if metric is None and name in self._run.parameters:
                if isinstance(self._run.parameters[name], list):
                    lacking.append(f"{name}: expected one value, found a list")
                continue
            if metric is None:
                lacking.append(f"{name}: the recording does not hold it")
            elif metric.value is None:
                lacking.append(f"{name}: {metric.lack}")
        return "; ".join(lacking)

    def _find_moment(self, limit: float | None) -> float | None:
        """Return when a bound on one metric is first violated; None if the check names several."""
        formula = self._check.formula
        named = [name for name in formula.names if name in self._metrics]
        if len(named) != 1:
            return None
        metric, root = self._metrics[named[0]], formula.root
        if (
            isinstance(root, expressions.Comparison)
            and len(root.operands) == 2
            and limit is not None
        ):
            left = root.operands[0]
            if isinstance(left, expressions.Name) and left.name == metric.id:
                operator = root.operators[0]
                return find_metric_violation(self._run, metric, operator, limit, grown=self._grown)
        return metric.at_s
