"""Metrics of loops with a moving reference: the delay, and the overshoot at corners."""

import math
from typing import Any, Final

import numpy as np

from turtlelog.arithmetic import compiled_as
from turtlelog.measure.metric import FOUND, Outcome, Status, add_reason
from turtlelog.measure.metric_kinds import curve_metric
from turtlelog.measure.reductions import PIECES, add_up
from turtlelog.measure.response import Response, Track, Values
from turtlelog.run.loops import ControlLoop

_STANDS_STILL: Final = add_reason(Status.NO_STEP, "the reference does not move")
_NO_CORNER: Final = add_reason(Status.NO_STEP, "the path has no corner")
_NOT_PASSED: Final = add_reason(Status.NOT_REACHED, "no corner of the path was passed")

_COARSE_ROWS: Final = 400
"""Largest number of rows in the first search of a lag. Of more rows, every n-th is used: a tenth of
a second of a path of 40 s, in which a path hardly bends."""

_FINE_STEPS: Final = 40
"""Number of steps of the golden-section search for the lag. Each step leaves 0.62 of the interval,
all steps together 5e-9."""

_GOLDEN: Final = (5.0**0.5 - 1.0) / 2.0

_LEAST_MOVED: Final = 1e-6
"""Motion below which a reference is at rest [rad or m]; poses are rounded to 32 bits."""

_BEYOND_M: Final = 0.1
"""Distance beyond a corner of a later lap from which the corner counts [m]. A run that ends with
its lap goes one sample beyond the next lap's first corner: 16 mm at 1 m/s."""


def _has_lag(loop: ControlLoop) -> bool:
    """Return whether the reference depends on time. The reference of a distance does not."""
    return loop.moves and loop.signal != "distance" and not _has_corners(loop)


def _has_corners(loop: ControlLoop) -> bool:
    return (loop.signal, loop.reference) == ("cross_track", "path")


def _find_bounds(values: Any) -> tuple[float, float]:
    low = high = values[0]
    for row in range(1, len(values)):
        low, high = min(low, values[row]), max(high, values[row])
    return low, high


@compiled_as(_find_bounds)
def find_bounds(values: Values) -> tuple[float, float]:
    """Return the least and the largest of some values."""
    return float(values.min()), float(values.max())


@curve_metric(
    "lag",
    "s",
    "Shift of the {goal} in time that fits the {signal} best: positive where the {signal} is late.",
    floor=0.0,
    applies=_has_lag,
)
def compute_lag(curve: Response) -> Outcome:
    """See `find_shift`."""
    reference = curve.track.reference
    if len(reference) == 0:
        return math.nan, math.nan, _STANDS_STILL
    low, high = find_bounds(reference)
    if high - low <= _LEAST_MOVED:
        return math.nan, math.nan, _STANDS_STILL
    return find_shift(curve.time_s, reference, curve.error, curve.memory), math.nan, FOUND


def find_shift(time_s: Values, reference: Values, error: Values, memory: Any) -> float:
    """Return the time shift of the reference that fits the signal best in the mean square [s].

    The signal is the reference minus the error. The shift is at most half of the duration in either
    direction. The reference is constant before its beginning and after its end, so that every shift
    is judged on all rows. A periodic reference that is off by one period therefore fits worse.
    """
    every = -(-len(time_s) // _COARSE_ROWS)
    count = ((len(time_s) - 1) // every + 1) | 1
    most_s = float(time_s[-1] - time_s[0]) / 2.0
    apart_s = (most_s + most_s) / (count - 1)
    best, least = 0, math.inf
    for number in range(count):
        shift_s = _tell_shift(number, count, apart_s, most_s)
        misfit = compute_misfit(time_s, reference, error, shift_s, every, memory)
        if misfit < least:
            best, least = number, misfit
    low_s = _tell_shift(max(best - 1, 0), count, apart_s, most_s)
    high_s = _tell_shift(min(best + 1, count - 1), count, apart_s, most_s)
    # The only minimum in this interval, by golden-section search.
    first_s, second_s = high_s - _GOLDEN * (high_s - low_s), low_s + _GOLDEN * (high_s - low_s)
    first = compute_misfit(time_s, reference, error, first_s, 1, memory)
    second = compute_misfit(time_s, reference, error, second_s, 1, memory)
    for _ in range(_FINE_STEPS):
        if first <= second:
            high_s, second_s, second = second_s, first_s, first
            first_s = high_s - _GOLDEN * (high_s - low_s)
            first = compute_misfit(time_s, reference, error, first_s, 1, memory)
        else:
            low_s, first_s, first = first_s, second_s, second
            second_s = low_s + _GOLDEN * (high_s - low_s)
            second = compute_misfit(time_s, reference, error, second_s, 1, memory)
    return (low_s + high_s) / 2.0


def _tell_shift(number: int, count: int, apart_s: float, most_s: float) -> float:
    """Return one of `count` equally spaced shifts, from -`most_s` to `most_s` [s]."""
    return most_s if number == count - 1 else number * apart_s - most_s


def _compute_misfit(
    time_s: Any, reference: Any, error: Any, shift_s: float, every: int, memory: Any
) -> float:
    pieces, count = memory.numbers[PIECES], (len(time_s) - 1) // every + 1
    after = 0
    for place in range(count):
        row = place * every
        at_s = time_s[row] - shift_s
        while after < count and time_s[after * every] <= at_s:
            after += 1
        end, begin = after * every, (after - 1) * every
        if after == 0:
            fitted = reference[0]
        elif after == count or time_s[begin] == at_s:
            fitted = reference[begin]
        else:
            slope = (reference[end] - reference[begin]) / (time_s[end] - time_s[begin])
            fitted = slope * (at_s - time_s[begin]) + reference[begin]
        off = reference[row] - error[row] - fitted
        pieces[place] = off * off
    return add_up(pieces, count) / count


@compiled_as(_compute_misfit)
def compute_misfit(
    time_s: Values,
    reference: Values,
    error: Values,
    shift_s: float,
    every: int,
    memory: Any,  # noqa: ARG001
) -> float:
    """Return the mean square of the signal minus the shifted reference, on every n-th row.

    The signal is the reference minus the error; between rows the reference is a line.
    """
    time_s, reference, error = time_s[::every], reference[::every], error[::every]
    fitted = np.interp(time_s - shift_s, time_s, reference)
    return float(np.mean((reference - error - fitted) ** 2))


@curve_metric(
    "corner_overshoot",
    "m",
    "Largest distance past a corner on its outer side, up to half way to the next corner; negative"
    " on the inner side.",
    floor=0.0,
    grows=True,
    applies=_has_corners,
)
def measure_corner_overshoot(curve: Response) -> Outcome:
    """Return the largest distance outside of a corner that was reached, and its time."""
    track = curve.track
    if len(track.corners) == 0:
        return math.nan, math.nan, _NO_CORNER
    low_m, high_m = find_bounds(track.arcs_m)
    # With a time law, the path ends after its first lap.
    to_m = 0.0 if track.has_speed else high_m - _BEYOND_M
    is_lapped = track.is_closed and to_m >= track.length_m
    last_m = max(to_m, track.length_m)
    largest_m, at_s, number = -math.inf, math.nan, 0
    while is_lapped or number < len(track.corners):
        arc_m, turn_rad, leg_m = find_corner(track, number, is_lapped)
        if is_lapped and arc_m > last_m:
            break
        number += 1
        if arc_m < low_m:
            continue
        side = -1.0 if turn_rad > 0.0 else 1.0
        end_m = arc_m + leg_m / 2.0
        row = find_furthest_between(track.arcs_m, curve.error, arc_m, end_m, -side)
        if row < 0:
            continue
        outside_m, time_s = -curve.error[row] * side, curve.time_s[row]
        if outside_m > largest_m or (outside_m == largest_m and time_s > at_s):
            largest_m, at_s = outside_m, time_s
    if math.isnan(at_s):
        return math.nan, math.nan, _NOT_PASSED
    return largest_m, curve.start_s + at_s, FOUND


def find_corner(track: Track, number: int, is_lapped: bool) -> tuple[float, float, float]:  # noqa: FBT001
    """Return arc length [m], turn [rad] and leg [m] of a corner, as `Path.list_corners` does.

    The leg leads to the next corner, or to the end of the path. If a run has more than one lap, the
    point between two laps is a corner too where the direction jumps.
    """
    if not is_lapped:
        return track.corners[number, 0], track.corners[number, 1], track.corners[number, 2]
    arc_m, turn_rad = _find_lapped(track, number)
    after_m, _ = _find_lapped(track, number + 1)
    return arc_m, turn_rad, after_m - arc_m


def _find_lapped(track: Track, number: int) -> tuple[float, float]:
    """Return arc length [m] and turn [rad] of a corner of any lap."""
    lap, place, count = 0, number, len(track.corners)
    if number >= count:
        seam = 1 if track.seam_rad != 0.0 else 0
        lap = 1 + (number - count) // (count + seam)
        place = (number - count) % (count + seam) - seam
    if place < 0:
        return lap * track.length_m, track.seam_rad
    return track.corners[place, 0] + lap * track.length_m, track.corners[place, 1]


def _find_furthest_between(
    arcs_m: Any, error: Any, begin_m: float, end_m: float, direction: float
) -> int:
    found = -1
    for row in range(len(arcs_m)):
        if begin_m <= arcs_m[row] < end_m and (
            found < 0 or error[row] * direction > error[found] * direction
        ):
            found = row
    return found


@compiled_as(_find_furthest_between)
def find_furthest_between(
    arcs_m: Values, error: Values, begin_m: float, end_m: float, direction: float
) -> int:
    """Return the first row with the largest error in a direction between two arc lengths, or -1."""
    rows = np.flatnonzero((arcs_m >= begin_m) & (arcs_m < end_m))
    return int(rows[int((error[rows] * direction).argmax())]) if len(rows) else -1
