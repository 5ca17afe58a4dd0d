"""A run as flat tables for spreadsheets and data frames, the unit in every column's name."""

from collections.abc import Callable, Mapping
from dataclasses import fields
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.run import CommandColumns, Event, PoseColumns, Run, SampleColumns

Table = Mapping[str, NDArray[Any]]
"""Columns by name, all of one length: float64, int64, or text as objects."""

_PAIRS: Final = MappingProxyType(
    {
        "xy_m": ("x_m", "y_m"),
        "error_xy_m": ("error_x_m", "error_y_m"),
        "world_velocity_m_s": ("world_velocity_x_m_s", "world_velocity_y_m_s"),
        "reference_xy_m": ("reference_x_m", "reference_y_m"),
    }
)
"""What the two columns of a pair are called."""

_SAMPLES: Final = (
    *("time_ns", "sequence", "pose_sequence", "phase", "bearing_rad", "heading_error_rad"),
    *("error_xy_m", "distance_m", "speed_m_s", "turn_rate_rad_s", "world_velocity_m_s"),
    *("wanted_speed_m_s", "wanted_turn_rate_rad_s", "reference_xy_m", "reference_heading_rad"),
)
"""Columns of samples in order, the law's states apart."""

TABLES: Final[Mapping[str, Callable[[Run], Table]]] = MappingProxyType(
    {
        "poses": lambda run: _flatten(run.poses),
        "commands": lambda run: _flatten(run.commands),
        "samples": lambda run: _tabulate_samples(run),
        "events": lambda run: _tabulate_events(run.events),
    }
)
"""How each table of a run is made, by its name."""


def tabulate_run(run: Run) -> Mapping[str, Table]:
    """Return the tables of a run by name; a column that was not recorded is left out."""
    return {name: tabulate(run) for name, tabulate in TABLES.items()}


def _flatten(columns: PoseColumns | CommandColumns | SampleColumns) -> Table:
    table: dict[str, NDArray[Any]] = {}
    names = [column.name for column in fields(columns)]
    for name in _SAMPLES if isinstance(columns, SampleColumns) else names:
        values = getattr(columns, name)
        if values is None:
            continue
        if name in _PAIRS:
            table |= zip(_PAIRS[name], values.T, strict=True)
        else:
            table[name] = values
    return table


def _tabulate_samples(run: Run) -> Table:
    """Return the samples with the names of their phases, and a column for each state of the law.

    A state that is called like another column has `state_` in front.
    """
    labels = np.array(run.phase_names, dtype=object)
    table = dict(_flatten(run.samples)) | {"phase": labels[run.samples.phase]}
    states = () if run.samples.states is None else run.samples.states.T
    for name, values in zip(run.declaration.states, states, strict=True):
        table[name if name not in table else f"state_{name}"] = values
    return table


def _tabulate_events(events: tuple[Event, ...]) -> Table:
    return {
        "time_ns": np.array([event.time_ns for event in events], dtype=np.int64),
        "kind": np.array([event.kind for event in events], dtype=object),
        "text": np.array([event.text for event in events], dtype=object),
    }
