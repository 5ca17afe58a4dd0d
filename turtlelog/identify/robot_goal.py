"""Start, goal and tolerances of an identified robot's scenario."""

import math
from typing import Any, Final

from turtlelog.run import Run

DIGITS: Final = 6
"""Significant digits of written numbers: a hundredth of the narrowest interval."""

_TOLERANCE: Final = 0.01
"""Tolerance of the goal [m] and [rad], usual for wheeled robots."""

_ABOVE_NOISE: Final = 5.0
"""Smallest tolerance in standard deviations of the poses' noise: a smaller one is never met."""

_DRIVE_S: Final = 5.0
"""Duration of a drive towards the goal, in which the heading drifts [s]."""

_ABOVE_DRIFT: Final = 2.0
"""Standard deviations of that drift within the tolerance: 1 drive of 20 drifts further."""

_PLACE: Final = ("x_m", "y_m")

_AHEAD_M: Final = 1.0
"""Distance of the goal ahead and to the left, if the bag has none [m]."""

Part = tuple[dict[str, Any], list[str]]
"""Keys of the scenario, and sentences on them."""


def find_start_and_goal(run: Run) -> Part:
    """Return the start of a robot, and its goal."""
    x_m, y_m = run.poses.xy_m[0].tolist()
    heading_rad = float(run.poses.heading_rad[0])
    values: dict[str, Any] = {
        "start.x_m": round(x_m, DIGITS),
        "start.y_m": round(y_m, DIGITS),
        "start.heading_rad": round(heading_rad, DIGITS),
    }
    if run.goal_xy_m is not None:
        goal_m = run.goal_xy_m
        note = "It starts at the first pose of the log, and has the log's goal."
    else:
        ahead, left = _AHEAD_M * math.cos(heading_rad), _AHEAD_M * math.sin(heading_rad)
        goal_m = x_m + ahead - left, y_m + left + ahead
        note = (
            "It starts at the first pose of the log. The log has no goal: one is set"
            f" {_AHEAD_M:g} m ahead and {_AHEAD_M:g} m to the left."
        )
    goals = zip(("goal.x_m", "goal.y_m"), goal_m, strict=True)
    values |= {key: round(value, DIGITS) for key, value in goals}
    return values, [note]


def choose_tolerances(values: dict[str, Any]) -> Part:
    """Return tolerances of the goal that a robot with this noise can meet."""
    noise_m, noise_rad = (
        values.get(f"sensing.noise_{name}", 0.0) for name in ("position_m", "heading_rad")
    )
    heading_rad = max(_TOLERANCE, _ABOVE_NOISE * noise_rad)
    way_m = math.hypot(*(values[f"goal.{axis}"] - values[f"start.{axis}"] for axis in _PLACE))
    drift_rad = _ABOVE_DRIFT * math.sqrt(_DRIVE_S) * values["disturbance.noise_turn_rate"]
    position_m = max(_TOLERANCE, _ABOVE_NOISE * noise_m, way_m * (heading_rad + drift_rad))
    keys = {
        "law.heading_tolerance_rad": float(f"{heading_rad:.2g}"),
        "law.position_tolerance_m": float(f"{position_m:.2g}"),
    }
    told = f"{1e3 * position_m:.2g} mm and {1e3 * heading_rad:.2g} mrad"
    return keys, [
        f"The tolerance of the goal is {told}: what a robot with such noise keeps that turns first"
        " and then drives."
    ]
