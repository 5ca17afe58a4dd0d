"""Effects between control law and plant, one file each.

The order of the list is that in which effects act at one place, in which their keys stand in a
scenario file, and in which `explain` lists them.
"""

from typing import Final

from turtlelog.parts import Effect, load_parts

_FILES: Final = (
    "sampling",
    "queue",
    "delay",
    "jitter",
    "loss",
    "repeat",
    "late",
    "dropout",
    "bias",
    "noise",
    "outlier",
    "quantum",
    "disturbance",
    "shaping",
    "saturation",
    "acceleration",
    "precision",
)

EFFECTS: Final[tuple[Effect, ...]] = load_parts(__name__, _FILES)
"""The `PART` of each file."""
