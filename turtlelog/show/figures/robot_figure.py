"""The figure of how a robot follows its commands, with a model that is known already."""

import io
from pathlib import Path

from matplotlib.figure import Figure

from turtlelog.errors import ShowError
from turtlelog.identify import AxisModel, RobotModel
from turtlelog.remote.urls import make_path
from turtlelog.run import Run
from turtlelog.show.figures.legend import add_legend
from turtlelog.show.figures.page import Page, use_looks
from turtlelog.show.figures.rates_figure import draw_rates
from turtlelog.show.figures.writing import FIGURE_FORMATS, save_figure
from turtlelog.show.output_files import replace_file


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
    path = make_path(path)
    kind = path.suffix.lower().removeprefix(".")
    if kind not in FIGURE_FORMATS:
        raise ShowError(f"{path}: expected a name that ends in .pdf, .png or .svg, found another")
    if not any(axis.is_known for axis in model.axes):
        raise ShowError(f"{path}: expected an axis that is known, found none: {_tell(model.axes)}")
    data = io.BytesIO()
    page = page or Page(kind="page")
    with use_looks():
        figure = Figure(figsize=(page.width_inch, page.width_inch), layout="constrained")
        draw_rates(figure, [run], model=model)
        add_legend(figure)
    save_figure(figure, data, kind, page)
    with replace_file(path) as part:
        part.write_bytes(data.getvalue())
    return path


def _tell(axes: tuple[AxisModel, ...]) -> str:
    return "; ".join(axis.reason for axis in axes)
