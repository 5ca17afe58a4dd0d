"""A trajectory beside its reference: paths after alignment, and errors over time."""

import math
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec

from turtlelog.compare import TrajectoryComparison
from turtlelog.compare.trajectory_errors import Values
from turtlelog.draw.figures.figure_curves import draw_thinned
from turtlelog.draw.figures.legend import add_legend
from turtlelog.draw.figures.page import MEASURED, MODELLED, REFERENCE, Page, use_looks
from turtlelog.draw.figures.writing import require_figure_path, write_figure

_PLANE_ROWS: Final = 2.2
"""Height of the panel of paths, in those of the panels over time."""

_ROW_HEIGHT: Final = 0.26
"""Height of a panel over time, as a share of the figure's width."""


def write_trajectory_figure(
    found: TrajectoryComparison, path: str | Path, *, page: Page | None = None
) -> Path:
    """Write a figure of an aligned trajectory beside its reference, and return its path.

    Args:
        found: What `turtlelog.compare.compare_trajectories` returned.
        path: Ends in .pdf, .png or .svg.
        page: Where it will stand.

    Raises:
        ShowError: Where the file cannot be written.
    """
    path = require_figure_path(path)
    page = page or Page(kind="page")
    rows = 2 if found.space == "plane" else 3
    with use_looks():
        height = page.width_inch * _ROW_HEIGHT * (_PLANE_ROWS + rows)
        figure = Figure(figsize=(page.width_inch, height), layout="constrained")
        grid = figure.add_gridspec(rows + 1, 1, height_ratios=(_PLANE_ROWS, *(1.0,) * rows))
        _draw_paths(figure.add_subplot(grid[0]), found)
        _draw_over_time(figure, grid, found)
        add_legend(figure)
    return write_figure(figure, path, page)


def _draw_paths(axes: Axes, found: TrajectoryComparison) -> None:
    for one, looks, label in _list_paths(found):
        draw_thinned(axes, one[:, 0], one[:, 1], one[:, 1], **looks, label=label)
    worst = int(found.absolute.position_m.argmax())
    both = np.array([found.reference.xyz_m[worst], found.estimate.xyz_m[worst]])
    axes.plot(both[:, 0], both[:, 1], color="0.15", linewidth=1.0)
    axes.plot(*both[1, :2], ".", color="0.15", label="largest position error")
    axes.set(xlabel="x [m]", ylabel="y [m]")
    axes.set_aspect("equal", adjustable="datalim")


def _list_paths(found: TrajectoryComparison) -> list[tuple[Values, dict[str, Any], str]]:
    how = "" if found.align == "none" else ", aligned"
    theirs, ours = (Path(name).name for name in (found.reference_name, found.name))
    return [
        (found.reference.xyz_m, {**MODELLED, "linewidth": 1.3}, f"{theirs}, reference"),
        (found.estimate.xyz_m, {**MEASURED, "linewidth": 1.0}, f"{ours}{how}"),
    ]


def _draw_over_time(figure: Figure, grid: GridSpec, found: TrajectoryComparison) -> None:
    time_ns = found.reference.time_ns
    is_frame = found.reference.clock == "frame"
    across = (time_ns - (0 if is_frame else time_ns[0])) / 1e9
    turn = "heading" if found.space == "plane" else "rotation"
    panels: list[tuple[str, Values]] = [
        ("position error [m]", found.absolute.position_m),
        (f"{turn} error [deg]", np.degrees(found.absolute.rotation_rad)),
    ]
    axes: Axes | None = None
    for row, (label, values) in enumerate(panels, start=1):
        axes = figure.add_subplot(grid[row], sharex=axes)
        draw_thinned(axes, across, values, values, **MEASURED, linewidth=0.9)
        rmse = math.sqrt(float((values**2).mean()))
        axes.axhline(rmse, **REFERENCE, linestyle="--", label="RMSE")
        axes.set_ylabel(label)
        axes.set_ylim(bottom=0.0)
    if found.space == "space":
        axes = figure.add_subplot(grid[3], sharex=axes)
        for one, looks, _ in _list_paths(found):
            draw_thinned(axes, across, one[:, 2], one[:, 2], **looks)
        axes.set_ylabel("z [m]")
    if axes is not None:
        axes.set_xlabel("pose" if is_frame else "time [s]")
        axes.margins(x=0.01)
