"""A run as flat tables for spreadsheets and data frames, the unit in every column's name."""

from collections.abc import Callable, Mapping
from dataclasses import fields
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.run import CommandColumns, Event, Phase, PoseColumns, Run, SampleColumns

Table = Mapping[str, NDArray[Any]]
"""Columns by name, all of one length: float64, int64, or text as objects."""

_PAIRS: Final = MappingProxyType(
    {
        "xy_m": ("x_m", "y_m"),
        "error_xy_m": ("error_x_m", "error_y_m"),
        "world_velocity_m_s": ("world_velocity_x_m_s", "world_velocity_y_m_s"),
    }
)
"""What the two columns of a pair are called."""

TABLES: Final[Mapping[str, Callable[[Run], Table]]] = MappingProxyType(
    {
        "poses": lambda run: _flatten(run.poses),
        "commands": lambda run: _flatten(run.commands),
        "samples": lambda run: _flatten(run.samples),
        "events": lambda run: _tabulate_events(run.events),
    }
)
"""How each table of a run is made, by its name."""


def tabulate_run(run: Run) -> Mapping[str, Table]:
    """Return the tables of a run by name; a column that was not recorded is left out."""
    return {name: tabulate(run) for name, tabulate in TABLES.items()}


def _flatten(columns: PoseColumns | CommandColumns | SampleColumns) -> Table:
    table: dict[str, NDArray[Any]] = {}
    for column in fields(columns):
        values = getattr(columns, column.name)
        if values is None:
            continue
        if column.name in _PAIRS:
            table |= zip(_PAIRS[column.name], values.T, strict=True)
        elif column.name == "phase":
            labels = np.array([phase.label for phase in Phase], dtype=object)
            table["phase"] = labels[values]
        else:
            table[column.name] = values
    return table


def _tabulate_events(events: tuple[Event, ...]) -> Table:
    return {
        "time_ns": np.array([event.time_ns for event in events], dtype=np.int64),
        "kind": np.array([event.kind for event in events], dtype=object),
        "text": np.array([event.text for event in events], dtype=object),
    }
