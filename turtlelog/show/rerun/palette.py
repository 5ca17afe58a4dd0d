"""The colours of what is no run of its own, told apart by colour-blind readers on dark ground."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.run import Phase
from turtlelog.show.run_colors import Color, choose_run_colors

_OKABE_ITO: Final[tuple[Color, ...]] = (
    (86, 180, 233),
    (0, 158, 115),
    (240, 228, 66),
    (213, 94, 0),
    (204, 121, 167),
    (230, 159, 0),
    (0, 114, 178),
)
"""The palette of Okabe and Ito without its black, which dark ground swallows."""

GROUND: Final[Color] = (13, 13, 13)
"""Of planes, also in a light theme; plots follow the theme, as their cursor does."""

REFERENCE: Final[Color] = (150, 150, 150)
"""Goal bearing, goal position, limits, world border."""

GOAL: Final[Color] = (255, 255, 255)

START: Final[Color] = (190, 190, 190)

MAIN: Final[Color] = choose_run_colors(1)[0]
"""What a single run did."""

SECOND: Final[Color] = _OKABE_ITO[2]
"""The other coordinate, or what the plant applied."""

WANTED: Final[Color] = _OKABE_ITO[3]
"""What the law asked for before clipping."""

IDEAL: Final[Color] = _OKABE_ITO[1]
"""What the ideal loop would do."""

SAMPLED: Final[Color] = _OKABE_ITO[4]
"""What the sampled loop with dead time would do."""

EVENT: Final[Color] = _OKABE_ITO[5]
"""What happened once."""

ERROR: Final[Color] = _OKABE_ITO[4]
"""From the turtle to the goal."""

MARK: Final[Color] = (165, 165, 165)
"""A metric where it has its place, to be seen on light ground too."""

NO_PHASE: Final = -1

TRACES: Final[Mapping[int, Color]] = MappingProxyType(
    {
        NO_PHASE: START,
        Phase.ROTATE: _OKABE_ITO[0],
        Phase.PAUSE: _OKABE_ITO[3],
        Phase.TRANSLATE: _OKABE_ITO[1],
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


def pack_colors(colors: Sequence[Color]) -> NDArray[np.uint32]:
    """Return opaque colours as Rerun takes them fastest, shape (n,)."""
    red, green, blue = np.array(colors, dtype=np.uint32).reshape(-1, 3).T
    return (red << 24 | green << 16 | blue << 8 | 255).astype(np.uint32)
