"""How true `compare --why` is: fresh pairs of scenarios whose changes are known.

python benchmarks/difference_truth.py [--pairs 500] [--noisy 0.04] [--robots 60] [--seed N]

Each pair differs in one to six groups of keys: laws, plants, effects, goals, starts, noise. The
contributions must add up to the difference, to 1e-9, and each must be the Shapley value that brute
force finds. Then pairs that differ by their noise alone: no cause may be named. Last pairs of
robots' logs, whose dead time, gain or bound differs, or nothing: the part must be named, and no
other one.
"""

import argparse
import math
import random
import sys
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import turtlelog as tl
from tests.explain.changed_pairs import Pair, draw_pair
from tests.explain.robot_pairs import CHANGES, METRICS, draw_robot_pair
from turtlelog.explain import Depth, explain_difference
from turtlelog.explain.answers import SEED
from turtlelog.explain.difference_report import choose_told
from turtlelog.scenario import get_preset, override_scenario

NEAR = 1e-9
"""How far sums and contributions may be from the truth, in the metric's unit."""

DEPTH = Depth(shows_effects=False, shows_starts=False)


def main() -> int:
    """Print what was counted; exit with 1 if a pair is explained wrongly."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=500, help="pairs of known changes")
    parser.add_argument("--noisy", type=float, default=0.04, help="part of them with noise")
    parser.add_argument("--alone", type=int, default=20, help="pairs that differ by noise alone")
    parser.add_argument("--robots", type=int, default=60, help="pairs of robots of each kind")
    parser.add_argument("--seed", type=int, default=time.time_ns() % 1_000_000)
    asked = parser.parse_args()
    print(f"seed {asked.seed}", flush=True)
    source, began_s = random.Random(asked.seed), time.process_time()
    found: Counter[str] = Counter()
    for number in range(asked.pairs):
        pair = draw_pair(source, is_random=source.random() < asked.noisy)
        said = judge_pair(pair)
        found[said] += 1
        if said.startswith("wrong"):
            print(f"{number}: {said}: {pair.first.name}, {pair.metric}, {dict(pair.changes)}")
    alone = sum(names_no_cause(source.randrange(10**6)) for _ in range(asked.alone))
    for said, count in sorted(found.items()):
        print(f"{count:5} {said}")
    print(f"{alone:5} of {asked.alone} pairs that differ by noise alone name no cause")
    for part in CHANGES:
        judged = Counter(judge_robots(part, source.randrange(10**6)) for _ in range(asked.robots))
        print(f"robots that differ in {part}: {', '.join(f'{n} {s}' for s, n in judged.items())}")
    print(f"{time.process_time() - began_s:.0f} s of processor time")
    return int(any(said.startswith("wrong") for said in found))


def judge_pair(pair: Pair) -> str:
    """Return what became of a pair, in a few words."""
    runs = [tl.simulate_run(one) for one in (pair.first, pair.second)]
    known = [tl.measure_run(run, only=[pair.metric])[pair.metric].value for run in runs]
    found = explain_difference(*runs, metric=pair.metric, depth=DEPTH)
    truth = pair.divide()
    if truth is None:
        return "wrong: divided without all values" if found.contributions else "without a value"
    if found.withheld or known[0] is None or known[1] is None:
        return "wrong: withheld"
    sizes = {one.name: one.contribution or 0.0 for one in found.contributions}
    if abs(math.fsum(sizes.values()) - (known[1] - known[0])) > NEAR:
        return "wrong: sum"
    sizes.pop(SEED, None)
    if not sizes.keys() <= truth.keys():
        return "wrong: groups"
    if max(abs(sizes.get(name, 0.0) - one) for name, one in truth.items()) > NEAR:
        return "wrong: contribution"
    kind = "noisy" if pair.is_random else f"{len(truth)} groups"
    return f"right: {kind}"


def judge_robots(part: str, seed: int) -> str:
    """Return whether the part of two robots is named, and no other part of them."""
    pair = draw_robot_pair(part, seed, has_same_commands=bool(seed % 2) or part == "noise")
    found = explain_difference(pair.first, pair.second, metric=METRICS[part])
    if found.withheld:
        return "without a cause"
    named = {one.name for one in choose_told(found) if one.name != "commands"}
    kinds = {name.removesuffix(" turning").removesuffix(" driving") for name in named}
    if not kinds:
        return "without a cause"
    return "right" if kinds == {part} else f"wrong ({', '.join(sorted(kinds))})"


def names_no_cause(seed: int) -> bool:
    """Return whether no cause is named of two runs that differ by their noise alone."""
    noise = {"sensing.noise_position_m": 0.01, "sensing.noise_heading_rad": 0.01}
    scenario = override_scenario(get_preset("paper-kp4"), noise, source="noise")
    runs = [tl.simulate_run(replace(scenario, seed=seed + by)) for by in (0, 1)]
    found = explain_difference(*runs, metric="final.position_error", depth=DEPTH)
    return all(one.name == SEED for one in found.contributions)


if __name__ == "__main__":
    sys.exit(main())
