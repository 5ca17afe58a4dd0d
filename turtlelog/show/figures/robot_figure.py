"""How a robot follows its commands, drawn: command, motion, model, and what the model leaves."""

import io
from pathlib import Path
from typing import Final

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from turtlelog.errors import ShowError
from turtlelog.identify import AxisModel, AxisTraces, RobotModel, trace_axis
from turtlelog.run import Run
from turtlelog.show.figures.page import LOOKS, REFERENCE, Page, add_legend, choose_lines
from turtlelog.show.figures.writing import FIGURE_FORMATS, save_figure
from turtlelog.show.output_files import replace_file

_NAMES: Final = {"speed": "speed [m/s]", "turn_rate": "turn rate [rad/s]"}
_HEIGHT: Final = 0.36
"""Of both panels of an axis, as a share of the page's width."""


def write_robot_figure(
    model: RobotModel, run: Run, path: str | Path, *, page: Page | None = None
) -> Path:
    """Write a figure of the axes that a model knows, for a run, and return its path.

    Args:
        model: What `turtlelog.identify_robot` returned.
        run: Whose motion is drawn: one that was identified, or another.
        path: Ends in .pdf, .png or .svg.
        page: Where it will stand.

    Raises:
        ShowError: Where no axis is known, or the file cannot be written.
    """
    path = Path(path)
    kind = path.suffix.lower().removeprefix(".")
    if kind not in FIGURE_FORMATS:
        raise ShowError(f"{path}: expected a name that ends in .pdf, .png or .svg, found another")
    traces = [trace_axis(axis, run) for axis in model.axes if axis.is_known]
    if not traces:
        raise ShowError(f"{path}: expected an axis that is known, found none: {_tell(model.axes)}")
    data = io.BytesIO()
    page = page or Page(columns=2)
    with mpl.rc_context(dict(LOOKS)):
        size = (page.width_inch, page.width_inch * _HEIGHT * len(traces))
        figure = Figure(figsize=size, layout="constrained")
        panels = figure.subplots(
            2 * len(traces), 1, sharex=True, height_ratios=[2.0, 1.0] * len(traces), squeeze=False
        )
        for number, found in enumerate(traces):
            _draw_axis(panels[2 * number, 0], panels[2 * number + 1, 0], found)
        panels[-1, 0].set_xlabel("time [s]")
        add_legend(figure)
    save_figure(figure, data, kind)
    with replace_file(path) as part:
        part.write_bytes(data.getvalue())
    return path


def _tell(axes: tuple[AxisModel, ...]) -> str:
    return "; ".join(axis.reason for axis in axes)


def _draw_axis(rates: Axes, left: Axes, found: AxisTraces) -> None:
    measured, modelled = choose_lines(2)
    rates.plot(found.time_s, found.commanded, **REFERENCE, label="command")
    rates.plot(found.time_s, found.measured, **measured, label="motion")
    rates.plot(found.time_s, found.modelled, **modelled, label="model")
    rates.set_ylabel(_NAMES[found.axis])
    left.axhline(0.0, **REFERENCE)
    left.plot(found.time_s, found.residual, **measured)
    left.set_ylabel("motion\n- model")
