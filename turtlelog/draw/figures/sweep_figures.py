"""Figures of a sweep as files: maps over two keys, curves over one, sensitivities of all keys."""

import io
import math
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from turtlelog.charts.map_values import label_metric, scale_values
from turtlelog.charts.palette import UNSTABLE, to_hex
from turtlelog.draw.figures.legend import count_legend_columns
from turtlelog.draw.figures.map_figure import draw_map_panel, group_reasons
from turtlelog.draw.figures.page import LOOKS, REFERENCE, Page, choose_colors, use_looks
from turtlelog.draw.figures.swept_curves import draw_curves
from turtlelog.draw.figures.writing import FIGURE_FORMATS, ShownFigure, save_figure
from turtlelog.draw.output_files import replace_file
from turtlelog.errors import ShowError
from turtlelog.files.urls import make_path
from turtlelog.sweep.gain_borders import LoopLimits, find_loop_limits, list_gain_keys
from turtlelog.sweep.sensitivities import Sensitivities, Sensitivity, find_sensitivities
from turtlelog.sweep.sweep_scenario import SweepTable, read_table_results
from turtlelog.sweep.table.swept_results import read_swept_results
from turtlelog.sweep.table.swept_views import SweptView, choose_view, require_values

_PANEL_INCH: Final = 2.5
"""Height of a map with its title and the label of its lower side [inch]."""

_TORNADO_INCH: Final = 0.75
_BAR_INCH: Final = 0.34
"""Height of each bar of a tornado plot [inch]: two lines of text."""

_SQUEEZED: Final = 0.62
"""Smallest height of panels on a slide, as a share of the usual height. On lower panels, labels of
sides touch."""

_LETTERS_PER_INCH: Final = 16.0
"""Letters per inch of the notes below the panels, at 7 points."""

_LINE_INCH: Final = 0.14

_NARROWEST_INCH: Final = 2.6
"""Smallest width of a map next to another map [inch]; the bar and the side take one inch."""

MapKind = Literal["map", "curves", "tornado"]
"""Content of a sweep figure."""

_METHODS: Final = (
    "range along each key, below it its values at both ends; at the line all keys are held at",
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
    path = make_path(path)
    form = path.suffix.lower().removeprefix(".")
    if form not in FIGURE_FORMATS:
        raise ShowError(f"{path}: the name must end in .pdf, .png or .svg")
    data = draw_sweep(view, limits, form, kind=kind, page=page)
    with replace_file(path) as part:
        part.write_bytes(data)
    return path


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
    kind = "curves" if view.y is None and kind == "map" else kind
    with use_looks():
        return lay_out(view, find_loop_limits(view), kind, page or Page(kind="page"))


def draw_sweep(
    view: SweptView,
    limits: Sequence[LoopLimits],
    form: str,
    *,
    kind: MapKind = "map",
    page: Page | None = None,
) -> bytes:
    """Return the content of the file that `write_map_figure` writes, in one of `FIGURE_FORMATS`."""
    page, data = page or Page(kind="page"), io.BytesIO()
    kind = "curves" if view.y is None and kind == "map" else kind
    with mpl.rc_context(dict(LOOKS)):
        figure = lay_out(view, limits, kind, page)
    save_figure(figure, data, form, page)
    return data.getvalue()


def lay_out(view: SweptView, limits: Sequence[LoopLimits], kind: MapKind, page: Page) -> Figure:
    """Return the drawn figure of a sweep."""
    metrics = view.results.metrics
    found = [find_sensitivities(view.results, one, dict(view.held)) for one in metrics]
    most = max(len(one.keys) for one in found)
    height = _TORNADO_INCH + _BAR_INCH * most if kind == "tornado" else _PANEL_INCH
    rows, columns = _choose_grid(len(metrics), height, page)
    figure = ShownFigure(figsize=(page.width_inch, height * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False)
    named: dict[str, Any] = {}
    reasons = group_reasons(metrics)
    for number, axes in enumerate(grid.flat):
        if number >= len(metrics):
            axes.set_axis_off()
        elif kind == "tornado":
            _draw_tornado(axes, found[number])
        elif kind == "curves":
            named |= draw_curves(axes, view, metrics[number], limits)
        else:
            named |= draw_map_panel(axes, view, metrics[number], limits, reasons)
    if kind == "tornado":
        words = [_METHODS[view.results.is_sampled], *filter(None, [found[0].held])]
        _write_below(figure, words)
    else:
        _add_legend(figure, named, view)
    page.fit(figure)
    return figure


def _write_below(figure: Figure, words: Sequence[str]) -> None:
    """Write lines below the panels, wrapped to the figure's width. The figure becomes higher."""
    letters = int(figure.get_figwidth() * _LETTERS_PER_INCH)
    lines = [line for one in words for line in textwrap.wrap(one, letters)]
    width, height = figure.get_size_inches()
    figure.set_size_inches(width, height + _LINE_INCH * (len(lines) - len(words)))
    figure.supxlabel("\n".join(lines).replace("$", r"\$"), fontsize=7.0, color="0.4")


def _choose_grid(count: int, height_inch: float, page: Page) -> tuple[int, int]:
    """Return rows and columns of panels.

    Raises:
        ShowError: If a slide has no room for the panels.
    """
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


_MOST_KEYS: Final = 12
"""Largest number of bars in a panel; each bar has 4 mm of a column."""

_NO_VALUE: Final = to_hex(UNSTABLE)

_THIN: Final = 0.01
"""Share of the widest bar below which a bar is not visible, and its ends are written as text."""

_ROOM_FOR_WORDS: Final = 0.9
"""Room for text to the right of the bars, as a multiple of their span."""

_HEIGHT: Final = 0.62


def _draw_tornado(axes: Axes, found: Sensitivities) -> None:
    """Draw a bar for each key: the metric's range over the key, or the rank correlation of both."""
    keys = found.keys[:_MOST_KEYS]
    title = label_metric(found.metric) if found.chance is None else found.metric.name
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
        unit = f" {one.axis.unit}" if one.axis.unit else ""
        name += f"\n{' to '.join(ends)}{unit}" if one.size else "\nmakes no difference"
    return name.replace("$", r"\$")


def _draw_ranges(axes: Axes, found: Sensitivities, keys: Sequence[Sensitivity]) -> None:
    (color,) = choose_colors(1)
    sizes = [one.most - one.least for one in keys if one.least is not None and one.most is not None]
    widest = _scale(found, max(sizes, default=0.0))
    ends = [] if found.center is None else [_scale(found, found.center)]
    for number, one in enumerate(keys):
        if one.least is None or one.most is None:
            continue
        low, high = _scale(found, one.least), _scale(found, one.most)
        axes.barh(number, high - low, _HEIGHT, left=low, color=color, alpha=0.8)
        if one.left_out:
            # Missing values, as of a loop that never settles, may be the largest effect.
            told = f" {one.left_out} of {len(one.axis)} values: no value"
            axes.text(high, number, told, fontsize=6.2, va="center", color=_NO_VALUE)
        elif high - low < _THIN * widest:
            told = f" {low:.3g} to {high:.3g}"
            axes.text(high, number, told, fontsize=6.2, va="center", color="0.25")
        ends += [low, high]
    if found.center is not None:
        axes.axvline(_scale(found, found.center), **REFERENCE)
    if ends:
        room = 0.05 * (max(ends) - min(ends)) or 0.05 * abs(ends[0]) or 1.0
        axes.set_xlim(min(ends) - room, max(ends) + room)
        if any(one.left_out for one in keys):
            axes.set_xlim(right=max(ends) + _ROOM_FOR_WORDS * (max(ends) - min(ends)))
    axes.xaxis.set_major_locator(MaxNLocator(4))


def _scale(found: Sensitivities, value: float) -> float:
    return float(scale_values(found.metric, np.array(value)))


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
    share = (
        "" if found.explained is None else f";\nall together explain {100 * found.explained:.0f} %"
    )
    axes.set_xlabel(f"rank correlation, {found.rows} rows{share}", fontsize=7.0)
