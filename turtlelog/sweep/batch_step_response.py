"""The metrics of `measure.step_response` in the compiled batch, operation by operation."""

import math
from typing import Any

import numpy as np

from turtlelog.measure.registry import LOOP_METRICS
from turtlelog.measure.step_response import SHORTEST_HOLD_S, SWING
from turtlelog.measure.table.loop_metrics import SMALLEST_STEP
from turtlelog.sweep.batch_functions import measure
from turtlelog.sweep.batch_sums import count_crossings, integrate_error, tell_time
from turtlelog.sweep.batch_table import (
    CUT,
    NO_STEP,
    NOT_REACHED,
    OK,
    TOO_LARGE,
    LoopMetric,
)

_NEEDS_WHOLE = np.array([LOOP_METRICS[metric.ending].needs_whole for metric in LoopMetric])
_NEEDS_STEP = np.array(
    [LoopMetric.DURATION < metric < LoopMetric.CROSSINGS for metric in LoopMetric]
)


@measure
def measure_response(values: Any, stretch: Any, step: Any, pieces: Any, entry: Any) -> None:
    """Enter the metrics of a loop that its curve tells, in the columns of `LoopMetric`."""
    found = entry.values
    _enter_curve(values, stretch, step, found)
    if entry.asked[LoopMetric.CROSSINGS]:
        found[LoopMetric.CROSSINGS] = count_crossings(values, stretch, step.reference)
    if entry.asked[LoopMetric.LARGEST_ERROR]:
        found[LoopMetric.LARGEST_ERROR] = _find_largest(values, stretch, step.reference)
    begin_s = _find_level(values, stretch, step, 0.1)
    found[LoopMetric.DELAY_TIME] = _find_level(values, stretch, step, 0.5)
    found[LoopMetric.RISE_TIME] = _find_level(values, stretch, step, 0.9) - begin_s
    found[LoopMetric.SETTLING_TIME] = _find_settling(values, stretch, step)
    if entry.asked[LoopMetric.IAE]:
        found[LoopMetric.IAE] = integrate_error(values, stretch, step.reference, pieces)
    is_step = not abs(step.reference - step.initial) <= SMALLEST_STEP
    _enter_statuses(found, entry.status, stretch.is_cut, is_step)


@measure
def _enter_statuses(found: Any, status: Any, is_cut: bool, is_step: bool) -> None:  # noqa: FBT001
    for place in range(len(_NEEDS_STEP)):
        status[place] = OK
        if is_cut and _NEEDS_WHOLE[place]:
            status[place] = CUT
        elif _NEEDS_STEP[place] and not is_step:
            status[place] = NO_STEP
        elif not _NEEDS_WHOLE[place] and math.isnan(found[place]):
            status[place] = NOT_REACHED
        elif not math.isfinite(found[place]):
            status[place] = TOO_LARGE


@measure
def _enter_curve(values: Any, stretch: Any, step: Any, found: Any) -> None:
    """Enter what the curve tells by its extremes and its end."""
    initial, reference, end = step.initial, step.reference, stretch.after - 1
    height = reference - initial
    top = bottom = stretch.first
    for row in range(stretch.first, stretch.after):
        if values[row] > values[top]:
            top = row
        if values[row] < values[bottom]:
            bottom = row
    ahead, behind = (top, bottom) if reference >= initial else (bottom, top)
    error = reference - values[end]
    found[LoopMetric.DURATION] = tell_time(stretch, end)
    found[LoopMetric.PEAK] = values[ahead]
    found[LoopMetric.PEAK_TIME] = tell_time(stretch, ahead)
    found[LoopMetric.OVERSHOOT] = 100.0 * ((values[ahead] - reference) / height)
    found[LoopMetric.UNDERSHOOT] = 100.0 * ((initial - values[behind]) / height)
    found[LoopMetric.FINAL_ERROR] = abs(error)
    found[LoopMetric.STEADY_STATE_ERROR] = error if reference >= initial else -error


@measure
def _find_level(values: Any, stretch: Any, step: Any, level: float) -> float:
    """Return the first time at which a share of the step is reached, NaN where it never is."""
    height = step.reference - step.initial
    threshold = step.initial + level * height
    for row in range(stretch.first, stretch.after):
        reached = values[row] >= threshold if height > 0.0 else values[row] <= threshold
        if reached:
            if row == stretch.first:
                return tell_time(stretch, row)  # type: ignore[no-any-return]
            return _interpolate(values, stretch, row - 1, threshold)  # type: ignore[no-any-return]
    return np.nan


@measure
def _find_settling(values: Any, stretch: Any, step: Any) -> float:
    """Return when the response enters the band for good, NaN where it does not."""
    reference = step.reference
    half_width = step.band * abs(reference - step.initial)
    high, low = reference + half_width, reference - half_width
    end = last = stretch.after - 1
    while last >= stretch.first and low <= values[last] <= high:
        last -= 1
    if last == end:
        return np.nan
    if last < stretch.first:
        settled_s = tell_time(stretch, stretch.first)
    else:
        edge = reference + math.copysign(half_width, values[last] - reference)
        settled_s = _interpolate(values, stretch, last, edge)
    if stretch.is_own:
        return settled_s  # type: ignore[no-any-return]
    period_s = _find_swing_period(values, stretch, reference, half_width)
    is_held = tell_time(stretch, end) - settled_s >= max(SHORTEST_HOLD_S, period_s)
    return settled_s if is_held else np.nan


@measure
def _find_swing_period(values: Any, stretch: Any, reference: float, half_width: float) -> float:
    """Return the period that the last two swings tell [s]; 0 where less than two are over."""
    last = after = -1
    for row in range(stretch.after - 1, stretch.first - 1, -1):
        error = values[row] - reference
        if not abs(error) > SWING * half_width:
            continue
        side = error > 0.0
        is_last = after < 0
        if after >= 0:
            gap_s = tell_time(stretch, after) - tell_time(stretch, row)
            is_last = after - row > 1 and gap_s >= SHORTEST_HOLD_S
            is_last = is_last or side != (values[after] - reference > 0.0)
        after = row
        if not is_last or row == stretch.after - 1:
            continue
        if last >= 0:
            between_s = tell_time(stretch, last) - tell_time(stretch, row)
            same = side == (values[last] - reference > 0.0)
            return between_s if same else 2.0 * between_s  # type: ignore[no-any-return]
        last = row
    return 0.0


@measure
def _interpolate(values: Any, stretch: Any, row: int, threshold: float) -> float:
    before, after = values[row], values[row + 1]
    share = (threshold - before) / (after - before)
    begin_s = tell_time(stretch, row)
    return begin_s + share * (tell_time(stretch, row + 1) - begin_s)  # type: ignore[no-any-return]


@measure
def _find_largest(values: Any, stretch: Any, reference: float) -> float:
    low = high = reference - values[stretch.first]
    for row in range(stretch.first, stretch.after):
        error = reference - values[row]
        low, high = min(low, error), max(high, error)
    return abs(low) if -low > high else abs(high)  # type: ignore[no-any-return]
