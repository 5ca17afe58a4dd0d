"""Common parts of laws that track a path: loops and reference pose.

If the path has a speed, the reference starts at the first sample and moves along the path at this
speed. The run ends when the reference reaches the end. Without a speed, the reference is the point
of the path nearest to the robot. The run ends when the robot is within a tolerance of the end.
"""

import math
from dataclasses import dataclass
from typing import Any, Final

from turtlelog.arithmetic import called, least, wrap_angle
from turtlelog.errors import LawError
from turtlelog.laws.base import Goal
from turtlelog.run import stop_reasons
from turtlelog.run.loops import ControlLoop, Declaration
from turtlelog.run.path_pieces import Point, find_on_first_lap, follow_piece, locate
from turtlelog.run.paths import Path

STOPS: Final = (stop_reasons.PATH_END,)
PATH_END: Final = 1

Target = tuple[Point, float, float, float]
"""The point where the robot should be, and its speed along the path [m/s]. Lag of the robot behind
this point [m]; 0 if the path has no times. Arc length of the path point nearest to the robot
[m]."""


@dataclass(slots=True)
class TrackingState:
    """State of a law that tracks a path.

    Attributes:
        first_ns: Time of the first sample [ns]; -1 before this sample.
        arc_m: Arc length of the path point nearest to the robot [m]; NaN until the robot reaches
            the path.
        begin_m: Arc length at which the robot reached the path [m]; NaN before that.
    """

    first_ns: int = -1
    arc_m: float = math.nan
    begin_m: float = math.nan


def declare(
    name: str, along_gain: str, parameters: Any, goal: Goal | None, path: Path | None
) -> Declaration:
    """Return the loops along and across the path, which act together; LawError without a path."""
    del parameters, goal
    if path is None:
        raise LawError(
            f"{name}: expected a path to track, found no table [path];"
            " the preset track-square has one"
        )
    along = ControlLoop(
        name="along",
        signal="along_track",
        command="speed",
        reference="path",
        # Without a time there is no error along the path.
        gain=None if path.speed_m_s is None else f"law.{along_gain}",
        is_proportional=False,
    )
    cross = ControlLoop(
        name="cross",
        signal="cross_track",
        command="turn_rate",
        reference="path",
        is_proportional=False,
    )
    phases = {"track": ("along", "cross")}
    return Declaration(loops=(along, cross), phases=phases, uses_goal=False)


@called
def find_target(
    settings: Any, state: Any, pieces: Any, row: Any, time_ns: int, pose: tuple[float, float, float]
) -> Target:
    """Return the reference for one pose, and write the reference into the row."""
    path, law = settings.path, settings.law
    if state.first_ns < 0:
        state.first_ns = time_ns
    position = pose[0], pose[1]
    if path.has_speed:
        due_m = least(path.speed_m_s * ((time_ns - state.first_ns) / 1e9), path.length_m)
        nearest_m, _, state.arc_m = follow_piece(path, pieces, state.arc_m, position, due_m)
        speed_m_s, behind_m, at_m = path.speed_m_s, due_m - nearest_m, due_m
        is_over = due_m >= path.length_m
    else:
        nearest_m, _, state.arc_m = follow_piece(path, pieces, state.arc_m, position, math.nan)
        if math.isnan(state.begin_m) and not math.isnan(state.arc_m):
            state.begin_m = nearest_m if path.is_closed else 0.0
        begin_m = 0.0 if math.isnan(state.begin_m) else state.begin_m
        end_m = begin_m + path.length_m - law.end_tolerance_m
        is_over = not math.isnan(state.begin_m) and nearest_m >= end_m  # after a whole lap
        # On a closed path the next lap begins with the direction of its first leg.
        at_m = nearest_m if is_over else find_on_first_lap(path, nearest_m)
        speed_m_s, behind_m = law.speed_m_s, 0.0
    point = locate(path, pieces, at_m)
    if is_over:
        row.stop = PATH_END
    row.heading_error_rad = wrap_angle(point[2] - pose[2])
    row.reference_x_m, row.reference_y_m, row.reference_heading_rad = point[0], point[1], point[2]
    return point, speed_m_s, behind_m, nearest_m
