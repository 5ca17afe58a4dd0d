"""A metric: a number with a unit, usable in arithmetic, or the reason why it is missing."""

import enum
import math
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from numbers import Real
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, NoReturn, Protocol

import numpy as np
from numpy.typing import NDArray

from turtlelog import display
from turtlelog.errors import CheckError, MeasureError, MissingValueError
from turtlelog.run.tables import Tabular, refuse_array


class Status(enum.StrEnum):
    """Whether a metric has a value; if not, the kind of reason."""

    OK = "ok"
    NOT_REACHED = "not_reached"
    """The event that the metric measures is not in the recording."""
    NO_STEP = "no_step"
    """The phase begins at its reference, so there is no step to respond to."""
    NO_MOTION = "no_motion"
    """The turtle ended where it began, so that a ratio to the distance is undefined."""
    NO_PHASE = "no_phase"
    """The run has no such phase."""
    TOO_SHORT = "too_short"
    """There are too few rows, or the run was cut off before the required time."""
    TOO_LARGE = "too_large"
    """The value exceeds the largest floating-point number."""
    ABSENT = "absent"
    """The recording does not contain the required data."""
    UNDETERMINED = "undetermined"
    """Several values fit the recording equally well, or no value fits."""

    @property
    def words(self) -> str:
        """Status as text for people: `not reached`."""
        return self.value.replace("_", " ")


class MetricWatch(Protocol):
    """Object that is called when a metric is compared, for example to report checks."""

    def compare(self, metric: "Metric", operator: str, other: object) -> bool:
        """Return the result of a comparison."""

    def miss(self, metric: "Metric") -> NoReturn:
        """Raise MissingValueError for a metric that was used as a number."""

    def negate(self, metric: "Metric") -> "MetricWatch":
        """Return the watch for the absolute value of the metric."""

    def measure(self, metric: "Metric", settings: Mapping[str, Any]) -> "Metric":
        """Return the metric measured with other settings."""

    def describe(self, metric: "Metric") -> str:
        """Return the metric's name with the operations applied to it."""


_Operation = Callable[[Any, Any], Any]


def _operate(operation: _Operation) -> _Operation:
    return lambda self, other: operation(float(self), other)


def _operate_mirrored(operation: _Operation) -> _Operation:
    return lambda self, other: operation(other, float(self))


class Numeric(ABC):
    """Object that behaves like its float in arithmetic, also with numpy's numbers and arrays."""

    __slots__ = ()

    @abstractmethod
    def __float__(self) -> float:
        """Return the number."""

    def __int__(self) -> int:
        return int(float(self))

    def __array__(self, dtype: Any = None, *, copy: bool | None = None) -> NDArray[Any]:
        return np.array(float(self), dtype=dtype)

    def __array_ufunc__(self, function: np.ufunc, method: str, *inputs: Any, **named: Any) -> Any:
        """Compute with the float. Comparisons use the object's own operators on either side."""
        compared = _OF_NUMPY.get(function.__name__)
        if compared and method == "__call__" and len(inputs) == 2 and not named:
            # numpy passes its numbers as arrays without a dimension.
            left, right = (one[()] if isinstance(one, np.ndarray) else one for one in inputs)
            if isinstance(left, Numeric):
                return OPERATORS[compared](left, right)
            return OPERATORS[MIRRORED[compared]](right, left)
        numbers = (float(one) if isinstance(one, Numeric) else one for one in inputs)
        return getattr(function, method)(*numbers, **named)

    def __neg__(self) -> float:
        return -float(self)

    def __pos__(self) -> float:
        return float(self)

    def __round__(self, digits: int | None = None) -> float:
        return round(float(self), digits)

    __add__ = __radd__ = _operate(operator.add)
    __mul__ = __rmul__ = _operate(operator.mul)
    __sub__, __rsub__ = _operate(operator.sub), _operate_mirrored(operator.sub)
    __truediv__, __rtruediv__ = _operate(operator.truediv), _operate_mirrored(operator.truediv)
    __pow__, __rpow__ = _operate(operator.pow), _operate_mirrored(operator.pow)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Metric(Numeric):
    """Metric of a run: a number with a unit, or the reason why the number is missing.

    A metric behaves as the float `value` in arithmetic, sorting, formatting and comparisons. A
    metric without a value raises MissingValueError when it is used as a number, also in `!=`, so
    that no test passes by mistake. `==` of two metrics compares value and unit, or status and
    reason if both lack a value; it raises no error. `hash` uses the value. `bool` raises an error,
    because a metric of 0 is not a failure.

    Attributes:
        id: `<phase, final or run>.<metric>`.
        value: Value in `unit`; None exactly if `status` is not `ok`.
        unit: `s`, `m`, `deg`, `%`, `1` or a product of units, as in `m^2 s`.
        status: Whether the metric has a value.
        reason: Reason why the value is missing, as a clause; otherwise empty.
        at_s: Time of the value from the first sample [s]: time of a peak, end of a rise, time of
            the largest jump. None if the value has no time.
        watch: Object that is called at comparisons; None for most metrics. If a watched metric has
            no value, `==` and `!=` with it raise an error.
    """

    id: str
    value: float | None
    unit: str
    status: Status = Status.OK
    reason: str = ""
    at_s: float | None = None
    watch: MetricWatch | None = None

    def to_dict(self) -> dict[str, str | float | None]:
        """Return the entry of JSON answers and references."""
        return {
            "id": self.id,
            "value": self.value,
            "unit": self.unit,
            "status": self.status.value,
            "reason": self.reason or None,
            "at_s": self.at_s,
        }

    def __float__(self) -> float:
        if self.value is not None:
            return self.value
        if self.watch is not None:
            self.watch.miss(self)
        raise MissingValueError(f"{self.id}: expected a number, found no value: {self.lack}")

    @property
    def lack(self) -> str:
        """Reason for a missing value: `no_phase (the run has no phase rotate)`; otherwise empty."""
        return "" if self.value is not None else f"{self.status.value} ({self.reason})"

    def __call__(self, **settings: Any) -> "Metric":
        """Return the metric of a recording with other settings: `settling_time(band=0.05)`."""
        if self.watch is None:
            raise MeasureError(f"{self.id}: expected measure_run(run, MeasureSettings(...))")
        return self.watch.measure(self, settings)

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

    def __hash__(self) -> int:
        return hash(self._key if self.value is None else self.value)

    def _compare(self, operator: str, other: object) -> bool:
        watch = self.watch
        if watch is not None:
            return watch.compare(self, operator, other)
        if not isinstance(other, Metric):
            is_number = isinstance(other, Real | np.ndarray) or operator not in {"==", "!="}
            return OPERATORS[operator](float(self), other) if is_number else operator == "!="
        if other.watch is not None:
            return other.watch.compare(other, MIRRORED[operator], self)
        if operator in {"==", "!="}:
            return (self._key == other._key) is (operator == "==")
        if self.unit != other.unit:
            found = f"{self.unit} and {other.unit}"
            raise MeasureError(f"{self.id}: expected two metrics of one unit, found {found}")
        return OPERATORS[operator](float(self), float(other))

    @property
    def _key(self) -> tuple[object, ...]:
        return self.value, self.unit, self.status, self.reason

    def __abs__(self) -> "Metric":
        """Return the magnitude of the metric, whose comparisons are watched like the metric's."""
        watch = None if self.watch is None else self.watch.negate(self)
        return replace(self, value=abs(float(self)), watch=watch)

    def __format__(self, spec: str) -> str:
        return repr(self) if self.value is None else format(self.value, spec)

    def __bool__(self) -> bool:
        raise CheckError(f"{self._describe()}: compare it with a limit")

    def _describe(self) -> str:
        return self.id if self.watch is None else self.watch.describe(self)

    def __repr__(self) -> str:
        known = self.value is not None
        text = display.format_number(self.value, self.unit) if known else self.lack
        return display.fit_line(f"<Metric {self._describe()}: {text}>")

    def _repr_html_(self) -> str:
        value = self.lack if self.value is None else display.format_number(self.value, self.unit)
        return display.format_notebook(f"{self._describe()}: {value}")


OPERATORS: Final[Mapping[str, Callable[[Any, Any], bool]]] = MappingProxyType(
    {
        "<": operator.lt,
        "<=": operator.le,
        ">": operator.gt,
        ">=": operator.ge,
        "==": operator.eq,
        "!=": operator.ne,
    }
)

MIRRORED: Final = MappingProxyType(
    {"<": ">", "<=": ">=", ">": "<", ">=": "<=", "==": "==", "!=": "!="}
)
"""Operators after exchanging or negating both sides."""

_UFUNCS: Final = ("less", "less_equal", "greater", "greater_equal", "equal", "not_equal")
_OF_NUMPY: Final = MappingProxyType(dict(zip(_UFUNCS, OPERATORS, strict=True)))

Real.register(Metric)  # pytest.approx accepts no other types

if TYPE_CHECKING:
    _MetricMapping = Mapping[str, Metric]
else:

    class _MetricMapping:
        """Base with the methods of a Mapping but no subclass: polars would read one as columns."""

        __slots__ = ()
        __contains__, get = Mapping.__contains__, Mapping.get
        keys, values, items = Mapping.keys, Mapping.values, Mapping.items


class Metrics(_MetricMapping, Tabular):
    """Metrics by id, read-only; a table for pandas, polars and Arrow, and in a notebook.

    `==` compares values, units, statuses and reasons. Metrics have no hash.

    Attributes:
        first: Ids of the metrics to look at first; all metrics if empty.
    """

    __slots__ = ("_found", "first")
    __hash__ = None  # type: ignore[assignment]

    def __init__(self, found: Iterable[tuple[str, Metric]], *, first: Sequence[str] = ()) -> None:
        self._found = dict(found)
        self.first = tuple(first)

    def __getitem__(self, name: str) -> Metric:
        return self._found[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._found)

    def __len__(self) -> int:
        return len(self._found)

    def __repr__(self) -> str:
        known = sum(metric.value is not None for metric in self.values())
        return f"<Metrics: {len(self)}, of which {known} have a value>"

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Metrics):
            return self._found == other
        mine, others = ({key: one.to_dict() for key, one in of.items()} for of in (self, other))
        return mine == others

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(Metrics, first=self.first), ([*self.items()],)

    def __array__(self, dtype: Any = None, *, copy: bool | None = None) -> NoReturn:
        refuse_array(self)

    def _tabulate(self) -> Mapping[str, Any]:
        listed = [metric.to_dict() for metric in self.values()]
        table = {name: [one[name] for one in listed] for name in _ENTRIES}
        # A column without any number is a column of numbers, too.
        numbers = {name: np.array(table[name], dtype=np.float64) for name in ("value", "at_s")}
        return table | numbers

    def _repr_html_(self) -> str:
        shown = [self[name] for name in self.first if name in self]
        told = [
            f"{name} {display.format_number(self[name].value, self[name].unit)}"
            for name in _ANSWERS
            if name in self and self[name].value is not None
        ]
        known = sum(metric.value is not None for metric in self.values())
        told.append(f"{known} of {display.describe_count(len(self), 'metric')} have a value")
        answer = f"{', '.join(told)}."
        if len(shown) in {0, len(self)}:
            return display.format_notebook(answer, _format_metrics_html(self.values()))
        every = display.format_folded(
            f"All {len(self)} metrics", _format_metrics_html(self.values())
        )
        return display.format_notebook(answer, _format_metrics_html(shown), every)


_ANSWERS: Final = ("final.position_error", "run.duration")
"""Metrics in the first line if they have a value."""

_ENTRIES: Final = ("id", "value", "unit", "status", "reason", "at_s")


def _format_metrics_html(metrics: Iterable[Metric]) -> str:
    rows = [
        (one.id, one.value, one.unit, one.reason if one.value is None else "") for one in metrics
    ]
    return display.format_html(rows, heads=("metric", "value", "unit", "no value because"))


@dataclass(frozen=True, slots=True)
class Missing:
    """Reason why a metric has no value."""

    status: Status
    reason: str


NO_POSES: Final = Missing(Status.ABSENT, "the recording holds no poses")
ONE_POSE: Final = Missing(Status.TOO_SHORT, "1 pose")


@dataclass(frozen=True, slots=True)
class Found:
    """A value in the metric's unit, and its time from the first sample [s], if it has one."""

    value: float
    at_s: float | None = None


Result = Found | Missing

Outcome = tuple[float, float, int]
"""Result of a metric as numbers, from functions that run plain and compiled.

With a value, the fields are the value, its time from the first sample [s] (NaN without a time), and
`FOUND`. Without a value, they are two numbers for the text of the reason, and the number of the
reason."""

REASONS: Final[list[Missing]] = [Missing(Status.OK, "")]
"""Reasons for missing values, by number."""

FOUND: Final = 0


def add_reason(status: Status, reason: str) -> int:
    """Return the number of a reason; its text may contain the two numbers of an outcome."""
    REASONS.append(Missing(status, reason))
    return len(REASONS) - 1


def read_outcome(outcome: Outcome) -> Result:
    """Return the metric (value, unit, time) of an outcome, or the reason why it has no value."""
    value, at_s, number = outcome
    if number:
        missing = REASONS[number]
        return Missing(missing.status, missing.reason.format(value, at_s))
    return Found(float(value), None if math.isnan(at_s) else float(at_s))


GOAL_UNKNOWN: Final = add_reason(Status.ABSENT, "the goal is not known")
NO_GOAL: Final = REASONS[GOAL_UNKNOWN]
