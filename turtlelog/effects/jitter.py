"""Delay each pose and each command by a random time, without changing their order."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from turtlelog.arithmetic import nearest_int
from turtlelog.effects.delay import judge_delays
from turtlelog.parts import Action, Complaint, Effect, Stream, Time, absent
from turtlelog.run.loops import Cause


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandJitterKeys:
    """Jitter of commands.

    Attributes:
        jitter_s: Largest additional transport time of a command, uniform from 0 [s]. No command
            overtakes another.
    """

    jitter_s: Time = absent(0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseJitterKeys:
    """Jitter of poses.

    Attributes:
        jitter_s: Largest additional delay of a pose, uniform from 0 [s]. No pose overtakes another.
    """

    jitter_s: Time = absent(0.0)


def jitter_command(settings: Any, drawn: Any, value: int) -> int:
    """Return the time at which a command arrives [ns]."""
    if settings.loop.jitter_s == 0.0:
        return value
    return value + nearest_int(settings.loop.jitter_s * 1e9 * drawn.part)


def jitter_pose(settings: Any, drawn: Any, value: int) -> int:
    """Return the time at which a pose arrives [ns]."""
    if settings.sensing.jitter_s == 0.0:
        return value
    return value + nearest_int(settings.sensing.jitter_s * 1e9 * drawn.part)


def _judge(scenario: Any) -> Iterator[Complaint]:
    times = {"loop": scenario.loop.jitter_s, "sensing": scenario.sensing.jitter_s}
    delays = {f"{table}.jitter_s": time_s for table, time_s in times.items()}
    yield from judge_delays(delays, scenario.max_duration_s)


PART = Effect(
    name="jitter",
    tables={"loop": CommandJitterKeys, "sensing": PoseJitterKeys},
    actions={
        "command_travel": Action(
            step=jitter_command,
            stream=Stream(number=4, kind="uniform", fields=("part",), keys=("loop.jitter_s",)),
            keys=("loop.jitter_s",),
        ),
        "pose_travel": Action(
            step=jitter_pose,
            stream=Stream(number=3, kind="uniform", fields=("part",), keys=("sensing.jitter_s",)),
            keys=("sensing.jitter_s",),
        ),
    },
    causes=(
        Cause(
            name="jitter",
            kind="effect",
            neutral={"loop.jitter_s": 0.0, "sensing.jitter_s": 0.0},
            meaning="no jitter of commands and poses, nor the mean delay that it adds",
        ),
    ),
    judge=_judge,
)
