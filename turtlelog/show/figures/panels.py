"""Figures over time: what the robot did, what it missed, and what it was told."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import SymmetricalLogLocator

from turtlelog.loops import COMMAND_UNITS
from turtlelog.run import Run
from turtlelog.show.figures.curves import (
    draw_curve,
    draw_level,
    list_targets,
    read_aims,
    read_applied,
    read_command,
    read_curve,
)
from turtlelog.show.figures.ideal_loop import compute_ideals
from turtlelog.show.figures.page import AIM, IDEAL, REFERENCE, choose_lines, label_runs
from turtlelog.show.shared_curves import Command

_TOLERANCES = {"heading_error": "law.heading_tolerance_rad", "distance": "law.position_tolerance_m"}
_AIMED = frozenset({"heading", "x", "y", "along_track"})
"""Signals that come to something else than zero."""

_LIMIT = {**REFERENCE, "linestyle": (0, (5, 2)), "label": "limit"}
_TOLERANCE = {**REFERENCE, "linestyle": (0, (5, 2)), "label": "tolerance"}


Draw = Callable[[Axes, Sequence[Run]], None]
"""Draws one panel of some runs."""


def draw_signal(axes: Axes, runs: Sequence[Run], *, signal: str, label: str) -> None:
    """Draw one signal of every run, with what it aims at and the ideal response where known."""
    _draw_targets(axes, runs, signal)
    for run, looks in _style_runs(runs):
        for ideal in compute_ideals(run, signal):
            draw_curve(axes, ideal, **{**looks, **IDEAL})
        for aim in read_aims(run, signal):
            draw_curve(axes, aim, **{**looks, **AIM, "label": aim.label})
        if (curve := read_curve(run, signal)) is not None:
            draw_curve(axes, curve, **looks)
    _finish(axes, runs, label)


def draw_error_magnitude(axes: Axes, runs: Sequence[Run], *, signal: str, label: str) -> None:
    """Draw the magnitude of an error on a logarithmic scale: what is exponential is straight.

    The axis spans what was measured; an error of zero is a gap.
    """
    axes.set_yscale("log")
    _draw_tolerances(axes, runs, signal)
    extremes: list[float] = []
    for run, looks in _style_runs(runs):
        if (curve := read_curve(run, signal)) is None:
            continue
        sizes = np.where(curve.values == 0.0, np.nan, np.abs(curve.values))
        known = sizes[np.isfinite(sizes)]
        extremes += [known.min(), known.max()] if len(known) else []
        for ideal in compute_ideals(run, signal):
            decay = replace(ideal, values=np.abs(ideal.values))
            draw_curve(axes, decay, **{**looks, **IDEAL})
        draw_curve(axes, replace(curve, values=sizes), **looks)
    if extremes:
        axes.set_ylim(0.6 * min(extremes), 1.8 * max(extremes))
    _finish(axes, runs, label)


def draw_command(axes: Axes, runs: Sequence[Run], *, command: Command, label: str) -> None:
    """Draw a command: of one run wanted, commanded and applied, of several what was commanded."""
    _draw_limits(axes, runs, command)
    if len(runs) == 1:
        _draw_stages(axes, runs[0], command)
    else:
        for run, looks in _style_runs(runs):
            if (curve := read_command(run, command)) is not None:
                draw_curve(axes, curve, **looks)
    _finish(axes, runs, f"{label} [{COMMAND_UNITS[command]}]")
    _keep_to_limits(axes, runs, command)


def draw_wanted(axes: Axes, runs: Sequence[Run], *, command: Command, label: str) -> None:
    """Draw commands before clipping, on a symmetric logarithmic scale that is linear to 1."""
    axes.set_yscale("symlog", linthresh=1.0)
    ticks = SymmetricalLogLocator(base=10.0, linthresh=1.0, subs=(1.0, 2.0, 5.0))
    axes.yaxis.set_major_locator(ticks)
    axes.yaxis.set_major_formatter("{x:g}")
    _draw_limits(axes, runs, command)
    for run, looks in _style_runs(runs):
        if (curve := read_curve(run, f"wanted_{command}")) is not None:
            draw_curve(axes, curve, **looks)
    _finish(axes, runs, f"{label} [{COMMAND_UNITS[command]}]")


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


def _style_runs(runs: Sequence[Run]) -> list[tuple[Run, dict[str, Any]]]:
    styled = zip(runs, label_runs(runs), choose_lines(len(runs)), strict=True)
    return [(run, {**looks, "label": name}) for run, name, looks in styled]


def _draw_tolerances(axes: Axes, runs: Sequence[Run], signal: str) -> None:
    found = _find_parameters(runs, _TOLERANCES[signal])
    levels = np.degrees(found) if signal == "heading_error" else found
    draw_level(axes, list(levels), **_TOLERANCE)


def _draw_targets(axes: Axes, runs: Sequence[Run], signal: str) -> None:
    """Draw the levels that a signal should come to, under their names; of errors it is zero."""
    if signal not in _AIMED:
        draw_level(axes, [0.0], **REFERENCE, label=None)
        return
    named: dict[str, set[float]] = {}
    for level in (level for run in runs for level in list_targets(run, signal)):
        named.setdefault(level.label, set()).add(level.value)
    for name, levels in named.items():
        draw_level(axes, sorted(levels), **REFERENCE, label=name)


def _draw_limits(axes: Axes, runs: Sequence[Run], command: Command) -> None:
    draw_level(axes, [0.0], color="0.8", linewidth=0.5)
    levels = [sign * limit for limit in _find_limits(runs, command) for sign in (1.0, -1.0)]
    draw_level(axes, levels, **_LIMIT)


def _find_limits(runs: Sequence[Run], command: Command) -> list[float]:
    keys = dict.fromkeys(key for run in runs for key in run.declaration.list_limits(command))
    return sorted({limit for key in keys for limit in _find_parameters(runs, key)})


def _find_parameters(runs: Sequence[Run], key: str) -> list[float]:
    """Return the values that the runs have of a parameter; what is boundless is none."""
    found = {run.parameters.get(key) for run in runs}
    return sorted(float(value) for value in found if isinstance(value, int | float) and value < 1e9)


def _draw_stages(axes: Axes, run: Run, command: Command) -> None:
    lines = choose_lines(3)
    # The plant tells its speed without a sign.
    applied = "|applied|" if command == "speed" else "applied"
    stages = (
        ("wanted", read_curve(run, f"wanted_{command}"), {**lines[1], "linewidth": 0.9}),
        ("commanded", read_command(run, command), {**lines[0], "linewidth": 1.7}),
        (applied, read_applied(run, command), {**lines[2], "linewidth": 0.8}),
    )
    for name, curve, looks in stages:
        if curve is not None:
            draw_curve(axes, curve, **looks, label=name)


def _keep_to_limits(axes: Axes, runs: Sequence[Run], command: Command) -> None:
    """End the axis a little beyond the limits: what was wanted may lie far outside."""
    limits = _find_limits(runs, command)
    if not limits:
        return
    curves = [read_command(run, command) for run in runs]
    low = min((float(curve.values.min()) for curve in curves if curve), default=0.0)
    high = max((float(curve.values.max()) for curve in curves if curve), default=0.0)
    axes.set_ylim(min(1.3 * low, -0.2 * limits[-1]), 1.3 * max(high, limits[-1]))


def _finish(axes: Axes, runs: Sequence[Run], label: str) -> None:
    firsts = dict.fromkeys("sample" if len(run.samples) else "pose" for run in runs)
    axes.set(xlabel=f"time from the first {' or '.join(firsts)} [s]", ylabel=label)
    axes.margins(x=0.01)
    axes.locator_params(axis="x", nbins=6)
