"""What to read of a file that may be meant in several ways: topics, frames, clock, goal."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Final, Literal, TypedDict

from turtlelog.errors import LogError
from turtlelog.files.urls import RemotePath, make_path

TimeSource = Literal["auto", "log", "stamp"]
"""What times poses: the recorder's clock, their stamps mapped to it, or what the bag suggests."""


class ReadOptions(TypedDict, total=False):
    """The fields of a `ReadChoice`, as arguments by name."""

    pose_topic: str | None
    command_topic: str | None
    path_topic: str | None
    pose_frame: str | None
    world_frame: str | None
    goal: tuple[float, ...] | None
    time: TimeSource
    columns: Mapping[str, str]
    allow_partial: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadChoice:
    """What to read of somebody else's files, and whether recordings may be unfinished.

    Attributes:
        pose_topic: Poses; None: what the types and names of the topics suggest, as for the others.
        command_topic: Commands.
        path_topic: The path that is to be followed.
        pose_frame: The robot's frame, of poses from transforms.
        world_frame: The frame in which poses from transforms are given.
        goal: x, y [m] and, where one is asked for, heading [rad]; None: as the file says.
        time: What times poses.
        columns: Of a plain table, by what they hold (`t`, `x`, `y`, `heading` ...): the name of the
            column, with its unit in brackets where the name does not tell (`yaw [deg]`).
        allow_partial: Read what an unfinished or damaged recording still holds.
    """

    pose_topic: str | None = None
    command_topic: str | None = None
    path_topic: str | None = None
    pose_frame: str | None = None
    world_frame: str | None = None
    goal: tuple[float, ...] | None = None
    time: TimeSource = "auto"
    columns: Mapping[str, str] = field(default_factory=dict)
    allow_partial: bool = False

    def override(self, other: "ReadChoice") -> "ReadChoice":
        """Return this choice with all that another one asks for; columns of both."""
        usual = ReadChoice()
        asked = {
            one.name: getattr(other, one.name)
            for one in fields(other)
            if getattr(other, one.name) != getattr(usual, one.name)
        }
        return replace(self, **asked | {"columns": {**self.columns, **other.columns}})


CHOSEN: Final = "chosen"
"""Note in one line on the topics that were chosen, for who asked; it goes into no recording."""


def split_topic(path: str | Path) -> tuple[Path, str | None]:
    """Return the file and the topic of its poses in FILE:TOPIC, as in `bag:/odom_kf`.

    A file of the whole name comes first, and what is no file before the colon is no FILE:TOPIC.
    """
    path = make_path(path)
    if isinstance(path, RemotePath):
        return path.split_topic()
    text = path.as_posix()
    head, colon, _ = text.rpartition(":/")
    while colon and not path.exists():
        if Path(head).exists():
            return Path(head), text[len(head) + 1 :]
        head, colon, _ = head.rpartition(":/")
    return path, None


def parse_goal(goal: tuple[float, ...]) -> tuple[tuple[float, float], float | None]:
    """Return position [m] and heading [rad] of a goal that is asked for; None without a heading.

    Raises:
        LogError: Where it is neither two nor three finite numbers.
    """
    if len(goal) not in {2, 3} or not all(map(math.isfinite, goal)):
        raise LogError(f"goal: expected x, y [m] and perhaps a heading [rad], found {goal!r:.60}")
    x_m, y_m, *heading_rad = map(float, goal)
    return (x_m, y_m), heading_rad[0] if heading_rad else None
