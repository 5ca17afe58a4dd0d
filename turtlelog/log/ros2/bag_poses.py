"""The source of the poses in a bag: one of several robots; a topic, or transforms of two frames."""

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from turtlelog.display import describe_count
from turtlelog.errors import LogError
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.file_info import TopicInfo
from turtlelog.log.read_choice import ReadChoice, parse_joints, parse_wheels
from turtlelog.log.ros2.bag import Bag
from turtlelog.log.ros2.bag_topics import (
    COMMAND_TYPES,
    NEEDS_WHEELS,
    NoPosesError,
    Pick,
    choose_joint_topic,
    choose_pose_topic,
    is_another_thing,
    is_measured,
    list_by_fields,
    list_first_names,
    list_numbers,
)
from turtlelog.log.ros2.bag_transforms import (
    TRANSFORM,
    Tree,
    build_link_columns,
    choose_frames,
    collect_links,
    trace_frame,
)
from turtlelog.log.ros2.computed_poses import integrate_wheels, locate_fixes
from turtlelog.log.ros2.pose_types import (
    FIX,
    JOINTS,
    POSE_TYPES,
    POSITIONS,
    TRANSFORM_TYPES,
    find_pose_shape,
)

Found = list[Mapping[str, TopicColumns]]
"""The columns of each file, by topic."""

_FRAMES: Final = ("header.frame_id", "frame_id")


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseSource:
    """The messages that contain poses.

    Attributes:
        topic: Name of the topic, with the type of the messages in `found`.
        found: The messages, by file.
        home: Topic or frame whose namespace is the robot's.
        frame: Frame of the poses; empty if unknown.
        tree: Transforms, if they were read.
        notes: Chosen topics or frames, and the alternatives.
    """

    topic: TopicInfo
    found: Found
    home: str
    frame: str
    tree: Tree = field(default_factory=dict)
    notes: Mapping[str, str] = field(default_factory=dict)


def find_poses(bag: Bag, topics: Collection[TopicInfo], choice: ReadChoice) -> PoseSource:
    """Return the messages with a robot's poses.

    Raises:
        LogError: If there are no poses, or several sources are equally likely.
    """
    frames = {"pose_frame": choice.pose_frame, "world_frame": choice.world_frame}
    asked = [name for name, value in frames.items() if value is not None]
    if choice.wheel_joints is not None or choice.wheels is not None:
        return _integrate_wheels(bag, topics, choice, asked)
    if asked and choice.pose_topic is None:
        return _trace_poses(bag, _pick_transforms(topics), topics, choice)
    pick = _pick(bag, topics, choice.pose_topic)
    found: Found | None = None
    if choice.pose_topic is None and not asked:
        pick, found = _pick_moving(bag, topics, pick)
    if pick.topic.type in TRANSFORM_TYPES:
        try:
            return _trace_poses(bag, pick, topics, choice)
        except LogError:
            fix = _pick_fix(topics) if choice.pose_topic is None else None
            if fix is None:
                raise
            pick = fix
    if asked:
        name = asked[0]
        raise LogError(
            f"{name}: expected poses from transforms, found {pick.describe()}, which are not"
        )
    return _read_poses(bag, pick, found)


def _read_poses(bag: Bag, pick: Pick, found: Found | None) -> PoseSource:
    """Return the messages of a topic of poses; `found` contains them if they were read before."""
    name = pick.topic.topic
    if pick.topic.type == JOINTS:
        raise LogError(f"pose_topic {pick.describe()}: {NEEDS_WHEELS}")
    found = [*bag.read({name})] if found is None else found
    notes = note_pick("pose_topic", pick)
    if pick.topic.type != FIX:
        frame = _read_frame(found, name)
        return PoseSource(topic=pick.topic, found=found, home=name, frame=frame, notes=notes)
    columns, more = locate_fixes([file[name] for file in found if name in file])
    return PoseSource(
        topic=replace(pick.topic, count=len(columns)),
        found=[{name: columns}],
        home=name,
        frame="",
        notes={**notes, **more},
    )


def _integrate_wheels(
    bag: Bag, topics: Collection[TopicInfo], choice: ReadChoice, frames: Sequence[str]
) -> PoseSource:
    """Return the odometry of two wheels as messages of a separate topic."""
    if choice.wheel_joints is None or choice.wheels is None:
        given, needed = "wheels", "wheel_joints"
        given, needed = (needed, given) if choice.wheels is None else (given, needed)
        raise LogError(f"{given}: needs {needed}, too: {NEEDS_WHEELS}")
    if frames:
        raise LogError(f"{frames[0]}: expected poses from transforms, found wheel_joints")
    joints, wheels_m = parse_joints(choice.wheel_joints), parse_wheels(choice.wheels)
    topic = choose_joint_topic(topics, choice.pose_topic)
    messages = bag.read_topic(topic.topic, is_flat=False)
    columns, note = integrate_wheels(messages, joints, wheels_m)
    return PoseSource(
        topic=replace(topic, count=len(columns)),
        found=[{topic.topic: columns}],
        home=topic.topic,
        frame="",
        notes={**note_pick("pose_topic", Pick(topic=topic)), "wheels": note},
    )


def _pick_fix(topics: Collection[TopicInfo]) -> Pick | None:
    """Return the topic of a satellite receiver if there is exactly one."""
    found = [topic for topic in topics if topic.type == FIX and topic.count and not topic.reason]
    return Pick(topic=found[0]) if len(found) == 1 else None


def note_pick(name: str, pick: Pick, more: str = "") -> dict[str, str]:
    """Return notes on a chosen topic and its alternatives."""
    others = {f"other_{name}s": list_first_names(pick.others)} if pick.others else {}
    still = {"still": f"{pick.still} never moves and was left out"} if pick.still else {}
    return {name: pick.describe() + more, **others, **still}


def read_tree(bag: Bag, topics: Collection[TopicInfo], home: str = "") -> Tree:
    """Return all transforms of a bag, or those of the robot's own topics (/robot1/tf), if any."""
    held = [topic.topic for topic in topics if topic.type in TRANSFORM_TYPES and topic.count]
    place = home.rpartition("/")[0]
    own = [name for name in held if name.rpartition("/")[0] == place]
    names = own if any(not _is_static(name) for name in own) else held
    if not names:
        return {}
    files = bag.read(names, is_flat=False)
    links = {}
    # Transforms that are sent repeatedly come last, because they move.
    for is_static in (True, False):
        own = [name for name in names if _is_static(name) == is_static]
        found = (file[name] for name in own for file in files if name in file)
        links.update(collect_links(found, is_static=is_static))
    return links


def _is_static(topic: str) -> bool:
    return topic.rpartition("/")[2] == "tf_static"


def _pick(bag: Bag, topics: Collection[TopicInfo], asked: str | None) -> Pick:
    """Return the topic of poses, by its type or else by its fields, which must be read."""
    try:
        return choose_pose_topic(topics, asked)
    except NoPosesError:
        for topic in list_by_fields(topics):
            if _holds_poses(bag, topic.topic):
                return Pick(topic=topic)
        raise


_FEWEST_STILL: Final = 20
"""Number of equal messages from which a topic counts as never moving; fewer may be a waiting
robot."""


def _pick_moving(bag: Bag, topics: Collection[TopicInfo], pick: Pick) -> tuple[Pick, Found | None]:
    """Return a moving topic instead of one that never moves, with its messages if they were read.

    Some robots publish an odometry of zeros next to a computed odometry.
    """
    if not pick.others or pick.topic.type not in POSITIONS:
        return pick, None
    first = _read_moving(bag, pick.topic)
    if first is None or first[1]:
        return pick, first and first[0]
    named = [topic for topic in topics if topic.topic in pick.others and topic.type in POSITIONS]
    for other in named:
        try:
            read = _read_moving(bag, other)
        except LogError:
            continue  # it was not requested
        if read is not None and read[1]:
            others = (pick.topic.topic, *(name for name in pick.others if name != other.topic))
            return Pick(topic=other, others=others, still=pick.topic.topic), read[0]
    return pick, first[0]


def _read_moving(bag: Bag, topic: TopicInfo) -> tuple[Found, bool] | None:
    """Return the messages of a topic and whether positions differ in a bit; None if unknown."""
    if topic.count < _FEWEST_STILL or topic.reason:
        return None
    place, found = POSITIONS[topic.type], [*bag.read({topic.topic})]
    held = [file[topic.topic].fields for file in found if topic.topic in file]
    names = [f"{place}{name}" for name in "xyz"]
    columns = [
        np.concatenate([np.asarray(fields[name]) for fields in held])
        for name in names
        if all(name in fields for fields in held)
    ]
    return found, any((column != column[0]).any() for column in columns)


def _holds_poses(bag: Bag, topic: str) -> bool:
    try:
        found = bag.read({topic})
    except LogError:
        return False  # another encoding, or texts and lists: no poses
    return any(topic in file and find_pose_shape(file[topic].fields) for file in found)


def _pick_transforms(topics: Collection[TopicInfo]) -> Pick:
    fitting = [topic for topic in topics if topic.type in TRANSFORM_TYPES and topic.count]
    moving = [topic for topic in fitting if not _is_static(topic.topic)]
    if not moving:
        raise LogError("no transforms (/tf)")
    return Pick(topic=min(moving, key=lambda topic: (topic.topic.count("/"), topic.topic)))


def _trace_poses(
    bag: Bag, pick: Pick, topics: Collection[TopicInfo], choice: ReadChoice
) -> PoseSource:
    """Return poses of one frame in another frame as messages of a separate topic."""
    topic = pick.topic.topic
    tree = read_tree(bag, topics, topic)
    frames = {"robot": choice.pose_frame, "world": choice.world_frame}
    chosen = choose_frames(tree, **frames, name=choice.robot)
    link, held = trace_frame(tree, chosen)
    unheld = np.zeros(len(link.time_ns), dtype=bool)
    for one in held:
        unheld |= link.time_ns < one.time_ns[0]
    columns = build_link_columns(link, topic).select(~unheld)
    notes = note_pick("pose_topic", pick, f": {chosen.world} -> {chosen.robot}")
    if chosen.others:
        notes["other_frames"] = list_first_names(chosen.others)
    if held:
        names = ", ".join(one.describe() for one in held)
        notes["held_transforms"] = f"{names}: the newest that was recorded counts"
    if dropped := int(unheld.sum()):
        poses = describe_count(dropped, "pose")
        notes["dropped_before_transforms"] = f"{poses} before the first of {held[0].describe()}"
    if not len(columns):
        raise LogError(
            f"topic {topic}: expected {chosen.world} -> {chosen.robot} at one time at least, found"
            f" none after {held[0].describe()} began"
        )
    prefix, _, name = chosen.robot.rpartition("/")
    if not prefix and any(one.topic.startswith(f"/{name}/") for one in topics):
        prefix = name  # as /turtle1/cmd_vel belongs to turtle1
    return PoseSource(
        topic=TopicInfo(topic=topic, type=TRANSFORM, count=len(columns)),
        found=[{topic: columns}],
        home=f"/{prefix}/tf" if prefix else topic,
        frame=chosen.world,
        tree=tree,
        notes=notes,
    )


def _read_frame(found: Found, topic: str) -> str:
    """Return the frame in the first message; empty if there is none."""
    for of_file in found:
        for name in _FRAMES if topic in of_file and len(of_file[topic]) else ():
            if name in of_file[topic].fields:
                return str(of_file[topic].fields[name][0]).lstrip("/")
    return ""


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
            starts = {name: "/".join([*place, name, ""]) for name in names}
            return tuple(
                BagRobot(name=name, topics=tuple(t for t in held if t.topic.startswith(start)))
                for name, start in starts.items()
            )
    return ()


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
