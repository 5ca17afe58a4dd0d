"""Scenarios by name: those that come with turtlelog as tables, and TOML files in and out."""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from turtlelog.errors import ScenarioError, describe_unknown
from turtlelog.files.text_files import describe_missing, format_toml, parse_toml, read_text_file
from turtlelog.files.urls import make_path
from turtlelog.scenario.model import Scenario
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
    if name not in _PRESET_TABLES:
        raise ScenarioError(f"preset: expected one of {', '.join(PRESETS)}, found {name!r}")
    return build_scenario(_PRESET_TABLES[name], source=name)


def iterate_paper_runs() -> Iterator[Scenario]:
    """Yield the scenarios of the paper's experiment, by rising gain."""
    return (get_preset(name) for name in PAPER_RUNS)


def _describe_paper_run(
    name: str, kp: float, start_backlog: int, pause_ticks: int
) -> dict[str, Any]:
    return {
        "name": name,
        "law": {
            "kind": "sequential-p",
            "kp_angular": kp,
            "kp_linear": kp,
            "projection": "bearing",
            "wrap_error": False,
            "pause_ticks": pause_ticks,
        },
        "loop": {"start_backlog": start_backlog, "queue_policy": "one-per-tick"},
    }


def _describe_plant_run(signal: str, **more: float) -> dict[str, Any]:
    law = {"kind": "open-loop", "signal": signal, "axis": "turn_rate", "amplitude": 1.0}
    return {
        "name": f"plant-{signal}",
        "law": {**law, "start_s": 0.0, "duration_s": 2.4, **more},
        "limits": {"speed_m_s": math.inf, "turn_rate_rad_s": math.inf},
    }


_PRESET_TABLES: Final[Mapping[str, Mapping[str, Any]]] = MappingProxyType(
    {
        "paper-kp1": _describe_paper_run("paper-kp1", 1.0, 6, 34),
        "paper-kp2": _describe_paper_run("paper-kp2", 2.0, 5, 34),
        "paper-kp4": _describe_paper_run("paper-kp4", 4.0, 6, 34),
        "paper-kp10": _describe_paper_run("paper-kp10", 10.0, 5, 33),
        "paper": _describe_paper_run("paper", 1.0, 5, 33),
        "textbook": {"name": "textbook"},
        "posture": {
            "name": "posture",
            "goal": {"heading_rad": math.pi / 2.0},
            "law": {"kind": "posture"},
        },
        "track-square": {
            "name": "track-square",
            "start": {"x_m": 3.0, "y_m": 3.0},
            "law": {"kind": "pure-pursuit"},
            "path": {
                "kind": "polygon",
                "points": [[3.0, 3.0], [8.0, 3.0], [8.0, 8.0], [3.0, 8.0]],
                "speed_m_s": 0.5,
            },
        },
        "lagged": {
            "name": "lagged",
            "plant": {
                "kind": "lagged",
                "period_s": 0.05,
                **dict.fromkeys(("speed_dead_time_s", "turn_dead_time_s"), 0.08),
                **dict.fromkeys(("speed_lag_s", "turn_lag_s"), 0.1),
            },
        },
        "plant-impulse": _describe_plant_run("impulse", width_s=0.016),
        "plant-step": _describe_plant_run("step"),
        "plant-ramp": _describe_plant_run("ramp"),
    }
)
"""The tables of each preset, as in a scenario file."""

PRESETS: Final = tuple(_PRESET_TABLES)
"""Names of the presets: the paper's four recorded runs, its controller as built, the textbook's,
other laws in the textbook's loop, a robot that is not turtlesim, and the plant's responses of the
paper's figure 2."""

PAPER_RUNS: Final = ("paper-kp1", "paper-kp2", "paper-kp4", "paper-kp10")
"""The presets of the paper's experiment, by rising gain."""
