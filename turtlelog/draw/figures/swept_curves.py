"""Metrics of a sweep over one key, with a line per value of a second key, and theory's limits."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from turtlelog.charts.map_values import (
    DECADES,
    VERDICT_WORDS,
    is_logarithmic,
    label_metric,
    list_branches,
    scale_values,
)
from turtlelog.charts.palette import choose_run_colors
from turtlelog.draw.figures.map_figure import LIMITS, mark_places, name_limit
from turtlelog.draw.figures.page import choose_colors, to_rgb
from turtlelog.sweep.gain_borders import LoopLimits, choose_limits
from turtlelog.sweep.table.swept_results import SweptAxis, SweptMetric, format_key_value
from turtlelog.sweep.table.swept_views import SweptView, fill_cells

Values = NDArray[np.float64]

_MOST_LINES: Final = 12
"""Largest number of values of a second key with a line each; neighbouring colours remain
distinct."""

_MOST_TOLD: Final = 6
"""Largest number of omitted values that a legend lists; for more, the legend gives the step."""

_ALIKE: Final = 0.005
"""Difference below which curves are one line in print: a third of a millimetre, as a share of a
panel's height."""

_RAMP_COLORS: Final = 256

_MOST_MARKED: Final = 40
"""Largest number of key values with a dot on the line: one per 2 mm of a panel."""

_MOST_DOTS: Final = 500
"""Largest number of sample rows with large dots, which cover a tenth of a panel."""


def choose_curve_axes(
    view: SweptView, limits: Sequence[LoopLimits]
) -> tuple[SweptAxis, SweptAxis | None]:
    """Return the axis along curves, preferably a gain, and the axis with one line per value."""
    if view.y is None:
        return view.x, None
    gains = [one.gain for one in limits]
    return (view.y, view.x) if view.y in gains and view.x not in gains else (view.x, view.y)


def choose_series(series: SweptAxis | None) -> list[int]:
    """Return the indices of a second axis that get a line: all, or a few at equal steps."""
    if series is None:
        return [0]
    count = min(len(series), _MOST_LINES)
    return [int(place) for place in np.linspace(0, len(series) - 1, count).round()]


def draw_curves(
    axes: Axes, view: SweptView, metric: SweptMetric, limits: Sequence[LoopLimits]
) -> dict[str, Any]:
    """Draw a metric against a key.

    Args:
        axes: Axes to draw on.
        view: View with one or two axes.
        metric: One of the view's metrics.
        limits: Limits from theory, as from `find_loop_limits`.

    Returns:
        Legend entries with their styles.
    """
    along, series = choose_curve_axes(view, limits)
    if view.results.is_sampled and len(view.results.axes) > 1:
        return _draw_sample(axes, view, metric, along)
    found = choose_limits([one for one in limits if one.gain is along], metric)
    cells = fill_cells(view, metric)
    parts = [
        scale_values(metric, one if along is view.x else one.T)
        for one in (cells.values, cells.least, cells.most)
    ]
    valueless = np.zeros(view.shape, dtype=bool)
    valueless.flat[list(cells.reasons)] = True
    valueless = valueless if along is view.x else valueless.T
    named: dict[str, Any] = {}
    theory: dict[str, Any] = {}
    places = choose_series(series)
    is_one = found is not None and len({*found.columns}) == 1
    for color, place in zip(_color_series(series, len(places)), places, strict=True):
        mean, least, most = (part[place] for part in parts)
        name = None if series is None else _name_value(series, place)
        named |= _draw_line(axes, along, mean, color, name)
        if valueless[place].any():
            named |= _mark_valueless(axes, along.numbers[valueless[place]], color)
        if view.seeds > 1:
            axes.fill_between(along.numbers, least, most, color=color, alpha=0.2, linewidth=0.0)
            named["least to greatest over the seeds"] = Patch(facecolor="0.8")
        if found is not None and not (theory and is_one):
            own = None if series is None or is_one else color
            theory |= _draw_limits(axes, found, metric, along, place, own)
    _set_axes(axes, along, metric, parts[0][places])
    _tell_alike(axes, parts[0][places])
    if series is not None and len(places) < len(series):
        named[_tell_left_out(series, places)] = Line2D([], [], linestyle="")
    return named | theory


def _color_series(series: SweptAxis | None, count: int) -> list[tuple[float, ...]]:
    """Return a colour for each line. Numbers have colours of the ramp, in their order."""
    if series is None or not series.is_number or count == 1:
        return choose_colors(count)
    # The ramp is that of more runs than hues; its ends are the least and the greatest value.
    ramp = choose_run_colors(_RAMP_COLORS)
    rows = np.linspace(0, _RAMP_COLORS - 1, count).round().astype(int)
    return [to_rgb(ramp[row]) for row in rows]


def _name_value(series: SweptAxis, place: int) -> str:
    """Return the legend text of a line: `law.kp_linear = 4`."""
    pairs = zip(series.keys, series.values[place], strict=True)
    return ", ".join(f"{key} = {format_key_value(value)}" for key, value in pairs)


def _tell_left_out(series: SweptAxis, places: Sequence[int]) -> str:
    """Return the values of a second key that have no line, as text."""
    left = [place for place in range(len(series)) if place not in places]
    if len(left) <= _MOST_TOLD:
        return f"left out: {', '.join(series.tell_place(place) for place in left)}"
    return f"left out: {len(left)} of {len(series)} values, in between"


def _tell_alike(axes: Axes, curves: Values) -> None:
    """Write above a panel how many of its curves coincide."""
    known = curves[np.isfinite(curves)]
    least = _ALIKE * float(np.ptp(known)) if len(known) else 0.0
    groups: list[Values] = []
    for curve in curves:
        if not any(_is_alike(curve, other, least) for other in groups):
            groups.append(curve)
    if len(groups) < len(curves):
        told = (
            f"{len(curves)} curves coincide in {len(groups)} line{'s' if len(groups) > 1 else ''}"
        )
        axes.set_title(told, fontsize=7.0, color="0.35", loc="right")


def _is_alike(one: Values, other: Values, least: float) -> bool:
    is_equal = np.isnan(one) & np.isnan(other) | (np.abs(one - other) <= least)
    return bool(is_equal.all())


def _draw_line(
    axes: Axes, along: SweptAxis, values: Values, color: Any, name: str | None
) -> dict[str, Any]:
    numbers, known = along.numbers, np.isfinite(values)
    if along.is_number:
        axes.plot(numbers, values, color=color, linewidth=0.9, zorder=2.0)
    # A value between two missing values has no line on either side.
    alone = known & ~np.r_[False, known[:-1]] & ~np.r_[known[1:], False]
    shown = known if len(numbers) <= _MOST_MARKED else alone
    axes.plot(numbers[shown], values[shown], "o", color=color, markersize=2.6, zorder=2.1)
    if name is None:
        return {}
    return {name: Line2D([], [], color=color, marker="o", markersize=2.6, linewidth=0.9)}


def _mark_valueless(axes: Axes, numbers: Values, color: Any) -> dict[str, Any]:
    """Mark rows without a value at the upper edge."""
    mark: dict[str, Any] = {"color": color, "marker": "x", "linestyle": "", "ms": 3.0}
    at = np.full(len(numbers), 0.985)
    axes.plot(numbers, at, transform=axes.get_xaxis_transform(), **mark)
    return {"no value": Line2D([], [], **{**mark, "color": "0.4"})}


def _draw_sample(
    axes: Axes, view: SweptView, metric: SweptMetric, along: SweptAxis
) -> dict[str, Any]:
    """Draw a dot for each row, because random rows do not share values of another key."""
    (color,) = choose_colors(1)
    numbers = along.numbers[along.places[view.rows]]
    values = scale_values(metric, metric.values[view.rows])
    known = np.isfinite(values)
    size = 2.6 if len(values) <= _MOST_DOTS else 1.2
    axes.plot(numbers[known], values[known], "o", color=color, markersize=size, mew=0.0)
    _set_axes(axes, along, metric, values)
    return {} if known.all() else _mark_valueless(axes, numbers[~known], color)


def _draw_limits(
    axes: Axes,
    found: LoopLimits,
    metric: SweptMetric,
    along: SweptAxis,
    place: int,
    color: Any,
) -> dict[str, Any]:
    """Draw theory's limits of one column as vertical lines, in the colour of its curve."""
    column = found.columns[place if len(found.columns) > 1 else 0]
    low, high = float(along.numbers[0]), float(along.numbers[-1])
    named: dict[str, Any] = {}
    for name, looks in LIMITS.items():
        for branch in list_branches([column], name):
            at = float(branch[0])
            if not low <= at <= high:
                continue
            own = {**looks, **({} if color is None else {"color": color})}
            axes.axvline(at, **own, zorder=1.5)
            grey = {} if color is None else {"color": "0.4"}
            named[name_limit(found, metric, name)] = Line2D([], [], **{**looks, **grey})
            if color is None:
                text = axes.text(at, 1.01, f"{at:.4g}", fontsize=6.2, color=looks["color"])
                text.set(transform=axes.get_xaxis_transform(), ha="center", va="bottom")
    return named


def _set_axes(axes: Axes, along: SweptAxis, metric: SweptMetric, values: Values) -> None:
    if is_logarithmic(along):
        axes.set_xscale("log")
    axes.set(xlabel=along.label, ylabel=label_metric(metric))
    mark_places(axes, "x", along)
    known = values[np.isfinite(values)]
    if metric.is_verdict:
        axes.set_yticks([0.0, 1.0], labels=[VERDICT_WORDS[0], VERDICT_WORDS[2]])
        axes.set_ylim(-0.15, 1.2)
    elif len(known) and known.min() > 0.0 and known.max() / known.min() >= DECADES:
        axes.set_yscale("log")
    axes.margins(x=0.03)
