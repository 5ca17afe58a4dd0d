"""What a check comes to on one recording, and a question to one; both may be undecided."""

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


class PartialLogError(CheckError, AssertionError):
    """A recording is incomplete, and the caller did not allow that."""


class Verdict(enum.StrEnum):
    """Result of a check."""

    PASS = "PASS"
    FAIL = "FAIL"
    SKIPPED = "SKIPPED"

    def __bool__(self) -> bool:
        raise CheckError(f'verdict {self.value}: expected a comparison with one, such as == "PASS"')


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgedSignal:
    """A signal that was held to a reference, as it was."""

    name: str
    reference: "Run"
    tolerance: "Tolerance"
    alignment: str


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgedMetric:
    """A metric that was held to a limit, in the metric's unit."""

    metric: "Metric"
    operator: str
    limit: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckResult:
    """One check on one recording. Times count from the first sample.

    Attributes:
        file: The recording.
        check: Its name: of the table in the specification, or what a test asked for.
        verdict: PASS, FAIL or SKIPPED.
        expected: Checked formula or tolerance, as written.
        value: Measured value, in `unit`; None if there is no single number.
        limit: Limit of the value, in `unit`.
        margin: Distance to the limit in `unit`, positive where it passes; None if there is none.
        unit: Unit of the three; empty if they have none.
        value_s: Time at which the value is found [s]; None if it belongs to no moment.
        decided_by: Comparison of the formula to which value, limit and margin belong, if it has
            several.
        first_violation_s: Time of the first violation [s]; None if there is none, or it has no
            moment.
        reason: Why it fails or is skipped, where figures do not say it.
        names: Signals to look at around the violation.
        is_decided: Whether that is known; where not, the check fails, and `bool` of it raises.
        why: Why the run is another one than its reference, in lines; empty if that was not asked.
        reference: The run, or the file of metrics, that it was held to; None without one.
        judged: Signal, formula or metric that was judged; None if that is no signal, formula or
            metric.
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
        """Whether it passes.

        Raises:
            UndecidedError: If nobody can tell, or nothing was judged.
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
    """Stands for True or False in an assert, and says why; where it is neither, `bool` raises.

    Attributes:
        results: Results of everything that was looked at.
    """

    results: tuple[CheckResult, ...]

    def __bool__(self) -> bool:
        """Whether all results pass.

        Raises:
            UndecidedError: If some are undecided and no other one fails.
        """
        failures = self.failures
        if not failures or failures[0].is_decided:
            return not failures
        raise UndecidedError(f"{failures[0].file}: undecided: {self._describe_first()}")

    def __eq__(self, other: object) -> bool:
        """Compare with True or False, as which it stands."""
        return bool(self) is other if isinstance(other, bool) else self is other

    __hash__ = None  # type: ignore[assignment]

    @property
    def failures(self) -> tuple[CheckResult, ...]:
        """The results that fail, and after them those that are undecided."""
        failed = [result for result in self.results if result.verdict is Verdict.FAIL]
        return tuple(sorted(failed, key=lambda result: not result.is_decided))

    @property
    def margin(self) -> float | None:
        """The smallest margin; None if none has one."""
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
    """Return FAIL where any fails, PASS where any passes, SKIPPED where nothing was judged."""
    return decide_verdict({result.verdict for result in results})


def decide_verdict(found: Container[Verdict]) -> Verdict:
    """Return the verdict of all where some are found, as `join_verdicts`."""
    order = (Verdict.FAIL, Verdict.PASS)
    return next((verdict for verdict in order if verdict in found), Verdict.SKIPPED)


def find_worst(results: Iterable[CheckResult]) -> list[CheckResult]:
    """Return the result of least margin in each unit, what fails first: units have no order."""
    worst: dict[str, CheckResult] = {}
    for result in results:
        before = worst.get(result.unit, result)
        if result.margin is not None and (before is result or _rank(result) < _rank(before)):
            worst[result.unit] = result
    return sorted(worst.values(), key=_passes)


def _rank(result: CheckResult) -> tuple[bool, float]:
    # A strict bound that fails with a margin of 0 is worse than one that passes with it.
    return _passes(result), result.margin or 0.0


def _passes(result: CheckResult) -> bool:
    return result.verdict is not Verdict.FAIL


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
    rows = [
        (
            *(one.file, one.check, one.verdict.value, format_number(one.value, one.unit)),
            *(format_number(one.margin, one.unit), one.expected, one.reason),
        )
        for one in results
    ]
    return format_html(rows, heads=heads, title=title)
