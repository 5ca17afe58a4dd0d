"""Follows a point that moves on a circle around the goal, and records where it should be.

turtlelog run --law examples/laws/tracking.py:Tracking --goal 5.5,5.5 --set law.speed_m_s=0.6
"""

import math
from dataclasses import dataclass

from turtlelog.laws import Decision, Goal, Pose
from turtlelog.run.angles import wrap_angle
from turtlelog.run.loops import ControlLoop, Declaration
from turtlelog.run.paths import Path


@dataclass(frozen=True, kw_only=True)
class Settings:
    radius_m: float = 1.0  # of the circle around the goal
    speed_m_s: float = 0.5  # of the point on it, counter-clockwise from the side of +x
    rounds: float = 2.0  # after so many the run ends
    kp_along: float = 1.0  # of the distance ahead [1/s]
    kp_cross: float = 2.0  # of the distance to the left [rad/(m s)]
    kp_heading: float = 2.0  # of the heading [1/s]


class Tracking:
    Parameters = Settings
    counts_samples = ()  # none of its parameters counts samples

    @classmethod
    def declare(cls, parameters: Settings, goal: Goal | None, path: Path | None) -> Declaration:
        heading = ControlLoop(
            name="heading",
            signal="heading",
            command="turn_rate",
            reference="recorded",
            gain="law.kp_heading",
        )
        lag = ControlLoop(
            name="lag",
            signal="distance",
            command="speed",
            reference="recorded",
            gain="law.kp_along",
        )
        return Declaration(loops=(heading, lag), phases={"track": ("heading", "lag")})

    def __init__(self, parameters: Settings) -> None:
        self.settings = parameters

    def reset(self, start: Pose, goal: Goal | None, path: Path | None) -> None:
        self.centre = goal or Goal(start.x_m, start.y_m)
        self.start_ns: int | None = None

    def find_reference(self, time_s: float) -> tuple[Pose, float]:
        """Return where the point is at a time, heading along the circle, and its angle on it."""
        settings, centre = self.settings, self.centre
        angle_rad = settings.speed_m_s / settings.radius_m * time_s
        x_m = centre.x_m + settings.radius_m * math.cos(angle_rad)
        y_m = centre.y_m + settings.radius_m * math.sin(angle_rad)
        return Pose(x_m, y_m, wrap_angle(angle_rad + math.pi / 2)), angle_rad

    def step(self, time_ns: int, pose: Pose) -> Decision:
        settings = self.settings
        if self.start_ns is None:
            self.start_ns = time_ns
        reference, angle_rad = self.find_reference((time_ns - self.start_ns) / 1e9)
        x_m, y_m = reference.x_m - pose.x_m, reference.y_m - pose.y_m
        cos, sin = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
        ahead_m, left_m = x_m * cos + y_m * sin, y_m * cos - x_m * sin
        error_rad = wrap_angle(reference.heading_rad - pose.heading_rad)
        turn_rate = settings.speed_m_s / settings.radius_m  # that of the point itself
        turn_rate += settings.kp_cross * left_m + settings.kp_heading * error_rad
        return Decision(
            speed_m_s=settings.speed_m_s * math.cos(error_rad) + settings.kp_along * ahead_m,
            turn_rate_rad_s=turn_rate,
            heading_error_rad=error_rad,
            reference=reference,
            stop_reason="rounds_done" if angle_rad >= settings.rounds * 2.0 * math.pi else None,
        )
