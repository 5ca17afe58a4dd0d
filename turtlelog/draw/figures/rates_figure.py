"""A robot's response to its commands: command, motion, model, enlarged steps, residuals."""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final, get_args

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from turtlelog import identify
from turtlelog.charts.curves import Command, Curve, Values, read_applied, read_command
from turtlelog.charts.palette import DEAD_TIME, darken, to_hex
from turtlelog.charts.plotted_curves import CommandChange, find_command_changes, label_time
from turtlelog.charts.time_plots import TIME_PLOTS, read_measured
from turtlelog.display import describe_count
from turtlelog.draw.figures import page, run_styles
from turtlelog.draw.figures.figure_curves import draw_curve, draw_thinned
from turtlelog.errors import ShowError
from turtlelog.identify.axis_motion import measure_axis_steps
from turtlelog.run import Run
from turtlelog.run.loops import COMMAND_UNITS, COMMAND_WORDS

_ROW_INCH: Final = 1.25
_LEFT_INCH: Final = 0.75

_BEFORE_S: Final = 0.25
"""Time shown before the change [s]."""

_LEAST_AFTER_S: Final = 0.8
_LENGTHS: Final = 6.0
"""Time shown after a step, in dead times plus time constants. After 5 time constants, the response
is within 1 %."""

_FINE: Final = 600
"""Number of points of the model in the close-up."""

_SHOWN_MS: Final = 2.0
"""Smallest width of an interval that is drawn [ms]; a narrower interval is a single stroke."""

_REASON_LETTERS: Final = 58

_COMMAND: Final = page.fix_style(color="0.3", linewidth=0.9)
_EACH: Final = page.fix_style(
    color="0.6", linewidth=0.7, zorder=2.0, label="motion after each change"
)
_OUTLIER: Final = page.fix_style(color="#c62828", markersize=4.5, label="left out of the fit")
_DEAD: Final = page.fix_style(
    color=to_hex(DEAD_TIME), alpha=0.3, lw=0.0, zorder=0.6, label="dead time"
)
_INTERVAL: Final = page.fix_style(
    color=to_hex(darken(DEAD_TIME)), lw=0.9, marker="|", ms=5.0, label="dead time: interval"
)
_LAG: Final = page.fix_style(
    color="#56b4e9", alpha=0.25, linewidth=0.0, zorder=0.6, label="time constant"
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrawnAxis:
    """Data drawn for one axis.

    Attributes:
        model: Result of the identification, or the reason why it is missing.
        brackets: Meaning of the values in brackets.
        command: Held command.
        measured: Measured rate of the robot; None if unknown.
        traces: Measured rate and model, if a model is known.
        outliers_s: End times of steps that the fit left out, shape (m,).
    """

    model: identify.AxisModel
    brackets: str
    command: Curve
    measured: tuple[Values, Values] | None
    traces: identify.AxisTraces | None
    outliers_s: Values = field(default_factory=lambda: np.empty(0))


def draw_rates(
    figure: Figure, runs: Sequence[Run], *, model: identify.RobotModel | None = None
) -> None:
    """Draw commands and measured rates of one run, with its model by `identify_robot`.

    Raises:
        ShowError: If there is not exactly one run, or the run has no commands.
    """
    if len(runs) != 1:
        raise ShowError(f"figure rates: expected one recording, found {len(runs)}")
    (run,) = runs
    model = identify.identify_robot([run]) if model is None else model
    drawn = [found for axis in model.axes if (found := _read_axis(axis, model, run)) is not None]
    if not drawn:
        raise ShowError("figure rates needs commands that are not always 0")
    width = figure.get_figwidth()
    is_wide = width >= page.SIDE_BY_SIDE_INCH
    rows: list[tuple[DrawnAxis, str, float]] = []
    for one in drawn:
        rows.append((one, "rates", _ROW_INCH))
        rows += [(one, "left", _LEFT_INCH)] if one.traces is not None else []
        rows += [] if is_wide else [(one, "step", _ROW_INCH)]
    heights = [height for _, _, height in rows]
    figure.set_size_inches(width, sum(heights) + 0.5 + 0.18 * len(rows))
    grid = figure.add_gridspec(
        len(rows),
        2 if is_wide else 1,
        height_ratios=heights,
        width_ratios=[1.5, 1.0][: 1 + is_wide],
    )
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
    drawn = partial(DrawnAxis, model=axis, brackets=model.brackets, command=command)
    if axis.is_known:
        traces = identify.trace_axis(axis, run)
        measured = (traces.time_s - run.start_ns / 1e9, traces.measured)
        outliers = [event.time_s for event in model.events if event.axis == axis.axis]
        return drawn(measured=measured, traces=traces, outliers_s=np.array(outliers))
    reported = read_measured(run, axis.axis)
    curve = read_applied(run, axis.axis) if reported is None else reported.curve
    return drawn(measured=None if curve is None else (curve.time_s, curve.values), traces=None)


def _draw_whole(axes: Axes, one: DrawnAxis, run: Run) -> None:
    axes.axhline(0.0, color="0.8", linewidth=0.5)
    draw_curve(axes, _hold_to_end(one.command, run), **_COMMAND, label="command")
    if one.measured is not None:
        time_s, values = one.measured
        draw_thinned(axes, time_s, values, values, **page.MEASURED, label="motion")
    if one.traces is not None:
        time_s, values = one.traces.time_s - run.start_ns / 1e9, one.traces.modelled
        draw_thinned(axes, time_s, values, values, **page.MODELLED, label="model")
    axes.set_ylabel(TIME_PLOTS[one.model.axis].label)
    axes.margins(x=0.01)
    if one.traces is not None:
        axes.set_title(f"{run_styles.label_runs([run])[0]}: {COMMAND_WORDS[one.model.axis]}")
    else:
        reason = f"not identified: {one.model.reason}"
        told = "\n".join(textwrap.wrap(reason, _REASON_LETTERS, max_lines=3, placeholder=" ..."))
        axes.set_title(told, fontsize=7.0, color="0.35")


def _hold_to_end(command: Curve, run: Run) -> Curve:
    """Return a command that is held until the last pose."""
    end_ns = int(run.poses.time_ns[-1]) if len(run.poses) else int(command.time_ns[-1])
    if end_ns <= command.time_ns[-1]:
        return command
    return Curve(
        start_ns=command.start_ns,
        time_ns=np.append(command.time_ns, end_ns),
        values=np.append(command.values, command.values[-1]),
        holds=command.holds,
    )


def _draw_left(axes: Axes, one: DrawnAxis, run: Run) -> None:
    """Draw the residual of the model."""
    if one.traces is None:
        return
    axes.axhline(0.0, **page.REFERENCE)
    time_s, values = one.traces.time_s - run.start_ns / 1e9, one.traces.residual
    draw_thinned(axes, time_s, values, values, **page.MEASURED)
    if len(one.outliers_s):
        # An outlier has the time of the pose after its step, traces that of the middle of one or
        # more steps.
        near = np.searchsorted(time_s, one.outliers_s)[:, None] + np.arange(-2, 2)
        near = np.clip(near, 0, len(values) - 1)
        rows = near[np.arange(len(near)), np.abs(values[near]).argmax(axis=1)]
        axes.plot(time_s[rows], values[rows], "x", **_OUTLIER)
        _name_outliers(axes, time_s[rows], values[rows], COMMAND_UNITS[one.model.axis])
    axes.set_ylabel(f"residual\n[{COMMAND_UNITS[one.model.axis]}]")


def _name_outliers(axes: Axes, time_s: Values, values: Values, unit: str) -> None:
    """Write above a panel the size of outliers that the fit ignores, or of the largest outlier."""
    largest = int(np.abs(values).argmax())
    told = f"left out: {values[largest]:+.3g} {unit} at {time_s[largest]:.2f} s"
    if len(values) > 1:
        told += f", the largest of {len(values)}"
    text = axes.text(1.0, 1.0, told, fontsize=6.5, color=_OUTLIER["color"])
    text.set(transform=axes.transAxes, ha="right", va="bottom")


def _draw_step(axes: Axes, one: DrawnAxis, run: Run) -> None:
    """Draw all large changes of the command over each other, with robot and model."""
    dead_s, lag_s = _read(one.model.dead_time_s), _read(one.model.lag_s)
    longest_s = 0.0 if one.model.dead_time_s is None else max(one.model.dead_time_s.high, 0.0)
    after_s = max(_LENGTHS * (dead_s + lag_s), _LEAST_AFTER_S)
    if one.model.is_known:
        if dead_s > 0.0:
            axes.axvspan(0.0, dead_s, **_DEAD)
        if one.model.dead_time_s is not None:
            _draw_interval(axes, one.model.dead_time_s)
        if lag_s > 0.0:
            axes.axvspan(dead_s, dead_s + lag_s, **_LAG)
    changes = find_command_changes(one.command)
    for change in changes:
        until_s = min(change.end_s + longest_s, change.half_s + after_s)
        # Before that time the robot still follows the previous change.
        from_s = min(change.begin_s + dead_s, change.half_s)
        _draw_command(axes, one.command, change, min(change.end_s, until_s))
        if one.measured is not None:
            # Not averaged over tenths of a second like the whole run: delays are shorter.
            _draw_followed(axes, change, *_read_fine(one, run), (from_s, until_s), **_EACH)
        if one.traces is not None:
            fine_s = np.linspace(from_s, until_s, _FINE)
            _, rate = identify.predict_axis(one.model, run, fine_s + run.start_ns / 1e9)
            looks = {**page.MODELLED, "linewidth": 0.9, "zorder": 2.4}
            _draw_followed(axes, change, fine_s, rate, (from_s, until_s), **looks)
    axes.set(xlim=(-_BEFORE_S, after_s), ylim=(-0.35, 1.45))
    axes.set_title(tell_model(one, len(changes)), fontsize=7.0, loc="right")
    axes.set_xlabel("time from the change [s]")
    axes.set_ylabel("part of\nthe change")
    axes.locator_params(axis="x", nbins=5)


def _draw_command(axes: Axes, command: Curve, change: CommandChange, until_s: float) -> None:
    """Draw a commanded change, from the level before it."""
    rows = (command.time_s >= change.begin_s) & (command.time_s <= until_s)
    time_s = [change.half_s - _BEFORE_S, *command.time_s[rows], until_s]
    values = [change.before, *command.values[rows], command.values[rows][-1]]
    looks = {**_COMMAND, "drawstyle": "steps-post"}
    axes.plot(np.array(time_s) - change.half_s, change.scale(np.array(values)), **looks)


def _draw_followed(
    axes: Axes,
    change: CommandChange,
    time_s: Values,
    values: Values,
    span_s: tuple[float, float],
    **looks: Any,
) -> None:
    """Draw the response to a change, over the time since half of the commanded change."""
    rows = (time_s >= span_s[0]) & (time_s <= span_s[1])
    axes.plot(time_s[rows] - change.half_s, change.scale(values[rows]), **looks)


def _draw_interval(axes: Axes, dead_time: identify.Estimate) -> None:
    """Draw the interval of the dead time's end, at the upper edge."""
    if 1e3 * (dead_time.high - dead_time.low) < _SHOWN_MS:
        return
    ends = [dead_time.low, dead_time.high]
    axes.plot(ends, [0.96, 0.96], transform=axes.get_xaxis_transform(), **_INTERVAL)


def _read_fine(one: DrawnAxis, run: Run) -> tuple[Values, Values]:
    """Return the mean rate of each step between two poses, at its middle [s]."""
    if one.traces is None:
        return one.measured or (np.empty(0), np.empty(0))
    time_s, moved, _ = measure_axis_steps(run.poses, one.model.axis)
    apart_s = np.diff(time_s)
    return time_s[:-1] + 0.5 * apart_s - run.start_ns / 1e9, moved / apart_s


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


def _tell_ms(found: identify.Estimate) -> str:
    if found.high - found.low < _EXACT_S:
        return f"{1e3 * found.value:.3g} ms"
    value, _, interval = identify.format_delay(found).partition(" ")
    return f"{value} ms {interval}"


_EXACT_S: Final = 5e-5
"""Largest width of an interval that tenths of a millisecond do not show [s]."""
