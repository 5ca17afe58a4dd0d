"""Fewer points that draw the same: what a picture cannot resolve is left out, extremes never."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

MOST_POINTS: Final = 20_000
"""How many points of a curve are drawn; a page 7 inches wide at 600 dpi has 4,300 columns."""


def choose_rows(values: NDArray[np.float64], most: int = MOST_POINTS) -> NDArray[np.int64] | None:
    """Return the rows of a curve to draw, None where all of them are few enough.

    The rows are split into equal stretches; of each the first row and the rows of the least and
    the greatest value of every column stay, and the very last row.

    Args:
        values: Shape (n,) or (n, columns).
        most: About how many rows may stay.
    """
    columns = values.reshape(len(values), -1)
    if len(columns) <= most:
        return None
    stretches = max(1, most // (2 * columns.shape[1] + 1))
    starts = np.linspace(0, len(columns), stretches, endpoint=False).astype(np.int64)
    kept = [starts, np.array([len(columns) - 1])]
    for column in columns.T:
        kept += _find_extremes(column, starts)
    return np.unique(np.concatenate(kept))


def _find_extremes(
    column: NDArray[np.float64], starts: NDArray[np.int64]
) -> list[NDArray[np.int64]]:
    """Return the first row of the least and of the greatest value in each stretch."""
    lengths = np.diff(starts, append=len(column))
    found = []
    for extremes in (np.minimum.reduceat(column, starts), np.maximum.reduceat(column, starts)):
        hits = np.flatnonzero(column == np.repeat(extremes, lengths))
        stretch = np.searchsorted(starts, hits, side="right") - 1
        _, first = np.unique(stretch, return_index=True)
        found.append(hits[first])
    return found
