"""Laws that rotate, then translate, and are not the sequential proportional one."""

import math
from dataclasses import dataclass
from typing import ClassVar

from msgspec.structs import replace

from tests.strange_law import StrangeLaw
from turtlelog.laws import Decision, Goal, Pose, SequentialP, SequentialPParameters
from turtlelog.run.angles import subtract_headings
from turtlelog.run.loops import Cause
from turtlelog.run.paths import Path


@dataclass(frozen=True, slots=True, kw_only=True)
class PidParameters(SequentialPParameters):
    ki: float = 0.2
    kd: float = 0.1


class SequentialPid:
    """Adds the integral and the difference of the commands that the proportional law wants."""

    Parameters: ClassVar = PidParameters
    declare = SequentialP.declare

    def __init__(self, parameters: PidParameters) -> None:
        names = SequentialPParameters.__slots__
        values = {name: getattr(parameters, name) for name in names}
        self._law = SequentialP(SequentialPParameters(**values))
        self._ki, self._kd = parameters.ki, parameters.kd
        self._sum = [0.0, 0.0]
        self._last = [0.0, 0.0]

    def reset(self, start: Pose, goal: Goal | None, path: Path | None) -> None:
        self._law.reset(start, goal, path)

    def step(self, time_ns: int, pose: Pose) -> Decision:
        decision = self._law.step(time_ns, pose)
        row = int(decision.phase == "translate")
        wanted = (decision.turn_rate_rad_s, decision.speed_m_s)[row]
        if wanted == 0.0:
            return decision
        self._sum[row] += wanted * 0.016
        rate = (wanted - self._last[row]) / 0.016
        self._last[row] = wanted
        found = wanted + self._ki * self._sum[row] + self._kd * rate
        if row:
            return replace(decision, speed_m_s=found)
        return replace(decision, turn_rate_rad_s=found)


class Silent(StrangeLaw):
    """Does not say which of its parameters count samples."""

    counts_samples = None  # type: ignore[assignment]


class Clashing(StrangeLaw):
    """Gives a cause the name of the loop's."""

    Parameters = SequentialPParameters  # type: ignore[assignment]
    causes = (Cause(name="delay", kind="effect", neutral={}, meaning="nothing"),)


@dataclass(frozen=True, slots=True, kw_only=True)
class CountingParameters:
    samples: int = 10


class Counting:
    """Turns for some samples."""

    Parameters: ClassVar = CountingParameters
    counts_samples: ClassVar = ("samples",)

    def __init__(self, parameters: CountingParameters) -> None:
        self._left = parameters.samples

    def reset(self, start: Pose, goal: Goal | None, path: Path | None) -> None:
        pass

    def step(self, time_ns: int, pose: Pose) -> Decision:
        self._left -= 1
        reason = None if self._left else "counted"
        return Decision(speed_m_s=0.0, turn_rate_rad_s=0.1, stop_reason=reason)


@dataclass(frozen=True, slots=True, kw_only=True)
class WeavingParameters:
    gain: float = 2.0
    every_samples: int = 60
    nap_ticks: int = 0


class Weaving:
    """Turns to the goal and drives there, weaving with two sines; naps now and then."""

    Parameters: ClassVar = WeavingParameters
    counts_samples: ClassVar = ("every_samples",)

    def __init__(self, parameters: WeavingParameters) -> None:
        self._parameters = parameters
        self._goal = Goal(0.0, 0.0)
        self._count = 0

    def reset(self, start: Pose, goal: Goal | None, path: Path | None) -> None:
        self._goal = goal or self._goal
        self._count = 0

    def step(self, time_ns: int, pose: Pose) -> Decision:
        self._count += 1
        settings = self._parameters
        ahead_m, left_m = self._goal.x_m - pose.x_m, self._goal.y_m - pose.y_m
        error_rad = subtract_headings(math.atan2(left_m, ahead_m), pose.heading_rad)
        distance_m = math.hypot(ahead_m, left_m)
        weave = 0.3 * math.sin(5e-9 * time_ns) + 0.2 * math.sin(13e-9 * time_ns)
        naps = self._count % settings.every_samples == 0
        return Decision(
            speed_m_s=distance_m * max(0.0, math.cos(error_rad)) * (1.0 + weave),
            turn_rate_rad_s=settings.gain * error_rad + weave,
            blocks_ticks=settings.nap_ticks if naps else 0,
            stop_reason="arrived" if distance_m < 0.05 else None,
        )


class Counting7:
    """Counts its calls, from run to run if `keeps`, and drives faster up to each seventh."""

    calls: ClassVar = 0
    keeps: ClassVar = True

    def __init__(self) -> None:
        if not self.keeps:
            type(self).calls = 0

    def step(self, time_ns: int, pose: Pose) -> Decision:
        type(self).calls += 1
        return Decision(speed_m_s=0.1 * (self.calls % 7), turn_rate_rad_s=0.0)


class Restarting7(Counting7):
    keeps = False


class Tiring(Weaving):
    """Turns less each time that it is made, from the fifth time on: it is not deterministic."""

    made: ClassVar = 0

    def __init__(self, parameters: WeavingParameters) -> None:
        super().__init__(parameters)
        type(self).made += 1
        self._number = self.made

    def step(self, time_ns: int, pose: Pose) -> Decision:
        found = super().step(time_ns, pose)
        less = max(0, self._number - 4) * 0.01
        return replace(found, turn_rate_rad_s=found.turn_rate_rad_s - less)
