"""The colours of runs: one for a run on screen and on paper, seen on black and on white."""

from typing import Final

Color = tuple[int, int, int]

FEW: Final[tuple[Color, ...]] = (
    (0, 114, 178),
    (230, 159, 0),
    (0, 165, 120),
    (190, 112, 160),
    (213, 94, 0),
    (86, 180, 233),
    (156, 154, 0),
)
"""After Okabe and Ito, for colour-blind readers.

An olive stands for their yellow and black, of which one ground or the other swallows each; green
and purple are a shade off, so that the first four differ in grey by at least 0.08 of white.
"""

_RAMP: Final[tuple[Color, ...]] = (
    (94, 73, 190),
    (32, 138, 204),
    (12, 193, 160),
    (108, 194, 92),
    (188, 200, 42),
    (250, 206, 60),
)
"""Rises in lightness from end to end, so that order can be read from it, also in grey."""


def choose_run_colors(count: int) -> tuple[Color, ...]:
    """Return one colour per run: distinct hues for a few, a ramp in the order given for many."""
    if count <= len(FEW):
        return FEW[:count]
    return tuple(_mix_ramp(index / (count - 1)) for index in range(count))


def _mix_ramp(share: float) -> Color:
    place = share * (len(_RAMP) - 1)
    low = min(int(place), len(_RAMP) - 2)
    part = place - low
    red, green, blue = (
        round(first + part * (second - first))
        for first, second in zip(_RAMP[low], _RAMP[low + 1], strict=True)
    )
    return red, green, blue
