"""Laws that rotate, then translate, and are not the sequential proportional one."""

from dataclasses import dataclass
from typing import ClassVar

from msgspec.structs import replace

from tests.strange_law import StrangeLaw
from turtlelog.laws import Decision, Goal, Pose, SequentialP, SequentialPParameters
from turtlelog.loops import Mechanism


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

    def reset(self, start: Pose, goal: Goal | None, path: None) -> None:
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
    """Gives a mechanism the name of the loop's."""

    Parameters = SequentialPParameters  # type: ignore[assignment]
    mechanisms = (Mechanism(name="delay", kind="effect", neutral={}, meaning="nothing"),)


@dataclass(frozen=True, slots=True, kw_only=True)
class CountingParameters:
    samples: int = 10


class Counting:
    """Turns for some samples."""

    Parameters: ClassVar = CountingParameters
    counts_samples: ClassVar = ("samples",)

    def __init__(self, parameters: CountingParameters) -> None:
        self._left = parameters.samples

    def reset(self, start: Pose, goal: Goal | None, path: None) -> None:
        pass

    def step(self, time_ns: int, pose: Pose) -> Decision:
        self._left -= 1
        reason = None if self._left else "counted"
        return Decision(speed_m_s=0.0, turn_rate_rad_s=0.1, stop_reason=reason)
