"""What to read of a file that may be meant in several ways: topics, frames, clock, goal."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypedDict

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
