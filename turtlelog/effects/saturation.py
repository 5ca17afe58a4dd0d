"""Clip commands to limits of speed and turn rate."""

import math
from dataclasses import dataclass, field
from typing import Any

from turtlelog.parts import MAY_BE_INFINITE, Action, Effect, Positive
from turtlelog.run.loops import Cause


@dataclass(frozen=True, slots=True, kw_only=True)
class SaturationKeys:
    """Limits at which the controller clips its commands; inf: no limit.

    Attributes:
        speed_m_s: Largest magnitude of the forward speed [m/s].
        turn_rate_rad_s: Largest magnitude of the turn rate [rad/s].
    """

    speed_m_s: Positive = field(default=1.0, metadata=MAY_BE_INFINITE)
    turn_rate_rad_s: Positive = field(default=1.0, metadata=MAY_BE_INFINITE)


def saturate(settings: Any, value: tuple[float, float]) -> tuple[float, float]:
    """Return the command, clipped."""
    speed, turn_rate = value
    most, most_turn = settings.limits.speed_m_s, settings.limits.turn_rate_rad_s
    if not -most <= speed <= most:
        speed = math.copysign(most, speed)
    if not -most_turn <= turn_rate <= most_turn:
        turn_rate = math.copysign(most_turn, turn_rate)
    return speed, turn_rate


PART = Effect(
    name="saturation",
    tables={"limits": SaturationKeys},
    actions={"limit": Action(step=saturate)},
    causes=(
        Cause(
            name="saturation",
            kind="design",
            neutral={"limits.speed_m_s": math.inf, "limits.turn_rate_rad_s": math.inf},
            meaning="no limit of speed and turn rate",
        ),
    ),
    added=("limits.speed_m_s", "limits.turn_rate_rad_s"),
)
