"""A metric that a test compares by a plain assert."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from turtlelog.check.failures import MissingValueError
from turtlelog.check.judge_formula import describe_status
from turtlelog.check.moments import find_metric_violation
from turtlelog.check.operators import OPERATORS, compare_numbers, measure_margin
from turtlelog.check.result import CheckResult, Verdict, format_number
from turtlelog.check.surroundings import choose_signals
from turtlelog.errors import CheckError
from turtlelog.measure import MeasureSettings, Metric, Status, measure_run
from turtlelog.run import Run

Note = Callable[[CheckResult], None]

MIRRORED = {"<": ">", "<=": ">=", ">": "<", ">=": "<=", "==": "==", "!=": "!="}


class MetricValue:
    """One metric of one recording, compared as a number; called, it is measured otherwise.

    Where it has no value every comparison raises MissingValueError, whatever the operator.

    Args:
        run: That was measured.
        file: Its name in messages.
        name: Id of the metric.
        note: Takes the result of every comparison.
        settings: How it is measured, by the names of `MeasureSettings`.
    """

    __hash__ = None  # type: ignore[assignment]

    def __init__(
        self,
        run: Run,
        file: str,
        name: str,
        note: Note,
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        self._run, self._file, self._note = run, file, note
        self._asked = dict(settings or {})
        try:
            self._settings = MeasureSettings(**self._asked)
        except TypeError as err:
            known = ", ".join(MeasureSettings.__dataclass_fields__)
            found = ", ".join(self._asked)
            raise CheckError(f"{name}: expected settings among {known}, found {found}") from err
        self.metric: Metric = measure_run(run, self._settings, only=(name,))[name]

    @property
    def value(self) -> float | None:
        """In the metric's unit, None where it has none."""
        return self.metric.value

    @property
    def unit(self) -> str:
        """Of the value."""
        return self.metric.unit

    @property
    def status(self) -> Status:
        """Whether there is a value, and if not, why."""
        return self.metric.status

    @property
    def at_s(self) -> float | None:
        """When it is taken, from the first sample [s]; None where it belongs to no moment."""
        return self.metric.at_s

    def __call__(self, **settings: Any) -> "MetricValue":
        """Return the metric measured with other settings: `settling_time(band=0.05)`."""
        asked = {**self._asked, **settings}
        return MetricValue(self._run, self._file, self.metric.id, self._note, asked)

    def __lt__(self, other: Any) -> bool:
        return self._compare("<", other)

    def __le__(self, other: Any) -> bool:
        return self._compare("<=", other)

    def __gt__(self, other: Any) -> bool:
        return self._compare(">", other)

    def __ge__(self, other: Any) -> bool:
        return self._compare(">=", other)

    def __eq__(self, other: object) -> bool:
        return self._compare("==", other)

    def __ne__(self, other: object) -> bool:
        return self._compare("!=", other)

    def __float__(self) -> float:
        return self._require_value("as a number")

    def __bool__(self) -> bool:
        raise CheckError(f"{self._name()}: expected a comparison with a limit, found none")

    def __repr__(self) -> str:
        if self.value is None:
            return f"<{self._name()}: {describe_status(self.metric)}>"
        return f"<{self._name()} = {format_number(self.value, self.unit)}>"

    def judge(self, operator: str, limit: float) -> CheckResult:
        """Return what a comparison with a number comes to, its first violation not looked for."""
        value = self._require_value(f"{operator} {limit:g}")
        holds = compare_numbers(value, operator, limit)
        return CheckResult(
            file=self._file,
            check=self._name(),
            verdict=Verdict.PASS if holds else Verdict.FAIL,
            expected=f"{operator} {format_number(limit, self.unit)}",
            value=value,
            limit=limit,
            margin=measure_margin(value, operator, limit),
            unit=self.unit,
            names=choose_signals([self.metric.id]),
        )

    def _compare(self, operator: str, other: Any) -> bool:
        if isinstance(other, MetricValue):
            if other.unit != self.unit:
                found = f"{self.unit} and {other.unit}"
                raise CheckError(f"{self._name()}: expected two of one unit, found {found}")
            other = float(other)
        if isinstance(other, bool) or not isinstance(other, int | float):
            # pytest.approx and numpy's numbers know how to compare themselves with a number.
            value = self._require_value(f"{operator} {other!r}")
            return bool(OPERATORS[operator](value, other))
        limit = float(other)
        result = self.judge(operator, limit)
        if result.verdict is Verdict.FAIL:
            first_s = find_metric_violation(self._run, self.metric, operator, limit, self._settings)
            result = replace(result, first_violation_s=first_s)
        self._note(result)
        return result.verdict is Verdict.PASS

    def _require_value(self, wanted: str) -> float:
        if self.value is not None:
            return self.value
        reason = describe_status(self.metric)
        self._note(
            CheckResult(
                file=self._file,
                check=self._name(),
                verdict=Verdict.FAIL,
                expected=wanted,
                reason=reason,
                names=choose_signals([self.metric.id]),
            )
        )
        found = f"found no value: {reason}"
        raise MissingValueError(f"{self._file}: {self._name()}: expected {wanted}, {found}")

    def _name(self) -> str:
        asked = ", ".join(f"{key}={value}" for key, value in self._asked.items())
        return f"{self.metric.id}({asked})" if asked else self.metric.id
