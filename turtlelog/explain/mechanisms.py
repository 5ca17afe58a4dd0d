"""What an implementation adds to the ideal loop: one table of data for each scenario.

Those of an effect stand in its file, those of a law in the law. Each says how a scenario is without
it. Sampling is the clock's: without it the same scenario is simulated on a finer one.
"""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any, Final

from turtlelog.effects import EFFECTS
from turtlelog.errors import ExplainError, describe_unknown
from turtlelog.laws import find_law, list_mechanisms, list_sample_counters, name_law
from turtlelog.loops import Mechanism
from turtlelog.run import Run
from turtlelog.scenario import (
    Scenario,
    flatten_scenario,
    override_scenario,
    resolve_scenario,
)
from turtlelog.simulate import simulate_run
from turtlelog.simulate.streams import RANDOM_KEYS, STREAMS

FINER: Final = 8
"""Steps that a tick is divided into without sampling: 2 ms each."""

SAMPLING: Final = "sampling"
"""The property that no setting is: without it the plant has a finer clock."""

LOOP_MECHANISMS: Final = (
    *(mechanism for effect in EFFECTS for mechanism in effect.mechanisms),
    Mechanism(
        name=SAMPLING,
        kind="property",
        neutral={},
        meaning=f"a clock {FINER} times finer, each pose answered, delays unchanged",
    ),
)
"""What lies between law and plant, whatever the law. Dead time and lag of a robot are its own."""

RANDOM_EFFECTS: Final = frozenset(
    one.name for one in LOOP_MECHANISMS if not RANDOM_KEYS.isdisjoint(one.neutral)
)
"""Names of those that draw random numbers."""


def draws_random(scenario: Scenario) -> bool:
    """Return whether a scenario's run is another one with another seed."""
    values = flatten_scenario(scenario)
    return any(
        # What is certain draws nothing that counts: a probability of 1.
        values.get(key, 0.0) not in ({0.0, 1.0} if stream.is_chance else {0.0})
        for stream in STREAMS.values()
        for key in stream.keys
    )


def find_mechanisms(scenario: Scenario) -> Mapping[str, Mechanism]:
    """Return what a scenario may have, by name: the loop's mechanisms, then those of its law.

    Without `sampling` where the clock cannot be made finer.

    Raises:
        ScenarioError: Where the law cannot be loaded, or may not run.
        ExplainError: Where two mechanisms have one name.
    """
    law = find_law(resolve_scenario(scenario).law.kind)
    is_offered = not describe_no_sampling(scenario)
    found = {one.name: one for one in LOOP_MECHANISMS if is_offered or one.name != SAMPLING}
    for mechanism in list_mechanisms(law):
        if mechanism.name in found or mechanism.name == SAMPLING:
            raise ExplainError(
                f"{name_law(law)}.mechanisms: expected a name that no other mechanism has,"
                f" found {mechanism.name!r}"
            )
        found[mechanism.name] = mechanism
    return MappingProxyType(found)


def list_effects(table: Mapping[str, Mechanism]) -> tuple[str, ...]:
    """Return those that share a deviation among themselves."""
    return tuple(name for name, found in table.items() if found.kind == "effect")


def is_present(scenario: Scenario, mechanism: Mechanism) -> bool:
    """Return whether a mechanism is in a scenario: whether taking it out changes a setting."""
    return mechanism.name == SAMPLING or take_out(scenario, [mechanism]) != scenario


def simulate_without(scenario: Scenario, names: Iterable[str]) -> Run:
    """Simulate a scenario without some of its mechanisms.

    Raises:
        ExplainError: Where the scenario has no mechanism of that name.
        ScenarioError: Where the law cannot be loaded, or may not run.
    """
    names = [*names]
    scenario = resolve_scenario(scenario)
    table = find_mechanisms(scenario)
    changed = take_out(scenario, [find_mechanism(name, table, scenario) for name in names])
    return simulate_finer(changed) if SAMPLING in names else simulate_run(changed)


def find_mechanism(name: str, table: Mapping[str, Mechanism], scenario: Scenario) -> Mechanism:
    """Return a mechanism of a scenario by its name.

    Raises:
        ExplainError: Where the table has none of that name.
    """
    if name in table:
        return table[name]
    if name == SAMPLING:
        raise ExplainError(f"mechanism: {describe_no_sampling(scenario)}")
    raise ExplainError(describe_unknown("cause", name, table, place="turtlelog list causes"))


def describe_no_sampling(scenario: Scenario) -> str:
    """Return why the clock cannot be made finer, in one clause; empty where it can."""
    if list_sample_counters(find_law(scenario.law.kind)) is None:
        return (
            f"sampling is not taken out, as the law {scenario.law.kind} does not say which of its"
            " parameters count samples (counts_samples)"
        )
    if draws_random(scenario):
        return (
            "sampling is not taken out, as the scenario draws random numbers for each pose or"
            " command, and a finer clock has more of them"
        )
    return ""


def take_out(scenario: Scenario, mechanisms: Iterable[Mechanism]) -> Scenario:
    """Return a scenario with the settings that it has without some mechanisms."""
    for mechanism in mechanisms:
        source = f"{scenario.name} without {mechanism.name}"
        scenario = override_scenario(scenario, mechanism.neutral, source=source)
    return resolve_scenario(scenario)


def simulate_finer(scenario: Scenario) -> Run:
    """Simulate a scenario with a plant whose clock is `FINER` times finer."""
    facts = scenario.plant.facts
    # A robot's period need not be a multiple of anything: its steps are whole nanoseconds.
    plant = replace(facts, period_ns=facts.period_ns // FINER, steps_per_tick=FINER)
    run = simulate_run(_stretch_counts(scenario), plant)
    return replace(run, parameters=flatten_scenario(scenario))


def _stretch_counts(scenario: Scenario) -> Scenario:
    """Return the scenario for a finer clock: what counts ticks or samples takes as long as before.

    Every pose is answered, also where a timer answered. A dead time of k ticks is k times `FINER`
    steps, and a queue that keeps k commands makes k - 1 ticks of it.
    """
    loop, parameters = scenario.loop, scenario.law.parameters
    counters = list_sample_counters(find_law(scenario.law.kind)) or ()
    counts: dict[str, Any] = {name: getattr(parameters, name) * FINER for name in counters}
    return replace(
        scenario,
        law=replace(scenario.law, parameters=replace(parameters, **counts)),
        loop=replace(
            loop,
            period_ticks=1,
            trigger="pose",
            period_s=None,
            start_backlog=(loop.start_backlog - 1) * FINER + 1,
            pose_queue=loop.pose_queue * FINER,
            command_queue=(loop.command_queue - 1) * FINER + 1,
            transport_delay_ticks=loop.transport_delay_ticks * FINER,
        ),
    )
