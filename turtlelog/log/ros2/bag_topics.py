"""Which topics of a bag hold the poses and the commands."""

import re
from collections.abc import Collection, Iterable
from typing import Final

from turtlelog.errors import LogError
from turtlelog.log.info import TopicInfo
from turtlelog.log.recording.topics import SHAPED, VELOCITY64

POSE_TYPES: Final = (
    "turtlesim/msg/Pose",
    "turtlesim_msgs/msg/Pose",
    "nav_msgs/msg/Odometry",
    "geometry_msgs/msg/PoseStamped",
)
COMMAND_TYPES: Final = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")

_NO_COMMANDS: Final = frozenset({VELOCITY64.name, SHAPED.name})
"""Topics of a recording of ours with the type of commands that nobody published as one."""

_TURTLE: Final = re.compile(r"/turtle\d+/pose")
_TURTLE_COMMANDS: Final = re.compile(r"/turtle\d+/cmd_vel")


def choose_pose_topic(topics: Iterable[TopicInfo], asked: str | None) -> TopicInfo:
    """Return the topic that was asked for, or else the one that can be meant.

    Raises:
        LogError: Where there is none, or several.
    """
    present = [topic for topic in topics if topic.count]
    if asked is not None:
        return _find_asked(present, asked, POSE_TYPES, "pose_topic")
    fitting = _list_fitting(present, POSE_TYPES)
    turtles = [topic for topic in fitting if _TURTLE.fullmatch(topic.topic)]
    chosen = turtles or fitting
    if not chosen:
        found = ", ".join(f"{topic.topic} ({topic.type})" for topic in present) or "no messages"
        raise LogError(f"expected poses ({', '.join(POSE_TYPES)}), found {_shorten(found)}")
    return _require_one(chosen, "pose_topic", "--pose-topic")


def choose_command_topic(
    topics: Iterable[TopicInfo], asked: str | None, *, pose_topic: str
) -> TopicInfo | None:
    """Return the topic that was asked for, or the one that can be meant; None where there is none.

    The neighbour of the poses (/turtle2/cmd_vel of /turtle2/pose) comes before all others.

    Raises:
        LogError: Where there are several.
    """
    present = [topic for topic in topics if topic.count]
    if asked is not None:
        return _find_asked(present, asked, COMMAND_TYPES, "command_topic")
    fitting = [
        topic for topic in _list_fitting(present, COMMAND_TYPES) if topic.topic not in _NO_COMMANDS
    ]
    neighbour = f"{pose_topic.rpartition('/')[0]}/cmd_vel"
    if _TURTLE.fullmatch(pose_topic):
        # The commands of another turtle drove another turtle.
        fitting = [topic for topic in fitting if not _TURTLE_COMMANDS.fullmatch(topic.topic)] + [
            topic for topic in fitting if topic.topic == neighbour
        ]
    chosen = [topic for topic in fitting if topic.topic == neighbour] or fitting
    return _require_one(chosen, "command_topic", "--command-topic") if chosen else None


def _find_asked(
    present: Collection[TopicInfo], asked: str, types: tuple[str, ...], name: str
) -> TopicInfo:
    for topic in present:
        if topic.topic == asked and topic.type in types:
            return topic
    found = next((f"{topic.type}" for topic in present if topic.topic == asked), None)
    if found is None:
        names = _shorten(", ".join(topic.topic for topic in present) or "no messages")
        raise LogError(f"{name}: expected a topic with messages, found {asked} among {names}")
    raise LogError(f"{name} {asked}: expected {' or '.join(types)}, found {found}")


def _list_fitting(present: Collection[TopicInfo], types: tuple[str, ...]) -> list[TopicInfo]:
    return [topic for topic in present if topic.type in types]


def _require_one(chosen: list[TopicInfo], name: str, option: str) -> TopicInfo:
    if len(chosen) > 1:
        names = ", ".join(topic.topic for topic in chosen)
        raise LogError(f"{name}: expected one topic, found {names}: choose with {option}")
    return chosen[0]


def _shorten(text: str) -> str:
    return text if len(text) <= 300 else f"{text[:297]}..."
