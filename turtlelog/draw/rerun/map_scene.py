"""A sweep as a Rerun recording: a map of each metric, whose cells say their row where one points.

A map is a picture of the cells, with a point of the same colour in each, which names its row. Its
unit is a pixel of that picture; the viewer's y points downward. A sample has the points alone.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from turtlelog.charts import palette
from turtlelog.charts.map_values import (
    OVERSHOOT,
    STABILITY,
    VERDICT_COLORS,
    find_edges,
    find_value_range,
    find_verdict_classes,
    is_logarithmic,
    label_metric,
    list_branches,
    scale_values,
)
from turtlelog.display import format_number
from turtlelog.draw.rerun.layout import LinkedBlueprint
from turtlelog.draw.rerun.rrd_file import open_recording
from turtlelog.sweep.gain_borders import LoopLimits, choose_limits
from turtlelog.sweep.swept_results import SweptMetric
from turtlelog.sweep.swept_views import SweptView, fill_cells

Values = NDArray[np.float64]

_MOST_TICKS: Final = 7
"""Values along a side: more would touch in a window of four views."""

_SAMPLE_SIDE: Final = 20.0
"""Of the square in which rows of a sample lie."""

_LIFT: Final = 0.035
"""Share of a map's height by which the viewer writes words below their point."""

_LEAST_SIDE: Final = 24
"""Of a map, in pixels of its picture: cells of a small one are squares of several."""

_DOT: Final = 0.1
"""Radius of a cell's point, in cells: large ones look like balls."""

_SHADES: Final = 256
_NO_VALUE: Final = (70, 70, 70)
_ROOM: Final = 0.14
"""Share of a map's side that the values along it take."""

_LIMIT_COLORS: Final = {STABILITY: palette.VIOLATION, OVERSHOOT: palette.GOAL}


def write_map_rrd(view: SweptView, limits: Sequence[LoopLimits], path: str | Path) -> None:
    """Write the metrics of a sweep over the axes of a view as one recording.

    Args:
        view: As `choose_view` returns it.
        limits: Of theory, as `find_loop_limits` returns them.
        path: The .rrd file; replaced when the new one is complete.

    Raises:
        ShowError: Where the file cannot be written.
    """
    metrics = view.results.metrics
    views = [_view_map(view, metric) for metric in metrics]
    columns = 1 if len(views) == 1 else 2
    layout = LinkedBlueprint(
        rrb.Grid(*views, grid_columns=columns),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="hidden"),
        auto_views=False,
        auto_layout=False,
    )
    with open_recording(path, name=f"{Path(view.results.path).name}, mapped", layout=layout) as to:
        for metric in metrics:
            _draw_map(to, view, metric, choose_limits(limits, metric))


def _view_map(view: SweptView, metric: SweptMetric) -> rrb.View:
    width, height = _find_size(view)
    held = view.tell_held()
    words = [held and f"at {held}", f"mean over {view.seeds} seeds" if view.seeds > 1 else ""]
    title = "; ".join([f"{label_metric(metric)}{_tell_colors(view, metric)}", *filter(None, words)])
    return rrb.Spatial2DView(
        origin=f"/{metric.name}",
        name=title,
        background=palette.GROUND,
        visual_bounds=rrb.VisualBounds2D(
            x_range=(-_ROOM * width, width * (1.0 + _ROOM / 2.0)),
            y_range=(-_ROOM * height * 0.6, height * (1.0 + _ROOM * 1.4)),
        ),
    )


def _tell_colors(view: SweptView, metric: SweptMetric) -> str:
    """Return which values the first and the last colour have."""
    if metric.is_verdict:
        return ": blue stable, red not"
    if view.results.is_sampled:
        values = metric.values[view.rows]
    else:
        values = fill_cells(view, metric).values
    if not np.isfinite(values).any():
        return ": no value"
    found = find_value_range(scale_values(metric, values))
    scale = ", logarithmic" if found.is_logarithmic else ""
    return f": violet {found.low:.4g} to yellow {found.high:.4g}{scale}"


def _find_side(view: SweptView) -> tuple[int, int]:
    """Return width and height of a cell, so that the map is about square, or a strip."""
    if view.results.is_sampled:
        return 1, 1
    lines, columns = view.shape
    most = max(lines, columns, _LEAST_SIDE)
    return -(-most // columns), -(-most // lines) if lines > 1 else -(-most // 6)


def _find_size(view: SweptView) -> tuple[float, float]:
    """Return width and height of a map."""
    if view.results.is_sampled:
        return _SAMPLE_SIDE, _SAMPLE_SIDE
    (wide, high), (lines, columns) = _find_side(view), view.shape
    return float(wide * columns), float(high * lines)


def _draw_map(
    to: rr.RecordingStream, view: SweptView, metric: SweptMetric, limits: LoopLimits | None
) -> None:
    if view.results.is_sampled:
        rows = view.rows
        values = metric.values[rows]
        radius: Any = rr.Radius.ui_points(4.0)
        reasons = [metric.reasons[row] for row in rows.tolist()]
    else:
        first = view.find_first_rows().ravel()
        cells = fill_cells(view, metric)
        rows, values = first[first >= 0], cells.values.ravel()[first >= 0]
        radius = _DOT * min(_find_side(view))
        reasons = [cells.reasons.get(cell) for cell in np.flatnonzero(first >= 0).tolist()]
    colors = _choose_colors(metric, scale_values(metric, values))
    middles = np.column_stack([_place(view, side, rows) for side in range(2)])
    labels = [
        f"{_tell_value(metric, value, reason)}\n"
        f"row {view.results.row_numbers[row]}: {view.results.tell_row(row)}"
        for row, value, reason in zip(rows.tolist(), values.tolist(), reasons, strict=True)
    ]
    if not view.results.is_sampled:
        to.log(
            f"/{metric.name}/cells",
            rr.Image(_paint(view, first, colors), draw_order=-10.0),
            static=True,
        )
    marks = rr.Points2D(middles, colors=colors, labels=labels, show_labels=False, radii=radius)
    to.log(f"/{metric.name}/rows", marks, static=True)
    _draw_axes(to, view, metric)
    if limits is not None and not view.results.is_sampled and view.y is not None:
        _draw_limits(to, view, metric, limits)


def _tell_value(metric: SweptMetric, value: float, reason: str | None) -> str:
    if np.isnan(value):
        return f"no value: {reason}"
    return format_number(value, metric.unit)


def _choose_colors(metric: SweptMetric, values: Values) -> NDArray[np.uint8]:
    """Return the colours of values, shape (n, 3)."""
    colors = np.full((len(values), 3), _NO_VALUE, dtype=np.uint8)
    known = np.isfinite(values)
    if metric.is_verdict:
        ramp = [tuple(bytes.fromhex(color[1:])) for color in VERDICT_COLORS]
        places = find_verdict_classes(values[known])
    else:
        ramp = [*palette.choose_run_colors(_SHADES)]
        places = find_value_range(values).share(values[known]) * (_SHADES - 1)
    colors[known] = np.array(ramp, dtype=np.uint8)[np.rint(places).astype(np.int64)]
    return colors


def _paint(view: SweptView, first: NDArray[np.int64], colors: NDArray[np.uint8]) -> Any:
    """Return the picture of the cells, the first line of y below; no row is the ground."""
    whole = np.full((len(first), 3), palette.GROUND, dtype=np.uint8)
    whole[first >= 0] = colors
    wide, high = _find_side(view)
    picture = whole.reshape(*view.shape, 3)[::-1]
    return picture.repeat(high, axis=0).repeat(wide, axis=1)


def _place(view: SweptView, side: int, rows: NDArray[np.int64]) -> Values:
    """Return where rows stand along x (0) or y (1), in the map's units."""
    size = _find_size(view)[side]
    if len(view.axes) <= side:
        return np.full(len(rows), size / 2.0)
    axis = view.axes[side]
    at = _scale(view, side, axis.numbers[axis.places[rows]])
    return at if side == 0 else size - at


def _scale(view: SweptView, side: int, numbers: Values) -> Values:
    """Return where numbers of an axis stand on it, from 0."""
    axis, size = view.axes[side], _find_size(view)[side]
    edges = find_edges(axis)
    if view.results.is_sampled:
        return np.asarray((numbers - edges[0]) / (edges[-1] - edges[0]) * size)
    if is_logarithmic(axis):
        numbers, edges = np.log(np.maximum(numbers, 1e-300)), np.log(edges)
    # Cells are as wide as each other, whatever lies between their values.
    places = np.interp(numbers, edges, np.arange(len(edges)), left=-1.0, right=len(edges))
    return np.asarray(places * (size / len(axis)), dtype=np.float64)


def _draw_axes(to: rr.RecordingStream, view: SweptView, metric: SweptMetric) -> None:
    width, height = _find_size(view)
    frame = [(0.0, 0.0), (0.0, height), (width, height)]
    lines = rr.LineStrips2D([frame], colors=[palette.REFERENCE], radii=rr.Radius.ui_points(0.5))
    to.log(f"/{metric.name}/axes", lines, static=True)
    words: list[tuple[float, float, str]] = []
    for side, axis in enumerate(view.axes):
        count = min(len(axis), _MOST_TICKS)
        places = np.unique(np.linspace(0, len(axis) - 1, count).round().astype(np.int64))
        for place, at in zip(places, _scale(view, side, axis.numbers[places]), strict=True):
            is_plain = axis.is_number and len(axis.keys) == 1
            text = f"{axis.numbers[place]:.3g}" if is_plain else axis.tell_place(int(place))
            beside = (-width * _ROOM / 3.0, height * (1.0 - _LIFT) - float(at), text)
            words.append((float(at), height * (1.0 + _LIFT), text) if side == 0 else beside)
    words.append((width / 2.0, height * (1.0 + 0.75 * _ROOM), view.x.label))
    if view.y is not None:
        words.append((width / 4.0, -height * _ROOM / 2.0, f"{view.y.label}, upward"))
    points = rr.Points2D(
        [(x, y) for x, y, _ in words],
        labels=[text for _, _, text in words],
        colors=[palette.START],
        radii=rr.Radius.ui_points(0.0),
        show_labels=True,
    )
    to.log(f"/{metric.name}/axes/words", points, static=True)


def _draw_limits(
    to: rr.RecordingStream, view: SweptView, metric: SweptMetric, found: LoopLimits
) -> None:
    is_upright = found.gain is view.x
    size = _find_size(view)[0 if is_upright else 1]
    for name, color in _LIMIT_COLORS.items():
        strips = []
        for branch in list_branches(found.columns, name):
            across = np.arange(len(branch) + 1) * _find_side(view)[1 if is_upright else 0]
            at = _scale(view, 0 if is_upright else 1, np.repeat(branch, 2))
            along = np.repeat(across, 2)[1:-1].astype(np.float64)
            inside = np.isfinite(at) & (at >= 0.0) & (at <= size)
            if is_upright:
                points = np.column_stack([at, _find_size(view)[1] - along])
            else:
                points = np.column_stack([along, size - at])
            ends = np.flatnonzero(np.diff(inside.astype(np.int8))) + 1
            # Parts lie inside and outside in turn.
            parts = np.split(points, ends)
            strips += parts[0 if inside[0] else 1 :: 2]
        if strips:
            looks: dict[str, Any] = {"colors": [color], "radii": rr.Radius.ui_points(1.5)}
            to.log(
                f"/{metric.name}/{name}",
                rr.LineStrips2D(strips, **looks, draw_order=40.0),
                static=True,
            )
