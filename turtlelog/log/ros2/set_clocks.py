"""Steps of the recorder's clock: it was set while recording, by NTP or by hand.

A small computer without a battery starts with a wrong date, and NTP sets its clock when the network
is there. Log times and stamps jump together, but the motion goes on as if no time had passed. A
clock that was set back leaves later messages with earlier times.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import join_words
from turtlelog.errors import LogError
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.planar_poses import Values, extract_poses
from turtlelog.log.ros2.stamps import (
    FIRST_WALL_NS,
    JUMP_ROWS,
    JUMP_STEPS,
    STRETCH_ROWS,
    TimesNs,
    find_least_jump,
    join_arrays,
    join_stamps,
)
from turtlelog.run.angles import subtract_headings

CLOCK_SET: Final = "clock_set"
"""Name of the note on steps of the recorder's clock."""

SILENCE: Final = "silence"
"""Name of the note on a silence that lasts most of a bag."""

_RIM_M: Final = 0.2
"""Distance of a point of the robot from its centre [m]: its way shows turning on the spot, too."""

_SILENT_STEPS: Final = 10.0
"""Shortest silence in usual steps that motion judges; in less, a robot can brake and speed up."""

_STRAIGHT: Final = 0.5
"""Smallest displacement over some poses as a share of the way between them: noise alone leads
back."""

_USUAL: Final = 0.95
"""Share of the steps between poses that count as usual."""

_BLOCK_SEAMS: Final = 3
"""Number of steps that change if one block of messages is stored late: before it, after it, and
where it belongs. Times that overlap change one step a message."""

_MOST_SILENT: Final = 0.5
"""Share of the duration from which a silence is mentioned: most of the time is then unknown."""

_MOST_TOLD: Final = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockStep:
    """A step of the recorder's clock.

    Attributes:
        first_ns: First log time since the previous step [ns].
        before_ns: Last log time before this step [ns].
        after_ns: First log time after this step [ns].
        shift_ns: What the clock was set by [ns]; negative if it was set back.
        extra_ns: Time to take out of log times after this step [ns]; 0 in the longest segment.
    """

    first_ns: int
    before_ns: int
    after_ns: int
    shift_ns: int
    extra_ns: int


def find_clock_steps(
    files: Sequence[TopicColumns], others: Sequence[TopicColumns]
) -> tuple[ClockStep, ...]:
    """Return the steps of the recorder's clock that the poses show, in the order of storage.

    The clock was set back if messages follow in storage with earlier times, unless the path is
    shorter in order of time, as in two recordings in one file. It was set forward if no message has
    a time in a long silence, and the robot was moving before and after, and did not move meanwhile,
    or if the stamps of a wall clock go on without a silence. Of commands, only steps back are
    found; other messages show that time passed.
    """
    log_ns = join_arrays([_restore(columns) for columns in files])
    step_ns = np.diff(log_ns)
    if len(log_ns) <= 2 * JUMP_ROWS:
        return ()
    least_ns, usual_ns = find_least_jump(log_ns), float(np.median(np.abs(step_ns)))
    back = np.flatnonzero(step_ns < -least_ns)
    back = back[(back >= JUMP_ROWS) & (back < len(log_ns) - JUMP_ROWS)]
    highest = np.maximum.accumulate(log_ns)
    back = back[[log_ns[row + 1 :][:JUMP_ROWS].max() < highest[row] for row in back.tolist()]]
    silent = np.flatnonzero(step_ns > max(least_ns, _SILENT_STEPS * usual_ns))
    silent = silent[(silent >= JUMP_ROWS) & (silent < len(log_ns) - 1 - JUMP_ROWS)]
    # After a network or a recorder that stalled, messages that waited come in a burst.
    rows_ns = log_ns[silent + 1 + JUMP_ROWS] - log_ns[silent + 1]
    silent = silent[rows_ns > JUMP_ROWS * usual_ns / 2.0]
    # In a paused simulation, or if only the recorder's clock was set, stamps have no silence.
    late_ns = _measure_delays(files, log_ns)
    is_behind = np.diff(late_ns)[silent] > step_ns[silent] / 2
    behind = silent[is_behind & _has_wall_clock(files)]
    silent = silent[~is_behind]
    heard_ns = join_arrays([columns.log_time_ns for columns in others] or [log_ns[:0]])
    for row in silent.tolist():
        inside = (heard_ns > highest[row] + usual_ns) & (heard_ns < log_ns[row + 1] - usual_ns)
        silent = silent[silent != row] if inside.any() else silent
    count = len(back) + len(silent) + len(behind)
    if not count or count > len(log_ns) / STRETCH_ROWS:
        return ()
    way = _read_rim(files)
    silent = silent[[way is not None and _goes_on(way, row) for row in silent.tolist()]]
    if len(back) and way is not None and not _is_stored_in_order(way, log_ns, back):
        back = back[:0]
    rows = np.sort(np.concatenate([back, silent, behind]))
    firsts = [0, *(rows + 1).tolist()]
    longest = int(np.argmax(np.diff([*firsts, len(log_ns)])))
    shifts_ns = np.rint(step_ns[rows] - usual_ns).astype(np.int64)
    extra_ns = np.cumsum(shifts_ns) - shifts_ns[:longest].sum()
    return tuple(
        ClockStep(
            first_ns=int(log_ns[first : row + 1].min()),
            before_ns=int(log_ns[row]),
            after_ns=int(log_ns[row + 1]),
            shift_ns=int(shift_ns),
            extra_ns=int(extra),
        )
        for first, row, shift_ns, extra in zip(firsts, rows, shifts_ns, extra_ns, strict=False)
    )


def undo_clock_steps(
    files: Sequence[TopicColumns], steps: Sequence[ClockStep]
) -> list[TopicColumns]:
    """Return a topic, by file, with log times as if the clock was never set.

    Messages of a topic that does not step back itself count as before the step while their times
    are between those of the poses before it.
    """
    if not steps or not files:
        return list(files)
    log_ns = join_arrays([_restore(columns) for columns in files])
    extra_ns, first = np.full_like(log_ns, steps[0].extra_ns - steps[0].shift_ns), 0
    for step in steps:
        first += _find_first_after(log_ns[first:], step)
        extra_ns[first:] = step.extra_ns
    found, borders = list[TopicColumns](), np.cumsum([len(columns) for columns in files])[:-1]
    for columns, own_ns in zip(files, np.split(log_ns - extra_ns, borders), strict=True):
        order, again = _list_stored(columns), np.argsort(own_ns, kind="stable")
        rows = columns.select(order[again])
        found.append(replace(rows, log_time_ns=own_ns[again], stored=None))
    return found


def describe_silence(*times: TimesNs) -> str:
    """Return a remark on a silence longer than the rest of a bag; empty without one."""
    time_ns = np.sort(np.concatenate(times))
    if len(time_ns) < 2:
        return ""
    step_ns = np.diff(time_ns)
    row = int(step_ns.argmax())
    if step_ns[row] <= _MOST_SILENT * (time_ns[-1] - time_ns[0]):
        return ""
    return (
        f"no message for {_tell_s(step_ns[row] / 1e9)} s from"
        f" {(time_ns[row] - time_ns[0]) / 1e9:.1f} s: either the recording was interrupted or its"
        " clock was set, which the log does not show"
    )


def describe_clock_steps(steps: Sequence[ClockStep]) -> str:
    """Return when and by how much the recorder's clock was set, and how this shows."""
    said, passed_ns = list[str](), 0
    for step in steps[:_MOST_TOLD]:
        at_s = (step.before_ns - passed_ns - steps[0].first_ns) / 1e9
        way = "back" if step.shift_ns < 0 else "forward"
        said.append(f"{way} by {_tell_s(abs(step.shift_ns) / 1e9)} s at {at_s:.1f} s")
        passed_ns += step.shift_ns
    if len(steps) > _MOST_TOLD:
        said.append(f"{len(steps) - _MOST_TOLD} more times")
    shown = {
        "messages are stored in order of arrival": any(step.shift_ns < 0 for step in steps),
        "motion or stamps go on without a break (unless all was suspended)": any(
            step.shift_ns > 0 for step in steps
        ),
    }
    why = join_words([text for text, is_shown in shown.items() if is_shown])
    return f"the recorder's clock was set {join_words(said)}, as {why}; this is taken out"


def _tell_s(seconds: float) -> str:
    return f"{seconds:.2f}" if seconds < 100.0 else f"{seconds:.0f}"


def _restore(columns: TopicColumns) -> TimesNs:
    """Return log times in the order of storage [ns]."""
    log_ns = columns.log_time_ns
    return log_ns if columns.stored is None else log_ns[_list_stored(columns)]


def _list_stored(columns: TopicColumns) -> NDArray[np.int64]:
    """Return the indices of messages in the order of storage."""
    return np.arange(len(columns)) if columns.stored is None else np.argsort(columns.stored)


def _read_rim(files: Sequence[TopicColumns]) -> Values | None:
    """Return x, y [m] and heading times radius [m] as stored, shape (n, 3); None if unreadable."""
    parts = []
    for columns in files:
        try:
            found = extract_poses(columns.type, columns.fields)
        except (KeyError, LogError):
            return None
        part = np.column_stack([found["x"], found["y"], found["heading"]])
        parts.append(part[_list_stored(columns)])
    return np.concatenate(parts)


def _measure_delays(files: Sequence[TopicColumns], log_ns: TimesNs) -> TimesNs:
    """Return log times minus stamps in the order of storage [ns]; 0 without usable stamps."""
    stored = (columns.select(_list_stored(columns)) for columns in files)
    stamp_ns = join_stamps([*stored])
    if stamp_ns is None or (stamp_ns <= 0).any():
        return np.zeros_like(log_ns)
    return log_ns - stamp_ns


def _has_wall_clock(files: Sequence[TopicColumns]) -> bool:
    """Return whether the first stamp is of a wall clock, which no pause of a simulation stops."""
    stamp_ns = join_stamps(files)
    return stamp_ns is not None and int(stamp_ns[0]) >= FIRST_WALL_NS


def _measure_steps(way: Values, first: NDArray[np.int64], second: NDArray[np.int64]) -> Values:
    """Return how far a point of the robot moves between rows [m]."""
    moved = way[second] - way[first]
    turned_rad = subtract_headings(way[second, 2], way[first, 2])
    return np.asarray(np.hypot(moved[:, 0], moved[:, 1]) + _RIM_M * np.abs(turned_rad))


def _goes_on(way: Values, row: int) -> bool:
    """Return whether the motion goes on after a row as if no time had passed."""
    moved_m = []
    for first in (row - JUMP_ROWS, row + 1):
        rows = np.arange(first, first + JUMP_ROWS + 1)
        steps_m = _measure_steps(way, rows[:-1], rows[1:])
        (whole_m,) = _measure_steps(way, rows[:1], rows[-1:])
        if not whole_m > _STRAIGHT * steps_m.sum():
            return False  # at rest, or unknown
        moved_m.append(float(steps_m.mean()))
    (across_m,) = _measure_steps(way, np.array([row]), np.array([row + 1]))
    return bool(across_m < JUMP_STEPS * min(moved_m))


def _is_stored_in_order(way: Values, log_ns: TimesNs, back: NDArray[np.int64]) -> bool:
    """Return whether the order of storage, not that of time, is that of the motion.

    It is not if blocks of messages are only stored late, without overlap or silence in order of
    time, or if the robot jumps where the times step back, and less in order of time.
    """
    order = np.argsort(log_ns, kind="stable")
    is_new = np.diff(order) != 1
    silence_ns = int(np.diff(log_ns[order])[is_new].max())
    if is_new.sum() <= _BLOCK_SEAMS * len(back) and silence_ns < find_least_jump(log_ns):
        return False
    stored_m = _measure_steps(way, np.arange(len(way) - 1), np.arange(1, len(way)))
    known_m, seams_m = stored_m[np.isfinite(stored_m)], stored_m[back]
    if not len(known_m) or not (seams_m > JUMP_STEPS * np.quantile(known_m, _USUAL)).any():
        return True
    sorted_m = _measure_steps(way, order[:-1][is_new], order[1:][is_new])
    return bool(np.nanmedian(seams_m) < np.nanmedian(sorted_m))


def _find_first_after(log_ns: TimesNs, step: ClockStep) -> int:
    """Return the first index after a step, of times in the order of storage."""
    middle_ns = step.before_ns + step.shift_ns / 2.0
    if step.shift_ns > 0:
        is_after = log_ns > middle_ns
        return int(is_after.argmax()) if is_after.any() else len(log_ns)
    falls = np.diff(log_ns)
    is_step = (log_ns[:-1] > middle_ns) & (log_ns[1:] < step.before_ns) & (falls < 0)
    if is_step.any():
        return int(np.where(is_step, falls, 0).argmin()) + 1
    early_ns = step.first_ns + step.shift_ns / 2.0
    is_after = (log_ns > step.before_ns) | (log_ns < early_ns)
    return int(is_after.argmax()) if is_after.any() else len(log_ns)
