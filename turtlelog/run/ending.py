"""How a run ended at its goal."""

import math
from typing import TYPE_CHECKING, Final

from turtlelog.display import format_short

if TYPE_CHECKING:
    from turtlelog.run.run import Run

_REACHED: Final = "within_tolerance"
_MISSED: Final = ("standstill", "settled", "timeout", "max_duration")
"""Stop reasons of built-in laws in runs that do not reach the goal."""


def find_goal_error(run: "Run") -> float | None:
    """Return the metric `final.position_error` [m]; None if the run had no goal."""
    if run.goal_xy_m is None or not run.declaration.uses_goal:
        return None
    return math.dist(run.goal_xy_m, run.poses.xy_m[-1])


def describe_goal_end(run: "Run", error_m: float, duration_s: float | None) -> str:
    """Return a sentence on whether a run reached its goal, its final distance and its duration.

    Args:
        run: The run.
        error_m: The metric `final.position_error` [m].
        duration_s: The metric `run.duration` [s].
    """
    size = format_short(error_m, "m")
    after = "" if duration_s is None else f" after {duration_s:.3g} s"
    # A law that reads other poses than the robot's stops where it believes the goal to be.
    is_seen = run.poses.sensed_xy_m is None
    if (run.stop_reason == _REACHED and is_seen) or error_m <= _allow(run):
        return f"reached the goal within {size}{after}"
    if run.stop_reason in _MISSED:
        return f"missed the goal by {size}{after}"
    return f"ended {size} from the goal{after}"


def allow_position(heading_rad: float, position_m: float, distance_m: float) -> float:
    """Return the final position error that the tolerances allow [m].

    Args:
        heading_rad: Tolerance of the heading [rad].
        position_m: Tolerance of the position [m].
        distance_m: Distance from the start to the goal [m].
    """
    return heading_rad * distance_m + position_m


def _allow(run: "Run") -> float:
    """Return the distance to the goal that the law's tolerances allow [m]; 0 without tolerances."""
    heading_rad = run.parameters.get("law.heading_tolerance_rad")
    position_m = run.parameters.get("law.position_tolerance_m")
    if not isinstance(heading_rad, float | int) or not isinstance(position_m, float | int):
        return 0.0
    if run.goal_xy_m is None:
        return 0.0
    return allow_position(heading_rad, position_m, math.dist(run.goal_xy_m, run.poses.xy_m[0]))
