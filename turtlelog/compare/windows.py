"""Questions about stretches of rows, answered for all stretches at once.

A stretch is the rows `first` to `after - 1`; none is empty.
"""

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]
Rows = NDArray[np.int64]


def find_ranges(values: Values, first: Rows, after: Rows) -> tuple[Values, Values]:
    """Return the smallest and the largest value of every stretch, shape of `first`.

    Two stretches of 2^k rows that overlap cover any longer one: only the tables of the k that
    occur are asked, one after another.
    """
    level = np.frexp((after - first).astype(np.float64))[1] - 1
    low, high = values, values
    lowest, highest = np.empty(first.shape), np.empty(first.shape)
    for k in range(int(level.max(initial=-1)) + 1):
        if k:
            half = 1 << (k - 1)
            low = np.minimum(low[:-half], low[half:])
            high = np.maximum(high[:-half], high[half:])
        asked = np.flatnonzero(level == k)
        left, right = first[asked], after[asked] - (1 << k)
        lowest[asked] = np.minimum(low[left], low[right])
        highest[asked] = np.maximum(high[left], high[right])
    return lowest, highest


def find_neighbours(
    values: Values, first: Rows, after: Rows, wanted: Values
) -> tuple[Values, Values]:
    """Return the nearest value at or below, and above `wanted` in every stretch; nan: none.

    A tree of sorted blocks, from rows upwards; each stretch is made of at most two blocks of every
    size, and each block is searched by bisection, all blocks of one size in one call.
    """
    order = np.argsort(values, kind="stable")
    sorted_values = values[order]
    size = 1 << int(len(values) - 1).bit_length()
    ranks = np.full(size, len(values), dtype=np.int64)
    ranks[order] = np.arange(len(values))
    wanted_rank = np.searchsorted(sorted_values, wanted, side="right") - 1
    below = np.full(wanted.shape, -1, dtype=np.int64)
    above = np.full(wanted.shape, len(values), dtype=np.int64)
    first, after, width = first.copy(), after.copy(), 1
    while (first < after).any():
        blocks = _Blocks(ranks, width)
        ends_odd = (first < after) & (after % 2 == 1)
        starts_odd = (first < after) & (first % 2 == 1)
        for asked, block in ((starts_odd, first), (ends_odd, after - 1)):
            found = blocks.search(block[asked], wanted_rank[asked])
            below[asked] = np.maximum(below[asked], found[0])
            above[asked] = np.minimum(above[asked], found[1])
        first, after = (first + 1) // 2, after // 2
        width *= 2
        ranks = np.sort(ranks.reshape(-1, min(width, size)), axis=1, kind="stable").ravel()
    padded = np.concatenate([sorted_values, [np.nan]])
    return padded[below], padded[above]


class _Blocks:
    """Blocks of `width` ranks, each sorted."""

    def __init__(self, ranks: Rows, width: int) -> None:
        self._ranks, self._width, self._most = ranks, width, len(ranks) + 1
        self._keys = ranks + np.arange(len(ranks)) // width * self._most

    def search(self, block: Rows, rank: Rows) -> tuple[Rows, Rows]:
        """Return the largest rank <= `rank` in each block (-1: none) and the smallest above it."""
        start, end = block * self._width, (block + 1) * self._width
        place = np.searchsorted(self._keys, block * self._most + rank, side="right")
        last = len(self._ranks) - 1
        below = np.where(place > start, self._ranks[np.maximum(place - 1, 0)], -1)
        above = np.where(place < end, self._ranks[np.minimum(place, last)], self._most)
        return below, above
