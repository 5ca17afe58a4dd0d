"""The verdict of `measure.swings` in the compiled batch, from the same thresholds."""

from typing import Any, NamedTuple

import numpy as np

from turtlelog.measure import swings
from turtlelog.sweep.batch_functions import measure
from turtlelog.sweep.batch_sums import count_crossings
from turtlelog.sweep.batch_table import NOT_REACHED, OK, UNDETERMINED


class _Swings(NamedTuple):
    """Where a response swings: whole swings, its size at the start and at most, its reference."""

    whole: int
    size: float
    largest: float
    reference: float


@measure
def judge_swings(
    values: Any, stretch: Any, reference: float, clipped: int, most: float
) -> tuple[float, int]:
    """Return the verdict of `swings` as a value and a status; a clipped row -1 is none."""
    largest, size = 0.0, abs(reference - values[stretch.first])
    for row in range(stretch.first, stretch.after):
        largest = max(largest, abs(reference - values[row]))
    count = int(count_crossings(values, stretch, reference)) - 1
    decays = largest <= min(swings.BEYOND * size, most)
    found = _Swings(count, size, largest, reference)
    rest, begin = _find_peak(values, stretch, reference, count, count + 1)
    is_elsewhere = _find_rise(values, stretch, reference, begin) > swings.NEAR * largest
    if count < 2:
        if is_elsewhere and abs(reference - values[stretch.after - 1]) <= swings.NEAR * largest:
            return np.nan, UNDETERMINED
        return _judge_approach(values, stretch, found, decays)  # type: ignore[no-any-return]
    is_long = count >= swings.FEWEST
    third = count // 3 if is_long else 1
    begun = count - 2 * third if is_long else 0
    last = count - third
    beginning, _ = _find_peak(values, stretch, reference, 0, third)
    before, begin = _find_peak(values, stretch, reference, begun, begun + third)
    after, _ = _find_peak(values, stretch, reference, last, count)
    first_before, _ = _find_peak(values, stretch, reference, begun, begun + min(third, 2))
    first_after, _ = _find_peak(values, stretch, reference, last, last + min(third, 2))
    dying = swings.DYING if is_long else swings.HALVED
    share = after / before
    decays = decays and not is_elsewhere and rest <= max(after, swings.NEAR * largest)
    falls = first_before >= swings.FALLING * before and first_after >= swings.FALLING * after
    if decays and share < dying and falls:
        return 1.0, OK
    if clipped >= begin or after >= swings.LARGE * largest:
        going_on = swings.GOING_ON if is_long else swings.GROWN
        return (0.0, OK) if share >= going_on else (np.nan, UNDETERMINED)
    grew = not is_long or before > beginning
    is_small = decays and not (grew and share > 1.0 / dying)
    return (1.0, OK) if is_small else (np.nan, UNDETERMINED)


@measure
def _judge_approach(values: Any, stretch: Any, found: Any, decays: bool) -> tuple[float, int]:  # noqa: FBT001
    """Return what `swings` says of a response that swings less than twice."""
    end = abs(found.reference - values[stretch.after - 1])
    if end > swings.NEAR * found.largest:
        if end == found.largest and end > found.size:
            return 0.0, OK
        return np.nan, NOT_REACHED
    step = most = 0.0
    for row in range(stretch.first + 1, stretch.after):
        before, now = found.reference - values[row - 1], found.reference - values[row]
        step = abs(abs(now) - abs(before))
        most = max(most, step)
    if decays and step <= swings.SLOWED * most:
        return 1.0, OK
    return np.nan, UNDETERMINED


@measure
def _find_peak(
    values: Any, stretch: Any, reference: float, swing: int, after: int
) -> tuple[float, int]:
    """Return the largest of the swings from one to that before another, and where they begin."""
    crossings, side, peak, begin = -1, 0, 0.0, 0
    for row in range(stretch.first, stretch.after):
        error = reference - values[row]
        now = 1 if error > 0.0 else -1 if error < 0.0 else 0
        if now:
            crossings += side == -now
            side = now
        if crossings >= after:
            break
        if crossings >= swing:
            begin = row if begin == 0 else begin
            peak = max(peak, abs(error))
    return peak, begin


@measure
def _find_rise(values: Any, stretch: Any, reference: float, first: int) -> float:
    """Return how far an error grows again behind the peak that it has from a row on."""
    peak = least = rise = 0.0
    for row in range(first, stretch.after):
        size = abs(reference - values[row])
        if size > peak:
            peak, least, rise = size, size, 0.0
        least = min(least, size)
        rise = max(rise, size - least)
    return rise
