"""A law of your own: turn and drive at once. Run it with

turtlelog run textbook --set law.kind=examples/turn_and_drive.py:TurnAndDrive
"""

import math
from dataclasses import dataclass

from turtlelog.angles import subtract_headings
from turtlelog.laws import Decision, Goal, Pose
from turtlelog.run import Phase


@dataclass(frozen=True, kw_only=True)
class TurnAndDriveParameters:
    kp_angular: float = 4.0
    kp_linear: float = 1.0
    tolerance_m: float = 0.005


class TurnAndDrive:
    Parameters = TurnAndDriveParameters

    def __init__(self, parameters: TurnAndDriveParameters) -> None:
        self.parameters = parameters
        self.goal = Goal(0.0, 0.0)

    def reset(self, start: Pose, goal: Goal) -> None:
        self.goal = goal

    def step(self, time_ns: int, pose: Pose) -> Decision:
        error_x_m, error_y_m = self.goal.x_m - pose.x_m, self.goal.y_m - pose.y_m
        distance_m = math.hypot(error_x_m, error_y_m)
        bearing_rad = math.atan2(error_y_m, error_x_m)
        heading_error_rad = subtract_headings(bearing_rad, pose.heading_rad)
        done = distance_m < self.parameters.tolerance_m
        return Decision(
            speed_m_s=0.0
            if done
            else self.parameters.kp_linear * distance_m * max(0.0, math.cos(heading_error_rad)),
            turn_rate_rad_s=0.0 if done else self.parameters.kp_angular * heading_error_rad,
            phase=Phase.TRANSLATE,
            bearing_rad=bearing_rad,
            heading_error_rad=heading_error_rad,
            error_x_m=error_x_m,
            error_y_m=error_y_m,
            stop_reason="within_tolerance" if done else None,
        )
