"""Pairs of logs of robots whose difference is known."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final

import numpy as np

from tests.identify.limited_robots import Limited, find_headings
from tests.identify.robots import Log, build_run, draw_steps, wrap
from turtlelog.run import Run

LOG: Final = Log(duration_s=30.0, poses_hz=30.0, commands_hz=20.0)

CHANGES: Final[Mapping[str, Callable[[Limited], Limited]]] = MappingProxyType(
    {
        "dead time": lambda robot: replace(robot, dead_time_s=robot.dead_time_s + 0.04),
        "gain": lambda robot: replace(robot, gain=0.9 * robot.gain),
        "limits": lambda robot: replace(robot, bound=0.6 * robot.bound),
        "noise": lambda robot: robot,
    }
)
"""What the second robot has otherwise than the first, by the part that it is; noise: nothing.

With half of the limit, no positive command of the log is below it, and the gain is not shown."""

METRICS: Final[Mapping[str, str]] = MappingProxyType(
    {
        part: "run.total_turning" if part == "gain" else "run.turn_rate_tracking_rms"
        for part in CHANGES
    }
)
"""What changes with each part. The tracking error is alike a little above and below a gain of 1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotPair:
    """Two logs, and the part in which the robots differ."""

    first: Run
    second: Run
    part: str


def draw_robot_pair(part: str, seed: int, *, has_same_commands: bool) -> RobotPair:
    """Return a pair of turning robots that differ in a part, driven by random steps."""
    rng = np.random.default_rng([seed, *part.encode()])
    robot = Limited(
        gain=float(rng.uniform(0.8, 1.1)),
        dead_time_s=0.07,
        lag_s=float(rng.uniform(0.05, 0.2)),
        bound=float(rng.uniform(1.0, 1.4)),
    )
    seeds = rng.integers(2**31, size=4).tolist()
    return RobotPair(
        first=_record(robot, seeds[0], seeds[1], "first"),
        second=_record(
            CHANGES[part](robot), seeds[0 if has_same_commands else 2], seeds[3], "second"
        ),
        part=part,
    )


def _record(robot: Limited, command_seed: int, noise_seed: int, name: str) -> Run:
    """Return the log of a robot on the spot; its noise does not depend on the commands."""
    time_s, turns = draw_steps(np.random.default_rng(command_seed), LOG, 1.5)
    rng = np.random.default_rng(noise_seed)
    true_s = np.arange(0.0, LOG.duration_s, 1.0 / LOG.poses_hz)
    heading = find_headings(robot, time_s, turns, true_s)
    seen = wrap(heading + rng.normal(0.0, LOG.noise_rad, len(true_s)))
    xy_m = rng.normal(0.0, LOG.noise_m, (len(true_s), 2))
    seen_s = np.maximum.accumulate(true_s + rng.uniform(0.0, LOG.jitter_s, len(true_s)))
    return replace(build_run(seen_s, xy_m, seen, (time_s, 0.0 * turns, turns)), name=name)
