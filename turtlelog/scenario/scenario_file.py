"""Scenarios by name: presets, and TOML files in and out."""

from collections.abc import Iterator
from pathlib import Path

from turtlelog.errors import ScenarioError, describe_unknown
from turtlelog.files.text_files import describe_missing, format_toml, parse_toml, read_text_file
from turtlelog.files.urls import make_path
from turtlelog.scenario.model import Scenario
from turtlelog.scenario.presets import PAPER_RUNS, PRESET_TABLES, PRESETS
from turtlelog.scenario.table_conversion import build_scenario, nest_scenario
from turtlelog.scenario.table_files import embed_files


def load_scenario(name_or_path: str | Path) -> Scenario:
    """Return a preset by its name, or the scenario in a TOML file.

    Raises:
        ScenarioError: If it is neither, or the file is wrong.
    """
    name = str(name_or_path)
    if name in PRESETS:
        return get_preset(name)
    path = make_path(name)
    if path.suffix != ".toml" and not path.is_file():
        if path.is_dir():
            raise ScenarioError(f"{name}: a folder, not a scenario file (.toml)")
        place = "turtlelog list presets"
        raise ScenarioError(describe_unknown("preset or file", name, PRESETS, place=place))
    return read_scenario(name_or_path)


def read_scenario(path: str | Path) -> Scenario:
    """Return the scenario in a TOML file, with the numbers of the files that it names.

    Raises:
        ScenarioError: If the file cannot be read, is no TOML, or a key or value is wrong.
    """
    try:
        text = read_text_file(path)
    except UnicodeDecodeError as err:
        raise ScenarioError(f"{path}: not TOML, not even text") from err
    except FileNotFoundError as err:
        raise ScenarioError(f"{path}: {describe_missing(path, PRESETS)}") from err
    except (OSError, ValueError) as err:
        found = getattr(err, "strerror", None) or err
        raise ScenarioError(f"{path}: expected a scenario file, found: {found}") from err
    path = make_path(path)
    return _build(text, str(path), path)


def parse_scenario(text: str, *, source: str = "scenario") -> Scenario:
    """Return the scenario that a TOML text describes. The text is the user's own: its law may run.

    A text lies in no folder: it names no file of commands.

    Raises:
        ScenarioError: If it is no TOML, or a key or value is wrong.
    """
    return _build(text, source, None)


def _build(text: str, source: str, path: Path | None) -> Scenario:
    try:
        tables = parse_toml(text)
    except ValueError as err:
        raise ScenarioError(f"{source}: not TOML: {err}") from err
    tables = tables if path is None else embed_files(tables, path)
    return build_scenario(tables, source=source, trust_law=True)


def format_scenario(scenario: Scenario) -> str:
    """Return the TOML text of a scenario; `parse_scenario` gives the same scenario back."""
    return format_toml(nest_scenario(scenario))


def get_preset(name: str) -> Scenario:
    """Return a preset.

    Raises:
        ScenarioError: If there is none of that name.
    """
    if name not in PRESET_TABLES:
        raise ScenarioError(f"preset: expected one of {', '.join(PRESETS)}, found {name!r}")
    return build_scenario(PRESET_TABLES[name], source=name)


def iterate_paper_runs() -> Iterator[Scenario]:
    """Yield the scenarios of the paper's experiment, by rising gain."""
    return (get_preset(name) for name in PAPER_RUNS)
