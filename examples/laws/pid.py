"""PID control of the heading, P control of the distance; its integral and filter are recorded.

turtlelog run --law examples/laws/pid.py:Pid --set law.ki=0.5 --set law.kd=0.1
"""

import math
from dataclasses import dataclass

from turtlelog.laws import Decision, Goal, Pose
from turtlelog.run.angles import wrap_angle
from turtlelog.run.loops import ControlLoop, Declaration
from turtlelog.run.paths import Path


@dataclass(frozen=True, kw_only=True)
class Settings:
    kp: float = 2.0  # of the heading [1/s]
    ki: float = 0.5  # of its integral [1/s^2]
    kd: float = 0.05  # of its derivative [1]
    filter_s: float = 0.05  # time constant of the derivative's filter [s]
    most_integral: float = 0.5  # the integral stays within +- this [rad s]: its anti-windup
    kp_linear: float = 1.0  # of the distance [1/s]
    tolerance_m: float = 0.01  # where the run ends


class Pid:
    Parameters = Settings
    counts_samples = ()  # none of its parameters counts samples

    @classmethod
    def declare(cls, parameters: Settings, goal: Goal | None, path: Path | None) -> Declaration:
        align = ControlLoop(
            name="align",
            signal="heading",
            command="turn_rate",
            reference="bearing_now",
            gain="law.kp",
            is_proportional=False,
            integral_gain="law.ki",
            derivative_gain="law.kd",
            derivative_filter="law.filter_s",
        )
        approach = ControlLoop(
            name="approach",
            signal="distance",
            command="speed",
            reference="zero",
            gain="law.kp_linear",
        )
        return Declaration(
            loops=(align, approach),
            phases={"drive": ("align", "approach")},
            states=("integral", "derivative"),
            state_units={"integral": "rad s", "derivative": "rad/s"},
        )

    def __init__(self, parameters: Settings) -> None:
        self.settings = parameters

    def reset(self, start: Pose, goal: Goal | None, path: Path | None) -> None:
        self.goal = goal or Goal(start.x_m, start.y_m)
        self.integral = self.derivative = 0.0
        self.last: tuple[int, float] | None = None

    def step(self, time_ns: int, pose: Pose) -> Decision:
        settings = self.settings
        ahead_m, left_m = self.goal.x_m - pose.x_m, self.goal.y_m - pose.y_m
        distance_m = math.hypot(ahead_m, left_m)
        error_rad = wrap_angle(math.atan2(left_m, ahead_m) - pose.heading_rad)
        self.remember(time_ns, error_rad)
        turn_rate = settings.kp * error_rad
        turn_rate += settings.ki * self.integral + settings.kd * self.derivative
        return Decision(
            speed_m_s=settings.kp_linear * distance_m * max(0.0, math.cos(error_rad)),
            turn_rate_rad_s=turn_rate,
            states=(self.integral, self.derivative),
            stop_reason="arrived" if distance_m < settings.tolerance_m else None,
        )

    def remember(self, time_ns: int, error_rad: float) -> None:
        """Integrate and differentiate the error; poses of one burst share their time."""
        if self.last is not None and time_ns > self.last[0]:
            settings, dt_s = self.settings, (time_ns - self.last[0]) / 1e9
            integral = self.integral + error_rad * dt_s
            self.integral = max(-settings.most_integral, min(settings.most_integral, integral))
            slope = wrap_angle(error_rad - self.last[1]) / dt_s
            self.derivative += (slope - self.derivative) * dt_s / (settings.filter_s + dt_s)
        self.last = time_ns, error_rad
