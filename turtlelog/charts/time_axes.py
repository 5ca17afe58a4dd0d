"""The axes of plots over time: ranges, and the timelines of compared runs."""

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.charts.curves import Level
from turtlelog.run import Run
from turtlelog.run.loops import DONE, PAUSE

Values = NDArray[np.float64]

HEADROOM: Final = 1.25
"""End of a command's range, as a multiple of its most extreme value."""

_ROOM: Final = 0.08
"""Margin above and below measured values, as a share of their range, or of the value if all values
are equal."""

_LEAST_ROOM: Final = 1e-9
"""Smallest margin if all values are equal, in the plot's unit, because a range needs a height."""

_ROOM_AROUND_0: Final = 0.1
"""Margin if all values are 0, in the plot's unit; ticks of a smaller range are hard to read."""

_AT_REST: Final = 0.01
"""Share of a plot's height within which a curve rests: less than a line's width in print at 40
mm."""

_LEAST_SIDE: Final = 0.15
"""Smallest visible part of a command's range on either side of 0, as a share of its largest limit,
times `HEADROOM`."""


def label_time(runs: Sequence[Run]) -> str:
    """Return the label of a time axis. Time zero is the first sample, or the first row of a bag."""
    return f"time from the first {' or '.join(dict.fromkeys(run.first_row for run in runs))} [s]"


def find_range(curves: Iterable[Values], levels: Sequence[Level]) -> tuple[float, float] | None:
    """Return the range of a plot that includes curves and level lines, with a margin.

    For commands, the range ends slightly beyond their extremes, whether these are limits or not.

    Returns:
        None if no value is known.
    """
    known = [values[np.isfinite(values)] for values in curves]
    spans = [(float(values.min()), float(values.max())) for values in known if len(values)]
    if not spans:
        return None
    low, high = min(span[0] for span in spans), max(span[1] for span in spans)
    limits = [level.value for level in levels if level.kind == "limit"]
    if limits:
        least = _LEAST_SIDE * max(limits)
        return min(low, -least) * HEADROOM, max(high, least) * HEADROOM
    others = [level.value for level in levels]
    return _add_room(min([low, *others]), max([high, *others]))


def find_rest(curves: Iterable[tuple[Values, Values]], height: float) -> float:
    """Return the time from which all curves stay within 1 % of a height of their last values [s].

    A robot may move in a gap, so the rest of a curve begins after its gaps.

    Args:
        curves: Times [s] and values of each curve.
        height: Height of the plot, in the unit of the values.
    """
    ends_s = [0.0]
    for time_s, values in curves:
        known = np.flatnonzero(np.isfinite(values))
        if len(known):
            time_s, values = time_s[: known[-1] + 1], values[: known[-1] + 1]
            is_near = np.abs(values - values[-1]) <= _AT_REST * height
            away = np.flatnonzero(~is_near)
            ends_s.append(float(time_s[away[-1]]) if len(away) else 0.0)
    return max(ends_s)


def _add_room(low: float, high: float) -> tuple[float, float]:
    room = _ROOM * (high - low)
    if not room:
        room = max(_ROOM * abs(high), _LEAST_ROOM) if high else _ROOM_AROUND_0
    return low - room, high + room


TIMELINE: Final = "sim_time"
WALL_TIMELINE: Final = "wall_time"

_PHASE_TIMELINE: Final = "{}_time"
_MOST_PHASES: Final = 8
"""Largest number of phase timelines of a run; each takes 8 bytes per row and entity in a view."""


def name_phase_timeline(phase: str) -> str:
    """Return the unique name of the timeline that begins at the start of a phase."""
    name = _PHASE_TIMELINE.format(phase)
    return _PHASE_TIMELINE.format(f"phase.{phase}") if name in {TIMELINE, WALL_TIMELINE} else name


def find_phase_zeros(run: Run) -> dict[str, int]:
    """Return the timelines of the phases after the first declared phase, with their zeros.

    Zeros are in the run's time [ns].
    """
    phases = [name for name in run.declaration.phases if name not in (PAUSE, DONE)]
    starts_ns: dict[str, int] = {}
    for span in run.find_phase_spans():
        starts_ns.setdefault(span.phase, span.start_ns)
    later = phases[1 : 1 + _MOST_PHASES]
    return {name_phase_timeline(name): starts_ns[name] for name in later if name in starts_ns}


def locate_run(run: Run, zero_ns: int, time_s: Values) -> tuple[Values, Values]:
    """Return the poses of a run on a timeline: x and y [m], shape (n, 2), and heading [rad].

    Poses are linearly interpolated. Before the first and after the last pose, the robot is at rest.

    Args:
        run: Run with at least one pose.
        zero_ns: Zero of the timeline, in the run's time [ns].
        time_s: Times [s], shape (n,).
    """
    own_s = (run.poses.time_ns - zero_ns) / 1e9
    heading_rad = np.unwrap(run.poses.heading_rad)
    xy_m = np.column_stack([np.interp(time_s, own_s, values) for values in run.poses.xy_m.T])
    return xy_m, np.interp(time_s, own_s, heading_rad)
