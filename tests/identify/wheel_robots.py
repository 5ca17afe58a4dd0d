"""Robots whose wheels limit both axes together, of known truth: two `LimitedRobot`s as wheels."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final

import numpy as np

from tests.identify.limited_robots import Limited, LimitedRobot
from tests.identify.robots import Log, Values, build_run, draw_steps, wrap
from turtlelog.identify import AxisModel
from turtlelog.run import Run

_PIECE_S: Final = 2e-3
"""Duration of an arc of the way [s]: at 3 rad/s and 3 m/s^2 it is off by 1e-8 m."""

LARGEST: Final = (0.5, 2.0)
"""Largest commands [m/s] and [rad/s]: wheels of up to 0.8 m/s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wheeled:
    """A robot with two wheels, each with the dead time, time constant and acceleration of `wheel`.

    Attributes:
        wheel: Its gain is that of the speed; the bound is not used.
        turn_gain: Gain of the turn rate [1].
        track_m: Distance of the wheels [m].
        most: Largest commanded speed of a wheel [m/s].
        coupling: What happens to a command beyond: `scaled` scales both axes alike, `clipped`
            clips each wheel, `turning` keeps the turn rate and `driving` keeps the speed.
    """

    wheel: Limited
    turn_gain: float
    track_m: float
    most: float = np.inf
    coupling: str = "scaled"

    def ask(self, speed: float, turn_rate: float) -> tuple[float, float]:
        """Return the speed [m/s] and the turn rate [rad/s] that remain of a command."""
        most, turn = self.most, 0.5 * self.track_m * turn_rate  # of a wheel [m/s]
        if self.coupling == "scaled":
            share = min(1.0, most / max(abs(speed) + abs(turn), 1e-12))
            speed, turn = share * speed, share * turn
        elif self.coupling == "clipped":
            left, right = (float(np.clip(one, -most, most)) for one in (speed - turn, speed + turn))
            speed, turn = 0.5 * (left + right), 0.5 * (right - left)
        elif self.coupling == "turning":
            turn = float(np.clip(turn, -most, most))
            speed = float(np.clip(speed, abs(turn) - most, most - abs(turn)))
        else:
            speed = float(np.clip(speed, -most, most))
            turn = float(np.clip(turn, abs(speed) - most, most - abs(speed)))
        return speed, turn / (0.5 * self.track_m)

    def drive(self, time_s: Values, commands: tuple[Values, Values], at_s: Values) -> Values:
        """Return x [m], y [m] and heading [rad] at some times, shape (n, 3)."""
        ratio = self.turn_gain / self.wheel.gain
        wheels = LimitedRobot(self.wheel), LimitedRobot(self.wheel)
        changes = np.flatnonzero(
            np.diff(commands[0], prepend=0) + 1j * np.diff(commands[1], prepend=0)
        )
        acts_s = time_s[changes] + self.wheel.dead_time_s
        asked = iter(
            [self.ask(float(commands[0][row]), float(commands[1][row])) for row in changes]
        )
        bounds = np.unique(np.concatenate([acts_s, at_s, np.arange(0.0, at_s[-1], _PIECE_S)]))
        acts, seen = set(acts_s.tolist()), set(at_s.tolist())
        found, x_m, y_m, heading, now_s = [], 0.0, 0.0, 0.0, 0.0
        for next_s in bounds[bounds <= at_s[-1]].tolist():
            before = [wheel.heading_rad for wheel in wheels]
            for wheel in wheels:
                wheel.move(next_s - now_s)
            left, right = (
                wheel.heading_rad - start for wheel, start in zip(wheels, before, strict=True)
            )
            turned = ratio * (right - left) / self.track_m
            x_m += 0.5 * (left + right) * np.cos(heading + 0.5 * turned)
            y_m += 0.5 * (left + right) * np.sin(heading + 0.5 * turned)
            heading, now_s = heading + turned, next_s
            if next_s in seen:
                found.append((x_m, y_m, heading))
            if next_s in acts:
                speed, turn_rate = next(asked)
                for wheel, sign in zip(wheels, (-1.0, 1.0), strict=True):
                    wheel.asked = self.wheel.gain * (speed + sign * 0.5 * self.track_m * turn_rate)
        return np.array(found)

    def list_truth(self, axis: AxisModel) -> dict[str, float]:
        """Return the true values of an axis by the names of its model's fields."""
        wheel = self.wheel
        is_speed = axis.axis == "speed"
        gain = wheel.gain if is_speed else self.turn_gain
        arm_m, acceleration = 0.5 * self.track_m, wheel.acceleration / wheel.gain
        own, other = (1.0, arm_m) if is_speed else (arm_m, 1.0)
        return {
            "gain": gain,
            "dead_time_s": wheel.dead_time_s,
            "lag_s": wheel.lag_s,
            "total_delay_s": wheel.dead_time_s + wheel.lag_s,
            "bound": gain * self.most / own,
            "bound_beside": self.most / other,
            "rate_limit": gain * acceleration / own,
            "rate_limit_beside": acceleration / other,
        }


def drive_wheels(truth: Wheeled, log: Log, seed: int) -> Run:
    """Return the run of such a robot, driven by random steps on both axes."""
    rng = np.random.default_rng(seed)
    time_s, speeds = draw_steps(rng, log, LARGEST[0])
    turns = draw_steps(rng, log, LARGEST[1])[1]
    at_s = np.arange(0.0, log.duration_s, 1.0 / log.poses_hz)
    poses = truth.drive(time_s, (speeds, turns), at_s)
    xy_m = poses[:, :2] + rng.normal(0.0, log.noise_m, (len(poses), 2))
    heading_rad = wrap(poses[:, 2] + rng.normal(0.0, log.noise_rad, len(poses)))
    seen_s = np.maximum(at_s + rng.normal(0.0, log.jitter_s, len(at_s)), 0.0)
    order = np.argsort(seen_s, kind="stable")
    return build_run(seen_s[order], xy_m[order], heading_rad[order], (time_s, speeds, turns))


def _bound(coupling: str) -> Callable[[Wheeled, np.random.Generator], Wheeled]:
    return lambda truth, rng: replace(truth, most=float(rng.uniform(0.25, 0.5)), coupling=coupling)


def _limit(truth: Wheeled, rng: np.random.Generator) -> Wheeled:
    return replace(truth, wheel=replace(truth.wheel, acceleration=float(rng.uniform(0.5, 2.0))))


KINDS: Final = MappingProxyType[str, Callable[[Wheeled, np.random.Generator], Wheeled]](
    {
        "free wheels": lambda truth, _: truth,
        "scaled": _bound("scaled"),
        "clipped": _bound("clipped"),
        "turning": _bound("turning"),
        "driving": _bound("driving"),
        "wheel accel.": _limit,
    }
)
"""What limits the wheels, drawn at random."""


def draw_robot(kind: str, seed: int) -> tuple[Wheeled, Log]:
    """Return a robot of a kind, and how it is recorded."""
    rng = np.random.default_rng([seed, 83])
    gain, turn_gain, dead_time_s, lag_s, track_m = (
        float(rng.uniform(*ends))
        for ends in ((0.8, 1.1), (0.8, 1.1), (0.03, 0.12), (0.05, 0.25), (0.2, 0.4))
    )
    truth = Wheeled(
        wheel=Limited(gain=gain, dead_time_s=dead_time_s, lag_s=lag_s),
        turn_gain=turn_gain,
        track_m=track_m,
    )
    noise = 10.0 ** float(rng.uniform(-0.7, 0.7))
    log = Log(
        duration_s=40.0,
        poses_hz=float(rng.uniform(20.0, 50.0)),
        noise_m=2e-4 * noise,
        noise_rad=5e-4 * noise,
        jitter_s=float(rng.uniform(0.0, 2e-3)),
    )
    return KINDS[kind](truth, rng), log
