"""Rerun recording of a robot's response to its commands, alone or next to a simulated robot."""

from pathlib import Path
from typing import Any, Final

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from turtlelog.charts import palette
from turtlelog.charts.curves import Values
from turtlelog.charts.time_plots import TIME_PLOTS, label_error
from turtlelog.compare import ErrorBand, RobotComparison
from turtlelog.compare.robot_comparison import SHOWN_UNITS
from turtlelog.draw.rerun.content import find_corners, view_curves
from turtlelog.draw.rerun.layout import link_views
from turtlelog.draw.rerun.plots import Series
from turtlelog.draw.rerun.rrd_file import open_recording
from turtlelog.draw.rerun.world import draw_points, draw_strips
from turtlelog.errors import ShowError
from turtlelog.identify import AxisTraces, RobotModel, trace_axis
from turtlelog.run import Run

_TIMELINE: Final = "robot_time"
_RESIDUAL: Final = "residual"

_CURVES: Final[tuple[tuple[str, palette.Color, float], ...]] = (
    ("commanded", palette.REFERENCE, 1.5),
    ("measured", palette.MEASURED, 1.0),
    ("modelled", palette.MODEL, 2.5),
    (_RESIDUAL, palette.ERROR, 1.0),
)
"""Curves of each axis in the order of drawing, with widths [points]; noise must not hide the
model."""


def write_robot_rrd(model: RobotModel, run: Run, path: str | Path) -> None:
    """Write a recording of the axes that a model knows, for a run.

    Args:
        model: Result of `turtlelog.identify_robot`.
        run: Run whose motion is shown: an identified run, or another run.
        path: The .rrd file. An existing file is replaced when the new one is complete.

    Raises:
        ShowError: If no axis is known, or the file cannot be written.
    """
    traces = [trace_axis(axis, run) for axis in model.axes if axis.is_known]
    if not traces:
        reasons = "; ".join(axis.reason for axis in model.axes)
        raise ShowError(f"{path}: no axis was identified: {reasons}")
    views = [view for found in traces for view in _list_views(found)]
    shares = [2.0, 1.0] * len(traces)
    layout = link_views(rrb.Vertical(*views, row_shares=shares))
    with open_recording(path, name=f"{run.name}, identified", layout=layout) as stream:
        for found in traces:
            _draw_axis(stream, found)


def _list_views(found: AxisTraces) -> list[rrb.View]:
    """Return a view of the rates of an axis, and a view of the model's residuals."""
    title = TIME_PLOTS[found.axis].label
    rates = [f"/{found.axis}/{name}" for name, _, _ in _CURVES if name != _RESIDUAL]
    low, high = float(np.nanmin(found.commanded)), float(np.nanmax(found.commanded))
    command = Series(
        entity="command",
        labels=(title,),
        time_ns=np.rint(found.time_s * 1e9).astype(np.int64),
        values=found.commanded[:, np.newaxis],
    )
    limits = (low, high if high > low else low + 1.0)
    corner = find_corners([command], {command.plot: limits})[command.plot]
    legend, hidden = rrb.PlotLegend(rrb.Corner2D[corner]), rrb.PlotLegend(visible=False)
    residual = [f"/{found.axis}/{_RESIDUAL}"]
    return [
        view_curves(title, rates, None, legend),
        view_curves(f"residual: {title}", residual, None, hidden),
    ]


def _draw_axis(stream: rr.RecordingStream, found: AxisTraces) -> None:
    """Log the rates of an axis, and the residuals of its model."""
    time_ns = np.rint(found.time_s * 1e9).astype("timedelta64[ns]")
    index = [rr.TimeColumn(_TIMELINE, duration=time_ns)]
    for name, color, width in _CURVES:
        entity = f"/{found.axis}/{name}"
        style = rr.SeriesLines(names=name, colors=palette.pack_colors([color]), widths=[width])
        stream.log(entity, style, static=True)
        stream.send_columns(entity, index, rr.Scalars.columns(scalars=getattr(found, name)))


_PLANE: Final = "/plane"
_PATH_PIXELS: Final = 1.2


def write_prediction_rrd(found: RobotComparison, path: str | Path) -> None:
    """Write a recording of a recorded robot next to a simulated robot.

    Args:
        found: Result of `turtlelog.compare.compare_robot`.
        path: The .rrd file. An existing file is replaced when the new one is complete.

    Raises:
        ShowError: If the file cannot be written.
    """
    longest = [band for band in found.bands if band.horizon_s == found.bands[-1].horizon_s]
    errors = [
        rrb.TimeSeriesView(
            origin=_name_errors(band),
            name=f"{label_error(band.quantity)} after {band.horizon_s:g} s",
            axis_x=rrb.TimeAxis(link="LinkToGlobal"),
        )
        for band in longest
    ]
    rates = [view for traces in found.traces for view in _list_views(traces)[:1]]
    plane = rrb.Spatial2DView(
        origin=_PLANE,
        name="recorded path, and predictions that begin on it",
        background=palette.GROUND,
    )
    layout = link_views(
        rrb.Horizontal(plane, rrb.Vertical(*errors, *rates), column_shares=[1.0, 1.2])
    )
    name = f"{found.name} beside {found.scenario}"
    with open_recording(path, name=name, layout=layout) as stream:
        _draw_plane(stream, found)
        for band in longest:
            _draw_errors(stream, band, found.start_s)
        for traces in found.traces:
            _draw_axis(stream, traces)


def _name_errors(band: ErrorBand) -> str:
    return f"/errors/{band.quantity}"


def _draw_plane(stream: rr.RecordingStream, found: RobotComparison) -> None:
    # A 2D view has y downward.
    pieces = [_flip(piece) for piece in found.predict_pieces()]
    # The recorded path is below, and visible on both sides.
    for name, strips, color, pixels in (
        ("recorded", [_flip(found.recorded.xy_m)], palette.MEASURED, 2.0 * _PATH_PIXELS),
        ("simulated", pieces, palette.MODEL, _PATH_PIXELS),
    ):
        looks: dict[str, Any] = {"draw_order": -pixels, "labels": [name], "show_labels": False}
        packed = palette.pack_colors([color])
        draw_strips(stream, f"{_PLANE}/{name}", strips, packed, pixels, **looks)
    starts, packed = [piece[0] for piece in pieces], palette.pack_colors([palette.MODEL])
    draw_points(stream, f"{_PLANE}/begins", starts, packed, 4.0 * _PATH_PIXELS)


def _flip(xy_m: Values) -> Values:
    return np.asarray(xy_m * np.array([1.0, -1.0]))


def _draw_errors(stream: rr.RecordingStream, band: ErrorBand, start_s: float) -> None:
    _, factor = SHOWN_UNITS[band.quantity]
    time_ns = np.rint((band.time_s + start_s) * 1e9).astype("timedelta64[ns]")
    index = [rr.TimeColumn(_TIMELINE, duration=time_ns)]
    curves: list[tuple[str, Values | None, palette.Color]] = [
        ("recorded", band.recorded, palette.MEASURED),
        ("least simulated", band.low, palette.REFERENCE),
        ("largest simulated", band.high, palette.REFERENCE),
    ]
    for name, values, color in curves:
        if values is None:
            continue
        entity = f"{_name_errors(band)}/{name.replace(' ', '_')}"
        colors = palette.pack_colors([color])
        stream.log(entity, rr.SeriesLines(names=name, colors=colors), static=True)
        stream.send_columns(entity, index, rr.Scalars.columns(scalars=factor * values))
