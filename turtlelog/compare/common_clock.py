"""Two runs on a common clock, and the deviation of one from values of the other near in time.

At time t, with a time tolerance d, a value is compared with the values of the reference in [t - d,
t + d]. A linearly interpolated signal takes every value between its minimum and maximum there; a
held signal takes the values of its rows in the window, and the value held at the window's start. A
value passes if it is within max(abs, rel |reference|) of any of these values. Because rel <= 1,
this half-width grows no faster than the distance, so the nearest values below and above decide.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import CompareError, suggest_names
from turtlelog.measure import Signal
from turtlelog.measure.reductions import Values
from turtlelog.run import Run
from turtlelog.run.angles import wrap_angle
from turtlelog.run.loops import NAME_PATTERN

Times = NDArray[np.int64]

ALIGNMENTS: Final = ("first_sample", "phase:NAME", "recorded", "sample")
"""Ways to align runs; NAME stands for a phase of their law."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _TimeClock:
    """Nanoseconds from time zero of each run; `span` has the first and last compared ones."""

    runs: tuple[Run, Run]
    zeros_ns: tuple[int, int]
    span: tuple[int, int]
    tells_time: bool = True
    """Whether the units of the clock are nanoseconds, so that tolerances in time apply."""

    def place_signal(self, signal: Signal, run: Run) -> Signal:
        """Return the signal of one of the two runs, with its rows on this clock."""
        zero_ns = self.zeros_ns[0 if run is self.runs[0] else 1]
        return _smooth(replace(signal, time_ns=signal.time_ns - zero_ns))

    def read_ns(self, unit: int) -> int:
        """Return the time of a unit of this clock [ns]."""
        return unit


@dataclass(frozen=True, slots=True, kw_only=True)
class _SampleClock:
    """Numbers of samples; poses are those that samples read, times those of the reference."""

    time_ns: Times
    tells_time: bool = False

    @property
    def span(self) -> tuple[int, int]:
        return 0, len(self.time_ns) - 1

    def place_signal(self, signal: Signal, run: Run) -> Signal:
        rows = np.arange(len(self.time_ns))
        read = rows
        if signal.kind.source != "sample":
            # Of what was sensed as well, for what a sample read did not drop out.
            read_ns = run.poses.time_ns[run.samples.pose_sequence[rows]]
            read = np.searchsorted(signal.time_ns, read_ns)
        return _smooth(replace(signal, time_ns=rows, values=signal.values[read]))

    def read_ns(self, unit: int) -> int:
        return int(self.time_ns[unit])


CommonClock = _TimeClock | _SampleClock
"""The clock on which two runs are compared."""


def could_be_alignment(text: str) -> bool:
    """Return whether a text is an alignment, possibly with a phase of any law."""
    phase = text.removeprefix("phase:")
    return text in ALIGNMENTS or (phase != text and re.fullmatch(NAME_PATTERN, phase) is not None)


def align_runs(reference: Run, run: Run, alignment: str) -> CommonClock:
    """Return the clock of one of `ALIGNMENTS` for two runs; a phase belongs to one of their laws.

    Raises:
        CompareError: If there is no such alignment, the alignment needs data that a run lacks, or
            the runs do not overlap.
    """
    for one in (reference, run):
        if not len(one.poses):
            raise CompareError(f"{one.name}: the recording holds no poses, which are compared")
    phases = join_phases(reference, run)
    known = ["first_sample", *(f"phase:{phase}" for phase in phases), "recorded", "sample"]
    if alignment not in known:
        expected = suggest_names(alignment, known)
        raise CompareError(f"alignment: expected {expected}, found {alignment!r}")
    if alignment == "sample":
        for one in (reference, run):
            if not len(one.samples):
                raise CompareError(f"{one.name}: no samples to align by number")
        count = min(len(reference.samples), len(run.samples))
        return _SampleClock(time_ns=reference.samples.time_ns[:count] - reference.start_ns)
    zeros_ns = find_zero_ns(reference, alignment), find_zero_ns(run, alignment, reference)
    # What stands before is not compared: before the first sample nothing was controlled yet.
    starts_ns = (reference.start_ns - zeros_ns[0], run.start_ns - zeros_ns[1])
    earliest_ns = max(starts_ns) if alignment == "recorded" else 0
    spans = [
        (int(one.poses.time_ns[0]) - zero_ns, one.end_ns - zero_ns)
        for one, zero_ns in zip((reference, run), zeros_ns, strict=True)
    ]
    span = max(earliest_ns, *(start for start, _ in spans)), min(end for _, end in spans)
    if span[1] <= span[0]:
        found = " and ".join(f"{start / 1e9:.2f} to {end / 1e9:.2f} s" for start, end in spans)
        names = f"{reference.name} and {run.name}"
        raise CompareError(f"{names}: expected runs that overlap, found {found}")
    return _TimeClock(runs=(reference, run), zeros_ns=zeros_ns, span=span)


def join_phases(reference: Run, run: Run) -> list[str]:
    """Return the phases of both laws, by which both runs are numbered."""
    return list(dict.fromkeys([*reference.phase_names, *run.phase_names]))


def _smooth(signal: Signal) -> Signal:
    """Remove the jumps of an angle at full turns, so that it can be interpolated."""
    if signal.kind.compared_as != "angle":
        return signal
    return replace(signal, values=np.unwrap(signal.values))


def find_zero_ns(run: Run, alignment: str, reference: Run | None = None) -> int:
    """Return time zero of an alignment in a run [ns]; by sample number, the first sample.

    Recorded times count from the first row of a run. For two runs of one bag, they count from the
    first row of the reference.
    """
    if alignment == "recorded":
        if reference is None or reference.source != run.source:
            return 0
        began_ns, other_ns = reference.origin.began_ns, run.origin.began_ns
        if began_ns is None or other_ns is None:
            return 0
        zero_ns = began_ns - other_ns
        return zero_ns if abs(zero_ns) < max(reference.end_ns, run.end_ns) else 0  # other bags
    if alignment in {"first_sample", "sample"}:
        return run.start_ns
    phase = alignment.removeprefix("phase:")
    for span in run.find_phase_spans():
        if span.phase == phase:
            return span.start_ns
    found = ", ".join(dict.fromkeys(span.phase for span in run.find_phase_spans())) or "none"
    raise CompareError(f"{run.name}: expected a phase {phase} to align at, found {found}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerance:
    """Allowed difference of a signal or metric from the reference: max(abs, rel |reference|).

    Attributes:
        abs: Absolute tolerance in the unit of the signal or metric, >= 0.
        rel: Fraction of the reference's magnitude, 0 to 1; for an angle, the fraction of its
            magnitude in [0, pi].
        time_s: Time tolerance [s], >= 0: a value passes if it matches any reference value within +-
            time_s. Only for signals.
        reason: Reason for the tolerance.

    Raises:
        CompareError: If a value is not a finite number in its range.
    """

    abs: float = 0.0
    rel: float = 0.0
    time_s: float = 0.0
    reason: str = ""

    def __post_init__(self) -> None:
        for name, most in (("abs", math.inf), ("rel", 1.0), ("time_s", _LONGEST_S)):
            value = getattr(self, name)
            wanted = "a finite number >= 0" if math.isinf(most) else f"a number from 0 to {most:g}"
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            if not is_number or not 0 <= value <= most or value == math.inf:
                raise CompareError(f"{name}: expected {wanted}, found {_describe(value)}")
            object.__setattr__(self, name, float(value))
        if not isinstance(self.reason, str):
            raise CompareError(f"reason: expected text, found {_describe(self.reason)}")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Grid:
    """Points at which a run is compared: its rows, and the reference's rows between them.

    Without the reference's times, a run with few rows would be compared at few points only.
    """

    at: Times  # times in units of the clock, not decreasing
    run_row: Times  # the run's row at each point, or the row before
    later: Times  # number of further rows of the run with the same time


_LONGEST_S = 1e6
"""Longest tolerance in time [s]: eleven days, longer than any run; in ns it fits into an int64."""


def _describe(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else repr(value)


def lay_grid(reference_at: Times, run_at: Times, span: tuple[int, int]) -> Grid:
    """Return the grid of two runs' rows in an interval of their clock, both ends included."""
    at = merge_times([reference_at, run_at])
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


def read_rows(run: Signal, grid: Grid) -> Values:
    """Return a placed signal's values on a grid, interpolated or held according to its kind."""
    if run.kind.resampling == "line":
        return np.interp(grid.at, run.time_ns, run.values)
    return run.values[grid.run_row]


def find_deciding_values(
    reference: Signal, grid: Grid, values: Values, tolerance: Tolerance, half_width: int
) -> Values:
    """Return the reference value that decides each row; far inside the tolerance, any within it.

    `values` are those of the run on the grid, `half_width` is the tolerance in time.
    """
    if reference.kind.resampling == "line":
        return _find_nearest_on_line(reference, grid, values, half_width)
    if not half_width:
        return _find_held(reference, grid)
    return _find_nearest_held(reference, grid, values, tolerance, half_width)


def find_window_range(reference: Signal, grid: Grid, half_width: int) -> tuple[Values, Values]:
    """Return the least and the largest reference value in the window around each row."""
    if reference.kind.resampling == "hold":
        return _find_ranges(reference.values, *_find_window(reference, grid, half_width))
    start, end = grid.at - half_width, grid.at + half_width
    ends = [np.interp(side, reference.time_ns, reference.values) for side in (start, end)]
    low, high = np.minimum(*ends), np.maximum(*ends)
    first = np.searchsorted(reference.time_ns, start, side="left")
    after = np.searchsorted(reference.time_ns, end, side="right")
    inside = np.flatnonzero(first < after)
    lowest, highest = _find_ranges(reference.values, first[inside], after[inside])
    low[inside] = np.minimum(low[inside], lowest)
    high[inside] = np.maximum(high[inside], highest)
    return low, high


def measure_distance(reference: Signal, values: Values, nearest: Values) -> Values:
    """Return the distance between values and reference values, never negative."""
    difference = values - nearest
    if reference.kind.compared_as == "angle":
        difference = wrap_angle(difference)
    if reference.kind.compared_as == "label":
        difference = np.sign(difference)
    return np.abs(difference)


def find_limit(reference: Signal, nearest: Values, tolerance: Tolerance) -> Values:
    """Return max(abs, rel |reference|) for reference values."""
    size = wrap_angle(nearest) if reference.kind.compared_as == "angle" else nearest
    return np.maximum(tolerance.abs, tolerance.rel * np.abs(size))


def _find_nearest_on_line(reference: Signal, grid: Grid, values: Values, half_width: int) -> Values:
    if not half_width:
        return np.interp(grid.at, reference.time_ns, reference.values)
    low, high = find_window_range(reference, grid, half_width)
    if reference.kind.compared_as == "angle":
        # The run's angles may be counted from another turn: take the turn next to the window.
        middle = (low + high) / 2.0
        values = middle + wrap_angle(values - middle)
    return np.clip(values, low, high)


def _find_held(reference: Signal, grid: Grid) -> Values:
    """Return the value held at each row's time; rows at one time match from the last backwards."""
    last = np.maximum(np.searchsorted(reference.time_ns, grid.at, side="right") - 1, 0)
    same = np.searchsorted(reference.time_ns, reference.time_ns[last], side="left")
    is_there = reference.time_ns[last] == grid.at
    return reference.values[np.where(is_there, np.maximum(last - grid.later, same), last)]


def _find_window(reference: Signal, grid: Grid, half_width: int) -> tuple[Times, Times]:
    """Return the row held at the start of each row's window, and the row after its last."""
    times_ns, start, end = reference.time_ns, grid.at - half_width, grid.at + half_width
    first = np.maximum(np.searchsorted(times_ns, start, side="right") - 1, 0)
    return first, np.maximum(np.searchsorted(times_ns, end, side="right"), first + 1)


def _find_nearest_held(
    reference: Signal, grid: Grid, values: Values, tolerance: Tolerance, half_width: int
) -> Values:
    """Return the nearest row value in each window, if this value can matter.

    For a value outside the range of its window, the nearest value is at the edge. A value within
    the range may lie in a gap. The rows are searched only if the held value does not already show
    that the row passes with more margin than another row.
    """
    first, after = _find_window(reference, grid, half_width)
    low, high = _find_ranges(reference.values, first, after)
    edge, held = np.clip(values, low, high), _find_held(reference, grid)
    between = edge == values

    def find_excess(values: Values, nearest: Values) -> Values:
        distance = measure_distance(reference, values, nearest)
        return distance - find_limit(reference, nearest, tolerance)

    enough = min(0.0, float(find_excess(values, edge).max(initial=-np.inf)))
    nearest = np.where(between, held, edge)
    unsaid = np.flatnonzero(between & (find_excess(values, held) > enough))
    if len(unsaid):
        wanted = values[unsaid]
        sides = _find_neighbours(reference.values, first[unsaid], after[unsaid], wanted)
        excess = [np.nan_to_num(find_excess(wanted, side), nan=np.inf) for side in sides]
        nearest[unsaid] = np.where(excess[0] <= excess[1], *sides)
    return nearest


def merge_times(times: Sequence[Times]) -> Times:
    """Return all times, sorted and without duplicates; at least one is given."""
    merged = np.sort(np.concatenate(times), kind="stable")  # merges sorted runs, unlike np.unique
    return merged[np.flatnonzero(np.diff(merged, prepend=merged[0] - 1))]  # faster than a mask


def _find_ranges(values: Values, first: Times, after: Times) -> tuple[Values, Values]:
    """Return the minimum and maximum of the rows from `first` to `after - 1`, for each pair."""
    lowest, highest = find_range_maxima(np.stack([-values, values]), first, after - 1)
    return -lowest, highest


def find_range_maxima(values: Values, firsts: Times, lasts: Times) -> Values:
    """Return the maximum of values[first] to values[last] for each pair, along the last axis.

    Ranges that reach the end use suffix maxima. Other ranges use two overlapping maxima of 2^k
    values. Firsts and lasts do not decrease.
    """
    count = values.shape[-1]
    inner = int(np.searchsorted(lasts, count - 1))
    found = np.empty((*values.shape[:-1], len(firsts)))
    tail = int(firsts[inner]) if inner < len(firsts) else count
    suffixes = np.maximum.accumulate(values[..., tail:][..., ::-1], axis=-1)[..., ::-1]
    found[..., inner:] = suffixes[..., firsts[inner:] - tail]
    firsts, lasts = firsts[:inner], lasts[:inner]
    levels = _find_levels(lasts - firsts + 1)
    maxima, level = values, 0
    for target in np.flatnonzero(np.bincount(levels)):
        while level < target:
            maxima = np.maximum(maxima[..., : -(1 << level)], maxima[..., 1 << level :])
            level += 1
        rows = slice(None) if levels.size == 1 else np.flatnonzero(levels == target)
        ends = lasts[rows] - ((1 << level) - 1)
        found[..., :inner][..., rows] = np.maximum(maxima[..., firsts[rows]], maxima[..., ends])
    return found


def _find_levels(counts: Times) -> NDArray[np.integer[Any]]:
    """Return the largest k with 2^k <= count for each; a single k if all are equal."""
    if not len(counts):
        return np.empty(0, np.int64)
    extremes = np.frexp(np.array([counts.min(), counts.max()], np.float64))[1] - 1
    if extremes[0] == extremes[1]:
        return extremes[:1]
    levels = np.zeros(len(counts), np.int8)  # few of 64 levels occur: cheaper than all logarithms
    for level in range(1, int(extremes[1]) + 1):
        levels += counts >= (1 << level)
    return levels


def _find_neighbours(
    values: Values, first: Times, after: Times, wanted: Values
) -> tuple[Values, Values]:
    """Return the nearest value at or below `wanted`, and above it, in each segment; NaN: no value.

    Each segment consists of at most two sorted blocks of every size; all blocks of one size are
    searched by bisection in one call.
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

    def __init__(self, ranks: Times, width: int) -> None:
        self._ranks, self._width, self._most = ranks, width, len(ranks) + 1
        self._keys = ranks + np.arange(len(ranks)) // width * self._most

    def search(self, block: Times, rank: Times) -> tuple[Times, Times]:
        """Return the largest rank <= `rank` in each block (-1: none), and the smallest above it."""
        start, end = block * self._width, (block + 1) * self._width
        place = np.searchsorted(self._keys, block * self._most + rank, side="right")
        last = len(self._ranks) - 1
        below = np.where(place > start, self._ranks[np.maximum(place - 1, 0)], -1)
        above = np.where(place < end, self._ranks[np.minimum(place, last)], self._most)
        return below, above
