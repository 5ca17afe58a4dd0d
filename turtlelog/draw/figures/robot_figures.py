"""Figures of a robot: its response to commands, its model beside it, and its trajectory errors."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec

from turtlelog import identify
from turtlelog.charts.curves import Command, Curve, Values, read_applied, read_command
from turtlelog.charts.palette import DEAD_TIME, OUTLIER, TIME_CONSTANT, darken, to_hex
from turtlelog.charts.plane_scene import find_time_breaks, list_time_gaps
from turtlelog.charts.plotted_curves import find_command_changes, label_time
from turtlelog.charts.time_plots import TIME_PLOTS, label_error, read_measured
from turtlelog.compare import ErrorGrowth, RobotComparison, TrajectoryComparison
from turtlelog.compare.robot_comparison import SHOWN_UNITS
from turtlelog.display import describe_count
from turtlelog.draw.figures import page as pages
from turtlelog.draw.figures.figure_curves import (
    add_legend,
    draw_curve,
    draw_thinned,
    label_runs,
    require_one_run,
)
from turtlelog.draw.figures.page import MEASURED, MODELLED, REFERENCE, Page, fix_style, use_looks
from turtlelog.draw.figures.time_panels import shade_gaps
from turtlelog.errors import ShowError
from turtlelog.identify.axis_model import join_rates
from turtlelog.identify.axis_motion import measure_axis_steps, read_axis_motion
from turtlelog.run import Run
from turtlelog.run.angles import Trajectory
from turtlelog.run.loops import COMMAND_UNITS, COMMAND_WORDS

_ROW_INCH: Final = 1.25
_LEFT_INCH: Final = 0.75

_BEFORE_S: Final = 0.25  # time shown before the change [s]

_LEAST_AFTER_S: Final = 0.8
_LENGTHS: Final = 6.0
"""Time shown after a step, in dead times plus time constants; after 5, 1 % is left."""

_FINE: Final = 600  # number of points of the model in the close-up

_SHOWN_MS: Final = 2.0
"""Smallest width of an interval that is drawn [ms]; a narrower interval is a single stroke."""

_REASON_LETTERS: Final = 58

_COMMAND: Final = fix_style(color="0.3", linewidth=0.9)
_EACH: Final = fix_style(color="0.6", linewidth=0.7, zorder=2.0, label="motion after each change")
_OUTLIER: Final = fix_style(color=to_hex(OUTLIER), markersize=4.5, label="left out of the fit")
_DEAD: Final = fix_style(color=to_hex(DEAD_TIME), alpha=0.3, lw=0.0, zorder=0.6, label="dead time")
_INTERVAL: Final = fix_style(
    color=to_hex(darken(DEAD_TIME)), lw=0.9, marker="|", ms=5.0, label="dead time: interval"
)
_LAG: Final = fix_style(
    color=to_hex(TIME_CONSTANT), alpha=0.25, lw=0.0, zorder=0.6, label="time constant"
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrawnAxis:
    """Data drawn for one axis."""

    model: identify.AxisModel  # result of the identification, or the reason why it is missing
    brackets: str  # meaning of the values in brackets
    command: Curve  # held command
    measured: tuple[Values, Values] | None  # measured rate of the robot; None if unknown
    has_means: bool  # whether the measured rates are means of steps between poses
    traces: identify.AxisTraces | None  # measured rate and model, if a model is known
    outliers_s: Values  # end times of steps that the fit left out [s], shape (m,)


def draw_rates(
    figure: Figure, runs: Sequence[Run], *, model: identify.RobotModel | None = None
) -> None:
    """Draw commands and measured rates of one run, with its model by `identify_robot`.

    ShowError if the run has no commands.
    """
    run = require_one_run("rates", runs)
    model = identify.identify_robot([run]) if model is None else model
    drawn = [found for axis in model.axes if (found := _read_axis(axis, model, run)) is not None]
    if not drawn:
        raise ShowError("figure rates needs commands that are not always 0")
    width = figure.get_figwidth()
    is_wide = width >= pages.SIDE_BY_SIDE_INCH
    rows: list[tuple[DrawnAxis, str, float]] = []
    for one in drawn:
        rows.append((one, "rates", _ROW_INCH))
        rows += [(one, "left", _LEFT_INCH)] if one.traces is not None else []
        rows += [] if is_wide else [(one, "step", _ROW_INCH)]
    heights = [height for _, _, height in rows]
    figure.set_size_inches(width, sum(heights) + 0.5 + 0.18 * len(rows))
    widths = [1.5, 1.0][: 1 + is_wide]
    grid = figure.add_gridspec(len(rows), len(widths), height_ratios=heights, width_ratios=widths)
    shared: Axes | None = None
    for number, (one, part, _) in enumerate(rows):
        if part == "step":
            _draw_step(figure.add_subplot(grid[number, 0]), one, run)
            continue
        axes = figure.add_subplot(grid[number, 0], sharex=shared)
        shared = shared or axes
        (_draw_whole if part == "rates" else _draw_left)(axes, one, run)
        if is_wide and part == "rates":
            span = slice(number, number + 1 + (one.traces is not None))
            _draw_step(figure.add_subplot(grid[span, 1]), one, run)
        is_last = not any(later == "rates" for _, later, _ in rows[number + 1 :])
        if part == "left" or one.traces is None:
            axes.set_xlabel(label_time([run]) if is_last or not is_wide else "")
        axes.tick_params(labelbottom=part == "left" or one.traces is None)


def lacks_commands(run: Run) -> bool:
    """Return whether the run has no command that the robot could follow."""
    curves = [read_command(run, name) for name in get_args(Command)]
    return not any(curve is not None and np.any(curve.values) for curve in curves)


def _read_axis(axis: identify.AxisModel, model: identify.RobotModel, run: Run) -> DrawnAxis | None:
    command = read_command(run, axis.axis)
    if command is None or not np.any(command.values):
        return None
    traces = identify.trace_axis(axis, run) if axis.is_known else None
    measured = None if traces is None else (traces.time_s - run.start_ns / 1e9, traces.measured)
    has_means = traces is not None
    if traces is None:
        reported = read_measured(run, axis.axis)
        curve = read_applied(run, axis.axis) if reported is None else reported[0]
        measured = None if curve is None else (curve.time_s, curve.values)
        has_means = measured is None and len(run.poses) > 1
        measured = _measure_means(run, axis.axis) if has_means else measured
    return DrawnAxis(
        model=axis,
        brackets=model.brackets,
        command=command,
        measured=measured,
        has_means=has_means,
        traces=traces,
        outliers_s=np.array([one.time_s for one in model.events if one.axis == axis.axis]),
    )


def _measure_means(run: Run, axis: Command) -> tuple[Values, Values]:
    """Return times [s] and mean rates of the robot, from its poses, for an axis without a model."""
    time_s, moved, _ = measure_axis_steps(run.poses, axis)
    found = join_rates(axis, read_axis_motion(run, axis), time_s, moved, np.zeros_like(moved))
    return found.time_s - run.start_ns / 1e9, found.measured


def _draw_whole(axes: Axes, one: DrawnAxis, run: Run) -> None:
    axes.axhline(0.0, color="0.8", linewidth=0.5)
    command = one.command  # held until the last pose
    if len(run.poses) and (end_ns := int(run.poses.time_ns[-1])) > command.time_ns[-1]:
        values = np.append(command.values, command.values[-1])
        command = replace(command, time_ns=np.append(command.time_ns, end_ns), values=values)
    draw_curve(axes, command, **_COMMAND, label="command")
    # Means extend over their steps: lines between their middles would begin before a command.
    looks: dict[str, Any] = {"drawstyle": "steps-mid"} if one.has_means else {}
    told = ""
    if one.measured is not None:
        time_s, values = one.measured
        if one.has_means and len(time_s) > 1:
            told = f", means of {np.median(np.diff(time_s)):.2g} s"
        draw_thinned(axes, time_s, values, values, **pages.MEASURED, **looks, label=f"motion{told}")
    if one.traces is not None:
        time_s, values = one.traces.time_s - run.start_ns / 1e9, one.traces.modelled
        draw_thinned(axes, time_s, values, values, **pages.MODELLED, **looks, label=f"model{told}")
    axes.set_ylabel(TIME_PLOTS[one.model.axis].label)
    axes.margins(x=0.01)
    if one.traces is not None:
        axes.set_title(f"{label_runs([run])[0]}: {COMMAND_WORDS[one.model.axis]}")
    else:
        told = pages.break_words(f"not identified: {one.model.reason}", _REASON_LETTERS)
        axes.set_title(told, fontsize=7.0, color="0.35")


def _draw_left(axes: Axes, one: DrawnAxis, run: Run) -> None:
    if one.traces is None:
        return
    axes.axhline(0.0, **REFERENCE)
    unit = COMMAND_UNITS[one.model.axis]
    time_s, values = one.traces.time_s - run.start_ns / 1e9, one.traces.residual
    draw_thinned(axes, time_s, values, values, **pages.MEASURED, drawstyle="steps-mid")
    if len(one.outliers_s):
        # An outlier has the time of the pose after its step, traces that of the middle of one or
        # more steps.
        near = np.searchsorted(time_s, one.outliers_s)[:, None] + np.arange(-2, 2)
        near = np.clip(near, 0, len(values) - 1)
        rows = near[np.arange(len(near)), np.abs(values[near]).argmax(axis=1)]
        axes.plot(time_s[rows], values[rows], "x", **_OUTLIER)
        largest = rows[int(np.abs(values[rows]).argmax())]
        told = f"left out: {values[largest]:+.3g} {unit} at {time_s[largest]:.2f} s"
        told += f", the largest of {len(rows)}" if len(rows) > 1 else ""
        text = axes.text(1.0, 1.0, told, fontsize=6.5, color=_OUTLIER["color"])
        text.set(transform=axes.transAxes, ha="right", va="bottom")
    axes.set_ylabel(f"residual\n[{unit}]")


def _draw_step(axes: Axes, one: DrawnAxis, run: Run) -> None:
    """Draw all large changes of the command over each other, with robot and model."""
    found = one.model.dead_time_s
    dead_s, lag_s = _read(found), _read(one.model.lag_s)
    gain = 1.0 if one.model.gain is None else one.model.gain.value
    after_s = max(_LENGTHS * (dead_s + lag_s), _LEAST_AFTER_S)
    if one.model.is_known:
        if dead_s > 0.0:
            axes.axvspan(0.0, dead_s, **_DEAD)
        if found is not None and 1e3 * (found.high - found.low) >= _SHOWN_MS:
            edge = axes.get_xaxis_transform()
            axes.plot([found.low, found.high], [0.96, 0.96], transform=edge, **_INTERVAL)
        if lag_s > 0.0:
            axes.axvspan(dead_s, dead_s + lag_s, **_LAG)
    changes = find_command_changes(one.command)
    for change in changes:
        until_s = min(change.end_s + dead_s, change.half_s + after_s)
        # Before that time the robot still follows the previous change.
        from_s = min(change.begin_s + dead_s, change.half_s)
        command, last_s = one.command, min(change.end_s, until_s)
        is_own = (command.time_s < last_s) | (command.time_s <= change.half_s)
        rows = (command.time_s >= change.begin_s) & is_own
        held_s = np.array([change.half_s - _BEFORE_S, *command.time_s[rows], last_s])
        held = np.array([change.before, *command.values[rows], command.values[rows][-1]])
        looks: dict[str, Any] = {**_COMMAND, "drawstyle": "steps-post"}
        axes.plot(held_s - change.half_s, change.scale(held), **looks)
        if one.measured is not None:
            # Not averaged over tenths of a second like the whole run: delays are shorter.
            time_s, values, half_s = _read_fine(one, run)
            rows = (time_s >= from_s) & (time_s + half_s <= until_s)
            axes.plot(time_s[rows] - change.half_s, change.scale(values[rows], gain), **_EACH)
        if one.traces is not None:
            fine_s = np.linspace(from_s, until_s, _FINE)
            _, rate = identify.predict_axis(one.model, run, fine_s + run.start_ns / 1e9)
            looks = {**pages.MODELLED, "linewidth": 0.9, "zorder": 2.4}
            axes.plot(fine_s - change.half_s, change.scale(rate, gain), **looks)
    axes.set(xlim=(-_BEFORE_S, after_s), ylim=(-0.35, 1.45))
    axes.set_title(tell_model(one, len(changes)), fontsize=7.0, loc="right")
    axes.set_xlabel("time from the change [s]")
    axes.set_ylabel("part of\nthe change")
    axes.locator_params(axis="x", nbins=5)


def _read_fine(one: DrawnAxis, run: Run) -> tuple[Values, Values, Values | float]:
    """Return the middle of each step between two poses [s], its mean rate and half its length."""
    if not one.has_means:
        return *(one.measured or (np.empty(0), np.empty(0))), 0.0
    time_s, moved, _ = measure_axis_steps(run.poses, one.model.axis)
    apart_s = np.diff(time_s)
    return time_s[:-1] + 0.5 * apart_s - run.start_ns / 1e9, moved / apart_s, 0.5 * apart_s


def _read(found: identify.Estimate | None) -> float:
    return 0.0 if found is None else max(found.value, 0.0)


def tell_model(one: DrawnAxis, changes: int) -> str:
    """Return the identified values of an axis, for a title."""
    model = one.model
    told = f"{COMMAND_WORDS[model.axis]}: {describe_count(changes, 'change')}"
    if model.gain is None or model.dead_time_s is None or model.lag_s is None:
        return told
    delays = f"dead time {_tell_ms(model.dead_time_s)}, time constant {_tell_ms(model.lag_s)}"
    return f"{told}, gain {identify.format_gain(model.gain)}\n{delays}\nin brackets: {one.brackets}"


_EXACT_S: Final = 5e-5  # largest width of an interval that tenths of a millisecond do not show [s]


def _tell_ms(found: identify.Estimate) -> str:
    if found.high - found.low < _EXACT_S:
        return f"{1e3 * found.value:.3g} ms"
    return identify.format_delay(found, " ms")


def write_robot_figure(
    model: identify.RobotModel, run: Run, path: str | Path, *, page: Page | None = None
) -> Path:
    """Write the figure `rates` of a run with a model by `identify_robot`, and return its path.

    The run may be an identified run or another run. The file name ends in .pdf, .png or .svg. An
    axis without a model is drawn with the reason. ShowError if the run has no commands, or the file
    cannot be written.
    """
    path = pages.require_figure_path(path)
    page = page or Page(kind="page")
    with use_looks():
        figure = Figure(figsize=(page.width_inch, page.width_inch), layout="constrained")
        draw_rates(figure, [run], model=model)
        add_legend(figure)
    return pages.write_figure(figure, path, page)


_HEIGHT, _STACKED_HEIGHT = 1.0, 2.6
"""Height of the figure as a share of its width, for panels side by side and stacked."""

_BAND: Final = fix_style(alpha=0.25, linewidth=0.0, label="central 95 % of simulated errors")

_RECORDED: Final = fix_style(**MEASURED, label="recorded")
_SIMULATED: Final = fix_style(**MODELLED, label="simulated")


def write_prediction_figure(
    found: RobotComparison, path: str | Path, *, page: Page | None = None
) -> Path:
    """Write a figure of a comparison by `compare_robot`, and return its path.

    The file name ends in .pdf, .png or .svg. ShowError if the file cannot be written.
    """
    path = pages.require_figure_path(path)
    page = page or Page(kind="page")
    with use_looks():
        is_wide = page.width_inch >= pages.SIDE_BY_SIDE_INCH
        height = page.width_inch * (_HEIGHT if is_wide else _STACKED_HEIGHT)
        figure = Figure(figsize=(page.width_inch, height), layout="constrained")
        ratios = (1.2, 1.2, 1.0, 1.0) if is_wide else (1.0,) * 6
        grid = figure.add_gridspec(len(ratios), 2, height_ratios=ratios)
        _draw_predicted(figure.add_subplot(grid[:2, 0] if is_wide else grid[:2, :]), found)
        first, column = (0, 1) if is_wide else (2, slice(None))
        axes = figure.add_subplot(grid[first, column])
        _draw_growth(axes, found.growth[0])
        axes = figure.add_subplot(grid[first + 1, column], sharex=axes)
        _draw_growth(axes, found.growth[1])
        axes.set_xlabel("time since the recorded pose [s]")
        shared: Axes | None = None
        for row, traces in enumerate(found.traces, start=2 if is_wide else 4):
            shared = figure.add_subplot(grid[row, :], sharex=shared)
            time_s = traces.time_s - found.start_s
            shared.plot(time_s, traces.commanded, **REFERENCE, label="command")
            draw_thinned(shared, time_s, traces.measured, traces.measured, **_RECORDED)
            draw_thinned(shared, time_s, traces.modelled, traces.modelled, **_SIMULATED)
            shared.set_ylabel(TIME_PLOTS[traces.axis].label)
            shared.margins(x=0.01)
        if shared is not None:
            shared.set_xlabel("time [s]")
        add_legend(figure)
    return pages.write_figure(figure, path, page)


def _draw_predicted(axes: Axes, found: RobotComparison) -> None:
    axes.plot(*found.recorded.xy_m.T, **_RECORDED, linewidth=1.6)
    pieces = [*found.predict_pieces()]
    for piece in pieces:
        axes.plot(*piece.T, **_SIMULATED)
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
        axes.plot(growth.since_s, middle, **_SIMULATED)
    axes.plot(growth.since_s, median, **_RECORDED)
    looks = {**MEASURED, "linewidth": 0.6, "label": "central 95 % of recorded errors"}
    for edge in (low, high):
        axes.plot(growth.since_s, edge, **looks)
    axes.set_ylabel(label_error(growth.quantity))
    axes.set_ylim(bottom=0.0)
    axes.margins(x=0.01)


_PLANE_ROWS: Final = 2.2  # height of the panel of paths, as a multiple of a panel over time
_ROW_HEIGHT: Final = 0.26  # height of a panel over time, as a share of the figure's width


def write_trajectory_figure(
    found: TrajectoryComparison, path: str | Path, *, page: Page | None = None
) -> Path:
    """Write a figure of a comparison by `compare_trajectories`, and return its path.

    The file name ends in .pdf, .png or .svg. ShowError if the file cannot be written.
    """
    path = pages.require_figure_path(path)
    page = page or Page(kind="page")
    rows = 2 if found.space == "plane" else 3
    with use_looks():
        height = page.width_inch * _ROW_HEIGHT * (_PLANE_ROWS + rows)
        figure = Figure(figsize=(page.width_inch, height), layout="constrained")
        grid = figure.add_gridspec(rows + 1, 1, height_ratios=(_PLANE_ROWS, *(1.0,) * rows))
        axes = figure.add_subplot(grid[0])
        for one, looks, label in _list_paths(found):
            x, y = _break_at_gaps(one, one.xyz_m[:, :2]).T
            draw_thinned(axes, x, y, y, **looks, label=label)
        worst = int(found.absolute.position_m.argmax())
        both = np.array([found.reference.xyz_m[worst], found.estimate.xyz_m[worst]])
        axes.plot(both[:, 0], both[:, 1], color="0.15", linewidth=1.0)
        axes.plot(*both[1, :2], ".", color="0.15", label="largest position error")
        axes.set(xlabel="x [m]", ylabel="y [m]")
        axes.set_aspect("equal", adjustable="datalim")
        _draw_over_time(figure, grid, found)
        add_legend(figure)
    return pages.write_figure(figure, path, page)


def _break_at_gaps(times: Trajectory, values: Values) -> Values:
    """Return values at the times of a trajectory, with NaN in the gaps of these times."""
    if times.clock == "frame":
        return values
    return np.insert(values, find_time_breaks(times.time_ns), np.nan, axis=0)


def _list_paths(found: TrajectoryComparison) -> list[tuple[Trajectory, dict[str, Any], str]]:
    """Return both trajectories; the reference has poses without a partner too."""
    how = "" if found.align == "none" else ", aligned"
    theirs, ours = (Path(name).name for name in (found.reference_name, found.name))
    return [
        (found.whole_reference, {**MODELLED, "linewidth": 1.3}, f"{theirs}, reference"),
        (found.estimate, {**MEASURED, "linewidth": 1.0}, f"{ours}{how}"),
    ]


def _draw_over_time(figure: Figure, grid: GridSpec, found: TrajectoryComparison) -> None:
    time_ns = found.reference.time_ns
    is_frame = found.reference.clock == "frame"
    zero_ns = 0 if is_frame else int(time_ns[0])
    gaps = [] if is_frame else list_time_gaps(time_ns, zero_ns)

    def read_across(times: Trajectory) -> Values:
        return _break_at_gaps(times, (times.time_ns - zero_ns) / 1e9)

    turn = "heading" if found.space == "plane" else "rotation"
    panels: list[tuple[str, Values]] = [
        ("position error [m]", found.absolute.position_m),
        (f"{turn} error [deg]", np.degrees(found.absolute.rotation_rad)),
    ]
    axes: Axes | None = None
    for row, (label, values) in enumerate(panels, start=1):
        axes = figure.add_subplot(grid[row], sharex=axes)
        broken = _break_at_gaps(found.reference, values)
        draw_thinned(axes, read_across(found.reference), broken, broken, **MEASURED, linewidth=0.9)
        shade_gaps(axes, gaps)
        rmse = math.sqrt(float((values**2).mean()))
        axes.axhline(rmse, **REFERENCE, linestyle="--", label="RMSE")
        axes.set_ylabel(label)
        axes.set_ylim(bottom=0.0)
    if found.space == "space":
        axes = figure.add_subplot(grid[3], sharex=axes)
        for one, looks, _ in _list_paths(found):
            z_m = _break_at_gaps(one, one.xyz_m[:, 2])
            draw_thinned(axes, read_across(one), z_m, z_m, **looks)
        axes.set_ylabel("z [m]")
    if axes is not None:
        axes.set_xlabel("pose" if is_frame else "time [s]")
        axes.margins(x=0.01)
