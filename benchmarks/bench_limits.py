"""Robots with limits through the identification: do intervals hold, does its advice overshoot?

python benchmarks/bench_limits.py [--robots 30] [--seed N] [--kind KIND ...] [--all]

Prints per kind of robot how many are refused, the coverage of each interval, the median error of
the total delay, and how often P control by the recommended gain for 5 % overshoots a small and a
large turn of the true robot by at most 6 %; with --all each robot in a line of its own.
"""

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

import turtlelog as tl
from tests.identify.limited_robots import KINDS, Limited, draw_robot, turn_by, turn_on_the_spot
from turtlelog.errors import TurtlelogError
from turtlelog.identify import AxisModel, build_robot_scenario
from turtlelog.theory import recommend_gains

TURNS_RAD = (0.3, 2.5)
"""A small and a large turn."""

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
    asked = parser.parse_args()
    began_s = time.process_time()
    print(f"{asked.robots} robots of each kind, seeds from {asked.seed} on; % of intervals hold")
    print(f"{'kind':13}{'refused':>8}", *(f"{name:>13}" for name in NAMES), "  error", "P<=6%")
    for kind in asked.kind:
        show(kind, range(asked.seed, asked.seed + asked.robots), shows_all=asked.all)
    print(f"{time.process_time() - began_s:.1f} s of processor time")


def show(kind: str, seeds: range, *, shows_all: bool) -> None:
    """Print the row of a kind."""
    held: dict[str, list[bool]] = {name: [] for name in NAMES}
    errors, fine, refused = [], [], 0
    for seed in seeds:
        truth, log = draw_robot(kind, seed)
        run = turn_on_the_spot(truth, log, seed)
        model = tl.identify_robot(run)
        axis = model.turn_rate
        if not axis.is_known:
            refused += 1
        said = judge(axis, truth)
        for name, (holds, _) in said.items():
            held[name].append(holds)
        if axis.total_delay_s is not None:
            errors.append(abs(axis.total_delay_s.value - truth.dead_time_s - truth.lag_s))
        overshoots = advise(model, run, truth) if axis.is_known else None
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
    print(f"{kind:13}{refused:8}", *shares, error, f"{np.sum(fine):.0f}/{len(fine)}", flush=True)


def judge(axis: AxisModel, truth: Limited) -> dict[str, tuple[bool, str]]:
    """Return which intervals hold the truth, and what they are."""
    true = {
        "gain": truth.gain,
        "dead_time_s": truth.dead_time_s,
        "lag_s": truth.lag_s,
        "total_delay_s": truth.dead_time_s + truth.lag_s,
        "rate_limit": min(truth.acceleration, truth.ramp),
        "bound": truth.bound,
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


def advise(model: tl.RobotModel, run: tl.run.Run, truth: Limited) -> list[float] | None:
    """Return by how much P control by the advice overshoots turns of the true robot [%]."""
    try:
        scenario = build_robot_scenario(model, run).scenario
    except TurtlelogError:
        return None
    declaration = tl.simulate.declare_scenario(scenario)
    loops = tl.theory.model_loops(declaration, tl.scenario.flatten_scenario(scenario))
    settings = next(loop for loop in loops if loop.loop.name == "rotate").require()[1]
    period_s = settings["period_s"]
    recommended = recommend_gains(settings["process"], period_s=period_s, overshoot_percent=5.0)
    kp = next(one.gains.kp for one in recommended if one.controller == "P" and one.gains)
    most = min(float(np.abs(run.commands.turn_rate_rad_s).max()), scenario.limits.turn_rate_rad_s)
    return [turn_by(truth, angle_rad, kp, period_s, most) for angle_rad in TURNS_RAD]


if __name__ == "__main__":
    main()
