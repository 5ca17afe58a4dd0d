"""Results of checks on a recording, and a metric that notes the result of each comparison."""

import enum
import math
from bisect import bisect_left
from collections.abc import Callable, Container, Iterable, Mapping
from dataclasses import dataclass, field, replace
from numbers import Real
from typing import TYPE_CHECKING, Any, NoReturn, Protocol, runtime_checkable

import numpy as np

from turtlelog.check.spec import Check, choose_signals
from turtlelog.compare import Tolerance
from turtlelog.display import NULL_IF_EMPTY, format_html, format_number
from turtlelog.errors import CheckError, MissingValueError, UndecidedError
from turtlelog.escapes import escape_controls
from turtlelog.measure import (
    MIRRORED,
    OPERATORS,
    MeasureSettings,
    Metric,
    find_first_stretch,
    list_metrics,
    measure_run,
)
from turtlelog.run import Run, slice_run, take_rows

if TYPE_CHECKING:
    from turtlelog.check.reference import MetricsFile

Grown = dict[tuple[str, int], float | None]
"""Cache of a metric's values by its id and the number of the last pose, or of the last command of a
log of commands alone, because checks repeat them."""


class Verdict(enum.StrEnum):
    """Result of a check."""

    PASS = "PASS"
    FAIL = "FAIL"
    SKIPPED = "SKIPPED"

    def __bool__(self) -> bool:
        raise CheckError(f'verdict {self.value}: expected a comparison with one, such as == "PASS"')


_RECORDING = "recording"  # the check that fails if a recording cannot be read, or is incomplete


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgedSignal:
    """A signal compared with a reference."""

    name: str
    reference: Run
    tolerance: Tolerance
    alignment: str


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgedMetric:
    """A metric compared with a limit, in the metric's unit."""

    metric: Metric
    operator: str
    limit: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckResult:
    """Result of one check on one recording. Times count from the first sample.

    Attributes:
        file: Name of the recording.
        check: Name of the check.
        verdict: PASS, FAIL or SKIPPED.
        expected: Checked formula or tolerance, as written.
        value: Measured value, in `unit`.
        limit: Limit of the value, in `unit`.
        margin: Distance to the limit in `unit`, positive for a pass.
        unit: Unit of value, limit and margin.
        value_s: Time of the value [s].
        decided_by: Comparison of the formula that decides.
        first_violation_s: Time of the first violation [s].
        reason: Why the check fails or is skipped, if the numbers do not show it.
        names: Signals to show around the violation.
        is_decided: Whether the verdict is known; if not, the check fails, and `bool` raises.
        why: Reason why the run differs from its reference, in lines.
        reference: Reference run or file of metrics; None without a reference.
        judged: Signal, formula or metric that was judged; None if the check has another subject.
    """

    file: str
    check: str
    verdict: Verdict
    expected: str = field(default="", metadata=NULL_IF_EMPTY)
    value: float | None = None
    limit: float | None = None
    margin: float | None = None
    unit: str = field(default="", metadata=NULL_IF_EMPTY)
    value_s: float | None = None
    decided_by: str = field(default="", metadata=NULL_IF_EMPTY)
    first_violation_s: float | None = None
    reason: str = field(default="", metadata=NULL_IF_EMPTY)
    names: tuple[str, ...] = field(default=(), repr=False)
    is_decided: bool = field(default=True, metadata={"json": "decided"})
    why: tuple[str, ...] = ()
    reference: "Run | MetricsFile | None" = field(default=None, repr=False, compare=False)
    judged: Check | JudgedSignal | JudgedMetric | None = field(
        default=None, repr=False, compare=False
    )

    def __bool__(self) -> bool:
        """Whether the check passes.

        Raises:
            UndecidedError: If the verdict is unknown, or nothing was judged.
        """
        if not self.is_decided or self.verdict is Verdict.SKIPPED:
            raise UndecidedError(f"{self.file}: {self.check}: undecided: {self.reason}")
        return self.verdict is Verdict.PASS

    @property
    def is_lost(self) -> bool:
        """Whether the recording cannot be read, so that no check was judged."""
        return self.check == _RECORDING and not self.is_decided

    def __repr__(self) -> str:
        told = describe_result(self)
        return escape_controls(f"<{self.verdict} {self.check} of {self.file}: {told}>")

    def _repr_html_(self) -> str:
        return _tabulate_html([self], title="")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CheckOutcome:
    """True or False in an assert, with the results; if undecided, `bool` raises an error."""

    results: tuple[CheckResult, ...]

    def __bool__(self) -> bool:
        """Whether all results pass; UndecidedError if some are undecided and no other fails."""
        failures = self.failures
        if not failures or failures[0].is_decided:
            return not failures
        raise UndecidedError(f"{failures[0].file}: undecided: {self._describe_first()}")

    def __eq__(self, other: object) -> bool:
        """Compare with True or False."""
        return bool(self) is other if isinstance(other, bool) else self is other

    __hash__ = None  # type: ignore[assignment]

    @property
    def failures(self) -> tuple[CheckResult, ...]:
        """The results that fail, followed by the undecided ones."""
        failed = [result for result in self.results if result.verdict is Verdict.FAIL]
        return tuple(sorted(failed, key=lambda result: not result.is_decided))

    @property
    def margin(self) -> float | None:
        """Smallest margin; None if no result has a margin."""
        return min((one.margin for one in self.results if one.margin is not None), default=None)

    def __repr__(self) -> str:
        if not self.failures:
            return f"<PASS: {len(self.results)} checked>"
        word = "FAIL" if self.failures[0].is_decided else "UNDECIDED"
        return f"<{word}: {self._describe_first()}>"

    def _repr_html_(self) -> str:
        return _tabulate_html(self.results, title=repr(self))

    def _describe_first(self) -> str:
        more = len(self.failures) - 1
        return describe_result(self.failures[0]) + (f" (and {more} more)" if more else "")


def join_verdicts(results: Iterable[CheckResult]) -> Verdict:
    """Return FAIL if any verdict is FAIL, PASS if any is PASS, SKIPPED if nothing was judged."""
    return decide_verdict({result.verdict for result in results})


def decide_verdict(found: Container[Verdict]) -> Verdict:
    """Return the joint verdict of a set of verdicts, as in `join_verdicts`."""
    order = (Verdict.FAIL, Verdict.PASS)
    return next((verdict for verdict in order if verdict in found), Verdict.SKIPPED)


def find_worst(results: Iterable[CheckResult]) -> list[CheckResult]:
    """Return for each unit the result with the smallest margin; failures have priority."""

    def rank(result: CheckResult) -> tuple[bool, float]:
        # With a margin of 0, a failed strict bound is worse than a passed bound.
        return result.verdict is not Verdict.FAIL, result.margin or 0.0

    worst: dict[str, CheckResult] = {}
    for result in results:
        before = worst.get(result.unit, result)
        if result.margin is not None and (before is result or rank(result) < rank(before)):
            worst[result.unit] = result
    return sorted(worst.values(), key=lambda result: rank(result)[0])


def describe_result(result: CheckResult) -> str:
    """Return a result in one line: value, limit, margin, first violation, reason."""
    at_s, unit = result.first_violation_s, result.unit
    parts = (
        "" if result.value is None else format_number(result.value, unit),
        result.expected,
        result.decided_by and f"decided by {result.decided_by}",
        "" if result.margin is None else f"margin {format_number(result.margin, unit)}",
        "" if at_s is None else f"first violated at {at_s:.3f} s",
        result.reason,
    )
    return "; ".join(filter(None, parts))


def _tabulate_html(results: Iterable[CheckResult], *, title: str) -> str:
    heads = ("file", "check", "verdict", "value", "margin", "expected", "reason")
    rows = []
    for one in results:
        numbers = [format_number(number, one.unit) for number in (one.value, one.margin)]
        rows.append((one.file, one.check, one.verdict.value, *numbers, one.expected, one.reason))
    return format_html(rows, heads=heads, title=title)


def fail_recording(file: str, reason: str) -> CheckResult:
    """Return the result for a recording on which no check could be judged."""
    return CheckResult(
        file=file, check=_RECORDING, verdict=Verdict.FAIL, reason=reason, is_decided=False
    )


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
    pose at which the run so far violates it; without poses, at the first command. An awaited time
    (a settling time) violates the limit when the allowed time is over, a final value at the end of
    the run. For other metrics, the result is the time of the metric, or None if it has no time.
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
    time_ns = (run.poses if len(run.poses) else run.commands).time_ns

    def is_violated(row: int) -> bool:
        if (name, row) not in grown:
            part = replace(run, commands=take_rows(run.commands, slice(row + 1)))
            if len(run.poses):
                part = slice_run(run, end_ns=int(time_ns[row]))
            part = replace(part, stop_reason=run.stop_reason)  # as if it had ended there
            grown[name, row] = measure_run(part, settings, only=(name,))[name].value
        value = grown[name, row]
        return value is not None and not OPERATORS[operator](value, limit)

    last = len(time_ns) - 1
    first = min(int(np.searchsorted(time_ns, run.start_ns)), last)
    row = bisect_left(range(last), x=True, lo=first, key=is_violated)
    return float(time_ns[row] - run.start_ns) / 1e9


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
        if (value := metric.value) is None:
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
        lack = f"expected {wanted}, found no value: {metric.lack}"
        raise MissingValueError(f"{self.file}: {self.label}: {lack}")


def _show(other: object, unit: str = "") -> str:
    if isinstance(other, Approximate):
        return f"{format_number(float(other.expected), unit)} ± {other.tolerance:.2g}"
    return format_number(other) if isinstance(other, float) else repr(other)
