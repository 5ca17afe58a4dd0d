"""Robots with limits of known truth, exact from event to event; they share no code with the fit."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final

import numpy as np

import turtlelog as tl
from tests.identify.robots import Log, Values, build_run, draw_steps, wrap
from turtlelog.identify import build_robot_scenario
from turtlelog.run import Run
from turtlelog.theory import recommend_gains

TURNS_RAD: Final = (0.3, 2.5)
"""A small and a large turn."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limited:
    """A turn rate: r' = clip((K f(u) - r) / lag, +-acceleration), after a dead time.

    Attributes:
        gain: K of a command above 0 [1].
        dead_time_s: From a command until the rate begins to follow [s].
        lag_s: Time constant [s].
        acceleration: Largest change of the rate, inside its loop [rad/s^2].
        ramp: Largest change of the commanded rate, before the loop [rad/s^2].
        bound: Largest rate that a command asks for [rad/s].
        stop: Largest rate [rad/s]: what asks for more drives towards it as if there were none.
        deadband: Commands below it move nothing [rad/s].
        reverse: Gain of a command below 0, by the other [1].
        friction: What every command lacks of its magnitude [rad/s].
        braking: Time constant of a rate that falls, by the other [1].
    """

    gain: float = 0.95
    dead_time_s: float = 0.07
    lag_s: float = 0.1
    acceleration: float = math.inf
    ramp: float = math.inf
    bound: float = math.inf
    stop: float = math.inf
    deadband: float = 0.0
    reverse: float = 1.0
    friction: float = 0.0
    braking: float = 1.0

    def ask(self, command: float) -> float:
        """Return the rate that a command asks for [rad/s]."""
        if abs(command) < self.deadband:
            return 0.0
        command = math.copysign(max(abs(command) - self.friction, 0.0), command)
        rate = self.gain * command * (self.reverse if command < 0.0 else 1.0)
        return min(max(rate, -self.bound), self.bound)

    def delay(self, time_s: Values) -> Values:
        """Return when commands act."""
        return np.asarray(time_s + self.dead_time_s)

    def build(self) -> "LimitedRobot":
        """Return the robot at rest."""
        return LimitedRobot(self)

    def list_truth(self) -> dict[str, float]:
        """Return the true values by the names of the model's fields."""
        return {
            "gain": self.gain,
            "dead_time_s": self.dead_time_s,
            "lag_s": self.lag_s,
            "total_delay_s": self.dead_time_s + self.lag_s,
            "rate_limit": min(self.acceleration, self.ramp),
            "bound": min(self.bound, self.stop),
            "deadband": self.deadband,
            "friction": self.friction,
            "reverse_gain": self.gain * self.reverse,
        }


@dataclass(slots=True)
class LimitedRobot:
    """One, on the spot: it holds what was asked, and moves to any later time exactly."""

    truth: Limited
    heading_rad: float = 0.0
    rate: float = 0.0
    asked: float = 0.0
    ramped: float = 0.0

    def move(self, duration_s: float) -> None:
        """Let a time pass without a command."""
        while duration_s > 0.0:
            duration_s -= self._move_piece(duration_s)

    def _move_piece(self, most_s: float) -> float:
        """Move until the slope is of another kind; return the time that took [s]."""
        lag_s, most = self.truth.lag_s, self.truth.acceleration
        if abs(self.asked) < abs(self.rate):
            lag_s *= self.truth.braking
        slope, most_s = self._ramp(most_s)
        before = self.rate
        off = self.ramped - before
        most_rate = math.copysign(self.truth.stop, off)
        if before == most_rate:
            self.heading_rad += before * most_s
            return most_s
        if abs(self.ramped) > self.truth.stop and self.ramped * off > 0.0:
            most_s = min(most_s, self._find_stop(off, most_rate, lag_s))
        if abs(off) > most * lag_s * (1.0 + 1e-12):
            took_s = min(most_s, abs(off) / most - lag_s)
            self.rate += math.copysign(most, off) * took_s
            self.heading_rad += 0.5 * (before + self.rate) * took_s
        else:
            took_s = most_s
            late = self.ramped - lag_s * slope
            left = before - late
            faded = math.exp(-took_s / lag_s)
            self.rate = late + slope * took_s + left * faded
            self.heading_rad += (late + 0.5 * slope * took_s) * took_s
            self.heading_rad += lag_s * left * (1.0 - faded)
        if abs(self.rate) > self.truth.stop * (1.0 - 1e-12):
            self.rate = most_rate
        self.ramped += slope * took_s
        return took_s

    def _ramp(self, most_s: float) -> tuple[float, float]:
        """Return how fast the asked rate changes, and for how long at most [s]."""
        ahead = self.asked - self.ramped
        if math.isinf(self.truth.ramp) or abs(ahead) < 1e-12:
            self.ramped = self.asked
            return 0.0, most_s
        return math.copysign(self.truth.ramp, ahead), min(most_s, abs(ahead) / self.truth.ramp)

    def _find_stop(self, off: float, most_rate: float, lag_s: float) -> float:
        """Return when the rate is at its largest, by the kind of slope that it has now [s]."""
        if abs(off) > self.truth.acceleration * lag_s * (1.0 + 1e-12):
            return abs(most_rate - self.rate) / self.truth.acceleration
        return lag_s * math.log(off / (self.ramped - most_rate))


def turn_on_the_spot(truth: Limited, log: Log, seed: int) -> Run:
    """Return the run of such a robot, driven by random steps of up to 1.5 rad/s."""
    rng = np.random.default_rng(seed)
    time_s, turns = draw_steps(rng, log, 1.5)
    true_s = np.arange(0.0, log.duration_s, 1.0 / log.poses_hz)
    heading = find_headings(truth, time_s, turns, true_s)
    seen = wrap(heading + rng.normal(0.0, log.noise_rad, len(true_s)))
    xy_m = rng.normal(0.0, log.noise_m, (len(true_s), 2))
    seen_s = np.maximum(true_s + rng.normal(0.0, log.jitter_s, len(true_s)), 0.0)
    order = np.argsort(seen_s, kind="stable")
    return build_run(seen_s[order], xy_m[order], seen[order], (time_s, 0.0 * turns, turns))


def find_headings(truth: Limited, time_s: Values, turns: Values, at_s: Values) -> Values:
    """Return the heading at some times, after commands [rad]."""
    robot = truth.build()
    acts_s = truth.delay(time_s)
    events = sorted(
        [(now_s, 0, value) for now_s, value in zip(acts_s.tolist(), turns.tolist(), strict=True)]
        + [(now_s, 1, 0.0) for now_s in at_s.tolist()]
    )
    found, before_s = [], 0.0
    for now_s, is_pose, value in events:
        robot.move(now_s - before_s)
        before_s = now_s
        if is_pose:
            found.append(robot.heading_rad)
        else:
            robot.asked = truth.ask(value)
    return np.array(found)


def turn_by(truth: Limited, angle_rad: float, kp: float, period_s: float, limit: float) -> float:
    """Return by how much P control overshoots a turn [%]; its commands end at a limit [rad/s]."""
    robot, waiting = truth.build(), list[tuple[float, float]]()
    largest = now_s = 0.0
    for tick in range(round(12.0 / period_s)):
        tick_s = tick * period_s
        while waiting and waiting[0][0] <= tick_s:
            acts_s, command = waiting.pop(0)
            robot.move(acts_s - now_s)
            now_s = acts_s
            robot.asked = truth.ask(command)
        robot.move(tick_s - now_s)
        now_s = tick_s
        largest = max(largest, robot.heading_rad)
        command = min(max(kp * (angle_rad - robot.heading_rad), -limit), limit)
        waiting.append((tick_s + truth.dead_time_s, command))
    return 100.0 * max(largest / angle_rad - 1.0, 0.0)


def turn_as_advised(model: tl.RobotModel, run: Run, truth: Limited) -> list[float]:
    """Return by how much a small and a large turn overshoot by the gain for 5 % [%]."""
    scenario = build_robot_scenario(model, run).scenario
    declaration = tl.simulate.declare_scenario(scenario)
    loops = tl.theory.model_loops(declaration, tl.scenario.flatten_scenario(scenario))
    loop = next(loop for loop in loops if loop.loop.name == "rotate")
    # Here a controller reads poses without any age, so the most dead time would be too cautious.
    settings = replace(loop, most_dead_time_s=None).require_latest()
    period_s = settings["period_s"]
    advised = recommend_gains(
        settings["process"], period_s=period_s, overshoot_percent=5.0, limits=loop.limits
    )
    kp = next(one.gains.kp for one in advised if one.controller == "P" and one.gains)
    most = min(float(np.abs(run.commands.turn_rate_rad_s).max()), scenario.limits.turn_rate_rad_s)
    return [turn_by(truth, angle_rad, kp, period_s, most) for angle_rad in TURNS_RAD]


def _draw(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.uniform(low, high))


KINDS: Final = MappingProxyType[str, Callable[[Limited, np.random.Generator], Limited]](
    {
        "first order": lambda truth, _: truth,
        "acceleration": lambda truth, rng: replace(truth, acceleration=_draw(rng, 1.5, 5.0)),
        "ramp before": lambda truth, rng: replace(truth, ramp=_draw(rng, 1.5, 5.0)),
        "bound": lambda truth, rng: replace(truth, bound=truth.gain * _draw(rng, 0.5, 1.2)),
        "both": lambda truth, rng: replace(
            truth, acceleration=_draw(rng, 1.5, 5.0), bound=truth.gain * _draw(rng, 0.5, 1.2)
        ),
        "stop": lambda truth, rng: replace(truth, stop=truth.gain * _draw(rng, 0.5, 1.2)),
        "deadband": lambda truth, rng: replace(truth, deadband=_draw(rng, 0.1, 0.4)),
        "direction": lambda truth, rng: replace(truth, reverse=_draw(rng, 0.75, 0.92)),
        # No structure that is fitted is like these.
        "friction": lambda truth, rng: replace(truth, friction=_draw(rng, 0.1, 0.3)),
        "braking": lambda truth, rng: replace(truth, braking=_draw(rng, 0.4, 0.7)),
    }
)
"""What limits a robot, drawn at random."""


def draw_robot(kind: str, seed: int) -> tuple[Limited, Log]:
    """Return a robot of a kind, and how it is recorded."""
    rng = np.random.default_rng([seed, 46])
    truth = Limited(
        gain=_draw(rng, 0.8, 1.1), dead_time_s=_draw(rng, 0.03, 0.12), lag_s=_draw(rng, 0.05, 0.25)
    )
    log = Log(
        duration_s=40.0,
        poses_hz=_draw(rng, 20.0, 50.0),
        noise_rad=5e-4 * 10.0 ** _draw(rng, -0.7, 0.7),
        jitter_s=_draw(rng, 0.0, 2e-3),
    )
    return KINDS[kind](truth, rng), log
