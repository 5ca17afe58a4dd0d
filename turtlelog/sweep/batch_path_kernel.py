"""The inputs of metrics in the batch for laws that track a path; see `batch_kernel`.

They are functions of their own, so that laws with a goal take no longer to compile.
"""

import math
from typing import Any, Final, NamedTuple

from numpy import rint

from turtlelog.arithmetic import called, wrap_angle
from turtlelog.measure.response import Track
from turtlelog.run.path_pieces import follow_piece
from turtlelog.sweep.batch_kernel import (
    ALONG,
    CROSS,
    HEADING,
    HEADINGS,
    NO_PHASE,
    NO_REFERENCE,
    TURN_RAD,
    USES_OF_ROW,
    VALUES,
    Course,
    LoopCurve,
    Row,
    build_course,
    build_curve,
    find_stretch,
    find_turn,
    prepare_row,
)

_ARCS, _OFFSETS, _DUES, _REFERENCE = range(USES_OF_ROW, USES_OF_ROW + 4)
USES_OF_PATH: Final = USES_OF_ROW + 4


class PathMemory(NamedTuple):
    """Work arrays as in `Memory`, the path's numbers and pieces, corners and seam as in `Track`."""

    numbers: Any
    rows: Any
    spans: Any
    path: Any
    pieces: Any
    corners: Any
    seam_rad: float


def prepare_path_row(
    facts: Any, ticks: Any, samples: Any, loops: Any, memory: PathMemory
) -> tuple[int, int]:
    """Do as `prepare_row`, and find the place of every pose on the path."""
    start_ns, end_ns = prepare_row(facts, ticks, samples, loops, memory)
    _trace(ticks, samples, memory)
    return start_ns, end_ns


@called
def _trace(ticks: Any, samples: Any, memory: PathMemory) -> None:
    """Enter the arc length of the moving reference, and each pose's arc length and offset."""
    path, pieces = memory.path[0], memory.pieces
    arcs_m, offsets_m = memory.numbers[_ARCS], memory.numbers[_OFFSETS]
    dues_m, held = memory.numbers[_DUES], memory.rows
    is_due = path.has_speed and _find_reference(samples, 0, False) < len(samples)  # noqa: FBT003
    if is_due:
        _hold_samples(samples, held[: len(ticks)], False)  # noqa: FBT003
        arc_m = 0.0
        for row in range(len(ticks)):
            sample = samples[held[row]]
            position = sample.reference_x_m, sample.reference_y_m
            dues_m[row], _, arc_m = follow_piece(path, pieces, arc_m, position, math.nan)
    arc_m = math.nan
    for row in range(len(ticks)):
        due_m = dues_m[row] if is_due else math.nan
        position = ticks[row].x_m, ticks[row].y_m
        arcs_m[row], offsets_m[row], arc_m = follow_piece(path, pieces, arc_m, position, due_m)


def _find_reference(samples: Any, first: int, is_heading: bool) -> int:  # noqa: FBT001
    """Return the first sample from one on with a reference, else the number of samples."""
    row = first
    while row < len(samples):
        sample = samples[row]
        if math.isfinite(sample.reference_heading_rad if is_heading else sample.reference_x_m):
            return row
        row += 1
    return row


@called
def _hold_samples(samples: Any, held: Any, is_heading: bool) -> None:  # noqa: FBT001
    """Enter the sample whose reference is held at each pose; at first, the first such sample."""
    after = _find_reference(samples, 0, is_heading)
    last, read = after, -1
    for row in range(len(held)):
        while after < len(samples) and max(read, samples[after].pose_sequence) <= row:
            last, read = after, max(read, samples[after].pose_sequence)
            after = _find_reference(samples, after + 1, is_heading)
        held[row] = last


def find_path_stretch(row: Row, number: int) -> tuple[int, int, int]:
    """Return the result of `find_stretch`, or that a loop has no reference on the path."""
    first, after, reason = find_stretch(row, number)
    signal = row.loops[number].signal
    has_none = _find_reference(row.samples, 0, signal == HEADING) == len(row.samples)
    is_unknown = signal != CROSS and has_none
    is_unknown = is_unknown or (signal == ALONG and not row.memory.path[0].has_speed)
    return first, after, NO_REFERENCE if is_unknown and reason != NO_PHASE else reason


@called
def read_path_curve(row: Row, number: int, first: int, after: int) -> LoopCurve:
    """Return the curve of a loop between two poses."""
    memory, signal = row.memory, row.loops[number].signal
    values, reference = memory.numbers[VALUES], memory.numbers[_REFERENCE]
    values, reference = values[: after - first], reference[: after - first]
    if signal == HEADING:
        target = _follow_heading(row, first, values, reference)
    else:
        _follow_path(row, first, values, reference, signal == CROSS)
        target = reference[0]
    for place in range(after - first):
        values[place] = target - values[place]
    path = memory.path[0]
    arcs_m, corners = memory.numbers[_ARCS][first:after], memory.corners
    lap = memory.seam_rad, path.length_m, path.is_closed, path.has_speed
    track = Track(reference, arcs_m, corners, lap[0], lap[1], lap[2], lap[3])
    return build_curve(row, number, first, values, target, track)


def _follow_path(row: Row, first: int, error: Any, reference: Any, is_cross: bool) -> None:  # noqa: FBT001
    """Enter the reference across or along the path, and the error."""
    dues_m, arcs_m = row.memory.numbers[_DUES], row.memory.numbers[_ARCS]
    offsets_m = row.memory.numbers[_OFFSETS]
    for place in range(len(error)):
        reference[place] = 0.0 if is_cross else dues_m[first + place]
        at_m = offsets_m[first + place] if is_cross else arcs_m[first + place]
        error[place] = reference[place] - at_m


def _follow_heading(row: Row, first: int, error: Any, reference: Any) -> float:
    """Enter the reference heading and the error, without jumps; return the first reference."""
    memory, turned, turned_error = row.memory, 0.0, 0.0
    heading_rad, held = memory.numbers[HEADINGS], memory.rows[: len(row.ticks)]
    _hold_samples(row.samples, held, True)  # noqa: FBT003
    before = target = row.samples[held[first]].reference_heading_rad
    error_before = 0.0
    for place in range(len(error)):
        wanted = row.samples[held[first + place]].reference_heading_rad
        now = wrap_angle(wanted - heading_rad[first + place])
        error_before = now if place == 0 else error_before
        turned += find_turn(wanted - before)
        turned_error += find_turn(now - error_before)
        reference[place], error[place] = wanted + turned, now + turned_error
        before, error_before = wanted, now
    turns_rad = TURN_RAD * rint(error[-1] / TURN_RAD)
    for place in range(len(error)):
        error[place] -= turns_rad
    return target  # type: ignore[no-any-return]


def read_path_course(row: Row) -> Course:
    """Return the quantities of the whole run."""
    offsets_m = row.memory.numbers[_OFFSETS][: len(row.ticks)]
    return build_course(row, offsets_m, offsets_m[-1], _find_heading_error(row))


def _find_heading_error(row: Row) -> float:
    """Return the final heading error: of a loop of the heading, otherwise the recorded error."""
    samples, held, last = row.samples, row.memory.rows[: len(row.ticks)], len(row.ticks) - 1
    has_loop = False
    for number in range(len(row.loops)):
        has_loop = has_loop or row.loops[number].signal == HEADING
    if has_loop and _find_reference(samples, 0, True) < len(samples):  # noqa: FBT003
        _hold_samples(samples, held, True)  # noqa: FBT003
        wanted_rad = samples[held[last]].reference_heading_rad
        return wrap_angle(wanted_rad - row.memory.numbers[HEADINGS][last])
    for place in range(len(samples)):
        if math.isnan(samples[place].heading_error_rad):
            return math.nan
    return samples[len(samples) - 1].heading_error_rad  # type: ignore[no-any-return]
