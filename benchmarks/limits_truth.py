"""Robots with limits through the identification: do intervals hold, does its advice overshoot?

python benchmarks/limits_truth.py [--plant | --wheels] [--robots 30] [--seed N] [--kind KIND ...]
    [--all] [--noise TIMES] [--duration SECONDS]

The robots are those of an independent simulation, which turn on the spot; with --wheels those of
another, whose wheels limit both axes together; with --plant those of the simulator's own plant,
with limits on both axes.

Prints per kind of robot how many axes are refused and doubted, the coverage of each interval, the
median error of the total delay, and how often P control by the recommended gain for 5 % overshoots
a small and a large turn of the true robot by at most 6 %; with --all each robot, too.
"""

import argparse
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import turtlelog as tl
from tests.identify import limited_robots, plant_robots, strange_robots, wheel_robots
from turtlelog.identify import AxisModel

NAMES = (
    *("gain", "dead_time_s", "lag_s", "total_delay_s"),
    *("rate_limit", "rate_limit_beside", "bound", "bound_beside"),
    *("deadband", "reverse_gain", "friction"),
)
"""Whose intervals are counted."""


@dataclass(frozen=True)
class Identified:
    """A robot with what was found of it.

    Attributes:
        text: The robot.
        axes: Each axis with its true values by name.
        overshoots: Of a small and a large turn by the advice [%]; empty where there is none.
        notes: Of the identification.
    """

    text: str
    axes: Sequence[tuple[AxisModel, dict[str, float]]]
    overshoots: list[float]
    notes: Sequence[str]


@dataclass
class Row:
    """The counts of a kind of robot."""

    refused: int = 0
    doubted: int = 0
    held: dict[str, list[bool]] = field(default_factory=lambda: {name: [] for name in NAMES})
    errors: list[float] = field(default_factory=list)
    fine: list[bool] = field(default_factory=list)

    def add(self, one: Identified) -> None:
        """Count a robot."""
        for axis, truth in one.axes:
            self.refused += not axis.is_known
            self.doubted += bool(axis.doubts)
            for name, (holds, _) in judge(axis, truth).items():
                self.held[name].append(holds)
            if axis.total_delay_s is not None:
                self.errors.append(abs(axis.total_delay_s.value - truth["total_delay_s"]))
        if one.overshoots:
            self.fine.append(max(one.overshoots) <= 6.0)

    def show(self, kind: str) -> None:
        """Print the row."""
        shares = [
            f"{100.0 * np.mean(one):8.0f}/{len(one):<4}" if one else 13 * " "
            for one in self.held.values()
        ]
        error = f"{1e3 * np.median(self.errors):7.1f}" if self.errors else "      -"
        fine = f"{np.sum(self.fine):.0f}/{len(self.fine)}"
        print(f"{kind:13}{self.refused:8}{self.doubted:8}", *shares, error, fine, flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plant", action="store_true", help="robots of the simulator's own plant")
    parser.add_argument("--wheels", action="store_true", help="robots with limited wheels")
    parser.add_argument("--robots", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", nargs="*")
    parser.add_argument("--all", action="store_true")
    parser.add_argument("--noise", type=float, default=1.0, help="times the usual noise")
    parser.add_argument("--duration", type=float, default=40.0)
    asked = parser.parse_args()
    began_s = time.process_time()
    print(f"{asked.robots} robots of each kind, seeds from {asked.seed} on; % of intervals hold")
    heads = f"{'kind':13}{'refused':>8}{'doubted':>8}"
    print(heads, *(f"{name:>13}" for name in NAMES), "  error", "P<=6%")
    known = [*limited_robots.KINDS, *strange_robots.KINDS]
    known = [*wheel_robots.KINDS] if asked.wheels else known
    known = [*plant_robots.KINDS] if asked.plant else known
    for kind in asked.kind or known:
        row = Row()
        for one in identify_robots(kind, asked):
            row.add(one)
            if asked.all:
                show_robot(one)
        row.show(kind)
    print(f"{time.process_time() - began_s:.1f} s of processor time")


def identify_robots(kind: str, asked: argparse.Namespace) -> Iterator[Identified]:
    """Yield the robots of a kind."""
    identify = identify_wheels if asked.wheels else identify_limited
    identify = identify_plant if asked.plant else identify
    for seed in range(asked.seed, asked.seed + asked.robots):
        yield identify(kind, seed, asked.noise, asked.duration)


def identify_limited(kind: str, seed: int, noise: float, duration_s: float) -> Identified:
    """Identify a robot of the independent simulation."""
    drawn = limited_robots if kind in limited_robots.KINDS else strange_robots
    truth, log = drawn.draw_robot(kind, seed)
    log = replace(log, noise_rad=noise * log.noise_rad, duration_s=duration_s)
    run = limited_robots.turn_on_the_spot(truth, log, seed)
    model = tl.identify_robot(run)
    known = model.turn_rate.is_known
    overshoots = limited_robots.turn_as_advised(model, run, truth) if known else []
    return Identified(
        f"{seed} {truth}", [(model.turn_rate, truth.list_truth())], overshoots, model.notes
    )


def identify_plant(kind: str, seed: int, noise: float, duration_s: float) -> Identified:
    """Identify a robot of the simulator's plant."""
    keys, log = plant_robots.draw_robot(kind, seed)
    log = replace(
        log,
        noise_rad=noise * log.noise_rad,
        noise_m=noise * log.noise_m,
        duration_s=duration_s,
    )
    run = plant_robots.drive_robot(keys, log, seed)
    model = tl.identify_robot(run)
    known = all(axis.is_known for axis in model.axes)
    overshoots = plant_robots.turn_as_advised(model, run, keys) if known else []
    axes = [(axis, plant_robots.list_truth(keys, axis)) for axis in model.axes]
    return Identified(f"{seed} {keys}", axes, overshoots, model.notes)


def identify_wheels(kind: str, seed: int, noise: float, duration_s: float) -> Identified:
    """Identify a robot whose wheels limit both axes together."""
    truth, log = wheel_robots.draw_robot(kind, seed)
    log = replace(
        log, noise_rad=noise * log.noise_rad, noise_m=noise * log.noise_m, duration_s=duration_s
    )
    run = wheel_robots.drive_wheels(truth, log, seed)
    model = tl.identify_robot(run)
    spot = replace(
        truth.wheel, gain=truth.turn_gain, bound=truth.list_truth(model.turn_rate)["bound"]
    )
    spot = replace(
        spot,
        acceleration=spot.acceleration * 2 * truth.turn_gain / truth.wheel.gain / truth.track_m,
    )
    known = all(axis.is_known for axis in model.axes)
    overshoots = limited_robots.turn_as_advised(model, run, spot) if known else []
    axes = [(axis, truth.list_truth(axis)) for axis in model.axes]
    return Identified(f"{seed} {truth}", axes, overshoots, model.notes)


def judge(axis: AxisModel, truth: dict[str, float]) -> dict[str, tuple[bool, str]]:
    """Return which intervals hold the truth, and what they are; a limit that is none does not."""
    said = {}
    for name in NAMES:
        found = getattr(axis, name, None)
        if found is not None:
            holds = name in truth and found.low <= truth[name] <= found.high
            said[name] = (holds, f"{'' if holds else '!'}{found!r}")
    return said


def show_robot(one: Identified) -> None:
    """Print what was found of a robot."""
    print(one.text)
    for axis, truth in one.axes:
        said = judge(axis, truth).items()
        print("   ", axis.axis, *(f"{name} {text}" for name, (_, text) in said), axis.reason)
    print("    overshoot", one.overshoots, *one.notes)


if __name__ == "__main__":
    main()
