"""What a sweep shows of its keys: sensitivities of a metric, limits of gains and measured borders.

In a grid, the sensitivity is the range of the metric along each key with the other keys fixed. In a
sample, it is Spearman's rank correlation of each key with the metric (C. Spearman, American Journal
of Psychology 15 (1904) 72-101). In addition, a linear regression on the ranks of all keys explains
a share of the variance of the metric's ranks (R. L. Iman and W. J. Conover, Technometrics 21 (1979)
499-509). The rest is due to interactions, non-monotonic dependence and noise.

Theory gives the limits of a gain in every column of a map.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import describe_count
from turtlelog.errors import TurtlelogError
from turtlelog.scenario import flatten_scenario, resolve_scenario
from turtlelog.simulate import declare_scenario
from turtlelog.sweep.sweep_table import (
    SEED,
    SweptAxis,
    SweptMetric,
    SweptResults,
    list_declared_loops,
)
from turtlelog.sweep.sweep_views import SweptView, fill_cells, find_usual_place, is_gain
from turtlelog.theory import LoopModel, find_stable_gains, hides_stability, model_loops
from turtlelog.theory.loop_design import LoopDesign, find_p_without_overshoot

Values = NDArray[np.float64]

_MOST_DRAWN: Final = 48  # places of a sampled key with theory: one per 2 mm of a figure


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnLimits:
    """Theoretical limits of the gain in one column.

    With full queues the dead time grows; `grown` is None if it cannot grow.
    """

    stable: tuple[tuple[float, float], ...]  # intervals of the gain with a stable loop
    overshoot: float | None  # gain from which the loop overshoots; None: not purely proportional
    grown: tuple[tuple[float, float], ...] | None = None  # the same with full queues

    @property
    def stability(self) -> float | None:
        """Gain from which the loop is unstable; None if no gain is stable."""
        return self.stable[-1][1] if self.stable else None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoopLimits:
    """Theoretical limits of a loop over the axes of a view."""

    loop: str  # name of the loop
    gain: SweptAxis  # axis of its gain
    columns: tuple[ColumnLimits | None, ...]  # for each place of the other axis; None: no limits
    notes: tuple[str, ...]  # reasons for missing limits, and what theory leaves out, in sentences


@dataclass(frozen=True, slots=True, kw_only=True)
class Border:
    """Border along the gain at which a loop becomes unstable, in one column.

    If all measured gains have one verdict, the grid has no border in the column. `is_near` is None
    if a border is unknown. One outside the grid is unknown, but not near a limit well inside.
    """

    place: int  # place of the column on the other axis
    last_stable: float | None  # largest gain measured as stable below the border; None if none was
    first_unstable: float | None  # smallest gain measured as unstable; None if none was
    theory: float | None  # gain from which the loop is unstable in theory; None: no limit
    verdict: bool | None  # whether all measured gains are stable, or all unstable; None: neither
    is_near: bool | None  # whether measured and theoretical border are within one cell
    is_mixed: bool = False  # whether seeds differ at some gain; most seeds then count

    @property
    def agrees(self) -> bool:
        """Whether theory has the same verdict at all measured gains, in all seeds."""
        if self.theory is None or self.verdict is None or self.is_mixed:
            return False
        if self.verdict:
            return self.last_stable is not None and self.last_stable < self.theory
        return self.first_unstable is not None and self.first_unstable >= self.theory


def list_gain_keys(results: SweptResults) -> tuple[str, ...]:
    """Return the keys of the gains that the law declares; empty if the law's code is not loaded."""
    return tuple(loop.gain for loop in list_declared_loops(results) if loop.gain)


def find_loop_limits(view: SweptView) -> list[LoopLimits]:
    """Return the theoretical limits of the loops whose gain is an axis of a view."""
    if view.results.is_sampled and len(view.results.axes) > len(view.axes):
        return []
    found = []
    gains = list_gain_keys(view.results)
    for loop in list_declared_loops(view.results):
        axis = next((axis for axis in view.axes if loop.gain in axis.keys), None)
        if axis is None or not axis.is_number or loop.gain is None or not is_gain(axis, gains):
            continue
        column = axis.keys.index(loop.gain)
        if all(value[column] == value[0] for value in axis.values):
            found.append(_find_limits(view, loop.name, axis))
    return found


def choose_limits(limits: Sequence[LoopLimits], metric: SweptMetric) -> LoopLimits | None:
    """Return the limits for a metric: of its loop, or of the first loop for metrics of the run."""
    own = [one for one in limits if one.loop == metric.loop]
    if own:
        return own[0]
    return limits[0] if limits and metric.loop in {"final", "run"} else None


def _find_limits(view: SweptView, name: str, gain: SweptAxis) -> LoopLimits:
    other = next((axis for axis in view.axes if axis is not gain), None)
    columns: list[ColumnLimits | None] = []
    notes: dict[str, list[int]] = {}
    known: dict[Any, ColumnLimits] = {}
    count = 1 if other is None else len(other)
    every = -(-count // _MOST_DRAWN) if view.results.is_sampled else 1
    for place in range(count):
        if place % every:
            columns.append(None)
            continue
        there = view.rows if other is None else view.rows[other.places[view.rows] == place]
        model = _model(view.results, there, name)
        if isinstance(model, str):
            notes.setdefault(model, []).append(place)
            columns.append(None)
            continue
        pid, settings = model.require()
        process, period_s = settings["process"], settings["period_s"]
        key = replace(pid, kp=1.0), process, period_s, model.most_dead_time_s
        if key not in known:
            design = LoopDesign(process=process, period_s=period_s, filter_s=pid.filter_s)
            grows = model.most_dead_time_s is not None
            known[key] = ColumnLimits(
                stable=find_stable_gains(pid, **settings),
                overshoot=None if pid.ki or pid.kd else find_p_without_overshoot(design),
                grown=find_stable_gains(pid, **model.require_latest()) if grows else None,
            )
        columns.append(known[key])
        if model.most_dead_time_s is not None:
            notes.setdefault(f"the dead time is the least; {model.growth} may let it grow", [])
    told = []
    for text, places in notes.items():
        where = ""
        if other is not None and 0 < len(places) < len(columns):
            texts = [other.tell_place(place) for place in places]
            listed = ", ".join(texts[:2] if len(texts) > 4 else texts)
            more = f" ... {texts[-1]}" if len(texts) > 4 else ""
            where = f" where {other.name} is {listed}{more}"
        told.append(f"{name}: {text}{where}")
    return LoopLimits(loop=name, gain=gain, columns=tuple(columns), notes=tuple(told))


def _model(results: SweptResults, rows: NDArray[np.int64], name: str) -> LoopModel | str:
    """Return the theoretical loop in one of the rows, or why theory gives no limit for this row."""
    reason = "no row makes a scenario"
    for row in rows.tolist():
        try:
            scenario = resolve_scenario(results.build_scenario(row))
            parameters = flatten_scenario(scenario)
            models = model_loops(declare_scenario(scenario), parameters)
        except TurtlelogError as err:
            reason = str(err)
            continue
        model = next((one for one in models if one.loop.name == name), None)
        if model is None:
            return "theory draws no line, as the law has no such loop"
        if model.reason:
            return f"theory draws no line: {model.reason}"
        if hides_stability(parameters):
            hiding = [key for key in model.neglected if hides_stability({key: parameters[key]})]
            hidden = ", ".join(model.describe_neglected(hiding))
            return f"theory draws no line, as it leaves out {hidden}"
        return model
    return f"theory draws no line: {reason}"


def find_borders(
    view: SweptView, metric: SweptMetric, limits: Sequence[LoopLimits]
) -> list[Border] | None:
    """Return where a measured verdict changes along its loop's gain, with the theoretical limit.

    There is a border for each value of the other axis. The result is None if the metric is not true
    or false, if its loop's gain is not an axis, or if rows were chosen at random.
    """
    own = next((one for one in limits if one.loop == metric.loop), None)
    if not metric.is_verdict or own is None or view.results.is_sampled:
        return None
    values = fill_cells(view, metric).values
    columns = values.T if own.gain is view.y else values
    pairs = enumerate(zip(columns, own.columns, strict=True))
    return [_find_border(place, column, own.gain.numbers, one) for place, (column, one) in pairs]


def tell_borders(borders: Sequence[Border]) -> str:
    """Return a comparison of borders with theory, as sentences."""
    known = [border.is_near for border in borders if border.is_near is not None]
    told = []
    if known:
        columns = describe_count(len(known), "column")
        told.append(
            f"the border lies within one cell of theory's line in {sum(known)} of {columns}"
        )
    without = [one for one in borders if one.is_near is None and one.verdict is not None]
    kinds = Counter((one.verdict, one.is_mixed, one.agrees) for one in without)
    for (verdict, is_mixed, agrees), count in kinds.items():
        columns = describe_count(count, "column")
        they = "has no border: it is" if count == 1 else "have no border: they are"
        text = f"{columns} {they} {'stable' if verdict else 'unstable'} at every measured gain"
        text += " in most seeds" if is_mixed else ""
        told.append(text + (", as in theory" if agrees else ""))
    return "; ".join(told) or "no border beside a limit of theory"


def _find_border(place: int, verdicts: Values, gains: Values, limit: ColumnLimits | None) -> Border:
    unstable = np.flatnonzero(verdicts < 0.5)
    first = int(unstable[0]) if len(unstable) else len(gains)
    stable = np.flatnonzero(verdicts[:first] >= 0.5)
    last = int(stable[-1]) if len(stable) else -1
    is_stable_again = bool((verdicts[first:] >= 0.5).any())
    is_measured = bool(np.isfinite(verdicts).any())
    has_border = is_stable_again or (len(unstable) > 0 and len(stable) > 0)
    theory = None if limit is None or len(limit.stable) != 1 else limit.stability
    near: bool | None = None
    if theory is not None and is_measured:
        step = int(np.searchsorted(gains, theory))
        # Theory agrees if its border is between the two neighbouring gains, or one cell beside.
        near = last <= step <= first + 1 and not is_stable_again
        if near and not has_border:
            near = None
    return Border(
        place=place,
        last_stable=None if last < 0 else float(gains[last]),
        first_unstable=None if first == len(gains) else float(gains[first]),
        theory=theory,
        verdict=None if has_border or not is_measured else not len(unstable),
        is_near=near,
        is_mixed=bool(((verdicts > 0.0) & (verdicts < 1.0)).any()),
    )


def describe_limits(limit: ColumnLimits | None) -> Mapping[str, Any] | None:
    """Return the limits of a column for JSON."""
    if limit is None:
        return None
    return {
        "stability": limit.stability,
        "overshoot": limit.overshoot,
        "stable": [list(ends) for ends in limit.stable],
        "stable_with_most_dead_time": limit.grown and [list(ends) for ends in limit.grown],
    }


_LEAST_ROWS: Final = 10
"""Smallest sample; with fewer rows, chance gives correlations of 0.65 in one of 20 cases."""

_NORMAL_95: Final = 1.959964
"""Central 95 % of the normal distribution. Chance correlates n ranks by 1 / sqrt(n - 1)."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sensitivity:
    """Range of a metric along one key.

    `least`, `most`, their places and `others` are None for a sample. `others` are the smallest and
    largest `most` minus `least` with the other keys fixed at other values, if there are any.
    """

    axis: SweptAxis  # the key, or the keys that vary together
    least: float | None = None  # smallest value of the metric along the key
    most: float | None = None  # largest value of the metric along the key
    least_place: int | None = None  # place of the smallest value on the axis
    most_place: int | None = None  # place of the largest value
    correlation: float | None = None  # Spearman's rank correlation; None for a grid
    left_out: int = 0  # number of rows along the key without a value
    others: tuple[float, float] | None = None  # ranges elsewhere

    @property
    def size(self) -> float:
        """Size of the key's effect: range, or magnitude of the correlation."""
        if self.correlation is not None:
            return abs(self.correlation)
        return 0.0 if self.least is None or self.most is None else self.most - self.least


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sensitivities:
    """Ranges of a metric along each key of a sweep.

    `chance` and `explained` are None for a grid. `explained` is None, too, if a key has words.
    """

    metric: SweptMetric  # the metric
    keys: tuple[Sensitivity, ...]  # sensitivities, largest first
    center: float | None = None  # value of the metric at the fixed values of all keys, if any
    held: str = ""  # values at which all keys are fixed, in words; empty for a sample
    chance: float | None = None  # magnitude below which 95 % of independent correlations lie
    explained: float | None = None  # share of the ranks' variance by all keys, 0 to 1
    rows: int = 0  # number of rows with a value, for a sample
    notes: tuple[str, ...] = ()  # parts left out, in sentences


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
    lines = np.moveaxis(cube, number, 0).reshape(len(line), -1)
    whole = lines[:, np.isfinite(lines).all(axis=0)]  # those with a value at every place
    ranges = whole.max(axis=0) - whole.min(axis=0)
    has_others = lines.shape[1] > 1 and len(ranges) > 0
    return Sensitivity(
        axis=axes[number],
        least=float(line[low]),
        most=float(line[high]),
        least_place=low,
        most_place=high,
        left_out=left_out,
        others=(float(ranges.min()), float(ranges.max())) if has_others else None,
    )


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
    found, whole = [], ranks - ranks.mean()
    for axis, column in zip(numeric, columns, strict=True):
        own = column - column.mean()
        scale = math.sqrt(float(own @ own) * float(whole @ whole))
        correlation = float(own @ whole) / scale if scale else 0.0  # 0 if the key is constant
        found.append(Sensitivity(axis=axis, correlation=correlation))
    design = np.column_stack([np.ones(rows), *columns])
    rest = ranks - design @ np.linalg.lstsq(design, ranks, rcond=None)[0]
    explained = 1.0 - float(rest @ rest) / float(whole @ whole)
    return Sensitivities(
        metric=metric,
        keys=tuple(sorted(found, key=lambda one: -one.size)),
        chance=_NORMAL_95 / math.sqrt(rows - 1),
        explained=explained if len(numeric) == len(axes) else None,
        rows=rows,
        notes=tuple(notes),
    )


def _rank(values: Values) -> Values:
    """Return ranks from 0. Equal values share the mean of their ranks."""
    _, places, counts = np.unique(values, return_inverse=True, return_counts=True)
    ends = np.cumsum(counts)
    return np.asarray((ends - (counts + 1) / 2.0)[places], dtype=np.float64)
