"""Curves of runs as figures draw them: in seconds from the first sample, in degrees, thinned."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from turtlelog.measure import read_signal
from turtlelog.run import Phase, Run
from turtlelog.show.commanded import Command, read_commanded
from turtlelog.show.thinning import MOST_POINTS, choose_rows
from turtlelog.theory import compute_step_response

Values = NDArray[np.float64]

_TURNED: Final = frozenset({"heading", "heading_error"})
_ERRORS: Final = frozenset(
    {"heading_error", "error_x", "error_y", "distance", "world_velocity_x", "world_velocity_y"}
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curve:
    """One line of a figure.

    Attributes:
        time_s: From the first sample of its run [s], shape (n,).
        values: In the unit of its axis, shape (n,).
        holds: Whether a value lasts until the next.
    """

    time_s: Values
    values: Values
    holds: bool = False


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


def compute_ideal(run: Run, signal_name: str) -> Curve | None:
    """Return how the ideal loop of the same gain would bring a signal to where it belongs.

    It starts where and when the phase that drives the signal starts. None for signals that no loop
    drives, and where the phase, the gain or the goal is not known.
    """
    measured, target = read_curve(run, signal_name), find_target(run, signal_name)
    if measured is None or target is None:
        return None
    is_turn = signal_name in _TURNED
    gain = run.parameters.get("law.kp_angular" if is_turn else "law.kp_linear")
    phase = Phase.ROTATE if is_turn else Phase.TRANSLATE
    starts_ns = [span.start_ns for span in run.find_phase_spans() if span.phase is phase]
    if not starts_ns or not isinstance(gain, int | float) or not 0.0 < gain < np.inf:
        return None
    start_s = (starts_ns[0] - run.start_ns) / 1e9
    after = measured.time_s >= start_s
    if not after.any():
        return None
    time_s, initial = measured.time_s[after], float(measured.values[after][0])
    values = compute_step_response(gain, time_s - start_s, initial=initial, reference=target)
    return Curve(time_s=time_s, values=values)


def find_target(run: Run, signal_name: str) -> float | None:
    """Return the value that a loop brings a signal to, in the unit of its curve."""
    if signal_name == "heading":
        bearings = run.samples.bearing_rad[:1]
        return float(np.degrees(bearings[0])) if len(bearings) else None
    if signal_name in _ERRORS:
        return 0.0
    if run.goal_xy_m is None or signal_name not in {"x", "y", "along_track"}:
        return None
    if signal_name == "along_track":
        distances_m = run.samples.distance_m[:1]
        return float(distances_m[0]) if len(distances_m) else None
    return run.goal_xy_m["xy".index(signal_name)]


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
    if not len(run.samples):
        return None
    time_s = (run.samples.time_ns - run.start_ns) / 1e9
    return Curve(time_s=time_s, values=run.samples.world_velocity_m_s[:, axis], holds=True)
