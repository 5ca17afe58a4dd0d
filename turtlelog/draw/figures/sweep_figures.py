"""Figures of a sweep as files: maps over two keys, curves over one, sensitivities of all keys."""

import io
import math
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from turtlelog.charts.curves import Values
from turtlelog.charts.palette import UNSTABLE, choose_run_colors, to_hex
from turtlelog.display import describe_count
from turtlelog.draw.figures import map_figure, page as pages
from turtlelog.draw.figures.figure_curves import choose_colors, count_legend_columns
from turtlelog.draw.figures.page import REFERENCE, Page, to_rgb, use_looks
from turtlelog.errors import ShowError
from turtlelog.sweep.sweep_analysis import (
    LoopLimits,
    Sensitivities,
    Sensitivity,
    choose_limits,
    find_loop_limits,
    find_sensitivities,
    list_gain_keys,
)
from turtlelog.sweep.sweep_table import (
    SweepTable,
    SweptAxis,
    SweptMetric,
    read_swept_results,
    read_table_results,
)
from turtlelog.sweep.sweep_views import SweptView, choose_view, fill_cells, require_values

_PANEL_INCH: Final = 2.5  # height of a map with its title and the label of its lower side [inch]

_TORNADO_INCH: Final = 0.75
_BAR_INCH: Final = 0.34  # height of each bar of a tornado plot [inch]: two lines of text

_SQUEEZED: Final = 0.62
"""Smallest share of the usual height on a slide; on lower panels, labels of sides touch."""

_LETTERS_PER_INCH: Final = 16.0  # letters per inch of the notes below the panels, at 7 points

_LINE_INCH: Final = 0.14

_NARROWEST_INCH: Final = 2.6
"""Smallest width of a map next to another map [inch]; the bar and the side take one inch."""

MapKind = Literal["map", "curves", "tornado"]
"""Content of a sweep figure."""

_METHODS: Final = (
    "bars: range along each key, between the two values beside it; line: all keys held at",
    "Spearman's rank correlation; grey: 95 % of independent keys",
)
"""Descriptions of the sensitivities, in a grid and in a sample."""


def write_map_figure(
    view: SweptView,
    limits: Sequence[LoopLimits],
    path: str | Path,
    *,
    kind: MapKind = "map",
    page: Page | None = None,
) -> Path:
    """Write the metrics of a sweep as one figure, and return its path.

    Args:
        view: View from `choose_view`.
        limits: Limits from theory, as from `find_loop_limits`.
        path: File name with the suffix .pdf, .png or .svg.
        kind: Maps over two axes (for one axis, curves), curves over one axis, or the change of a
            metric along each key.
        page: Page format.

    Raises:
        ShowError: If the file cannot be written.
    """
    path = pages.require_figure_path(path)
    page = page or Page(kind="page")
    return pages.write_figure(lay_out(view, limits, kind, page), path, page)


def draw_map(  # noqa: PLR0913  (all but the first have defaults)
    table: SweepTable | str | Path,
    metrics: Sequence[str] | None = None,
    *,
    x: str | None = None,
    y: str | None = None,
    at: Mapping[str, Any] | None = None,
    kind: MapKind = "map",
    page: Page | None = None,
) -> Figure:
    """Return the drawn map of a sweep, which a notebook can show.

    Args:
        table: Table from `sweep_scenario`, or its file.
        metrics: Ids or patterns. Default: up to four metrics of the table.
        x: Key of the horizontal axis. Default: chosen automatically.
        y: Key of the vertical axis. Default: chosen automatically.
        at: Values of keys that are held constant.
        kind: Maps over two keys (for one key, curves), curves over one key, or the change of a
            metric along each key (`tornado`).
        page: Page format.

    Raises:
        SweepError: If a key does not vary, a metric does not exist, or no row has a value.
        LogError: If the file is not a table of a sweep.
    """
    if isinstance(table, SweepTable):
        results = read_table_results(table, metrics)
    else:
        results = read_swept_results(table, metrics)
    view = choose_view(results, x=x, y=y, at=at, gains=list_gain_keys(results))
    require_values(view)
    return lay_out(view, find_loop_limits(view), kind, page or Page(kind="page"))


def draw_sweep_svg(view: SweptView, limits: Sequence[LoopLimits], kind: MapKind) -> bytes:
    """Return the content of the .svg file that `write_map_figure` writes."""
    page, data = Page(kind="page"), io.BytesIO()
    pages.save_figure(lay_out(view, limits, kind, page), data, "svg", page)
    return data.getvalue()


@use_looks()
def lay_out(view: SweptView, limits: Sequence[LoopLimits], kind: MapKind, page: Page) -> Figure:
    """Return the drawn figure of a sweep; of a single axis, a map is drawn as curves."""
    kind = "curves" if view.y is None and kind == "map" else kind
    metrics = view.results.metrics
    found = [find_sensitivities(view.results, one, dict(view.held)) for one in metrics]
    most = max(len(one.keys) for one in found)
    height = _TORNADO_INCH + _BAR_INCH * most if kind == "tornado" else _PANEL_INCH
    rows, columns = _choose_grid(len(metrics), height, page)
    figure = pages.ShownFigure(figsize=(page.width_inch, height * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False)
    named: dict[str, Any] = {}
    reasons = map_figure.group_reasons(metrics)
    for number, axes in enumerate(grid.flat):
        if number >= len(metrics):
            axes.set_axis_off()
        elif kind == "tornado":
            _draw_tornado(axes, found[number])
        elif kind == "curves":
            named |= draw_curves(axes, view, metrics[number], limits)
        else:
            named |= map_figure.draw_map_panel(axes, view, metrics[number], limits, reasons)
    if kind == "tornado":
        words = [_METHODS[view.results.is_sampled], *filter(None, [found[0].held])]
        _write_below(figure, words)
    else:
        if len(limits) == 1:  # the only loop needs no name
            named = {one.removeprefix(f"{limits[0].loop}: "): look for one, look in named.items()}
        _add_legend(figure, named, view)
    page.fit(figure)
    return figure


def _write_below(figure: Figure, words: Sequence[str]) -> None:
    """Write lines below the panels, wrapped to the figure's width. The figure becomes higher."""
    letters = int(figure.get_figwidth() * _LETTERS_PER_INCH)
    lines = [line for one in words for line in textwrap.wrap(one, letters)]
    width, height = figure.get_size_inches()
    figure.set_size_inches(width, height + _LINE_INCH * (len(lines) - len(words)))
    figure.supxlabel("\n".join(lines).replace("$", r"\$"), **pages.NOTE)


def _choose_grid(count: int, height_inch: float, page: Page) -> tuple[int, int]:
    """Return rows and columns of panels; more than a slide has room for are refused."""
    columns = min(count, max(int(page.width_inch / _NARROWEST_INCH), 1))
    rows = -(-count // columns)
    room = page.height_inch / (height_inch * _SQUEEZED)
    if rows > max(room, 1.0):
        raise ShowError(
            f"--metric: expected at most {columns * max(int(room), 1)} on a slide, found {count}"
        )
    return rows, columns


def _add_legend(figure: Figure, named: dict[str, Any], view: SweptView) -> None:
    held = view.tell_held()
    words = [f"at {held}"] if held else []
    words += [f"mean over {view.seeds} seeds"] if view.seeds > 1 else []
    width, height = figure.get_size_inches()
    if words:
        _write_below(figure, [", ".join(words)])
    if named:
        columns = count_legend_columns(list(named), width * 72.0)
        lines = math.ceil(len(named) / columns)
        figure.set_size_inches(width, height + 0.16 * lines)
        figure.legend(named.values(), named.keys(), loc="outside upper center", ncols=columns)


_MOST_KEYS: Final = 12  # bars in a panel; each bar has 4 mm of a column

_NO_VALUE: Final = to_hex(UNSTABLE)

_THIN: Final = 0.01
"""Share of the widest bar below which a bar is not visible, and its ends are written as text."""

_ROOM_FOR_WORDS: Final = 0.9  # room for text to the right of the bars, as a multiple of their span

_HEIGHT: Final = 0.62


def _draw_tornado(axes: Axes, found: Sensitivities) -> None:
    """Draw a bar for each key: the metric's range over the key, or the rank correlation of both."""
    keys = found.keys[:_MOST_KEYS]
    title = (
        map_figure.label_swept_metric(found.metric) if found.chance is None else found.metric.name
    )
    axes.set_title(title, loc="right")  # long names of keys leave no room on both sides
    axes.grid(visible=False, axis="y")
    axes.set_yticks(range(len(keys)), labels=[_name(one) for one in keys])
    axes.set_ylim(max(len(keys), 1) - 0.4, -0.6)
    if not any(one.size for one in keys):
        is_still = found.chance is None and any(one.least is not None for one in keys)
        text = "no key moves it" if is_still else "no value to compare"
        axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", fontsize=7.0, color="0.4")
    if found.chance is None:
        _draw_ranges(axes, found, keys)
    else:
        _draw_correlations(axes, found, keys)


def _name(one: Sensitivity) -> str:
    """Return a key, and below it its values at the least and the greatest value of the metric."""
    name = one.axis.name.replace(", ", ",\n")
    if one.least_place is not None and one.most_place is not None:
        ends = (one.axis.tell_place(place) for place in (one.least_place, one.most_place))
        unit = f" [{one.axis.unit}]" if one.axis.unit else ""
        name += f"\n{' to '.join(ends)}{unit}" if one.size else "\nmakes no difference"
    return name.replace("$", r"\$")


def _draw_ranges(axes: Axes, found: Sensitivities, keys: Sequence[Sensitivity]) -> None:
    (color,) = choose_colors(1)
    sizes = [one.most - one.least for one in keys if one.least is not None and one.most is not None]
    scale = math.degrees if found.metric.unit == "rad" else float
    widest = scale(max(sizes, default=0.0))
    ends = [] if found.center is None else [scale(found.center)]
    for number, one in enumerate(keys):
        if one.least is None or one.most is None:
            continue
        low, high = scale(one.least), scale(one.most)
        axes.barh(number, high - low, _HEIGHT, left=low, color=color, alpha=0.8)
        if one.left_out:
            # Missing values, as of a loop that never settles, may be the largest effect.
            told = f" {one.left_out} of {len(one.axis)} values: no value"
            axes.text(high, number, told, fontsize=6.2, va="center", color=_NO_VALUE)
        elif high - low < _THIN * widest:
            told = " to ".join(dict.fromkeys((f"{low:.3g}", f"{high:.3g}")))
            axes.text(high, number, f" {told}", fontsize=6.2, va="center", color="0.25")
        ends += [low, high]
    if found.center is not None:
        axes.axvline(scale(found.center), **REFERENCE)
    if ends:
        room = 0.05 * (max(ends) - min(ends)) or 0.05 * abs(ends[0]) or 1.0
        axes.set_xlim(min(ends) - room, max(ends) + room)
        if any(one.left_out for one in keys):
            axes.set_xlim(right=max(ends) + _ROOM_FOR_WORDS * (max(ends) - min(ends)))
    axes.xaxis.set_major_locator(MaxNLocator(4))


def _draw_correlations(axes: Axes, found: Sensitivities, keys: Sequence[Sensitivity]) -> None:
    positive, negative = choose_colors(2)
    if found.chance is not None:
        axes.axvspan(-found.chance, found.chance, color="0.92", linewidth=0.0, zorder=0.5)
    for number, one in enumerate(keys):
        value = one.correlation or 0.0
        color = positive if value >= 0.0 else negative
        axes.barh(number, value, _HEIGHT, color=color, zorder=2.0)
        ha = "left" if value >= 0.0 else "right"
        axes.text(value, number, f" {value:.2f} ", fontsize=6.2, ha=ha, va="center", color="0.25")
    axes.axvline(0.0, **REFERENCE)
    axes.set_xlim(-1.35, 1.35)
    told = f"rank correlation, {found.rows} rows"
    if found.explained is not None:
        told += f";\nall together explain {100 * found.explained:.0f} %"
    axes.set_xlabel(told, fontsize=7.0)


_MOST_LINES: Final = 12  # lines, one for each value of a second key, of which neighbours differ
_MOST_TOLD: Final = 6  # omitted values that a legend lists; for more, the legend gives the step

_ALIKE: Final = 0.005
"""Share of a panel's height within which curves are one line: a third of a millimetre."""


_MOST_MARKED: Final = 40  # key values with a dot on the line: one per 2 mm of a panel
_MOST_DOTS: Final = 500  # sample rows with large dots, which cover a tenth of a panel


def draw_curves(
    axes: Axes, view: SweptView, metric: SweptMetric, limits: Sequence[LoopLimits]
) -> dict[str, Any]:
    """Draw a metric against a key, and return the legend entries with their styles."""
    along, series = view.x, view.y
    gains = [one.gain for one in limits]
    if series in gains and along not in gains:  # a gain is along the curves
        along, series = series, along
    if view.results.is_sampled and len(view.results.axes) > 1:
        return _draw_sample(axes, view, metric, along)
    found = choose_limits([one for one in limits if one.gain is along], metric)
    cells = fill_cells(view, metric)
    parts = [
        map_figure.scale_values(metric, one if along is view.x else one.T)
        for one in (cells.values, cells.least, cells.most)
    ]
    valueless = np.zeros(view.shape, dtype=bool)
    valueless.flat[list(cells.reasons)] = True
    valueless = valueless if along is view.x else valueless.T
    named: dict[str, Any] = {}
    theory: dict[str, Any] = {}
    count = 1 if series is None else len(series)
    places = np.linspace(0, count - 1, min(count, _MOST_LINES)).round().astype(int).tolist()
    is_one = found is not None and len({*found.columns}) == 1
    for color, place in zip(_color_series(series, len(places)), places, strict=True):
        mean, least, most = (part[place] for part in parts)
        name = None if series is None else series.tell_keys(place)
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
    ramp = choose_run_colors(256)
    return [to_rgb(ramp[row]) for row in np.linspace(0, len(ramp) - 1, count).round().astype(int)]


def _tell_left_out(series: SweptAxis, places: Sequence[int]) -> str:
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
        if not any(np.allclose(curve, one, 0.0, least, equal_nan=True) for one in groups):
            groups.append(curve)
    if len(groups) < len(curves):
        told = f"{len(curves)} curves coincide in {describe_count(len(groups), 'line')}"
        axes.set_title(told, fontsize=7.0, color="0.35", loc="right")


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
    values = map_figure.scale_values(metric, metric.values[view.rows])
    known = np.isfinite(values)
    size = 2.6 if len(values) <= _MOST_DOTS else 1.2
    axes.plot(numbers[known], values[known], "o", color=color, markersize=size, mew=0.0)
    _set_axes(axes, along, metric, values)
    return {} if known.all() else _mark_valueless(axes, numbers[~known], color)


def _draw_limits(
    axes: Axes, found: LoopLimits, metric: SweptMetric, along: SweptAxis, place: int, color: Any
) -> dict[str, Any]:
    """Draw theory's limits of one column as vertical lines, in the colour of its curve."""
    column = found.columns[place if len(found.columns) > 1 else 0]
    low, high = float(along.numbers[0]), float(along.numbers[-1])
    named: dict[str, Any] = {}
    for limit in map_figure.LIMITS:
        looks = limit.looks
        for branch in map_figure.list_branches([column], limit):
            at = float(branch[0])
            if not low <= at <= high:
                continue
            own = {**looks, **({} if color is None else {"color": color})}
            axes.axvline(at, **own, zorder=1.5)
            grey = {} if color is None else {"color": "0.4"}
            named[map_figure.name_limit(found, metric, limit)] = Line2D([], [], **{**looks, **grey})
            if color is None:
                text = axes.text(at, 1.01, f"{at:.4g}", fontsize=6.2, color=looks["color"])
                text.set(transform=axes.get_xaxis_transform(), ha="center", va="bottom")
    return named


def _set_axes(axes: Axes, along: SweptAxis, metric: SweptMetric, values: Values) -> None:
    if map_figure.is_logarithmic(along):
        axes.set_xscale("log")
    axes.set(xlabel=along.label, ylabel=map_figure.label_swept_metric(metric))
    map_figure.mark_places(axes, "x", along)
    known = values[np.isfinite(values)]
    if metric.is_verdict:
        axes.set_yticks(
            [0.0, 1.0], labels=[map_figure.VERDICT_WORDS[0], map_figure.VERDICT_WORDS[2]]
        )
        axes.set_ylim(-0.15, 1.2)
    elif len(known) and known.min() > 0.0 and known.max() / known.min() >= map_figure.DECADES:
        axes.set_yscale("log")
    elif len(known) and f"{known.min():.3g}" == f"{known.max():.3g}":
        # Printed as one value; on its own scale, differences in later digits look like an effect.
        axes.set_ylim(*sorted((0.9 * known[0], 1.1 * known[0])) if known[0] else (-0.1, 0.1))
    axes.margins(x=0.03)
