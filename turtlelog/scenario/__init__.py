"""Scenario: everything that determines a run; TOML in and out; presets."""

from pathlib import Path

from turtlelog.errors import ScenarioError
from turtlelog.scenario.convert import (
    build_scenario,
    describe_unknown_key,
    flatten_scenario,
    flatten_tables,
    nest_parameters,
    nest_scenario,
    resolve_law,
    resolve_scenario,
    restore_scenario,
)
from turtlelog.scenario.model import (
    DEFAULT_LAW,
    LawChoice,
    LawTable,
    Limits,
    LoopSettings,
    Scenario,
    Start,
    Target,
)
from turtlelog.scenario.overrides import (
    complete_scenario,
    override_gains,
    override_scenario,
    parse_assignments,
)
from turtlelog.scenario.presets import PAPER_RUNS, PRESETS, get_preset, iterate_paper_runs
from turtlelog.scenario.toml import format_scenario, parse_scenario, read_scenario

__all__ = [
    "DEFAULT_LAW",
    "PAPER_RUNS",
    "PRESETS",
    "LawChoice",
    "LawTable",
    "Limits",
    "LoopSettings",
    "Scenario",
    "Start",
    "Target",
    "build_scenario",
    "complete_scenario",
    "describe_unknown_key",
    "flatten_scenario",
    "flatten_tables",
    "format_scenario",
    "get_preset",
    "iterate_paper_runs",
    "load_scenario",
    "nest_parameters",
    "nest_scenario",
    "override_gains",
    "override_scenario",
    "parse_assignments",
    "parse_scenario",
    "read_scenario",
    "resolve_law",
    "resolve_scenario",
    "restore_scenario",
]


def load_scenario(name_or_path: str | Path) -> Scenario:
    """Return a preset by its name, or the scenario in a TOML file.

    Raises:
        ScenarioError: Where it is neither, or the file is wrong.
    """
    name = str(name_or_path)
    if name in PRESETS:
        return get_preset(name)
    if not name.endswith(".toml") and not Path(name).is_file():
        presets = ", ".join(PRESETS)
        raise ScenarioError(f"{name}: expected a scenario file (.toml) or one of {presets}")
    return read_scenario(name_or_path)
