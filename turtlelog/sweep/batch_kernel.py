"""Inputs of metrics in the batch: the curve of each loop, and quantities of the whole run.

The functions are compiled, like the metric functions of `measure` that they call. Fields have the
names and, bit for bit, the values of `Response` and `RunContext`. The line from start to goal is an
input because numpy computes its cosine, as for single runs.
"""

import math
from typing import Any, Final, NamedTuple

from numpy import arctan2, fmod, hypot, rint

from turtlelog.arithmetic import called, wrap_angle
from turtlelog.measure.metric import Status, add_reason
from turtlelog.measure.reductions import USES
from turtlelog.measure.response import LOST_TURNS
from turtlelog.run.angles import EXPLAINED_RAD

NO_PHASE: Final = add_reason(Status.NO_PHASE, "the run has no such phase")
_TOO_SHORT: Final = add_reason(Status.TOO_SHORT, "less than two poses in the loop")
NO_REFERENCE: Final = add_reason(Status.ABSENT, "the reference is not known")
_LOST_TURNS: Final = add_reason(Status.UNDETERMINED, LOST_TURNS)
_NO_SAMPLES: Final = -1

SIGNALS: Final = ("heading", "along_track", "cross_track", "distance")
PATH: Final = "path"
REFERENCES: Final = ("zero", "goal_bearing", "goal_distance", "goal_heading", "bearing_now", PATH)
"""References and signals of loops, by number; references from `bearing_now` on move."""
HEADING, ALONG, CROSS, _DISTANCE = range(4)
_ZERO, _GOAL_BEARING, _GOAL_DISTANCE, _GOAL_HEADING, _BEARING_NOW = range(5)

TURN_RAD: Final = 2.0 * math.pi


class Memory(NamedTuple):
    """Work arrays for the largest number of poses or samples, filled again for every row."""

    numbers: Any  # one row per use: first the rows of `reductions`, then those named here
    rows: Any  # row numbers
    spans: Any  # A `SPAN` for each loop


HEADINGS, VALUES, _ERROR, _TIMES, _STEPS, _COMMAND_TIMES, _COMMANDS = range(USES, USES + 7)
USES_OF_ROW: Final = USES + 7


class Commands(NamedTuple):
    """Commands of a loop, with the fields of `CommandStretch`."""

    time_s: Any
    values: Any


class LoopCurve(NamedTuple):
    """Curve of a loop, with the fields of `Response`."""

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
    answered: int
    clipped: int
    limit: float
    commands: Commands
    memory: Memory
    track: Any


class Course(NamedTuple):
    """Quantities of a run, with the fields of `RunContext`."""

    x_m: Any
    y_m: Any
    samples: Any
    goal: tuple[float, float, float]
    line: tuple[float, float, float, float]
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
    memory: Memory
    offset_m: Any


class Row(NamedTuple):
    """Inputs of the measurement of a row, with start and end of the run [ns]."""

    facts: Any
    ticks: Any
    samples: Any
    line: Any
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


def prepare_row(facts: Any, ticks: Any, samples: Any, loops: Any, memory: Any) -> tuple[int, int]:
    """Unwrap the headings, find the samples of loops, and return start and end of the run [ns]."""
    end_ns = max((facts.ticks - 1) * facts.period_ns, samples[-1].time_ns)
    if facts.published > 0:
        end_ns = max(end_ns, samples[facts.published - 1].published_ns)
    _unwrap(ticks, facts.period_ns, memory.numbers[HEADINGS])
    _find_spans(samples, loops, memory.spans)
    return samples[0].time_ns, end_ns


def _unwrap(ticks: Any, period_ns: int, heading_rad: Any) -> None:
    """Unwrap the heading, as `unwrap_headings` does."""
    turned = 0.0
    before = heading_rad[0] = ticks[0].heading_rad
    for row in range(1, len(ticks)):
        now = ticks[row].heading_rad
        full_rad = _find_full_turns(now - before, ticks[row].turn_rate_rad_s * (period_ns / 1e9))
        turned += find_turn(now - before) if math.isnan(full_rad) else full_rad
        heading_rad[row] = now + turned
        before = now


def _find_full_turns(step_rad: float, turned_rad: float) -> float:
    """Return the full turns that a turn adds to a step of the heading [rad].

    The result is NaN if the turn is at most half a turn, or does not explain the step.
    """
    if abs(turned_rad) <= math.pi:
        return math.nan
    full_rad: float = TURN_RAD * rint((turned_rad - step_rad) / TURN_RAD)
    return full_rad if abs(turned_rad - step_rad - full_rad) <= EXPLAINED_RAD else math.nan


def _loses_turns(row: Row, moves: bool, first: int, after: int) -> bool:  # noqa: FBT001
    """Return whether full turns between poses are lost, as in `find_response`."""
    period_s, lost = row.facts.period_ns / 1e9, 0
    for place in range(first + 1, after):
        turned_rad = row.ticks[place].turn_rate_rad_s * period_s
        step_rad = row.ticks[place].heading_rad - row.ticks[place - 1].heading_rad
        is_lost = moves or math.isnan(_find_full_turns(step_rad, turned_rad))
        if is_lost and abs(turned_rad) > math.pi:
            lost += 1
    return lost > 0


def find_turn(step_rad: float) -> float:
    """Return the angle that numpy's unwrap adds from a step on."""
    if abs(step_rad) <= math.pi:
        return 0.0
    rest: float = fmod(step_rad + math.pi, TURN_RAD)
    if rest < 0.0:
        rest += TURN_RAD
    return rest - math.pi - step_rad


def _find_spans(samples: Any, loops: Any, spans: Any) -> None:
    """Find the samples of each loop's first segment, and the last sample of each loop."""
    for number in range(len(loops)):
        spans[number].first = spans[number].after = spans[number].last = _NO_SAMPLES
        spans[number].end = len(samples)
    begin, count = 0, len(samples)
    while begin < count:
        phase, after = samples[begin].phase, begin + 1
        while after < count and samples[after].phase == phase:
            after += 1
        for number in range(len(loops)):
            _add_samples(loops[number], spans[number], phase, begin, after)
        begin = after


def _add_samples(loop: Any, span: Any, phase: int, begin: int, after: int) -> None:
    """Add one phase's samples; a segment includes a pause, and ends at the next other phase."""
    if loop.phases >> phase & 1 != 0:
        if span.first < 0:
            span.first = begin
        if span.after < 0 or span.after == begin:
            span.after = after
        span.last = after - 1
    elif span.first >= 0 and begin < span.end and phase != loop.pause:
        span.end = begin


def find_stretch(row: Row, number: int) -> tuple[int, int, int]:
    """Return a loop's first pose, the pose after its last, and the reason for no curve, or 0."""
    facts, span, period_ns = row.facts, row.memory.spans[number], row.facts.period_ns
    if span.first < 0:
        return 0, 0, NO_PHASE
    start_ns = row.samples[span.first].time_ns
    pose = -(-start_ns // period_ns)
    if 0 < pose < facts.ticks and pose * period_ns != start_ns:
        pose -= 1
    first, after = min(pose, facts.ticks), min(_end_ns(row, span) // period_ns + 1, facts.ticks)
    loop = row.loops[number]
    if loop.reference == _GOAL_HEADING and math.isnan(row.line.goal_heading_rad):
        return first, after, NO_REFERENCE
    if after - first < 2:
        return first, after, _TOO_SHORT
    moves = loop.reference >= _BEARING_NOW
    if loop.signal == HEADING and _loses_turns(row, moves, first, after):
        return first, after, _LOST_TURNS
    return first, after, 0


def _end_ns(row: Row, span: Any) -> int:
    goes_on = span.end < len(row.samples)
    return row.samples[span.end].time_ns if goes_on else row.end_ns


@called
def read_loop_curve(row: Row, number: int, first: int, after: int) -> LoopCurve:
    """Return the curve of a loop between two poses."""
    loop = row.loops[number]
    values = _read_values(row, loop, first, after)
    reference = _read_target(row, loop, first, values)
    return build_curve(row, number, first, values, reference, 0)


def build_curve(
    row: Row, number: int, first: int, values: Any, reference: float, track: Any
) -> LoopCurve:
    """Return the curve of a loop from its values, which begin at a pose, and its reference."""
    facts, memory, samples, loop = row.facts, row.memory, row.samples, row.loops[number]
    span, count, period_ns = memory.spans[number], len(values), facts.period_ns
    start_ns, end_ns, after = samples[span.first].time_ns, _end_ns(row, span), first + len(values)
    error, time_s = memory.numbers[_ERROR][:count], memory.numbers[_TIMES][:count]
    step_s = memory.numbers[_STEPS][: count - 1]
    for place in range(count):
        error[place] = reference - values[place]
        time_s[place] = max((first + place) * period_ns - start_ns, 0) / 1e9
    for place in range(count - 1):
        step_s[place] = time_s[place + 1] - time_s[place]
    in_pause = span.end < len(samples) or samples[-1].phase == loop.pause
    ended_itself = not (facts.is_cut or facts.is_late) or end_ns < row.end_ns
    ended_itself = ended_itself or in_pause or _ends_blocked(row)
    limit = facts.turn_limit if loop.turns else facts.speed_limit
    commands = _read_commands(row, loop, span, end_ns)
    answered = min(samples[span.after - 1].time_ns // period_ns + 1, after) - first
    clipped = len(commands.values) - 1
    while clipped >= 0 and abs(commands.values[clipped]) < limit:
        clipped -= 1
    if clipped >= 0:
        pose = min(samples[span.first + clipped].time_ns // period_ns, after - 1)
        clipped = max(pose - first, -1)
    return LoopCurve(
        time_s,
        step_s,
        values,
        error,
        values[0],
        reference,
        row.line.band,
        (start_ns - row.start_ns) / 1e9,
        ended_itself,
        facts.is_cut and end_ns == row.end_ns,
        loop.signal == HEADING,
        answered,
        clipped,
        limit,
        commands,
        memory,
        track,
    )


def _ends_blocked(row: Row) -> bool:
    """Whether the last sample's command was published after the sample's time, or never."""
    last_ns, published = row.samples[-1].time_ns, row.facts.published
    if published < len(row.samples):
        return row.end_ns > last_ns  # type: ignore[no-any-return]
    return row.samples[published - 1].published_ns > last_ns  # type: ignore[no-any-return]


def _read_commands(row: Row, loop: Any, span: Any, end_ns: int) -> Commands:
    count, samples = span.after - span.first, row.samples
    values = row.memory.numbers[_COMMANDS][:count]
    time_s = row.memory.numbers[_COMMAND_TIMES][:count]
    is_out = row.facts.published == len(samples)
    for place in range(count):
        sample = samples[span.first + place]
        values[place] = sample.turn_rate_rad_s if loop.turns else sample.speed_m_s
        at_ns = sample.published_ns if is_out else sample.time_ns
        time_s[place] = (min(at_ns, end_ns) - row.start_ns) / 1e9
    return Commands(time_s, values)


def _read_values(row: Row, loop: Any, first: int, after: int) -> Any:
    """Return the signal of a loop at poses. A moving goal bearing is treated as fixed."""
    memory, ticks, line = row.memory, row.ticks, row.line
    if loop.signal == HEADING and loop.reference != _BEARING_NOW:
        return memory.numbers[HEADINGS][first:after]
    values = memory.numbers[VALUES][: after - first]
    if loop.signal == HEADING:
        _follow_bearing(row, first, values)
        return values
    for place in range(after - first):
        tick = ticks[first + place]
        if loop.signal == _DISTANCE:
            values[place] = hypot(line.goal_x_m - tick.x_m, line.goal_y_m - tick.y_m)
        else:
            x_m, y_m = tick.x_m - line.x_m, tick.y_m - line.y_m
            along = loop.signal == ALONG
            values[place] = (
                x_m * line.cos + y_m * line.sin if along else y_m * line.cos - x_m * line.sin
            )
    return values


def _find_bearing(row: Row, place: int) -> float:
    """Return the bearing of the goal from a pose [rad]."""
    tick, line = row.ticks[place], row.line
    return arctan2(line.goal_y_m - tick.y_m, line.goal_x_m - tick.x_m)  # type: ignore[no-any-return]


def _follow_bearing(row: Row, first: int, values: Any) -> None:
    """Enter the heading as if the goal bearing kept its first value."""
    heading_rad, turned = row.memory.numbers[HEADINGS], 0.0
    before = wrap_angle(_find_bearing(row, first) - heading_rad[first])
    values[0] = before
    for place in range(1, len(values)):
        now = wrap_angle(_find_bearing(row, first + place) - heading_rad[first + place])
        turned += find_turn(now - before)
        values[place] = now + turned
        before = now
    turns_rad = TURN_RAD * rint(values[-1] / TURN_RAD)
    target_rad = _find_bearing(row, first)
    for place in range(len(values)):
        values[place] = target_rad - (values[place] - turns_rad)


def _read_target(row: Row, loop: Any, first: int, values: Any) -> float:
    """Return the target value of a curve; a heading's gets the full turns of the last value."""
    if loop.reference == _BEARING_NOW:
        return _find_bearing(row, first)
    wanted = _read_constant(row, loop)
    if loop.signal != HEADING:
        return wanted
    return wanted + rint((values[-1] - wanted) / TURN_RAD) * 2.0 * math.pi  # type: ignore[no-any-return]


def _read_constant(row: Row, loop: Any) -> float:
    line, wanted = row.line, 0.0
    if loop.reference == _GOAL_BEARING:
        wanted = line.bearing_rad
    elif loop.reference == _GOAL_DISTANCE:
        wanted = line.length_m
    elif loop.reference == _GOAL_HEADING:
        wanted = line.goal_heading_rad
    return wanted


def read_course(row: Row) -> Course:
    """Return the quantities of the whole run."""
    last, line = row.ticks[-1], row.line
    x_m, y_m = last.x_m - line.x_m, last.y_m - line.y_m
    none, offset_m = row.memory.numbers[HEADINGS][:0], y_m * line.cos - x_m * line.sin
    return build_course(row, none, offset_m, _find_heading_error(row))


def build_course(row: Row, offset_m: Any, last_m: float, heading_error_rad: float) -> Course:
    """Return the quantities of the whole run.

    `offset_m` is the offset of every pose from the path; empty for the line from start to goal.
    `last_m` is the offset of the last pose from either, `heading_error_rad` the error at the end.
    """
    facts, ticks, line = row.facts, row.ticks, row.line
    last = ticks[-1]
    return Course(
        ticks.x_m,
        ticks.y_m,
        row.samples,
        (line.goal_x_m, line.goal_y_m, line.goal_heading_rad),
        (line.x_m, line.y_m, line.cos, line.sin),
        row.start_ns,
        facts.period_ns,
        min(-(-row.start_ns // facts.period_ns), facts.ticks - 1),
        len(row.samples),
        (row.end_ns - row.start_ns) / 1e9,
        ((facts.ticks - 1) * facts.period_ns - row.start_ns) / 1e9,
        last.heading_rad,
        last_m,
        heading_error_rad,
        False,  # noqa: FBT003
        row.memory,
        offset_m,
    )


def _find_heading_error(row: Row) -> float:
    """Return the final heading error: reference of the last active heading loop minus heading.

    If no heading loop acted, the first declared heading loop is used. The goal's heading replaces
    a bearing from the present position, and a loop that is missing.
    """
    acting, spans = -1, row.memory.spans
    for number in range(len(row.loops)):
        loop = row.loops[number]
        is_known = loop.reference != _GOAL_HEADING or not math.isnan(row.line.goal_heading_rad)
        if loop.signal == HEADING and is_known:
            acting = number if acting < 0 or spans[number].last > spans[acting].last else acting
    last, wanted_rad = len(row.ticks) - 1, row.line.goal_heading_rad
    if acting >= 0 and row.loops[acting].reference != _BEARING_NOW:
        wanted_rad = _read_constant(row, row.loops[acting])
    elif acting >= 0 and math.isnan(wanted_rad):
        wanted_rad = _find_bearing(row, last)
    if math.isnan(wanted_rad):
        return math.nan
    return wrap_angle(wanted_rad - row.memory.numbers[HEADINGS][last])
