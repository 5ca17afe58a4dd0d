"""Colours: one for a run in every view, told apart by colour-blind readers, best on dark ground."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.run import Phase

Color = tuple[int, int, int]

QUALITATIVE: Final[tuple[Color, ...]] = (
    (86, 180, 233),
    (0, 158, 115),
    (240, 228, 66),
    (213, 94, 0),
    (204, 121, 167),
    (230, 159, 0),
    (0, 114, 178),
)
"""The palette of Okabe and Ito without its black, which dark ground swallows."""

_RAMP: Final[tuple[Color, ...]] = (
    (112, 92, 200),
    (70, 130, 210),
    (40, 165, 165),
    (90, 195, 110),
    (190, 215, 60),
    (255, 235, 110),
)
"""Rises in lightness from end to end, so that order can be read from it."""

GROUND: Final[Color] = (13, 13, 13)
"""Of planes, also in a light theme; plots follow the theme, as their cursor does."""

REFERENCE: Final[Color] = (150, 150, 150)
"""Goal bearing, goal position, limits, world border."""

GOAL: Final[Color] = (255, 255, 255)

START: Final[Color] = (190, 190, 190)

MAIN: Final[Color] = QUALITATIVE[0]
"""What a single run did."""

SECOND: Final[Color] = QUALITATIVE[2]
"""The other coordinate, or what the plant applied."""

WANTED: Final[Color] = QUALITATIVE[3]
"""What the law asked for before clipping."""

IDEAL: Final[Color] = QUALITATIVE[1]
"""What the ideal loop would do."""

SAMPLED: Final[Color] = QUALITATIVE[4]
"""What the sampled loop with dead time would do."""

EVENT: Final[Color] = QUALITATIVE[5]
"""What happened once."""

ERROR: Final[Color] = QUALITATIVE[4]
"""From the turtle to the goal."""

MARK: Final[Color] = (165, 165, 165)
"""A metric where it has its place, to be seen on light ground too."""

NO_PHASE: Final = -1

TRACES: Final[Mapping[int, Color]] = MappingProxyType(
    {
        NO_PHASE: START,
        Phase.ROTATE: QUALITATIVE[0],
        Phase.PAUSE: QUALITATIVE[3],
        Phase.TRANSLATE: QUALITATIVE[1],
        Phase.DONE: START,
    }
)
"""The hues of the phases, light enough for a line."""

PHASES: Final[Mapping[Phase, Color]] = MappingProxyType(
    {
        Phase.ROTATE: (46, 96, 148),
        Phase.PAUSE: (140, 70, 20),
        Phase.TRANSLATE: (20, 110, 84),
        Phase.DONE: (90, 90, 90),
    }
)
"""Dark enough for the viewer's white lettering."""


def choose_run_colors(count: int) -> tuple[Color, ...]:
    """Return one colour per run: distinct hues for a few, a ramp in the order given for many."""
    if count <= len(QUALITATIVE):
        return QUALITATIVE[:count]
    return tuple(_mix_ramp(index / (count - 1)) for index in range(count))


def pack_colors(colors: Sequence[Color]) -> NDArray[np.uint32]:
    """Return opaque colours as Rerun takes them fastest, shape (n,)."""
    red, green, blue = np.array(colors, dtype=np.uint32).reshape(-1, 3).T
    return (red << 24 | green << 16 | blue << 8 | 255).astype(np.uint32)


def _mix_ramp(share: float) -> Color:
    place = share * (len(_RAMP) - 1)
    low = min(int(place), len(_RAMP) - 2)
    part = place - low
    red, green, blue = (
        round(first + part * (second - first))
        for first, second in zip(_RAMP[low], _RAMP[low + 1], strict=True)
    )
    return red, green, blue
