"""A common clock for two runs: time zero is each one's first sample."""

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import CompareError
from turtlelog.measure import Signal
from turtlelog.run import Run


def find_overlap_ns(runs: tuple[Run, ...]) -> tuple[int, int]:
    """Return the stretch that all runs cover, from their first samples [ns].

    Raises:
        CompareError: Where there is none.
    """
    starts = [int(run.poses.time_ns[0]) - run.start_ns for run in runs]
    ends = [run.end_ns - run.start_ns for run in runs]
    # What stands before the first sample is not compared: nothing was controlled yet.
    start_ns, end_ns = max(0, *starts), min(ends)
    if end_ns <= start_ns:
        names = " and ".join(run.name for run in runs)
        raise CompareError(f"{names}: expected runs that overlap from their first samples on")
    return start_ns, end_ns


def resample_signal(
    signal: Signal, start_ns: int, grid_ns: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return the signal on a grid of times from the run's first sample [ns], shape of the grid.

    By line between rows, or by holding the last one, as fits the signal; outside, the ends hold.
    """
    time_ns = signal.time_ns - start_ns
    if signal.kind.resampling == "line":
        values = np.unwrap(signal.values) if signal.kind.compared_as == "angle" else signal.values
        return np.interp(grid_ns, time_ns, values)
    row = np.searchsorted(time_ns, grid_ns, side="right") - 1
    return signal.values[np.maximum(row, 0)]
