"""Lose commands at random."""

from dataclasses import dataclass
from typing import Any

from turtlelog.parts import Action, Effect, Probability, absent, draw_chance
from turtlelog.run.loops import Cause


@dataclass(frozen=True, slots=True, kw_only=True)
class LossKeys:
    """Loss of commands.

    Attributes:
        loss_probability: Probability that a published command does not arrive.
    """

    loss_probability: Probability = absent(0.0)


def lose_command(settings: Any, drawn: Any, value: bool) -> bool:  # noqa: FBT001
    """Return whether a command is lost."""
    return value or (
        settings.loop.loss_probability != 0.0 and drawn.chance < settings.loop.loss_probability
    )


PART = Effect(
    name="loss",
    tables={"loop": LossKeys},
    actions={
        "lose_command": Action(step=lose_command, stream=draw_chance(5, "loop.loss_probability"))
    },
    causes=(
        Cause(
            name="loss",
            kind="effect",
            neutral={"loop.loss_probability": 0.0},
            meaning="every command arrives",
        ),
    ),
)
