"""Random numbers of effects: one stream each, so that switching one off changes no other."""

from collections.abc import Callable
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

_NUMBERS: Final = {
    name: number
    for number, name in enumerate(
        (
            "noise",
            "dropout",
            "outlier",
            "sensing_jitter",
            "transport_jitter",
            "loss",
            "repeat",
            "late",
            "disturbance",
        )
    )
}
"""Number of each stream: with the seed it determines all that is drawn. New names come last."""

_BLOCK: Final = 256
"""Events drawn at once."""


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
