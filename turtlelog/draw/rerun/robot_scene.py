"""How a robot follows its commands as a Rerun recording: command, motion, model and residual."""

from pathlib import Path
from typing import Final

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from turtlelog.charts import palette
from turtlelog.charts.palette import Color
from turtlelog.draw.rerun.content import find_emptiest_corner
from turtlelog.draw.rerun.layout import link_views
from turtlelog.draw.rerun.rrd_file import open_recording
from turtlelog.errors import ShowError
from turtlelog.identify import AxisTraces, RobotModel, trace_axis
from turtlelog.run import Run

_TITLES: Final = {"speed": "speed [m/s]", "turn_rate": "turn rate [rad/s]"}
TIMELINE: Final = "robot_time"
_RESIDUAL: Final = "residual"

_CURVES: Final[tuple[tuple[str, Color, float], ...]] = (
    ("commanded", palette.REFERENCE, 1.5),
    ("measured", palette.MEASURED, 1.0),
    ("modelled", palette.MODEL, 2.5),
    (_RESIDUAL, palette.ERROR, 1.0),
)
"""Of each axis, in the order of drawing, with widths [points]: noise must not hide the model."""


def write_robot_rrd(model: RobotModel, run: Run, path: str | Path) -> None:
    """Write a recording of the axes that a model knows, for a run.

    Args:
        model: Result of `turtlelog.identify_robot`.
        run: Run whose motion is shown: an identified one, or another.
        path: The .rrd file; replaced when the new one is complete.

    Raises:
        ShowError: If no axis is known, or the file cannot be written.
    """
    traces = [trace_axis(axis, run) for axis in model.axes if axis.is_known]
    if not traces:
        reasons = "; ".join(axis.reason for axis in model.axes)
        raise ShowError(f"{path}: no axis was identified: {reasons}")
    views = [view for found in traces for view in list_views(found)]
    shares = [2.0, 1.0] * len(traces)
    layout = link_views(rrb.Vertical(*views, row_shares=shares))
    with open_recording(path, name=f"{run.name}, identified", layout=layout) as stream:
        for found in traces:
            draw_axis(stream, found)


def list_views(found: AxisTraces) -> list[rrb.View]:
    """Return a view of the rates of an axis, and one of what its model leaves."""
    title = _TITLES[found.axis]
    rates = [f"/{found.axis}/{name}" for name, _, _ in _CURVES if name != _RESIDUAL]
    link = rrb.TimeAxis(link="LinkToGlobal")
    low, high = np.nanmin(found.commanded), np.nanmax(found.commanded)
    corner = find_emptiest_corner(
        np.rint(found.time_s * 1e9).astype(np.int64),
        found.commanded,
        (float(low), float(high) if high > low else float(low) + 1.0),
    )
    legend = rrb.PlotLegend(rrb.Corner2D[corner])
    return [
        rrb.TimeSeriesView(origin="/", contents=rates, name=title, axis_x=link, plot_legend=legend),
        rrb.TimeSeriesView(
            origin="/",
            contents=[f"/{found.axis}/{_RESIDUAL}"],
            name=f"motion - model: {title}",
            axis_x=link,
            plot_legend=rrb.PlotLegend(visible=False),
        ),
    ]


def draw_axis(stream: rr.RecordingStream, found: AxisTraces) -> None:
    """Log the rates of an axis, and what its model leaves."""
    time_ns = np.rint(found.time_s * 1e9).astype("timedelta64[ns]")
    index = [rr.TimeColumn(TIMELINE, duration=time_ns)]
    for name, color, width in _CURVES:
        entity = f"/{found.axis}/{name}"
        style = rr.SeriesLines(names=name, colors=palette.pack_colors([color]), widths=[width])
        stream.log(entity, style, static=True)
        stream.send_columns(entity, index, rr.Scalars.columns(scalars=getattr(found, name)))
