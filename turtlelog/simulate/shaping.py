"""What becomes of the commands that a law wants: shaping, then limits of speed and its rates."""

import math
from typing import Protocol

import msgspec

from turtlelog.laws import Law, Pose
from turtlelog.scenario import Scenario
from turtlelog.simulate.law_driver import LawDriver, Sample
from turtlelog.simulate.sensing import round_to_step


class Limiter(Protocol):
    """Follows a wanted command as fast as it may."""

    def follow(self, wanted: float, dt_s: float) -> float:
        """Return the command so long after the last one [s]."""
        ...


class Clip:
    """Bounds the magnitude alone."""

    __slots__ = ("_limit",)

    def __init__(self, limit: float) -> None:
        """Take the largest magnitude."""
        self._limit = limit

    def follow(self, wanted: float, dt_s: float) -> float:
        """Return the wanted command, clipped; it takes no time."""
        del dt_s
        return min(max(wanted, -self._limit), self._limit)


class AccelerationLimiter:
    """Bounds the change of the command per second as well; from rest."""

    __slots__ = ("_clip", "_largest", "_value")

    def __init__(self, limit: float, largest: float) -> None:
        """Take the largest magnitudes of the command and of its change per second."""
        self._clip, self._largest, self._value = Clip(limit), largest, 0.0

    def follow(self, wanted: float, dt_s: float) -> float:
        """Return the command so long after the last one [s]."""
        wanted, step = self._clip.follow(wanted, dt_s), self._largest * dt_s
        if abs(wanted - self._value) <= step:
            self._value = wanted
        else:
            self._value += math.copysign(step, wanted - self._value)
        return self._value


class JerkLimiter:
    """Bounds the change of the acceleration per second as well; from rest.

    The command moves along the fastest S-curve to what is wanted, where it comes to rest without an
    overshoot: three parts of constant jerk, of which the middle one has none.
    """

    __slots__ = ("_acceleration", "_clip", "_jerk", "_largest", "_limit", "_value")

    def __init__(self, limit: float, largest: float, jerk: float) -> None:
        """Take the largest magnitudes of the command, of its acceleration and of its jerk."""
        self._clip, self._largest, self._jerk = Clip(limit), largest, jerk
        self._value = self._acceleration = 0.0

    def follow(self, wanted: float, dt_s: float) -> float:
        """Return the command so long after the last one [s]."""
        wanted = self._clip.follow(wanted, dt_s)
        if dt_s <= 0.0 or (self._value == wanted and self._acceleration == 0.0):
            return self._value
        left_s = dt_s
        for jerk, duration_s in self._plan(wanted):
            part_s = min(duration_s, left_s)
            self._value += (self._acceleration + 0.5 * jerk * part_s) * part_s
            self._acceleration += jerk * part_s
            left_s -= part_s
            if left_s <= 0.0:
                break
        else:
            self._value, self._acceleration = wanted, 0.0
        self._value = self._clip.follow(self._value, dt_s)
        return self._value

    def _plan(self, wanted: float) -> tuple[tuple[float, float], ...]:
        """Return jerk and duration [s] of each part of the way to the wanted command."""
        jerk = self._jerk
        # Where the command would come to rest if the acceleration were taken back from now on.
        rest = self._value + self._acceleration * abs(self._acceleration) / (2.0 * jerk)
        side = math.copysign(1.0, wanted - rest)
        way, now = side * (wanted - self._value), side * self._acceleration
        top = min(math.sqrt(max(jerk * way + 0.5 * now * now, 0.0)), self._largest)
        top = max(top, now)
        held_s = 0.0
        if top > 0.0:
            held_s = max(way - (2.0 * top * top - now * now) / (2.0 * jerk), 0.0) / top
        return (
            (side * jerk, (top - now) / jerk),
            (0.0, held_s),
            (-side * jerk, top / jerk),
        )


class _Shaper:
    """Shapes the commands of one axis: low-pass, dead zone, quantum."""

    __slots__ = ("_dead_zone", "_low_pass_s", "_quantum", "_value")

    def __init__(self, low_pass_s: float, dead_zone: float, quantum: float) -> None:
        self._low_pass_s, self._dead_zone, self._quantum = low_pass_s, dead_zone, quantum
        self._value = 0.0

    def shape(self, wanted: float, dt_s: float) -> float:
        """Return what is left of a wanted command so long after the last one [s]."""
        if self._low_pass_s:
            self._value -= math.expm1(-dt_s / self._low_pass_s) * (wanted - self._value)
            wanted = self._value
        if abs(wanted) < self._dead_zone:
            return 0.0
        return round_to_step(wanted, self._quantum)


class ShapingDriver(LawDriver):
    """A law whose commands are shaped, or bounded in acceleration and jerk, as time passes."""

    __slots__ = ("_first_s", "_has_shaping", "_last_ns", "_speed", "_turn_rate")

    def __init__(
        self, scenario: Scenario, law: Law, *, period_s: float, step_budget_s: float | None = None
    ) -> None:
        """Count `period_s` before the first sample, from rest."""
        super().__init__(scenario, law, step_budget_s=step_budget_s)
        shaping, limits = scenario.shaping, scenario.limits
        self._has_shaping = shaping.acts
        self._first_s, self._last_ns = period_s, -1
        low_pass_s = shaping.low_pass_s
        self._speed = (
            _Shaper(low_pass_s, shaping.dead_zone_speed_m_s, shaping.quantum_speed_m_s),
            build_limiter(limits.speed_m_s, limits.acceleration_m_s2, limits.jerk_m_s3),
        )
        dead_zone, quantum = shaping.dead_zone_turn_rate_rad_s, shaping.quantum_turn_rate_rad_s
        rates = limits.turn_acceleration_rad_s2, limits.turn_jerk_rad_s3
        self._turn_rate = (
            _Shaper(low_pass_s, dead_zone, quantum),
            build_limiter(limits.turn_rate_rad_s, *rates),
        )

    def answer(self, time_ns: int, pose_sequence: int, pose: Pose) -> Sample:
        """Return the sample that a pose makes, with its command shaped and limited.

        Raises:
            SimulationError: Where the law fails or answers with something that is no number.
        """
        sample = super().answer(time_ns, pose_sequence, pose)
        dt_s = self._first_s if self._last_ns < 0 else (time_ns - self._last_ns) / 1e9
        self._last_ns = time_ns
        shaper, limiter = self._speed
        speed = shaper.shape(sample.decision.speed_m_s, dt_s)
        turn_shaper, turn_limiter = self._turn_rate
        turn_rate = turn_shaper.shape(sample.decision.turn_rate_rad_s, dt_s)
        return msgspec.structs.replace(
            sample,
            speed_m_s=limiter.follow(speed, dt_s),
            turn_rate_rad_s=turn_limiter.follow(turn_rate, dt_s),
            shaped_speed_m_s=speed if self._has_shaping else math.nan,
            shaped_turn_rate_rad_s=turn_rate if self._has_shaping else math.nan,
        )


def build_limiter(limit: float, acceleration: float, jerk: float) -> Limiter:
    """Return what bounds a command, its change per second, and the change of that."""
    if math.isfinite(jerk):
        return JerkLimiter(limit, acceleration, jerk)
    if math.isfinite(acceleration):
        return AccelerationLimiter(limit, acceleration)
    return Clip(limit)


def build_driver(
    scenario: Scenario,
    law: Law,
    *,
    period_ns: int | None = None,
    step_budget_s: float | None = None,
) -> LawDriver:
    """Return what asks a law, and shapes and limits its commands where the scenario says so.

    Args:
        scenario: With its law resolved.
        law: Its law.
        period_ns: Of the plant's clock [ns]; None: as the scenario says.
        step_budget_s: How long the law may compute for one answer [s]; None: as long as it takes.
    """
    limits, loop = scenario.limits, scenario.loop
    rates = (limits.acceleration_m_s2, limits.turn_acceleration_rad_s2)
    jerks = (limits.jerk_m_s3, limits.turn_jerk_rad_s3)
    if not scenario.shaping.acts and all(map(math.isinf, (*rates, *jerks))):
        return LawDriver(scenario, law, step_budget_s=step_budget_s)
    period_ns = scenario.plant.facts.period_ns if period_ns is None else period_ns
    period_s = loop.period_s or loop.period_ticks * period_ns / 1e9
    return ShapingDriver(scenario, law, period_s=period_s, step_budget_s=step_budget_s)
