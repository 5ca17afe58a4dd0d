"""How a robot follows its commands as a Rerun recording: command, motion, model and residual."""

from pathlib import Path
from typing import Final

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from turtlelog.errors import ShowError
from turtlelog.identify import AxisTraces, RobotModel, trace_axis
from turtlelog.run import Run
from turtlelog.show import palette
from turtlelog.show.palette import Color
from turtlelog.show.rerun.rrd_file import open_recording

_TITLES: Final = {"speed": "speed [m/s]", "turn_rate": "turn rate [rad/s]"}
TIMELINE: Final = "robot_time"
_RESIDUAL: Final = "residual"

_CURVES: Final[tuple[tuple[str, Color], ...]] = (
    ("commanded", palette.REFERENCE),
    ("measured", palette.MEASURED),
    ("modelled", palette.MAIN),
    (_RESIDUAL, palette.ERROR),
)
"""Of each axis, in the order of drawing."""


def write_robot_rrd(model: RobotModel, run: Run, path: str | Path) -> None:
    """Write a recording of the axes that a model knows, for a run.

    Args:
        model: What `turtlelog.identify_robot` returned.
        run: Whose motion is shown: one that was identified, or another.
        path: The .rrd file; replaced when the new one is complete.

    Raises:
        ShowError: Where no axis is known, or the file cannot be written.
    """
    traces = [trace_axis(axis, run) for axis in model.axes if axis.is_known]
    if not traces:
        reasons = "; ".join(axis.reason for axis in model.axes)
        raise ShowError(f"{path}: expected an axis that is known, found none: {reasons}")
    views = [view for found in traces for view in list_views(found)]
    shares = [2.0, 1.0] * len(traces)
    layout = rrb.Blueprint(
        rrb.Vertical(*views, row_shares=shares),
        rrb.TimePanel(state=rrb.PanelState.Collapsed, timeline=TIMELINE),
        collapse_panels=True,
    )
    with open_recording(path, name=f"{run.name}, identified", layout=layout) as stream:
        for found in traces:
            draw_axis(stream, found)


def list_views(found: AxisTraces) -> list[rrb.View]:
    """Return a view of the rates of an axis, and one of what its model leaves."""
    title = _TITLES[found.axis]
    rates = [f"/{found.axis}/{name}" for name, _ in _CURVES if name != _RESIDUAL]
    link = rrb.TimeAxis(link="LinkToGlobal")
    return [
        rrb.TimeSeriesView(origin="/", contents=rates, name=title, axis_x=link),
        rrb.TimeSeriesView(
            origin="/",
            contents=[f"/{found.axis}/{_RESIDUAL}"],
            name=f"motion - model: {title}",
            axis_x=link,
        ),
    ]


def draw_axis(stream: rr.RecordingStream, found: AxisTraces) -> None:
    """Log the rates of an axis, and what its model leaves."""
    time_ns = np.rint(found.time_s * 1e9).astype("timedelta64[ns]")
    index = [rr.TimeColumn(TIMELINE, duration=time_ns)]
    for name, color in _CURVES:
        entity = f"/{found.axis}/{name}"
        style = rr.SeriesLines(names=name, colors=palette.pack_colors([color]))
        stream.log(entity, style, static=True)
        stream.send_columns(entity, index, rr.Scalars.columns(scalars=getattr(found, name)))
