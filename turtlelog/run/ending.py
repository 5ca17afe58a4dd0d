"""How a run ended at its goal."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

from turtlelog.display import format_short

if TYPE_CHECKING:
    from turtlelog.run.run import Run

_REACHED: Final = "within_tolerance"
_MISSED: Final = ("standstill", "settled", "timeout", "max_duration")
"""Stop reasons of built-in laws in runs that do not reach the goal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GoalEnd:
    """End of a run at its goal.

    Attributes:
        verdict: `reached`, `missed`, or `ended` if the run has no tolerances to judge the error by.
        error_m: Metric `final.position_error` [m].
        allowed_m: Final position error that the tolerances of the law allow [m]; 0 without them.
        duration_s: Metric `run.duration` [s].
    """

    verdict: Literal["reached", "missed", "ended"]
    error_m: float
    allowed_m: float
    duration_s: float

    def describe(self) -> str:
        """Return a sentence without a subject: verdict, distance to the goal and duration."""
        size = format_short(self.error_m, "m")
        after = f"after {self.duration_s:.3g} s"
        if self.verdict == "reached":
            return f"reached the goal within {size} {after}"
        if self.verdict == "ended":
            return f"ended {size} from the goal {after}"
        return f"missed the goal by {size} (allowed: {format_short(self.allowed_m, 'm')}) {after}"


def find_goal_end(run: "Run") -> GoalEnd | None:
    """Return how a run ended at its goal; None without poses or a goal to reach."""
    if run.goal_xy_m is None or not run.declaration.uses_goal or not len(run.poses):
        return None
    error_m, allowed_m = math.dist(run.goal_xy_m, run.poses.xy_m[-1]), _allow(run)
    # A law that reads other poses than the robot's stops where it believes the goal to be.
    is_seen = run.poses.sensed_xy_m is None
    verdict: Literal["reached", "missed", "ended"] = "ended"
    if (run.stop_reason == _REACHED and is_seen) or error_m <= allowed_m:
        verdict = "reached"
    elif run.stop_reason in _MISSED and allowed_m:
        verdict = "missed"
    return GoalEnd(verdict=verdict, error_m=error_m, allowed_m=allowed_m, duration_s=run.duration_s)


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
