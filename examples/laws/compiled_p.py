"""P control as a part of the loop: a function of numbers, which numba compiles for sweeps.

turtlelog run --law examples/laws/compiled_p.py:P --kp 2
turtlelog sweep textbook --set law.kind=examples/laws/compiled_p.py:P --grid law.kp=0.5:10:0.01
"""

import math
from dataclasses import dataclass
from typing import Any

from turtlelog.arithmetic import hypot, wrap_angle
from turtlelog.laws import Goal, LawPart
from turtlelog.run.loops import ControlLoop, Declaration
from turtlelog.run.paths import Path

ALIGN = ControlLoop(
    name="align", signal="heading", command="turn_rate", reference="bearing_now", gain="law.kp"
)
APPROACH = ControlLoop(
    name="approach", signal="distance", command="speed", reference="zero", gain="law.kp_linear"
)
ARRIVED = 1  # the first of `stops`


@dataclass(frozen=True, kw_only=True)
class Gains:
    kp: float = 2.0  # of the heading [1/s]
    kp_linear: float = 1.0  # of the distance [1/s]
    tolerance_m: float = 0.01  # where the run ends


@dataclass(slots=True)
class State:
    samples: int = 0


def step(
    settings: Any, state: Any, row: Any, pose: tuple[float, float, float]
) -> tuple[float, float]:
    x_m, y_m = settings.goal.x_m - pose[0], settings.goal.y_m - pose[1]
    distance_m, bearing_rad = hypot(x_m, y_m), math.atan2(y_m, x_m)
    error_rad = wrap_angle(bearing_rad - pose[2])
    state.samples += 1
    row.error_x_m, row.error_y_m, row.distance_m = x_m, y_m, distance_m
    row.bearing_rad, row.heading_error_rad = bearing_rad, error_rad
    if distance_m < settings.law.tolerance_m:
        row.stop = ARRIVED
    speed = settings.law.kp_linear * distance_m * max(0.0, math.cos(error_rad))
    return speed, settings.law.kp * error_rad


def declare(_: Gains, goal: Goal | None, path: Path | None) -> Declaration:  # noqa: ARG001
    return Declaration(loops=(ALIGN, APPROACH), phases={"drive": ("align", "approach")})


P = LawPart(
    name="compiled-p",
    meaning="Turn and drive towards the goal at once.",
    Parameters=Gains,
    step=step,
    declare=declare,
    State=State,
    stops=("arrived",),
    counts_samples=(),
)
