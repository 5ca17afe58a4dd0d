"""Compile what tests run, once: each of their workers would compile it for itself.

A loop takes 4 to 6 s: of every day are those of the sequential laws and of one other; with the
word `all` those of every law and plant.
"""

import random
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from importlib.util import find_spec
from typing import Final

from tests.effects_cases import EFFECTS
from tests.simulate.random_scenarios import OTHER_LAWS, build_law
from turtlelog.laws import LAWS
from turtlelog.processes import count_cores
from turtlelog.scenario import Scenario, get_preset, override_scenario, resolve_scenario
from turtlelog.simulate.many import find_loop
from turtlelog.sweep.batch import find_batch
from turtlelog.sweep.batch_arrays import compile_goals, compile_paths, is_batched

EVERYDAY: Final = {
    *("sequential-p turtlesim", "sequential-pid turtlesim", "sequential-pid lagged"),
    *("sequential-p lagged", "pure-pursuit turtlesim"),
}
"""Law and plant of the loops of every day: the sequential ones, and one that follows a path."""


def list_pairs(*, has_all: bool) -> Iterator[Scenario]:
    """Yield a scenario of each law and plant; last those of batches, whose measurement is known."""
    for kind in (*OTHER_LAWS, *(kind for kind in LAWS if kind not in OTHER_LAWS)):
        law = build_law(random.Random(1), kind) if kind in OTHER_LAWS else {"law.kind": kind}
        for plant, robot in (("lagged", EFFECTS["lagged"]), ("turtlesim", {})):
            if has_all or f"{kind} {plant}" in EVERYDAY:
                changes = {**law, **robot}
                yield resolve_scenario(override_scenario(get_preset("textbook"), changes))


def compile_pair(scenario: Scenario) -> None:
    """Compile the loop of a scenario, and its batch."""
    plant = scenario.plant.facts
    found = [find_loop(scenario, plant)]
    if is_batched(scenario, plant):
        found.append(find_batch(scenario))
    for loops in found:
        assert loops is not None
        loops.load()
        assert loops.problem is None


def main(*words: str) -> None:
    """Compile it, on all cores."""
    measurements = [compile_goals, compile_paths]
    pairs = [partial(compile_pair, scenario) for scenario in list_pairs(has_all="all" in words)]
    with ProcessPoolExecutor(count_cores()) as pool:
        jobs: list[Callable[[], object]] = [*measurements, *pairs]
        for job in [pool.submit(run, job) for job in jobs]:
            job.result()


def run(job: Callable[[], object]) -> None:
    """Run a job, whose answer stays in its process."""
    job()


if __name__ == "__main__" and find_spec("numba"):
    main(*sys.argv[1:])
