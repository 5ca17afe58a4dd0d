"""Lose poses at random."""

from dataclasses import dataclass
from typing import Any

from turtlelog.parts import Action, Effect, Probability, absent, draw_chance
from turtlelog.run.loops import Cause


@dataclass(frozen=True, slots=True, kw_only=True)
class DropoutKeys:
    """Loss of poses.

    Attributes:
        dropout_probability: Probability that a pose does not arrive.
    """

    dropout_probability: Probability = absent(0.0)


def lose_pose(settings: Any, drawn: Any, value: bool) -> bool:  # noqa: FBT001
    """Return whether a pose is lost."""
    probability = settings.sensing.dropout_probability
    return value or (probability != 0.0 and drawn.chance < probability)


PART = Effect(
    name="dropout",
    tables={"sensing": DropoutKeys},
    actions={
        "lose_pose": Action(step=lose_pose, stream=draw_chance(1, "sensing.dropout_probability"))
    },
    causes=(
        Cause(
            name="dropout",
            kind="effect",
            neutral={"sensing.dropout_probability": 0.0},
            meaning="every pose arrives",
        ),
    ),
)
