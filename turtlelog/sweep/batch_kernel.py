"""Arrays of a row of the batch for the metrics of `measure`: curves of loops, and the course.

The functions are compiled. They read the rows of the loop into work arrays by the rules of
`measure.loop_segment`; fields have the names and, bit for bit, the values of `Response` and
`RunContext`. Laws that track a path have functions of their own, so that laws with a goal take no
longer to compile.
"""

import math
from typing import Any, Final, NamedTuple

from turtlelog.arithmetic import called, wrap_angle
from turtlelog.measure.loop_segment import (
    ALONG,
    BEARING_NOW,
    CROSS,
    GOAL_HEADING,
    HEADING,
    Segment,
    Ticks,
    ends_itself,
    find_bearing,
    find_distance,
    find_last_acting,
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
from turtlelog.measure.metric import Status, add_reason
from turtlelog.measure.reductions import USES
from turtlelog.measure.response import LOST_TURNS, Track
from turtlelog.run.angles import continue_step, explains_step, is_fast_turn
from turtlelog.run.path_pieces import follow_pieces

NO_PHASE: Final = add_reason(Status.NO_PHASE, "the run has no such phase")
_TOO_SHORT: Final = add_reason(Status.TOO_SHORT, "less than two poses in the loop")
_NO_REFERENCE: Final = add_reason(Status.ABSENT, "the reference is not known")
_LOST_TURNS: Final = add_reason(Status.UNDETERMINED, LOST_TURNS)


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
    """Return the reason why a loop has no curve, as in `find_response`; 0 if it has one."""
    loop = row.loops[number]
    if segment.first_sample == segment.after_sample:
        return NO_PHASE
    if loop.reference == GOAL_HEADING and math.isnan(row.aim.goal_heading_rad):
        return _NO_REFERENCE
    if segment.after - segment.first < 2:
        return _TOO_SHORT
    return _LOST_TURNS if loop.signal == HEADING and _loses_turns(row, loop, segment) else 0


def _loses_turns(row: Row, loop: Any, segment: Segment) -> bool:
    period_s, lost = row.facts.period_ns / 1e9, 0
    for place in range(segment.first + 1, segment.after):
        turned_rad = row.ticks[place].turn_rate_rad_s * period_s
        step_rad = row.ticks[place].heading_rad - row.ticks[place - 1].heading_rad
        moves = loop.reference >= BEARING_NOW
        if is_fast_turn(turned_rad) and (moves or not explains_step(step_rad, turned_rad)):
            lost += 1
    return lost > 0


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
    return _build_course(row, none, last_m, _find_heading_error(row))


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
        min(-(-row.start_ns // facts.period_ns), facts.ticks - 1),
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


def _find_heading_error(row: Row) -> float:
    """Return the final heading error, as `get_heading_error`; NaN if it is unknown."""
    aim, known = row.aim, 0
    for number in range(len(row.loops)):
        loop = row.loops[number]
        wanted_rad = read_constant(loop.reference, aim)
        if loop.signal == HEADING and not math.isnan(wanted_rad):
            known |= 1 << number
    acting = find_last_acting(row.samples.phase, row.loops, known)
    wanted_rad = aim.goal_heading_rad
    if acting >= 0 and row.loops[acting].reference != BEARING_NOW:
        wanted_rad = read_constant(row.loops[acting].reference, aim)
    elif acting >= 0 and math.isnan(wanted_rad):
        wanted_rad = _find_bearing(row, len(row.ticks) - 1)
    if math.isnan(wanted_rad):
        return math.nan
    return wrap_angle(wanted_rad - row.memory.numbers[_HEADINGS][len(row.ticks) - 1])


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
    """Return the reason of `find_missing`, or that a loop has no reference on the path."""
    reason, signal = find_missing(row, number, segment), row.loops[number].signal
    is_known = signal == CROSS
    if signal == HEADING:
        is_known = _has_any(row.samples.reference_heading_rad)
    elif signal == ALONG:
        is_known = row.memory.path[0].has_speed and _has_any(row.samples.reference_x_m)
    return reason if is_known or reason == NO_PHASE else _NO_REFERENCE


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
    """Return the final heading error: of a loop of the heading, otherwise the recorded error."""
    samples, numbers, count = row.samples, row.memory.numbers, len(row.ticks)
    column, has_loop = samples.reference_heading_rad, False
    for number in range(len(row.loops)):
        has_loop = has_loop or row.loops[number].signal == HEADING
    if has_loop and _has_any(column):
        held_rad = hold_column(column, samples.pose_sequence, count, numbers[_REFERENCE][:count])
        return wrap_angle(held_rad[-1] - numbers[_HEADINGS][count - 1])
    for place in range(len(samples)):
        if math.isnan(samples[place].heading_error_rad):
            return math.nan
    return samples[len(samples) - 1].heading_error_rad  # type: ignore[no-any-return]
