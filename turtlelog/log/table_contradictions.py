"""Contradictions within a table: times that start again."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

TimesNs = NDArray[np.int64]

_FAR_BACK: Final = 0.5
"""Largest share of a run's time at which the next run starts. A late row goes back by a few steps,
and a new run to the start."""

_FEWEST_ROWS: Final = 10
"""Smallest number of rows of a run, and of rows within the times of the run above. Rows of several
threads are late by fewer rows."""


def find_runs(time_ns: TimesNs) -> list[slice]:
    """Return the rows of each run in a table whose times start again, in the order of the file.

    Rows that are late, and parts in another order, belong to one run: sorting is right for them.
    """
    starts = [0, *(np.flatnonzero(np.diff(time_ns) < 0) + 1).tolist()]
    found, first = [], 0
    low, high = int(time_ns[0]), int(time_ns[0])
    for start, end in zip(starts, [*starts[1:], len(time_ns)], strict=True):
        part = time_ns[start:end]
        is_far = int(part[0]) <= low + _FAR_BACK * (high - low)
        if is_far and start - first >= _FEWEST_ROWS <= _count_within(part, low, high):
            found.append(slice(first, start))
            first, low, high = start, int(part[0]), int(part[-1])
        low, high = min(low, int(part[0])), max(high, int(part[-1]))
    return [*found, slice(first, len(time_ns))]


def _count_within(part: TimesNs, low: int, high: int) -> int:
    return int(np.searchsorted(part, high, "right") - np.searchsorted(part, low))
