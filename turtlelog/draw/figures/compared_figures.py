"""Figures of comparisons: runs, a robot and its model, a path and its reference."""

import math
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec

from turtlelog.charts.attribution_steps import draw_up_difference
from turtlelog.charts.time_plots import TIME_PLOTS, label_error
from turtlelog.compare import ErrorGrowth, RobotComparison, TrajectoryComparison
from turtlelog.compare.robot_comparison import SHOWN_UNITS
from turtlelog.compare.trajectory_errors import Values
from turtlelog.draw.figures.attribution_figure import draw_waterfall
from turtlelog.draw.figures.figure_curves import add_legend, draw_thinned
from turtlelog.draw.figures.page import (
    MEASURED,
    MODELLED,
    REFERENCE,
    SIDE_BY_SIDE_INCH,
    Page,
    fix_style,
    use_looks,
)
from turtlelog.draw.figures.rates_figure import draw_rates
from turtlelog.draw.figures.writing import require_figure_path, write_figure
from turtlelog.errors import ShowError
from turtlelog.explain import ExplainedDifference
from turtlelog.identify import AxisTraces, RobotModel
from turtlelog.run import Run

_LINE_INCH = 0.27
"""Height of a bar with its text [inch]."""

_BARS = 0.72
"""Width of the bars with the text next to them, as a share of the figure's width."""


def write_difference_figure(
    found: ExplainedDifference, path: str | Path, *, page: Page | None = None
) -> Path:
    """Write a figure of the causes of a difference between two runs, and return its path.

    Args:
        found: Result of `turtlelog.explain_difference`.
        path: File name with the suffix .pdf, .png or .svg.
        page: Page format.

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


def write_robot_figure(
    model: RobotModel, run: Run, path: str | Path, *, page: Page | None = None
) -> Path:
    """Write the figure `rates` of a run with a given model, and return its path.

    Args:
        model: Result of `turtlelog.identify_robot`.
        run: Run whose motion is drawn: an identified run, or another run.
        path: File name with the suffix .pdf, .png or .svg.
        page: Page format.

    Raises:
        ShowError: If no axis is known, or the file cannot be written.
    """
    path = require_figure_path(path)
    if not any(axis.is_known for axis in model.axes):
        reasons = "; ".join(axis.reason for axis in model.axes)
        raise ShowError(f"{path}: no axis was identified: {reasons}")
    page = page or Page(kind="page")
    with use_looks():
        figure = Figure(figsize=(page.width_inch, page.width_inch), layout="constrained")
        draw_rates(figure, [run], model=model)
        add_legend(figure)
    return write_figure(figure, path, page)


_HEIGHT: Final = 1.0
_STACKED_HEIGHT: Final = 2.6
"""Height of the figure as a share of its width, for panels side by side and stacked."""

_BAND: Final = fix_style(alpha=0.25, linewidth=0.0, label="central 95 % of simulated errors")

_RECORDED: Final = "recorded"
_SIMULATED: Final = "simulated"


def write_prediction_figure(
    found: RobotComparison, path: str | Path, *, page: Page | None = None
) -> Path:
    """Write a figure of a recorded robot and a simulated one, and return its path.

    Args:
        found: Result of `turtlelog.compare.compare_robot`.
        path: File name with the suffix .pdf, .png or .svg.
        page: Page format.

    Raises:
        ShowError: If the file cannot be written.
    """
    path = require_figure_path(path)
    page = page or Page(kind="page")
    with use_looks():
        is_wide = page.width_inch >= SIDE_BY_SIDE_INCH
        height = _HEIGHT if is_wide else _STACKED_HEIGHT
        size = (page.width_inch, page.width_inch * height)
        figure = Figure(figsize=size, layout="constrained")
        ratios = (1.2, 1.2, 1.0, 1.0) if is_wide else (1.0,) * 6
        grid = figure.add_gridspec(len(ratios), 2, height_ratios=ratios)
        _draw_predicted(figure.add_subplot(grid[:2, 0] if is_wide else grid[:2, :]), found)
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


def _draw_predicted(axes: Axes, found: RobotComparison) -> None:
    axes.plot(*found.recorded.xy_m.T, **MEASURED, label=_RECORDED, linewidth=1.6)
    pieces = [*found.predict_pieces()]
    for piece in pieces:
        axes.plot(*piece.T, **MODELLED, label=_SIMULATED)
    starts = np.array([piece[0] for piece in pieces])
    axes.plot(*starts.T, ".", color=MODELLED["color"], label="begins at the recorded pose")
    axes.set(xlabel="x [m]", ylabel="y [m]")
    axes.set_aspect("equal", adjustable="datalim")


def _draw_growth(axes: Axes, growth: ErrorGrowth) -> None:
    _, factor = SHOWN_UNITS[growth.quantity]
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
    axes.set_ylabel(label_error(growth.quantity))
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
    axes.set_ylabel(TIME_PLOTS[traces.axis].label)
    axes.margins(x=0.01)


_PLANE_ROWS: Final = 2.2
"""Height of the panel of paths, as a multiple of a panel over time."""

_ROW_HEIGHT: Final = 0.26
"""Height of a panel over time, as a share of the figure's width."""


def write_trajectory_figure(
    found: TrajectoryComparison, path: str | Path, *, page: Page | None = None
) -> Path:
    """Write a figure of an aligned trajectory and its reference, and return its path.

    Args:
        found: Result of `turtlelog.compare.compare_trajectories`.
        path: File name with the suffix .pdf, .png or .svg.
        page: Page format.

    Raises:
        ShowError: If the file cannot be written.
    """
    path = require_figure_path(path)
    page = page or Page(kind="page")
    rows = 2 if found.space == "plane" else 3
    with use_looks():
        height = page.width_inch * _ROW_HEIGHT * (_PLANE_ROWS + rows)
        figure = Figure(figsize=(page.width_inch, height), layout="constrained")
        grid = figure.add_gridspec(rows + 1, 1, height_ratios=(_PLANE_ROWS, *(1.0,) * rows))
        _draw_aligned(figure.add_subplot(grid[0]), found)
        _draw_over_time(figure, grid, found)
        add_legend(figure)
    return write_figure(figure, path, page)


def _draw_aligned(axes: Axes, found: TrajectoryComparison) -> None:
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
