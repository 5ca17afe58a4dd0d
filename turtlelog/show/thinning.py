"""Fewer points that draw the same: what a picture cannot resolve is left out, extremes never."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

MOST_POINTS: Final = 20_000
"""How many points of a curve are drawn; a page 7 inches wide at 600 dpi has 4,300 columns."""


def choose_rows(values: NDArray[np.float64], most: int = MOST_POINTS) -> NDArray[np.int64] | None:
    """Return the rows of a curve to draw, None where all of them are few enough.

    The rows are split into equal stretches; of each the first row and the rows of the least and
    the greatest value of every column stay, and the very last row. NaN is neither.

    Args:
        values: Shape (n,) or (n, columns).
        most: About how many rows may stay.
    """
    columns = values.reshape(len(values), -1)
    if len(columns) <= most:
        return None
    stretches = max(1, most // (2 * columns.shape[1] + 1))
    length = -(-len(columns) // stretches)
    kept = [np.arange(0, len(columns), length), np.array([len(columns) - 1])]
    for column in columns.T:
        kept += _find_extremes(column, length)
    return np.unique(np.concatenate(kept))


def _find_extremes(column: NDArray[np.float64], length: int) -> list[NDArray[np.int64]]:
    """Return the first row of the least and of the greatest value in each stretch of a length."""
    is_nan = np.isnan(column)
    has_nan = bool(is_nan.any())
    low = np.where(is_nan, np.inf, column) if has_nan else column
    high = np.where(is_nan, -np.inf, column) if has_nan else column
    whole = len(column) // length * length
    starts = np.arange(0, len(column), length)
    found = []
    for values, find in ((low, np.argmin), (high, np.argmax)):
        rows = find(values[:whole].reshape(-1, length), axis=1)
        last = [find(values[whole:])] if whole < len(column) else []
        found.append(starts + np.append(rows, last).astype(np.int64))
    return found
