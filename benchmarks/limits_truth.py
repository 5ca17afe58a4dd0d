"""Robots with limits through the identification: do intervals hold, does its advice overshoot?

python benchmarks/limits_truth.py [--robots 30] [--seed N] [--kind KIND ...] [--all]
    [--noise TIMES] [--duration SECONDS]

Prints per kind of robot how many are refused and doubted, the coverage of each interval, the median
error of the total delay, and how often P control by the recommended gain for 5 % overshoots a small
and a large turn of the true robot by at most 6 %; with --all each robot in a line of its own.
"""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import turtlelog as tl
from tests.identify.limited_robots import (
    KINDS,
    Limited,
    draw_robot,
    turn_as_advised,
    turn_on_the_spot,
)
from turtlelog.identify import AxisModel

NAMES = (
    "gain",
    "dead_time_s",
    "lag_s",
    "total_delay_s",
    "rate_limit",
    "bound",
    "reverse_gain",
    "friction",
)
"""Whose intervals are counted."""


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", nargs="*", default=[*KINDS])
    parser.add_argument("--all", action="store_true")
    parser.add_argument("--noise", type=float, default=1.0, help="times the usual noise")
    parser.add_argument("--duration", type=float, default=40.0)
    asked = parser.parse_args()
    began_s = time.process_time()
    print(f"{asked.robots} robots of each kind, seeds from {asked.seed} on; % of intervals hold")
    print(
        f"{'kind':13}{'refused':>8}{'doubted':>8}",
        *(f"{name:>13}" for name in NAMES),
        "  error",
        "P<=6%",
    )
    for kind in asked.kind:
        seeds = range(asked.seed, asked.seed + asked.robots)
        show(kind, seeds, asked.noise, asked.duration, shows_all=asked.all)
    print(f"{time.process_time() - began_s:.1f} s of processor time")


def show(kind: str, seeds: range, noise: float, duration_s: float, *, shows_all: bool) -> None:
    """Print the row of a kind."""
    held: dict[str, list[bool]] = {name: [] for name in NAMES}
    errors, fine, refused, doubted = [], [], 0, 0
    for seed in seeds:
        truth, log = draw_robot(kind, seed)
        log = replace(log, noise_rad=noise * log.noise_rad, duration_s=duration_s)
        run = turn_on_the_spot(truth, log, seed)
        model = tl.identify_robot(run)
        axis = model.turn_rate
        if not axis.is_known:
            refused += 1
        doubted += bool(axis.doubts)
        said = judge(axis, truth)
        for name, (holds, _) in said.items():
            held[name].append(holds)
        if axis.total_delay_s is not None:
            errors.append(abs(axis.total_delay_s.value - truth.dead_time_s - truth.lag_s))
        overshoots = turn_as_advised(model, run, truth) if axis.is_known else None
        if overshoots is not None:
            fine.append(max(overshoots) <= 6.0)
        if shows_all:
            print(seed, truth)
            print("   ", *(f"{name} {text}" for name, (_, text) in said.items()), axis.reason)
            print("    overshoot", overshoots, *model.notes)
    shares = [
        f"{100.0 * np.mean(one):8.0f}/{len(one):<4}" if one else 13 * " " for one in held.values()
    ]
    error = f"{1e3 * np.median(errors):7.1f}" if errors else "      -"
    print(
        f"{kind:13}{refused:8}{doubted:8}",
        *shares,
        error,
        f"{np.sum(fine):.0f}/{len(fine)}",
        flush=True,
    )


def judge(axis: AxisModel, truth: Limited) -> dict[str, tuple[bool, str]]:
    """Return which intervals hold the truth, and what they are."""
    true = {
        "gain": truth.gain,
        "dead_time_s": truth.dead_time_s,
        "lag_s": truth.lag_s,
        "total_delay_s": truth.dead_time_s + truth.lag_s,
        "rate_limit": min(truth.acceleration, truth.ramp),
        "bound": min(truth.bound, truth.stop),
        "friction": truth.friction,
        "reverse_gain": truth.gain * truth.reverse,
    }
    said = {}
    for name, value in true.items():
        found = getattr(axis, name, None)
        if found is not None:
            mark = "" if found.low <= value <= found.high else "!"
            said[name] = (not mark, f"{mark}{found!r}")
    return said


if __name__ == "__main__":
    main()
