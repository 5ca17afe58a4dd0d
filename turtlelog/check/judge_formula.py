"""A formula on a run -> result: does it hold, by what margin, and since when not."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from turtlelog.check.formula import FormulaResult, check_formula, check_run
from turtlelog.check.moments import find_metric_violation
from turtlelog.check.result import CheckResult, Verdict
from turtlelog.check.spec import Check
from turtlelog.check.surroundings import choose_signals
from turtlelog.check.vocabulary import find_window, require_known_names
from turtlelog.expressions import Comparison, Expression, Name, Temporal, iterate_nodes
from turtlelog.measure import METRICS, SIGNALS, Metric, measure_run
from turtlelog.run import Run


def judge_check(check: Check, run: Run, *, file: str) -> CheckResult:
    """Return what one check comes to; a metric without a value fails it, whatever the formula.

    Raises:
        ExpressionError: Where a name is not there or the kinds do not go together.
    """
    if check.when is not None:
        skipped = _judge_condition(check, check.when, run, file)
        if skipped is not None:
            return skipped
    require_known_names(check.formula, over_time=check.kind == "holds", run=run)
    lacking = _find_lacking(check.formula, run)
    if lacking:
        return _build(check, file, verdict=Verdict.FAIL, reason=lacking)
    judge = _judge_over_time if check.kind == "holds" else _judge_metrics
    return judge(check, run, file)


def _judge_condition(
    check: Check, condition: Expression, run: Run, file: str
) -> CheckResult | None:
    """Return why a check is skipped, or fails as nobody can tell; None where it applies."""
    require_known_names(condition, over_time=False, run=run)
    lacking = _find_lacking(condition, run)
    if lacking:
        return _build(check, file, verdict=Verdict.FAIL, reason=f"when: {lacking}")
    found = check_formula(_read_values(condition, run), condition)
    if found.holds:
        return None
    values = ", ".join(f"{name} = {value}" for name, value in found.values.items())
    reason = f"only when {condition.text}; here {values}"
    return _build(check, file, verdict=Verdict.SKIPPED, reason=reason)


def _judge_metrics(check: Check, run: Run, file: str) -> CheckResult:
    found = check_formula(_read_values(check.formula, run), check.formula)
    failed_s = None if found.holds else _find_moment(check.formula, found.limit, run)
    return replace(_describe(check, found, file), first_violation_s=failed_s)


def _judge_over_time(check: Check, run: Run, file: str) -> CheckResult:
    window_ns = find_window(run, check.phase)
    if window_ns is None:
        reason = f"no_phase (the run has no phase {check.phase})"
        return _build(check, file, verdict=Verdict.FAIL, reason=reason)
    found = check_run(run, check.formula, window_ns=window_ns)
    if found.holds and not _is_told(found, check.formula, run):
        reason = "the recording ends before the formula's window does, and the run had not ended"
        return _build(check, file, verdict=Verdict.FAIL, reason=reason)
    begun_s = (window_ns[0] - run.start_ns) / 1e9
    value_s, failed_s = (
        None if time_s is None else time_s + begun_s
        for time_s in (found.margin_s, found.first_violation_s)
    )
    result = _describe(check, found, file)
    return replace(result, value_s=value_s, first_violation_s=failed_s)


def _is_told(found: FormulaResult, formula: Expression, run: Run) -> bool:
    """Whether a verdict stands on what was recorded; a run that came to its end stays there."""
    is_reached = isinstance(formula.root, Temporal) and formula.root.operator == "eventually"
    return found.is_covered or run.is_complete or is_reached


def _describe(check: Check, found: FormulaResult, file: str) -> CheckResult:
    is_finite = found.margin is not None and math.isfinite(found.margin)
    return replace(
        _build(check, file, verdict=Verdict.PASS if found.holds else Verdict.FAIL),
        value=found.value,
        limit=found.limit,
        margin=found.margin if is_finite else None,
        unit=found.unit,
        decided_by=found.decided_by if _has_several(check.formula) else "",
        reason=found.reason,
    )


def _has_several(formula: Expression) -> bool:
    """Whether a formula holds more than one comparison."""
    links = [node.operators for node in iterate_nodes(formula.root) if isinstance(node, Comparison)]
    return sum(map(len, links)) > 1


def _build(check: Check, file: str, *, verdict: Verdict, reason: str = "") -> CheckResult:
    return CheckResult(
        file=file,
        check=check.name,
        verdict=verdict,
        expected=check.describe(),
        reason=reason,
        names=choose_signals(check.formula.names),
    )


def _find_lacking(formula: Expression, run: Run) -> str:
    """Return the names without a value and why; empty where all have one."""
    metrics = _measure(formula, run)
    lacking = [
        f"{name}: {describe_status(metric)}"
        for name, metric in metrics.items()
        if metric.value is None
    ]
    lacking += [
        f"{name}: the recording does not hold it"
        for name in formula.names
        if name not in SIGNALS and name not in METRICS and name not in run.parameters
    ]
    return "; ".join(lacking)


def describe_status(metric: Metric) -> str:
    """Return why a metric has no value: `no_phase (the run has no phase rotate)`."""
    return f"{metric.status.value} ({metric.reason})"


def _measure(formula: Expression, run: Run) -> Mapping[str, Metric]:
    ids = [name for name in formula.names if name in METRICS and name not in SIGNALS]
    return measure_run(run, only=ids) if ids else {}


def _read_values(formula: Expression, run: Run) -> dict[str, Any]:
    values: dict[str, Any] = {name: found.value for name, found in _measure(formula, run).items()}
    return values | {name: run.parameters[name] for name in formula.names if name in run.parameters}


def _find_moment(formula: Expression, limit: float | None, run: Run) -> float | None:
    """Return when a bound on one metric is first violated; None where there are several."""
    metrics = list(_measure(formula, run).values())
    if len(metrics) != 1:
        return None
    metric, root = metrics[0], formula.root
    if isinstance(root, Comparison) and len(root.operands) == 2 and limit is not None:
        left = root.operands[0]
        if isinstance(left, Name) and left.name == metric.id:
            return find_metric_violation(run, metric, root.operators[0], limit)
    return metric.at_s
