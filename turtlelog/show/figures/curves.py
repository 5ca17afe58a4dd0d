"""Curves of runs as figures draw them: in seconds from the first sample, in degrees, thinned."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from turtlelog.measure import read_signal
from turtlelog.run import Run
from turtlelog.show.shared_curves import (
    REFERENCE,
    Command,
    Level,
    list_aims,
    list_levels,
    read_commanded,
    read_world_velocity,
)
from turtlelog.show.thinning import MOST_POINTS, choose_rows

Values = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curve:
    """One line of a figure.

    Attributes:
        time_s: From the first sample of its run [s], shape (n,).
        values: In the unit of its axis, shape (n,).
        holds: Whether a value lasts until the next.
        label: For the legend, where it is not the run's own.
    """

    time_s: Values
    values: Values
    holds: bool = False
    label: str = ""


def read_curve(run: Run, signal_name: str) -> Curve | None:
    """Return a signal with headings in degrees, None where the run does not hold it.

    Beside the named signals there are `world_velocity_x` and `world_velocity_y`: gain times error.
    """
    if signal_name.startswith("world_velocity_"):
        return _read_world_velocity(run, "xy".index(signal_name[-1]))
    signal = read_signal(run, signal_name)
    if signal is None or not len(signal.values):
        return None
    is_angle = signal.kind.unit == "rad"
    return Curve(
        time_s=(signal.time_ns - run.start_ns) / 1e9,
        values=np.degrees(signal.values) if is_angle else signal.values,
        holds=signal.kind.resampling == "hold",
    )


def read_command(run: Run, command: Command) -> Curve | None:
    """Return what was commanded, None where the run holds no commands."""
    found = read_commanded(run, command)
    if found is None:
        return None
    time_ns, values = found
    return Curve(time_s=(time_ns - run.start_ns) / 1e9, values=values, holds=True)


def read_applied(run: Run, command: Command) -> Curve | None:
    """Return what the plant applied of `speed` or `turn_rate`, None where not recorded.

    turtlesim publishes the magnitude of the applied speed, whichever way it drives.
    """
    poses = run.poses
    values = poses.speed_m_s if command == "speed" else poses.turn_rate_rad_s
    if values is None:
        return None
    return Curve(time_s=(poses.time_ns - run.start_ns) / 1e9, values=values, holds=True)


def read_aims(run: Run, signal_name: str) -> list[Curve]:
    """Return what the law, or the goal, asks of a signal where that moves."""
    is_angle = signal_name == "heading"
    return [
        Curve(
            time_s=(aim.time_ns - run.start_ns) / 1e9,
            values=np.degrees(aim.values) if is_angle else aim.values,
            holds=aim.label == REFERENCE,
            label=aim.label,
        )
        for aim in list_aims(run, signal_name)
    ]


def list_targets(run: Run, signal_name: str) -> list[Level]:
    """Return what a signal should be, where that stands still, in the unit of its curve."""
    if signal_name in ("x", "y"):
        goal = run.goal_xy_m
        return [] if goal is None else [Level(label="goal", value=goal["xy".index(signal_name)])]
    levels = list_levels(run, signal_name)
    if signal_name != "heading":
        return levels
    return [replace(level, value=float(np.degrees(level.value))) for level in levels]


def draw_curve(axes: Axes, curve: Curve, **looks: Any) -> None:
    """Draw a curve, as stairs where it holds; a long one is thinned."""
    drawstyle = "steps-post" if curve.holds else "default"
    draw_thinned(axes, curve.time_s, curve.values, curve.values, drawstyle=drawstyle, **looks)


def draw_thinned(axes: Axes, across: Values, up: Values, kept: Values, **looks: Any) -> None:
    """Draw a line; where points are left out the extremes of `kept` stay, and a note says so."""
    rows = choose_rows(kept)
    if rows is not None:
        across, up = across[rows], up[rows]
        note = f"curves of over {MOST_POINTS:,} points are\nthinned for drawing, extremes kept"
        axes.figure.supxlabel(note, fontsize=7.0, color="0.4")
    # A line of one point would be none.
    axes.plot(across, up, marker="o" if len(up) == 1 else None, markersize=3.0, **looks)


def draw_level(axes: Axes, levels: Sequence[float], **looks: Any) -> None:
    """Draw level lines under one name."""
    for index, level in enumerate(levels):
        shown = dict(looks)
        if index:
            shown.pop("label", None)
        axes.axhline(level, zorder=1.5, **shown)


def _read_world_velocity(run: Run, axis: int) -> Curve | None:
    found = read_world_velocity(run)
    if found is None:
        return None
    time_ns, velocity = found
    return Curve(time_s=(time_ns - run.start_ns) / 1e9, values=velocity[:, axis], holds=True)
