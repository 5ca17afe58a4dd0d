"""Theoretical limits of a gain in every column of a map, and the measured border."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import describe_count
from turtlelog.errors import TurtlelogError
from turtlelog.scenario import flatten_scenario, resolve_scenario
from turtlelog.simulate import declare_scenario
from turtlelog.sweep.table.swept_results import (
    SweptAxis,
    SweptMetric,
    SweptResults,
    list_declared_loops,
)
from turtlelog.sweep.table.swept_views import SweptView, fill_cells, is_gain
from turtlelog.theory import LoopModel, find_stable_gains, hides_stability, model_loops
from turtlelog.theory.exact_gains import LoopDesign, find_p_without_overshoot

Values = NDArray[np.float64]

_MOST_DRAWN: Final = 48
"""Largest number of places of a sampled key at which theory is computed: one per 2 mm of a
figure."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnLimits:
    """Theoretical limits of the gain in one column.

    Attributes:
        stable: Intervals of the gain in which the loop is stable.
        overshoot: Gain from which the loop overshoots; None if the loop is not purely proportional.
        grown: Stable intervals with the longer dead time of full queues; None if the dead time
            cannot grow.
    """

    stable: tuple[tuple[float, float], ...]
    overshoot: float | None
    grown: tuple[tuple[float, float], ...] | None = None

    @property
    def stability(self) -> float | None:
        """Gain from which the loop is unstable; None if no gain is stable."""
        return self.stable[-1][1] if self.stable else None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoopLimits:
    """Theoretical limits of a loop over the axes of a view.

    Attributes:
        loop: Name of the loop.
        gain: Axis of its gain.
        columns: Limits for each place of the other axis; None if theory gives no limits.
        notes: Reasons for missing limits, and parts that theory leaves out, in sentences.
    """

    loop: str
    gain: SweptAxis
    columns: tuple[ColumnLimits | None, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Border:
    """Border along the gain at which a loop becomes unstable, in one column.

    Attributes:
        place: Place of the column on the other axis.
        last_stable: Largest gain below the border that was measured as stable; None if no gain was.
        first_unstable: Smallest gain that was measured as unstable; None if no gain was.
        theory: Gain from which the loop is unstable in theory; None if theory gives no limit.
        is_near: Whether the measured and the theoretical border are within one cell; None if one is
            unknown.
    """

    place: int
    last_stable: float | None
    first_unstable: float | None
    theory: float | None
    is_near: bool | None


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
        key = (
            replace(pid, kp=1.0),
            settings["process"],
            settings["period_s"],
            model.most_dead_time_s,
        )
        if key not in known:
            known[key] = _compute(model)
        columns.append(known[key])
        if model.most_dead_time_s is not None:
            notes.setdefault(f"the dead time is the least; {model.growth} may let it grow", [])
    told = []
    for text, places in notes.items():
        where = ""
        if other is not None and 0 < len(places) < len(columns):
            where = f" where {other.name} is {_tell_places(other, places)}"
        told.append(f"{name}: {text}{where}")
    return LoopLimits(loop=name, gain=gain, columns=tuple(columns), notes=tuple(told))


def _tell_places(axis: SweptAxis, places: Sequence[int]) -> str:
    texts = [axis.tell_place(place) for place in places]
    return ", ".join(texts) if len(texts) <= 4 else f"{texts[0]}, {texts[1]} ... {texts[-1]}"


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
            hidden = [
                text
                for text, key in ((text, text.partition(" = ")[0]) for text in model.left_out)
                if hides_stability({key: parameters[key]})
            ]
            return f"theory draws no line, as it leaves out {', '.join(hidden)}"
        return model
    return f"theory draws no line: {reason}"


def _compute(model: LoopModel) -> ColumnLimits:
    pid, settings = model.require()
    process, period_s = settings["process"], settings["period_s"]
    grown = None
    if model.most_dead_time_s is not None:
        grown = find_stable_gains(pid, **model.require_latest())
    is_proportional = not pid.ki and not pid.kd
    design = LoopDesign(process=process, period_s=period_s, filter_s=pid.filter_s)
    return ColumnLimits(
        stable=find_stable_gains(pid, **settings),
        overshoot=find_p_without_overshoot(design) if is_proportional else None,
        grown=grown,
    )


def find_borders(
    view: SweptView, metric: SweptMetric, limits: Sequence[LoopLimits]
) -> list[Border] | None:
    """Return where a measured verdict changes along its loop's gain, with the theoretical limit.

    Args:
        view: Rows that are shown.
        metric: One of the view's metrics.
        limits: Result of `find_loop_limits`.

    Returns:
        A border for each value of the other axis. The result is None if the metric is not true or
            false, if its loop's gain is not an axis, or if rows were chosen at random.
    """
    own = next((one for one in limits if one.loop == metric.loop), None)
    if not metric.is_verdict or own is None or view.results.is_sampled:
        return None
    values = fill_cells(view, metric).values
    columns = values.T if own.gain is view.y else values
    return [
        _find_border(place, column, own.gain.numbers, limit)
        for place, (column, limit) in enumerate(zip(columns, own.columns, strict=True))
    ]


def tell_borders(borders: Sequence[Border]) -> str:
    """Return a comparison of borders with theory, as sentences."""
    known = [border.is_near for border in borders if border.is_near is not None]
    if not known:
        return "no border beside a limit of theory"
    columns = describe_count(len(known), "column")
    return f"the border lies within one cell of theory's line in {sum(known)} of {columns}"


def _find_border(place: int, verdicts: Values, gains: Values, limit: ColumnLimits | None) -> Border:
    unstable = np.flatnonzero(verdicts < 0.5)
    first = int(unstable[0]) if len(unstable) else len(gains)
    stable = np.flatnonzero(verdicts[:first] >= 0.5)
    last = int(stable[-1]) if len(stable) else -1
    theory = None if limit is None or len(limit.stable) != 1 else limit.stability
    near = None
    if theory is not None and np.isfinite(verdicts).any():
        step = int(np.searchsorted(gains, theory))
        # Theory agrees if its border is between the two neighbouring gains, or one cell beside.
        near = last <= step <= first + 1 and not (verdicts[first:] >= 0.5).any()
    return Border(
        place=place,
        last_stable=None if last < 0 else float(gains[last]),
        first_unstable=None if first == len(gains) else float(gains[first]),
        theory=theory,
        is_near=near,
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
