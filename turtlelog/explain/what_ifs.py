"""What would have happened: a run's scenario without its effects, one by one and all at once."""

from collections.abc import Callable, Mapping
from typing import Final

from turtlelog.display import join_words
from turtlelog.explain.attribution import Attribution
from turtlelog.explain.causes import simulate_without
from turtlelog.explain.identification import Identification
from turtlelog.run import Run

_MOST_NAMED: Final = 3
"""Causes that a name holds; more are counted: a legend has no room for them."""


def simulate_what_ifs(
    identified: Identification,
    found: Attribution,
    *,
    report: Callable[[int, int], None] | None = None,
) -> Mapping[str, Run]:
    """Simulate the run without each cause that acts, and without all of them.

    Those are the ones that change the value, or decide whether there is one; where there is none
    with and without any, every one that takes part. None if re-simulation and log disagree: they
    would say nothing of the log.

    Args:
        identified: Scenario that reproduces the run.
        found: Causes among which its value was divided.
        report: Called with the simulations that are done, and how many there are.

    Returns:
        Runs by what they lack, as `name_without` writes it: one cause each, in the order of the
        attribution; where there are several, the last is the run without all.

    Raises:
        ExplainError: If no scenario reproduces the run.
        ScenarioError: If its law cannot be loaded, or may not run.
        SimulationError: If the law fails without one of them.
    """
    if found.withheld and not found.without_value:
        return {}
    names = list_deciding(found)
    chosen: list[tuple[str, ...]] = [(name,) for name in names]
    if len(names) > 1:
        chosen.append(tuple(names))
    scenario = identified.build_scenario()
    runs: dict[str, Run] = {}
    for number, taken in enumerate(chosen, start=1):
        runs[name_without(taken)] = simulate_without(scenario, taken)
        if report is not None:
            report(number, len(chosen))
    return runs


def list_deciding(found: Attribution) -> tuple[str, ...]:
    """Return the causes that change the value, or decide whether there is one."""
    if not found.without_value:
        return found.acting
    cases = (*found.without_value, *found.with_value)
    named = {name for case in cases for name in case.causes}
    return tuple(name for name in found.causes if name in named) or found.causes


def name_without(causes: tuple[str, ...]) -> str:
    """Return what a what-if lacks in words: `queue`, `queue and pause`, `all 5 effects`."""
    if len(causes) > _MOST_NAMED:
        return f"all {len(causes)} effects"
    return join_words(causes)
