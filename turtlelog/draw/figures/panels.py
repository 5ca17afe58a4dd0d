"""How panels stand in a figure, and what those over time have in common."""

from collections.abc import Callable, Sequence
from itertools import pairwise

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from turtlelog.charts.robot_curves import lack_samples
from turtlelog.draw.figures.plane_panels import draw_paths, show_all
from turtlelog.run import Run

Draw = Callable[[Axes, Sequence[Run]], None]
"""Draws one panel of some runs."""


def draw_stack(figure: Figure, runs: Sequence[Run], panels: Sequence[Draw]) -> None:
    """Draw panels over each other on one time axis."""
    grid = figure.subplots(len(panels), 1, sharex=True, squeeze=False)
    for axes, panel in zip(grid[:, 0], panels, strict=True):
        panel(axes, runs)
    for axes, _ in pairwise(grid[:, 0]):
        axes.set_xlabel("")


def draw_overview(figure: Figure, runs: Sequence[Run], panels: Sequence[Draw]) -> None:
    """Draw where runs drove, and panels on one time axis in two columns around it.

    The plane stands at the top of the left column. Of runs without samples it takes all of that,
    and of runs without poses there is none.
    """
    if not any(len(run.poses) for run in runs):
        draw_stack(figure, runs, panels)
        return
    if lack_samples(runs):
        grid = figure.add_gridspec(len(panels), 2, width_ratios=(1.0, 1.25))
        rows = len(panels)
    else:
        rows = count_plane_rows(panels)
        grid = figure.add_gridspec((len(panels) + rows) // 2, 2)
    plane = figure.add_subplot(grid[:rows, 0])
    draw_paths(plane, runs)
    show_all(plane, runs)
    places = [(row, column) for row in range(grid.nrows) for column in (0, 1)]
    places = [(row, column) for row, column in places if column or row >= rows]
    shared: Axes | None = None
    for panel, (row, column) in zip(panels, places, strict=True):
        shared = axes = figure.add_subplot(grid[row, column], sharex=shared)
        panel(axes, runs)
        if rows == grid.nrows:
            # Low panels have no room for a unit beside its name.
            axes.set_ylabel(axes.get_ylabel().replace(" [", "\n["))
        if row + 1 < grid.nrows:
            axes.set_xlabel("")
            axes.tick_params(labelbottom=False)


def count_plane_rows(panels: Sequence[object]) -> int:
    """Return the rows of two columns that a plane takes so that beside panels no place is empty."""
    return 1 + (len(panels) + 1) % 2


def finish(axes: Axes, runs: Sequence[Run], label: str) -> None:
    """Name the axes of a panel over time."""
    firsts = dict.fromkeys(run.first_row for run in runs)
    axes.set(xlabel=f"time from the first {' or '.join(firsts)} [s]", ylabel=label)
    axes.margins(x=0.01)
    axes.locator_params(axis="x", nbins=6)
