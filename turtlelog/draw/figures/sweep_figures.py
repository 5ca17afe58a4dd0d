"""Figures of a sweep as files: maps over two keys, curves over one, sensitivities of all."""

import io
import math
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal

import matplotlib as mpl
from matplotlib.figure import Figure

from turtlelog.draw.figures.legend import count_columns
from turtlelog.draw.figures.map_figure import draw_map_panel
from turtlelog.draw.figures.page import LOOKS, Page, use_looks
from turtlelog.draw.figures.shown_figure import ShownFigure
from turtlelog.draw.figures.swept_curves import draw_curves
from turtlelog.draw.figures.tornado_figure import draw_tornado
from turtlelog.draw.figures.value_scale import group_reasons
from turtlelog.draw.figures.writing import FIGURE_FORMATS, save_figure
from turtlelog.draw.output_files import replace_file
from turtlelog.errors import ShowError
from turtlelog.files.urls import make_path
from turtlelog.sweep.gain_borders import LoopLimits, find_loop_limits, list_gain_keys
from turtlelog.sweep.sensitivities import find_sensitivities
from turtlelog.sweep.sweep_scenario import SweepTable, read_table_results
from turtlelog.sweep.swept_results import read_swept_results
from turtlelog.sweep.swept_views import SweptView, choose_view, require_values

_PANEL_INCH: Final = 2.5
"""Height of a map with its title and the name of its lower side."""

_TORNADO_INCH: Final = 0.75
_BAR_INCH: Final = 0.34
"""Heights of a tornado without bars, and of a bar: two lines of lettering."""

_SQUEEZED: Final = 0.62
"""Share of their heights to which panels fit on a slide: of less, the names of sides touch."""

_LETTERS_PER_INCH: Final = 16.0
"""Of the notes below the panels, 7 points high."""

_LINE_INCH: Final = 0.14

_NARROWEST_INCH: Final = 2.6
"""A map beside another is at least so wide: its bar and its side take an inch."""


MapKind = Literal["map", "curves", "tornado"]
"""What a figure of a sweep shows."""

_METHODS: Final = (
    "range along each key, below it its values at both ends; at the line all keys are held at",
    "Spearman's rank correlation; grey: 95 % of independent keys",
)
"""Of sensitivities, in a grid and in a sample."""


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
        view: As `choose_view` returns it.
        limits: Of theory, as `find_loop_limits` returns them.
        path: Ends in .pdf, .png or .svg.
        kind: Maps over two axes (over one, curves), curves over one of them, or how far each key
            moves a metric.
        page: Where it will stand.

    Raises:
        ShowError: Where the file cannot be written.
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
    """Return the map of a sweep, drawn, which a notebook shows.

    Args:
        table: Of `sweep_scenario`, or the file of one.
        metrics: Ids or patterns; None: up to four of them.
        x: Key at the bottom; None: chosen.
        y: Key at the side; None: chosen.
        at: Values of keys that are held.
        kind: Maps over two keys (over one, curves), curves over one of them, or how far each key
            moves a metric (`tornado`).
        page: Where it will stand.

    Raises:
        SweepError: Where a key does not vary, a metric is not there, or no row has a value.
        LogError: Where the file is no table of a sweep.
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
    """Return the figure that `write_map_figure` writes, in one of `FIGURE_FORMATS`."""
    page, data = page or Page(kind="page"), io.BytesIO()
    kind = "curves" if view.y is None and kind == "map" else kind
    with mpl.rc_context(dict(LOOKS)):
        figure = lay_out(view, limits, kind, page)
    save_figure(figure, data, form, page)
    return data.getvalue()


def lay_out(view: SweptView, limits: Sequence[LoopLimits], kind: MapKind, page: Page) -> Figure:
    """Return the figure of a sweep, drawn."""
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
            draw_tornado(axes, found[number])
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
    """Write lines below the panels, broken where they are wider than the figure, which grows."""
    letters = int(figure.get_figwidth() * _LETTERS_PER_INCH)
    lines = [line for one in words for line in textwrap.wrap(one, letters)]
    width, height = figure.get_size_inches()
    figure.set_size_inches(width, height + _LINE_INCH * (len(lines) - len(words)))
    figure.supxlabel("\n".join(lines).replace("$", r"\$"), fontsize=7.0, color="0.4")


def _choose_grid(count: int, height_inch: float, page: Page) -> tuple[int, int]:
    """Return rows and columns of panels.

    Raises:
        ShowError: Where a slide has no room for them.
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
        columns = count_columns(list(named), width * 72.0)
        lines = math.ceil(len(named) / columns)
        figure.set_size_inches(width, height + 0.16 * lines)
        figure.legend(named.values(), named.keys(), loc="outside upper center", ncols=columns)
