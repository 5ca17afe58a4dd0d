"""A law of your own: turn and drive at once. Run it with

turtlelog run --law examples/turn_and_drive.py:TurnAndDrive
"""

import math
from dataclasses import dataclass

from turtlelog.laws import Decision, Goal, Pose
from turtlelog.run.angles import subtract_headings
from turtlelog.run.loops import ControlLoop, Declaration
from turtlelog.run.paths import Path


@dataclass(frozen=True, kw_only=True)
class TurnAndDriveParameters:
    kp_angular: float = 4.0
    kp_linear: float = 1.0
    tolerance_m: float = 0.005


class TurnAndDrive:
    Parameters = TurnAndDriveParameters
    counts_samples = ()  # none of its parameters counts samples

    @classmethod
    def declare(
        cls, parameters: TurnAndDriveParameters, goal: Goal | None, path: Path | None
    ) -> Declaration:
        align = ControlLoop(
            name="align",
            signal="heading",
            command="turn_rate",
            reference="bearing_now",
            gain="law.kp_angular",
        )
        approach = ControlLoop(
            name="approach",
            signal="distance",
            command="speed",
            reference="zero",
            gain="law.kp_linear",
        )
        return Declaration(loops=(align, approach), phases={"drive": ("align", "approach")})

    def __init__(self, parameters: TurnAndDriveParameters) -> None:
        self.parameters = parameters
        self.goal = Goal(0.0, 0.0)

    def reset(self, start: Pose, goal: Goal | None, path: Path | None) -> None:
        if goal is not None:
            self.goal = goal

    def step(self, time_ns: int, pose: Pose) -> Decision:
        error_x_m, error_y_m = self.goal.x_m - pose.x_m, self.goal.y_m - pose.y_m
        distance_m = math.hypot(error_x_m, error_y_m)
        heading_error_rad = subtract_headings(math.atan2(error_y_m, error_x_m), pose.heading_rad)
        if distance_m < self.parameters.tolerance_m:
            return Decision(speed_m_s=0.0, turn_rate_rad_s=0.0, stop_reason="within_tolerance")
        forward = max(0.0, math.cos(heading_error_rad))
        return Decision(
            speed_m_s=self.parameters.kp_linear * distance_m * forward,
            turn_rate_rad_s=self.parameters.kp_angular * heading_error_rad,
        )
