"""Delay all poses and all commands by a constant time."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from turtlelog.arithmetic import to_ns
from turtlelog.parts import Action, Complaint, Effect, Ticks, Time, absent
from turtlelog.run.loops import Cause


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandDelayKeys:
    """Delay of commands: the sum of both keys.

    Attributes:
        transport_delay_ticks: Ticks between publication and arrival of a command.
        transport_delay_s: Additional time [s].
    """

    transport_delay_ticks: Ticks = 0
    transport_delay_s: Time = absent(0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseDelayKeys:
    """Delay of poses.

    Attributes:
        delay_s: Time from a pose to its arrival at the controller [s].
    """

    delay_s: Time = absent(0.0)


def delay_command(settings: Any, value: int) -> int:
    """Return the time at which a command arrives [ns]."""
    delay_ns: int = settings.loop.transport_delay_ticks * settings.scene.period_ns
    return value + delay_ns + to_ns(settings.loop.transport_delay_s)


def delay_pose(settings: Any, value: int) -> int:
    """Return the time at which a pose arrives [ns]."""
    return value + to_ns(settings.sensing.delay_s)


def _judge(scenario: Any) -> Iterator[Complaint]:
    """Yield notes on delays longer than the run, with which nothing would happen."""
    most_s, loop = scenario.max_duration_s, scenario.loop
    ticks_s = loop.transport_delay_ticks * scenario.plant.facts.period_s
    delays = {
        "loop.transport_delay_ticks": ticks_s,
        "loop.transport_delay_s": ticks_s + loop.transport_delay_s,
        "sensing.delay_s": scenario.sensing.delay_s,
    }
    yield from judge_delays(delays, most_s)


def judge_delays(delays: dict[str, float], most_s: float) -> Iterator[Complaint]:
    """Yield the times that are longer than a run [s]."""
    for key, delay_s in delays.items():
        if delay_s > most_s:
            yield key, f"no longer than max_duration_s = {most_s:g} s", f"{delay_s:g} s"


PART = Effect(
    name="delay",
    tables={"loop": CommandDelayKeys, "sensing": PoseDelayKeys},
    actions={
        # Of whole ticks the loop has a queue by itself, unless a time comes to them.
        "command_travel": Action(step=delay_command, keys=("loop.transport_delay_s",)),
        "pose_travel": Action(step=delay_pose, keys=("sensing.delay_s",)),
    },
    causes=(
        Cause(
            name="delay",
            kind="effect",
            neutral={
                "loop.transport_delay_ticks": 0,
                "loop.transport_delay_s": 0.0,
                "sensing.delay_s": 0.0,
            },
            meaning="no delay of commands and poses",
        ),
    ),
    modelled=("loop.transport_delay_ticks", "loop.transport_delay_s", "sensing.delay_s"),
    judge=_judge,
)
