"""Robots of known noise beside their identified models: is noise that doubled or halved told?

python benchmarks/noise_truth.py [--robots 15] [--seed N] [--duration SECONDS]

A robot with noise of its rates, of its poses, or of both is identified from one log. A second log
has half, the same or twice the noise; or the same noise and another gain, dead time or lag. Prints
of how many robots each is called noisier or quieter.
"""

import argparse
import sys
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.identify.robots import Log, Truth
from tests.identify.test_robot_scenario import LOG, build, drive_with_noise
from turtlelog.compare import compare_robot

CHANGES: dict[str, tuple[float, dict[str, float]]] = {
    "half the noise": (0.5, {}),
    "the same": (1.0, {}),
    "twice the noise": (2.0, {}),
    "gain -10 %": (1.0, {"gain": 0.9}),
    "dead time +40 ms": (1.0, {"dead_time_s": 0.04}),
    "lag doubled": (1.0, {"lag_s": 2.0}),
}
"""The second log: times the noise, and what of both axes is another (a dead time is added)."""


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, default=15)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--duration", type=float, default=60.0)
    asked = parser.parse_args()
    began_s = time.process_time()
    told: dict[str, Counter[str]] = {name: Counter() for name in CHANGES}
    for seed in range(asked.seed, asked.seed + asked.robots):
        for name, level in judge_robot(seed, asked.duration).items():
            told[name][level] += 1
    print(f"{asked.robots} robots, two logs of {asked.duration:g} s, seeds from {asked.seed} on")
    print(f"{'second log':18}{'quieter':>9}{'no word':>9}{'noisier':>9}")
    for name, levels in told.items():
        counts = (levels[level] for level in ("quieter", "as simulated", "noisier"))
        print(f"{name:18}", *(f"{count:8}" for count in counts))
    print(f"{time.process_time() - began_s:.0f} s of processor time")


def judge_robot(seed: int, duration_s: float) -> dict[str, str]:
    """Return what is said of each second log of a robot."""
    rng = np.random.default_rng([seed, 77])
    log = replace(
        LOG,
        poses_hz=float(rng.choice([10.0, 20.0, 50.0])),
        speed=draw_axis(rng),
        turn_rate=draw_axis(rng),
        duration_s=duration_s,
    )
    kind = seed % 3
    rates = (kind != 1) * np.array([rng.uniform(0.003, 0.02), rng.uniform(0.005, 0.05)])
    poses = (kind != 2) * np.array([rng.uniform(2e-4, 2e-3), rng.uniform(5e-4, 5e-3)])
    first = drive_with_noise(seed, rates=tuple(rates), sensing=tuple(poses), log=log)
    scenario = build(first).scenario
    found: dict[str, str] = {}
    for name, (times, changes) in CHANGES.items():
        second = drive_with_noise(
            100_000 + seed,
            rates=tuple(times * rates),
            sensing=tuple(times * poses),
            log=change_axes(log, changes),
        )
        levels = {level.level for level in compare_robot(second, scenario).noise}
        said = levels - {"as simulated"}
        found[name] = said.pop() if len(said) == 1 else "as simulated"
    return found


def draw_axis(rng: np.random.Generator) -> Truth:
    """Return an axis of a usual robot."""
    return Truth(
        gain=rng.uniform(0.8, 1.1),
        dead_time_s=rng.uniform(0.03, 0.15),
        lag_s=rng.uniform(0.05, 0.2),
    )


def change_axes(log: Log, changes: dict[str, float]) -> Log:
    """Return the log of another robot."""

    def change(axis: Truth) -> Truth:
        values = {
            name: getattr(axis, name) + by if name == "dead_time_s" else getattr(axis, name) * by
            for name, by in changes.items()
        }
        return replace(axis, **values)

    return replace(log, speed=change(log.speed), turn_rate=change(log.turn_rate))


if __name__ == "__main__":
    main()
