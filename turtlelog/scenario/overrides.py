"""Changing a scenario by dotted keys: `law.kp_linear=4`."""

import tomllib
from collections.abc import Iterable, Mapping
from typing import Any

from turtlelog.errors import ScenarioError
from turtlelog.scenario.convert import build_scenario, nest_scenario, set_nested
from turtlelog.scenario.model import Scenario


def override_scenario(
    scenario: Scenario, values: Mapping[str, Any], *, source: str = "changes"
) -> Scenario:
    """Return the scenario with values set by dotted key, checked like a file.

    A new `law.kind` drops the old law's parameters.

    Raises:
        ScenarioError: Where a key or value is wrong.
    """
    tables = nest_scenario(scenario)
    if "law.kind" in values and values["law.kind"] != scenario.law.kind:
        tables["law"] = {}
    for key, value in values.items():
        try:
            set_nested(tables, key, value)
        except ScenarioError as err:
            raise ScenarioError(f"{source}: {err}") from err
    return build_scenario(tables, source=source)


def parse_assignments(assignments: Iterable[str], *, source: str = "changes") -> dict[str, Any]:
    """Return the values of `key=value` texts; a value is TOML, or plain text where it is none.

    Raises:
        ScenarioError: Where one has no key or no equals sign.
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
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        return text
