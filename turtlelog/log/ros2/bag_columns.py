"""The rows of one topic, put in order."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlelog.log.engine.topic_columns import TopicColumns

Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OrderedRows:
    """OrderedRows in order of time.

    Attributes:
        time_ns: As in the file [ns], shape (n,), not decreasing.
        columns: By name, each of shape (n,).
        late: OrderedRows that stood behind a later one.
        duplicates: OrderedRows that were there twice, to the last bit, and were dropped.
    """

    time_ns: NDArray[np.int64]
    columns: Mapping[str, Values]
    late: int
    duplicates: int


def order_rows(
    found: Sequence[TopicColumns], tables: Sequence[Mapping[str, Values]]
) -> OrderedRows:
    """Return a topic's rows in several files as one table, sorted by time, each row once.

    Args:
        found: The messages of each file.
        tables: The columns that are wanted of them.
    """
    time_ns = np.concatenate([columns.log_time_ns for columns in found])
    columns = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    # Two equal commands of one burst are no duplicates; their numbers differ.
    stamps = [
        np.concatenate([columns.publish_time_ns for columns in found]),
        np.concatenate([columns.sequence for columns in found]),
    ]
    late = int((time_ns < np.maximum.accumulate(time_ns)).sum())
    order = np.argsort(time_ns, kind="stable")
    contents = [column[order] for column in (*stamps, *columns.values())]
    kept = order[~_find_duplicates(time_ns[order], contents)]
    return OrderedRows(
        time_ns=time_ns[kept],
        columns={name: column[kept] for name, column in columns.items()},
        late=late,
        duplicates=len(order) - len(kept),
    )


def separate_times(time_ns: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
    """Return strictly increasing times, and how many had to move: by 1 ns behind the one before.

    OrderedRows of one time are as many ticks; to drop one would lose a step of the motion.
    """
    rows = np.arange(len(time_ns))
    moved = np.maximum.accumulate(time_ns - rows) + rows
    return moved, int((moved != time_ns).sum())


def _find_duplicates(
    time_ns: NDArray[np.int64], contents: Sequence[NDArray[Any]]
) -> NDArray[np.bool_]:
    """Return which rows repeat an earlier one; only rows of one time can."""
    repeated = np.zeros(len(time_ns), dtype=bool)
    same = np.flatnonzero(np.diff(time_ns) == 0)
    seen: set[tuple[int, bytes]] = set()
    for row in np.union1d(same, same + 1).tolist():
        content = int(time_ns[row]), b"".join(column[row].tobytes() for column in contents)
        repeated[row] = content in seen
        seen.add(content)
    return repeated
