"""Many rows in one call: each simulated by a compiled loop, then measured from its arrays.

The numbers are those of `measure`, operation by operation, so that they are the same bit for bit:
here the stretch of a loop, as `response` finds it; beside it the metrics of its curve
(`batch_step_response`), whether its swings die out (`batch_swings`), and sums and searches along
the rows (`batch_sums`). What rests on the cosine or the root of a library is left to numpy, as
there: the line from start to goal is given, and of the end the places are returned.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit, types

from turtlelog import arithmetic
from turtlelog.compiled_loops import sum_up_sources
from turtlelog.laws import sequential
from turtlelog.laws.sequential import REORIENT, ROTATE, TRANSLATE
from turtlelog.measure import metric, registry, step_response, swings
from turtlelog.measure.registry import LOOP_METRICS
from turtlelog.measure.table import loop_metrics
from turtlelog.measure.table.loop_metrics import SMALLEST_STEP
from turtlelog.simulate import compiled_arithmetic, rows, twins
from turtlelog.simulate.compiled_loop import SAMPLE, TICK
from turtlelog.sweep import (
    batch_functions,
    batch_rows,
    batch_step_response,
    batch_sums,
    batch_swings,
    batch_table,
)
from turtlelog.sweep.batch_functions import list_array, measure, wrap_angle
from turtlelog.sweep.batch_rows import FACTS, LINE
from turtlelog.sweep.batch_step_response import measure_response
from turtlelog.sweep.batch_sums import (
    find_cross_track,
    find_largest_gap,
    find_sample,
    measure_way,
    share_saturated,
)
from turtlelog.sweep.batch_swings import judge_swings
from turtlelog.sweep.batch_table import (
    NO_PHASE,
    NO_STEP,
    OK,
    RUN_AT,
    TOO_SHORT,
    LoopMetric,
    RunColumn,
)

_COUNT = len(LoopMetric)
_IS_ANGLE = np.array([LOOP_METRICS[metric.ending].unit == "{value}" for metric in LoopMetric])
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

    facts: Any
    ticks: Any
    samples: Any
    line: Any


class _Entry(NamedTuple):
    """The columns of a loop, or of a row: values, statuses, and which are asked for."""

    values: Any
    status: Any
    asked: Any


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
def _find_stretch(row: Any, end_ns: int, phase: int) -> Any:
    """Return where the loop of a phase acts; -1 as its first row without such samples."""
    facts, samples, period_ns = row.facts, row.samples, row.facts.period_ns
    first = find_sample(samples, facts.samples, phase)
    after = find_sample(samples, facts.samples, phase + 1)
    if first == after:
        return _Stretch(-1, -1, 0, period_ns, False, False)  # noqa: FBT003
    start_ns, goes_on = samples[first].time_ns, after < facts.samples
    last_ns = samples[after].time_ns if goes_on else end_ns
    pose = -(-start_ns // period_ns)
    if 0 < pose < facts.ticks and pose * period_ns != start_ns:
        pose -= 1
    is_own = not (facts.is_cut or facts.is_late) or last_ns < end_ns
    is_own = is_own or goes_on or _ends_blocked(facts, samples, end_ns)
    is_cut = facts.is_cut and last_ns == end_ns
    end = min(last_ns // period_ns + 1, facts.ticks)
    return _Stretch(min(pose, facts.ticks), end, start_ns, period_ns, is_cut, is_own)


@measure
def _ends_blocked(facts: Any, samples: Any, end_ns: int) -> bool:
    """Whether the last sample's command went out later than its pose was answered, or never."""
    last_ns = samples[facts.samples - 1].time_ns
    if facts.published < facts.samples:
        return end_ns > last_ns  # type: ignore[no-any-return]
    return samples[facts.published - 1].published_ns > last_ns  # type: ignore[no-any-return]


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
    measure_response(values, stretch, step, pieces, entry)
    if entry.asked[LoopMetric.STABLE]:
        found, status = _find_stable(row, values, stretch, step, phase)
        entry.values[LoopMetric.STABLE], entry.status[LoopMetric.STABLE] = found, status
    samples, axis = row.samples, 0 if phase == TRANSLATE else 1
    own = (
        find_sample(samples, row.facts.samples, phase),
        find_sample(samples, row.facts.samples, phase + 1),
    )
    share = share_saturated(samples, own, axis, _find_limit(row.facts, phase))
    entry.values[LoopMetric.SATURATED_SHARE] = share
    entry.status[LoopMetric.SATURATED_SHARE] = OK
    if phase != TRANSLATE:
        for place in range(_COUNT):
            if _IS_ANGLE[place]:
                entry.values[place] *= _TO_DEGREES


@measure
def _find_stable(row: Any, values: Any, stretch: Any, step: Any, phase: int) -> tuple[float, int]:
    """Return whether the swings die out, at the poses up to the last that was answered."""
    if abs(step.reference - step.initial) <= SMALLEST_STEP:
        return np.nan, NO_STEP
    samples, turns = row.samples, phase != TRANSLATE
    after = find_sample(samples, row.facts.samples, phase + 1)
    answered_ns = samples[after - 1].time_ns
    end = min(answered_ns // stretch.period_ns + 1, stretch.after)
    if end - stretch.first < 2:
        return np.nan, TOO_SHORT
    limit = _find_limit(row.facts, phase)
    sample = after - 1
    while sample >= 0 and samples[sample].phase == phase:
        command = samples[sample].turn_rate_rad_s if turns else samples[sample].speed_m_s
        if abs(command) >= limit:
            break
        sample -= 1
    clipped = -1
    if sample >= 0 and samples[sample].phase == phase:
        clipped = min(samples[sample].time_ns // stretch.period_ns, end - 1)
    answered = _Stretch(stretch.first, end, 0, stretch.period_ns, False, False)  # noqa: FBT003
    most = swings.TURN_RAD if turns else math.inf
    return judge_swings(values, answered, step.reference, clipped, most)  # type: ignore[no-any-return]


@measure
def _find_limit(facts: Any, phase: int) -> float:
    """Return where the command of a phase is clipped."""
    return facts.speed_limit if phase == TRANSLATE else facts.turn_limit  # type: ignore[no-any-return]


@measure
def _find_end_ns(row: Any) -> int:
    """Return the time of the last row of any column [ns]."""
    facts, samples = row.facts, row.samples
    end_ns = max((facts.ticks - 1) * facts.period_ns, samples[facts.samples - 1].time_ns)
    if facts.published:
        end_ns = max(end_ns, samples[facts.published - 1].published_ns)
    return end_ns  # type: ignore[no-any-return]


@measure
def _measure_row(row: Any, scratch: Any, entry: Any) -> None:
    ticks, samples, line = row.ticks, row.samples, row.line
    count, end_ns, pieces = row.facts.ticks, _find_end_ns(row), scratch[2:].reshape(-1)
    _unwrap(ticks, count, scratch[0])
    _project(ticks, count, line, scratch[1])
    for number in range(3):
        phase = ROTATE if number == 0 else TRANSLATE if number == 1 else REORIENT
        part = slice(number * _COUNT, number * _COUNT + _COUNT)
        values = scratch[1] if phase == TRANSLATE else scratch[0]
        own = _Entry(entry.values[part], entry.status[part], entry.asked[part])
        if own.asked.any():
            _measure_loop(row, values, pieces, end_ns, phase, own)
    turns_last = find_sample(samples, row.facts.samples, REORIENT) < row.facts.samples
    wanted_rad = line.goal_heading_rad if turns_last else line.bearing_rad
    pose, first = ticks[count - 1], ticks[samples[0].pose_sequence]
    end, asked = entry.values[RUN_AT:], entry.asked[RUN_AT:]
    end[RunColumn.DURATION] = (end_ns - samples[0].time_ns) / 1e9
    end[RunColumn.HEADING_ERROR] = abs(wrap_angle(wanted_rad - scratch[0, count - 1])) * _TO_DEGREES
    end[RunColumn.X_M], end[RunColumn.Y_M] = pose.x_m, pose.y_m
    error_rad = abs(wrap_angle(line.goal_heading_rad - pose.heading_rad))
    end[RunColumn.GOAL_HEADING_ERROR] = error_rad * _TO_DEGREES
    end[RunColumn.FIRST_X_M], end[RunColumn.FIRST_Y_M] = first.x_m, first.y_m
    x_m, y_m = pose.x_m - line.x_m, pose.y_m - line.y_m
    end[RunColumn.CROSS_TRACK] = y_m * line.cos - x_m * line.sin
    if asked[RunColumn.CROSS_TRACK_MAX]:
        first_row = -(-samples[0].time_ns // row.facts.period_ns)
        end[RunColumn.CROSS_TRACK_MAX] = find_cross_track(ticks, first_row, count, line)
    if asked[RunColumn.LARGEST_GAP]:
        end[RunColumn.LARGEST_GAP] = find_largest_gap(samples, row.facts.samples)
    if asked[RunColumn.PATH_LENGTH]:
        end[RunColumn.PATH_LENGTH] = measure_way(ticks, count, pieces)


SOURCES = (
    *(batch_functions, batch_rows, batch_step_response, batch_sums, batch_swings, batch_table),
    *(arithmetic, compiled_arithmetic, rows, sequential, twins),
    *(loop_metrics, metric, registry, step_response, swings),
)
"""Whose code and constants stand in the machine code."""

MEASURE = types.int64(
    list_array(FACTS),
    list_array(TICK),
    list_array(SAMPLE),
    list_array(LINE),
    list_array(np.float64, 2),
    types.Tuple([list_array(np.float64), list_array(np.int8), list_array(np.bool_)]),
)
"""What measures a row, whatever simulated it."""


def _build(stamp: int) -> Any:
    """Return the compiled function, whose cache knows the code that it was compiled with."""

    @njit(MEASURE, nogil=True, cache=True, error_model="numpy", _nrt=False)
    def measure_row(
        facts: Any, ticks: Any, samples: Any, line: Any, scratch: Any, entry: Any
    ) -> int:
        """Measure a row: numbers and statuses are entered.

        `entry` are values, statuses, and which of their columns are asked for: what takes a pass of
        its own is not computed otherwise.
        """
        row = _Row(facts[0], ticks, samples, line[0])
        _measure_row(row, scratch, _Entry(entry[0], entry[1], entry[2]))
        return stamp

    return measure_row


measure_row = _build(sum_up_sources(*SOURCES))
