"""Many rows in one call: each simulated by a compiled loop, then measured from its arrays.

What is measured are the numbers of `measure`, operation by operation, so that they are the same
bit for bit: `response` finds the stretch of a loop, `step_response` the numbers of its curve. What
rests on the cosine or the root of a library is left to numpy, as there: the line from start to goal
is given, and of the end the places are returned. What is added up stands in `batch_sums`.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from turtlelog.measure import metric, step_response, swings
from turtlelog.measure.step_response import SHORTEST_HOLD_S, SWING
from turtlelog.measure.table import loop_metrics
from turtlelog.measure.table.loop_metrics import SMALLEST_STEP
from turtlelog.simulate.compiled import functions, memory
from turtlelog.simulate.compiled.functions import measure, wrap_angle
from turtlelog.simulate.compiled.memory import MAX_DURATION, REORIENT, ROTATE, TIMEOUT, TRANSLATE
from turtlelog.sweep import batch_sums, batch_table
from turtlelog.sweep.batch_sums import (
    find_cross_track,
    find_largest_gap,
    integrate_error,
    measure_way,
    share_saturated,
    tell_time,
)
from turtlelog.sweep.batch_table import (
    CUT,
    DEGREES,
    LOOP_FIGURES,
    NO_PHASE,
    NO_STEP,
    NOT_REACHED,
    OK,
    TOO_LARGE,
    TOO_SHORT,
    UNDETERMINED,
)

_DURATION, _DELAY, _RISE, _PEAK, _PEAK_TIME, _OVERSHOOT, _UNDERSHOOT, _SETTLING = range(8)
_CROSSINGS, _FINAL, _STEADY, _LARGEST, _STABLE, _IAE, _SATURATED = range(8, 15)
_COUNT = len(LOOP_FIGURES)
_IS_ANGLE = np.array([name in DEGREES for name in LOOP_FIGURES])
_IS_TIME = np.array([place in {_DELAY, _RISE, _SETTLING} for place in range(_COUNT)])
_NEEDS_STEP = np.array([0 < place < _CROSSINGS for place in range(_COUNT)])
_TO_DEGREES = 180.0 / math.pi
_TURN_RAD = 2.0 * math.pi


class _Stretch(NamedTuple):
    """Where a loop acts: from the first pose to the one after the last, from when [ns].

    `is_cut` and `is_own` are `was_cut` and `ended_itself` of a `Response`; no poses: no phase.
    """

    first: int
    after: int
    start_ns: int
    period_ns: int
    is_cut: bool
    is_own: bool


class _Step(NamedTuple):
    """What a loop should do."""

    initial: float
    reference: float
    band: float


class _Row(NamedTuple):
    """What a row is measured from."""

    settings: Any
    state: Any
    memory: Any
    line: Any


class _Entry(NamedTuple):
    """Where the figures of a loop, or of a row, are entered."""

    figures: Any
    status: Any


@measure
def _unwrap(ticks: Any, count: int, heading_rad: Any) -> None:
    """Count the heading through full turns, as numpy's unwrap."""
    turned = 0.0
    heading_rad[0] = ticks[0].heading_rad
    for row in range(1, count):
        step = ticks[row].heading_rad - ticks[row - 1].heading_rad
        if abs(step) > math.pi:
            rest = np.fmod(step + math.pi, _TURN_RAD)
            if rest < 0.0:
                rest += _TURN_RAD
            turned += (rest - math.pi) - step
        heading_rad[row] = ticks[row].heading_rad + turned


@measure
def _project(ticks: Any, count: int, line: Any, along_m: Any) -> None:
    for row in range(count):
        x_m, y_m = ticks[row].x_m - line.x_m, ticks[row].y_m - line.y_m
        along_m[row] = x_m * line.cos + y_m * line.sin


@measure
def _interpolate(values: Any, stretch: Any, row: int, threshold: float) -> float:
    before, after = values[row], values[row + 1]
    share = (threshold - before) / (after - before)
    begin_s = tell_time(stretch, row)
    return begin_s + share * (tell_time(stretch, row + 1) - begin_s)  # type: ignore[no-any-return]


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
def _find_largest(values: Any, stretch: Any, reference: float) -> float:
    low = high = reference - values[stretch.first]
    for row in range(stretch.first, stretch.after):
        error = reference - values[row]
        low, high = min(low, error), max(high, error)
    return abs(low) if -low > high else abs(high)  # type: ignore[no-any-return]


@measure
def _count_crossings(values: Any, stretch: Any, reference: float) -> float:
    crossings, side = 0, 0
    for row in range(stretch.first, stretch.after):
        now = 1 if values[row] > reference else -1 if values[row] < reference else 0
        if now:
            crossings += side == -now
            side = now
    return float(crossings)


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
    found[_DURATION] = tell_time(stretch, end)
    found[_PEAK] = values[ahead]
    found[_PEAK_TIME] = tell_time(stretch, ahead)
    found[_OVERSHOOT] = 100.0 * ((values[ahead] - reference) / height)
    found[_UNDERSHOOT] = 100.0 * ((initial - values[behind]) / height)
    found[_CROSSINGS] = _count_crossings(values, stretch, reference)
    found[_FINAL] = abs(error)
    found[_STEADY] = error if reference >= initial else -error
    found[_LARGEST] = _find_largest(values, stretch, reference)


class _Swings(NamedTuple):
    """Where a response swings: whole swings, its size at the start and at most, its reference."""

    whole: int
    size: float
    largest: float
    reference: float


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


@measure
def _judge_swings(
    values: Any, stretch: Any, reference: float, clipped: int, most: float
) -> tuple[float, int]:
    """Return the verdict of `swings` as a value and a status; a clipped row -1 is none."""
    largest, size = 0.0, abs(reference - values[stretch.first])
    for row in range(stretch.first, stretch.after):
        largest = max(largest, abs(reference - values[row]))
    count = int(_count_crossings(values, stretch, reference)) - 1
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
def _find_stable(row: Any, values: Any, stretch: Any, step: Any, phase: int) -> tuple[float, int]:
    """Return whether the swings die out, at the poses up to the last that was answered."""
    if abs(step.reference - step.initial) <= SMALLEST_STEP:
        return np.nan, NO_STEP
    samples, turns = row.memory.samples, phase != TRANSLATE
    after = _find_sample(samples, row.state.samples, phase + 1)
    answered_ns = samples[after - 1].time_ns
    end = min(answered_ns // stretch.period_ns + 1, stretch.after)
    if end - stretch.first < 2:
        return np.nan, TOO_SHORT
    limit = row.memory.axes[1 if turns else 0].limit
    sample = after - 1
    while sample >= 0 and samples[sample].phase == phase:
        command = samples[sample].turn_rate if turns else samples[sample].speed
        if abs(command) >= limit:
            break
        sample -= 1
    clipped = -1
    if sample >= 0 and samples[sample].phase == phase:
        clipped = min(samples[sample].time_ns // stretch.period_ns, end - 1)
    answered = _Stretch(stretch.first, end, 0, stretch.period_ns, False, False)  # noqa: FBT003
    most = swings.TURN_RAD if turns else math.inf
    return _judge_swings(values, answered, step.reference, clipped, most)  # type: ignore[no-any-return]


@measure
def _measure_response(values: Any, stretch: Any, step: Any, pieces: Any, entry: Any) -> None:
    """Enter the figures of a loop in the order of `LOOP_FIGURES`."""
    found, status = entry.figures, entry.status
    _enter_curve(values, stretch, step, found)
    begin_s = _find_level(values, stretch, step, 0.1)
    found[_DELAY] = _find_level(values, stretch, step, 0.5)
    found[_RISE] = _find_level(values, stretch, step, 0.9) - begin_s
    found[_SETTLING] = _find_settling(values, stretch, step)
    found[_IAE] = integrate_error(values, stretch, step.reference, pieces)
    is_step = not abs(step.reference - step.initial) <= SMALLEST_STEP
    for place in range(_COUNT):
        is_time = _IS_TIME[place]
        status[place] = OK
        if stretch.is_cut and not is_time:
            status[place] = CUT
        elif _NEEDS_STEP[place] and not is_step:
            status[place] = NO_STEP
        elif is_time and math.isnan(found[place]):
            status[place] = NOT_REACHED
        elif not math.isfinite(found[place]):
            status[place] = TOO_LARGE


@measure
def _find_sample(samples: Any, count: int, phase: int) -> int:
    """Return the first sample of a phase or a later one: phases only go on."""
    low, high = 0, count
    while low < high:
        middle = (low + high) // 2
        if samples[middle].phase < phase:
            low = middle + 1
        else:
            high = middle
    return low


@measure
def _ends_blocked(state: Any, samples: Any, end_ns: int) -> bool:
    """Whether the last sample's command went out later than its pose was answered, or never."""
    last_ns = samples[state.samples - 1].time_ns
    if state.commands < state.samples:
        return end_ns > last_ns  # type: ignore[no-any-return]
    return samples[samples[state.commands - 1].published].published_ns > last_ns  # type: ignore[no-any-return]


@measure
def _find_stretch(row: Any, end_ns: int, phase: int) -> Any:
    """Return where the loop of a phase acts; -1 as its first row without such samples."""
    state, samples, period_ns = row.state, row.memory.samples, row.settings.period_ns
    first = _find_sample(samples, state.samples, phase)
    after = _find_sample(samples, state.samples, phase + 1)
    if first == after:
        return _Stretch(-1, -1, 0, period_ns, False, False)  # noqa: FBT003
    start_ns, goes_on = samples[first].time_ns, after < state.samples
    last_ns = samples[after].time_ns if goes_on else end_ns
    pose = -(-start_ns // period_ns)
    if 0 < pose < state.ticks and pose * period_ns != start_ns:
        pose -= 1
    is_own = state.stop_reason not in (MAX_DURATION, TIMEOUT) or last_ns < end_ns
    is_own = is_own or goes_on or _ends_blocked(state, samples, end_ns)
    is_cut = state.stop_reason == MAX_DURATION and last_ns == end_ns
    end = min(last_ns // period_ns + 1, state.ticks)
    return _Stretch(min(pose, state.ticks), end, start_ns, period_ns, is_cut, is_own)


@measure
def _measure_loop(row: Any, values: Any, pieces: Any, end_ns: int, phase: int, entry: Any) -> None:
    """Find the stretch of a loop and measure it there."""
    stretch, line = _find_stretch(row, end_ns, phase), row.line
    if stretch.after - stretch.first < 2:
        entry.status[:] = NO_PHASE if stretch.first < 0 else TOO_SHORT
        return
    reference = line.length_m
    if phase != TRANSLATE:
        reference = line.bearing_rad if phase == ROTATE else line.goal_heading_rad
        turns = np.rint((values[stretch.after - 1] - reference) / _TURN_RAD)
        reference += turns * 2.0 * math.pi
    step = _Step(values[stretch.first], reference, line.band)
    _measure_response(values, stretch, step, pieces, entry)
    found, status = _find_stable(row, values, stretch, step, phase)
    entry.figures[_STABLE], entry.status[_STABLE] = found, status
    samples, axis = row.memory.samples, 0 if phase == TRANSLATE else 1
    own = (
        _find_sample(samples, row.state.samples, phase),
        _find_sample(samples, row.state.samples, phase + 1),
    )
    share = share_saturated(samples, own, axis, row.memory.axes[axis].limit)
    entry.figures[_SATURATED], entry.status[_SATURATED] = share, OK
    if phase != TRANSLATE:
        for place in range(_COUNT):
            if _IS_ANGLE[place]:
                entry.figures[place] *= _TO_DEGREES


@measure
def _find_end_ns(row: Any) -> int:
    """Return the time of the last row of any column [ns]."""
    state, samples = row.state, row.memory.samples
    end_ns = max((state.ticks - 1) * row.settings.period_ns, samples[state.samples - 1].time_ns)
    if state.commands:
        end_ns = max(end_ns, samples[samples[state.commands - 1].published].published_ns)
    return end_ns  # type: ignore[no-any-return]


@measure
def _measure_row(row: Any, scratch: Any, entry: Any) -> None:
    ticks, samples, line = row.memory.ticks, row.memory.samples, row.line
    count, end_ns, pieces = row.state.ticks, _find_end_ns(row), scratch[2:].reshape(-1)
    _unwrap(ticks, count, scratch[0])
    _project(ticks, count, line, scratch[1])
    for loop in range(3):
        phase = ROTATE if loop == 0 else TRANSLATE if loop == 1 else REORIENT
        part = slice(loop * _COUNT, loop * _COUNT + _COUNT)
        values = scratch[1] if phase == TRANSLATE else scratch[0]
        own = _Entry(entry.figures[part], entry.status[part])
        _measure_loop(row, values, pieces, end_ns, phase, own)
    turns_last = _find_sample(samples, row.state.samples, REORIENT) < row.state.samples
    wanted_rad = line.goal_heading_rad if turns_last else line.bearing_rad
    pose, first, end = (
        ticks[count - 1],
        ticks[samples[0].pose_sequence],
        entry.figures[3 * _COUNT :],
    )
    end[0] = (end_ns - samples[0].time_ns) / 1e9
    end[1] = abs(wrap_angle(wanted_rad - scratch[0, count - 1])) * _TO_DEGREES
    end[2], end[3] = pose.x_m, pose.y_m
    end[4] = abs(wrap_angle(line.goal_heading_rad - pose.heading_rad)) * _TO_DEGREES
    end[5], end[6] = first.x_m, first.y_m
    x_m, y_m = pose.x_m - line.x_m, pose.y_m - line.y_m
    end[7] = y_m * line.cos - x_m * line.sin
    first_row = -(-samples[0].time_ns // row.settings.period_ns)
    end[8] = find_cross_track(ticks, first_row, count, line)
    end[9] = find_largest_gap(samples, row.state.samples)
    end[10] = measure_way(ticks, count, pieces)


@njit(error_model="numpy", nogil=True, forceinline=True)
def run_rows_by(simulate: Any, rows: Any, scratch: Any, entries: Any) -> None:
    """Simulate and measure rows, each in the same memory; numbers and statuses are entered.

    `simulate` is the compiled loop; `rows` are settings, states and lines of each, its axes, and
    the memory; `entries` are figures and statuses.
    """
    (settings, states, lines), axes, memory = rows
    for number in range(len(settings)):
        for axis in range(2):
            memory.axes[axis] = axes[number, axis]
        for loss in memory.losses:
            loss.since_ns = loss.count = loss.finished_since_ns = loss.finished = 0
        simulate(settings[number : number + 1], states[number : number + 1], memory)
        state = states[number]
        if not state.has_failed and state.samples:
            row = _Row(settings[number], state, memory, lines[number])
            _measure_row(row, scratch, _Entry(entries[0][number], entries[1][number]))


SOURCES = (
    *(batch_sums, batch_table, functions, loop_metrics, memory, metric, step_response, swings),
)
"""Whose code and constants stand in the machine code."""
