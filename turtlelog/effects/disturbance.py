"""Disturbances and noise of the plant's rates, added after the time constant."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from turtlelog.arithmetic import to_ns
from turtlelog.effects.delay import judge_delays
from turtlelog.parts import (
    NEVER_NS,
    Action,
    Complaint,
    Effect,
    NotNegative,
    Offset,
    Size,
    Stream,
    Time,
    TurnOffset,
    TurnSize,
    absent,
)
from turtlelog.run.loops import PUSH_KEYS, Cause

_END_OF_TIME_S = 9e9
"""A time later than any run [s]; in nanoseconds it fits into 64 bits."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DisturbanceKeys:
    """Disturbances and noise, added to the rates of the plant.

    Attributes:
        speed_m_s: Disturbance along the heading [m/s].
        turn_rate_rad_s: Disturbance of the turn rate, counter-clockwise [rad/s].
        from_s: Time at which disturbance and noise begin [s].
        to_s: Time at which disturbance and noise end [s]; inf: the end of the run.
        noise_speed: White noise of the speed [m/s times the root of a second]. After a time t, the
            standard deviation of the distance is the noise times the root of t.
        noise_turn_rate: White noise of the turn rate [rad/s times the root of a second].
    """

    speed_m_s: Offset = absent(0.0)
    turn_rate_rad_s: TurnOffset = absent(0.0)
    from_s: Time = absent(0.0)
    to_s: NotNegative = absent(math.inf, may_be_infinite=True)
    noise_speed: Size = absent(0.0)
    noise_turn_rate: TurnSize = absent(0.0)


def find_push(
    settings: Any, drawn: Any, time_ns: int, period_ns: int, value: tuple[float, float]
) -> tuple[float, float]:
    """Return the disturbance of speed [m/s] and turn rate [rad/s] at a time in a step."""
    push = settings.disturbance
    if not to_ns(push.from_s) <= time_ns < _find_end_ns(push.to_s):
        return value
    speed, turn_rate = push.speed_m_s, push.turn_rate_rad_s
    # A velocity held for a step moves by its standard deviation times the step.
    root = math.sqrt(period_ns / 1e9)
    scale, turn_scale = push.noise_speed / root, push.noise_turn_rate / root
    if scale != 0.0 or turn_scale != 0.0:
        speed += scale * drawn.speed
        turn_rate += turn_scale * drawn.turn_rate
    return value[0] + speed, value[1] + turn_rate


def find_next_push(settings: Any, time_ns: int, value: int) -> int:
    """Return the time at which the disturbance next begins or ends [ns]."""
    push = settings.disturbance
    from_ns, end_ns = to_ns(push.from_s), _find_end_ns(push.to_s)
    if time_ns < from_ns:
        return min(value, from_ns)
    return min(value, end_ns) if time_ns < end_ns else value


def _find_end_ns(to_s: float) -> int:
    return to_ns(to_s) if to_s < _END_OF_TIME_S else NEVER_NS


def _judge(scenario: Any) -> Iterator[Complaint]:
    push = scenario.disturbance
    yield from judge_delays({"disturbance.from_s": push.from_s}, scenario.max_duration_s)
    if push.to_s <= push.from_s:
        yield "disturbance.to_s", f"a time after from_s = {push.from_s:g}", repr(push.to_s)


def _note(scenario: Any) -> Iterator[str]:
    push, usual = scenario.disturbance, DisturbanceKeys()
    names = [name for name in ("from_s", "to_s") if getattr(push, name) != getattr(usual, name)]
    if names and not PART.acts(scenario):
        keys = " and ".join(f"disturbance.{name}" for name in names)
        yield f"{keys}: there is no disturbance and no noise to begin or end"


PART = Effect(
    name="disturbance",
    tables={"disturbance": DisturbanceKeys},
    actions={
        "push": Action(
            step=find_push,
            stream=Stream(
                number=8,
                kind="normal",
                fields=("speed", "turn_rate"),
                keys=("disturbance.noise_speed", "disturbance.noise_turn_rate"),
            ),
        ),
        "next_push": Action(step=find_next_push),
    },
    causes=(
        Cause(
            name="disturbance",
            kind="effect",
            neutral=dict.fromkeys(PUSH_KEYS, 0.0),
            meaning="nothing disturbs the robot",
        ),
    ),
    added=(
        *("disturbance.speed_m_s", "disturbance.turn_rate_rad_s"),
        *("disturbance.from_s", "disturbance.to_s"),
    ),
    judge=_judge,
    notes=_note,
)
