"""Panels over time of commands: wanted, commanded, applied and measured, their limits, outliers."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import SymmetricalLogLocator

from turtlelog.charts.robot_curves import read_measured
from turtlelog.charts.shared_curves import (
    Command,
    find_disturbance,
    find_limits,
    read_applied,
    read_command,
    read_curve,
)
from turtlelog.draw.figures.figure_curves import (
    draw_curve,
    draw_level,
)
from turtlelog.draw.figures.page import (
    PUSHED,
    REFERENCE,
    choose_lines,
    label_runs,
    style_runs,
)
from turtlelog.draw.figures.panels import finish
from turtlelog.loops import COMMAND_UNITS
from turtlelog.run import Run

_LIMIT = {**REFERENCE, "linestyle": (0, (5, 2)), "label": "limit"}

_WORDS_POINTS: Final = 6.5

_MEASURED: Final[Mapping[str, Any]] = MappingProxyType(
    {"linestyle": "-", "linewidth": 0.8, "zorder": 1.9}
)

_COMMANDED: Final[Mapping[str, Any]] = MappingProxyType(
    {"linestyle": (0, (1, 1.5)), "linewidth": 0.8, "zorder": 1.8, "label": "commanded"}
)
"""Commands beside measured rates of the same run, in its colour."""

_OUTLIER: Final[Mapping[str, Any]] = MappingProxyType(
    {"linestyle": "", "marker": "v", "markersize": 4.0, "clip_on": False, "label": "outlier"}
)

_OUTLIER_ROOM: Final = 0.15
"""Of an axis' length, for a line of words on outliers below the curves."""


def draw_command(axes: Axes, runs: Sequence[Run], *, command: Command, label: str) -> None:
    """Draw a command: of one run wanted, commanded and applied, of several what was commanded.

    Beside it is what the robot measured, without outliers, which are named at the lower edge.
    """
    _draw_limits(axes, runs, command)
    if len(runs) == 1:
        if (pushed_s := find_disturbance(runs[0])) is not None:
            axes.axvspan(*pushed_s, **PUSHED)
        _draw_stages(axes, runs[0], command)
    else:
        _draw_commands(axes, runs, command)
    finish(axes, runs, f"{label} [{COMMAND_UNITS[command]}]")
    _keep_to_limits(axes, runs, command)
    _name_outliers(axes, runs, command)


def draw_wanted(axes: Axes, runs: Sequence[Run], *, command: Command, label: str) -> None:
    """Draw commands before clipping, on a symmetric logarithmic scale that is linear to 1."""
    axes.set_yscale("symlog", linthresh=1.0)
    ticks = SymmetricalLogLocator(base=10.0, linthresh=1.0, subs=(1.0, 2.0, 5.0))
    axes.yaxis.set_major_locator(ticks)
    axes.yaxis.set_major_formatter("{x:g}")
    _draw_limits(axes, runs, command)
    for run, looks in style_runs(runs):
        if (curve := read_curve(run, f"wanted_{command}")) is not None:
            draw_curve(axes, curve, **looks)
    finish(axes, runs, f"{label} [{COMMAND_UNITS[command]}]")


def _draw_limits(axes: Axes, runs: Sequence[Run], command: Command) -> None:
    draw_level(axes, [0.0], color="0.8", linewidth=0.5)
    levels = [sign * limit for limit in find_limits(runs, command) for sign in (1.0, -1.0)]
    draw_level(axes, levels, **_LIMIT)


def _draw_stages(axes: Axes, run: Run, command: Command) -> None:
    lines = choose_lines(4)
    # The plant tells its speed without a sign.
    applied = "|applied|" if command == "speed" else "applied"
    measured = read_measured(run, command)
    stages = (
        ("wanted", read_curve(run, f"wanted_{command}"), {**lines[1], "linewidth": 0.9}),
        ("shaped", read_curve(run, f"shaped_{command}"), {**lines[3], "linewidth": 0.9}),
        ("commanded", read_command(run, command), {**lines[0], "linewidth": 1.7}),
        (applied, read_applied(run, command), {**lines[2], "linewidth": 0.8}),
        ("measured", None if measured is None else measured.curve, {**lines[2], **_MEASURED}),
    )
    for name, curve, looks in stages:
        if curve is not None:
            draw_curve(axes, curve, **looks, label=name)


def _draw_commands(axes: Axes, runs: Sequence[Run], command: Command) -> None:
    """Draw what was commanded of several runs, finer where the answer was measured as well."""
    for run, looks in style_runs(runs):
        curve, measured = read_command(run, command), read_measured(run, command)
        if measured is not None:
            draw_curve(axes, measured.curve, **looks)
            looks = {**looks, **_COMMANDED}
        if curve is not None:
            draw_curve(axes, curve, **looks)


def _name_outliers(axes: Axes, runs: Sequence[Run], command: Command) -> None:
    """Name the outliers that the axis leaves out, with a mark at each one's time."""
    lines = []
    for (run, looks), name in zip(style_runs(runs), label_runs(runs), strict=True):
        measured = read_measured(run, command)
        if measured is None or not (words := measured.name_outliers()):
            continue
        color = choose_lines(4)[2]["color"] if len(runs) == 1 else looks["color"]
        at_s, edge = measured.outliers.time_s, axes.get_xaxis_transform()
        axes.plot(at_s, np.zeros(len(at_s)), transform=edge, color=color, **_OUTLIER)
        lines.append(words if len(runs) == 1 else f"{name}: {words}")
    if lines:
        low, high = axes.get_ylim()
        axes.set_ylim(low - _OUTLIER_ROOM * len(lines) * (high - low), high)
        text = axes.text(0.99, 0.03, "\n".join(lines), fontsize=_WORDS_POINTS, color="0.3")
        text.set(transform=axes.transAxes, ha="right", va="bottom")


def _keep_to_limits(axes: Axes, runs: Sequence[Run], command: Command) -> None:
    """End the axis a little beyond the limits: what was wanted may lie far outside."""
    limits = find_limits(runs, command)
    if not limits:
        return
    curves = [read_command(run, command) for run in runs]
    if len(runs) == 1 and find_disturbance(runs[0]) is not None:
        curves.append(read_applied(runs[0], command))
    low = min((float(curve.values.min()) for curve in curves if curve), default=0.0)
    high = max((float(curve.values.max()) for curve in curves if curve), default=0.0)
    axes.set_ylim(min(1.3 * low, -0.2 * limits[-1]), 1.3 * max(high, limits[-1]))
