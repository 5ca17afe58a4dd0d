"""Times that step: a recorder's clock that was set, by NTP or by hand, and tables of several runs.

A small computer without a battery starts with a wrong date, and NTP sets its clock when the network
is there. Log times and stamps jump together, but the motion goes on as if no time had passed. A
clock that was set back leaves later messages with earlier times.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import describe_count, join_words
from turtlelog.errors import LogError
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.planar_poses import Values, extract_poses
from turtlelog.log.read_choice import CLOCK_SET
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
from turtlelog.run import Run
from turtlelog.run.angles import subtract_headings

_RIM_M: Final = 0.2
"""Distance of a point of the robot from its centre [m]: its way shows turning on the spot, too."""

_SILENT_STEPS: Final = 10.0
"""Shortest silence in usual steps that motion judges; in less, a robot can brake and speed up."""

_TIMED_M: Final = 0.125
_TIMED_RAD: Final = 0.1
"""Largest way and turn between poses that only a source with a rate sends. A localization often
waits until the robot has moved: that of Nav2 for 0.25 m or 0.2 rad, and some for half of it."""

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
        stored: Number of messages in `twice_ns` that are stored before a step back, by topic; empty
            if unknown.
    """

    first_ns: int
    before_ns: int
    after_ns: int
    shift_ns: int
    extra_ns: int
    stored: Mapping[str, int] = field(default_factory=dict)

    @property
    def middle_ns(self) -> float:
        """Border between log times just before the step and just after it [ns]."""
        return self.before_ns + self.shift_ns / 2.0

    @property
    def twice_ns(self) -> tuple[int, int]:
        """First and last log time that may occur on both sides of a step back [ns]."""
        return self.before_ns + self.shift_ns, self.after_ns - self.shift_ns


ReadHeads = Callable[[int, int], Iterable[tuple[str, int]]]
"""Reader of topic and log time [ns] of all messages between two times, in the order of storage."""


def find_clock_steps(files: Sequence[TopicColumns], read_heads: ReadHeads) -> tuple[ClockStep, ...]:
    """Return the steps of the recorder's clock that the poses show, in the order of storage.

    The clock was set back if messages follow in storage with earlier times, unless the path is
    shorter in order of time, as in two recordings in one file. It was set forward if no message has
    a time in a long silence, and the robot was moving before and after, and did not move meanwhile,
    or if the stamps of a wall clock go on without a silence. Poses that may come by way instead of
    time do not show this.

    Args:
        files: The poses, by file. Of commands, only steps back are found.
        read_heads: Reader of the bag, whose other messages may show that time passed.
    """
    log_ns = join_arrays([_restore(columns) for columns in files])
    step_ns = np.diff(log_ns)
    if len(log_ns) <= 2 * JUMP_ROWS:
        return ()
    highest, usual_ns = np.maximum.accumulate(log_ns), int(np.median(np.abs(step_ns)))
    back = np.flatnonzero(step_ns < -find_least_jump(log_ns))
    back = back[(back >= JUMP_ROWS) & (back < len(log_ns) - JUMP_ROWS)]
    back = back[[log_ns[row + 1 :][:JUMP_ROWS].max() < highest[row] for row in back.tolist()]]
    silent, behind = _find_silences(files, log_ns, usual_ns)
    way = _read_way(files) if len(silent) or len(back) else None
    if way is None or not _is_timed(way):
        silent = silent[:0]
    else:
        silent = silent[[_goes_on(way, row) for row in silent.tolist()]]
    count = len(back) + len(silent) + len(behind)
    if not count or count > len(log_ns) / STRETCH_ROWS:
        return ()
    own_ns = frozenset(log_ns.tolist()) if len(silent) else frozenset()
    for row in silent.tolist():
        heads = read_heads(int(highest[row]) + usual_ns, int(log_ns[row + 1]) - usual_ns)
        if any(time_ns not in own_ns for _, time_ns in heads):
            silent = silent[silent != row]
    if len(back) and way is not None and not _is_stored_in_order(way, log_ns, back):
        back = back[:0]
    rows = np.sort(np.concatenate([back, silent, behind]))
    firsts = [0, *(rows + 1).tolist()]
    longest = int(np.argmax(np.diff([*firsts, len(log_ns)])))
    shifts_ns = step_ns[rows] - usual_ns
    extra_ns = np.cumsum(shifts_ns) - shifts_ns[:longest].sum()
    steps = (
        ClockStep(
            first_ns=int(log_ns[first : row + 1].min()),
            before_ns=int(log_ns[row]),
            after_ns=int(log_ns[row + 1]),
            shift_ns=int(shift_ns),
            extra_ns=int(extra),
        )
        for first, row, shift_ns, extra in zip(firsts, rows, shifts_ns, extra_ns, strict=False)
    )
    ends, topic = [*firsts[2:], len(log_ns)], files[0].topic
    return tuple(
        replace(step, stored=_count_stored(topic, step, read_heads))
        if step.shift_ns < 0 and log_ns[row + 1 : end].max() >= step.first_ns
        else step
        for step, row, end in zip(steps, rows.tolist(), ends, strict=False)
    )


def undo_clock_steps(
    files: Sequence[TopicColumns], steps: Sequence[ClockStep]
) -> list[TopicColumns]:
    """Return a topic, by file, with log times as if the clock was never set.

    A topic whose own messages do not step back with the clock is divided by the order in which the
    bag stores its messages and the poses.
    """
    if not steps or not files:
        return list(files)
    log_ns = join_arrays([_restore(columns) for columns in files])
    extra_ns, first = np.full_like(log_ns, steps[0].extra_ns - steps[0].shift_ns), 0
    for step in steps:
        first = _find_first_after(log_ns, first, step, files[0].topic)
        extra_ns[first:] = step.extra_ns
    found, borders = list[TopicColumns](), np.cumsum([len(columns) for columns in files])[:-1]
    for columns, own_ns in zip(files, np.split(log_ns - extra_ns, borders), strict=True):
        order, again = _list_stored(columns), np.argsort(own_ns, kind="stable")
        rows = columns.select(order[again])
        found.append(replace(rows, log_time_ns=own_ns[again], stored=None))
    return found


def note_steps(run: Run, steps: Sequence[ClockStep]) -> Run:
    """Return a run with notes on the steps of the recorder's clock, or on a long silence."""
    if steps:
        notes = {**run.notes, CLOCK_SET: _describe_steps(steps)}
        return replace(run, notes=notes, origin=replace(run.origin, was_clock_set=True))
    silence = _describe_silence(run.poses.time_ns, run.commands.time_ns)
    return replace(run, notes={**run.notes, "silence": silence}) if silence else run


def _describe_silence(*times: TimesNs) -> str:
    """Return a remark on a silence longer than the rest of a bag; empty without one."""
    time_ns = np.sort(np.concatenate(times))
    if len(time_ns) < 2:
        return ""
    step_ns = np.diff(time_ns)
    row = int(step_ns.argmax())
    if step_ns[row] <= _MOST_SILENT * (time_ns[-1] - time_ns[0]):
        return ""
    return (
        f"no pose or command for {_tell_s(step_ns[row] / 1e9)} s from"
        f" {(time_ns[row] - time_ns[0]) / 1e9:.1f} s: the robot sent none, the recording was"
        " interrupted or its clock was set; poses and commands do not show which"
    )


def _describe_steps(steps: Sequence[ClockStep]) -> str:
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


def _read_way(files: Sequence[TopicColumns]) -> Values | None:
    """Return x [m], y [m] and heading [rad] in the order of storage, shape (n, 3).

    The result is None if the messages are not poses that can be read.
    """
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


def _find_silences(
    files: Sequence[TopicColumns], log_ns: TimesNs, usual_ns: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the rows before long silences, and before those in which stamps of a wall clock go on.

    If other stamps go on, the row is in neither array.
    """
    step_ns = np.diff(log_ns)
    silent = np.flatnonzero(step_ns > max(find_least_jump(log_ns), _SILENT_STEPS * usual_ns))
    silent = silent[(silent >= JUMP_ROWS) & (silent < len(log_ns) - 1 - JUMP_ROWS)]
    # After a network or a recorder that stalled, messages that waited come in a burst.
    rows_ns = log_ns[silent + 1 + JUMP_ROWS] - log_ns[silent + 1]
    silent = silent[rows_ns > JUMP_ROWS * usual_ns / 2.0]
    # In a paused simulation, or if only the recorder's clock was set, stamps have no silence.
    is_behind = np.diff(_measure_delays(files, log_ns))[silent] > step_ns[silent] / 2
    return silent[~is_behind], silent[is_behind & _has_wall_clock(files)]


def _measure_steps(way: Values, first: NDArray[np.int64], second: NDArray[np.int64]) -> Values:
    """Return how far a point of the robot moves between rows [m]."""
    moved = way[second] - way[first]
    turned_rad = subtract_headings(way[second, 2], way[first, 2])
    return np.asarray(np.hypot(moved[:, 0], moved[:, 1]) + _RIM_M * np.abs(turned_rad))


def _is_timed(way: Values) -> bool:
    """Return whether some poses follow others closely, so that they do not come by way."""
    moved, turned_rad = np.diff(way[:, :2], axis=0), subtract_headings(way[1:, 2], way[:-1, 2])
    is_small = np.hypot(moved[:, 0], moved[:, 1]) < _TIMED_M
    return int((is_small & (np.abs(turned_rad) < _TIMED_RAD)).sum()) >= JUMP_ROWS


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


def _count_stored(topic: str, step: ClockStep, read_heads: ReadHeads) -> Mapping[str, int]:
    """Return `ClockStep.stored` of a step back that a topic shows."""
    counts, last_ns, (start_ns, end_ns) = Counter[str](), -1, step.twice_ns
    for name, time_ns in read_heads(start_ns, end_ns + 1):
        if name == topic and (last_ns, time_ns) == (step.before_ns, step.after_ns):
            return counts
        last_ns = time_ns if name == topic else last_ns
        counts[name] += last_ns != step.before_ns or time_ns > step.middle_ns
    return {}


def _find_first_after(log_ns: TimesNs, first: int, step: ClockStep, topic: str) -> int:
    """Return the first index after a step, of times in the order of storage.

    Earlier steps are before the index `first`.
    """
    rest_ns = log_ns[first:]
    falls = np.diff(rest_ns)
    is_step = (rest_ns[:-1] > step.middle_ns) & (rest_ns[1:] < step.before_ns) & (falls < 0)
    if step.shift_ns < 0 and is_step.any():
        return first + int(np.where(is_step, falls, 0).argmin()) + 1
    start_ns, end_ns = step.twice_ns
    twice = np.flatnonzero((log_ns >= start_ns) & (log_ns <= end_ns))
    if step.stored and len(twice):
        count = step.stored.get(topic, 0)
        return int(twice[count] if count < len(twice) else twice[-1] + 1)
    early_ns = step.first_ns + step.shift_ns / 2.0
    is_after = (rest_ns > step.before_ns) | (rest_ns < early_ns)
    if step.shift_ns > 0:
        is_after = rest_ns > step.middle_ns
    return first + int(is_after.argmax()) if is_after.any() else len(log_ns)


_FAR_BACK: Final = 0.5
"""Largest share of a run's time at which the next run starts; a late row goes back by few steps."""

_FEWEST_ROWS: Final = 10
"""Smallest number of rows of a run, and of rows within the times of the run above."""


def find_runs(time_ns: NDArray[np.int64]) -> list[slice]:
    """Return the rows of each run in a table whose times start again, in the order of the file.

    Rows that are late, and parts in another order, belong to one run: sorting is right for them.
    """
    starts = np.append(0, np.flatnonzero(np.diff(time_ns) < 0) + 1)
    ends = np.append(starts[1:], len(time_ns))
    columns = (starts, ends, time_ns[starts], time_ns[ends - 1])
    found, first, head = [], 0, None
    low = high = int(time_ns[0])
    for start, end, begin, last in zip(*(column.tolist() for column in columns), strict=True):
        if not begin <= low + _FAR_BACK * (high - low):
            head = None
        elif head is None or start - head >= _FEWEST_ROWS:
            head = start  # late rows may divide the first rows of a run
        if head is not None and head - first >= _FEWEST_ROWS <= end - start:
            part = time_ns[start:end]
            within = np.searchsorted(part, high, "right") - np.searchsorted(part, low)
            if within >= _FEWEST_ROWS:
                found.append(slice(first, head))
                first, low, high = head, int(time_ns[head:start].min(initial=begin)), last
        head = None if end - start >= _FEWEST_ROWS else head
        low, high = min(low, begin), max(high, last)
    return [*found, slice(first, len(time_ns))]


def describe_restart(runs: Sequence[slice], number: int, word: str, lines: Sequence[int]) -> str:
    """Return which run of a table is read, with the `lines` of rows, called by a `word`."""
    rows = runs[number - 1]
    left = sum(run.stop - run.start for run in runs) - (rows.stop - rows.start)
    return (
        f"run {number} of {len(runs)} in the table is read, {word}s"
        f" {lines[rows.start]} to {lines[rows.stop - 1]}; times start again at {word}"
        f" {lines[runs[1].start]}, and {describe_count(left, 'row')} are left out: save each"
        " run to a file of its own"
    )


DAY_NS: Final = 86_400_000_000_000

_MIDNIGHT_NS: Final = 60_000_000_000
"""Longest step over midnight [ns]; a longer one may be a run that starts again."""


def count_midnights(time_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the number of midnights before each time, if they are times of the day, or else 0."""
    counts = np.zeros(len(time_ns), dtype=np.int64)
    if not len(time_ns) or time_ns.min() < 0 or time_ns.max() >= DAY_NS:
        return counts
    steps_ns = np.diff(time_ns)
    is_over = np.abs(np.abs(steps_ns) - DAY_NS) <= _MIDNIGHT_NS
    days = np.where(is_over, -np.sign(steps_ns), 0)  # a late row steps back over midnight
    if not days.any() or days[np.flatnonzero(days)[0]] < 0:
        return counts
    counts[1:] = np.cumsum(days)
    return counts
