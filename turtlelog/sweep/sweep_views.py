"""Views of a sweep for charts: two axes, fixed values of the other axes, the values of cells."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import SweepError, suggest_names
from turtlelog.measure import find_metric_kind
from turtlelog.scenario import flatten_scenario
from turtlelog.sweep.sweep_table import SEED, SweptAxis, SweptMetric, SweptResults, format_key_value

Values = NDArray[np.float64]
Places = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SweptView:
    """Rows of a sweep over one or two axes."""

    results: SweptResults  # sweep that the rows belong to
    x: SweptAxis  # horizontal axis
    y: SweptAxis | None  # vertical axis; None if one axis is shown
    held: Mapping[SweptAxis, int]  # fixed places of the axes that are not shown
    seeds: int  # number of seeds over which a cell averages; 1 if runs are not repeated
    rows: Places  # shown rows, ascending
    notes: tuple[str, ...]  # choices made for the caller, in sentences

    @property
    def axes(self) -> tuple[SweptAxis, ...]:
        """The one or two axes."""
        return (self.x,) if self.y is None else (self.x, self.y)

    @property
    def shape(self) -> tuple[int, int]:
        """Number of places of y and of x."""
        return (1 if self.y is None else len(self.y), len(self.x))

    @property
    def cells(self) -> Places:
        """Index of each shown row's cell, counted along x first."""
        beside = 0 if self.y is None else self.y.places[self.rows] * len(self.x)
        return np.asarray(self.x.places[self.rows] + beside, dtype=np.int64)

    def find_first_rows(self) -> Places:
        """Return the first row of each cell, in the shape of `shape`; -1 for empty cells."""
        found = np.full(self.shape[0] * self.shape[1], -1, dtype=np.int64)
        found[self.cells[::-1]] = self.rows[::-1]
        return found.reshape(self.shape)

    def tell_held(self) -> str:
        """Return the fixed values as text, as in `loop.transport_delay_ticks = 4`."""
        return ", ".join(axis.tell_keys(place) for axis, place in self.held.items())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SweptCells:
    """A metric in the cells of a view."""

    values: Values  # means over the rows with a value, in the shape of the view; NaN if missing
    least: Values  # smallest value
    most: Values  # largest value
    counts: Places  # number of rows with a value
    reasons: Mapping[int, str]  # reason for a missing value, by index of a cell with rows


def choose_view(
    results: SweptResults,
    *,
    x: str | None = None,
    y: str | None = None,
    at: Mapping[str, Any] | None = None,
    gains: Sequence[str] = (),
) -> SweptView:
    """Return the rows to be shown in a chart with one or two axes.

    Args:
        results: Results of a sweep.
        x: Key of the horizontal axis. Default: chosen automatically.
        y: Key of the vertical axis. Default: chosen automatically.
        at: Values of fixed keys.
        gains: Keys that get the vertical axis when shown together with another key.

    Raises:
        SweepError: If a key does not vary, or a value does not occur.
    """
    held = _hold(results, at or {})
    asked = [
        None if key is None else _require_axis(results, key, option)
        for key, option in ((x, "--x"), (y, "--y"))
    ]
    for one, option in zip(asked, ("--x", "--y"), strict=True):
        if one is not None and one in held:
            raise SweepError(f"{option}: expected a key that --at does not hold, found {one.name}")
    if asked[0] is not None and asked[0] is asked[1]:
        raise SweepError(f"--y: expected another key than --x, found {asked[0].name}")
    shown = _choose_axes(results, asked, held, gains)
    return _hold_others(results, shown, held)


def _require_axis(results: SweptResults, key: str, option: str) -> SweptAxis:
    found = results.find_axis(key)
    if found is None:
        near = suggest_names(key, [key for axis in results.axes for key in axis.keys])
        raise SweepError(f"{option}: expected a key that varies ({near}), found {key}")
    return found


def _hold(results: SweptResults, at: Mapping[str, Any]) -> dict[SweptAxis, int]:
    held: dict[SweptAxis, int] = {}
    for key, value in at.items():
        axis = _require_axis(results, key, "--at")
        column = axis.keys.index(key)
        values = [one[column] for one in axis.values]
        if value not in values:
            # The nearest numbers, or the first words.
            is_number = all(isinstance(one, int | float) for one in (value, *values))
            listed = sorted(values, key=lambda one: abs(one - value)) if is_number else values
            near = " or ".join(format_key_value(one) for one in dict.fromkeys(listed[:3]))
            raise SweepError(f"--at: expected a value of {key}, as {near}, found {value}")
        wanted = [(axis.keys.index(other), at[other]) for other in axis.keys if other in at]
        fits = [all(one[column] == wish for column, wish in wanted) for one in axis.values]
        if True not in fits:
            raise SweepError(f"--at: no row has these values of {axis.name}")
        held[axis] = fits.index(True)
    return held


def _choose_axes(
    results: SweptResults,
    asked: Sequence[SweptAxis | None],
    held: Mapping[SweptAxis, int],
    gains: Sequence[str],
) -> list[SweptAxis]:
    first, second = asked
    given = [axis for axis in asked if axis is not None]
    others = [axis for axis in results.axes if axis not in held and axis not in given]
    free = [axis for axis in others if len(axis) > 1]
    free = [axis for axis in free if axis.keys != (SEED,)] or ([] if given else free)
    if not free and not given:
        free = [axis for axis in results.axes if axis not in held] or [results.axes[0]]
    # Texts have few places: they are fixed rather than a range of numbers.
    ranked = sorted(free, key=lambda axis: not axis.is_number)
    added = ranked[: 2 - len(given)]
    if second is not None:
        if first is None and not added:
            raise SweepError(f"--y: expected a second key that varies, found {second.name} alone")
        return [first or added[0], second]
    if first is not None:
        return [first, *added]
    added.sort(key=results.axes.index)
    if len(added) == 2 and is_gain(added[0], gains) and not is_gain(added[1], gains):
        added.reverse()
    return added


def is_gain(axis: SweptAxis, gains: Sequence[str]) -> bool:
    """Return whether all keys of an axis are gains."""
    return set(axis.keys) <= set(gains)


def _hold_others(
    results: SweptResults, shown: Sequence[SweptAxis], held: Mapping[SweptAxis, int]
) -> SweptView:
    notes, held, seeds = [], dict(held), 1
    for axis in results.axes:
        if axis in shown or axis in held or results.is_sampled:
            continue
        if axis.keys == (SEED,):
            seeds = len(axis)
        else:
            held[axis], how = find_usual_place(results, axis)
            if len(axis) > 1:
                notes.append(f"{axis.tell_keys(held[axis])} ({how}); --at holds another")
    chosen = np.ones(results.row_count, dtype=bool)
    for axis, place in held.items():
        chosen &= axis.places == place
    rows = np.flatnonzero(chosen)
    if not len(rows):
        raise SweepError("--at: no row has all these values")
    return SweptView(
        results=results,
        x=shown[0],
        y=shown[1] if len(shown) > 1 else None,
        held=held,
        seeds=seeds,
        rows=rows,
        notes=tuple(notes),
    )


def find_usual_place(results: SweptResults, axis: SweptAxis) -> tuple[int, str]:
    """Return the fixed place of an axis and the reason: the base's values, or else the middle."""
    parameters = flatten_scenario(results.base)
    base = tuple(map(parameters.get, axis.keys))
    if base in axis.values:
        return axis.values.index(base), "as in the base"
    return (len(axis) - 1) // 2, "the middle of its values"


def fill_cells(view: SweptView, metric: SweptMetric) -> SweptCells:
    """Return the values of a metric in the cells of a view."""
    count = view.shape[0] * view.shape[1]
    cells, values = view.cells, metric.values[view.rows]
    has_value = np.isfinite(values)
    counts = np.bincount(cells[has_value], minlength=count)
    least, most = np.full(count, np.inf), np.full(count, -np.inf)
    np.minimum.at(least, cells[has_value], values[has_value])
    np.maximum.at(most, cells[has_value], values[has_value])
    scale = np.maximum(np.abs(values[has_value]).max(initial=0.0), 1.0)
    sums = np.bincount(cells[has_value], weights=values[has_value] / scale, minlength=count)
    with np.errstate(invalid="ignore", divide="ignore"):
        means = np.where(counts == 1, least, sums / counts * scale)
    is_empty = counts == 0
    for array in (means, least, most):
        array[is_empty] = np.nan
    reasons = {
        int(cell): metric.reasons[row] or "no value"
        for cell, row in zip(cells[::-1].tolist(), view.rows[::-1].tolist(), strict=True)
        if is_empty[cell]
    }
    return SweptCells(
        values=means.reshape(view.shape),
        least=least.reshape(view.shape),
        most=most.reshape(view.shape),
        counts=counts.reshape(view.shape),
        reasons=reasons,
    )


def require_values(view: SweptView) -> None:
    """Raise SweepError if no metric has a value in any shown row."""
    metrics, path = view.results.metrics, view.results.path
    if view.results.failed == view.results.row_count:
        raise SweepError(f"{path}: all rows failed")
    if not metrics:
        raise SweepError(f"{path}: the table has no metric")
    if any(np.isfinite(metric.values[view.rows]).any() for metric in metrics):
        return
    reasons = dict.fromkeys(str(one.reasons[row]) for one in metrics for row in view.rows.tolist())
    names = ", ".join(metric.name for metric in metrics)
    raise SweepError(f"{path}: expected a row with a value of {names}, found {', '.join(reasons)}")


def list_shown_values(view: SweptView, metric: SweptMetric) -> tuple[Places, Values]:
    """Return the shown rows with their values; for means over seeds, the first row of each mean."""
    if view.seeds == 1:
        return view.rows, metric.values[view.rows]
    first = view.find_first_rows()
    return first[first >= 0], fill_cells(view, metric).values[first >= 0]


def find_best_rows(view: SweptView, metric: SweptMetric) -> list[int]:
    """Return the shown rows with the best value; empty if neither direction is better.

    With seeds, the result is the first row of each best mean; only means over the largest number of
    seeds count.
    """
    kind, (rows, values) = find_metric_kind(metric.name), list_shown_values(view, metric)
    if kind is None or kind.better is None or metric.is_verdict or not np.isfinite(values).any():
        return []
    if view.seeds > 1:
        counts = fill_cells(view, metric).counts[view.find_first_rows() >= 0]
        values = np.where(counts == counts.max(), values, np.nan)
    if kind.floor is not None:
        values = np.maximum(values, kind.floor)
    best = np.nanmin(values) if kind.better == "lower" else np.nanmax(values)
    return [int(row) for row in rows[values == best]]


class Rivals(NamedTuple):
    """Means over seeds beside the best mean."""

    within_chance: int  # number of means that are not significantly worse than the best
    others: int  # number of means that are worse, significantly or not

    @property
    def is_open(self) -> bool:
        """Whether there are worse means, and none of them is significantly worse."""
        return 0 < self.others == self.within_chance


_CHANCE: Final = 0.05
"""Probability that chance makes an equally good mean seem worse, for all means together."""


def count_rivals(view: SweptView, metric: SweptMetric) -> Rivals | None:
    """Return how many means over seeds may be as good as the best; None without a best mean.

    The runs of two means are paired by seed. A difference is significant if it exceeds the quantile
    of Student's t. The error probability is divided by the number of means (Bonferroni), because
    the best of many means is partly the luckiest.
    """
    best, seed = find_best_rows(view, metric), view.results.find_axis(SEED)
    if view.seeds == 1 or not best or seed is None or seed in view.axes:
        return None
    from scipy.special import stdtrit

    runs = np.full((view.shape[0] * view.shape[1], len(seed)), np.nan)
    runs[view.cells, seed.places[view.rows]] = metric.values[view.rows]
    counts = np.isfinite(runs).sum(axis=1)
    cells = dict(zip(view.rows.tolist(), view.cells.tolist(), strict=True))
    equal = [cells[row] for row in best]
    others = np.setdiff1d(np.flatnonzero(counts == counts.max()), equal)
    kind = find_metric_kind(metric.name)
    sign = -1.0 if kind is not None and kind.better == "higher" else 1.0
    worse = sign * (runs[others] - runs[equal[0]])
    known = np.isfinite(worse).sum(axis=1)
    within = 0
    for count, row in zip(known.tolist(), worse, strict=True):
        if count < 2:
            within += 1
            continue
        error = np.nanstd(row, ddof=1) / np.sqrt(count)
        within += bool(np.nanmean(row) <= stdtrit(count - 1, 1.0 - _CHANCE / len(others)) * error)
    return Rivals(within, len(others))


@dataclass(frozen=True, slots=True, kw_only=True)
class BestRow:
    """The best row of a metric: number, value and keys; `as_good` counts equally good rows.

    With means over seeds, it is the first row of the best mean. `within_chance` counts worse means
    whose difference from the best may be chance, of `others`.
    """

    row: int
    value: float
    as_good: int
    within_chance: int | None
    others: int | None
    keys: Mapping[str, Any]

    @property
    def is_open(self) -> bool:
        """Whether no other mean over seeds is worse by more than chance."""
        return Rivals(self.within_chance or 0, self.others or 0).is_open


def find_best_row(view: SweptView, metric: SweptMetric) -> BestRow | None:
    """Return the best shown row; of several equally good rows, the first."""
    found = find_best_rows(view, metric)
    if not found:
        return None
    row = found[0]
    rows, values = list_shown_values(view, metric)
    rivals = count_rivals(view, metric)
    return BestRow(
        row=view.results.row_numbers[row],
        value=float(values[rows == row][0]),
        as_good=len(found),
        within_chance=None if rivals is None else rivals.within_chance,
        others=None if rivals is None else rivals.others,
        keys=name_values({axis: axis.places[row] for axis in view.results.axes}),
    )


def name_values(places: Mapping[SweptAxis, int]) -> dict[str, Any]:
    """Return the values of axes at places, by key."""
    return {
        key: value
        for axis, place in places.items()
        for key, value in zip(axis.keys, axis.values[place], strict=True)
    }
