"""The robots of a bag: which topics belong to which robot, and the choice of one robot."""

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from turtlelog.errors import LogError
from turtlelog.log.file_info import TopicInfo
from turtlelog.log.ros2.bag_topics import (
    COMMAND_TYPES,
    is_another_thing,
    is_measured,
    list_first_names,
    list_numbers,
)
from turtlelog.log.ros2.pose_types import FIX, JOINTS, POSE_TYPES

_Place = tuple[str, ...]
"""The words before the robot's name in a topic name."""

_NUMBER: Final = re.compile(r"\d+")

_PARTS: Final = re.compile(
    r"(?i)(?:front|rear|left|right)?_?(?:camera|cam|imu|lidar|laser|scan|gps|gnss|sensor|wheel|tag"
    r"|marker|motor|arm|joy)s?_?"
)
"""Names, without their numbers, that belong to parts of a robot."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BagRobot:
    """One of several robots.

    Attributes:
        name: Word that occurs only in the topics of this robot.
        topics: Topics of this robot.
    """

    name: str
    topics: tuple[TopicInfo, ...]

    @property
    def poses(self) -> TopicInfo | None:
        """The robot's topic with the most poses."""
        return _find_most(filter(_tells_poses, self.topics))

    @property
    def commands(self) -> TopicInfo | None:
        """The robot's topic with the most commands."""
        return _find_most(topic for topic in self.topics if _is_command(topic))


def find_robots(topics: Iterable[TopicInfo]) -> tuple[BagRobot, ...]:
    """Return the robots that topic names distinguish; empty for a bag of one robot.

    Several robots have topics of one type whose namespaces differ in one word. These words differ
    only by number, or both poses and commands have them.
    """
    held = [topic for topic in topics if topic.count]
    kinds: dict[_Place, dict[str, set[bool]]] = defaultdict(lambda: defaultdict(set))
    for place, words in _group_words(held):
        for word, is_command in words.items():
            kinds[place][word].add(is_command)
    for place in sorted(kinds, key=lambda place: (len(place), place)):
        names = _choose_names(kinds[place])
        if len(names) > 1:
            return _share_topics(held, place, names)
    return ()


def _share_topics(
    held: Sequence[TopicInfo], place: _Place, names: Iterable[str]
) -> tuple[BagRobot, ...]:
    """Return the robots with their topics, in one pass: a bag may have 65,000 topics."""
    of_robot: dict[str, list[TopicInfo]] = {name: [] for name in names}
    for topic in held:
        words = tuple(topic.topic.split("/"))
        before, inside = words[: len(place)], words[len(place) : -1]
        if before == place and inside and inside[0] in of_robot:
            of_robot[inside[0]].append(topic)
    return tuple(BagRobot(name=name, topics=tuple(found)) for name, found in of_robot.items())


def _group_words(held: Sequence[TopicInfo]) -> Iterator[tuple[_Place, dict[str, bool]]]:
    """Yield the words in which topics of one type differ, and whether the topics are commands."""
    groups: dict[tuple[_Place, _Place, str], dict[str, bool]] = defaultdict(dict)
    for topic in (one for one in held if _tells_poses(one) or _is_command(one)):
        words = tuple(topic.topic.split("/"))
        for place, word in enumerate(words[:-1]):
            if word and not _PARTS.fullmatch(_NUMBER.sub("", word)):
                key = words[:place], words[place + 1 :], topic.type
                groups[key][word] = _is_command(topic)
    for (before, _, _), found in groups.items():
        if len(found) > 1:
            yield before, found


def select_robot(
    topics: Sequence[TopicInfo], name: str | None
) -> tuple[Sequence[TopicInfo], tuple[BagRobot, ...]]:
    """Return the topics of one robot and those of no robot, and all robots.

    Without a name, the first robot with poses is chosen if the robots differ only by number. A name
    that occurs in no topic may occur in the frames of transforms.

    Raises:
        LogError: If several robots are equally likely.
    """
    robots = find_robots(topics)
    if not robots:
        return topics, ()
    names = [robot.name for robot in robots]
    if name is None:
        if not any(robot.poses for robot in robots) and any(map(_tells_poses, topics)):
            return topics, ()  # the robot of the poses is unknown
        if len({_NUMBER.sub("#", one) for one in names}) > 1:
            raise LogError(
                f"{len(names)} robots, {list_first_names(names)}: choose with --robot NAME"
            )
        posed = [robot.name for robot in robots if robot.poses and robot.poses.count > 1]
        name = min(posed or names, key=list_numbers)
    if name not in names:
        return topics, robots
    others = {topic for robot in robots if robot.name != name for topic in robot.topics}
    return [topic for topic in topics if topic not in others], robots


def describe_robots(robots: Sequence[BagRobot], chosen: str | None) -> str:
    """Return a sentence on the robots of a bag and the chosen one."""
    names = list_first_names([robot.name for robot in robots])
    which = "" if chosen is None else f"{chosen} of "
    return f"{which}{names}: --robot NAME chooses"


def require_robot(name: str, topic: str, robots: Collection[BagRobot]) -> None:
    """Refuse a requested robot if the topic of poses or commands belongs to another."""
    if name in topic.split("/")[:-1]:
        return
    known = list_first_names([robot.name for robot in robots]) or f"a bag of one robot, on {topic}"
    raise LogError(f"robot {name}: no topic below that name; found {known}")


def _tells_poses(topic: TopicInfo) -> bool:
    is_pose = topic.type in POSE_TYPES or topic.type == JOINTS
    return topic.count > 0 and is_pose and not is_another_thing(topic.topic)


def _is_command(topic: TopicInfo) -> bool:
    return topic.type in COMMAND_TYPES and not is_measured(topic.topic)


def _choose_names(words: dict[str, set[bool]]) -> list[str]:
    """Return the words that are names of robots, in order of their numbers."""
    counts: dict[str, int] = defaultdict(int)
    for word in words:
        counts[_NUMBER.sub("#", word)] += 1
    names = [
        word
        for word, kinds in words.items()
        if len(kinds) == 2 or (counts[_NUMBER.sub("#", word)] > 1 and _NUMBER.search(word))
    ]
    return sorted(names, key=lambda name: (_NUMBER.sub("#", name), list_numbers(name)))


def _find_most(topics: Iterable[TopicInfo]) -> TopicInfo | None:
    """Return the topic with the most messages, satellite fixes last."""
    return min(
        topics, key=lambda topic: (topic.type == FIX, -topic.count, topic.topic), default=None
    )
