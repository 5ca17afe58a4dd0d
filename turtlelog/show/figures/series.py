"""Figures over time: what the robot did, what it missed, and what it was told."""

from collections.abc import Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from turtlelog.compare import name_runs
from turtlelog.run import Run
from turtlelog.show.figures.curves import (
    Curve,
    compute_ideal,
    draw_curve,
    draw_level,
    read_applied,
    read_curve,
    read_world_velocity,
)
from turtlelog.show.figures.page import IDEAL, REFERENCE, choose_lines

_LIMITS = {"speed": "limits.speed_m_s", "turn_rate": "limits.turn_rate_rad_s"}
_UNITS = {"speed": "m/s", "turn_rate": "rad/s"}
_MOST_IN_LEGEND = 8


def draw_signal(axes: Axes, runs: Sequence[Run], *, signal: str, label: str) -> None:
    """Draw one signal of every run, with its goal and the ideal response where there are."""
    _draw_targets(axes, runs, signal)
    is_named = False
    for run, looks in _style_runs(runs):
        if signal in {"heading", "x", "y"} and (ideal := compute_ideal(run, signal)) is not None:
            draw_curve(axes, ideal, **IDEAL, label=None if is_named else "ideal")
            is_named = True
        if (curve := read_curve(run, signal)) is not None:
            draw_curve(axes, curve, **looks)
    _finish(axes, label)


def draw_error_magnitude(axes: Axes, runs: Sequence[Run], *, signal: str, label: str) -> None:
    """Draw the magnitude of an error on a logarithmic scale: what is exponential is straight."""
    for run, looks in _style_runs(runs):
        if (curve := read_curve(run, signal)) is not None:
            sizes = np.abs(curve.values)
            sizes = np.where(sizes > 0.0, sizes, np.nan)
            draw_curve(axes, Curve(time_s=curve.time_s, values=sizes), **looks)
    axes.set_yscale("log")
    _finish(axes, label)


def draw_command(axes: Axes, runs: Sequence[Run], *, command: str, label: str) -> None:
    """Draw a command: of one run wanted, commanded and applied, of several what was commanded."""
    _draw_limits(axes, runs, command)
    if len(runs) == 1:
        _draw_stages(axes, runs[0], command)
    else:
        for run, looks in _style_runs(runs):
            if (curve := read_curve(run, command)) is not None:
                draw_curve(axes, curve, **looks)
    _finish(axes, f"{label} [{_UNITS[command]}]")
    _keep_to_limits(axes, runs, command)


def draw_wanted(axes: Axes, runs: Sequence[Run], *, command: str, label: str) -> None:
    """Draw commands before clipping, on a symmetric logarithmic scale that is linear to 1."""
    _draw_limits(axes, runs, command)
    for run, looks in _style_runs(runs):
        if (curve := read_curve(run, f"wanted_{command}")) is not None:
            draw_curve(axes, curve, **looks)
    axes.set_yscale("symlog", linthresh=1.0)
    _finish(axes, f"{label} [{_UNITS[command]}]")


def draw_world_velocity(axes: Axes, runs: Sequence[Run], *, axis: int) -> None:
    """Draw a component of gain times error in the world frame, before projection and clipping."""
    for run, looks in _style_runs(runs):
        if (curve := read_world_velocity(run, axis)) is not None:
            draw_curve(axes, curve, **looks)
    _finish(axes, f"Kp e_{'xy'[axis]} [m/s]")


def draw_stack(figure: Figure, runs: Sequence[Run], *, panels: Sequence[Any]) -> None:
    """Draw panels over each other on one time axis, with one legend."""
    grid = figure.subplots(len(panels), 1, sharex=True, squeeze=False)
    for axes, panel in zip(grid[:, 0], panels, strict=True):
        panel(axes, runs)
    for axes, below in pairwise(grid[:, 0]):
        axes.set_xlabel("")
        if _list_labels(axes) == _list_labels(below):
            _drop_legend(below)


def draw_panel(figure: Figure, runs: Sequence[Run]) -> None:
    """Draw the six views of a run on half a page: both loops, what they missed, their commands."""
    grid = figure.subplots(3, 2, sharex=True)
    panels = (
        partial(draw_signal, signal="heading", label="heading [deg]"),
        partial(draw_signal, signal="along_track", label="along-track [m]"),
        partial(draw_error_magnitude, signal="heading_error", label="|heading error| [deg]"),
        partial(draw_signal, signal="cross_track", label="cross-track [m]"),
        partial(draw_command, command="turn_rate", label="turn rate"),
        partial(draw_command, command="speed", label="speed"),
    )
    for axes, panel in zip(grid.flat, panels, strict=True):
        panel(axes, runs)
        if axes is not grid[0, 1] and len(runs) > 1:
            _drop_legend(axes)
    for axes in grid[:-1].flat:
        axes.set_xlabel("")


def _style_runs(runs: Sequence[Run]) -> list[tuple[Run, dict[str, Any]]]:
    styled = zip(runs, name_runs(runs), choose_lines(len(runs)), strict=True)
    return [(run, {**looks, "label": name}) for run, name, looks in styled]


def _draw_targets(axes: Axes, runs: Sequence[Run], signal: str) -> None:
    levels: set[float] = set()
    if signal == "heading":
        levels = {float(np.degrees(run.samples.bearing_rad[0])) for run in runs if len(run.samples)}
    elif signal in {"x", "y"}:
        axis = "xy".index(signal)
        levels = {run.goal_xy_m[axis] for run in runs if run.goal_xy_m is not None}
    elif "error" in signal or signal in {"cross_track", "distance"}:
        draw_level(axes, [0.0], **REFERENCE)
    if levels:
        name = "goal bearing" if signal == "heading" else "goal"
        draw_level(axes, sorted(levels), **REFERENCE, label=name)


def _draw_limits(axes: Axes, runs: Sequence[Run], command: str) -> None:
    limits = _find_limits(runs, command)
    draw_level(axes, [0.0], color="0.8", linewidth=0.5)
    levels = [sign * limit for limit in limits for sign in (1.0, -1.0)]
    draw_level(axes, levels, **REFERENCE, linestyle=(0, (5, 2)), label="limit")


def _find_limits(runs: Sequence[Run], command: str) -> list[float]:
    found = {run.parameters.get(_LIMITS[command]) for run in runs}
    return sorted(float(limit) for limit in found if isinstance(limit, int | float) and limit < 1e9)


def _draw_stages(axes: Axes, run: Run, command: str) -> None:
    lines = choose_lines(3)
    stages = (
        ("wanted", read_curve(run, f"wanted_{command}"), {**lines[1], "linewidth": 0.8}),
        ("commanded", read_curve(run, command), {**lines[0], "linewidth": 1.6}),
        ("applied", read_applied(run, command), {**lines[2], "linewidth": 0.8}),
    )
    for name, curve, looks in stages:
        if curve is not None:
            draw_curve(axes, curve, **looks, label=name)


def _keep_to_limits(axes: Axes, runs: Sequence[Run], command: str) -> None:
    """End the axis a little beyond the limits: what was wanted may lie far outside."""
    limits = _find_limits(runs, command)
    if not limits:
        return
    curves = [read_curve(run, command) for run in runs]
    low = min((float(curve.values.min()) for curve in curves if curve), default=0.0)
    axes.set_ylim(min(1.3 * low, -0.2 * limits[-1]), 1.3 * limits[-1])


def _drop_legend(axes: Axes) -> None:
    legend = axes.get_legend()
    if legend is not None:
        legend.remove()


def _list_labels(axes: Axes) -> list[str]:
    labels = [str(line.get_label()) for line in axes.get_lines()]
    return [label for label in labels if not label.startswith("_")]


def _finish(axes: Axes, label: str) -> None:
    axes.set(xlabel="time from the first sample [s]", ylabel=label)
    axes.margins(x=0.01)
    if len(_list_labels(axes)) > 1:
        axes.legend(ncols=1 if len(_list_labels(axes)) <= _MOST_IN_LEGEND else 2)
