"""Answer every n-th pose, or use a timer. The loop itself reads these keys."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

from turtlelog.parts import Complaint, Count, Effect, Period, absent


@dataclass(frozen=True, slots=True, kw_only=True)
class SamplingKeys:
    """Trigger and period of the controller.

    Attributes:
        period_ticks: Number n: the controller answers every n-th pose.
        trigger: `pose`: the controller answers each pose that arrives. `timer`: the controller
            answers the newest pose every `period_s`.
        period_s: Period of the timer [s]; used only with the trigger `timer`.
    """

    period_ticks: Count = 1
    trigger: Literal["pose", "timer"] = absent("pose")
    period_s: Period | None = absent(None)


def _judge(scenario: Any) -> Iterator[Complaint]:
    loop = scenario.loop
    if loop.trigger == "timer":
        if loop.period_s is None:
            yield "loop.period_s", "a period, for loop.trigger is timer", "none"
        if loop.period_ticks != 1:
            yield "loop.period_ticks", "1, for loop.trigger is timer", repr(loop.period_ticks)
    elif loop.period_s is not None:
        yield "loop.period_s", "none, for loop.trigger is pose", repr(loop.period_s)


PART = Effect(
    name="sampling",
    tables={"loop": SamplingKeys},
    modelled=("loop.period_ticks", "loop.trigger", "loop.period_s"),
    judge=_judge,
)
"""The design parameter belongs to the clock: `explain` removes sampling with a finer clock."""
