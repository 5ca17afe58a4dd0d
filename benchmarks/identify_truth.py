"""Fresh robots of known truth through the identification: how often intervals hold it.

python benchmarks/identify_truth.py [--robots 2000] [--seed N]

Prints per parameter the coverage of the intervals of 95 % and the median error; the robots at the
edge of what is allowed (no dead time, or no lag), those with two lags and those with a limit of the
acceleration are counted apart: a fifth as many of each.
"""

import argparse
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.identify.robots import draw_log, draw_second_order
from tests.identify.scores import PARAMETERS, Score, score_limited, score_robots

NOISE_M = 2e-4
"""The noise at which the error of the dead time is claimed [m]."""


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=time.time_ns() % 1_000_000_000)
    asked = parser.parse_args()
    began_s = time.process_time()
    seeds = range(asked.seed, asked.seed + asked.robots)
    print(f"{asked.robots} robots of 40 s, seeds from {asked.seed} on")
    show("in the range", score_robots((seed, draw_log(seed)) for seed in seeds))
    at_edge = seeds[: max(asked.robots // 5, 1)]
    edges = score_robots((seed, draw_log(seed, at_edge=True)) for seed in at_edge)
    show("at its edge", edges)
    doubled = score_robots((seed, draw_second_order(seed)) for seed in at_edge)
    show("with two lags", doubled)
    limited = score_limited(at_edge)
    show("with a limit of the acceleration", limited)
    print(f"  rate_limit     {100.0 * limited.find_coverage('rate_limit'):5.1f} % hold")
    print(f"{time.process_time() - began_s:.1f} s of processor time")


def show(title: str, score: Score) -> None:
    print(
        f"{title}: {score.axes} axes, {score.refused} refused, {score.of_second_order} of another"
        " model than first order"
    )
    for name in PARAMETERS:
        coverage, error = score.find_coverage(name), score.find_median_error(name)
        unit = "" if name == "gain" else " s"
        print(f"  {name:13}  {100.0 * coverage:5.1f} % hold  median error {error:.2g}{unit}")
    quiet = score.find_median_error("dead_time_s", NOISE_M)
    print(f"  median error of the dead time at noise up to {NOISE_M:g} m: {1e3 * quiet:.3f} ms")


if __name__ == "__main__":
    main()
