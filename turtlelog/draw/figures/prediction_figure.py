"""A recorded robot beside a simulated one: paths, how errors grow, and rates."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from turtlelog.compare import ErrorGrowth, RobotComparison
from turtlelog.compare.robot_comparison import SHOWN_UNITS
from turtlelog.draw.figures.figure_curves import draw_thinned
from turtlelog.draw.figures.legend import add_legend
from turtlelog.draw.figures.page import MEASURED, MODELLED, REFERENCE, Page, use_looks
from turtlelog.draw.figures.writing import require_figure_path, write_figure
from turtlelog.identify import AxisTraces
from turtlelog.run.loops import COMMAND_UNITS, COMMAND_WORDS

_HEIGHT: Final = 1.0
_STACKED_HEIGHT: Final = 2.6
"""Of the figure, as a share of its width: beside each other, or each panel below the last."""

_SIDE_BY_SIDE_INCH: Final = 5.0
"""Narrower than this, panels stand below each other: their labels would collide."""


_BAND: Final[Mapping[str, Any]] = MappingProxyType(
    {"alpha": 0.25, "linewidth": 0.0, "label": "central 95 % of simulated errors"}
)

_RECORDED: Final = "recorded"
_SIMULATED: Final = "simulated"


def write_prediction_figure(
    found: RobotComparison, path: str | Path, *, page: Page | None = None
) -> Path:
    """Write a figure of a recorded robot beside a simulated one, and return its path.

    Args:
        found: What `turtlelog.compare.compare_robot` returned.
        path: Ends in .pdf, .png or .svg.
        page: Where it will stand.

    Raises:
        ShowError: Where the file cannot be written.
    """
    path = require_figure_path(path)
    page = page or Page(kind="page")
    with use_looks():
        is_wide = page.width_inch >= _SIDE_BY_SIDE_INCH
        height = _HEIGHT if is_wide else _STACKED_HEIGHT
        size = (page.width_inch, page.width_inch * height)
        figure = Figure(figsize=size, layout="constrained")
        ratios = (1.2, 1.2, 1.0, 1.0) if is_wide else (1.0,) * 6
        grid = figure.add_gridspec(len(ratios), 2, height_ratios=ratios)
        _draw_paths(figure.add_subplot(grid[:2, 0] if is_wide else grid[:2, :]), found)
        above = figure.add_subplot(grid[0, 1] if is_wide else grid[2, :])
        _draw_growth(above, found.growth[0])
        below = figure.add_subplot(grid[1, 1] if is_wide else grid[3, :], sharex=above)
        _draw_growth(below, found.growth[1])
        below.set_xlabel("time since the recorded pose [s]")
        shared: Axes | None = None
        for row, traces in enumerate(found.traces, start=2 if is_wide else 4):
            shared = figure.add_subplot(grid[row, :], sharex=shared)
            _draw_rates(shared, traces, found.start_s)
        if shared is not None:
            shared.set_xlabel("time [s]")
        add_legend(figure)
    return write_figure(figure, path, page)


def _draw_paths(axes: Axes, found: RobotComparison) -> None:
    axes.plot(*found.recorded.xy_m.T, **MEASURED, label=_RECORDED, linewidth=1.6)
    pieces = [*found.predict_pieces()]
    for piece in pieces:
        axes.plot(*piece.T, **MODELLED, label=_SIMULATED)
    starts = np.array([piece[0] for piece in pieces])
    axes.plot(*starts.T, ".", color=MODELLED["color"], label="begins at the recorded pose")
    axes.set(xlabel="x [m]", ylabel="y [m]")
    axes.set_aspect("equal", adjustable="datalim")


def _draw_growth(axes: Axes, growth: ErrorGrowth) -> None:
    unit, factor = SHOWN_UNITS[growth.quantity]
    low, median, high = factor * growth.recorded.T
    if growth.simulated is not None:
        least, middle, most = factor * growth.simulated.T
        axes.fill_between(growth.since_s, least, most, color=MODELLED["color"], **_BAND)
        axes.plot(growth.since_s, middle, **MODELLED, label=_SIMULATED)
    axes.plot(growth.since_s, median, **MEASURED, label=_RECORDED)
    for edge in (low, high):
        axes.plot(
            growth.since_s,
            edge,
            color=MEASURED["color"],
            linewidth=0.6,
            label="central 95 % of recorded errors",
        )
    axes.set_ylabel(f"{growth.quantity} error [{unit}]")
    axes.set_ylim(bottom=0.0)
    axes.margins(x=0.01)


def _draw_rates(axes: Axes, traces: AxisTraces, start_s: float) -> None:
    time_s = traces.time_s - start_s
    axes.plot(time_s, traces.commanded, **REFERENCE, label="command")
    for values, looks, label in (
        (traces.measured, MEASURED, _RECORDED),
        (traces.modelled, MODELLED, _SIMULATED),
    ):
        draw_thinned(axes, time_s, values, values, **looks, label=label)
    axes.set_ylabel(f"{COMMAND_WORDS[traces.axis]} [{COMMAND_UNITS[traces.axis]}]")
    axes.margins(x=0.01)
