"""P control: turns and drives towards the goal at once. The shortest law with declared loops.

turtlelog run --law examples/laws/p.py:P --kp 2
"""

import math
from dataclasses import dataclass

from turtlelog.laws import Decision, Goal, Pose
from turtlelog.run.angles import wrap_angle
from turtlelog.run.loops import ControlLoop, Declaration
from turtlelog.run.paths import Path

ALIGN = ControlLoop(
    name="align", signal="heading", command="turn_rate", reference="bearing_now", gain="law.kp"
)
APPROACH = ControlLoop(
    name="approach", signal="distance", command="speed", reference="zero", gain="law.kp_linear"
)


@dataclass(frozen=True, kw_only=True)
class Gains:
    kp: float = 2.0  # of the heading [1/s]
    kp_linear: float = 1.0  # of the distance [1/s]
    tolerance_m: float = 0.01  # where the run ends


class P:
    Parameters = Gains
    counts_samples = ()  # none of its parameters counts samples

    @classmethod
    def declare(cls, parameters: Gains, goal: Goal | None, path: Path | None) -> Declaration:
        return Declaration(loops=(ALIGN, APPROACH), phases={"drive": ("align", "approach")})

    def __init__(self, parameters: Gains) -> None:
        self.gains = parameters

    def reset(self, start: Pose, goal: Goal | None, path: Path | None) -> None:
        self.goal = goal or Goal(start.x_m, start.y_m)

    def step(self, time_ns: int, pose: Pose) -> Decision:
        ahead_m, left_m = self.goal.x_m - pose.x_m, self.goal.y_m - pose.y_m
        distance_m = math.hypot(ahead_m, left_m)
        error_rad = wrap_angle(math.atan2(left_m, ahead_m) - pose.heading_rad)
        return Decision(
            speed_m_s=self.gains.kp_linear * distance_m * max(0.0, math.cos(error_rad)),
            turn_rate_rad_s=self.gains.kp * error_rad,
            stop_reason="arrived" if distance_m < self.gains.tolerance_m else None,
        )
