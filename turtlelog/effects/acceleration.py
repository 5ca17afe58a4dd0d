"""Limits of acceleration and jerk, which bound how fast a command follows the wanted command.

With a jerk limit the command follows the fastest S-curve to the wanted command and comes to rest
there without overshoot. The curve has three parts of constant jerk; the jerk of the middle part is
0.
"""

import math
from dataclasses import dataclass, field
from typing import Any

from turtlelog.arithmetic import clip, least, most
from turtlelog.parts import Action, Effect, Positive, absent
from turtlelog.run.loops import Cause


@dataclass(frozen=True, slots=True, kw_only=True)
class AccelerationKeys:
    """Limits of the rate at which commands change.

    Attributes:
        acceleration_m_s2: Largest magnitude of the change of the speed per second [m/s^2].
        turn_acceleration_rad_s2: Largest magnitude of the change of the turn rate per second
            [rad/s^2].
        jerk_m_s3: Largest magnitude of the change of the acceleration per second [m/s^3].
        turn_jerk_rad_s3: Largest magnitude of the change of the turn acceleration per second
            [rad/s^3].
    """

    acceleration_m_s2: Positive = absent(math.inf, may_be_infinite=True)
    turn_acceleration_rad_s2: Positive = absent(math.inf, may_be_infinite=True)
    jerk_m_s3: Positive = absent(math.inf, may_be_infinite=True)
    turn_jerk_rad_s3: Positive = absent(math.inf, may_be_infinite=True)


@dataclass(slots=True)
class Follower:
    """State of one command: its value and its rate of change, starting at rest."""

    value: float = 0.0
    rate: float = 0.0


@dataclass(slots=True)
class Followers:
    """State of both commands, starting at rest."""

    speed: Follower = field(default_factory=Follower)
    turn_rate: Follower = field(default_factory=Follower)


def follow(
    settings: Any, state: Any, dt_s: float, value: tuple[float, float]
) -> tuple[float, float]:
    """Return the command at a time after the last command [s]; `value` is within the limits."""
    limits = settings.limits
    largest, turn_largest = limits.acceleration_m_s2, limits.turn_acceleration_rad_s2
    speed, turn_rate = value
    if math.isfinite(limits.jerk_m_s3):
        rates = largest, limits.jerk_m_s3
        speed = follow_with_jerk(state.speed, limits.speed_m_s, rates, speed, dt_s)
    elif math.isfinite(largest):
        speed = follow_with_acceleration(state.speed, largest, speed, dt_s)
    if math.isfinite(limits.turn_jerk_rad_s3):
        rates = turn_largest, limits.turn_jerk_rad_s3
        turn_rate = follow_with_jerk(
            state.turn_rate, limits.turn_rate_rad_s, rates, turn_rate, dt_s
        )
    elif math.isfinite(turn_largest):
        turn_rate = follow_with_acceleration(state.turn_rate, turn_largest, turn_rate, dt_s)
    return speed, turn_rate


def follow_with_acceleration(state: Any, largest: float, wanted: float, dt_s: float) -> float:
    """Return a command with bounded change per second."""
    step = largest * dt_s
    if abs(wanted - state.value) <= step:
        state.value = wanted
    else:
        state.value += math.copysign(step, wanted - state.value)
    followed: float = state.value
    return followed


def follow_with_jerk(
    state: Any, limit: float, rates: tuple[float, float], wanted: float, dt_s: float
) -> float:
    """Return a command with bounded acceleration and jerk, its first and second rate of change."""
    if not (dt_s <= 0.0 or (state.value == wanted and state.rate == 0.0)):
        _follow_curve(state, rates, wanted, dt_s)
        state.value = clip(state.value, limit)
    followed: float = state.value
    return followed


def _follow_curve(state: Any, rates: tuple[float, float], wanted: float, dt_s: float) -> None:
    jerk, begin_s, held_s, end_s = plan_curve(state.value, state.rate, rates, wanted)
    left_s = dt_s
    for part in range(3):
        part_jerk = jerk if part == 0 else 0.0 if part == 1 else -jerk
        duration_s = begin_s if part == 0 else held_s if part == 1 else end_s
        part_s = least(duration_s, left_s)
        state.value += (state.rate + 0.5 * part_jerk * part_s) * part_s
        state.rate += part_jerk * part_s
        left_s -= part_s
        if left_s <= 0.0:
            return
    state.value, state.rate = wanted, 0.0


def plan_curve(
    value: float, rate: float, rates: tuple[float, float], wanted: float
) -> tuple[float, float, float, float]:
    """Return the S-curve to a wanted command: its first jerk, and the durations of its parts [s].

    The jerk of the middle part is 0, that of the last part is opposite to the first.
    """
    largest, jerk = rates
    # Where the command would come to rest if the acceleration were taken back from now on.
    rest = value + rate * abs(rate) / (2.0 * jerk)
    side = math.copysign(1.0, wanted - rest)
    way, now = side * (wanted - value), side * rate
    top = least(math.sqrt(most(jerk * way + 0.5 * now * now, 0.0)), largest)
    top = most(top, now)
    held_s = 0.0
    if top > 0.0:
        held_s = most(way - (2.0 * top * top - now * now) / (2.0 * jerk), 0.0) / top
    return side * jerk, (top - now) / jerk, held_s, top / jerk


PART = Effect(
    name="acceleration",
    tables={"limits": AccelerationKeys},
    actions={"limit": Action(step=follow)},
    State=Followers,
    causes=(
        Cause(
            name="acceleration",
            kind="design",
            neutral={
                "limits.acceleration_m_s2": math.inf,
                "limits.turn_acceleration_rad_s2": math.inf,
            },
            meaning="no limit of acceleration",
        ),
        Cause(
            name="jerk",
            kind="design",
            neutral={"limits.jerk_m_s3": math.inf, "limits.turn_jerk_rad_s3": math.inf},
            meaning="no limit of jerk",
        ),
    ),
)
