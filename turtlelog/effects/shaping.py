"""Shape the wanted commands before the limits: low-pass filter, dead zone, quantisation."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from turtlelog.arithmetic import round_to_step
from turtlelog.parts import Action, Complaint, Effect, Size, Time, absent
from turtlelog.run.loops import Cause


@dataclass(frozen=True, slots=True, kw_only=True)
class ShapingKeys:
    """Low-pass filter, dead zone and quantisation of commands: the table `[shaping]`.

    The order is: low-pass filter, dead zone, rounding to the quantisation step.

    Attributes:
        low_pass_s: Time constant of a first-order filter on both commands [s]; 0: no filter.
        dead_zone_speed_m_s: Dead zone of the speed [m/s]: smaller magnitudes become 0, others do
            not change.
        dead_zone_turn_rate_rad_s: Dead zone of the turn rate [rad/s]: smaller magnitudes become 0.
        quantum_speed_m_s: Step to which the speed is rounded [m/s]; 0: no rounding.
        quantum_turn_rate_rad_s: Step to which the turn rate is rounded [rad/s]; 0: no rounding.
    """

    low_pass_s: Time = absent(0.0)
    dead_zone_speed_m_s: Size = absent(0.0)
    dead_zone_turn_rate_rad_s: Size = absent(0.0)
    quantum_speed_m_s: Size = absent(0.0)
    quantum_turn_rate_rad_s: Size = absent(0.0)


@dataclass(slots=True)
class Filter:
    """State of the filter of one command."""

    value: float = 0.0


@dataclass(slots=True)
class Filters:
    """State of both filters, starting at rest."""

    speed: Filter = field(default_factory=Filter)
    turn_rate: Filter = field(default_factory=Filter)


def shape(
    settings: Any, state: Any, dt_s: float, value: tuple[float, float]
) -> tuple[float, float]:
    """Return the shaped command at a time after the last command [s]."""
    keys = settings.shaping
    speed, turn_rate = value
    if keys.low_pass_s != 0.0:
        speed = low_pass(state.speed, keys.low_pass_s, dt_s, speed)
        turn_rate = low_pass(state.turn_rate, keys.low_pass_s, dt_s, turn_rate)
    if abs(speed) < keys.dead_zone_speed_m_s:
        speed = 0.0
    else:
        speed = round_to_step(speed, keys.quantum_speed_m_s)
    if abs(turn_rate) < keys.dead_zone_turn_rate_rad_s:
        turn_rate = 0.0
    else:
        turn_rate = round_to_step(turn_rate, keys.quantum_turn_rate_rad_s)
    return speed, turn_rate


def low_pass(state: Any, time_constant_s: float, dt_s: float, wanted: float) -> float:
    """Return a command behind a first-order filter; the result is exact for a constant command."""
    state.value -= math.expm1(-dt_s / time_constant_s) * (wanted - state.value)
    filtered: float = state.value
    return filtered


def _judge(scenario: Any) -> Iterator[Complaint]:
    """Yield notes on shaping that lets no command through."""
    for name in ("speed_m_s", "turn_rate_rad_s"):
        limit = getattr(scenario.limits, name)
        for kind in ("dead_zone", "quantum"):
            value = getattr(scenario.shaping, f"{kind}_{name}")
            if value > limit:
                most = f"no more than limits.{name} = {limit:g}"
                yield f"shaping.{kind}_{name}", most, repr(value)


PART = Effect(
    name="shaping",
    tables={"shaping": ShapingKeys},
    actions={"shape": Action(step=shape)},
    State=Filters,
    causes=(
        Cause(
            name="shaping",
            kind="design",
            neutral={
                "shaping.low_pass_s": 0.0,
                "shaping.dead_zone_speed_m_s": 0.0,
                "shaping.dead_zone_turn_rate_rad_s": 0.0,
                "shaping.quantum_speed_m_s": 0.0,
                "shaping.quantum_turn_rate_rad_s": 0.0,
            },
            meaning="commands as the law wants them, up to the limits",
        ),
    ),
    modelled=("shaping.low_pass_s",),
    judge=_judge,
)
