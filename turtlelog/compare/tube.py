"""How far a run's values are from the nearest value that the reference takes close in time.

At time t, with a tolerance d in time, the values that count are those that the reference takes in
[t - d, t + d], as a function of time: a signal that is read by line takes every value between the
least and the greatest of them; one that is held takes those of its rows in the window and the one
held at the window's start. A value passes if it is within max(abs, rel |reference|) of any of them.
As rel <= 1, that half-width grows no faster than the distance: the nearest value below and the
nearest above decide.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from turtlelog.angles import wrap_angle
from turtlelog.compare.tolerances import Tolerance
from turtlelog.compare.windows import find_neighbours, find_ranges
from turtlelog.measure import Signal

Values = NDArray[np.float64]
Times = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Grid:
    """Where a run is compared: its rows, and the times of the reference's rows between them.

    Without the latter a run with few rows would be compared in few places only.

    Attributes:
        at: Units of the clock, shape (n,), not decreasing.
        run_row: The run's row that holds there, shape (n,); before its first one, that.
        later: How many further rows of the run share the row's time, shape (n,).
    """

    at: Times
    run_row: Times
    later: Times


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rows:
    """A run's values on a grid, shape (n,)."""

    grid: Grid
    values: Values


def lay_grid(reference_at: Times, run_at: Times, span: tuple[int, int]) -> Grid:
    """Return the grid of two runs' rows in a span of their clock, both ends included."""
    at = _merge_times(reference_at, run_at)
    at = at[(at >= span[0]) & (at <= span[1])]
    run_row = np.maximum(np.searchsorted(run_at, at, side="right") - 1, 0)
    shares = run_at[1:] == run_at[:-1]
    early = np.flatnonzero(shares & (run_at[:-1] >= span[0]) & (run_at[:-1] <= span[1]))
    if not len(early):
        return Grid(at=at, run_row=run_row, later=np.zeros(len(at), dtype=np.int64))
    at = np.concatenate([run_at[early], at])
    order = np.argsort(at, kind="stable")
    run_row = np.concatenate([early, run_row])[order]
    at = at[order]
    last = np.searchsorted(run_at, run_at[run_row], side="right") - 1
    return Grid(at=at, run_row=run_row, later=last - run_row)


def read_rows(run: Signal, grid: Grid) -> Rows:
    """Return a placed signal's values on a grid, by line or held as fits the signal."""
    if run.kind.resampling == "line":
        return Rows(grid=grid, values=np.interp(grid.at, run.time_ns, run.values))
    return Rows(grid=grid, values=run.values[grid.run_row])


def find_nearest(
    reference: Signal, rows: Rows, tolerance: Tolerance, *, half_width: int = 0
) -> Values:
    """Return the value of the reference that decides over each row, shape of the rows.

    Where a row is far inside its tolerance, another value that it passes by may be returned.
    """
    if reference.kind.resampling == "line":
        return _find_nearest_on_line(reference, rows, half_width)
    if not half_width:
        return _find_held(reference, rows)
    return _find_nearest_held(reference, rows, tolerance, half_width)


def measure_distance(reference: Signal, values: Values, nearest: Values) -> Values:
    """Return how far values are from values of the reference, never negative."""
    difference = values - nearest
    if reference.kind.compared_as == "angle":
        difference = wrap_angle(difference)
    if reference.kind.compared_as == "label":
        difference = np.sign(difference)
    return np.abs(difference)


def find_limit(reference: Signal, nearest: Values, tolerance: Tolerance) -> Values:
    """Return max(abs, rel |reference|) at values of the reference."""
    size = wrap_angle(nearest) if reference.kind.compared_as == "angle" else nearest
    return np.maximum(tolerance.abs, tolerance.rel * np.abs(size))


def _find_nearest_on_line(reference: Signal, rows: Rows, half_width: int) -> Values:
    if not half_width:
        return np.interp(rows.grid.at, reference.time_ns, reference.values)
    start, end = rows.grid.at - half_width, rows.grid.at + half_width
    ends = [np.interp(side, reference.time_ns, reference.values) for side in (start, end)]
    low, high = np.minimum(*ends), np.maximum(*ends)
    first = np.searchsorted(reference.time_ns, start, side="left")
    after = np.searchsorted(reference.time_ns, end, side="right")
    inside = np.flatnonzero(first < after)
    lowest, highest = find_ranges(reference.values, first[inside], after[inside])
    low[inside] = np.minimum(low[inside], lowest)
    high[inside] = np.maximum(high[inside], highest)
    values = rows.values
    if reference.kind.compared_as == "angle":
        # The run's angles may be counted from another turn: take the turn next to the window.
        middle = (low + high) / 2.0
        values = middle + wrap_angle(values - middle)
    return np.clip(values, low, high)


def _find_held(reference: Signal, rows: Rows) -> Values:
    """Return the value held at each row's time.

    Rows that share one time are matched from the last one backwards.
    """
    last = np.maximum(np.searchsorted(reference.time_ns, rows.grid.at, side="right") - 1, 0)
    same = np.searchsorted(reference.time_ns, reference.time_ns[last], side="left")
    is_there = reference.time_ns[last] == rows.grid.at
    return reference.values[np.where(is_there, np.maximum(last - rows.grid.later, same), last)]


def _find_nearest_held(
    reference: Signal, rows: Rows, tolerance: Tolerance, half_width: int
) -> Values:
    """Return the nearest of the rows in each window, where it can matter.

    A value outside the range of its window has its nearest at the edge. One between may stand in
    a gap; rows are searched for it only where the held value does not say already that the row
    passes with more to spare than another.
    """
    start, end = rows.grid.at - half_width, rows.grid.at + half_width
    first = np.maximum(np.searchsorted(reference.time_ns, start, side="right") - 1, 0)
    after = np.maximum(np.searchsorted(reference.time_ns, end, side="right"), first + 1)
    low, high = find_ranges(reference.values, first, after)
    edge, held = np.clip(rows.values, low, high), _find_held(reference, rows)
    between = edge == rows.values

    def find_excess(values: Values, nearest: Values) -> Values:
        distance = measure_distance(reference, values, nearest)
        return distance - find_limit(reference, nearest, tolerance)

    enough = min(0.0, float(find_excess(rows.values, edge).max(initial=-np.inf)))
    nearest = np.where(between, held, edge)
    unsaid = np.flatnonzero(between & (find_excess(rows.values, held) > enough))
    if len(unsaid):
        wanted = rows.values[unsaid]
        sides = find_neighbours(reference.values, first[unsaid], after[unsaid], wanted)
        excess = [np.nan_to_num(find_excess(wanted, side), nan=np.inf) for side in sides]
        nearest[unsaid] = np.where(excess[0] <= excess[1], *sides)
    return nearest


def _merge_times(one: Times, other: Times) -> Times:
    """Return the times of both, sorted, each once."""
    if np.array_equal(one, other):
        both = one
    else:
        # Merges sorted runs, where np.union1d would sort anew.
        both = np.sort(np.concatenate([one, other]), kind="stable")
    return both[np.flatnonzero(np.diff(both, prepend=both[0] - 1))]
