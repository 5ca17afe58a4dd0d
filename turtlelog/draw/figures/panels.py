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


def draw_columns(figure: Figure, runs: Sequence[Run], panels: Sequence[Draw]) -> None:
    """Draw panels in two columns on one time axis, from left to right."""
    grid = figure.subplots(-(-len(panels) // 2), min(len(panels), 2), sharex=True, squeeze=False)
    for number, axes in enumerate(grid.flat):
        if number >= len(panels):
            axes.remove()
            continue
        panels[number](axes, runs)
        if number + 2 < len(panels):
            axes.set_xlabel("")
        else:
            axes.tick_params(labelbottom=True)


def draw_overview(figure: Figure, runs: Sequence[Run], panels: Sequence[Draw]) -> None:
    """Draw panels in two columns; of runs without samples over each other, beside the plane."""
    if not lack_samples(runs):
        draw_columns(figure, runs, panels)
        return
    grid = figure.add_gridspec(len(panels), 2, width_ratios=(1.0, 1.25))
    plane = figure.add_subplot(grid[:, 0])
    draw_paths(plane, runs)
    show_all(plane, runs)
    shared: Axes | None = None
    for number, panel in enumerate(panels):
        shared = axes = figure.add_subplot(grid[number, 1], sharex=shared)
        panel(axes, runs)
        # Low panels have no room for a unit beside its name.
        axes.set_ylabel(axes.get_ylabel().replace(" [", "\n["))
        if number + 1 < len(panels):
            axes.set_xlabel("")
            axes.tick_params(labelbottom=False)


def finish(axes: Axes, runs: Sequence[Run], label: str) -> None:
    """Name the axes of a panel over time."""
    firsts = dict.fromkeys("sample" if len(run.samples) else "pose" for run in runs)
    axes.set(xlabel=f"time from the first {' or '.join(firsts)} [s]", ylabel=label)
    axes.margins(x=0.01)
    axes.locator_params(axis="x", nbins=6)
