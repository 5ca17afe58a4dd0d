"""A metric of a recording that reports its comparisons to a test."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from numbers import Real
from typing import Any, NoReturn, Protocol, runtime_checkable

from turtlelog.check.judge_formula import find_metric_violation, measure_margin
from turtlelog.check.result import CheckResult, JudgedMetric, Verdict
from turtlelog.check.vocabulary import choose_signals
from turtlelog.display import format_number
from turtlelog.errors import CheckError, MissingValueError
from turtlelog.measure import MIRRORED, OPERATORS, MeasureSettings, Metric, measure_run
from turtlelog.run import Run

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
    """Return a metric of a recording that records the result of every comparison.

    If the metric has no value, every comparison raises MissingValueError, whatever the operator.

    Args:
        run: Run that is measured.
        file: Name of the run in messages.
        name: Id of the metric.
        note: Function that is called with the results.
        asked: Settings of the metric, by the names of `MeasureSettings`.
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
        run: Run that was measured.
        file: Name of the run in messages.
        note: Function that is called with the result of every comparison.
        label: Text of the compared quantity: `abs(final.cross_track)`.
        measured: Metric as measured.
        settings: Settings of the metric.
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
            violated_s = find_metric_violation(
                self.run, self.measured, operator, limit, self.settings
            )
            result = replace(result, first_violation_s=violated_s)
        self.note(result)
        return result.verdict is Verdict.PASS

    def judge(self, metric: Metric, operator: str, other: object) -> CheckResult:
        """Return the result of a comparison without searching for its first violation.

        Args:
            metric: Watched metric.
            operator: Comparison operator of Python.
            other: A number, a metric of the same unit, or `pytest.approx` of a number.

        Raises:
            CheckError: If the other operand cannot be compared.
            MissingValueError: If either side has no value.
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
            margin = measure_margin(value, operator, limit)
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
            names=choose_signals([metric.id], self.run.declaration),
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
                names=choose_signals([metric.id], self.run.declaration),
                is_decided=False,
            )
        )
        found = f"found no value: {metric.lack}"
        raise MissingValueError(f"{self.file}: {self.label}: expected {wanted}, {found}")


def _show(other: object, unit: str = "") -> str:
    if isinstance(other, Approximate):
        return f"{format_number(float(other.expected), unit)} ± {other.tolerance:.2g}"
    return format_number(other) if isinstance(other, float) else repr(other)
