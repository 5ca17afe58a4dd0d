"""Differences between an implementation and the ideal loop: one table of causes per scenario.

The causes of an effect are in its file, those of a law in the law. Each cause defines the scenario
without it. Sampling belongs to the clock: without sampling, the same scenario is simulated with a
finer clock. The differences between two scenarios are causes as well: a group of settings that
belong together is a cause of the second one, and its neutral values are those of the first.

The metric to explain is chosen and checked here as well, and its resolution is found.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from enum import StrEnum
from typing import Any, Final

from turtlelog import measure
from turtlelog.effects import EFFECTS
from turtlelog.errors import ExplainError, describe_unknown
from turtlelog.laws import LAWS, find_law, list_causes, list_sample_counters, name_law
from turtlelog.plants import PLANTS
from turtlelog.run import Run
from turtlelog.run.angles import wrap_angle
from turtlelog.run.loops import Cause, Declaration
from turtlelog.run.stop_reasons import allow_position
from turtlelog.scenario import (
    DEFAULT_LAW,
    Scenario,
    build_scenario,
    flatten_scenario,
    nest_parameters,
    override_scenario,
    resolve_scenario,
)
from turtlelog.simulate import declare_scenario, simulate_run
from turtlelog.simulate.loop_parts import RANDOM_KEYS, STREAMS

FINER: Final = 8
"""Number of steps per tick without sampling; a step is then 2 ms."""

SAMPLING: Final = "sampling"
"""Name of the design parameter that has no setting: without it, the plant has a finer clock."""

LOOP_CAUSES: Final = (
    *(cause for effect in EFFECTS for cause in effect.causes),
    Cause(
        name=SAMPLING,
        kind="design",
        neutral={},
        meaning=f"a clock {FINER} times finer, each pose answered, delays unchanged",
    ),
)
"""Causes between law and plant, for every law."""

PLANT_CAUSES: Final[Mapping[str, tuple[Cause, ...]]] = {
    kind: part.causes for kind, part in PLANTS.items() if part.causes
}
"""Causes in a plant, by kind of plant. Dead time and time constant of a robot are not among
them."""

NAMED: Final = 0.1
"""Share of the contributions' total magnitude above which a cause or joint part is named. A design
parameter is named above the same share of the value."""

RANDOM_EFFECTS: Final = frozenset(
    one.name for one in LOOP_CAUSES if not RANDOM_KEYS.isdisjoint(one.neutral)
)
"""Names of the causes that draw random numbers."""


def draws_random(scenario: Scenario) -> bool:
    """Return whether the run of a scenario depends on its seed."""
    values = flatten_scenario(scenario)
    return any(
        # A probability of 0 or 1 has no random effect.
        values.get(key, 0.0) not in ({0.0, 1.0} if stream.is_chance else {0.0})
        for stream in STREAMS.values()
        for key in stream.keys
    )


def find_drawn_seed(scenario: Scenario) -> int | None:
    """Return the seed of a scenario, or None if its run does not depend on the seed."""
    return scenario.seed if draws_random(scenario) else None


def find_causes(scenario: Scenario) -> Mapping[str, Cause]:
    """Return the possible causes of a scenario by name: of the loop, the plant and the law.

    `sampling` is left out if the clock cannot be made finer.

    Raises:
        ScenarioError: If the law cannot be loaded or may not run.
        ExplainError: If two causes have the same name.
    """
    law = find_law(resolve_scenario(scenario).law.kind)
    is_offered = not describe_no_sampling(scenario)
    found = {one.name: one for one in LOOP_CAUSES if is_offered or one.name != SAMPLING}
    found |= {one.name: one for one in PLANT_CAUSES.get(scenario.plant.kind, ())}
    for cause in list_causes(law):
        if cause.name in found or cause.name == SAMPLING:
            raise ExplainError(
                f"{name_law(law)}.causes: expected a name that no other cause has,"
                f" found {cause.name!r}"
            )
        found[cause.name] = cause
    return found


def list_effects(table: Mapping[str, Cause]) -> tuple[str, ...]:
    """Return the causes among which a deviation is divided."""
    return tuple(name for name, found in table.items() if found.kind == "effect")


def is_present(scenario: Scenario, cause: Cause) -> bool:
    """Return whether a cause is in a scenario, that is, whether its removal changes a setting."""
    return cause.name == SAMPLING or take_out(scenario, [cause]) != scenario


def simulate_without(scenario: Scenario, names: Iterable[str]) -> Run:
    """Simulate a scenario without some of its causes.

    Raises:
        ExplainError: If the scenario has no cause with that name.
        ScenarioError: If the law cannot be loaded or may not run.
    """
    names = [*names]
    scenario = resolve_scenario(scenario)
    table = find_causes(scenario)
    changed = take_out(scenario, [find_cause(name, table, scenario) for name in names])
    return simulate_finer(changed) if SAMPLING in names else simulate_run(changed)


def find_cause(name: str, table: Mapping[str, Cause], scenario: Scenario) -> Cause:
    """Return a cause of a scenario by its name, or raise ExplainError with the nearest names."""
    if name in table:
        return table[name]
    if name == SAMPLING:
        raise ExplainError(f"cause: {describe_no_sampling(scenario)}")
    raise ExplainError(describe_unknown("cause", name, table, place="turtlelog list causes"))


def describe_no_sampling(scenario: Scenario) -> str:
    """Return why the clock cannot be made finer, in one clause; empty if it can be made finer."""
    if list_sample_counters(find_law(scenario.law.kind)) is None:
        return (
            f"sampling is not removed, because the law {scenario.law.kind} does not say which of"
            " its parameters count samples (counts_samples)"
        )
    if draws_random(scenario):
        return (
            "sampling is not removed, because the scenario draws random numbers for each pose or"
            " command: a run with a finer clock would have other random numbers"
        )
    return ""


def take_out(scenario: Scenario, causes: Iterable[Cause]) -> Scenario:
    """Return a scenario with the settings that remove some causes."""
    for cause in causes:
        source = f"{scenario.name} without {cause.name}"
        scenario = override_scenario(scenario, cause.neutral, source=source)
    return resolve_scenario(scenario)


def simulate_finer(scenario: Scenario) -> Run:
    """Simulate a scenario with a plant whose clock is `FINER` times finer."""
    facts = scenario.plant.facts
    # The period of a robot model may be any whole number of nanoseconds, so it is divided as such.
    plant = replace(facts, period_ns=facts.period_ns // FINER, steps_per_tick=FINER)
    run = simulate_run(_stretch_counts(scenario), plant)
    return replace(run, parameters=flatten_scenario(scenario))


def _stretch_counts(scenario: Scenario) -> Scenario:
    """Return the scenario for a finer clock, with counts of ticks or samples that last as long.

    Every pose is answered, even with a timer. A dead time of k ticks becomes k times `FINER` steps,
    and a queue of k commands becomes a delay of k - 1 ticks.
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


LAW: Final = "law"
"""Group of all settings of a law, if the runs have different laws."""

GAINS: Final = "gains"
"""Group of the gains of all loops, if each run has one value for them."""

_NOT_SETTINGS: Final = ("name", "seed")
"""Keys that are not settings: a name changes nothing, and the seeds have their own line."""

_WHOLE: Final = ("goal", "start", "path")  # tables that are changed as a whole

_NAMES: Final[Mapping[str, str]] = {
    "saturation": "limits",
    "sampling": "sampling period",
    "float32": "pose precision",
    "max_duration_s": "time span",
}
"""Names of groups that differ from the names of their causes."""


def find_changes(first: Scenario, second: Scenario) -> dict[str, Cause]:
    """Return the groups of settings in which two scenarios differ, by name, in the file's order.

    Neutral values are those of `first`, None for a key that it does not have. Both gains form one
    group if each scenario has one value for both. The keys of an effect form one group, as do goal,
    start and path each. If the kinds of law differ, the law with all of its keys is one group; the
    same applies to the plant. A path that only one of the laws has belongs to the law. Both laws
    are loaded.
    """
    before, after = flatten_scenario(first), flatten_scenario(second)
    keys = [
        key
        for key in {**before, **after}
        if key not in _NOT_SETTINGS and before.get(key) != after.get(key)
    ]
    names = _name_groups(first, second)
    groups: dict[str, dict[str, object]] = {}
    for key in keys:
        table = key.partition(".")[0]
        # A table within a law is changed as a whole.
        name = names.get(table) or names.get(key) or ".".join(key.split(".")[:2])
        groups.setdefault(_NAMES.get(name, name), {})[key] = before.get(key)
    if LAW in groups:  # equal values may mean different things to different laws
        own = [key for key in {**before, **after} if key.startswith("law.")]
        groups[LAW] |= {key: before.get(key) for key in own}
    return {
        name: Cause(name=name, kind="effect", neutral=values, meaning=f"as in {first.name}")
        for name, values in groups.items()
    }


def _name_groups(first: Scenario, second: Scenario) -> dict[str, str]:
    """Return the names of the groups of tables and keys; any other key is a group of its own."""
    names: dict[str, str] = {}
    for effect in EFFECTS:  # keys without a cause of their own belong to the first cause
        first_cause = effect.causes[0].name if effect.causes else effect.name
        for table, kind in effect.tables.items():
            names |= {f"{table}.{field.name}": first_cause for field in fields(kind)}
        names |= {key: one.name for one in effect.causes for key in one.neutral}
    names |= {table: table for table in _WHOLE}
    if second.plant.kind != first.plant.kind:
        names["plant"] = "plant"
    if second.law.kind != first.law.kind:
        names["law"] = LAW
        if (second.path is None) != (first.path is None):
            names["path"] = LAW
        return names
    causes = (*PLANT_CAUSES.get(second.plant.kind, ()), *list_causes(find_law(second.law.kind)))
    names |= {key: one.name for one in causes for key in one.neutral}
    gains = declare_scenario(second).list_gains()
    sides = [flatten_scenario(one) for one in (first, second)]
    if len(gains) > 1 and all(len({side.get(key) for key in gains}) == 1 for side in sides):
        names |= dict.fromkeys(gains, GAINS)
    return names


def undo_changes(second: Scenario, changes: Iterable[Cause]) -> Scenario:
    """Return a scenario with some groups of settings taken from another scenario."""
    values = {key: value for one in changes for key, value in one.neutral.items()}
    return set_values(second, values)


def set_values(scenario: Scenario, values: Mapping[str, Any]) -> Scenario:
    """Return a scenario with values of another scenario by dotted key; None: the key is absent.

    ScenarioError: the settings contradict each other.
    """
    found = {**flatten_scenario(scenario), **values}
    tables = nest_parameters({key: value for key, value in found.items() if value is not None})
    # Both laws run already: the user of the comparison has named them.
    return resolve_scenario(build_scenario(tables, source="both runs", trust_law=True))


def require_causes(run: Run, metric: str, causes: Sequence[str] | None) -> None:
    """Require a metric of the run and distinct causes that the run may have; no code is loaded.

    Causes of a law that is not built in are known only when it runs.

    Raises:
        ExplainError: If the metric or a cause is wrong. The message contains the nearest names.
    """
    require_metric(run.declaration, metric)
    require_distinct(causes)
    kind = str(run.parameters.get("law.kind", DEFAULT_LAW))
    if kind not in LAWS:
        return
    plant = str(run.parameters.get("plant.kind"))
    known = [*LOOP_CAUSES, *PLANT_CAUSES.get(plant, ()), *list_causes(find_law(kind))]
    table = {cause.name: cause for cause in known}
    for name in causes or ():
        find_cause(name, table, Scenario())


def require_metric(declaration: Declaration, metric: str) -> None:
    """Refuse a metric that a run of these loops does not have, with the nearest names."""
    known = measure.list_metrics(declaration)
    if metric not in known:
        raise ExplainError(measure.describe_no_metric(metric, known))


def require_distinct(causes: Sequence[str] | None) -> None:
    """Refuse an empty list of causes, or one that names a cause twice."""
    if causes is not None and (not causes or len({*causes}) < len(causes)):
        raise ExplainError(f"causes: expected different ones, found {', '.join(causes)}")


def choose_metric(declaration: Declaration) -> str:
    """Return the default metric to explain: the most important one for the run's law.

    With a goal, the metric is the final position error. Without a goal, it is the rms error of the
    last declared loop; for a law that tracks a path, the cross-track error; without loops, the path
    length.
    """
    if declaration.uses_goal:
        return "final.position_error"
    loops = [loop.name for loop in declaration.loops]
    return f"{loops[-1]}.rms_error" if loops else "run.path_length"


_SHARE: Final = 0.01
"""Share of a value that is negligible if neither a tolerance nor a clock bounds it. A phase of the
paper's runs has at least a hundred samples, so this is about one sample's effect on an integral."""

_HALF_A_COUNT: Final = 0.5  # negligible change of a count; counts change by at least one


class ResolutionReason(StrEnum):
    """Origin of the largest negligible change, as a clause."""

    SAMPLE = "one sample period"
    COUNT = "half a count"
    SHARE = "1 % of the value"
    POSITION_TOLERANCE = "heading tolerance times distance plus position tolerance"
    HEADING_TOLERANCE = "the heading tolerance"
    STEP_TOLERANCE = "the tolerance over the step"
    NO_SCENARIO = "no scenario is known"
    NO_RUN = "no run is simulated"


@dataclass(frozen=True, slots=True, kw_only=True)
class Resolution:
    """The largest change of a metric that is negligible.

    Attributes:
        size: Size of the change, in the metric's unit.
        reason: Origin of a change of this size, in one clause.
    """

    size: float
    reason: ResolutionReason

    @property
    def is_tolerance(self) -> bool:
        """Whether the tolerances of the law allow a change of this size."""
        reasons = ResolutionReason
        return self.reason in {
            reasons.POSITION_TOLERANCE,
            reasons.HEADING_TOLERANCE,
            reasons.STEP_TOLERANCE,
        }


def find_resolution(
    scenario: Scenario, declaration: Declaration, metric: str, value: float
) -> Resolution:
    """Return the resolution of a metric of a scenario, for unknown tolerances from its value."""
    kind = measure.list_metrics(declaration)[metric]
    unit = kind.unit
    if unit == "s":
        return Resolution(size=find_sample_period_s(scenario), reason=ResolutionReason.SAMPLE)
    if scenario.law.kind == DEFAULT_LAW and unit in {"m", "deg", "%"}:
        return _find_tolerated(scenario, declaration, metric, unit)
    if kind.nature == "count":
        return Resolution(size=_HALF_A_COUNT, reason=ResolutionReason.COUNT)
    return Resolution(size=_SHARE * abs(value), reason=ResolutionReason.SHARE)


def find_sample_period_s(scenario: Scenario) -> float:
    """Return the usual time between two answers [s]."""
    loop = scenario.loop
    period_s: float = loop.period_s or loop.period_ticks * scenario.plant.facts.period_s
    return period_s


def _find_tolerated(
    scenario: Scenario, declaration: Declaration, metric: str, unit: str
) -> Resolution:
    """Return the errors that the tolerances of the sequential law allow."""
    heading_rad = scenario.law.parameters.heading_tolerance_rad
    position_m = scenario.law.parameters.position_tolerance_m
    start, goal = scenario.start, scenario.goal
    x_m, y_m = goal.x_m - start.x_m, goal.y_m - start.y_m
    turn_rad = math.atan2(y_m, x_m) - start.heading_rad
    if scenario.law.parameters.wrap_error:
        turn_rad = wrap_angle(turn_rad)
    distance_m, turn_rad = (max(abs(s), math.ulp(1.0)) for s in (math.hypot(x_m, y_m), turn_rad))
    if unit == "m":
        size = allow_position(heading_rad, position_m, distance_m)
        return Resolution(size=size, reason=ResolutionReason.POSITION_TOLERANCE)
    if unit == "deg":
        size = math.degrees(heading_rad)
        return Resolution(size=size, reason=ResolutionReason.HEADING_TOLERANCE)
    loop = declaration.find_loop(metric.rpartition(".")[0])
    turns = loop is not None and loop.signal == "heading"
    tolerance, step = (heading_rad, turn_rad) if turns else (position_m, distance_m)
    return Resolution(size=100.0 * tolerance / step, reason=ResolutionReason.STEP_TOLERANCE)
