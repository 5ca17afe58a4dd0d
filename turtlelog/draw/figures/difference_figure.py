"""Why two runs differ: a waterfall from the value of one to that of the other."""

from pathlib import Path

from matplotlib.figure import Figure

from turtlelog.charts.difference_steps import (
    draw_up_difference,
)
from turtlelog.draw.figures.attribution_figure import draw_waterfall
from turtlelog.draw.figures.page import Page, use_looks
from turtlelog.draw.figures.writing import require_figure_path, write_figure
from turtlelog.errors import ShowError
from turtlelog.explain import ExplainedDifference

_LINE_INCH = 0.27
"""Height of a bar with its words."""

_BARS = 0.72
"""Width of the bars with the words beside them, as a share of the figure's."""


def write_difference_figure(
    found: ExplainedDifference, path: str | Path, *, page: Page | None = None
) -> Path:
    """Write a figure of what makes the difference of two runs, and return its path.

    Args:
        found: What `turtlelog.explain_difference` returned.
        path: Ends in .pdf, .png or .svg.
        page: Where it will stand.

    Raises:
        ShowError: If there are no contributions, or the file cannot be written.
    """
    path = require_figure_path(path)
    waterfall = draw_up_difference(found)
    if not waterfall.steps:
        reason = found.withheld or "no setting that differs changes the metric"
        raise ShowError(f"{path}: there are no contributions to draw: {reason}")
    page = page or Page(kind="page")
    with use_looks():
        height_inch = _LINE_INCH * (len(waterfall.steps) + 2.5)
        figure = Figure(figsize=(page.width_inch, height_inch), layout="constrained")
        draw_waterfall(figure.subplots(), waterfall, _BARS * page.width_inch)
    return write_figure(figure, path, page)
