"""Precision of published poses: 32-bit or 64-bit floats. The loop itself reads this key."""

from dataclasses import dataclass
from typing import Literal

from turtlelog.parts import Effect
from turtlelog.run.loops import Cause


@dataclass(frozen=True, slots=True, kw_only=True)
class PrecisionKeys:
    """Precision of published poses.

    Attributes:
        pose_precision: Precision of published poses.
    """

    pose_precision: Literal["float32", "float64"] = "float32"


PART = Effect(
    name="float32",
    tables={"loop": PrecisionKeys},
    causes=(
        Cause(
            name="float32",
            kind="design",
            neutral={"loop.pose_precision": "float64"},
            meaning="poses of 64 bits",
        ),
    ),
    modelled=("loop.pose_precision",),
)
