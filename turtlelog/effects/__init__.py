"""Effects between control law and plant, one per file.

Effects at one place act in the order of the list. Scenario files and `explain` have the same order.
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
"""The `PART` of each file of effects."""
