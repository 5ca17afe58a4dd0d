"""Results of checks on a recording; a result may be undecided."""

import enum
from collections.abc import Container, Iterable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from turtlelog.display import format_html, format_number
from turtlelog.errors import CheckError, UndecidedError
from turtlelog.escapes import escape_controls

if TYPE_CHECKING:
    from turtlelog.check.reference import MetricsFile
    from turtlelog.check.spec import Check
    from turtlelog.compare import Tolerance
    from turtlelog.measure import Metric
    from turtlelog.run import Run


class Verdict(enum.StrEnum):
    """Result of a check."""

    PASS = "PASS"
    FAIL = "FAIL"
    SKIPPED = "SKIPPED"

    def __bool__(self) -> bool:
        raise CheckError(f'verdict {self.value}: expected a comparison with one, such as == "PASS"')


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgedSignal:
    """A signal compared with a reference."""

    name: str
    reference: "Run"
    tolerance: "Tolerance"
    alignment: str


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgedMetric:
    """A metric compared with a limit, in the metric's unit."""

    metric: "Metric"
    operator: str
    limit: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckResult:
    """Result of one check on one recording. Times count from the first sample.

    Attributes:
        file: Name of the recording.
        check: Name of the check: its table in the specification, or the question of a test.
        verdict: PASS, FAIL or SKIPPED.
        expected: Checked formula or tolerance, as written.
        value: Measured value, in `unit`; None if the check has no single number.
        limit: Limit of the value, in `unit`.
        margin: Distance to the limit in `unit`, positive for a pass; None without a distance.
        unit: Unit of value, limit and margin; empty if they have no unit.
        value_s: Time of the value [s]; None if the value has no time.
        decided_by: Comparison to which value, limit and margin belong, if the formula has several.
        first_violation_s: Time of the first violation [s]; None if there is no violation, or it has
            no time.
        reason: Why the check fails or is skipped, if the numbers do not show the reason.
        names: Signals to show around the violation.
        is_decided: Whether the verdict is known; otherwise the check fails, and `bool` raises an
            error.
        why: Reason why the run differs from its reference, in lines; empty if not determined.
        reference: Reference run or file of metrics; None without a reference.
        judged: Signal, formula or metric that was judged; None if the check has another subject.
    """

    file: str
    check: str
    verdict: Verdict
    expected: str = ""
    value: float | None = None
    limit: float | None = None
    margin: float | None = None
    unit: str = ""
    value_s: float | None = None
    decided_by: str = ""
    first_violation_s: float | None = None
    reason: str = ""
    names: tuple[str, ...] = ()
    is_decided: bool = True
    why: tuple[str, ...] = ()
    reference: "Run | MetricsFile | None" = field(default=None, repr=False, compare=False)
    judged: "Check | JudgedSignal | JudgedMetric | None" = field(
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

    def __repr__(self) -> str:
        return escape_controls(
            f"<{self.verdict} {self.check} of {self.file}: {describe_result(self)}>"
        )

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
        margins = [result.margin for result in self.results if result.margin is not None]
        return min(margins, default=None)

    def __repr__(self) -> str:
        if not self.failures:
            return f"<PASS: {len(self.results)} checked>"
        word = "FAIL" if self.failures[0].is_decided else "UNDECIDED"
        return f"<{word}: {self._describe_first()}>"

    def _repr_html_(self) -> str:
        return _tabulate_html(self.results, title=repr(self))

    def _describe_first(self) -> str:
        more = len(self.failures) - 1
        others = f" (and {more} more)" if more else ""
        return f"{describe_result(self.failures[0])}{others}"


def join_verdicts(results: Iterable[CheckResult]) -> Verdict:
    """Return FAIL if any verdict is FAIL, PASS if any is PASS, SKIPPED if nothing was judged."""
    return decide_verdict({result.verdict for result in results})


def decide_verdict(found: Container[Verdict]) -> Verdict:
    """Return the joint verdict of a set of verdicts, as in `join_verdicts`."""
    order = (Verdict.FAIL, Verdict.PASS)
    return next((verdict for verdict in order if verdict in found), Verdict.SKIPPED)


def find_worst(results: Iterable[CheckResult]) -> list[CheckResult]:
    """Return for each unit the result with the smallest margin; failures have priority."""

    def passes(result: CheckResult) -> bool:
        return result.verdict is not Verdict.FAIL

    def rank(result: CheckResult) -> tuple[bool, float]:
        # With a margin of 0, a failed strict bound is worse than a passed bound.
        return passes(result), result.margin or 0.0

    worst: dict[str, CheckResult] = {}
    for result in results:
        before = worst.get(result.unit, result)
        if result.margin is not None and (before is result or rank(result) < rank(before)):
            worst[result.unit] = result
    return sorted(worst.values(), key=passes)


def describe_result(result: CheckResult) -> str:
    """Return a result in one line: value, limit, margin, first violation, reason."""
    parts = []
    if result.value is not None:
        parts.append(f"{format_number(result.value, result.unit)}")
    parts += [result.expected] if result.expected else []
    parts += [f"decided by {result.decided_by}"] if result.decided_by else []
    if result.margin is not None:
        parts.append(f"margin {format_number(result.margin, result.unit)}")
    if result.first_violation_s is not None:
        parts.append(f"first violated at {result.first_violation_s:.3f} s")
    parts += [result.reason] if result.reason else []
    return "; ".join(parts)


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
        file=file, check="recording", verdict=Verdict.FAIL, reason=reason, is_decided=False
    )
