"""The signals of two tables of samples, paired row by row."""

from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from turtlelog.replay.differences import Difference, Pairing
from turtlelog.run import Run, SampleColumns
from turtlelog.run.loops import Declaration

Rows = NDArray[np.int64] | slice

_Read = Callable[[SampleColumns], NDArray[np.float64] | None]

_NUMBERS: Final[Mapping[str, tuple[str, _Read]]] = MappingProxyType(
    {
        "wanted_speed": ("m/s", lambda samples: samples.wanted_speed_m_s),
        "wanted_turn_rate": ("rad/s", lambda samples: samples.wanted_turn_rate_rad_s),
        "shaped_speed": ("m/s", lambda samples: samples.shaped_speed_m_s),
        "shaped_turn_rate": ("rad/s", lambda samples: samples.shaped_turn_rate_rad_s),
        "speed": ("m/s", lambda samples: samples.speed_m_s),
        "turn_rate": ("rad/s", lambda samples: samples.turn_rate_rad_s),
        "bearing": ("rad", lambda samples: samples.bearing_rad),
        "heading_error": ("rad", lambda samples: samples.heading_error_rad),
        "error_x": ("m", lambda samples: _take(samples.error_xy_m, 0)),
        "error_y": ("m", lambda samples: _take(samples.error_xy_m, 1)),
        "distance": ("m", lambda samples: samples.distance_m),
        "world_v_x": ("m/s", lambda samples: _take(samples.world_velocity_m_s, 0)),
        "world_v_y": ("m/s", lambda samples: _take(samples.world_velocity_m_s, 1)),
        "reference_x": ("m", lambda samples: _take(samples.reference_xy_m, 0)),
        "reference_y": ("m", lambda samples: _take(samples.reference_xy_m, 1)),
        "reference_heading": ("rad", lambda samples: samples.reference_heading_rad),
    }
)
"""What a controller computes, as it computed it, by name: commands first, then errors."""

_ANGLES: Final = frozenset({"bearing", "reference_heading"})
"""Signals whose values differ by less than half a turn."""

PUBLISHED: Final = ("command_speed", "command_lateral_speed", "command_turn_rate")
"""The signals of the commands as they were published."""

COMMANDS: Final = ("speed", "turn_rate", *PUBLISHED)
"""The signals that leave the controller: as samples tell them, and as published."""


class Answers(NamedTuple):
    """Samples, and the declaration that names their phases and states."""

    samples: SampleColumns
    declaration: Declaration


def pair_samples(
    recorded: Answers, replayed: Answers, *, rows: Rows, others: Rows
) -> Iterator[Pairing]:
    """Yield the signals that both hold; `rows` of the one are beside `others` of the other."""
    time_ns = recorded.samples.time_ns[rows]
    were, are = _read_numbers(recorded), _read_numbers(replayed)
    for name, (unit, was) in were.items():
        if name in are:
            yield Pairing(
                signal=name,
                unit=unit,
                time_ns=time_ns,
                recorded=was[rows],
                replayed=are[name][1][others],
                kind="angle" if name in _ANGLES else "number",
            )
    yield Pairing(
        signal="phase",
        unit="1",
        time_ns=time_ns,
        recorded=_name_phases(recorded)[rows],
        replayed=_name_phases(replayed)[others],
        kind="label",
    )


def _read_numbers(answers: Answers) -> dict[str, tuple[str, NDArray[np.float64]]]:
    """Return the unit and the column of each signal that there is, states by their names."""
    samples, names = answers
    found = {name: (unit, read(samples)) for name, (unit, read) in _NUMBERS.items()}
    found |= {
        name: (names.state_units.get(name, "1"), _take(samples.states, row))
        for row, name in enumerate(names.states)
    }
    return {name: (unit, column) for name, (unit, column) in found.items() if column is not None}


def _name_phases(answers: Answers) -> NDArray[np.str_]:
    return np.array(answers.declaration.phase_names)[answers.samples.phase]


def _take(columns: NDArray[np.float64] | None, row: int) -> NDArray[np.float64] | None:
    return None if columns is None else columns[:, row]


def compare_declarations(run: Run, replayed: Declaration) -> Difference | None:
    """Return how the declaration of the law that answers differs from the recorded one."""
    if run.declaration == replayed:
        return None
    was, now = _describe_declaration(run.declaration), _describe_declaration(replayed)
    parts = [(a, b) for a, b in zip(was, now, strict=True) if a != b]
    return Difference(
        signal="declaration",
        time_ns=run.start_ns,
        recorded="; ".join(a for a, _ in parts),
        replayed="; ".join(b for _, b in parts),
    )


def _describe_declaration(declaration: Declaration) -> tuple[str, ...]:
    loops = [
        f"{loop.name} ({loop.signal} by {loop.command} to {loop.reference},"
        f" gain {loop.gain or 'none'}{'' if loop.is_proportional else ', not proportional'},"
        f" limit {loop.limit_key})"
        for loop in declaration.loops
    ]
    phases = [
        f"{name} ({', '.join(acting) or 'no loop'})" for name, acting in declaration.phases.items()
    ]
    return (
        f"loops {', '.join(loops) or 'none'}",
        f"phases {', '.join(phases)}",
        f"states {', '.join(declaration.states) or 'none'}",
        "a goal" if declaration.uses_goal else "no goal",
    )


def pair_published(run: Run, answers: SampleColumns) -> Iterator[Pairing]:
    """Yield the commands as published beside what a law answers; none where they do not match.

    The n-th command is that of the sample with the number n.
    """
    if not has_published(run):
        return
    commands, numbers = run.commands, run.samples.sequence[: len(answers)]
    rows = np.flatnonzero(numbers < len(commands))
    none = np.zeros(len(answers))  # no law moves sideways
    sides = (
        ("m/s", commands.speed_m_s, answers.speed_m_s),
        ("m/s", commands.lateral_speed_m_s, none),
        ("rad/s", commands.turn_rate_rad_s, answers.turn_rate_rad_s),
    )
    for name, (unit, recorded, replayed) in zip(PUBLISHED, sides, strict=True):
        yield Pairing(
            signal=name,
            unit=unit,
            time_ns=commands.time_ns[numbers[rows]],
            recorded=recorded[numbers[rows]],
            replayed=replayed[rows],
        )


def has_published(run: Run) -> bool:
    """Whether there is one command per sample, lost samples included; the last may be missing."""
    count = int(run.samples.sequence[-1]) + 1
    return count - 1 <= len(run.commands) <= count


def list_absent(recorded: Answers, replayed: Answers) -> tuple[str, ...]:
    """Return the names of the signals that a replay has, and its recording does not."""
    held = _read_numbers(recorded)
    return tuple(name for name in _read_numbers(replayed) if name not in held)


def count_missing(samples: SampleColumns) -> int:
    """Return how many samples are missing before the last one, by their numbers from 0."""
    return int(samples.sequence[-1]) + 1 - len(samples) if len(samples) else 0


def has_all_commands(run: Run) -> bool:
    """Whether the n-th command is that of the n-th sample; the last may not have gone out."""
    samples, commands = len(run.samples), len(run.commands)
    return not samples or (not count_missing(run.samples) and samples - 1 <= commands <= samples)
