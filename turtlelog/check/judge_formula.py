"""Result of a check: a formula on a run, or a metric that a test compares with a limit."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Real
from typing import Any, NoReturn, Protocol, runtime_checkable

import numpy as np

from turtlelog.check import spec
from turtlelog.check.formula import FormulaResult, check_formula, check_run
from turtlelog.check.formula_trace import find_span, find_window
from turtlelog.check.result import CheckResult, JudgedMetric, Verdict
from turtlelog.display import format_number
from turtlelog.errors import CheckError, MissingValueError
from turtlelog.expressions import Comparison, Expression, Name, iterate_nodes
from turtlelog.measure import (
    COMMANDED,
    MIRRORED,
    OPERATORS,
    SIGNALS,
    MeasureSettings,
    Metric,
    find_first_stretch,
    list_metrics,
    list_signals,
    measure_run,
)
from turtlelog.run import Run, slice_run

Grown = dict[tuple[str, int], float | None]
"""Cache of a metric's values by its id and the number of the last pose, because checks repeat
them."""


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
    metrics = measure_named([check], run) if metrics is None else metrics
    return _Judge(check, run, file, metrics, {} if grown is None else grown)()


def measure_named(
    checks: Sequence[spec.Check],
    run: Run,
    *,
    trajectories: spec.TrajectoryJudge | None = None,
    file: str = "",
) -> Mapping[str, Metric]:
    """Return the metrics of a run that checks name; `trajectories` measures errors of positions."""
    names = spec.list_formula_names(checks)
    ids = sorted(name for name in names if spec.find_kind(run, name) is not None)
    of_robot = spec.measure_robot(run, sorted(names & spec.ROBOT_VALUES.keys()))
    errors = sorted(names & spec.TRAJECTORY_VALUES.keys())
    beside = trajectories.measure(run, errors, file) if trajectories and errors else {}
    return {**(measure_run(run, only=ids) if ids else {}), **of_robot, **beside}


class _Judge:
    def __init__(
        self, check: spec.Check, run: Run, file: str, metrics: Mapping[str, Metric], grown: Grown
    ) -> None:
        self._check, self._run, self._file = check, run, file
        self._metrics, self._grown = metrics, grown

    def __call__(self) -> CheckResult:
        check, formula = self._check, self._check.formula
        if check.when is not None:
            skipped = self._judge_condition(check.when)
            if skipped is not None:
                return skipped
        spec.require_known_names(formula, over_time=check.kind == "holds", run=self._run)
        lacking = self._find_lacking(formula)
        if lacking:
            return self._leave_open(lacking)
        if check.kind == "holds":
            return self._judge_over_time()
        found = self._check_values(formula)
        failed_s = None if found.holds else self._find_moment(found.limit)
        return replace(self._describe(found), first_violation_s=failed_s)

    def _check_values(self, formula: Expression) -> FormulaResult:
        values: dict[str, Any] = {
            name: self._metrics[name].value if name in self._metrics else self._run.parameters[name]
            for name in formula.names
        }
        return check_formula(values, formula, declaration=self._run.declaration)

    def _judge_condition(self, condition: Expression) -> CheckResult | None:
        """Return the reason why a check is skipped or undecided; None if it applies."""
        spec.require_known_names(condition, over_time=False, run=self._run)
        lacking = self._find_lacking(condition)
        if lacking:
            return self._leave_open(f"when: {lacking}")
        found = self._check_values(condition)
        if found.holds is None:
            return self._leave_open(f"when: {found.reason}")
        if found.holds:
            return None
        values = ", ".join(f"{name} = {value}" for name, value in found.values.items())
        reason = f"only when {condition.text}; here {values}"
        return self._build(Verdict.SKIPPED, reason=reason)

    def _judge_over_time(self) -> CheckResult:
        check, run = self._check, self._run
        names = check.formula.names
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
        has_others = any(name in SIGNALS and name not in COMMANDED for name in names)
        if begun_s > 0.0 and not told.reason and not check.phase and has_others:
            told = replace(told, reason=f"judged from the first command on, at {begun_s:.3f} s")
        return replace(told, value_s=value_s, first_violation_s=failed_s)

    def _describe(self, found: FormulaResult) -> CheckResult:
        is_finite = found.margin is not None and math.isfinite(found.margin)
        nodes = iterate_nodes(self._check.formula.root)
        comparisons = sum(len(n.operators) for n in nodes if isinstance(n, Comparison))
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

    def _find_lacking(self, formula: Expression) -> str:
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
        if isinstance(root, Comparison) and len(root.operands) == 2 and limit is not None:
            left = root.operands[0]
            if isinstance(left, Name) and left.name == metric.id:
                operator = root.operators[0]
                return find_metric_violation(self._run, metric, operator, limit, grown=self._grown)
        return metric.at_s


def find_metric_violation(
    run: Run,
    metric: Metric,
    operator: str,
    limit: float,
    settings: MeasureSettings | None = None,
    *,
    grown: Grown | None = None,
) -> float | None:
    """Return when a metric first violates a limit, from the first sample [s].

    A metric that only grows (an error integral, a maximum) violates an upper limit at the first
    pose at which the run so far violates it. An awaited time (a settling time) violates the limit
    when the allowed time is over, a final value at the end of the run. For other metrics, the
    result is the time of the metric, or None if the metric has no time.
    """
    part = metric.id.split(".", 1)[0]
    kind = list_metrics(run.declaration).get(metric.id)
    if kind is not None and operator in {"<", "<="} and metric.value is not None:
        if kind.grows:
            grown = {} if grown is None else grown
            return _find_growth(run, metric.id, operator, limit, settings, grown)
        if kind.is_awaited:  # from the time at which its loop first acts
            loop = run.declaration.find_loop(part)
            stretch = find_first_stretch(run, loop) if loop else []
            start_s = (stretch[0].start_ns - run.start_ns) / 1e9 if stretch else 0.0
            return start_s + max(limit, 0.0)
    if metric.at_s is None and part == "final":
        return (run.end_ns - run.start_ns) / 1e9
    return metric.at_s


def _find_growth(
    run: Run, name: str, operator: str, limit: float, settings: MeasureSettings | None, grown: Grown
) -> float:
    first = int(np.searchsorted(run.poses.time_ns, run.start_ns, side="left"))
    last = len(run.poses) - 1
    while first < last:
        middle = (first + last) // 2
        if (name, middle) not in grown:
            part = slice_run(run, end_ns=int(run.poses.time_ns[middle]))
            part = replace(part, stop_reason=run.stop_reason)  # as if it had ended there
            grown[name, middle] = measure_run(part, settings, only=(name,))[name].value
        value = grown[name, middle]
        if value is not None and not OPERATORS[operator](value, limit):
            last = middle
        else:
            first = middle + 1
    return float(run.poses.time_ns[last] - run.start_ns) / 1e9


Note = Callable[[CheckResult], None]


@runtime_checkable
class Approximate(Protocol):
    """Type of the objects that `pytest.approx` returns for numbers."""

    expected: Any

    @property
    def tolerance(self) -> float:
        """Allowed difference from the number."""


def watch_metric(
    run: Run, file: str, name: str, note: Note, asked: Mapping[str, Any] | None = None
) -> Metric:
    """Return a metric of a recording that notes the result of every comparison.

    If the metric has no value, every comparison raises MissingValueError, whatever the operator.
    `asked` are settings by the names of `MeasureSettings`.
    """
    asked = dict(asked or {})
    try:
        settings = MeasureSettings(**asked)
    except TypeError as err:
        known, found = ", ".join(MeasureSettings.__dataclass_fields__), ", ".join(asked)
        raise CheckError(f"{name}: expected settings among {known}, found {found}") from err
    metric = measure_run(run, settings, only=(name,))[name]
    text = ", ".join(f"{key}={value}" for key, value in asked.items())
    label = f"{name}({text})" if text else name
    watch = RecordedMetric(
        run=run, file=file, note=note, label=label, measured=metric, settings=settings, asked=asked
    )
    return replace(metric, watch=watch)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedMetric:
    """The watch of a recording's metric.

    Attributes:
        note: Function that is called with the result of every comparison.
        label: Text of the compared quantity: `abs(final.cross_track)`.
        measured: Metric as measured.
        asked: Settings that differ from the defaults, by name.
        sign: -1 if the negative of the measured value is compared.
    """

    run: Run
    file: str
    note: Note
    label: str
    measured: Metric
    settings: MeasureSettings
    asked: Mapping[str, Any] = field(default_factory=dict)
    sign: int = 1

    def describe(self, metric: Metric) -> str:  # noqa: ARG002
        """Return the text of the compared quantity."""
        return self.label

    def measure(self, metric: Metric, settings: Mapping[str, Any]) -> Metric:
        """Return the metric measured with other settings."""
        return watch_metric(self.run, self.file, metric.id, self.note, {**self.asked, **settings})

    def negate(self, metric: Metric) -> "RecordedMetric":
        """Return the watch for the absolute value of the metric."""
        sign = -1 if float(metric) < 0 else self.sign
        return replace(self, label=f"abs({self.label})", sign=sign)

    def compare(self, metric: Metric, operator: str, other: object) -> bool:
        """Return the result of a comparison, and record the result with its first violation."""
        result = self.judge(metric, operator, other)
        if result.verdict is Verdict.FAIL and result.limit is not None:
            operator, limit = self._undo_sign(operator, result.limit)
            at_s = find_metric_violation(self.run, self.measured, operator, limit, self.settings)
            result = replace(result, first_violation_s=at_s)
        self.note(result)
        return result.verdict is Verdict.PASS

    def judge(self, metric: Metric, operator: str, other: object) -> CheckResult:
        """Return the result of a comparison without searching for its first violation.

        The other operand is a number, a metric of the same unit, or `pytest.approx` of a number.
        """
        value = metric.value
        if value is None:
            self._miss(metric, f"{operator} {_show(other)}")
        if isinstance(other, Approximate):
            limit = self._read_limit(metric, operator, other.expected)
            expected = _show(other, metric.unit)
            off = other.tolerance - abs(value - limit)
            margin = off if operator == "==" else -off
            holds = OPERATORS[operator](value, other)
        else:
            limit = self._read_limit(metric, operator, other)
            expected = format_number(limit, metric.unit)
            margin = limit - value if operator in {"<", "<="} else value - limit
            if operator in {"==", "!="}:
                margin = abs(value - limit) * (-1.0 if operator == "==" else 1.0) + 0.0
            holds = OPERATORS[operator](value, limit)
        judged, border = self._undo_sign(operator, limit)
        return CheckResult(
            file=self.file,
            check=self.label,
            verdict=Verdict.PASS if holds else Verdict.FAIL,
            expected=f"{operator} {expected}",
            value=value,
            limit=limit,
            margin=margin,
            unit=metric.unit,
            value_s=metric.at_s,
            names=spec.choose_signals([metric.id], self.run.declaration),
            judged=JudgedMetric(metric=self.measured, operator=judged, limit=border),
        )

    def miss(self, metric: Metric) -> NoReturn:
        """Raise MissingValueError for a metric that was used as a number."""
        self._miss(metric, "a number")

    def _undo_sign(self, operator: str, limit: float) -> tuple[str, float]:
        """Return the result of a comparison in terms of the metric as measured."""
        return (MIRRORED[operator], -limit) if self.sign < 0 else (operator, limit)

    def _read_limit(self, metric: Metric, operator: str, other: object) -> float:
        if isinstance(other, Metric):
            if other.unit != metric.unit:
                found = f"{metric.unit} and {other.unit}"
                raise CheckError(f"{self.label}: expected two of one unit, found {found}")
            return float(other)
        place = f"{self.label}: expected a number after {operator}"
        if isinstance(other, bool) or not isinstance(other, Real):
            raise CheckError(f"{place}, found {other!r}")
        try:
            limit = float(other)
        except OverflowError:
            raise CheckError(f"{place}, found one too large for a float") from None
        if math.isnan(limit):
            raise CheckError(f"{place}, found nan")
        return limit

    def _miss(self, metric: Metric, wanted: str) -> NoReturn:
        self.note(
            CheckResult(
                file=self.file,
                check=self.label,
                verdict=Verdict.FAIL,
                expected=wanted,
                reason=metric.lack,
                names=spec.choose_signals([metric.id], self.run.declaration),
                is_decided=False,
            )
        )
        found = f"found no value: {metric.lack}"
        raise MissingValueError(f"{self.file}: {self.label}: expected {wanted}, {found}")


def _show(other: object, unit: str = "") -> str:
    if isinstance(other, Approximate):
        return f"{format_number(float(other.expected), unit)} ± {other.tolerance:.2g}"
    return format_number(other) if isinstance(other, float) else repr(other)
