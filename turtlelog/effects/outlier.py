"""Replace some sensed poses by outliers."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from turtlelog.parts import Action, Complaint, Effect, Probability, Size, Stream, absent
from turtlelog.run.loops import Cause


@dataclass(frozen=True, slots=True, kw_only=True)
class OutlierKeys:
    """Outliers among the poses that the controller reads.

    Attributes:
        outlier_probability: Probability that a pose is an outlier.
        outlier_m: Distance of an outlier from the pose, in any direction [m].
        outlier_rad: Heading error of an outlier, to either side [rad].
    """

    outlier_probability: Probability = absent(0.0)
    outlier_m: Size = absent(0.0)
    outlier_rad: Size = absent(0.0)


def throw(
    settings: Any, drawn: Any, value: tuple[float, float, float]
) -> tuple[float, float, float]:
    """Return the pose that the controller reads."""
    probability = settings.sensing.outlier_probability
    if probability == 0.0 or not drawn.chance < probability:
        return value
    x_m, y_m, heading_rad = value
    far_m, far_rad = settings.sensing.outlier_m, settings.sensing.outlier_rad
    x_m += far_m * math.cos(2.0 * math.pi * drawn.direction)
    y_m += far_m * math.sin(2.0 * math.pi * drawn.direction)
    heading_rad += far_rad if drawn.side < 0.5 else -far_rad
    return x_m, y_m, heading_rad


def _judge(scenario: Any) -> Iterator[Complaint]:
    sensing = scenario.sensing
    if sensing.outlier_probability and not (sensing.outlier_m or sensing.outlier_rad):
        sizes = "outlier_m or outlier_rad above 0"
        yield "sensing.outlier_probability", f"{sizes} beside it", "neither"


def _note(scenario: Any) -> Iterator[str]:
    sensing = scenario.sensing
    idle = [f"sensing.{key}" for key in ("outlier_m", "outlier_rad") if getattr(sensing, key)]
    if idle and not sensing.outlier_probability:
        verb = "has" if len(idle) == 1 else "have"
        yield f"{' and '.join(idle)} {verb} no effect, for sensing.outlier_probability is 0"


PART = Effect(
    name="outlier",
    tables={"sensing": OutlierKeys},
    actions={
        "sense": Action(
            step=throw,
            stream=Stream(
                number=2,
                kind="uniform",
                fields=("chance", "direction", "side"),
                keys=("sensing.outlier_probability",),
            ),
        )
    },
    causes=(
        Cause(
            name="outlier",
            kind="effect",
            neutral={"sensing.outlier_probability": 0.0},
            meaning="no pose is an outlier",
        ),
    ),
    judge=_judge,
    notes=_note,
)
