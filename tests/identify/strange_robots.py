"""Robots that no structure of the fit is like, or only nearly, of known truth; in small steps."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final

import numpy as np

from tests.identify import limited_robots
from tests.identify.limited_robots import Limited, LimitedRobot
from tests.identify.robots import Log, Values

_STEP_S: Final = 1e-3
"""Longest step in time [s]: headings are off by less than 1e-5 rad."""

_PLANNED: Final = 3
"""Parts of a step for a plan that brakes, which is then as exact."""


@dataclass(frozen=True, kw_only=True)
class Strange(Limited):
    """A turn rate with a second state, or commands and odometry that are not what they seem.

    Attributes:
        damping: Damping ratio of a rate of second order; 0 for first order.
        rubbing: Rate that dry friction costs at any rate above 0 [rad/s].
        sticking: Rate that must be asked for until the robot leaves rest [rad/s].
        jerk: Largest change of the commanded acceleration, beside `ramp` [rad/s^3].
        quantum: Step of the commands that the robot knows [rad/s].
        fading: Share of the gain that a command of 1 rad/s loses [s/rad].
        jitter_s: Largest dead time of a message more than the least [s].
        filter_s: Time constant of a filter of the odometry [s].
    """

    damping: float = 0.0
    rubbing: float = 0.0
    sticking: float = 0.0
    jerk: float = 0.0
    quantum: float = 0.0
    fading: float = 0.0
    jitter_s: float = 0.0
    filter_s: float = 0.0

    def ask(self, command: float) -> float:
        """Return the rate that a command asks for [rad/s]."""
        if self.quantum:
            command = self.quantum * round(command / self.quantum)
        return self.gain * command * (1.0 - self.fading * abs(command))

    def delay(self, time_s: Values) -> Values:
        """Return when messages act; none overtakes another."""
        rng = np.random.default_rng(len(time_s))
        later_s = rng.uniform(0.0, self.jitter_s, len(time_s))
        return np.asarray(np.maximum.accumulate(time_s + self.dead_time_s + later_s))

    def build(self) -> LimitedRobot:
        """Return the robot at rest."""
        return StrangeRobot(self)

    def list_truth(self) -> dict[str, float]:
        """Return the true values by the names of the model's fields, as small commands show them.

        The lag is the sum of all, the dead time the mean.
        """
        dead_time_s, lag_s = self.dead_time_s + 0.5 * self.jitter_s, self.lag_s + self.filter_s
        delays = {"dead_time_s": dead_time_s, "lag_s": lag_s, "total_delay_s": dead_time_s + lag_s}
        return {**super().list_truth(), **delays, "friction": self.rubbing / self.gain}


class StrangeRobot(LimitedRobot):
    """One, in steps: its heading is that which its odometry tells."""

    def __init__(self, truth: Strange) -> None:
        """Build it at rest."""
        super().__init__(truth)
        self.of, self.heading, self.slope = truth, 0.0, 0.0

    def move(self, duration_s: float) -> None:
        """Let a time pass without a command."""
        count = math.ceil(duration_s / _STEP_S)
        for _ in range(count):
            self._step(duration_s / count)

    def _step(self, step_s: float) -> None:
        of, before = self.of, self.rate
        target = self._plan(step_s) if of.jerk else self.asked
        faded = math.exp(-step_s / of.lag_s)
        if of.damping:
            inertia = (0.5 * of.lag_s / of.damping) ** 2
            # The middle of the step: off by the cube of the step.
            middle = before + 0.5 * step_s * self.slope
            slope = self.slope + 0.5 * step_s * self._push(target, before, self.slope, inertia)
            self.rate = before + step_s * slope
            self.slope += step_s * self._push(target, middle, slope, inertia)
        elif of.rubbing:
            self._rub(target, faded)
        else:
            self.rate = target + (before - target) * faded
        start = self.heading
        self.heading += 0.5 * step_s * (before + self.rate)
        if not of.filter_s:
            self.heading_rad = self.heading
            return
        left = math.exp(-step_s / of.filter_s)
        middle = 0.5 * (start + self.heading)
        self.heading_rad = middle + (self.heading_rad - middle) * left

    def _push(self, target: float, rate: float, slope: float, inertia: float) -> float:
        return (target - rate - self.of.lag_s * slope) / inertia

    def _rub(self, target: float, faded: float) -> None:
        """Follow a target against dry friction, which ends at rest."""
        if self.rate == 0.0 and abs(target) <= self.of.sticking:
            return
        way = math.copysign(1.0, self.rate or target)
        left = target - way * self.of.rubbing
        rate = left + (self.rate - left) * faded
        self.rate = rate if rate * way > 0.0 else 0.0

    def _plan(self, step_s: float) -> float:
        """Return the mean planned rate in a step: no change of acceleration exceeds the jerk."""
        before, part_s, most = self.ramped, step_s / _PLANNED, self.of.jerk
        sums = 0.0
        for _ in range(_PLANNED):
            off = self.asked - self.ramped
            if abs(off) <= most * part_s**2 and abs(self.slope) <= 2.0 * most * part_s:
                self.ramped, self.slope = self.asked, 0.0
            half, slope = 0.5 * most * part_s, self.slope
            left = max(abs(off) - 0.5 * part_s * slope * math.copysign(1.0, off), 0.0)
            stopping = math.sqrt(half**2 + 2.0 * most * left) - half
            wanted = math.copysign(min(self.of.ramp, stopping), off)
            self.slope += min(max(wanted - slope, -2.0 * half), 2.0 * half)
            self.ramped += 0.5 * part_s * (slope + self.slope)
            sums += self.ramped
        return (sums + 0.5 * (before - self.ramped)) / _PLANNED


def _draw(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.uniform(low, high))


def _rub(truth: Strange, rng: np.random.Generator) -> Strange:
    rubbing = _draw(rng, 0.1, 0.3)
    return replace(truth, rubbing=rubbing, sticking=rubbing * _draw(rng, 1.0, 1.5))


KINDS: Final = MappingProxyType[str, Callable[[Strange, np.random.Generator], Strange]](
    {
        "underdamped": lambda truth, rng: replace(truth, damping=_draw(rng, 0.3, 0.7)),
        "dry friction": _rub,
        "jerk": lambda truth, rng: replace(
            truth, ramp=_draw(rng, 2.0, 5.0), jerk=_draw(rng, 10.0, 40.0)
        ),
        "quantised": lambda truth, rng: replace(truth, quantum=_draw(rng, 0.05, 0.2)),
        "fading gain": lambda truth, rng: replace(truth, fading=_draw(rng, 0.07, 0.2)),
        "jitter": lambda truth, _: replace(truth, jitter_s=0.04),
        "filtered": lambda truth, rng: replace(truth, filter_s=_draw(rng, 0.05, 0.2)),
        "rare poses": lambda truth, _: truth,
        "rare commands": lambda truth, _: truth,
    }
)
"""What is strange about a robot, drawn at random."""


def draw_robot(kind: str, seed: int) -> tuple[Strange, Log]:
    """Return a robot of a kind, and how it is recorded."""
    rng = np.random.default_rng([seed, 47])
    plain, log = limited_robots.draw_robot("first order", seed)
    truth = Strange(gain=plain.gain, dead_time_s=plain.dead_time_s, lag_s=plain.lag_s)
    if kind == "rare poses":
        log = replace(log, poses_hz=5.0)
    if kind == "rare commands":
        log = replace(log, commands_hz=2.0)
    return KINDS[kind](truth, rng), log
