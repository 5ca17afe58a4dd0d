"""What a metric is: a number with a unit, or the reason why there is none."""

import enum
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from turtlelog.display import describe_count, format_html, format_number


class Status(enum.StrEnum):
    """Whether a metric has a value, and if not, why."""

    OK = "ok"
    NOT_REACHED = "not_reached"
    """What it asks for never happened within the recording."""
    NO_STEP = "no_step"
    """The phase begins at its reference: there is nothing to respond to."""
    NO_MOTION = "no_motion"
    """The turtle did not get from one place to another: there is nothing to divide by."""
    NO_PHASE = "no_phase"
    """The run has no such phase."""
    TOO_SHORT = "too_short"
    """Too few rows, or a run that was cut before the time asked for."""
    TOO_LARGE = "too_large"
    """Beyond the largest number that a computer holds."""
    ABSENT = "absent"
    """The recording does not hold what it is computed from."""
    UNDETERMINED = "undetermined"
    """The recording fits several values alike, or none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Metric:
    """One figure of one run.

    Attributes:
        id: `<phase, final or run>.<metric>`.
        value: In `unit`; None exactly where `status` is not `ok`.
        unit: `s`, `m`, `deg`, `%`, `1` or a product of units, as in `m^2 s`.
        status: Whether there is a value.
        reason: One clause where there is none, else empty.
        at_s: When it is taken, from the first sample [s]: of a peak, the end of a rise, the largest
            jump; None where it belongs to no moment.
    """

    id: str
    value: float | None
    unit: str
    status: Status = Status.OK
    reason: str = ""
    at_s: float | None = None

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

    def __repr__(self) -> str:
        known = self.value is not None
        text = format_number(self.value, self.unit) if known else self.status.value
        return f"<Metric {self.id}: {text}>"


class Metrics(dict[str, Metric]):
    """Metrics by id; in a notebook a table of those to look at first, and below it all.

    Attributes:
        first: Ids of those to look at first; all where empty.
    """

    def __init__(self, found: Iterable[tuple[str, Metric]], *, first: Sequence[str] = ()) -> None:
        super().__init__(found)
        self.first = tuple(first)

    def __repr__(self) -> str:
        known = sum(metric.value is not None for metric in self.values())
        return f"<Metrics: {len(self)}, of which {known} have a value>"

    def _repr_html_(self) -> str:
        shown = [self[name] for name in self.first if name in self]
        if len(shown) in {0, len(self)}:
            return format_metrics_html(self.values(), title=repr(self))
        title = f"{len(shown)} of {describe_count(len(self), 'metric')}"
        every = format_metrics_html(self.values(), title="")
        summary = f"<summary>All {len(self)} metrics</summary>"
        return f"{format_metrics_html(shown, title=title)}\n<details>{summary}{every}</details>"


def format_metrics_html(metrics: Iterable[Metric], *, title: str) -> str:
    """Return metrics as a table for notebooks; those without a value say why."""
    rows = [
        (one.id, one.value, one.unit, one.reason if one.value is None else "") for one in metrics
    ]
    return format_html(rows, heads=("metric", "value", "unit", "no value because"), title=title)


@dataclass(frozen=True, slots=True, kw_only=True)
class Missing:
    """Why a metric has no value."""

    status: Status
    reason: str


NO_COMMANDS: Final = Missing(status=Status.ABSENT, reason="the recording holds no commands")
ONE_POSE: Final = Missing(status=Status.TOO_SHORT, reason="1 pose")


@dataclass(frozen=True, slots=True)
class Found:
    """A value, and when it is taken.

    Attributes:
        value: In the metric's unit.
        at_s: From the first sample [s]; None where it belongs to no moment.
    """

    value: float
    at_s: float | None = None


Result = Found | Missing

Outcome = tuple[float, float, int]
"""What a metric is in numbers, which functions return that run plain and compiled.

The value, its moment from the first sample [s] (NaN: it belongs to none), and `FOUND`; or the
number of a reason behind two numbers for its text.
"""

REASONS: Final[list[Missing]] = [Missing(status=Status.OK, reason="")]
"""Why metrics have no value, by number."""

FOUND: Final = 0


def add_reason(status: Status, reason: str) -> int:
    """Return the number of a reason, whose text may have the two numbers of an outcome in it."""
    REASONS.append(Missing(status=status, reason=reason))
    return len(REASONS) - 1


def read_outcome(outcome: Outcome) -> Result:
    """Return what an outcome says."""
    value, at_s, number = outcome
    if number:
        missing = REASONS[number]
        return Missing(status=missing.status, reason=missing.reason.format(value, at_s))
    return Found(float(value), None if math.isnan(at_s) else float(at_s))


GOAL_UNKNOWN: Final = add_reason(Status.ABSENT, "the goal is not known")
NO_GOAL: Final = REASONS[GOAL_UNKNOWN]
