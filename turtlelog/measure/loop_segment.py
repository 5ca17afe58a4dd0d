"""The segment of a run in which a loop acts, and rules for its response: one source, compiled too.

A rule for single numbers serves whole columns of one run, and row by row the compiled batch of
`sweep`. What numpy does with a column stands beside the loop that is compiled instead, which writes
into the array `out`. Both return the same bits.

Code without texts knows signals and references by number. `times` are the times of poses: an array
[ns], or in the batch `Ticks`.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy import hypot, maximum, minimum, rint
from numpy.typing import NDArray

from turtlelog.arithmetic import compiled_as, inlined
from turtlelog.measure.reductions import Values, compute_median
from turtlelog.measure.step_response import NEVER, NOBODY_KNOWS
from turtlelog.run.angles import find_turn, wrap_angle
from turtlelog.run.loops import PAUSE, ControlLoop, Declaration
from turtlelog.run.stop_reasons import GoalLine

SIGNALS: Final = ("heading", "along_track", "cross_track", "distance")
GOAL_REFERENCES: Final = ("zero", "goal_bearing", "goal_distance", "goal_heading", "bearing_now")
"""References that the goal alone determines."""

REFERENCES: Final = (*GOAL_REFERENCES, "path", "recorded")
"""References by number: from `bearing_now` on, they move."""

HEADING, ALONG, CROSS, DISTANCE = range(4)
_ZERO, _GOAL_BEARING, _GOAL_DISTANCE, GOAL_HEADING, BEARING_NOW = range(5)

_TURN_RAD: Final = 2.0 * math.pi


class LoopNumbers(NamedTuple):
    """A declared loop in numbers.

    Attributes:
        phases: Phases in which the loop acts, one bit each.
        pause: Bit of the phase `pause`.
        signal: Index into `SIGNALS`.
        reference: Index into `REFERENCES`.
        turns: Whether the command is the turn rate.
    """

    phases: int
    pause: int
    signal: int
    reference: int
    turns: bool


def number_loop(declaration: Declaration, loop: ControlLoop) -> LoopNumbers:
    """Return a loop of a law in numbers."""
    names = declaration.phase_names
    phases = sum(1 << names.index(phase) for phase in declaration.list_phases(loop.name))
    kinds = SIGNALS.index(loop.signal), REFERENCES.index(loop.reference)
    return LoopNumbers(phases, 1 << names.index(PAUSE), *kinds, loop.command == "turn_rate")


class Ticks(NamedTuple):
    """Regular times of poses, from 0: `length` of them from number `first` on."""

    period_ns: int
    first: int
    length: int


def _count_until(times: Ticks, time_ns: int) -> int:
    return min(max(time_ns // times.period_ns + 1 - times.first, 0), times.length)


@compiled_as(_count_until)
def count_until(times: NDArray[np.int64], time_ns: int) -> int:
    """Return the number of poses until a time, inclusive."""
    return int(np.searchsorted(times, time_ns, side="right"))


def find_row_from(times: Any, count: int, time_ns: int) -> int:
    """Return the row of the first of some poses at or after a time, or else the last row."""
    return min(count_until(times, time_ns - 1), count - 1)


def _is_usual_step(times: Ticks, row: int) -> bool:
    return row < times.length


@compiled_as(_is_usual_step)
def _ends_usual_step(times: NDArray[np.int64], row: int) -> bool:
    """Return whether the step to a pose is not much longer than the others; there is no gap."""
    if row == len(times):
        return False
    step_ns = times[row] - times[row - 1]
    return bool(step_ns <= _NEAR * compute_median(times[1:] - times[:-1]))


_NEAR: Final = 1.5
"""Longest usual step between poses, as a multiple of the usual one. In a longer step the robot may
have moved far."""


def _find_first_row(times: Any, start_ns: int) -> int:
    """Return the row of the pose at which a loop begins; between two poses, the earlier row."""
    # A timer reads the earlier pose. If poses before it are lost, the later row is returned.
    after = count_until(times, start_ns - 1)
    is_between = after > 0 and count_until(times, start_ns) == after
    return after - 1 if is_between and _ends_usual_step(times, after) else after


def _find_phase(phase: Any, first: int, phases: int) -> int:
    row = first
    while row < len(phase) and phases >> phase[row] & 1 == 0:
        row += 1
    return row


@compiled_as(_find_phase)
def find_phase(phase: NDArray[np.int64], first: int, phases: int) -> int:
    """Return the first sample from one on in any of some phases; the number of samples if none."""
    rest = phase[first:]
    if not len(rest):
        return first
    found = np.array([phases >> number & 1 for number in range(int(rest.max()) + 1)])[rest]
    row = int(found.argmax())
    return first + (row if found[row] else len(rest))


def _find_last_phase(phase: Any, phases: int) -> int:
    row = len(phase) - 1
    while row >= 0 and phases >> phase[row] & 1 == 0:
        row -= 1
    return row


@compiled_as(_find_last_phase)
def find_last_phase(phase: NDArray[np.int64], phases: int) -> int:
    """Return the last sample in any of some phases; -1 if there is none."""
    return len(phase) - 1 - find_phase(phase[::-1], 0, phases)


class Segment(NamedTuple):
    """First segment of a run in which a loop acts, with the pauses between.

    Attributes:
        first_sample: First sample of the loop; `after_sample`: the sample after its last.
        first: Row of the first pose; `after`: the row after the last.
        start_ns: Time of the first sample [ns].
        end_ns: Time of the next sample of another phase, or the end of the run [ns].
        is_last: Whether the segment lasts to the end of the run.
    """

    first_sample: int
    after_sample: int
    first: int
    after: int
    start_ns: int
    end_ns: int
    is_last: bool


def find_segment(samples: Any, times: Any, loop: Any, run_end_ns: int) -> Segment:
    """Return the segment of a loop; one without samples if the loop never acts."""
    phase, time_ns, count = samples.phase, samples.time_ns, len(samples.phase)
    first = find_phase(phase, 0, loop.phases)
    after = find_phase(phase, first, ~loop.phases)
    end = find_phase(phase, after, ~(loop.phases | loop.pause))
    is_last = end == count
    start_ns = run_end_ns if first == count else int(time_ns[first])
    end_ns = run_end_ns if is_last else int(time_ns[end])
    rows = _find_first_row(times, start_ns), count_until(times, end_ns)
    return Segment(first, after, rows[0], rows[1], start_ns, end_ns, is_last)


def ends_itself(segment: Any, samples: Any, loop: Any, is_done: bool, is_blocked: bool) -> bool:  # noqa: FBT001
    """Return whether the law ended a segment because its work was done.

    `is_done`: the law ended the run so. `is_blocked`: the last command came after its sample.
    """
    in_pause = loop.pause >> samples.phase[-1] & 1 != 0
    return not segment.is_last or is_done or is_blocked or in_pause


def find_last_acting(phase: Any, loops: Any, known: int) -> int:
    """Return the loop that acts, or acted last; the first of `known`, one bit each, if none did."""
    found, latest = -1, -2
    for number in range(len(loops)):
        last = find_last_phase(phase, loops[number].phases)
        if known >> number & 1 != 0 and last > latest:
            found, latest = number, last
    return found


# The response to the reference.


class Aim(NamedTuple):
    """The goal, and the line to it from the start; NaN if unknown.

    Attributes:
        x_m: Start of the line, world frame [m]; likewise `y_m`.
        cos: Cosine of the bearing, from numpy; likewise `sin`.
        length_m: Length of the line [m].
        bearing_rad: Bearing of the goal from the start [rad].
        goal_x_m: Goal, world frame [m]; likewise `goal_y_m`.
        goal_heading_rad: Heading of the goal [rad].
    """

    x_m: float
    y_m: float
    cos: float
    sin: float
    length_m: float
    bearing_rad: float
    goal_x_m: float
    goal_y_m: float
    goal_heading_rad: float


def aim_at(
    line: GoalLine | None, goal_xy_m: tuple[float, float] | None, heading_rad: float | None
) -> Aim:
    """Return a line, a goal and its heading in numbers."""
    (x_m, y_m), bearing_rad, length_m = (math.nan, math.nan), math.nan, None
    if line is not None:
        (x_m, y_m), bearing_rad, length_m = line.start_xy_m, line.bearing_rad, line.length_m
    length_m = math.nan if length_m is None else length_m
    cos, sin = float(np.cos(bearing_rad)), float(np.sin(bearing_rad))
    goal = *(goal_xy_m or (math.nan, math.nan)), math.nan if heading_rad is None else heading_rad
    return Aim(x_m, y_m, cos, sin, length_m, bearing_rad, *goal)


def read_constant(reference: int, aim: Any) -> float:
    """Return a reference that does not move [rad or m]; NaN if it is unknown."""
    wanted: float = 0.0
    if reference == _GOAL_BEARING:
        wanted = aim.bearing_rad
    elif reference == _GOAL_DISTANCE:
        wanted = aim.length_m
    elif reference == GOAL_HEADING:
        wanted = aim.goal_heading_rad
    return wanted


def find_bearing(x_m: float, y_m: float, goal_x_m: float, goal_y_m: float) -> float:
    """Return the bearing of the goal from a position [rad]."""
    # Not numpy's `arctan2`, whose last bit differs from the C library's on processors with AVX-512:
    # compiled code calls the C library.
    return math.atan2(goal_y_m - y_m, goal_x_m - x_m)


def find_distance(x_m: Any, y_m: Any, goal_x_m: float, goal_y_m: float) -> Any:
    """Return the distance of positions to the goal [m]."""
    return hypot(goal_x_m - x_m, goal_y_m - y_m)


def project(x_m: Any, y_m: Any, line: Any, is_along: bool) -> Any:  # noqa: FBT001
    """Return the coordinate of positions along, or left of, the line from start to goal [m]."""
    x_m, y_m = x_m - line.x_m, y_m - line.y_m
    return x_m * line.cos + y_m * line.sin if is_along else y_m * line.cos - x_m * line.sin


def turn_towards(value: float, measured: float, is_angle: bool) -> float:  # noqa: FBT001
    """Return a heading shifted by full turns towards the measured heading, which has no jumps."""
    if not is_angle:
        return value
    return float(value + rint((measured - value) / _TURN_RAD) * 2.0 * math.pi)


def _unwrap(angle_rad: Any) -> Any:
    turned = 0.0
    before = angle_rad[0]
    for row in range(1, len(angle_rad)):
        now = angle_rad[row]
        turned += find_turn(now - before)
        angle_rad[row] = now + turned
        before = now
    return angle_rad


@compiled_as(_unwrap)
def unwrap(angle_rad: Values) -> Values:
    """Return angles without jumps [rad]; compiled, in the same array."""
    return np.unwrap(angle_rad)


@inlined
def _follow_error(error_rad: Any) -> Any:
    for row in range(len(error_rad)):
        error_rad[row] = wrap_angle(error_rad[row])
    error_rad = unwrap(error_rad)
    turns_rad = _TURN_RAD * rint(error_rad[-1] / _TURN_RAD)
    for row in range(len(error_rad)):
        error_rad[row] -= turns_rad
    return error_rad


@compiled_as(_follow_error)
def follow_error(error_rad: Values) -> Values:
    """Return the error of a heading without jumps, at the end within half a turn [rad]."""
    error_rad = np.unwrap(wrap_angle(error_rad))
    return np.asarray(error_rad - _TURN_RAD * rint(error_rad[-1] / _TURN_RAD))


def _subtract_from(value: float, column: Any, out: Any) -> Any:
    for row in range(len(column)):
        out[row] = value - column[row]
    return out


@compiled_as(_subtract_from)
def subtract_from(value: float, column: Values, out: Any) -> Values:  # noqa: ARG001
    """Return a value minus each number of a column; compiled, in `out`."""
    return np.asarray(value - column)


@inlined
def refer_to_start(error: Any, first: float, is_angle: bool, out: Any) -> Any:  # noqa: FBT001
    """Return the first value of a moving reference minus its error: the values of a response."""
    return subtract_from(first, follow_error(error) if is_angle else error, out)


def _hold_column(column: Any, read: Any, count: int, out: Any) -> Any:
    after, latest = 0, -1
    while not math.isfinite(column[after]):
        after += 1
    last = after
    for row in range(count):
        while after < len(column) and max(latest, read[after]) <= row:
            last, latest, after = after, max(latest, read[after]), after + 1
            while after < len(column) and not math.isfinite(column[after]):
                after += 1
        out[row] = column[last]
    return out


@compiled_as(_hold_column)
def hold_column(column: Values, read: NDArray[np.int64], count: int, out: Any) -> Values:  # noqa: ARG001
    """Return recorded references, held at each of `count` poses until a sample reads a later one.

    Args:
        column: Values of samples, shape (m,) or (m, 2), some of them finite.
        read: Pose that each sample read.
        count: Number of poses.
        out: Array for the result of compiled code.
    """
    rows = np.flatnonzero(np.isfinite(column if column.ndim == 1 else column[:, 0]))
    return np.asarray(column[rows[find_latest(read[rows], count)]])


def find_latest(read: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Return the last sample that read each pose or an earlier pose, or else the first."""
    latest = np.searchsorted(np.maximum.accumulate(read), np.arange(count), side="right") - 1
    return np.asarray(np.maximum(latest, 0))


def tell_pose_time(pose_ns: Any, start_ns: int) -> Any:
    """Return the time of poses from the start of a segment [s]; 0 before it."""
    return maximum(pose_ns - start_ns, 0) / 1e9


def tell_publication(time_ns: Any, end_ns: int, start_ns: int) -> Any:
    """Return the time of commands of a segment from the start of the run [s]."""
    return (minimum(time_ns, end_ns) - start_ns) / 1e9


def count_answered(curve: Any) -> int:
    """Return the number of poses up to the last answered one: the loop causes no later motion."""
    return count_until(curve.pose_ns, curve.commands.answered_ns[-1])


def _find_last_beyond(values: Any, limit: float) -> int:
    row = len(values) - 1
    while row >= 0 and abs(values[row]) < limit:
        row -= 1
    return row


@compiled_as(_find_last_beyond)
def find_last_beyond(values: Values, limit: float) -> int:
    """Return the last row of a magnitude at or beyond a limit; -1 if there is none."""
    is_beyond = np.abs(values[::-1]) >= limit
    row = int(is_beyond.argmax())
    return len(values) - 1 - row if is_beyond[row] else -1


def find_clipped(curve: Any) -> int:
    """Return the last pose after which no command was at its limit, for `judge_swings`."""
    if math.isnan(curve.limit):
        return NOBODY_KNOWS
    last = find_last_beyond(curve.commands.values, curve.limit)
    if last < 0:
        return NEVER
    return count_until(curve.pose_ns, curve.commands.answered_ns[last]) - 1
