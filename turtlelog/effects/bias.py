"""Add a constant offset to the poses that the controller reads."""

from dataclasses import dataclass
from typing import Any

from turtlelog.parts import Action, Effect, Offset, absent
from turtlelog.run.loops import Cause


@dataclass(frozen=True, slots=True, kw_only=True)
class BiasKeys:
    """Offset of the poses that the controller reads.

    Attributes:
        bias_position_m: Offset of both x and y [m].
        bias_heading_rad: Offset of the heading [rad].
    """

    bias_position_m: Offset = absent(0.0)
    bias_heading_rad: Offset = absent(0.0)


def add_bias(settings: Any, value: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return the pose that the controller reads."""
    bias_m, bias_rad = settings.sensing.bias_position_m, settings.sensing.bias_heading_rad
    x_m, y_m, heading_rad = value
    if bias_m != 0.0:
        x_m, y_m = x_m + bias_m, y_m + bias_m
    if bias_rad != 0.0:
        heading_rad += bias_rad
    return x_m, y_m, heading_rad


PART = Effect(
    name="bias",
    tables={"sensing": BiasKeys},
    actions={"sense": Action(step=add_bias)},
    causes=(
        Cause(
            name="bias",
            kind="effect",
            neutral={"sensing.bias_position_m": 0.0, "sensing.bias_heading_rad": 0.0},
            meaning="poses are read without bias",
        ),
    ),
    added=("sensing.bias_position_m", "sensing.bias_heading_rad"),
)
