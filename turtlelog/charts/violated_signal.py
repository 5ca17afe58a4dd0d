"""A signal that violated a check: its curve, the band that it left, where, when and how far."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from turtlelog.charts.curves import Curve, Values
from turtlelog.display import format_number


@dataclass(frozen=True, slots=True, kw_only=True)
class ViolationMoment:
    """One moment of a violation.

    Attributes:
        time_s: From the first sample [s].
        value: Of the signal then, in the unit of the check.
    """

    time_s: float
    value: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViolatedSignal:
    """A signal and the band that a check holds it to, both in the unit of the check.

    Angles are in degrees, as the check's message prints them.

    Attributes:
        name: What is measured, as the check writes it: `cross_track`, `speed - measured_speed`.
        unit: Of values and limits: `m`, `deg`, `m/s`, `rad/s`; empty where it is not plain.
        curve: The signal over the whole run, shape (n,).
        low: Lower end of the band, shape (n,), NaN where nothing is asked; None for no lower end.
        high: Upper end of the band, likewise.
        reference: What a tolerance counts from, shape (n,); None where the limit is not one.
        outside: Rows that violate the check, shape (n,): outside the band while it is asked for.
        first: When the check is first violated.
        worst: The row furthest outside; where a value was waited for that never came, the nearest.
        worst_word: `worst` or `nearest`.
        check: The check's name.
        expected: What was to hold, as written.
        metric: Id of the metric that is held to the limit, which the signal has at the worst moment
            alone; empty where the band is asked for over time.
    """

    name: str
    unit: str
    curve: Curve
    low: Values | None
    high: Values | None
    outside: NDArray[np.bool_]
    first: ViolationMoment
    worst: ViolationMoment
    worst_word: str = "worst"
    reference: Values | None = None
    check: str = ""
    expected: str = ""
    metric: str = ""

    @property
    def is_moving(self) -> bool:
        """Whether an end of the band is not the same at all times."""
        ends = [end[np.isfinite(end)] for end in (self.low, self.high) if end is not None]
        return any(len(end) > 0 and bool(np.ptp(end) > 0.0) for end in ends)

    @property
    def title(self) -> str:
        """The signal with its unit, for a plot."""
        return self.name if self.unit in {"", "1"} else f"{self.name} [{self.unit}]"

    def describe_moment(self, moment: ViolationMoment, word: str) -> str:
        """Return a moment in words: `worst -0.083 m at 4.512 s`."""
        return f"{word} {format_number(moment.value, self.unit)} at {moment.time_s:.3f} s"

    def describe_outside(self, moment: ViolationMoment) -> str:
        """Return how far outside the band the signal is then: `0.0577 m`; empty where it is not."""
        row = int(np.argmin(np.abs(self.curve.time_s - moment.time_s)))
        below = 0.0 if self.low is None else float(self.low[row]) - moment.value
        above = 0.0 if self.high is None else moment.value - float(self.high[row])
        beyond = float(np.nanmax([below, above, 0.0]))
        return format_number(float(f"{beyond:.3g}"), self.unit) if beyond > 0.0 else ""

    def describe_limits(self) -> dict[str, str]:
        """Return the name of each end of the band: `low` and `high`, each where there is one."""
        return {
            side: self._name_limit(end, side)
            for side, end in (("low", self.low), ("high", self.high))
            if end is not None
        }

    def _name_limit(self, end: Values, side: str) -> str:
        known = end[np.isfinite(end)]
        if self.reference is not None:
            return f"reference {'-' if side == 'low' else '+'} tolerance"
        if not len(known) or np.ptp(known) > 0.0:
            return f"{'lower' if side == 'low' else 'upper'} limit, moving"
        return f"limit {format_number(float(known[0]), self.unit)}"


@dataclass(frozen=True, slots=True, kw_only=True)
class SignalSearch:
    """The violated signal of a check, or why there is none.

    Attributes:
        signal: None where the violation belongs to no signal, or to no moment.
        reason: Why there is none; empty where there is one.
    """

    signal: ViolatedSignal | None = None
    reason: str = ""
