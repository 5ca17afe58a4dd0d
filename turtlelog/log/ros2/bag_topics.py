"""The topics of a bag with poses and commands, chosen by type and name or as requested."""

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

from turtlelog.errors import LogError
from turtlelog.log.file_info import TopicInfo
from turtlelog.log.planar_poses import (
    COMMAND_TYPES,
    FIX,
    JOINTS,
    OTHER_PLACES,
    POSE_TYPES,
    POSES_IN_SHORT,
    TRANSFORM_TYPES,
)
from turtlelog.log.read_choice import NEEDS_WHEELS, match_topic
from turtlelog.log.recording.topics import POSE64
from turtlelog.run import SourceTopic

PATH: Final = "nav_msgs/msg/Path"

_MOST_UNREAD: Final = 3
"""Largest number of unread topics that one line lists with their reasons."""

_ROS_TYPE: Final = re.compile(r"\w+/(?:msg|srv|action)/\w+")

_NO_ROBOT: Final = re.compile(
    r"(?:^|[/_])(?:goals?|goal_?pose|targets?|waypoints?|initial_?pose|set_?pose|clicked|via"
    r"|docks?|staging|desired|setpoints?|references?|ref|plan|trajectory|lookahead|carrot|markers?"
    r"|objects?|obstacles?|landmarks?|tf_static)(?=$|[/_\d])"
)
"""Words in names of poses that are not a robot's: goals, initial poses, other objects."""

_MEASURED: Final = re.compile(
    r"(?:^|[/_])(?:odom|odometry|measured|actual|feedback|estimated?|current|state|imu)(?=$|[/_\d])"
)
"""Words in names of measured velocities."""

_POSE_NAMES: Final = (
    re.compile(r"odom|odometry|pose"),
    re.compile(r"amcl_pose|robot_pose|base_pose|odometry/filtered|(?:base|wheel)?_?odom_?combined"),
    re.compile(r"(?s:.*(?:odom|pose).*)"),
)


class NoPosesError(LogError):
    """Error of a bag without a readable topic of poses; some may be unreadable (`is_unread`)."""

    def __init__(self, text: str, *, is_unread: bool = False) -> None:
        super().__init__(text)
        self.is_unread = is_unread


_MOST_LISTED: Final = 100
"""Largest number of names in a note. A file of 400 kB can have 65,000 topics."""


def list_first_names(names: Sequence[str]) -> str:
    """Return names for a note; of too many, the first and the number of the others."""
    few = ", ".join(names[:_MOST_LISTED])
    more = len(names) - _MOST_LISTED
    return f"{few} and {more:,} more" if more > 0 else few


@dataclass(frozen=True, slots=True, kw_only=True)
class Pick:
    """A topic that was chosen.

    Attributes:
        topic: The chosen topic.
        others: Names of the alternatives.
        still: Name of a topic that was rejected because it never moves; empty without such a topic.
    """

    topic: TopicInfo
    others: tuple[str, ...] = ()
    still: str = ""

    @property
    def source(self) -> SourceTopic:
        """Name and type of the topic."""
        return SourceTopic(name=self.topic.topic, type=self.topic.type)


def choose_pose_topic(topics: Iterable[TopicInfo], asked: str | None) -> Pick:
    """Return the requested topic, or else the most likely topic."""
    held = [topic for topic in topics if topic.count]
    if asked is not None:
        return Pick(topic=find_asked(held, asked, (*POSE_TYPES, JOINTS), "pose_topic"))
    present = drop_unread(held)
    usual = [
        topic for topic in present if topic.type in POSE_TYPES and not is_another_thing(topic.topic)
    ]
    fitting = drop_two_types(usual, present)
    if not fitting:
        raise _deny_poses(held, present)
    homes = {take_home(topic.topic) for topic in present if topic.type in COMMAND_TYPES}

    def rank(topic: TopicInfo) -> tuple[int, ...]:
        return (
            int(topic.count < 2),  # a single message shows no motion
            int(topic.topic == POSE64.name),
            POSE_TYPES[topic.type][0],
            rank_name(topic.topic, _POSE_NAMES),
            int(take_home(topic.topic) not in homes),
            topic.topic.count("/"),
        )

    best = list_first(fitting, rank)
    if len({_NUMBER.sub("#", topic.topic) for topic in best}) == 1:
        # If robots differ only by number, the first is chosen.
        best = [min(best, key=lambda topic: list_numbers(topic.topic))]
    chosen = require_one_topic(best, "pose_topic")
    others = [topic for topic in fitting if topic != chosen and topic.type not in TRANSFORM_TYPES]
    return Pick(topic=chosen, others=tuple(topic.topic for topic in others))


def choose_joint_topic(topics: Iterable[TopicInfo], asked: str | None) -> TopicInfo:
    """Return the requested topic of joint states, or else the one with the usual name."""
    held = [topic for topic in topics if topic.count]
    if asked is not None:
        return find_asked(held, asked, (JOINTS,), "pose_topic")
    fitting = [topic for topic in drop_unread(held) if topic.type == JOINTS]
    if not fitting:
        raise LogError(f"wheel_joints: expected a topic of {JOINTS}, found {_describe(held)}")
    named = [topic for topic in fitting if take_last(topic.topic) == "joint_states"]
    return require_one_topic(named or fitting, "pose_topic")


def list_by_fields(topics: Iterable[TopicInfo]) -> list[TopicInfo]:
    """Return topics whose fields may belong to a pose: types with such names, or unknown types."""
    return [
        topic
        for topic in topics
        if topic.count
        and not topic.reason
        and not is_another_thing(topic.topic)
        and (not _ROS_TYPE.fullmatch(topic.type) or _POSE_LIKE.search(take_last(topic.type)))
    ]


def describe_other_poses(topics: Iterable[TopicInfo]) -> dict[str, str]:
    """Return a note on topics that may contain poses, for a bag of which none is read."""
    held = [topic for topic in topics if topic.count]
    parts = [
        f"{topic.topic} ({topic.type}) is not read, as its fields have other names"
        for topic in list_by_fields(held)
        if _POSE_LIKE.search(take_last(topic.type))
    ]
    joints = [topic.topic for topic in held if topic.type == JOINTS]
    parts = [*parts[:_MOST_UNREAD], *([f"{joints[0]}: {NEEDS_WHEELS}"] if joints else [])]
    return {"poses": f"poses: {'; '.join(parts)}"} if parts else {}


def describe_other_places(topics: Iterable[TopicInfo]) -> str:
    """Return the topics of places that are not read as poses, with reasons; may be empty."""
    held = [topic for topic in topics if topic.count and topic.type in OTHER_PLACES]
    parts = [f"{topic.topic} ({topic.type}): {OTHER_PLACES[topic.type]}" for topic in held]
    return "; ".join(parts[:_MOST_UNREAD])


def describe_unread_topics(topics: Iterable[TopicInfo]) -> str:
    """Return the unread topics of poses, commands, goals or paths with reasons; may be empty."""
    unread = [topic for topic in topics if topic.count and topic.reason]
    return _join_reasons(filter(_is_of_a_run, unread))


def _deny_poses(held: Sequence[TopicInfo], present: Sequence[TopicInfo]) -> NoPosesError:
    unread = [topic for topic in held if topic not in present]
    if reasons := _join_reasons(filter(_is_of_a_run, unread)):
        return NoPosesError(reasons, is_unread=True)
    found = f"no poses; it contains {_describe(held)}; poses are read from {POSES_IN_SHORT}"
    has_joints = any(topic.type == JOINTS for topic in present)
    parts = [found, NEEDS_WHEELS if has_joints else "", _join_reasons(unread)]
    return NoPosesError("; ".join(filter(None, parts)))


def _join_reasons(unread: Iterable[TopicInfo]) -> str:
    reasons = [topic.describe_reason() for topic in unread]
    more = len(reasons) - _MOST_UNREAD
    rest = [f"{more} more topics are not understood"] if more > 0 else []
    return "; ".join([*reasons[:_MOST_UNREAD], *rest])


def _is_of_a_run(topic: TopicInfo) -> bool:
    """Return whether the last word of a type is that of a readable type, for other encodings."""
    last = re.split(r"[/.:]", topic.type)[-1]
    return last in _RUN_WORDS or bool(_POSE_LIKE.search(last))


def drop_unread(topics: Iterable[TopicInfo]) -> list[TopicInfo]:
    """Return readable topics, and topics with two types, which are refused later."""
    held = list(topics)
    counts = Counter(topic.topic for topic in held)
    return [topic for topic in held if not topic.reason or counts[topic.topic] > 1]


_RUN_WORDS: Final = frozenset(
    kind.rpartition("/")[2] for kind in (*POSE_TYPES, *COMMAND_TYPES, PATH)
)

_POSE_LIKE: Final = re.compile(r"(?i)pose|odom|locali[sz]ation")
_NUMBER: Final = re.compile(r"\d+")
_SUFFIX: Final = re.compile(r"[_-]?\d+")


def list_first(
    topics: Sequence[TopicInfo], rank: Callable[[TopicInfo], tuple[int, ...]]
) -> list[TopicInfo]:
    """Return the topics with the best rank."""
    least = min(map(rank, topics))
    return [topic for topic in topics if rank(topic) == least]


def is_measured(topic: str) -> bool:
    """Return whether a topic's name shows that its velocities are measured."""
    return _MEASURED.search(take_last(topic)) is not None


def rank_place(topic: str, pose_topic: str) -> tuple[int, int]:
    """Return the distance of a topic from the poses: number of differing words, then depth."""
    own, home = topic.split("/")[1:-1], pose_topic.split("/")[1:-1]
    shared = 0
    while shared < min(len(own), len(home)) and own[shared] == home[shared]:
        shared += 1
    # The nearest topic has exactly the same namespace: /a/cmd_vel for /a/odom.
    return -2 * shared - int(own == home and bool(own)), len(own)


def rank_name(topic: str, names: Sequence[re.Pattern[str]]) -> int:
    """Return the index of the first pattern that matches the end of a name."""
    ends = take_last(topic), "/".join(topic.split("/")[-2:])
    fitting = (number for number, name in enumerate(names) if any(map(name.fullmatch, ends)))
    return next(fitting, len(names))


def is_another_thing(topic: str) -> bool:
    """Return whether a topic's name shows that its poses are not a robot's: a goal, a marker."""
    return _NO_ROBOT.search(re.sub(r"(?<=[a-z])(?=[A-Z])", "_", topic).lower()) is not None


def is_another_robots(topic: str, pose_topic: str) -> bool:
    """Return whether a topic's namespace differs from the poses' only by numbers: tb3 and tb3_1."""
    pairs = zip(topic.split("/")[1:-1], pose_topic.split("/")[1:-1], strict=False)
    return any(
        own != home and len({_SUFFIX.sub("", one) for one in (own, home)}) == 1
        for own, home in pairs
    )


def drop_two_types(fitting: list[TopicInfo], present: Collection[TopicInfo]) -> list[TopicInfo]:
    """Return topics without those that have messages of two types. Refuse if no topic remains."""
    counts = Counter(topic.topic for topic in present)
    left = [topic for topic in fitting if counts[topic.topic] == 1]
    if fitting and not left:
        _require_one_type(fitting[0].topic, present)
    return left


def _require_one_type(name: str, present: Collection[TopicInfo]) -> None:
    kinds = sorted(topic.type for topic in present if topic.topic == name)
    if len(kinds) > 1:
        raise LogError(f"topic {name}: expected messages of one type, found {' and '.join(kinds)}")


def find_asked(
    present: Collection[TopicInfo], asked: str, types: tuple[str, ...], name: str
) -> TopicInfo:
    """Return the topic that the option `name` requests; refuse a topic without these types."""
    asked = match_topic(asked, {topic.topic for topic in present})
    _require_one_type(asked, present)
    found = next((topic for topic in present if topic.topic == asked), None)
    if found is None:
        names = _describe(present, "{0.topic}")
        raise LogError(f"{name}: expected a topic with messages, found {asked} among {names}")
    is_free = name in {"pose_topic", "command_topic"} and not _ROS_TYPE.fullmatch(found.type)
    # The reader reports an undecodable topic, with the name of its file.
    if found.type not in types and not is_free and not found.reason:
        raise LogError(f"{name} {asked}: expected {' or '.join(types)}, found {found.type}")
    return found


def require_one_topic(chosen: list[TopicInfo], name: str) -> TopicInfo:
    """Return the only topic; several are refused, and the option `name` chooses."""
    if len(chosen) > 1:
        names = ", ".join(topic.topic for topic in chosen)
        option = f"--{name.replace('_', '-')}"
        raise LogError(f"{name}: expected one topic, found {names}: choose with {option}")
    return chosen[0]


def take_home(topic: str) -> str:
    """Return a topic's name without its last word."""
    return topic.rpartition("/")[0]


def take_last(topic: str) -> str:
    """Return the last word of a topic's name."""
    return topic.rpartition("/")[2]


def list_numbers(name: str) -> list[tuple[int, str]]:
    """Return the numbers in a name as a sort key, as texts, because they may be very long."""
    digits = (found.lstrip("0") for found in _NUMBER.findall(name))
    return [(len(found), found) for found in digits]


def _describe(present: Collection[TopicInfo], form: str = "{0.topic} ({0.type})") -> str:
    text = ", ".join(form.format(topic) for topic in present) or "no messages"
    return text if len(text) <= 300 else f"{text[:297]}..."


_Place = tuple[str, ...]
"""The words before the robot's name in a topic name."""

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
        return _find_most(filter(_is_command, self.topics))


def find_robots(topics: Iterable[TopicInfo]) -> tuple[BagRobot, ...]:
    """Return the robots that topic names distinguish; empty for a bag of one robot.

    Namespaces of topics of one type differ in one word: by number, or of poses and commands.
    """
    held = [topic for topic in topics if topic.count]
    kinds: dict[_Place, dict[str, set[bool]]] = defaultdict(lambda: defaultdict(set))
    for place, words in _group_words(held):
        for word, is_command in words.items():
            kinds[place][word].add(is_command)
    chosen = (
        (place, _choose_names(kinds[place]))
        for place in sorted(kinds, key=lambda one: (len(one), one))
    )
    place, names = next(((place, names) for place, names in chosen if len(names) > 1), ((), []))
    of_robot: dict[str, list[TopicInfo]] = {name: [] for name in names}
    for topic in held if names else ():  # in one pass: a bag may have 65,000 topics
        parts = tuple(topic.topic.split("/"))
        before, inside = parts[: len(place)], parts[len(place) : -1]
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
    """
    robots = find_robots(topics)
    if not robots:
        return topics, ()
    names = [robot.name for robot in robots]
    if name is None:
        if not any(robot.poses for robot in robots) and any(map(_tells_poses, topics)):
            return topics, ()  # the robot of the poses is unknown
        if len({_NUMBER.sub("#", one) for one in names}) > 1:
            several = f"{len(names)} robots, {list_first_names(names)}"
            raise LogError(f"{several}: choose with --robot NAME")
        posed = [robot.name for robot in robots if robot.poses and robot.poses.count > 1]
        name = min(posed or names, key=list_numbers)
    if name not in names:
        return topics, robots
    others = {topic for robot in robots if robot.name != name for topic in robot.topics}
    return [topic for topic in topics if topic not in others], robots


def describe_robots(robots: Sequence[BagRobot], topic: str, asked: str | None) -> str:
    """Return a sentence on the robots of a bag and that of a topic; empty for one robot."""
    words = topic.split("/")[:-1]
    names = list_first_names([robot.name for robot in robots])
    if asked is not None and asked not in words:
        known = names or f"a bag of one robot, on {topic}"
        raise LogError(f"robot {asked}: no topic below that name; found {known}")
    which = next((f"{robot.name} of " for robot in robots if robot.name in words), "")
    return f"{which}{names}: --robot NAME chooses" if robots else ""


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
    return min(
        topics, key=lambda topic: (topic.type == FIX, -topic.count, topic.topic), default=None
    )
