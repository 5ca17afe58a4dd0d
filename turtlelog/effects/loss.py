"""Lose commands at random."""

from dataclasses import dataclass
from typing import Any

from turtlelog.parts import Action, Effect, Probability, Stream, absent
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
        "lose_command": Action(
            step=lose_command,
            stream=Stream(
                number=5,
                kind="uniform",
                fields=("chance",),
                keys=("loop.loss_probability",),
                is_chance=True,
            ),
        )
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
