"""Metrics of loops with a moving reference: the delay, and the overshoot at corners."""

from collections.abc import Callable
from typing import Final

import numpy as np

from turtlelog.measure.context import RunContext
from turtlelog.measure.metric import Found, Missing, Result, Status
from turtlelog.measure.metric_kinds import loop_metric
from turtlelog.measure.references import read_reference
from turtlelog.measure.response import Response, Values
from turtlelog.run.loops import ControlLoop
from turtlelog.run.paths import Corner, Path

_STANDS_STILL: Final = Missing(status=Status.NO_STEP, reason="the reference does not move")
_NO_PATH: Final = Missing(status=Status.ABSENT, reason="the path is not known")
_NO_CORNER: Final = Missing(status=Status.NO_STEP, reason="the path has no corner")
_NOT_PASSED: Final = Missing(status=Status.NOT_REACHED, reason="no corner of the path was passed")

_COARSE_ROWS: Final = 400
"""Largest number of rows in the first search of a lag. Of more rows, every n-th is used: a tenth of
a second of a path of 40 s, in which a path hardly bends."""

_FINE_STEPS: Final = 40
"""Number of steps of the golden-section search for the lag. Each step leaves 0.62 of the interval,
all steps together 5e-9."""

_LEAST_MOVED: Final = 1e-6
"""Motion below which a reference is at rest [rad or m]; poses are rounded to 32 bits."""

_BEYOND_M: Final = 0.1
"""Distance beyond a corner of a later lap from which the corner counts [m]. A run that ends with
its lap goes one sample beyond the next lap's first corner: 16 mm at 1 m/s."""


def _has_lag(loop: ControlLoop) -> bool:
    """Return whether the reference depends on time, unlike that of a distance."""
    is_error = loop.signal == "distance" or (loop.signal, loop.reference) == ("cross_track", "path")
    return loop.moves and not is_error


def _has_corners(loop: ControlLoop) -> bool:
    return (loop.signal, loop.reference) == ("cross_track", "path")


@loop_metric(
    "lag",
    "s",
    "Shift of the {goal} in time that fits the {signal} best: positive where the {signal} is late.",
    floor=0.0,
    applies=_has_lag,
)
def _compute_lag(context: RunContext, response: Response) -> Result:
    reference = read_reference(context.run, response.loop)
    if not isinstance(reference, np.ndarray):
        return _STANDS_STILL
    inside = reference[response.rows]
    inside = np.unwrap(inside) if response.loop.signal == "heading" else inside
    if np.ptp(inside) <= _LEAST_MOVED:
        return _STANDS_STILL
    signal = inside - response.error
    return Found(find_shift(response.time_s, inside, signal))


def find_shift(time_s: Values, reference: Values, signal: Values) -> float:
    """Return the time shift of the reference that fits the signal best in the mean square [s].

    The shift is at most half of the duration in either direction. The reference is constant before
    its beginning and after its end, so that every shift is judged on all rows. A periodic reference
    that is off by one period therefore fits worse.
    """
    every = slice(None, None, -(-len(time_s) // _COARSE_ROWS))
    coarse = time_s[every], reference[every], signal[every]
    most_s = float(time_s[-1] - time_s[0]) / 2.0
    shifts_s = np.linspace(-most_s, most_s, len(coarse[0]) | 1)
    best = int(np.argmin([_compute_misfit(*coarse, shift_s) for shift_s in shifts_s]))
    low_s, high_s = shifts_s[max(best - 1, 0)], shifts_s[min(best + 1, len(shifts_s) - 1)]
    return _find_least(
        lambda shift_s: _compute_misfit(time_s, reference, signal, shift_s), low_s, high_s
    )


def _find_least(compute: Callable[[float], float], low: float, high: float) -> float:
    """Return the place of a function's only minimum in an interval, by golden-section search."""
    golden = (5.0**0.5 - 1.0) / 2.0
    inner = [high - golden * (high - low), low + golden * (high - low)]
    values = [compute(at) for at in inner]
    for _ in range(_FINE_STEPS):
        if values[0] <= values[1]:
            high = inner[1]
            inner = [high - golden * (high - low), inner[0]]
            values = [compute(inner[0]), values[0]]
        else:
            low = inner[0]
            inner = [inner[1], low + golden * (high - low)]
            values = [values[1], compute(inner[1])]
    return (low + high) / 2.0


def _compute_misfit(time_s: Values, reference: Values, signal: Values, shift_s: float) -> float:
    """Return the mean square of the signal minus the shifted reference."""
    fitted = np.interp(time_s - shift_s, time_s, reference)
    return float(np.mean((signal - fitted) ** 2))


@loop_metric(
    "corner_overshoot",
    "m",
    "Largest distance past a corner on its outer side, up to half way to the next corner; negative"
    " on the inner side.",
    floor=0.0,
    grows=True,
    applies=_has_corners,
)
def _compute_corner_overshoot(context: RunContext, response: Response) -> Result:
    path, along = context.run.path, context.get_signal("along_track")
    if path is None or along is None:
        return _NO_PATH
    if not path.corners:
        return _NO_CORNER
    arcs_m, offsets_m = along.values[response.rows], -response.error
    found: list[tuple[float, float]] = []
    for corner in _list_corners(path, arcs_m):
        rows = np.flatnonzero(
            (arcs_m >= corner.arc_m) & (arcs_m < corner.arc_m + corner.leg_m / 2.0)
        )
        if len(rows):
            outside_m = offsets_m[rows] * -np.sign(corner.turn_rad)
            row = int(outside_m.argmax())
            found.append((float(outside_m[row]), float(response.time_s[rows[row]])))
    if not found:
        return _NOT_PASSED
    largest_m, at_s = max(found)
    return Found(largest_m, response.start_s + at_s)


def _list_corners(path: Path, arcs_m: Values) -> list[Corner]:
    """Return the corners that a run reached; if the path has a speed, only of the first lap."""
    to_m = float(arcs_m.max(initial=0.0)) - _BEYOND_M if path.speed_m_s is None else 0.0
    return [one for one in path.list_corners(to_m) if one.arc_m >= arcs_m.min(initial=np.inf)]
