"""How true `explain` is: fresh logs of known truth, how often each certainty holds.

python benchmarks/explain_truth.py [--logs 40] [--seed N] [--only FAMILY]

Prints for every family of logs and every key how many findings of each certainty there are, and
how many of them do not hold the truth. `exact` may never fail; an interval of 95 % in 1 to 10 % of
the logs.
"""

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from tests.explain.families import FAMILIES, make_family
from tests.explain.loop_family import count_true, make_loop_logs
from tests.explain.scoring import score
from turtlelog.explain import identify_run

LOOPS = {"loops": True, "loops, other queues": False}
"""Families of laws other than the sequential one: whether their queues have the usual depths."""


def main() -> int:
    """Print the table; exit with 1 where an `exact` is false."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=40, help="logs of each family")
    parser.add_argument("--seed", type=int, default=time.time_ns() % 1_000_000)
    parser.add_argument("--only", choices=[*FAMILIES, *LOOPS], action="append", help="one family")
    parser.add_argument("--show", action="store_true", help="print each finding that is not true")
    asked = parser.parse_args()
    print(f"seed {asked.seed}, {asked.logs} logs of each family")
    false_exact = 0
    for family in asked.only or (*FAMILIES, *LOOPS):
        if family in LOOPS:
            found = count_loops(family, asked.seed, asked.logs)
        else:
            found = count_family(family, asked.seed, asked.logs, show=asked.show)
        print_family(found)
        false_exact += sum(amount for (_, said), amount in found.items() if said == "exact false")
    print(f"\nfalse exact: {false_exact}")
    return int(false_exact > 0)


def count_family(family: str, seed: int, logs: int, *, show: bool) -> Counter[tuple[str, str]]:
    total: Counter[tuple[str, str]] = Counter()
    began = time.perf_counter()
    for log in make_family(family, seed, logs):
        run = log.to_run()
        found = identify_run(run)
        scored = score(log, found)
        total += scored
        for key, said in scored:
            if show and said.endswith("false"):
                print(f"  {key}: {found.findings[key]}\n    {log.truth}, {log.reason}")
    print(f"\n{family}: {FAMILIES[family].meaning} ({time.perf_counter() - began:.0f} s)")
    return total


def count_loops(family: str, seed: int, logs: int) -> Counter[tuple[str, str]]:
    began = time.perf_counter()
    total = count_true(make_loop_logs(seed, logs, is_usual=LOOPS[family]))
    print(f"\n{family}: laws of other users ({time.perf_counter() - began:.0f} s)")
    return total


def print_family(found: Counter[tuple[str, str]]) -> None:
    names = ("exact", "fitted", "bounded", "ambiguous", "unknown")
    print(f"{'':28}" + "".join(f"{name:>18}" for name in names))
    for key in sorted({key for key, _ in found}):
        cells = []
        for name in names:
            true, false = found[key, f"{name} true"], found[key, f"{name} false"]
            amount = true + false
            cells.append(f"{amount}, {false} false" if false else str(amount or "-"))
        print(f"{key:28}" + "".join(f"{cell:>18}" for cell in cells))


if __name__ == "__main__":
    sys.exit(main())
