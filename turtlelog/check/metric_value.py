"""A metric that a test compares by a plain assert."""

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import replace
from numbers import Real
from typing import Any, Protocol, runtime_checkable

from turtlelog.check.judge_formula import (
    MIRRORED,
    OPERATORS,
    find_metric_violation,
    measure_margin,
)
from turtlelog.check.result import (
    CheckResult,
    JudgedMetric,
    MissingValueError,
    Verdict,
    describe_status,
)
from turtlelog.check.vocabulary import choose_signals
from turtlelog.display import format_number
from turtlelog.errors import CheckError
from turtlelog.measure import MeasureSettings, Metric, Status, measure_run
from turtlelog.run import Run


class FloatArithmetic(ABC):
    """Computes as its float does; numpy leaves the comparison with it to it."""

    __array_ufunc__ = None

    @abstractmethod
    def __float__(self) -> float:
        """Return the number."""

    def __neg__(self) -> float:
        return -float(self)

    def __pos__(self) -> float:
        return float(self)

    def __round__(self, digits: int | None = None) -> float:
        return round(float(self), digits)

    def __add__(self, other: Any) -> Any:
        return float(self) + other

    def __radd__(self, other: Any) -> Any:
        return other + float(self)

    def __sub__(self, other: Any) -> Any:
        return float(self) - other

    def __rsub__(self, other: Any) -> Any:
        return other - float(self)

    def __mul__(self, other: Any) -> Any:
        return float(self) * other

    def __rmul__(self, other: Any) -> Any:
        return other * float(self)

    def __truediv__(self, other: Any) -> Any:
        return float(self) / other

    def __rtruediv__(self, other: Any) -> Any:
        return other / float(self)

    def __pow__(self, other: Any) -> Any:
        return float(self) ** other

    def __rpow__(self, other: Any) -> Any:
        return other ** float(self)


Note = Callable[[CheckResult], None]


@runtime_checkable
class Approximate(Protocol):
    """What `pytest.approx` makes of a number."""

    expected: Any

    @property
    def tolerance(self) -> float:
        """How far from it."""


class MetricValue(FloatArithmetic):
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
        self._label, self._sign = self._name(name), 1
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
        return self._require_value("a number")

    def __abs__(self) -> "MetricValue":
        """Return its magnitude, to be compared in the same way."""
        value = float(self)
        found = copy.copy(self)
        found.metric = replace(self.metric, value=abs(value))
        found._label, found._sign = f"abs({self._label})", -1 if value < 0 else self._sign
        return found

    def __format__(self, spec: str) -> str:
        return repr(self) if self.value is None else format(self.value, spec)

    def __bool__(self) -> bool:
        raise CheckError(f"{self._label}: compare it with a limit")

    def __repr__(self) -> str:
        if self.value is None:
            return f"<{self._label}: {describe_status(self.metric)}>"
        return f"<{self._label} = {self._format(self.value)}>"

    def judge(self, operator: str, other: object) -> CheckResult:
        """Return what a comparison comes to, its first violation not looked for.

        Args:
            operator: Of Python.
            other: A number, a metric of the same unit, or `pytest.approx` of a number.

        Raises:
            CheckError: Where it is nothing to compare with.
            MissingValueError: Where either has no value.
        """
        value = self._require_value(f"{operator} {_show(other)}")
        if isinstance(other, Approximate):
            limit, expected = self._read_limit(operator, other.expected), _show(other, self.unit)
            off = other.tolerance - abs(value - limit)
            margin = off if operator == "==" else -off
            holds = OPERATORS[operator](value, other)
        else:
            limit = self._read_limit(operator, other)
            expected, margin = self._format(limit), measure_margin(value, operator, limit)
            holds = OPERATORS[operator](value, limit)
        return CheckResult(
            file=self._file,
            check=self._label,
            verdict=Verdict.PASS if holds else Verdict.FAIL,
            expected=f"{operator} {expected}",
            value=value,
            limit=limit,
            margin=margin,
            unit=self.unit,
            value_s=self.at_s,
            names=choose_signals([self.metric.id], self._run.declaration),
            judged=self._describe_judged(operator, limit),
        )

    def _describe_judged(self, operator: str, limit: float) -> JudgedMetric:
        if self._sign < 0:
            operator, limit = MIRRORED[operator], -limit
        return JudgedMetric(metric=self.metric, operator=operator, limit=limit)

    def _compare(self, operator: str, other: object) -> bool:
        result = self.judge(operator, other)
        if result.verdict is Verdict.FAIL and result.limit is not None:
            result = replace(result, first_violation_s=self._find_violation(operator, result.limit))
        self._note(result)
        return result.verdict is Verdict.PASS

    def _find_violation(self, operator: str, limit: float) -> float | None:
        if self._sign < 0:
            operator, limit = MIRRORED[operator], -limit
        return find_metric_violation(self._run, self.metric, operator, limit, self._settings)

    def _read_limit(self, operator: str, other: object) -> float:
        if isinstance(other, MetricValue):
            if other.unit != self.unit:
                found = f"{self.unit} and {other.unit}"
                raise CheckError(f"{self._label}: expected two of one unit, found {found}")
            return float(other)
        place = f"{self._label}: expected a number after {operator}"
        if isinstance(other, bool) or not isinstance(other, Real):
            raise CheckError(f"{place}, found {other!r}")
        try:
            limit = float(other)
        except OverflowError:
            raise CheckError(f"{place}, found one too large for a float") from None
        if math.isnan(limit):
            raise CheckError(f"{place}, found nan")
        return limit

    def _require_value(self, wanted: str) -> float:
        if self.value is not None:
            return self.value
        reason = describe_status(self.metric)
        self._note(
            CheckResult(
                file=self._file,
                check=self._label,
                verdict=Verdict.FAIL,
                expected=wanted,
                reason=reason,
                names=choose_signals([self.metric.id], self._run.declaration),
                is_decided=False,
            )
        )
        found = f"found no value: {reason}"
        raise MissingValueError(f"{self._file}: {self._label}: expected {wanted}, {found}")

    def _format(self, number: float) -> str:
        return format_number(number, self.unit)

    def _name(self, name: str) -> str:
        asked = ", ".join(f"{key}={value}" for key, value in self._asked.items())
        return f"{name}({asked})" if asked else name


def _show(other: object, unit: str = "") -> str:
    if isinstance(other, Approximate):
        return f"{format_number(float(other.expected), unit)} ± {other.tolerance:.2g}"
    return format_number(other) if isinstance(other, float) else repr(other)


Real.register(MetricValue)  # pytest.approx compares with nothing else
