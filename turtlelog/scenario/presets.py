"""The presets as tables of scenario files, and the values of tables by dotted key.

Apart from the reading of files, because an error about a missing file needs only the names.
"""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from turtlelog.errors import ScenarioError

if TYPE_CHECKING:
    from turtlelog.run import Parameter


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


PRESET_TABLES: Final[Mapping[str, Mapping[str, Any]]] = MappingProxyType(
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

PRESETS: Final = tuple(PRESET_TABLES)
"""Names of the presets: the paper's four recorded runs, the paper's controller with all effects,
the textbook loop, other laws in the textbook loop, a robot that is not turtlesim, and the plant
responses of the paper's figure 2."""

PAPER_RUNS: Final = ("paper-kp1", "paper-kp2", "paper-kp4", "paper-kp10")
"""The presets of the paper's experiment, by rising gain."""

DEFAULT_LAW: Final = "sequential-p"
"""Default of `law.kind`."""


def nest_parameters(parameters: "Mapping[str, Parameter]") -> dict[str, Any]:
    """Return values by dotted key as nested tables.

    Raises:
        ScenarioError: If a key is both a value and a table.
    """
    tables: dict[str, Any] = {}
    for key, value in parameters.items():
        set_nested(tables, key, value)
    lost = parameters.keys() - flatten_tables(tables).keys()
    if lost:
        raise ScenarioError(f"{min(lost)}: part of this key has a value already")
    return tables


def set_nested(tables: dict[str, Any], key: str, value: Any) -> None:
    """Set a value by its dotted key in nested tables; missing tables are created."""
    *parents, last = key.split(".")
    for depth, parent in enumerate(parents, start=1):
        tables = tables.setdefault(parent, {})
        if not isinstance(tables, dict):
            above = ".".join(parents[:depth])
            raise ScenarioError(f"{above}: expected a value, found a key below it")
    tables[last] = value


def flatten_tables(tables: Mapping[str, Any]) -> "dict[str, Parameter]":
    """Return the values of nested tables by dotted key."""
    found: dict[str, Any] = {}
    for key, value in tables.items():
        if isinstance(value, Mapping):
            found |= {f"{key}.{inner}": one for inner, one in flatten_tables(value).items()}
        else:
            found[key] = value
    return found
