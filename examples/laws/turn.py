"""A law in three lines: a function of clock, pose and goal that returns speed and turn rate.

turtlelog run --law examples/laws/turn.py:turn_and_drive
"""

import math

from turtlelog.laws import Goal, Pose
from turtlelog.run.angles import wrap_angle


def turn_and_drive(time_ns: int, pose: Pose, goal: Goal) -> tuple[float, float]:  # noqa: ARG001
    ahead_m, left_m = goal.x_m - pose.x_m, goal.y_m - pose.y_m
    error_rad = wrap_angle(math.atan2(left_m, ahead_m) - pose.heading_rad)
    return min(math.hypot(ahead_m, left_m), 1.0) * max(0.0, math.cos(error_rad)), 2.0 * error_rad
