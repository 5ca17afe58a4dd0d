"""Arrays of a row of the batch for the metrics of `measure`: curves of loops, and the course.

The functions are compiled. They read the rows of the loop into work arrays by the rules of
`measure.loop_segment`; fields have the names and, bit for bit, the values of `Response` and
`RunContext`. Laws that track a path have functions of their own, so that laws with a goal take no
longer to compile.
"""

import math
from typing import Any, Final, NamedTuple

from turtlelog.arithmetic import called
from turtlelog.measure.loop_segment import (
    ALONG,
    BEARING_NOW,
    CROSS,
    HEADING,
    Segment,
    Ticks,
    ends_itself,
    find_bearing,
    find_distance,
    find_row_from,
    find_segment,
    hold_column,
    project,
    read_constant,
    refer_to_start,
    subtract_from,
    tell_pose_time,
    tell_publication,
    turn_towards,
    unwrap,
)
from turtlelog.measure.reductions import USES
from turtlelog.measure.references import LastPose, find_last_heading_error
from turtlelog.measure.response import Track, choose_reason
from turtlelog.run.angles import continue_step, is_fast_turn
from turtlelog.run.path_pieces import follow_pieces


class Memory(NamedTuple):
    """Work arrays for the largest number of poses or samples, filled again for every row."""

    numbers: Any  # one row per use: first the rows of `reductions`, then those named here
    rows: Any  # row numbers


class PathMemory(NamedTuple):
    """Work arrays as in `Memory`, the path's numbers and pieces, corners and seam as in `Track`."""

    numbers: Any
    rows: Any
    path: Any
    pieces: Any
    corners: Any
    seam_rad: float


_HEADINGS, _VALUES, _ERROR, _TIMES, _STEPS, _COMMAND_TIMES, _COMMANDS = range(USES, USES + 7)
USES_OF_ROW: Final = USES + 7
_ARCS, _OFFSETS, _DUES, _REFERENCE = range(USES_OF_ROW, USES_OF_ROW + 4)
USES_OF_PATH: Final = USES_OF_ROW + 4


class Commands(NamedTuple):
    """Commands of a loop, with the fields of `CommandStretch`."""

    time_s: Any
    values: Any
    answered_ns: Any


class LoopCurve(NamedTuple):
    """Curve of a loop, with the fields of `Response`."""

    pose_ns: Ticks
    time_s: Any
    step_s: Any
    values: Any
    error: Any
    initial: float
    reference: float
    band: float
    start_s: float
    ended_itself: bool
    was_cut: bool
    is_angle: bool
    limit: float
    commands: Commands
    memory: Any
    track: Any


class Course(NamedTuple):
    """Quantities of a run, with the fields of `RunContext`."""

    x_m: Any
    y_m: Any
    samples: Any
    goal: tuple[float, float, float]
    aim: Any
    start_ns: int
    period_ns: int
    first_row: int
    sample_count: int
    duration_s: float
    last_pose_s: float
    last_heading_rad: float
    last_cross_track_m: float
    heading_error_rad: float
    is_lawless_with_goal: bool
    memory: Any
    offset_m: Any


class Row(NamedTuple):
    """Inputs of the measurement of a row, with start and end of the run [ns]."""

    facts: Any
    ticks: Any
    samples: Any
    aim: Any
    loops: Any
    memory: Any
    start_ns: int
    end_ns: int


def is_any(asked: Any, first: int, after: int) -> bool:
    """Return whether any column in a range is requested."""
    count = 0
    for column in range(first, after):
        count += asked[column]
    return count > 0


def prepare_row(facts: Any, ticks: Any, samples: Any, memory: Any) -> tuple[int, int]:
    """Unwrap the headings, as `unwrap_headings`, and return start and end of the run [ns]."""
    heading_rad, period_s = memory.numbers[_HEADINGS], facts.period_ns / 1e9
    added_rad, before = 0.0, ticks[0].heading_rad
    heading_rad[0] = before
    for place in range(1, len(ticks)):
        now, turned_rad = ticks[place].heading_rad, ticks[place].turn_rate_rad_s * period_s
        is_fast = is_fast_turn(turned_rad)
        if is_fast or abs(now - before) > math.pi:  # other steps add nothing, in no time
            added_rad += continue_step(now - before, turned_rad, is_fast)
        heading_rad[place] = now + added_rad
        before = now
    end_ns = max((facts.ticks - 1) * facts.period_ns, samples[-1].time_ns)
    if facts.published > 0:
        end_ns = max(end_ns, samples[facts.published - 1].published_ns)
    return samples[0].time_ns, end_ns


def find_row_segment(row: Row, number: int) -> Segment:
    """Return the segment of a loop."""
    times = Ticks(row.facts.period_ns, 0, row.facts.ticks)
    return find_segment(row.samples, times, row.loops[number], row.end_ns)


def find_missing(row: Row, number: int, segment: Segment) -> int:
    """Return the reason why a loop has no curve; 0 if it has one."""
    loop = row.loops[number]
    is_known = not math.isnan(read_constant(loop.reference, row.aim))
    return choose_reason(row, loop, segment, is_known)


@called
def read_loop_curve(row: Row, number: int, segment: Segment) -> LoopCurve:
    """Return the curve of a loop in its segment."""
    loop, memory, aim = row.loops[number], row.memory, row.aim
    first, count = segment.first, segment.after - segment.first
    values = memory.numbers[_HEADINGS][first : segment.after]
    is_angle = loop.signal == HEADING
    if not is_angle:
        values = memory.numbers[_VALUES][:count]
        for place in range(count):
            x_m, y_m = row.ticks[first + place].x_m, row.ticks[first + place].y_m
            if loop.signal == ALONG or loop.signal == CROSS:  # noqa: PLR1714
                values[place] = project(x_m, y_m, aim, loop.signal == ALONG)
            else:
                values[place] = find_distance(x_m, y_m, aim.goal_x_m, aim.goal_y_m)
    if loop.reference != BEARING_NOW:
        reference = turn_towards(read_constant(loop.reference, aim), values[-1], is_angle)
        return _build_curve(row, loop, segment, values, reference, 0)
    error, reference = memory.numbers[_ERROR][:count], _find_bearing(row, first)
    for place in range(count):
        error[place] = _find_bearing(row, first + place) - values[place]
    values = refer_to_start(error, reference, is_angle, memory.numbers[_VALUES][:count])
    return _build_curve(row, loop, segment, values, reference, 0)


def _find_bearing(row: Row, place: int) -> float:
    tick, aim = row.ticks[place], row.aim
    return find_bearing(tick.x_m, tick.y_m, aim.goal_x_m, aim.goal_y_m)


def _build_curve(
    row: Row, loop: Any, segment: Segment, values: Any, reference: float, track: Any
) -> LoopCurve:
    facts, memory, samples, count = row.facts, row.memory, row.samples, len(values)
    time_s, step_s = memory.numbers[_TIMES][:count], memory.numbers[_STEPS][: count - 1]
    for place in range(count):
        pose_ns = (segment.first + place) * facts.period_ns
        time_s[place] = tell_pose_time(pose_ns, segment.start_ns)
    for place in range(count - 1):
        step_s[place] = time_s[place + 1] - time_s[place]
    last = samples[-1]
    out_ns = row.end_ns if facts.published < len(samples) else last.published_ns
    is_done = not (facts.is_cut or facts.is_late)
    return LoopCurve(
        Ticks(facts.period_ns, segment.first, count),
        time_s,
        step_s,
        values,
        subtract_from(reference, values, memory.numbers[_ERROR][:count]),
        values[0],
        reference,
        row.aim.band,
        (segment.start_ns - row.start_ns) / 1e9,
        ends_itself(segment, samples, loop, is_done, out_ns > last.time_ns),
        facts.is_cut and segment.end_ns == row.end_ns,
        loop.signal == HEADING,
        facts.turn_limit if loop.turns else facts.speed_limit,
        _read_commands(row, loop, segment),
        memory,
        track,
    )


def _read_commands(row: Row, loop: Any, segment: Segment) -> Commands:
    samples = row.samples[segment.first_sample : segment.after_sample]
    values = row.memory.numbers[_COMMANDS][: len(samples)]
    time_s = row.memory.numbers[_COMMAND_TIMES][: len(samples)]
    is_out = row.facts.published == len(row.samples)
    for place in range(len(samples)):
        sample = samples[place]
        values[place] = sample.turn_rate_rad_s if loop.turns else sample.speed_m_s
        out_ns = sample.published_ns if is_out else sample.time_ns
        time_s[place] = tell_publication(out_ns, segment.end_ns, row.start_ns)
    return Commands(time_s, values, samples.time_ns)


def read_course(row: Row) -> Course:
    """Return the quantities of the whole run."""
    last, none = row.ticks[-1], row.memory.numbers[_HEADINGS][:0]
    last_m = project(last.x_m, last.y_m, row.aim, False)  # noqa: FBT003
    return _build_course(row, none, last_m, _find_heading_error(row, math.nan))


def _build_course(row: Row, offset_m: Any, last_m: float, heading_error_rad: float) -> Course:
    """Return the quantities of the whole run.

    `offset_m` is the offset of every pose from the path; empty for the line from start to goal.
    `last_m` is the offset of the last pose from either, `heading_error_rad` the error at the end.
    """
    facts, ticks, aim = row.facts, row.ticks, row.aim
    return Course(
        ticks.x_m,
        ticks.y_m,
        row.samples,
        (aim.goal_x_m, aim.goal_y_m, aim.goal_heading_rad),
        aim,
        row.start_ns,
        facts.period_ns,
        find_row_from(Ticks(facts.period_ns, 0, facts.ticks), facts.ticks, row.start_ns),
        len(row.samples),
        (row.end_ns - row.start_ns) / 1e9,
        ((facts.ticks - 1) * facts.period_ns - row.start_ns) / 1e9,
        ticks[-1].heading_rad,
        last_m,
        heading_error_rad,
        False,  # noqa: FBT003
        row.memory,
        offset_m,
    )


def _find_heading_error(row: Row, reference_rad: float) -> float:
    """Return the final heading error, otherwise the recorded error; NaN if it is unknown."""
    last, samples = row.ticks[-1], row.samples
    unwrapped_rad = row.memory.numbers[_HEADINGS][len(row.ticks) - 1]
    pose = LastPose(last.x_m, last.y_m, last.heading_rad, unwrapped_rad, reference_rad)
    error_rad = find_last_heading_error(samples.phase, row.loops, row.aim, pose)
    if not math.isnan(error_rad):
        return error_rad
    for place in range(len(samples)):
        if math.isnan(samples[place].heading_error_rad):
            return math.nan
    return samples[len(samples) - 1].heading_error_rad  # type: ignore[no-any-return]


# Laws that track a path.


def prepare_path_row(facts: Any, ticks: Any, samples: Any, memory: Any) -> tuple[int, int]:
    """Do as `prepare_row`, and find the place of every pose on the path, as `trace_poses`."""
    path, pieces, numbers, count = memory.path[0], memory.pieces, memory.numbers, len(ticks)
    x_m, y_m, due_m = numbers[_ARCS][:count], numbers[_OFFSETS][:count], numbers[_DUES][:count]
    due_m[:] = math.nan
    if path.has_speed and _has_any(samples.reference_x_m):
        hold_column(samples.reference_x_m, samples.pose_sequence, count, x_m)
        hold_column(samples.reference_y_m, samples.pose_sequence, count, y_m)
        follow_pieces(path, pieces, 0.0, x_m, y_m, due_m, due_m, y_m)
    for place in range(count):
        x_m[place], y_m[place] = ticks[place].x_m, ticks[place].y_m
    follow_pieces(path, pieces, math.nan, x_m, y_m, due_m, x_m, y_m)
    return prepare_row(facts, ticks, samples, memory)


def _has_any(column: Any) -> bool:
    """Return whether any value of a column is finite."""
    row = 0
    while row < len(column) and not math.isfinite(column[row]):
        row += 1
    return row < len(column)


def find_path_missing(row: Row, number: int, segment: Segment) -> int:
    """Return the reason why a loop has no curve; 0 if it has one."""
    loop = row.loops[number]
    is_known = loop.signal == CROSS
    if loop.signal == HEADING:
        is_known = _has_any(row.samples.reference_heading_rad)
    elif loop.signal == ALONG:
        is_known = row.memory.path[0].has_speed and _has_any(row.samples.reference_x_m)
    return choose_reason(row, loop, segment, is_known)


@called
def read_path_curve(row: Row, number: int, segment: Segment) -> LoopCurve:
    """Return the curve of a loop in its segment."""
    memory, loop, samples = row.memory, row.loops[number], row.samples
    numbers, first, after = memory.numbers, segment.first, segment.after
    is_angle, count = loop.signal == HEADING, after - first
    error, values = numbers[_ERROR][:count], numbers[_HEADINGS][first:after]
    reference, arcs_m = numbers[_REFERENCE][first:after], numbers[_ARCS][first:after]
    if is_angle:
        held_rad = numbers[_REFERENCE][:after]
        hold_column(samples.reference_heading_rad, samples.pose_sequence, after, held_rad)
    else:
        values = arcs_m if loop.signal == ALONG else numbers[_OFFSETS][first:after]
    for place in range(count):
        if not is_angle:
            reference[place] = numbers[_DUES][first + place] if loop.signal == ALONG else 0.0
        error[place] = reference[place] - values[place]
    start = reference[0]
    values = refer_to_start(error, start, is_angle, numbers[_VALUES][:count])
    if is_angle:
        unwrap(reference)
    path = memory.path[0]
    lap = memory.seam_rad, path.length_m, path.is_closed, path.has_speed
    track = Track(reference, arcs_m, memory.corners, lap[0], lap[1], lap[2], lap[3])
    return _build_curve(row, loop, segment, values, start, track)


def read_path_course(row: Row) -> Course:
    """Return the quantities of the whole run."""
    offsets_m = row.memory.numbers[_OFFSETS][: len(row.ticks)]
    return _build_course(row, offsets_m, offsets_m[-1], _find_path_heading_error(row))


def _find_path_heading_error(row: Row) -> float:
    """Return the final heading error, with the reference that the law last recorded."""
    samples, count, reference_rad = row.samples, len(row.ticks), math.nan
    column, held_rad = samples.reference_heading_rad, row.memory.numbers[_REFERENCE][:count]
    has_loop = False
    for number in range(len(row.loops)):
        has_loop = has_loop or row.loops[number].signal == HEADING
    if has_loop and _has_any(column):
        reference_rad = hold_column(column, samples.pose_sequence, count, held_rad)[-1]
    return _find_heading_error(row, reference_rad)
