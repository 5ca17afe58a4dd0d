"""Scenarios that come with turtlelog, by name."""

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any, Final

from turtlelog.scenario.convert import build_scenario
from turtlelog.scenario.model import Scenario


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


_TABLES: Final[Mapping[str, Mapping[str, Any]]] = MappingProxyType(
    {
        "paper-kp1": _describe_paper_run("paper-kp1", 1.0, 6, 34),
        "paper-kp2": _describe_paper_run("paper-kp2", 2.0, 5, 34),
        "paper-kp4": _describe_paper_run("paper-kp4", 4.0, 6, 34),
        "paper-kp10": _describe_paper_run("paper-kp10", 10.0, 5, 33),
        "paper": _describe_paper_run("paper", 1.0, 5, 33),
        "textbook": {"name": "textbook"},
    }
)

PRESETS: Final = tuple(_TABLES)
"""Names of the presets: the paper's four recorded runs, its controller as built, the textbook's."""

PAPER_RUNS: Final = ("paper-kp1", "paper-kp2", "paper-kp4", "paper-kp10")
"""The presets of the paper's experiment, by rising gain."""


def get_preset(name: str) -> Scenario:
    """Return a preset; KeyError where there is none of that name."""
    return build_scenario(_TABLES[name], source=name)


def iterate_paper_runs() -> Iterator[Scenario]:
    """Yield the scenarios of the paper's experiment, by rising gain."""
    return (get_preset(name) for name in PAPER_RUNS)
