"""The signal that violated a check, with the band that it left, as pictures show it."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.charts.curves import Curve, Values
from turtlelog.display import format_number

_CLOSE_UP: Final = 4.0
"""Ratio of the signal's height to the violation's height, from which only the violation is shown.
Otherwise the band would take less than a quarter of the plot."""

_ROOM: Final = 0.18
"""Margin above and below the whole signal for marks and their texts, as a share of its height."""

_CLOSE_ROOM: Final = 0.8
"""Margin above and below a close-up, where the signal goes on, as a share of its height."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ShownRange:
    """Part of a signal's values that a plot shows."""

    low: float  # lower end of the plot, in the unit of the check
    high: float  # upper end of the plot
    note: str = ""  # how far the signal goes outside a close-up; empty if the whole is shown


@dataclass(frozen=True, slots=True, kw_only=True)
class ViolationMoment:
    """One time of a violation."""

    time_s: float  # time from the first sample [s]
    value: float  # value of the signal at this time, in the unit of the check


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViolatedSignal:
    """A signal with the band to which a check limits it, in the unit of the check.

    Angles are in degrees, as in the check's message.
    """

    name: str  # name of the measured quantity in the check: `cross_track`, `speed - measured_speed`
    unit: str  # unit of values and limits: `m`, `deg`, `m/s`, `rad/s`; empty if it is not simple
    curve: Curve  # the signal over the whole run, shape (n,)
    low: Values | None  # lower end of the band, shape (n,); NaN where none is asked; None: no end
    high: Values | None  # upper end of the band, likewise
    outside: NDArray[np.bool_]  # whether each row is outside while the band is required, shape (n,)
    first: ViolationMoment  # first violation of the check
    worst: ViolationMoment  # row furthest outside; of a value never reached, the nearest row
    worst_word: str = "worst"  # `worst` or `nearest`
    reference: Values | None = None  # values from which a tolerance counts, shape (n,); else None
    check: str = ""  # name of the check
    expected: str = ""  # requirement as written
    metric: str = ""  # limited metric, which the signal has only at the worst time; empty: a band

    @property
    def is_moving(self) -> bool:
        """Whether an end of the band changes with time."""
        ends = [end[np.isfinite(end)] for end in (self.low, self.high) if end is not None]
        return any(len(end) > 0 and bool(np.ptp(end) > 0.0) for end in ends)

    @property
    def title(self) -> str:
        """Name of the signal with its unit, for a plot."""
        return self.name if self.unit in {"", "1"} else f"{self.name} [{self.unit}]"

    def find_range(self) -> ShownRange:
        """Return the range of a plot: of signal and band, or of a much smaller violation."""
        # A value that was never reached is outside from the start: only its nearest approach
        # matters.
        values = self.curve.values
        outside = values[:0] if self.worst_word == "nearest" else values[self.outside]
        ends = [end for end in (self.low, self.high) if end is not None]
        near = np.concatenate([*ends, outside, [self.first.value, self.worst.value]])
        near = near[np.isfinite(near)]
        whole = np.concatenate([near, values[np.isfinite(values)]])
        is_close_up = bool(np.ptp(whole) > _CLOSE_UP * np.ptp(near))
        shown, share = (near, _CLOSE_ROOM) if is_close_up else (whole, _ROOM)
        low, high = float(shown.min()), float(shown.max())
        room = share * (high - low) or 0.1 * abs(low) or 1.0
        note = ""
        if is_close_up:
            far = float(whole[int(np.argmax(np.abs(whole - near.mean())))])
            note = f"close up: the signal goes to {format_number(far, self.unit)}"
        return ShownRange(low=low - room, high=high + room, note=note)

    def describe_moment(self, moment: ViolationMoment, word: str) -> str:
        """Return the time and value of a violation as text: `worst -0.083 m at 4.512 s`."""
        return f"{word} {format_number(moment.value, self.unit)} at {moment.time_s:.3f} s"

    def describe_outside(self, moment: ViolationMoment) -> str:
        """Return the distance of the signal from the band as text: `0.0577 m`; empty if inside."""
        row = int(np.argmin(np.abs(self.curve.time_s - moment.time_s)))
        below = 0.0 if self.low is None else float(self.low[row]) - moment.value
        above = 0.0 if self.high is None else moment.value - float(self.high[row])
        beyond = float(np.nanmax([below, above, 0.0]))
        return format_number(float(f"{beyond:.3g}"), self.unit) if beyond > 0.0 else ""

    def describe_limits(self) -> dict[str, str]:
        """Return the names of the band's ends: `low` and `high`, if they exist."""
        names = {}
        for side, end in (("low", self.low), ("high", self.high)):
            known = np.zeros(0) if end is None else end[np.isfinite(end)]
            if end is not None and self.reference is not None:
                names[side] = f"reference {'-' if side == 'low' else '+'} tolerance"
            elif end is not None and (not len(known) or np.ptp(known) > 0.0):
                names[side] = f"{'lower' if side == 'low' else 'upper'} limit, moving"
            elif end is not None:
                names[side] = f"limit {format_number(float(known[0]), self.unit)}"
        return names
