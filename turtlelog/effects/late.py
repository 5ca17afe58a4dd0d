"""Delay some commands at random, together with the commands behind them."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from turtlelog.arithmetic import to_ns
from turtlelog.effects.delay import judge_delays
from turtlelog.parts import Action, Complaint, Effect, Probability, Time, absent, draw_chance
from turtlelog.run.loops import Cause


@dataclass(frozen=True, slots=True, kw_only=True)
class LateKeys:
    """Late commands.

    Attributes:
        late_probability: Probability that a command is late.
        late_s: Additional delay of a late command [s].
    """

    late_probability: Probability = absent(0.0)
    late_s: Time = absent(0.0)


def hold_up(settings: Any, drawn: Any, value: int) -> int:
    """Return the time at which a command arrives [ns]."""
    probability = settings.loop.late_probability
    if probability != 0.0 and drawn.chance < probability:
        return value + to_ns(settings.loop.late_s)
    return value


def _judge(scenario: Any) -> Iterator[Complaint]:
    loop = scenario.loop
    yield from judge_delays({"loop.late_s": loop.late_s}, scenario.max_duration_s)
    if loop.late_probability and not loop.late_s:
        yield "loop.late_s", "a time above 0 beside late_probability", repr(loop.late_s)


def _note(scenario: Any) -> Iterator[str]:
    if scenario.loop.late_s and not scenario.loop.late_probability:
        yield "loop.late_s has no effect, for loop.late_probability is 0"


PART = Effect(
    name="late",
    tables={"loop": LateKeys},
    actions={
        "command_travel": Action(step=hold_up, stream=draw_chance(7, "loop.late_probability"))
    },
    causes=(
        Cause(
            name="late",
            kind="effect",
            neutral={"loop.late_probability": 0.0},
            meaning="no command is late",
        ),
    ),
    judge=_judge,
    notes=_note,
)
