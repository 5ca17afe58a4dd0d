"""Maps of a sweep: metrics over two keys as colours, with limits of the gain."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import BoundaryNorm, ListedColormap, LogNorm, Normalize
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from turtlelog.charts.curves import Values
from turtlelog.charts.palette import (
    OVERSHOOT_ON_CELLS,
    UNSTABLE,
    VERDICTS,
    choose_shades,
    to_hex,
)
from turtlelog.display import cut_name
from turtlelog.draw.figures.page import STROKES, fix_style, to_rgb
from turtlelog.sweep.sweep_analysis import ColumnLimits, LoopLimits, choose_limits
from turtlelog.sweep.sweep_table import SweptAxis, SweptMetric
from turtlelog.sweep.sweep_views import SweptView, fill_cells

_MOST_VECTORS: Final = 2_500  # cells stored as shapes, 100 bytes each; more become pixels
_MOST_WORDS: Final = 12  # labels along a side: each takes 4 mm of a column

_FEW_NUMBERS: Final = 6
"""Largest number of values with a label each; with so few, a scale would suggest values between."""

_LONGEST: Final = 16  # longest label [letters]
_MOST_EDGED: Final = 1_000  # dots with an edge; of more, smaller dots only edges would be visible

_HALO: Final = 1.4
"""Width of the white border around a line, which separates it from any colour below [points]."""

VERDICT_COLORS: Final = tuple(map(to_hex, VERDICTS))

VERDICT_WORDS: Final = ("not stable", "stable for some seeds", "stable")

DECADES: Final = 100.0
"""Ratio of largest to smallest value from which colours and axes are logarithmic. On a linear
scale, the whole lower decade would share 3 of 256 shades, or be as thin as a line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TheoryLimit:
    """A limit of a gain from theory."""

    text: str  # text in a legend, before `(theory)`
    list_ends: Callable[[ColumnLimits], Iterable[float]]  # gains at the limit in a column
    looks: Mapping[str, Any]  # style of its line
    is_of_most_dead_time: bool = False  # whether it is for the most dead time, not for the least


LIMITS: Final = (
    TheoryLimit(
        text="instability",
        list_ends=lambda column: _list_borders(column.stable),
        looks={"color": to_hex(UNSTABLE), "linewidth": 1.2},
    ),
    TheoryLimit(
        text="instability with the most dead time",
        list_ends=lambda column: _list_borders(column.grown or ()),
        looks={"color": to_hex(UNSTABLE), "linewidth": 1.0, "linestyle": STROKES["dotted"]},
        is_of_most_dead_time=True,
    ),
    TheoryLimit(
        text="overshoot begins",
        list_ends=lambda column: () if column.overshoot is None else (column.overshoot,),
        looks={
            "color": to_hex(OVERSHOOT_ON_CELLS),
            "linewidth": 1.0,
            "linestyle": STROKES["dashed"],
        },
    ),
)
"""Theory's limits in the order of a legend."""


def draw_map_panel(
    axes: Axes,
    view: SweptView,
    metric: SweptMetric,
    limits: Sequence[LoopLimits],
    reasons: Mapping[str, tuple[str, str]],
) -> dict[str, Any]:
    """Draw a metric over the two axes of a view, and return the legend entries with their styles.

    The limits are from `find_loop_limits`, the text and hatch for each reason for a missing value
    from `group_reasons`.
    """
    if view.results.is_sampled:
        named = _draw_points(axes, view, metric)
    else:
        named = _draw_cells(axes, view, metric, reasons)
    ends = []
    for side, axis in zip("xy", view.axes, strict=True):
        edges = find_edges(axis)
        ends.append((float(edges[0]), float(edges[-1])))
        if is_logarithmic(axis):
            axes.set(**{f"{side}scale": "log"})
        axes.set(**{f"{side}lim": ends[-1], f"{side}label": axis.label})
        mark_places(axes, side, axis)
    axes.set_title(label_swept_metric(metric), pad=4.0)
    axes.grid(visible=False)
    found = choose_limits(limits, metric)
    if found is not None:
        named |= _draw_limits(axes, view, metric, found, ends)
    return named


def mark_places(axes: Axes, side: str, axis: SweptAxis) -> None:
    """Write an axis' values, or every second, third ...; more than a few numbers get a scale."""
    if axis.is_number and len(axis) > _FEW_NUMBERS:
        return
    places = range(0, len(axis), -(-len(axis) // _MOST_WORDS))
    texts = [cut_name(axis.tell_place(place), _LONGEST, mark="…") for place in places]
    drawn = axes.xaxis if side == "x" else axes.yaxis
    numbers = axis.numbers.tolist()
    labels = [text.replace("$", r"\$") for text in texts]
    drawn.set_ticks([], minor=True)
    drawn.set_ticks([numbers[place] for place in places], labels=labels)


def _draw_cells(
    axes: Axes, view: SweptView, metric: SweptMetric, reasons: Mapping[str, tuple[str, str]]
) -> dict[str, Any]:
    cells = fill_cells(view, metric)
    values = scale_values(metric, cells.values)
    edges = find_edges(view.x), find_edges(view.axes[1])
    looks: dict[str, Any] = {"rasterized": values.size > _MOST_VECTORS, "zorder": 1.0}
    # Viewers show seams between adjacent shapes when they smooth edges; a line covers them.
    hatched = {cell: reasons[reason] for cell, reason in cells.reasons.items()}
    named = _hatch_cells(axes, edges, hatched, looks)
    looks |= {} if looks["rasterized"] else {"edgecolors": "face", "linewidth": 0.3}
    if metric.is_verdict:
        values, colors = find_verdict_classes(values), ListedColormap(list(VERDICT_COLORS))
        norm = BoundaryNorm([-0.5, 0.5, 1.5, 2.5], 3)
        axes.pcolormesh(*edges, np.ma.masked_invalid(values), cmap=colors, norm=norm, **looks)
        return _name_verdicts(values) | named
    scale = build_scale(values)
    shown: dict[str, Any] = {"cmap": _COLORS, "norm": scale.norm, **looks}
    _add_bar(axes, axes.pcolormesh(*edges, np.ma.masked_invalid(values), **shown), scale)
    return named


def _draw_points(axes: Axes, view: SweptView, metric: SweptMetric) -> dict[str, Any]:
    x, y = (axis.numbers[axis.places[view.rows]] for axis in view.axes)
    values = scale_values(metric, metric.values[view.rows])
    known = np.isfinite(values)
    size = min(max(1500.0 / max(len(values), 1), 1.5), 22.0)
    looks: dict[str, Any] = {"rasterized": len(values) > _MOST_VECTORS, "zorder": 2.0}
    named: dict[str, Any] = {}
    if not known.all():
        cross: dict[str, Any] = {"marker": "x", "color": "0.5", "s": size, "linewidth": 0.6}
        axes.scatter(x[~known], y[~known], **cross, **looks)
        mark = Line2D([], [], color="0.5", marker="x", linestyle="", markersize=4.0)
        named["no value"] = mark  # the printed lines give the reason
    edge = 0.25 if len(values) <= _MOST_EDGED else 0.0
    looks |= {"s": size, "linewidth": edge, "edgecolor": "0.3"}
    if metric.is_verdict:
        classes = find_verdict_classes(values[known])
        colors = [VERDICT_COLORS[int(one)] for one in classes]
        axes.scatter(x[known], y[known], c=colors, **looks)
        return _name_verdicts(classes) | named
    scale = build_scale(values)
    order = np.flatnonzero(known)[np.argsort(values[known], kind="stable")]
    looks |= {"c": values[order], "cmap": _COLORS, "norm": scale.norm}
    _add_bar(axes, axes.scatter(x[order], y[order], **looks), scale)
    return named


_COLORS: Final = ListedColormap([*map(to_rgb, choose_shades(256))], name="turtlelog")


class ColorScale(NamedTuple):
    """Mapping of a metric's values to 0 to 1, and the pointed ends of its bar."""

    norm: Normalize
    extend: str


def _add_bar(axes: Axes, drawn: Any, scale: ColorScale) -> None:
    bar = axes.figure.colorbar(drawn, ax=axes, extend=scale.extend, fraction=0.06, pad=0.02)
    bar.outline.set_linewidth(0.4)
    bar.ax.tick_params(labelsize=6.5, width=0.5, length=2.0)
    bar.ax.grid(visible=False)


def _name_verdicts(classes: Values) -> dict[str, Any]:
    return {
        VERDICT_WORDS[number]: Patch(facecolor=VERDICT_COLORS[number], edgecolor="0.6", lw=0.4)
        for number in (2, 1, 0)
        if (classes == number).any()
    }


def _hatch_cells(
    axes: Axes,
    edges: tuple[Values, Values],
    hatched: Mapping[int, tuple[str, str]],
    looks: Mapping[str, Any],
) -> dict[str, Any]:
    """Draw cells without a value, with one hatch for each reason."""
    groups: dict[tuple[str, str], list[int]] = {}
    for cell, one in hatched.items():
        groups.setdefault(one, []).append(cell)
    named = {}
    for (text, hatch), cells in groups.items():
        shapes = _join_cells(edges, np.array(cells))
        grey = {**_VALUELESS, "hatch": hatch, "linewidth": 0.0}
        axes.add_collection(PolyCollection(shapes, **grey, **looks))
        named[text] = Patch(**{**grey, "linewidth": 0.4})
    return named


def _join_cells(edges: tuple[Values, Values], cells: NDArray[np.int64]) -> list[Values]:
    """Return the corners of rectangles that cover cells. Vertical neighbours are joined."""
    x, y = edges
    column, row = np.divmod(np.sort(cells % (len(x) - 1) * len(y) + cells // (len(x) - 1)), len(y))
    is_first = np.r_[True, (np.diff(row) != 1) | (np.diff(column) != 0)]
    first = np.flatnonzero(is_first)
    last = np.r_[first[1:], len(row)] - 1
    left, right = x[column[first]], x[column[first] + 1]
    low, high = y[row[first]], y[row[last] + 1]
    corners = np.array([[left, low], [right, low], [right, high], [left, high]])
    return list(corners.transpose(2, 0, 1))


def _draw_limits(
    axes: Axes,
    view: SweptView,
    metric: SweptMetric,
    found: LoopLimits,
    ends: Sequence[tuple[float, float]],
) -> dict[str, Any]:
    """Draw theory's limits of a gain in the columns, or rows, of the other axis."""
    is_upright = found.gain is view.x
    other = view.axes[1] if is_upright else view.x
    low, high = ends[0] if is_upright else ends[1]
    named: dict[str, Any] = {}
    for limit in LIMITS:
        looks = limit.looks
        for branch in list_branches(found.columns, limit):
            if not ((branch > low) & (branch < high)).any():
                continue
            at, values = other.numbers, branch
            if view.results.is_sampled:
                at, values = at[np.isfinite(branch)], branch[np.isfinite(branch)]
            else:
                at, values = np.repeat(find_edges(other), 2)[1:-1], np.repeat(branch, 2)
            line = (values, at) if is_upright else (at, values)
            axes.plot(*line, color="white", linewidth=looks["linewidth"] + _HALO, zorder=2.9)
            axes.plot(*line, **looks, zorder=3.0)
            named[name_limit(found, metric, limit)] = Line2D([], [], **looks)
    return named


def name_limit(found: LoopLimits, metric: SweptMetric, limit: TheoryLimit) -> str:
    """Return the legend text of a limit. The metric of a loop already names the loop.

    Figures of runs draw limits for the dead times of the runs, which may be longer.
    """
    can_grow = any(one is not None and one.grown is not None for one in found.columns)
    is_least = can_grow and not limit.is_of_most_dead_time
    name = f"{limit.text} (theory{', least dead time' if is_least else ''})"
    return name if metric.loop == found.loop else f"{found.loop}: {name}"


_HATCHES: Final = ("", "////", "....", "xxxx")
"""Hatches for the reasons of missing values. The last hatch is for all other reasons."""

_VALUELESS: Final = fix_style(facecolor="0.93", edgecolor="0.6")


def build_scale(values: Values) -> ColorScale:
    """Return the colour scale of values, without NaN."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 1.0)
    is_logarithmic, extend = low > 0.0 and high / low >= DECADES, "neither"
    if len(known) and not is_logarithmic:
        inner_low, inner_high = (float(one) for one in np.quantile(known, [0.05, 0.95]))
        room = _OUTLYING * (inner_high - inner_low)
        is_below, is_above = 0.0 < room < inner_low - low, 0.0 < room < high - inner_high
        low, high = inner_low if is_below else low, inner_high if is_above else high
        extend = ("neither", "max", "min", "both")[2 * is_below + is_above]
    if low == high:  # one colour, in the middle of a bar that shows the value
        spread = abs(low) * 1e-3 or 1e-3
        low, high = low - spread, high + spread
    return ColorScale((LogNorm if is_logarithmic else Normalize)(low, high), extend)


def group_reasons(metrics: Sequence[SweptMetric]) -> dict[str, tuple[str, str]]:
    """Return legend text and hatch of each reason, most frequent first; rare ones share a hatch."""
    counts = Counter(reason for one in metrics for reason in one.reasons if reason is not None)
    order = [reason for reason, _ in counts.most_common()]
    few = order if len(order) <= len(_HATCHES) else order[: len(_HATCHES) - 1]
    others = dict.fromkeys(order, ("no value: others", _HATCHES[-1]))
    words = {one: (f"no value: {one}", hatch) for one, hatch in zip(few, _HATCHES, strict=False)}
    return {**others, **words}


_OUTLYING: Final = 10.0
"""Distance from the central 90 % of values, as a multiple of their range, beyond which values share
the last colour. The bar then has a pointed end. Without this, all other values would have less than
a tenth of the colours."""


def find_verdict_classes(values: Values) -> Values:
    """Return 0 for unstable, 1 for in between, 2 for stable; NaN stays NaN."""
    return np.where(values >= 1.0, 2.0, np.where(values <= 0.0, 0.0, values * 0.0 + 1.0))


def label_swept_metric(metric: SweptMetric) -> str:
    """Return a metric's name with its unit; angles are in degrees."""
    unit = "deg" if metric.unit == "rad" else metric.unit
    return metric.name + (f" [{unit}]" if unit not in {"", "1"} else "")


def scale_values(metric: SweptMetric, values: Values) -> Values:
    """Return values in their display unit."""
    return np.degrees(values) if metric.unit == "rad" else values


def find_edges(axis: SweptAxis) -> Values:
    """Return the edges of the cells of an axis, halfway between the centres of the cells."""
    numbers = axis.numbers
    if len(numbers) == 1:
        half = abs(float(numbers[0])) * 0.1 or 0.5
        return np.array([numbers[0] - half, numbers[0] + half])
    if is_logarithmic(axis):
        return np.exp(_find_middles(np.log(numbers)))
    return _find_middles(numbers)


def is_logarithmic(axis: SweptAxis) -> bool:
    """Return whether the numbers of an axis have equal ratios rather than equal differences."""
    numbers = axis.numbers
    if not axis.is_number or len(numbers) < 3 or numbers[0] <= 0.0:
        return False
    steps, ratios = np.diff(numbers), np.diff(np.log(numbers))
    return bool(ratios.std() / ratios.mean() < 0.999 * steps.std() / steps.mean())


def _find_middles(numbers: Values) -> Values:
    middles = numbers[:-1] / 2.0 + numbers[1:] / 2.0
    first, last = 2.0 * numbers[0] - middles[0], 2.0 * numbers[-1] - middles[-1]
    return np.concatenate([[first], middles, [last]])


def list_branches(columns: Sequence[ColumnLimits | None], limit: TheoryLimit) -> list[Values]:
    """Return the values of a limit, one for each column; NaN for no limit.

    If a loop is stable in several ranges of its gain, or not from 0 on, each end is a branch.
    """
    ends = [() if one is None else (*limit.list_ends(one),) for one in columns]
    most = max(map(len, ends), default=0)
    # Counted from the top: if there is any end, there is a highest end.
    padded = [[*([math.nan] * (most - len(one))), *one] for one in ends]
    return [np.array(values, dtype=np.float64) for values in zip(*padded, strict=True)]


def _list_borders(stable: Iterable[tuple[float, float]]) -> Iterator[float]:
    """Yield the gains at which a loop becomes stable or unstable."""
    yield from (end for pair in stable for end in pair if end > 0.0 and math.isfinite(end))
