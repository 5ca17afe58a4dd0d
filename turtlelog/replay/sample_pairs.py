"""The signals of two tables of samples, paired row by row."""

from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.replay.difference import Pairing
from turtlelog.run import Run, SampleColumns

Rows = NDArray[np.int64] | slice

_Read = Callable[[SampleColumns], NDArray[np.float64] | None]

_NUMBERS: Final[Mapping[str, tuple[str, _Read]]] = MappingProxyType(
    {
        "wanted_speed": ("m/s", lambda samples: samples.wanted_speed_m_s),
        "wanted_turn_rate": ("rad/s", lambda samples: samples.wanted_turn_rate_rad_s),
        "speed": ("m/s", lambda samples: samples.speed_m_s),
        "turn_rate": ("rad/s", lambda samples: samples.turn_rate_rad_s),
        "bearing": ("rad", lambda samples: samples.bearing_rad),
        "heading_error": ("rad", lambda samples: samples.heading_error_rad),
        "error_x": ("m", lambda samples: samples.error_xy_m[:, 0]),
        "error_y": ("m", lambda samples: samples.error_xy_m[:, 1]),
        "distance": ("m", lambda samples: samples.distance_m),
        "world_v_x": ("m/s", lambda samples: samples.world_velocity_m_s[:, 0]),
        "world_v_y": ("m/s", lambda samples: samples.world_velocity_m_s[:, 1]),
    }
)
"""What a controller computes, as it computed it, by name: commands first, then errors."""

PUBLISHED: Final = ("command_speed", "command_lateral_speed", "command_turn_rate")
"""The signals of the commands as they were published."""

COMMANDS: Final = ("speed", "turn_rate", *PUBLISHED)
"""The signals that leave the controller: as samples tell them, and as published."""


def pair_samples(
    recorded: SampleColumns, replayed: SampleColumns, *, rows: Rows, others: Rows
) -> Iterator[Pairing]:
    """Yield the signals that both hold; `rows` of the one are beside `others` of the other."""
    time_ns = recorded.time_ns[rows]
    for name, (unit, read) in _NUMBERS.items():
        was, now = read(recorded), read(replayed)
        if was is not None and now is not None:
            yield Pairing(
                signal=name,
                unit=unit,
                time_ns=time_ns,
                recorded=was[rows],
                replayed=now[others],
                kind="angle" if name == "bearing" else "number",
            )
    yield Pairing(
        signal="phase",
        unit="1",
        time_ns=time_ns,
        recorded=recorded.phase[rows],
        replayed=replayed.phase[others],
        kind="phase",
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


def list_absent(recorded: SampleColumns) -> tuple[str, ...]:
    """Return the names of the signals that a recording does not hold."""
    return tuple(name for name, (_, read) in _NUMBERS.items() if read(recorded) is None)


def count_missing(samples: SampleColumns) -> int:
    """Return how many samples are missing before the last one, by their numbers from 0."""
    return int(samples.sequence[-1]) + 1 - len(samples) if len(samples) else 0


def has_all_commands(run: Run) -> bool:
    """Whether the n-th command is that of the n-th sample; the last may not have gone out."""
    samples, commands = len(run.samples), len(run.commands)
    return not samples or (not count_missing(run.samples) and samples - 1 <= commands <= samples)
