"""The rows of a bag's topics: sorted, without duplicates, finite, on one clock.

A message has its stamp, set by the publisher, and its log time, when the recorder received it. They
differ by the offset of two clocks and the transport delay. Stamps have less jitter, but commands
without stamps have only the recorder's clock. Poses are therefore timed by their stamps, mapped to
the recorder's clock by the messages with the shortest transport delay. This delay is unknown, so
all pose times are late by it.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import describe_count
from turtlelog.errors import LogError
from turtlelog.files.urls import make_path
from turtlelog.log.engine.topic_columns import TopicColumns, iterate_heads, read_some_columns
from turtlelog.log.file_access import name_file, name_place
from turtlelog.log.file_info import RecordingInfo, TopicInfo, merge_topics, read_info
from turtlelog.log.planar_poses import Fields, Values
from turtlelog.log.read_choice import TimeSource
from turtlelog.log.ros2.bag_files import find_bag_files
from turtlelog.log.ros2.set_clocks import ClockStep, find_clock_steps, undo_clock_steps
from turtlelog.log.ros2.stamps import (
    StampClock,
    Stamps,
    TimesNs,
    describe_stamp_clock,
    join_arrays,
    join_stamps,
    place_log_times,
    read_stamp_clock,
)
from turtlelog.run import Clock, Origin

Held = list[dict[str, TopicColumns]]
"""Messages by topic, for each file, in file order."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bag:
    """The files of a bag and their contents, for any storage.

    Attributes:
        path: The folder, or the single file.
        infos: Contents of each file, in order of time.
        steps: Steps of the recorder's clock, which are taken out of all log times that are read.
    """

    path: Path
    infos: Mapping[Path, RecordingInfo]
    steps: tuple[ClockStep, ...] = ()

    @property
    def topics(self) -> Sequence[TopicInfo]:
        """The topics of all files, without duplicates."""
        first, *others = (info.topics for info in self.infos.values())
        return merge_topics(chain(first, *others)) if others else first

    def read(
        self, names: Collection[str], *, is_flat: bool = True
    ) -> tuple[Mapping[str, TopicColumns], ...]:
        """Return the messages of some topics, by topic, for each file; empty topics are omitted.

        Args:
            names: Names of the topics.
            is_flat: Whether to refuse types with sequences of texts or messages.
        """
        held = (
            (file, {*names} & {topic.topic for topic in info.topics if topic.count})
            for file, info in self.infos.items()
        )
        found = tuple(read_some_columns(file, some, is_flat=is_flat) for file, some in held)
        return tuple(self.undo_steps(found))

    @contextmanager
    def name_errors(self) -> Iterator[None]:
        """Add the bag's name to errors, unless an error names one of its files."""
        try:
            with name_file(self.path, expected="a bag"):
                yield
        except LogError as err:
            text = str(err).removeprefix(f"{self.path}: ")
            if not any(text.startswith(f"{file}: ") for file in self.infos):
                raise
            raise LogError(text) from err

    def find_steps(self, found: Sequence[Mapping[str, TopicColumns]], name: str) -> "Bag":
        """Return the bag with the steps of its recorder's clock that a topic in `found` shows."""
        own = [of_file[name] for of_file in found if name in of_file]
        return replace(self, steps=find_clock_steps(own, self._read_heads)) if own else self

    def _read_heads(self, start_ns: int, end_ns: int) -> Iterator[tuple[str, int]]:
        """Yield topic and log time [ns] of all messages in an interval, in order of storage."""
        for file in self.infos:
            yield from iterate_heads(file, start_ns, end_ns)

    def undo_steps(self, found: Sequence[Mapping[str, TopicColumns]]) -> Held:
        """Return messages by topic, for each file, with log times as if no clock was set."""
        undone: Held = [dict(of_file) for of_file in found]
        for name in {name for of_file in found for name in of_file} if self.steps else ():
            holding = [of_file for of_file in undone if name in of_file]
            topic = undo_clock_steps([of_file[name] for of_file in holding], self.steps)
            for of_file, columns in zip(holding, topic, strict=True):
                of_file[name] = columns
        return undone

    def read_topic(self, name: str, *, is_flat: bool = True) -> list[TopicColumns]:
        """Return the messages of a topic, for each file that has some."""
        files = self.read({name}, is_flat=is_flat)
        return [file[name] for file in files if name in file and len(file[name])]


def open_bag(path: str | Path) -> Bag:
    """Return a ROS 2 bag: a folder, or a single file.

    Raises:
        LogError: If the path is not a bag, or one of its files is truncated or damaged.
    """
    path = make_path(path)
    found = find_bag_files(path)
    infos = {file: read_info(file) for file in found.files}
    if found.notes:
        first = found.files[0]
        infos[first] = replace(infos[first], notes={**infos[first].notes, **found.notes})
    for file, info in infos.items():
        if not info.complete:
            is_left = any(topic.count for topic in info.topics)
            fix = "; turtlelog convert --recover reads what is left" if is_left else ""
            lost = info.notes["partial"]
            raise LogError(f"{file}: truncated or unfinished (no end of an MCAP file): {lost}{fix}")
    return Bag(path=path, infos=infos)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OrderedRows:
    """The rows of a topic in order of time.

    Attributes:
        time_ns: Time in the file [ns], shape (n,), not decreasing.
        columns: Columns by name, shape (n,) each.
        late: Number of rows that came after a row with a later time.
        duplicates: Number of exact duplicate rows, which were dropped.
        stamp_ns: Stamp of each row [ns], shape (n,); None if the type has no stamps.
    """

    time_ns: TimesNs
    columns: Mapping[str, Values]
    late: int
    duplicates: int
    stamp_ns: TimesNs | None = None

    @property
    def stamps(self) -> Stamps:
        """Both times of each row."""
        return Stamps(log_ns=self.time_ns, stamp_ns=self.stamp_ns)

    def take(
        self, rows: NDArray[np.int64] | NDArray[np.bool_], time_ns: TimesNs | None = None
    ) -> "OrderedRows":
        """Return some of the rows in any order, with given new times, if any."""
        is_full = rows.dtype != np.bool_ and len(rows) == len(self.time_ns)
        if is_full and (rows[1:] > rows[:-1]).all():  # all rows in order
            return self if time_ns is None else replace(self, time_ns=time_ns)
        return replace(
            self,
            time_ns=self.time_ns[rows] if time_ns is None else time_ns,
            columns={name: column[rows] for name, column in self.columns.items()},
            stamp_ns=None if self.stamp_ns is None else self.stamp_ns[rows],
        )


def order_rows(
    found: Sequence[TopicColumns], tables: Sequence[Mapping[str, Values]]
) -> OrderedRows:
    """Return a topic's rows of all files as one table, sorted by time, without duplicates."""
    time_ns = join_arrays([columns.log_time_ns for columns in found])
    late = int((time_ns < np.maximum.accumulate(time_ns)).sum())
    rows = OrderedRows(
        time_ns=time_ns,
        columns={name: join_arrays([table[name] for table in tables]) for name in tables[0]},
        late=late,
        duplicates=0,
        stamp_ns=join_stamps(found),
    )
    # Equal commands of one burst are not duplicates; their sequence numbers differ.
    others = [
        join_arrays([columns.publish_time_ns for columns in found]),
        join_arrays([columns.sequence for columns in found]),
    ]
    if late:
        order = np.argsort(time_ns, kind="stable")
        rows, others = rows.take(order), [column[order] for column in others]
    others += [] if rows.stamp_ns is None else [rows.stamp_ns]
    twice = _find_duplicates(rows.time_ns, [*others, *rows.columns.values()])
    duplicates = int(twice.sum())
    return replace(rows.take(~twice), duplicates=duplicates) if duplicates else rows


def order_topic(
    found: Held, choice: TopicInfo, extract: Callable[[str, Fields], dict[str, Values]]
) -> OrderedRows:
    """Return the rows of a topic from all files; their messages are removed from `found`."""
    tables = []
    for columns in (of_file[choice.topic] for of_file in found if choice.topic in of_file):
        if columns.type != choice.type:
            raise LogError(f"topic {choice.topic}: expected {choice.type}, found {columns.type}")
        try:
            with name_place(f"topic {choice.topic}"):
                tables.append(extract(choice.type, columns.fields))
        except KeyError as err:
            raise columns.describe_missing(err.args[0]) from err
    return order_rows(
        [of_file.pop(choice.topic) for of_file in found if choice.topic in of_file], tables
    )


def sort_messages(messages: Sequence[TopicColumns]) -> list[tuple[int, int, int]]:
    """Return log time [ns], file and row of every message, in order of time."""
    return sorted(
        (time_ns, number, row)
        for number, columns in enumerate(messages)
        for row, time_ns in enumerate(columns.log_time_ns.tolist())
    )


LARGEST: Final = 1e30
"""Largest plausible value [m, m/s, rad/s]: larger values come from memory that was never set. The
fourth powers of smaller values, and the 32-bit numbers of pictures, are finite."""


def drop_not_finite(rows: OrderedRows, names: Collection[str]) -> tuple[OrderedRows, int]:
    """Return the rows with usable numbers in columns of these names, and the number of others."""
    kept = np.ones(len(rows.time_ns), dtype=np.bool_)
    for name in names:
        kept &= np.abs(rows.columns[name]) <= LARGEST  # nan is not
    if kept.all():
        return rows, 0
    return rows.take(kept), int((~kept).sum())


def add_rows(origin: Origin, tables: Sequence[OrderedRows], start_ns: int) -> Origin:
    """Return an origin with the start of its rows, and the numbers of sorted and dropped ones."""
    return replace(
        origin,
        began_ns=start_ns,
        start_ns=start_ns,
        sorted_rows=sum(rows.late for rows in tables),
        dropped_duplicates=sum(rows.duplicates for rows in tables),
    )


def note_lost(lost: Mapping[str, int], unturned: int = 0) -> dict[str, str]:
    """Return a note on rows without finite numbers, `unturned` of them poses without a heading."""
    counts = [describe_count(count, kind) for kind, count in lost.items() if count]
    without = f", {unturned} of the poses without a heading" if unturned else ""
    return {"dropped_nan": f"{' and '.join(counts)}{without}"} if counts else {}


def _find_duplicates(time_ns: TimesNs, contents: Sequence[NDArray[Any]]) -> NDArray[np.bool_]:
    """Return which rows repeat an earlier row. Only rows of equal time are compared."""
    repeated = np.zeros(len(time_ns), dtype=bool)
    same = np.flatnonzero(np.diff(time_ns) == 0)
    order = np.union1d(same, same + 1)
    # Compared as bits, so that NaN equals NaN; equal rows are adjacent, the earliest first.
    keys = [time_ns, *(column.view(f"u{column.itemsize}") for column in contents)]
    for key in reversed(keys):
        order = order[np.argsort(key[order], kind="stable")]
    equal = np.ones(max(len(order) - 1, 0), dtype=bool)
    for key in keys:
        equal &= np.diff(key[order]) == 0
    repeated[order[1:][equal]] = True
    return repeated


CLOCK: Final = "clock"
"""Name of the note on the clock of a run's poses."""

_CLOSEST_NS: Final = 1_000_000
"""Smallest time between two poses that gives a usable rate [ns]: 0.2 mm of noise become 0.2 m/s."""

_CLOSEST_SHARE: Final = 0.25
"""Share of the usual step below which poses count as close, because a motion capture may run at 2
kHz."""

_SAME_CLOCK_NS: Final = 1_000_000_000
"""Largest time between a stamp of a command and its reception [ns] for stamps of the poses'
simulation. Stamps of another simulation, or of a wall clock, differ by more."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _TimedRows:
    """The rows of a topic in order of the times used.

    Attributes:
        rows: Indices of the given rows, shape (m,).
        time_ns: Time on the recorder's clock [ns], shape (m,), not decreasing.
    """

    rows: NDArray[np.int64]
    time_ns: TimesNs


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BagTimes:
    """Times of the poses and commands of a bag.

    Attributes:
        poses: Times of the poses that are kept.
        commands: Times of all commands.
        clock: Clock that times the poses; None if the poses have no stamps.
        notes: Description of the timing, for the notes of a run.
    """

    poses: _TimedRows
    commands: _TimedRows
    clock: Clock | None = None
    notes: Mapping[str, str] = field(default_factory=dict)


def time_rows(
    poses: Stamps, commands: Stamps | None, time: TimeSource, *, noun: str = "poses"
) -> BagTimes:
    """Return the times of poses and commands on one timeline.

    The timeline is the recorder's clock. If stamps run at another rate, as in simulation, the
    motion follows the stamps: the timeline has the rate of the stamps, and commands are mapped to
    it. Commands with usable stamps are timed by their stamps, like poses.

    Both topics are in order of log time. With `auto`, stamps of poses are used if they are usable.
    In a bag without poses, its commands are given as poses, with this noun. No command is dropped,
    however close in time.
    """
    commands = commands or Stamps(log_ns=np.empty(0, dtype=np.int64))
    if poses.stamp_ns is None:
        if time == "stamp":
            raise LogError(f"time: expected {noun} with stamps, found a type without: take log")
        return BagTimes(poses=_sort(poses.log_ns), commands=_sort(commands.log_ns))
    found = read_stamp_clock(poses)
    if time == "stamp" and found.pace is None:
        raise LogError(f"time: expected usable stamps of {noun}, but {found.reason}: take log")
    used: Literal["log", "stamp"] = "stamp"
    if time == "log" or (time == "auto" and found.reason):
        used = "log"
    rows = _sort(poses.log_ns if used == "log" else found.time_ns)
    commands_ns, how = commands.log_ns, ""
    if used == "stamp" and noun == "poses":
        commands_ns, how = _time_commands(commands, poses, found)
    notes = {CLOCK: f"{noun} are timed by {describe_stamp_clock(found, used)}{how}"}
    if noun == "poses":
        kept = _find_apart(rows.time_ns)
        if close := int(len(kept) - kept.sum()):
            closest = f"{describe_count(close, 'pose')} less than 1 ms before another left out"
            notes |= {CLOCK: f"{notes[CLOCK]}; {closest}", "close_rows": str(close)}
        rows = _TimedRows(rows=rows.rows[kept], time_ns=rows.time_ns[kept])
    offset_s, jitter_s = (
        None if time_ns is None else time_ns / 1e9 for time_ns in (found.offset_ns, found.jitter_ns)
    )
    clock = Clock(used=used, ratio=found.pace, offset_s=offset_s, jitter_s=jitter_s)
    return BagTimes(poses=rows, commands=_sort(commands_ns), clock=clock, notes=notes)


def _time_commands(commands: Stamps, poses: Stamps, found: StampClock) -> tuple[TimesNs, str]:
    """Return the times of commands on the poses' timeline, and a description of their source."""
    if not len(commands.log_ns):
        return commands.log_ns, ""
    own = read_stamp_clock(commands)
    if not found.is_other_pace:
        if own.reason or own.is_other_pace:
            return commands.log_ns, "; commands by the recorder's clock"
        return own.time_ns, "; commands by their stamps, likewise"
    placed_ns = place_log_times(found, poses.log_ns, commands.log_ns)
    if not own.reason and not found.jumps and commands.stamp_ns is not None:
        stamped_ns = commands.stamp_ns + (found.offset_ns or 0)
        if np.abs(stamped_ns - placed_ns).max() < _SAME_CLOCK_NS:
            return stamped_ns, "; commands by their stamps of the same clock"
    return placed_ns, "; commands are mapped to it by the poses that were received with them"


def _find_apart(time_ns: TimesNs) -> NDArray[np.bool_]:
    """Return which rows to keep: the last of several that are too close for a rate."""
    step_ns = np.diff(time_ns)
    moving_ns = step_ns[step_ns > 0]
    if not len(moving_ns):
        return np.ones(len(time_ns), dtype=bool)
    least_ns = min(_CLOSEST_NS, _CLOSEST_SHARE * float(np.median(moving_ns)))
    return np.append(step_ns >= least_ns, True)


def _sort(time_ns: TimesNs) -> _TimedRows:
    rows = np.argsort(time_ns, kind="stable")
    return _TimedRows(rows=rows, time_ns=time_ns[rows])
