"""The rows of a bag's topic in order of time: sorted, without duplicates, with finite numbers."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.file_access import name_place
from turtlelog.log.file_info import TopicInfo
from turtlelog.log.ros2.stamps import Stamps, join_arrays, join_stamps
from turtlelog.run.angles import wrap_angle

ROWS_AT_ONCE: Final = 65_536
"""Number of rows that are compared or computed at once."""

Held = list[dict[str, TopicColumns]]
"""Messages by topic, for each file, in file order."""

Fields = Mapping[str, NDArray[Any]]
Values = NDArray[np.float64]


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

    time_ns: NDArray[np.int64]
    columns: Mapping[str, Values]
    late: int
    duplicates: int
    stamp_ns: NDArray[np.int64] | None = None

    @property
    def stamps(self) -> Stamps:
        """Both times of each row."""
        return Stamps(log_ns=self.time_ns, stamp_ns=self.stamp_ns)

    def take(
        self, rows: NDArray[np.int64] | NDArray[np.bool_], time_ns: NDArray[np.int64] | None = None
    ) -> "OrderedRows":
        """Return some of the rows in any order, with given new times, if any."""
        if rows.dtype != np.bool_ and len(rows) == len(self.time_ns) and _is_whole(rows):
            return self if time_ns is None else replace(self, time_ns=time_ns)
        return replace(
            self,
            time_ns=self.time_ns[rows] if time_ns is None else time_ns,
            columns={name: column[rows] for name, column in self.columns.items()},
            stamp_ns=None if self.stamp_ns is None else self.stamp_ns[rows],
        )


def _is_whole(rows: NDArray[Any]) -> bool:
    """Return whether row numbers are those of all rows in order."""
    return all(
        np.array_equal(
            rows[first : first + ROWS_AT_ONCE],
            np.arange(first, min(first + ROWS_AT_ONCE, len(rows))),
        )
        for first in range(0, len(rows), ROWS_AT_ONCE)
    )


def order_rows(
    found: Sequence[TopicColumns], tables: Sequence[Mapping[str, Values]]
) -> OrderedRows:
    """Return a topic's rows in several files as one table, sorted by time, without duplicates.

    The columns of the messages of each file are in `tables`.
    """
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


_LARGEST: Final = 1e30
"""Largest plausible value [m, m/s, rad/s]: larger values come from memory that was never set. The
fourth powers of smaller values, and the 32-bit numbers of pictures, are finite."""


def drop_not_finite(rows: OrderedRows, names: Collection[str]) -> tuple[OrderedRows, int]:
    """Return the rows with usable numbers in columns of these names, and the number of others."""
    kept = np.ones(len(rows.time_ns), dtype=np.bool_)
    for name in names:
        kept &= np.abs(rows.columns[name]) <= _LARGEST  # nan is not
    if kept.all():
        return rows, 0
    return rows.take(kept), int((~kept).sum())


def separate_times(time_ns: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
    """Return strictly increasing times, and how many were moved to 1 ns after the previous time.

    Rows with equal times are different ticks; dropping one would lose a step of the motion.
    """
    rows = np.arange(len(time_ns))
    moved = np.maximum.accumulate(time_ns - rows) + rows
    return moved, int((moved != time_ns).sum())


def wrap_far_headings(heading_rad: Values) -> tuple[Values, int]:
    """Return headings within a float32 step of [-pi, pi), and the number of changed headings.

    turtlesim's own rounding exceeds that interval by less than a step; such headings are kept.
    """
    far = np.abs(heading_rad) > np.nextafter(np.float32(np.pi), np.float32(4.0))
    return np.where(far, wrap_angle(heading_rad), heading_rad), int(far.sum())


def _find_duplicates(
    time_ns: NDArray[np.int64], contents: Sequence[NDArray[Any]]
) -> NDArray[np.bool_]:
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
