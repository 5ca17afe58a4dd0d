"""Random numbers of effects, in separate streams: removing one effect changes no other effect."""

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from operator import attrgetter
from types import MappingProxyType, SimpleNamespace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.effects import EFFECTS
from turtlelog.parts import Stream
from turtlelog.scenario import Scenario
from turtlelog.simulate.assemble import OF_TICKS, name_stream


def _list_streams() -> Iterator[tuple[str, Stream]]:
    for effect in EFFECTS:
        for place, action in effect.actions.items():
            if action.stream is not None:
                yield name_stream(effect, place), action.stream


STREAMS: Final[Mapping[str, Stream]] = MappingProxyType(dict(_list_streams()))
"""Streams of random numbers by the names of their rows in the loop."""

RANDOM_KEYS: Final[frozenset[str]] = frozenset(
    key for stream in STREAMS.values() for key in stream.keys
)
"""Scenario keys with random effects."""

_READ: Final = {name: tuple(map(attrgetter, one.keys)) for name, one in STREAMS.items()}

_BLOCK: Final = 256
"""Number of events whose random numbers are drawn at once."""


def list_streams(scenario: Scenario) -> frozenset[str]:
    """Return the names of the streams that a scenario uses."""
    return frozenset(name for name, keys in _READ.items() if any(read(scenario) for read in keys))


@cache
def build_row(stream: Stream) -> type[Any]:
    """Return the dataclass of the random numbers of a stream for one event."""
    found = [(name, float, dataclasses.field(default=0.0)) for name in stream.fields]
    return dataclasses.make_dataclass("Drawn", found, slots=True)


@cache
def list_of(*, ticks: bool) -> tuple[str, ...]:
    """Return the names of the streams whose events are poses, or samples."""
    return tuple(
        name_stream(effect, place)
        for effect in EFFECTS
        for place, action in effect.actions.items()
        if action.stream is not None and (place in OF_TICKS) == ticks
    )


@cache
def build_events(*, ticks: bool) -> type[Any]:
    """Return the dataclass of the numbers of all streams for one pose, or for one sample."""
    rows = {name: build_row(STREAMS[name]) for name in list_of(ticks=ticks)}
    found = [(name, row, dataclasses.field(default_factory=row)) for name, row in rows.items()]
    return dataclasses.make_dataclass("Events", found, slots=True)


class DrawnEvents:
    """The random numbers of the streams for poses, or for samples, by number of the event.

    The streams that a scenario does not use are None.
    """

    __slots__ = ("_event", "_number", "_streams")

    def __init__(self, seed: int, used: frozenset[str], *, ticks: bool) -> None:
        """Start the streams that a scenario uses."""
        self._event = SimpleNamespace(**dict.fromkeys(list_of(ticks=ticks)))
        self._streams = [
            (name, DrawnRows(seed, STREAMS[name])) for name in list_of(ticks=ticks) if name in used
        ]
        self._number = -1

    def __getitem__(self, number: int) -> Any:
        """Return the numbers of an event. Later calls cannot go back to earlier events."""
        if number != self._number:
            self._number = number
            for name, rows in self._streams:
                setattr(self._event, name, rows[number])
        return self._event


class DrawnRows:
    """The random numbers of a stream by number of the event.

    Numbers are generated for every event, used or not.
    """

    __slots__ = ("_draw", "_first", "_kind", "_rows", "_width")

    def __init__(self, seed: int, stream: Stream) -> None:
        """Start a stream from a scenario's seed."""
        self._draw, self._width = _begin_stream(seed, stream), len(stream.fields)
        self._kind, self._first = build_row(stream), 0
        self._rows: list[Any] = []

    def __getitem__(self, number: int) -> Any:
        """Return the numbers of an event. Later calls cannot go back to earlier events.

        Raises:
            IndexError: If a call goes back to an earlier event.
        """
        while number >= self._first + len(self._rows):
            self._first += len(self._rows)
            drawn = self._draw((_BLOCK, self._width)).tolist()
            self._rows = [self._kind(*row) for row in drawn]
        if number < self._first:
            raise IndexError(f"event {number} comes before {self._first}")
        return self._rows[number - self._first]


def draw_events(seed: int, stream: Stream, events: int) -> NDArray[np.float64]:
    """Return the random numbers of a stream's first events as one array, shape (events, width)."""
    width = len(stream.fields)
    return _begin_stream(seed, stream)((events, width)) if events else np.empty((0, width))


def _begin_stream(seed: int, stream: Stream) -> Callable[[tuple[int, int]], NDArray[np.float64]]:
    sequence = np.random.SeedSequence(entropy=seed, spawn_key=(stream.number,))
    generator = np.random.Generator(np.random.PCG64(sequence))
    return generator.random if stream.kind == "uniform" else generator.standard_normal
