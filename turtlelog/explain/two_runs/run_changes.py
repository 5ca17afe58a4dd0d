"""Differences between two scenarios, in groups of settings that belong together.

A group is a cause of the second run's scenario, and its neutral values are those of the first run.
The game of `explain` can then compare two runs.
"""

from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from typing import Any, Final

from turtlelog.effects import EFFECTS
from turtlelog.errors import ScenarioError
from turtlelog.explain.causes import PLANT_CAUSES, draws_random
from turtlelog.explain.game import Coalition, Outcome, Play, ScenarioGame, Work
from turtlelog.laws import find_law, list_causes
from turtlelog.run.loops import Cause
from turtlelog.scenario import (
    Scenario,
    build_scenario,
    flatten_scenario,
    nest_parameters,
    resolve_scenario,
)
from turtlelog.simulate import declare_scenario

LAW: Final = "law"
"""Group of all settings of a law, if the runs have different laws."""

GAINS: Final = "gains"
"""Group of the gains of all loops, if each run has one value for them."""

_NOT_SETTINGS: Final = ("name", "seed")
"""Keys that are not settings: a name changes nothing, and the seeds have their own line."""

_WHOLE: Final = ("goal", "start", "path")
"""Tables that are changed as a whole."""

_NAMES: Final[Mapping[str, str]] = {
    "saturation": "limits",
    "sampling": "sampling period",
    "float32": "pose precision",
    "max_duration_s": "time span",
}
"""Names of groups that differ from the names of their causes."""


def find_changes(first: Scenario, second: Scenario) -> dict[str, Cause]:
    """Return the groups of settings in which two scenarios differ, by name, in the file's order.

    Both gains form one group if each scenario has one value for both. The keys of an effect form
    one group, as do goal, start and path each. If the kinds of law differ, the law with all of its
    keys is one group; the same applies to the plant. A path that only one of the laws has belongs
    to the law.

    Args:
        first: Scenario with the neutral values; None for a key that the scenario does not have.
        second: Other scenario. The laws of both are already loaded.
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
    """Return the name of the group of a table or key.

    A key without a group is a group of its own.
    """
    names = {key: name for name, found in _list_effect_keys() for key in found}
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
    if len(gains) > 1 and all(_has_one_value(one, gains) for one in (first, second)):
        names |= dict.fromkeys(gains, GAINS)
    return names


def _list_effect_keys() -> Iterable[tuple[str, tuple[str, ...]]]:
    """Yield the causes of the loop with their keys; other keys belong to the first cause."""
    for effect in EFFECTS:
        keys = tuple(
            f"{table}.{field.name}"
            for table, kind in effect.tables.items()
            for field in fields(kind)
        )
        names = [one.name for one in effect.causes] or [effect.name]
        yield names[0], keys
        yield from ((one.name, tuple(one.neutral)) for one in effect.causes)


def _has_one_value(scenario: Scenario, keys: Iterable[str]) -> bool:
    values = flatten_scenario(scenario)
    return len({values.get(key) for key in keys}) == 1


class ChangeGame(ScenarioGame):
    """Simulations of the second of two scenarios, with some changes undone as in the first."""

    def __init__(
        self,
        second: Scenario,
        metric: str,
        changes: Mapping[str, Cause],
        first: Scenario,
        work: Work | None = None,
    ) -> None:
        """Store the scenario with all changes."""
        super().__init__(second, metric, work, causes=changes)
        self.is_random = draws_random(second) or draws_random(first)
        self._impossible: dict[Coalition, str] = {}

    def list_seeds(self, out: Coalition) -> tuple[int | None, ...]:
        """Return the seeds for a simulation; None alone if there is nothing to simulate."""
        return (None,) if self._find_obstacle(out) else super().list_seeds(out)

    def _simulate(self, wanted: Any) -> None:
        for out, seed in wanted:
            if reason := self._find_obstacle(out):
                self._outcomes[out, seed] = Outcome(value=None, reason=reason, ended=())
        super()._simulate(wanted)

    def build_play(self, out: Coalition, seed: int | None = None) -> Play:
        """Return the simulation. A law that fails with another law's settings gives no value."""
        return replace(super().build_play(out, seed), may_fail=True)

    def _find_obstacle(self, out: Coalition) -> str:
        """Return why these settings are not a valid scenario; empty if the scenario is valid."""
        if out not in self._impossible:
            try:
                self._take_out(out)
                self._impossible[out] = ""
            except ScenarioError as err:
                self._impossible[out] = f"these settings contradict each other ({err})"
        return self._impossible[out]

    def _list_present(self, causes: Mapping[str, Cause]) -> tuple[str, ...]:
        return tuple(causes)

    def _build_without(self, causes: Iterable[Cause]) -> Scenario:
        return undo_changes(self._scenario, causes)


def undo_changes(second: Scenario, changes: Iterable[Cause]) -> Scenario:
    """Return a scenario with some groups of settings taken from another scenario.

    Raises:
        ScenarioError: If the settings contradict each other.
    """
    values = {key: value for one in changes for key, value in one.neutral.items()}
    return set_values(second, values)


def set_values(scenario: Scenario, values: Mapping[str, Any]) -> Scenario:
    """Return a scenario with values of another scenario by dotted key; None: the key is absent.

    Raises:
        ScenarioError: If the settings contradict each other.
    """
    found = {**flatten_scenario(scenario), **values}
    tables = nest_parameters({key: value for key, value in found.items() if value is not None})
    # Both laws run already: the user of the comparison has named them.
    return resolve_scenario(build_scenario(tables, source="both runs", trust_law=True))
