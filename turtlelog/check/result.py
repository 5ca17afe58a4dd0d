"""What a check comes to on one recording."""

import enum
from collections.abc import Iterable
from dataclasses import dataclass

from turtlelog.check.failures import UndecidedError
from turtlelog.errors import CheckError


class Verdict(enum.StrEnum):
    """What was found."""

    PASS = "PASS"
    FAIL = "FAIL"
    SKIPPED = "SKIPPED"

    def __bool__(self) -> bool:
        raise CheckError(f'verdict {self.value}: expected a comparison with one, such as == "PASS"')


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckResult:
    """One check on one recording. Times count from the first sample.

    Attributes:
        file: The recording.
        check: Its name: of the table in the specification, or what a test asked for.
        verdict: PASS, FAIL or SKIPPED.
        expected: What was to hold, as written.
        value: What was found, in `unit`; None where there is no one number.
        limit: What it was held to, in `unit`.
        margin: Distance to the limit in `unit`, positive where it passes; None where there is none.
        unit: Of the three; empty where they have none.
        value_s: When the value is found [s]; None where it belongs to no moment.
        decided_by: Of several comparisons in a formula that which value, limit and margin are of.
        first_violation_s: When it was first violated [s]; None where it is not, or at no moment.
        reason: Why it fails or is skipped, where figures do not say it.
        names: Signals to look at around the violation.
        is_decided: Whether that is known; where not, the check fails, and `bool` of it raises.
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

    def __bool__(self) -> bool:
        """Whether it passes.

        Raises:
            UndecidedError: Where nobody can tell, or nothing was judged.
        """
        if not self.is_decided or self.verdict is Verdict.SKIPPED:
            raise UndecidedError(f"{self.file}: {self.check}: undecided: {self.reason}")
        return self.verdict is Verdict.PASS


def join_verdicts(results: Iterable[CheckResult]) -> Verdict:
    """Return FAIL where any fails, PASS where any passes, SKIPPED where nothing was judged."""
    found = {result.verdict for result in results}
    order = (Verdict.FAIL, Verdict.PASS)
    return next((verdict for verdict in order if verdict in found), Verdict.SKIPPED)


def find_worst(results: Iterable[CheckResult]) -> list[CheckResult]:
    """Return the result of least margin in each unit, what fails first: units have no order."""
    worst: dict[str, tuple[float, CheckResult]] = {}
    for result in results:
        margin, unit = result.margin, result.unit
        if margin is not None and (unit not in worst or margin < worst[unit][0]):
            worst[unit] = margin, result
    ordered = sorted(worst.values(), key=lambda found: found[0] >= 0)
    return [result for _, result in ordered]


def format_number(number: float | None, unit: str = "") -> str:
    """Return a number with its unit in five digits; `-` for none."""
    if number is None:
        return "-"
    return f"{number:.5g}" + (f" {unit}" if unit not in {"", "1"} else "")
