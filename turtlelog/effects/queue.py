"""Queues of poses and commands. The loop itself reads these keys."""

from dataclasses import dataclass
from typing import Literal

from turtlelog.parts import Count, Effect
from turtlelog.run.loops import Cause


@dataclass(frozen=True, slots=True, kw_only=True)
class QueueKeys:
    """Depths and policy of the queues of poses and commands.

    Attributes:
        start_backlog: Initial queue: number of poses that wait when the controller starts; 1: only
            the newest pose.
        pose_queue: Depth of the controller's pose queue.
        command_queue: Depth of the plant's command queue.
        queue_policy: `one-per-tick`: the plant takes one command per tick. `newest`: the plant
            takes the newest command and drops the others.
    """

    start_backlog: Count = 1
    pose_queue: Count = 10
    command_queue: Count = 7
    queue_policy: Literal["one-per-tick", "newest"] = "newest"


PART = Effect(
    name="queue",
    tables={"loop": QueueKeys},
    causes=(
        Cause(
            name="queue",
            kind="effect",
            neutral={"loop.queue_policy": "newest", "loop.start_backlog": 1},
            meaning="the newest command wins, and no initial queue",
        ),
    ),
    modelled=("loop.start_backlog", "loop.pose_queue", "loop.command_queue", "loop.queue_policy"),
)
