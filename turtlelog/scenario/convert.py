"""Nested tables to scenarios and back; the one place that judges keys and values."""

import dataclasses
import difflib
import math
import re
from collections.abc import Iterator, Mapping
from typing import Any, Literal, get_args, get_origin, get_type_hints

import msgspec

from turtlelog.errors import LawError, ScenarioError
from turtlelog.laws import find_law
from turtlelog.run import Parameter
from turtlelog.scenario.model import DEFAULT_LAW, LawChoice, Scenario

_INFINITE_KEYS = frozenset({"limits.speed_m_s", "limits.turn_rate_rad_s"})
_PLACE = re.compile(r"(?P<text>.*?)(?: - at `\$\.?(?P<key>.*)`)?", re.DOTALL)


def build_scenario(tables: Mapping[str, Any], *, source: str = "scenario") -> Scenario:
    """Return the scenario that nested tables describe; a key left out takes the textbook's value.

    Raises:
        ScenarioError: `source: key: expected ..., found ...`, for the first key that is wrong.
    """
    law_table = tables.get("law", {})
    if not isinstance(law_table, Mapping):
        raise ScenarioError(f"{source}: law: expected a table, found {law_table!r}")
    kind = law_table.get("kind", DEFAULT_LAW)
    try:
        law = find_law(kind) if isinstance(kind, str) else None
    except LawError as err:
        raise ScenarioError(f"{source}: law.kind: {err}") from err
    if law is None:
        raise ScenarioError(f"{source}: law.kind: expected text, found {kind!r}")
    rest = {key: value for key, value in tables.items() if key != "law"}
    own = {key: value for key, value in law_table.items() if key != "kind"}
    _require_sound(rest, Scenario, "", source)
    _require_sound(own, law.Parameters, "law.", source)
    parameters = _convert(own, law.Parameters, "law.", source)
    scenario: Scenario = _convert(rest, Scenario, "", source)
    return dataclasses.replace(scenario, law=LawChoice(kind=kind, parameters=parameters))


def flatten_scenario(scenario: Scenario) -> dict[str, Parameter]:
    """Return every value by its dotted key (`law.kp_linear`); what is None is left out."""
    return flatten_tables(nest_scenario(scenario))


def nest_scenario(scenario: Scenario) -> dict[str, Any]:
    """Return the scenario as the nested tables of its file."""
    tables = dataclasses.asdict(scenario)
    tables["law"] = {"kind": scenario.law.kind, **tables["law"]["parameters"]}
    return {key: _drop_none(value) for key, value in tables.items()}


def flatten_tables(tables: Mapping[str, Any]) -> dict[str, Parameter]:
    """Return the values of nested tables by dotted key."""
    return dict(_walk(tables, ""))


def _drop_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: inner for key, inner in value.items() if inner is not None}
    return value


def _walk(tables: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for key, value in tables.items():
        if isinstance(value, Mapping):
            yield from _walk(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _require_sound(table: Mapping[str, Any], kind: type, prefix: str, source: str) -> None:
    """Refuse unknown keys and nan or inf, which msgspec lets pass."""
    hints = get_type_hints(kind)
    for key, value in table.items():
        place = f"{prefix}{key}"
        if key not in hints:
            raise ScenarioError(f"{source}: {place}: {describe_unknown_key(key, list(hints))}")
        if isinstance(value, Mapping) and dataclasses.is_dataclass(hints[key]):
            _require_sound(value, hints[key], f"{place}.", source)
        infinite = isinstance(value, float) and math.isinf(value) and place not in _INFINITE_KEYS
        if isinstance(value, float) and (math.isnan(value) or infinite):
            raise ScenarioError(f"{source}: {place}: expected a finite number, found {value}")


def describe_unknown_key(key: str, known: list[str]) -> str:
    """Return the end of an error line for a key that is not known, with the nearest that are."""
    near = difflib.get_close_matches(key, known, n=2) or known
    return f"expected {' or '.join(near)}, found an unknown key"


def _convert(table: Mapping[str, Any], kind: type[Any], prefix: str, source: str) -> Any:
    try:
        return msgspec.convert(table, kind)
    except msgspec.ValidationError as err:
        matched = _PLACE.fullmatch(str(err))
        text, key = (matched["text"], matched["key"] or "") if matched else (str(err), "")
        raise ScenarioError(
            f"{source}: {prefix}{key}: {_describe(text, _find_choices(kind, key))},"
            f" found {_find_value(table, key)}"
        ) from err


def _describe(text: str, choices: tuple[str, ...]) -> str:
    """Put msgspec's words into ours: ``Expected `float` > 0.0`` to `expected a number > 0.0`."""
    if choices:
        return f"expected {' or '.join(choices)}"
    text = text.split(", got")[0].replace("`", "")
    for theirs, ours in _WORDS.items():
        text = text.replace(theirs, ours)
    return text


def _find_choices(kind: Any, key: str) -> tuple[str, ...]:
    """Return the words that a key allows, none where it takes any value of its type."""
    for part in key.split("."):
        kind = get_type_hints(kind).get(part) if dataclasses.is_dataclass(kind) else None
    return get_args(kind) if get_origin(kind) is Literal else ()


_WORDS = {
    "Expected": "expected",
    "float": "a number",
    "int": "a whole number",
    "str": "text",
    "bool": "true or false",
    "object": "a table",
}


def _find_value(table: Mapping[str, Any], key: str) -> str:
    value: Any = table
    for part in key.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return repr(value)
