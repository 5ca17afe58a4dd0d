"""The sensitivity of a metric to each key of a sweep: ranges in a grid, ranks in a sample.

In a grid, the sensitivity is the range of the metric along each key with the other keys fixed. In a
sample, it is Spearman's rank correlation of each key with the metric (C. Spearman, American Journal
of Psychology 15 (1904) 72-101). In addition, a linear regression on the ranks of all keys explains
a share of the variance of the metric's ranks (R. L. Iman and W. J. Conover, Technometrics 21 (1979)
499-509). The rest is due to interactions, non-monotonic dependence and noise.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.sweep.table.swept_results import SEED, SweptAxis, SweptMetric, SweptResults
from turtlelog.sweep.table.swept_views import find_usual_place

Values = NDArray[np.float64]

_LEAST_ROWS: Final = 10
"""Smallest number of rows with a value in a sample. With fewer rows, chance alone gives
correlations of 0.65 in one of 20 cases."""

_NORMAL_95: Final = 1.959964
"""Half-width of the central 95 % of the normal distribution. By chance, ranks of n independent rows
correlate with the standard deviation 1 / sqrt(n - 1)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sensitivity:
    """Range of a metric along one key.

    Attributes:
        axis: The key, or the keys that vary together.
        least: Smallest value of the metric along the key; None for a sample.
        most: Largest value of the metric along the key; None for a sample.
        least_place: Place of the smallest value on the axis; None for a sample.
        most_place: Place of the largest value; None for a sample.
        correlation: Spearman's rank correlation; None for a grid.
        left_out: Number of rows along the key without a value.
        others: Smallest and largest range (`most` minus `least`) along the key, with the other keys
            fixed at other values. None for a sample, or if there are no other values.
    """

    axis: SweptAxis
    least: float | None = None
    most: float | None = None
    least_place: int | None = None
    most_place: int | None = None
    correlation: float | None = None
    left_out: int = 0
    others: tuple[float, float] | None = None

    @property
    def size(self) -> float:
        """Size of the key's effect: range, or magnitude of the correlation."""
        if self.correlation is not None:
            return abs(self.correlation)
        return 0.0 if self.least is None or self.most is None else self.most - self.least


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sensitivities:
    """Ranges of a metric along each key of a sweep.

    Attributes:
        metric: The metric.
        keys: Sensitivities, largest first.
        center: Value of the metric at the fixed values of all keys; None for a sample, or if there
            is no value.
        held: Values at which all keys are fixed, in words; empty for a sample.
        chance: Magnitude below which 95 % of the correlations of independent keys lie; None for a
            grid.
        explained: Share of the variance of the metric's ranks explained by the ranks of all keys, 0
            to 1; None for a grid, or if a key has words.
        rows: Number of rows with a value, for a sample.
        notes: Parts left out, in sentences.
    """

    metric: SweptMetric
    keys: tuple[Sensitivity, ...]
    center: float | None = None
    held: str = ""
    chance: float | None = None
    explained: float | None = None
    rows: int = 0
    notes: tuple[str, ...] = ()


def find_sensitivities(
    results: SweptResults, metric: SweptMetric, held: dict[SweptAxis, int] | None = None
) -> Sensitivities:
    """Return the sensitivities of a metric to the keys of a sweep.

    Args:
        results: Results of a grid or a sample.
        metric: One of the metrics of the results.
        held: Places at which keys of a grid are fixed. Other keys are fixed at the base's values,
            or else in the middle.
    """
    if results.is_sampled:
        return _correlate(results, metric)
    axes = list_varied(results)
    center = {axis: find_usual_place(results, axis)[0] for axis in axes} | (held or {})
    center = {axis: place for axis, place in center.items() if axis in axes}
    cube = _fill_cube(axes, metric)
    found = [_range_along(axes, number, center, cube) for number in range(len(axes))]
    value = float(cube[tuple(center[axis] for axis in axes)]) if axes else math.nan
    notes = [
        f"{metric.name}: {one.left_out} of {len(one.axis)} values of {one.axis.name} have no value"
        " and are left out"
        for one in found
        if one.left_out
    ]
    return Sensitivities(
        metric=metric,
        keys=tuple(sorted(found, key=lambda one: -one.size)),
        center=None if math.isnan(value) else value,
        held="; ".join(f"{axis.name} = {axis.tell_place(center[axis])}" for axis in axes),
        notes=tuple(notes),
    )


def list_varied(results: SweptResults) -> list[SweptAxis]:
    """Return the axes that may affect a metric. In a grid, the metric is averaged over seeds."""
    axes = [axis for axis in results.axes if len(axis) > 1]
    return [axis for axis in axes if results.is_sampled or axis.keys != (SEED,)]


def _fill_cube(axes: Sequence[SweptAxis], metric: SweptMetric) -> Values:
    """Return the metric by places of all axes, averaged over seeds; NaN for missing values."""
    shape = tuple(len(axis) for axis in axes)
    known = np.isfinite(metric.values)
    count = math.prod(shape)
    cells = np.zeros(len(metric.values), dtype=np.int64)
    for axis in axes:
        cells = cells * len(axis) + axis.places
    counts = np.bincount(cells[known], minlength=count)
    sums = np.bincount(cells[known], weights=metric.values[known], minlength=count)
    means = np.full(count, np.nan)
    np.divide(sums, counts, out=means, where=counts > 0)
    return means.reshape(shape)


def _range_along(
    axes: Sequence[SweptAxis], number: int, center: dict[SweptAxis, int], cube: Values
) -> Sensitivity:
    places = tuple(center[axis] for axis in axes)
    line = np.moveaxis(cube, number, -1)[(*places[:number], *places[number + 1 :])]
    known = np.flatnonzero(np.isfinite(line))
    left_out = len(line) - len(known)
    if not len(known):
        return Sensitivity(axis=axes[number], left_out=left_out)
    low, high = (int(known[find(line[known])]) for find in (np.argmin, np.argmax))
    return Sensitivity(
        axis=axes[number],
        least=float(line[low]),
        most=float(line[high]),
        least_place=low,
        most_place=high,
        left_out=left_out,
        others=_find_other_ranges(np.moveaxis(cube, number, 0).reshape(len(line), -1)),
    )


def _find_other_ranges(lines: Values) -> tuple[float, float] | None:
    """Return the smallest and largest range over all lines with a value at every place."""
    whole = lines[:, np.isfinite(lines).all(axis=0)]
    if lines.shape[1] < 2 or not whole.shape[1]:
        return None
    ranges = whole.max(axis=0) - whole.min(axis=0)
    return float(ranges.min()), float(ranges.max())


def _correlate(results: SweptResults, metric: SweptMetric) -> Sensitivities:
    known = np.isfinite(metric.values)
    rows = int(known.sum())
    axes = list_varied(results)
    numeric = [axis for axis in axes if axis.is_number]
    words = [axis.name for axis in axes if not axis.is_number]
    notes = [f"{metric.name}: {name} has words, which have no ranks" for name in words]
    if rows < len(known):
        left = len(known) - rows
        notes.append(f"{metric.name}: {left} of {len(known)} rows have no value and are left out")
    values = metric.values[known]
    if rows < _LEAST_ROWS or values.min() == values.max():
        what = f"{rows} rows" if rows < _LEAST_ROWS else "one value in all rows"
        notes.append(f"{metric.name}: no correlation of {what}")
        return Sensitivities(metric=metric, keys=(), rows=rows, notes=tuple(notes))
    ranks = _rank(values)
    columns = [_rank(axis.numbers[axis.places[known]]) for axis in numeric]
    found = [
        Sensitivity(axis=axis, correlation=_find_correlation(column, ranks))
        for axis, column in zip(numeric, columns, strict=True)
    ]
    return Sensitivities(
        metric=metric,
        keys=tuple(sorted(found, key=lambda one: -one.size)),
        chance=_NORMAL_95 / math.sqrt(rows - 1),
        explained=_find_explained(columns, ranks) if len(numeric) == len(axes) else None,
        rows=rows,
        notes=tuple(notes),
    )


def _rank(values: Values) -> Values:
    """Return ranks from 0. Equal values share the mean of their ranks."""
    _, places, counts = np.unique(values, return_inverse=True, return_counts=True)
    ends = np.cumsum(counts)
    return np.asarray((ends - (counts + 1) / 2.0)[places], dtype=np.float64)


def _find_correlation(first: Values, second: Values) -> float:
    """Return the correlation of ranks; 0 if one input is constant."""
    a, b = first - first.mean(), second - second.mean()
    scale = math.sqrt(float(a @ a) * float(b @ b))
    return float(a @ b) / scale if scale else 0.0


def _find_explained(columns: Sequence[Values], ranks: Values) -> float:
    design = np.column_stack([np.ones(len(ranks)), *columns])
    solution, *_ = np.linalg.lstsq(design, ranks, rcond=None)
    rest = ranks - design @ solution
    whole = ranks - ranks.mean()
    return 1.0 - float(rest @ rest) / float(whole @ whole)
