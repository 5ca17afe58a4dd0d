"""Changing a scenario by dotted keys: `law.kp_linear=4`."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, get_type_hints

from turtlelog.errors import ScenarioError
from turtlelog.files.text_files import parse_toml
from turtlelog.laws import find_law, find_part, name_given_law
from turtlelog.run import Run
from turtlelog.run.paths import PATH_KEYS
from turtlelog.scenario.model import LawChoice, LawTable, Scenario, require_scenario
from turtlelog.scenario.presets import set_nested
from turtlelog.scenario.scenario_file import load_scenario
from turtlelog.scenario.table_conversion import (
    build_scenario,
    flatten_scenario,
    nest_scenario,
    resolve_scenario,
)

_LARGEST_WHOLE: Final = 2**53
"""Largest float that counts as a whole number. Doubles skip whole numbers above this value, so
nobody typed such a gain as an int."""


def override_scenario(
    scenario: Scenario,
    values: Mapping[str, Any],
    *,
    source: str = "changes",
    trust_law: bool | None = None,
) -> Scenario:
    """Return the scenario with values set by dotted key, checked like a file. No code is loaded.

    A new `law.kind` drops the parameters of the old law. A new `plant.kind` drops those of the old
    plant, a new `path.kind` the shape of the old path.

    Args:
        scenario: Scenario to be changed.
        values: New values by dotted key.
        source: Beginning of error lines.
        trust_law: Whether a law that is not built in may run. Default: yes if the scenario's law
            may run, or if `law.kind` is among the values, because then the user names the law.

    Raises:
        ScenarioError: If a key or value is wrong.
    """
    require_scenario(scenario)
    _require_tables(scenario, values, source)
    is_named = "law.kind" in values or _is_trusted(scenario)
    is_trusted = is_named if trust_law is None else trust_law
    return _override(scenario, values, source=source, trust_law=is_trusted)


def choose_scenario(
    scenario: Scenario | str | Path, *, law: Any = None, changes: Mapping[str, Any] | None = None
) -> Scenario:
    """Return a scenario with another law and changed values.

    Args:
        scenario: A scenario, the name of a preset, or a file.
        law: Law to use instead of the scenario's law: the name of a law, or the law itself.
            Default: the scenario's law.
        changes: Values by dotted key.

    Raises:
        LawError: If `law` is not a law.
        ScenarioError: If there is no such scenario, or a change is wrong.
    """
    if isinstance(scenario, str | Path):
        scenario = load_scenario(str(scenario))
    require_scenario(scenario)
    if law is not None:
        kind = law if isinstance(law, str) else name_given_law(law)
        scenario = override_scenario(scenario, {"law.kind": kind}, source="law")
        if find_part(law) is not None:
            scenario = replace(scenario, law=LawChoice(kind=kind, parameters=law.parameters))
    if changes is None:
        return scenario
    if not hasattr(changes, "keys"):
        expected = 'values by key, as in {"law.kp_linear": 4.0}'
        raise ScenarioError(f"changes: expected {expected}, found {changes!r:.60}")
    plain = {key: unwrap_number(changes[key]) for key in changes.keys()}  # noqa: SIM118
    return override_scenario(scenario, plain) if plain else scenario


def unwrap_number(value: Any) -> Any:
    """Return a numpy number as a Python number; any other value unchanged."""
    return value.item() if hasattr(value, "item") and not getattr(value, "ndim", 1) else value


def _require_tables(scenario: Scenario, values: Mapping[str, Any], source: str) -> None:
    """Raise an error for a key without its table, and name the keys with the same ending."""
    if all("." in key for key in values):
        return
    known = dict.fromkeys(["goal.heading_rad", *flatten_scenario(scenario), *PATH_KEYS])
    lasts = {key.rpartition(".")[2] for key in known}
    for key in values:
        if "." in key or key in known:
            continue
        from difflib import get_close_matches  # Only mistakes pay for it.

        ends = [last for last in lasts if last.startswith(key)] or get_close_matches(key, lasts)
        homes = [name for name in known if name.rpartition(".")[2] in ends]
        if any("." in name for name in homes):
            near = " or ".join(homes)
            raise ScenarioError(f"{source}: {key}: unknown key; did you mean {near}?")


def override_gains(
    scenario: Scenario, keys: Iterable[str], kp: float, *, source: str = "kp"
) -> Scenario:
    """Return the scenario with one value for all gains.

    An integer gain accepts only a whole number.

    Raises:
        ScenarioError: If `override_scenario` raises it.
    """
    is_whole = float(kp).is_integer() and abs(kp) <= _LARGEST_WHOLE
    gains = {key: int(kp) if is_whole and _is_int(scenario, key) else kp for key in keys}
    return override_scenario(scenario, gains, source=source)


def _is_int(scenario: Scenario, key: str) -> bool:
    """Return whether a law's parameter is an int, by its value or else by its type in the law."""
    known = flatten_scenario(scenario)
    if key in known or not _is_trusted(scenario):
        return isinstance(known.get(key), int)
    hints = get_type_hints(find_law(scenario.law.kind).Parameters)
    return hints.get(key.removeprefix("law.")) is int


def _override(
    scenario: Scenario, values: Mapping[str, Any], *, source: str, trust_law: bool
) -> Scenario:
    tables, was = nest_scenario(scenario), scenario.law.parameters
    if "law.kind" in values and values["law.kind"] != scenario.law.kind:
        tables["law"] = {}
    if values.get("plant.kind", scenario.plant.kind) != scenario.plant.kind:
        tables["plant"] = {}
    was_path = scenario.path
    if was_path is not None and values.get("path.kind", was_path.kind) != was_path.kind:
        # What belongs to any path stays; corners are no circle's.
        tables["path"] = {key: tables["path"][key] for key in tables["path"].keys() & {"speed_m_s"}}
    for key, value in values.items():
        try:
            set_nested(tables, key, value)
        except ScenarioError as err:
            raise ScenarioError(f"{source}: {err}") from err
    changed = build_scenario(tables, source=source, trust_law=trust_law)
    table = changed.law.parameters
    is_same = changed.law.kind == scenario.law.kind
    if not (is_same and isinstance(table, LawTable) and isinstance(was, LawTable)):
        return changed
    # The keys of the law are judged later, in one table: error lines name all who wrote into it.
    is_written = any(key.startswith("law.") and key != "law.kind" for key in values)
    sources = (*was.sources, source) if is_written else was.sources
    table = replace(table, sources=tuple(dict.fromkeys(sources)))
    return replace(changed, law=replace(changed.law, parameters=table))


def _is_trusted(scenario: Scenario) -> bool:
    table = scenario.law.parameters
    return table.is_trusted if isinstance(table, LawTable) else True


def complete_scenario(run: Run, base: Scenario) -> Scenario:
    """Return the scenario of a run: its recorded values, and the rest from another scenario.

    An imported log contains at most gains, tolerances, limits and goal. Keys that the law of `base`
    does not have are left out; a user law is loaded to find its keys. A law that only the run names
    must not run.

    Raises:
        ScenarioError: If a value of the run is wrong, or the law of `base` may not run.
    """
    base = resolve_scenario(base)
    known = flatten_scenario(base).keys() | {"goal.heading_rad", *PATH_KEYS}
    goal = run.goal_xy_m
    values: dict[str, Any] = {} if goal is None else {"goal.x_m": goal[0], "goal.y_m": goal[1]}
    values |= {key: value for key, value in run.parameters.items() if key in known}
    is_same = values.get("law.kind", base.law.kind) == base.law.kind
    return _override(base, values, source=run.name, trust_law=is_same)


def replay_commands(scenario: Scenario, run: Run) -> Scenario:
    """Return the scenario with the law `open-loop` and the commands of a run.

    The times are relative to the first sample of the run, or to an earlier first command. If
    several commands were published at one time, the last command is used. Repeated commands are
    left out, because each command is held until the next. Therefore commands that waited in a queue
    cannot be distinguished.

    Raises:
        ScenarioError: If the run has no commands, more than a scenario can contain, or sideways
            commands.
    """
    commands = run.commands
    if not len(commands):
        raise ScenarioError(f"{run.name}: the run has no commands")
    if commands.lateral_speed_m_s.any():
        expected = "commands along the heading, as laws give them"
        raise ScenarioError(f"{run.name}: expected {expected}, found one to the side")
    origin_ns = min(run.start_ns, int(commands.time_ns[0]))
    columns = (commands.time_ns, commands.speed_m_s, commands.turn_rate_rad_s)
    rows = {row[0]: row[1:] for row in zip(*(one.tolist() for one in columns), strict=True)}
    *times_ns, last_ns = rows
    befores = [None, *(rows[time_ns] for time_ns in times_ns)]
    kept = [
        ((time_ns - origin_ns) / 1e9, *command)
        for (time_ns, command), before in zip(rows.items(), befores, strict=True)
        if command != before or time_ns == last_ns
    ]
    times_s, speeds, turn_rates = zip(*kept, strict=True)
    values = {
        "law.kind": "open-loop",
        "law.signal": "sequence",
        "law.time_s": times_s,
        "law.speed_m_s": speeds,
        "law.turn_rate_rad_s": turn_rates,
    }
    return override_scenario(replace(scenario, law=LawChoice()), values, source=run.name)


def parse_assignments(assignments: Iterable[str], *, source: str = "changes") -> dict[str, Any]:
    """Return the values of `key=value` texts; a value is TOML, otherwise plain text.

    Raises:
        ScenarioError: If a text has no key or no equals sign.
    """
    values: dict[str, Any] = {}
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        if not equals or not all(key.strip().split(".")) or not text.strip():
            raise ScenarioError(f"{source}: expected key=value, found {assignment!r}")
        values[key.strip()] = _parse_value(text.strip())
    return values


def _parse_value(text: str) -> Any:
    try:
        return parse_toml(f"value = {text}")["value"]
    except ValueError:
        return float(text) if _SHORT_NUMBER.fullmatch(text) else text


_SHORT_NUMBER: Final = re.compile(r"[+-]?(\d+\.|\.\d+)([eE][+-]?\d+)?", re.ASCII)
"""Numbers that TOML refuses, but people type: `.5` and `5.`."""
