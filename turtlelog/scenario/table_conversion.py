"""Nested tables to scenarios and back; the only place that validates keys and values."""

import copy
import dataclasses
import math
import re
from collections.abc import Iterator, Mapping
from datetime import date, time
from functools import cache
from typing import Any, get_args, get_type_hints

import msgspec

from turtlelog import laws
from turtlelog.effects import EFFECTS
from turtlelog.effects.delay import judge_delays
from turtlelog.errors import (
    LawError,
    ParameterError,
    PathError,
    ScenarioError,
    describe_error,
    find_near,
    join_names,
)
from turtlelog.files.text_files import describe_type, describe_value, name_key
from turtlelog.parts import Complaint
from turtlelog.plants import PLANTS
from turtlelog.run import Parameter, Run
from turtlelog.scenario.model import LawChoice, LawTable, Scenario, require_scenario
from turtlelog.scenario.presets import DEFAULT_LAW, flatten_tables, nest_parameters

_LONGEST_KIND = 300
"""Longest path and class that are shown in full, so that users can look at them before they trust
them."""

_PLAIN = frozenset({float, int, str, bool})

_MISSING = re.compile(r"Object missing required field `(\w+)`")
_PLACE = re.compile(r" - at `\$\.(.*)`$")


def build_scenario(
    tables: Mapping[str, Any], *, source: str = "scenario", trust_law: bool = False
) -> Scenario:
    """Return the scenario in nested tables; a missing key has the default value.

    No code is loaded: the table of a law that is not built in is validated when the law runs.

    Args:
        tables: Tables of a scenario file.
        source: Beginning of error lines.
        trust_law: Whether a law that is not built in may run, because the user named it. A
            recording does not count as the user.

    Raises:
        ScenarioError: If a key is wrong. The message describes the first wrong key: `source: key:
            expected ..., found ...`.
    """
    law_table = tables.get("law", {})
    if not isinstance(law_table, Mapping):
        raise ScenarioError(f"{source}: law: expected a table, found {describe_value(law_table)}")
    kind = law_table.get("kind", DEFAULT_LAW)
    if not isinstance(kind, str):
        raise ScenarioError(f"{source}: law.kind: expected text, found {describe_value(kind)}")
    if "checks" in tables:
        raise ScenarioError(
            f"{source} is a specification, not a scenario: turtlelog check {source} FILE..."
        )
    rest = {key: value for key, value in tables.items() if key != "law"}
    own = {key: value for key, value in law_table.items() if key != "kind"}
    _require_sound(rest, Scenario, "", source)
    law = LawChoice(
        kind=kind, parameters=LawTable(values=own, sources=(source,), is_trusted=trust_law)
    )
    try:
        laws.require_law_name(kind)
    except LawError as err:
        raise ScenarioError(f"{source}: law.kind: {err}") from err
    if kind in laws.LAWS:
        law = resolve_law(law)
    scenario: Scenario = _convert(rest, Scenario, "", source)
    _require_consistent(scenario, source)
    return dataclasses.replace(scenario, law=law)


def resolve_scenario(scenario: Scenario, *, trust_law: bool = False) -> Scenario:
    """Return the scenario with the parameters of its law, whose code is loaded if necessary.

    Raises:
        ScenarioError: If `resolve_law` raises it.
    """
    require_scenario(scenario)
    return dataclasses.replace(scenario, law=resolve_law(scenario.law, trust_law=trust_law))


def resolve_law(choice: LawChoice, *, trust_law: bool = False) -> LawChoice:
    """Return a choice with the law's own parameters. Only this function loads a named law.

    Args:
        choice: Choice of the law; returned unchanged if it already has parameters.
        trust_law: Whether a law named only by a recording may run.

    Raises:
        ScenarioError: If only a recording names the law and the law is not trusted, if the law does
            not exist, or if it does not accept these keys and values.
    """
    table = choice.parameters
    if not isinstance(table, LawTable):
        return choice
    if choice.kind not in laws.LAWS and not (table.is_trusted or trust_law):
        raise ScenarioError(
            f"{table.sources[0]}: law.kind: expected a built-in law, or --trust-law (in Python and"
            " pytest trust_law=True) to run the code that the file names,"
            f" found {describe_value(choice.kind, longest=_LONGEST_KIND)}"
        )
    try:
        law = laws.find_law(choice.kind)
    except LawError as err:
        raise ScenarioError(f"{table.sources[0]}: law.kind: {err}") from err
    return LawChoice(kind=choice.kind, parameters=_build_parameters(table, law))


def _build_parameters(table: LawTable, law: laws.AnyLaw) -> Any:
    """Return a law's parameters, valid in a scenario file. Defaults may have any value."""
    kind, source = law.Parameters, ", ".join(table.sources)
    try:
        with laws.print_to_stderr():
            _require_sound(table.values, kind, "law.", source)
            parameters = _convert(table.values, kind, "law.", source)
            if law not in laws.LAWS.values():
                written = _write_value(_nest_values(parameters), f"{source}: law")
                _require_sound(written, kind, "law.", source)
                _convert(written, kind, "law.", source)
    except (ScenarioError, KeyboardInterrupt):
        raise
    except BaseException as err:  # what the law's own code raises
        raise ScenarioError(f"{source}: law: {laws.describe_law_error(err, law)}") from err
    return parameters


def _write_value(value: Any, place: str) -> Any:
    if isinstance(value, Mapping):
        return {key: _write_value(entry, f"{place}.{key}") for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_write_value(entry, place) for entry in value]
    if isinstance(value, float):
        return float(value)
    if isinstance(value, bool | int | str | date | time):
        return value
    expected = "a number, text, true or false, a date, a list or a table"
    raise ScenarioError(f"{place}: expected {expected}, found {describe_value(value)}")


def flatten_scenario(scenario: Scenario) -> dict[str, Parameter]:
    """Return every value by its dotted key (`law.kp_linear`), without None."""
    return flatten_tables(nest_scenario(scenario))


def nest_scenario(scenario: Scenario) -> dict[str, Any]:
    """Return the scenario as the nested tables of its file."""
    tables: dict[str, Any] = _nest_values(dataclasses.replace(scenario, law=LawChoice()))
    own = scenario.law.parameters
    own = copy.deepcopy(dict(own.values)) if isinstance(own, LawTable) else _nest_values(own)
    given = {key: value for key, value in own.items() if value is not None}
    tables["law"] = {"kind": scenario.law.kind, **given}
    return tables


def _nest_values(value: Any) -> Any:
    """Return a value in the form of a file: dataclasses as tables, tuples as lists, without None.

    Keys that files omit are left out if they have their defaults.
    """
    if type(value) in _PLAIN:
        return value
    if isinstance(value, tuple | list):
        return [_nest_values(entry) for entry in value]
    if isinstance(value, Mapping):
        return {key: _nest_values(entry) for key, entry in value.items()}
    if not dataclasses.is_dataclass(value):
        return copy.deepcopy(value)
    kind: Any = type(value)
    return {
        field.name: _nest_values(found)
        for field, may_be_absent in _list_fields(kind)
        if (found := getattr(value, field.name)) is not None
        and not (may_be_absent and found == field.default)
    }


@cache
def _list_fields(kind: type[Any]) -> list[tuple[dataclasses.Field[Any], bool]]:
    """Return the fields of a dataclass, and whether files omit the default of each field."""
    return [
        (field, not laws.ABSENT_BY_DEFAULT.keys().isdisjoint(field.metadata))
        for field in dataclasses.fields(kind)
    ]


def restore_scenario(run: Run, *, source: str = "", trust_law: bool = False) -> Scenario:
    """Return the scenario of a run. No code is loaded.

    Args:
        run: Run with its whole scenario.
        source: Beginning of error lines. Default: the name of the run.
        trust_law: Whether a recorded law that is not built in may run. Running it executes code
            that the run, or its file, names.

    Raises:
        ScenarioError: If the run does not contain the whole scenario.
    """
    if not run.scenario_is_complete:
        raise ScenarioError(
            f"{source or run.name}: expected a run with its whole scenario, found {run.source}"
            f" without {_list_unknown(run)}: --scenario gives the rest from another"
        )
    tables = nest_parameters(run.parameters)
    return build_scenario(tables, source=source or run.name, trust_law=trust_law)


def describe_unknown_key(key: str, known: list[str]) -> str:
    """Return the end of an error line for an unknown key, with the nearest known keys."""
    return f"unknown key; {_advise_key(key, known)}"


def _advise_key(key: str, known: list[str]) -> str:
    near = find_near(key, known)
    return f"did you mean {join_names(near)}?" if near else f"there are {join_names(known)}"


def _list_unknown(run: Run) -> str:
    """Return keys that a run lacks, the law's keys first, and the number of keys not listed."""
    keys = sorted(flatten_scenario(Scenario()).keys() - run.parameters.keys())
    keys.sort(key=lambda key: not key.startswith("law."))
    return f"{', '.join(keys[:4])} and {len(keys[4:])} more"


def _require_sound(table: Mapping[str, Any], kind: type, prefix: str, source: str) -> None:
    """Raise an error for unknown keys and for NaN or infinity, which msgspec accepts."""
    known = _list_keys(kind)
    for key, value in table.items():
        place = f"{prefix}{name_key(key)}"
        if key not in known:
            advice = _advise_key(key, list(known))
            unknown = f"{source}: {place}: unknown key; {advice}"
            raise ScenarioError(unknown, unknown_key=place, advice=advice)
        inner, may_be_infinite = known[key]
        if isinstance(value, Mapping) and inner is not None:
            _require_sound(value, inner, f"{place}.", source)
        infinite = isinstance(value, float) and math.isinf(value) and not may_be_infinite
        if isinstance(value, float) and (math.isnan(value) or infinite):
            raise ScenarioError(f"{source}: {place}: expected a finite number, found {value}")


@cache
def _list_keys(kind: type[Any]) -> Mapping[str, tuple[type | None, bool]]:
    """Return the keys of a table. Each key has its subtable, if any, and whether it may be inf."""
    unlimited = {
        one.name
        for one in dataclasses.fields(kind)
        if one.default == math.inf or one.metadata.keys() & laws.MAY_BE_INFINITE.keys()
    }
    hints = get_type_hints(kind)
    return {key: (_find_table(hint), key in unlimited) for key, hint in hints.items()}


def _find_table(hint: Any) -> type | None:
    """Return the dataclass that a type requires, also if the dataclass is optional."""
    if dataclasses.is_dataclass(hint):
        return hint if isinstance(hint, type) else None
    kinds = [found for kind in get_args(hint) if (found := _find_table(kind)) is not None]
    is_optional = type(None) in get_args(hint) and len(get_args(hint)) == len(kinds) + 1
    return kinds[0] if is_optional and len(kinds) == 1 else None


def _convert(table: Mapping[str, Any], kind: type[Any], prefix: str, source: str) -> Any:
    """Convert tables with msgspec; its errors give the place, the type gives the expected value."""
    try:
        return msgspec.convert(table, kind)
    except msgspec.ValidationError as err:
        place = _PLACE.search(str(err))
        path = f"{prefix}{place[1]}" if place else prefix.rstrip(".")
        if isinstance(err.__cause__, ParameterError | PathError):  # it begins with its key
            raise ScenarioError(f"{source}: {path}.{err.__cause__}") from err
        if err.__cause__ is not None:  # a dataclass that judges its values itself
            raise ScenarioError(f"{source}: {path}: {describe_error(err.__cause__)}") from err
        missing = _MISSING.match(str(err))
        keys = (place[1].split(".") if place else []) + ([missing[1]] if missing else [])
        try:
            hint, value = _find_value(table, kind, keys)
        except (KeyError, TypeError):  # within a list, or one of several types
            found = str(err).removesuffix(place[0] if place else "").replace("`", "")
            found = found[:1].lower() + found[1:].replace(", got ", ", found ")
            raise ScenarioError(f"{source}: {path}: {found}") from err
        raise ScenarioError(
            f"{source}: {prefix}{'.'.join(keys)}: expected {describe_type(hint)},"
            f" found {describe_value(value)}"
        ) from err


def _find_value(table: Any, kind: Any, keys: list[str]) -> tuple[Any, Any]:
    for key in keys:
        table = table.get(key) if isinstance(table, Mapping) else None
        kind = get_type_hints(_find_table(kind) or kind, include_extras=True)[key]
    return kind, table


def _require_consistent(scenario: Scenario, source: str) -> None:
    """Raise an error if values contradict each other; parameters of the law are not checked."""
    of_effects = [effect.judge for effect in EFFECTS if effect.judge is not None]
    for judge in (_judge_places, _judge_path, *of_effects, _judge_dead_times):
        for key, expected, found in judge(scenario):
            raise ScenarioError(f"{source}: {key}: expected {expected}, found {found}")


def _judge_places(scenario: Scenario) -> Iterator[Complaint]:
    low_m, high_m = scenario.plant.facts.low_m, scenario.plant.facts.high_m
    expected = f"a number from {low_m:.10g} to {high_m:.10g}"
    for table in ("start", "goal"):
        for name in ("x_m", "y_m"):
            value = getattr(getattr(scenario, table), name)
            if not low_m <= value <= high_m:
                yield f"{table}.{name}", expected, f"{value:.10g}"


def _judge_path(scenario: Scenario) -> Iterator[Complaint]:
    if scenario.path is None:
        return
    low_m, high_m = scenario.plant.facts.low_m, scenario.plant.facts.high_m
    bounds_m = scenario.path.bounds_m
    for name, least_m, most_m in (("x", *bounds_m[:2]), ("y", *bounds_m[2:])):
        if least_m < low_m or most_m > high_m:
            within = f"{name} from {low_m:.10g} to {high_m:.10g} m"
            yield "path", within, f"{least_m:.10g} to {most_m:.10g} m"


def _judge_dead_times(scenario: Scenario) -> Iterator[Complaint]:
    keys = PLANTS[scenario.plant.kind].delays
    delays = {f"plant.{key}": getattr(scenario.plant, key) for key in keys}
    yield from judge_delays(delays, scenario.max_duration_s)
