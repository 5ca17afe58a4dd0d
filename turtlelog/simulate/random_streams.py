"""Random numbers of effects: one stream each, so that switching one off changes no other."""

from collections.abc import Callable, Mapping
from operator import attrgetter
from types import MappingProxyType
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from turtlelog.scenario import Scenario

RANDOM_KEYS: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "noise": ("sensing.noise_position_m", "sensing.noise_heading_rad"),
        "dropout": ("sensing.dropout_probability",),
        "outlier": ("sensing.outlier_probability",),
        "sensing_jitter": ("sensing.jitter_s",),
        "transport_jitter": ("loop.jitter_s",),
        "loss": ("loop.loss_probability",),
        "repeat": ("loop.repeat_probability",),
        "late": ("loop.late_probability",),
        "disturbance": ("disturbance.noise_speed", "disturbance.noise_turn_rate"),
    }
)
"""The keys of each stream's effect: where all of them are 0, none of its numbers is used.

The place of a name here and the seed determine all that is drawn. New names come last.
"""

_NUMBERS: Final = {name: number for number, name in enumerate(RANDOM_KEYS)}
_READ: Final = {name: tuple(attrgetter(key) for key in keys) for name, keys in RANDOM_KEYS.items()}

_BLOCK: Final = 256
"""Events drawn at once."""


def list_streams(scenario: Scenario) -> frozenset[str]:
    """Return the names of the streams whose numbers a scenario uses."""
    return frozenset(name for name, keys in _READ.items() if any(read(scenario) for read in keys))


class RandomStream:
    """The random numbers of one effect by the number of the event that they belong to.

    They are drawn for every event, whether it uses them or not.
    """

    __slots__ = ("_draw", "_first", "_rows", "_width")

    def __init__(
        self, seed: int, name: str, *, width: int = 1, kind: Literal["uniform", "normal"]
    ) -> None:
        """Begin a stream.

        Args:
            seed: Of the scenario.
            name: Of the stream.
            width: Numbers for each event.
            kind: `uniform`: from 0 to below 1; `normal`: of mean 0 and standard deviation 1.
        """
        self._draw = _begin_stream(seed, name, kind)
        self._width = width
        self._first = 0
        self._rows: list[list[float]] = []

    def draw(self, number: int) -> list[float]:
        """Return the numbers of an event; a later call asks for no earlier event.

        Raises:
            IndexError: Where it does.
        """
        while number >= self._first + len(self._rows):
            self._first += len(self._rows)
            self._rows = self._draw((_BLOCK, self._width)).tolist()
        if number < self._first:
            raise IndexError(f"event {number} comes before {self._first}")
        return self._rows[number - self._first]


def draw_events(
    seed: int, name: str, events: int, *, width: int, kind: Literal["uniform", "normal"]
) -> NDArray[np.float64]:
    """Return the numbers of the first events of a stream at once, shape (events, width)."""
    if not events:
        return np.empty((0, width))
    return _begin_stream(seed, name, kind)((events, width))


def _begin_stream(
    seed: int, name: str, kind: Literal["uniform", "normal"]
) -> Callable[[tuple[int, int]], NDArray[np.float64]]:
    sequence = np.random.SeedSequence(entropy=seed, spawn_key=(_NUMBERS[name],))
    generator = np.random.Generator(np.random.PCG64(sequence))
    return generator.random if kind == "uniform" else generator.standard_normal
