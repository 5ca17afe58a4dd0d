"""Where the poses of a bag come from: a topic, the transforms between two frames, or its fields."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from turtlelog.errors import LogError
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.info import TopicInfo
from turtlelog.log.read_choice import ReadChoice
from turtlelog.log.ros2.bag import Bag
from turtlelog.log.ros2.bag_columns import find_pose_shape
from turtlelog.log.ros2.bag_topics import (
    TRANSFORM_TYPES,
    NoPosesError,
    Pick,
    choose_pose_topic,
    list_by_fields,
    list_names,
)
from turtlelog.log.ros2.bag_transforms import (
    TRANSFORM,
    FrameChoice,
    Tree,
    build_columns,
    choose_frames,
    collect_links,
    trace_frame,
)

Found = list[Mapping[str, TopicColumns]]
"""The columns of each file, by topic."""

_FRAMES: Final = ("header.frame_id", "frame_id")


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseSource:
    """The messages that hold poses.

    Attributes:
        topic: Its name, and the type of the messages in `found`.
        found: The messages, by file.
        home: A topic or frame whose place among the names is the robot's.
        frame: In which the poses are; empty where they name none.
        tree: Transforms, where they were read.
        notes: Which were chosen, and which could have been meant as well.
    """

    topic: TopicInfo
    found: Found
    home: str
    frame: str
    tree: Tree = field(default_factory=dict)
    notes: Mapping[str, str] = field(default_factory=dict)


def find_poses(bag: Bag, topics: Collection[TopicInfo], choice: ReadChoice) -> PoseSource:
    """Return the messages that hold a robot's poses.

    Raises:
        LogError: Where there are none, or nothing tells which of several.
    """
    frames = {"pose_frame": choice.pose_frame, "world_frame": choice.world_frame}
    asked = [name for name, value in frames.items() if value is not None]
    if asked and choice.pose_topic is None:
        return _trace_poses(bag, _pick_transforms(topics), topics, choice)
    pick = _pick(bag, topics, choice.pose_topic)
    if pick.topic.type in TRANSFORM_TYPES:
        return _trace_poses(bag, pick, topics, choice)
    if asked:
        name = asked[0]
        raise LogError(
            f"{name}: expected poses from transforms, found {pick.describe()}, which are not"
        )
    found = [*bag.read({pick.topic.topic})]
    return PoseSource(
        topic=pick.topic,
        found=found,
        home=pick.topic.topic,
        frame=_read_frame(found, pick.topic.topic),
        notes=note_pick("pose_topic", pick),
    )


def note_pick(name: str, pick: Pick, more: str = "") -> dict[str, str]:
    """Return notes on a topic that was chosen, and on those that could have been meant."""
    others = {f"other_{name}s": list_names(pick.others)} if pick.others else {}
    return {name: pick.describe() + more, **others}


def read_tree(bag: Bag, topics: Collection[TopicInfo], home: str = "") -> Tree:
    """Return all transforms of a bag, those of a robot's own topics (/robot1/tf) where it has them.

    Raises:
        LogError: Where they cannot be read.
    """
    held = [topic.topic for topic in topics if topic.type in TRANSFORM_TYPES and topic.count]
    place = home.rpartition("/")[0]
    own = [name for name in held if name.rpartition("/")[0] == place]
    names = own if any(not _is_static(name) for name in own) else held
    if not names:
        return {}
    files = bag.read(names, is_flat=False)
    links = {}
    # What is sent again and again comes last: it moves.
    for is_static in (True, False):
        chosen = [
            file[name]
            for name in names
            if _is_static(name) == is_static
            for file in files
            if name in file
        ]
        links.update(collect_links(chosen, is_static=is_static))
    return links


def _is_static(topic: str) -> bool:
    return topic.rpartition("/")[2] == "tf_static"


def _pick(bag: Bag, topics: Collection[TopicInfo], asked: str | None) -> Pick:
    """Return the topic by its type, or else by its fields, which only reading tells."""
    try:
        return choose_pose_topic(topics, asked)
    except NoPosesError:
        for topic in list_by_fields(topics):
            if _holds_poses(bag, topic.topic):
                return Pick(topic=topic)
        raise


def _holds_poses(bag: Bag, topic: str) -> bool:
    try:
        found = bag.read({topic})
    except LogError:
        return False  # of another encoding, or of texts and lists: no pose
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
    """Return poses of one frame in another as messages of a topic of their own."""
    topic = pick.topic.topic
    tree = read_tree(bag, topics, topic)
    chosen = choose_frames(tree, robot=choice.pose_frame, world=choice.world_frame)
    link, held = trace_frame(tree, chosen)
    unheld = np.zeros(len(link.time_ns), dtype=bool)
    for one in held:
        unheld |= link.time_ns < one.time_ns[0]
    columns = build_columns(link, topic).select(~unheld)
    notes = note_pick("pose_topic", pick, f": {chosen.world} -> {chosen.robot}")
    notes |= _note_frames(chosen, [one.describe() for one in held], int(unheld.sum()))
    if not len(columns):
        raise LogError(
            f"topic {topic}: expected {chosen.world} -> {chosen.robot} at one time at least, found"
            f" none after {held[0].describe()} began"
        )
    prefix, _, name = chosen.robot.rpartition("/")
    if not prefix and any(one.topic.startswith(f"/{name}/") for one in topics):
        prefix = name  # as /turtle1/cmd_vel is of turtle1
    return PoseSource(
        topic=TopicInfo(topic=topic, type=TRANSFORM, count=len(columns)),
        found=[{topic: columns}],
        home=f"/{prefix}/tf" if prefix else topic,
        frame=chosen.world,
        tree=tree,
        notes=notes,
    )


def _note_frames(chosen: FrameChoice, held: Sequence[str], dropped: int) -> dict[str, str]:
    notes = {}
    if chosen.others:
        notes["other_frames"] = list_names(chosen.others)
    if held:
        notes["held_transforms"] = f"{', '.join(held)}: the newest that was recorded counts"
    if dropped:
        notes["dropped_before_transforms"] = f"{dropped} poses before the first of {held[0]}"
    return notes


def _read_frame(found: Found, topic: str) -> str:
    """Return the frame that the first message names, empty where it names none."""
    for of_file in found:
        for name in _FRAMES if topic in of_file and len(of_file[topic]) else ():
            if name in of_file[topic].fields:
                return str(of_file[topic].fields[name][0]).lstrip("/")
    return ""
