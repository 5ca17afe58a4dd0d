"""Scenario files: TOML in and out."""

import tomllib
from pathlib import Path

import tomli_w

from turtlelog.errors import ScenarioError, describe_error
from turtlelog.scenario.convert import build_scenario, nest_scenario
from turtlelog.scenario.model import Scenario


def parse_scenario(text: str, *, source: str = "scenario") -> Scenario:
    """Return the scenario that a TOML text describes. The text is the user's own: its law may run.

    Raises:
        ScenarioError: Where it is no TOML, or a key or value is wrong.
    """
    try:
        tables = tomllib.loads(text)
    except (ValueError, RecursionError) as err:
        raise ScenarioError(f"{source}: expected TOML, found: {describe_error(err)}") from err
    return build_scenario(tables, source=source, trust_law=True)


def format_scenario(scenario: Scenario) -> str:
    """Return the TOML text of a scenario; `parse_scenario` gives the same scenario back."""
    return tomli_w.dumps(nest_scenario(scenario))


def read_scenario(path: str | Path) -> Scenario:
    """Return the scenario in a TOML file.

    Raises:
        ScenarioError: Where the file cannot be read, is no TOML, or a key or value is wrong.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as err:
        raise ScenarioError(f"{path}: expected TOML, found bytes that are no text") from err
    except (OSError, ValueError) as err:
        found = getattr(err, "strerror", None) or err
        raise ScenarioError(f"{path}: expected a scenario file, found: {found}") from err
    return parse_scenario(text, source=str(path))
