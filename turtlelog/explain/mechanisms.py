"""What an implementation adds to the ideal loop: one table of data for each scenario.

The loop's own mechanisms stand here, those of a law in the law. Each says how a scenario is without
it. Sampling is the plant's: without it the same scenario is simulated on a finer clock.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any, Final

from turtlelog.errors import ExplainError, suggest_names
from turtlelog.laws import find_law, list_mechanisms, list_sample_counters
from turtlelog.loops import Mechanism
from turtlelog.plants import TURTLESIM
from turtlelog.run import Run
from turtlelog.scenario import (
    Scenario,
    flatten_scenario,
    override_scenario,
    resolve_scenario,
)
from turtlelog.simulate import simulate_run

FINER: Final = 8
"""Steps that a tick is divided into without sampling: 2 ms each."""

_PERIOD: Final = "plant.period_s"
"""The plant's period: what sampling hangs on. No scenario sets it."""

SAMPLING: Final = "sampling"

LOOP_MECHANISMS: Final = (
    Mechanism(
        name="queue",
        kind="effect",
        neutral={"loop.queue_policy": "newest", "loop.start_backlog": 1},
        meaning="the newest command wins, and no backlog at the start",
    ),
    Mechanism(
        name="delay",
        kind="effect",
        neutral={"loop.transport_delay_ticks": 0},
        meaning="no transport delay",
    ),
    Mechanism(
        name="saturation",
        kind="property",
        neutral={"limits.speed_m_s": math.inf, "limits.turn_rate_rad_s": math.inf},
        meaning="no limit of speed and turn rate",
    ),
    Mechanism(
        name=SAMPLING,
        kind="property",
        neutral={_PERIOD: TURTLESIM.refine(FINER).period_s},
        meaning=f"a clock {FINER} times finer, dead times unchanged",
    ),
    Mechanism(
        name="float32",
        kind="property",
        neutral={"loop.pose_precision": "float64"},
        meaning="poses of 64 bits",
    ),
)
"""What lies between law and plant, whatever the law."""


def find_mechanisms(scenario: Scenario) -> Mapping[str, Mechanism]:
    """Return what a scenario may have, by name: the loop's mechanisms, then those of its law.

    Without `sampling` where the law does not tell which of its parameters count samples.

    Raises:
        ScenarioError: Where the law cannot be loaded, or may not run.
        ExplainError: Where two mechanisms have one name.
    """
    law = find_law(resolve_scenario(scenario).law.kind)
    counts = list_sample_counters(law) is not None
    found = {one.name: one for one in LOOP_MECHANISMS if counts or one.name != SAMPLING}
    for mechanism in list_mechanisms(law):
        if mechanism.name in found or mechanism.name == SAMPLING:
            raise ExplainError(
                f"{law.__name__}.mechanisms: expected a name that no other mechanism has,"
                f" found {mechanism.name!r}"
            )
        found[mechanism.name] = mechanism
    return MappingProxyType(found)


def list_effects(table: Mapping[str, Mechanism]) -> tuple[str, ...]:
    """Return those that share a deviation among themselves."""
    return tuple(name for name, found in table.items() if found.kind == "effect")


def is_present(scenario: Scenario, mechanism: Mechanism) -> bool:
    """Return whether a mechanism is in a scenario: whether taking it out changes a setting."""
    return _PERIOD in mechanism.neutral or _take_out(scenario, [mechanism]) != scenario


def simulate_without(scenario: Scenario, names: Iterable[str]) -> Run:
    """Simulate a scenario without some of its mechanisms.

    Raises:
        ExplainError: Where the scenario has no mechanism of that name.
        ScenarioError: Where the law cannot be loaded, or may not run.
    """
    scenario = resolve_scenario(scenario)
    table = find_mechanisms(scenario)
    mechanisms = [find_mechanism(name, table, scenario) for name in names]
    changed = _take_out(scenario, mechanisms)
    is_finer = any(_PERIOD in mechanism.neutral for mechanism in mechanisms)
    return _simulate_finer(changed) if is_finer else simulate_run(changed)


def find_mechanism(name: str, table: Mapping[str, Mechanism], scenario: Scenario) -> Mechanism:
    """Return a mechanism of a scenario by its name.

    Raises:
        ExplainError: Where the table has none of that name.
    """
    if name in table:
        return table[name]
    if name == SAMPLING:
        raise ExplainError(f"mechanism: {describe_no_sampling(scenario)}")
    raise ExplainError(f"mechanism: expected {suggest_names(name, table)}, found {name!r}")


def describe_no_sampling(scenario: Scenario) -> str:
    """Return why a law's clock cannot be made finer, in one clause."""
    return (
        f"sampling is not taken out, as the law {scenario.law.kind} does not say which of its"
        " parameters count samples (counts_samples)"
    )


def _take_out(scenario: Scenario, mechanisms: Iterable[Mechanism]) -> Scenario:
    for mechanism in mechanisms:
        values = {key: value for key, value in mechanism.neutral.items() if key != _PERIOD}
        source = f"{scenario.name} without {mechanism.name}"
        scenario = override_scenario(scenario, values, source=source)
    return resolve_scenario(scenario)


def _simulate_finer(scenario: Scenario) -> Run:
    """Simulate a scenario with a plant whose clock is `FINER` times finer."""
    run = simulate_run(_stretch_counts(scenario), TURTLESIM.refine(FINER))
    return replace(run, parameters=flatten_scenario(scenario))


def _stretch_counts(scenario: Scenario) -> Scenario:
    """Return the scenario for a finer clock: what counts ticks or samples takes as long as before.

    Every pose is answered. A dead time of k ticks is k times `FINER` steps, and a queue that keeps
    k commands makes k - 1 ticks of it.
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
            start_backlog=(loop.start_backlog - 1) * FINER + 1,
            pose_queue=loop.pose_queue * FINER,
            command_queue=(loop.command_queue - 1) * FINER + 1,
            transport_delay_ticks=loop.transport_delay_ticks * FINER,
        ),
    )
