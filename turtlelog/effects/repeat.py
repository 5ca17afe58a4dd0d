"""Repeat commands at random."""

from dataclasses import dataclass
from typing import Any

from turtlelog.parts import Action, Effect, Probability, absent, draw_chance
from turtlelog.run.loops import Cause


@dataclass(frozen=True, slots=True, kw_only=True)
class RepeatKeys:
    """Duplicated commands.

    Attributes:
        repeat_probability: Probability that a command arrives twice.
    """

    repeat_probability: Probability = absent(0.0)


def repeat_command(settings: Any, drawn: Any, value: int) -> int:
    """Return how often a command arrives."""
    probability = settings.loop.repeat_probability
    if probability != 0.0 and drawn.chance < probability:
        return value + 1
    return value


PART = Effect(
    name="repeat",
    tables={"loop": RepeatKeys},
    actions={
        "repeat": Action(step=repeat_command, stream=draw_chance(6, "loop.repeat_probability"))
    },
    causes=(
        Cause(
            name="repeat",
            kind="effect",
            neutral={"loop.repeat_probability": 0.0},
            meaning="no command arrives twice",
        ),
    ),
)
