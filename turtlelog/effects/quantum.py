"""Round the poses that the controller reads."""

from dataclasses import dataclass
from typing import Any

from turtlelog.arithmetic import round_to_step
from turtlelog.parts import Action, Effect, Size, absent
from turtlelog.run.loops import Cause


@dataclass(frozen=True, slots=True, kw_only=True)
class QuantumKeys:
    """Rounding of the poses that the controller reads.

    Attributes:
        quantum_position_m: Step to which x and y are rounded [m]; 0: no rounding.
        quantum_heading_rad: Step to which the heading is rounded [rad]; 0: no rounding.
    """

    quantum_position_m: Size = absent(0.0)
    quantum_heading_rad: Size = absent(0.0)


def round_pose(settings: Any, value: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return the pose that the controller reads."""
    step_m = settings.sensing.quantum_position_m
    x_m, y_m = round_to_step(value[0], step_m), round_to_step(value[1], step_m)
    return x_m, y_m, round_to_step(value[2], settings.sensing.quantum_heading_rad)


PART = Effect(
    name="quantum",
    tables={"sensing": QuantumKeys},
    actions={"sense": Action(step=round_pose)},
    causes=(
        Cause(
            name="quantum",
            kind="effect",
            neutral={"sensing.quantum_position_m": 0.0, "sensing.quantum_heading_rad": 0.0},
            meaning="poses are read unrounded",
        ),
    ),
)
