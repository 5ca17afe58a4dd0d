"""What a question to a recording comes to: true where all of its results pass."""

from dataclasses import dataclass

from turtlelog.check.failures import UndecidedError
from turtlelog.check.junit import describe_result
from turtlelog.check.result import CheckResult, Verdict


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CheckOutcome:
    """Stands for True or False in an assert, and says why; where it is neither, `bool` raises.

    Attributes:
        results: Of everything that was looked at.
    """

    results: tuple[CheckResult, ...]

    def __bool__(self) -> bool:
        """Whether all results pass.

        Raises:
            UndecidedError: Where some are undecided and no other one fails.
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
        """The smallest margin; None where none has one."""
        margins = [result.margin for result in self.results if result.margin is not None]
        return min(margins, default=None)

    def __repr__(self) -> str:
        if not self.failures:
            return f"<PASS: {len(self.results)} checked>"
        word = "FAIL" if self.failures[0].is_decided else "UNDECIDED"
        return f"<{word}: {self._describe_first()}>"

    def _describe_first(self) -> str:
        more = len(self.failures) - 1
        others = f" (and {more} more)" if more else ""
        return f"{describe_result(self.failures[0])}{others}"
