"""Figures of sampling times, and of the sequence numbers that go with them.

A period is the time from one row to the next, `np.diff(time_s)`, shape (n - 1,). Rows of a burst
share one time: their periods are 0 and count as such, and the silence before a burst is one long
period. So the mean is the length over the count whatever happens in between, the median is what
the loop mostly does, and the percentiles show pause and burst at either end.
"""

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]


def compute_rate(periods_s: Values) -> float | None:
    """Return rows per second over the whole length [Hz]; None where no time passes."""
    length_s = float(periods_s.sum())
    return len(periods_s) / length_s if length_s > 0.0 else None


def compute_spread(periods_s: Values) -> float:
    """Return the standard deviation of the periods around their mean [s]."""
    # From the first period on, so that equal ones leave exactly 0.
    return float((periods_s - periods_s[0]).std())


def compute_jitter(periods_s: Values) -> float | None:
    """Return the root mean square of the change from one period to the next [s].

    The cycle-to-cycle jitter (JEDEC JESD65B), as RMS: unlike the standard deviation it does not see
    a slow drift of the rate. None for less than two periods.
    """
    changes = np.diff(periods_s)
    return float(np.sqrt(np.mean(changes * changes))) if len(changes) else None


def find_percentile(ordered_s: Values, percent: int) -> float:
    """Return the shortest period than which so many percent are no longer [s]; 50: the median.

    Args:
        ordered_s: In rising order, at least one.
        percent: From 1 to 100.
    """
    if percent == 50:
        return float(np.median(ordered_s))
    return float(ordered_s[-(-len(ordered_s) * percent // 100) - 1])


def count_burst_rows(periods_s: Values) -> int:
    """Return how many rows share their time with the row before."""
    return int(np.count_nonzero(periods_s == 0.0))


def count_missing(sequence: NDArray[np.int64]) -> int:
    """Return how many numbers are missing between the first and the last; they increase by 1."""
    return int(sequence[-1] - sequence[0]) + 1 - len(sequence) if len(sequence) else 0
