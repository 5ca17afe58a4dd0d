"""The figure of how a robot follows its commands, with a model that is known already."""

from pathlib import Path

from matplotlib.figure import Figure

from turtlelog.draw.figures.legend import add_legend
from turtlelog.draw.figures.page import Page, use_looks
from turtlelog.draw.figures.rates_figure import draw_rates
from turtlelog.draw.figures.writing import require_figure_path, write_figure
from turtlelog.errors import ShowError
from turtlelog.identify import AxisModel, RobotModel
from turtlelog.run import Run


def write_robot_figure(
    model: RobotModel, run: Run, path: str | Path, *, page: Page | None = None
) -> Path:
    """Write the figure `rates` of a run with a model of its own, and return its path.

    Args:
        model: What `turtlelog.identify_robot` returned.
        run: Whose motion is drawn: one that was identified, or another.
        path: Ends in .pdf, .png or .svg.
        page: Where it will stand.

    Raises:
        ShowError: Where no axis is known, or the file cannot be written.
    """
    path = require_figure_path(path)
    if not any(axis.is_known for axis in model.axes):
        raise ShowError(f"{path}: no axis was identified: {_tell(model.axes)}")
    page = page or Page(kind="page")
    with use_looks():
        figure = Figure(figsize=(page.width_inch, page.width_inch), layout="constrained")
        draw_rates(figure, [run], model=model)
        add_legend(figure)
    return write_figure(figure, path, page)


def _tell(axes: tuple[AxisModel, ...]) -> str:
    return "; ".join(axis.reason for axis in axes)
