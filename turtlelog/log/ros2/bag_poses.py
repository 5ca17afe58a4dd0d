"""The poses in a bag: their source, a topic or transforms of two frames, and as a trajectory."""

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import describe_count
from turtlelog.errors import LogError
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.file_access import name_file
from turtlelog.log.file_info import TopicInfo
from turtlelog.log.planar_poses import (
    FIX,
    JOINTS,
    ODOMETRY,
    POSITIONS,
    TRANSFORM_TYPES,
    Fields,
    PoseShape,
    Values,
    extract_poses,
    find_pose_shape,
)
from turtlelog.log.read_choice import CHOSEN, NEEDS_WHEELS, ReadChoice, parse_joints, parse_wheels
from turtlelog.log.recording.topics import SENSED
from turtlelog.log.ros2 import bag_topics, bag_transforms
from turtlelog.log.ros2.bag_rows import Bag, Held, OrderedRows, drop_not_finite, order_topic
from turtlelog.log.ros2.computed_poses import integrate_wheels, locate_fixes
from turtlelog.log.ros2.reported_motion import LATERAL
from turtlelog.log.ros2.set_clocks import undo_clock_steps
from turtlelog.log.ros2.stamps import Stamps, TimesNs, join_arrays, join_stamps, read_stamp_clock
from turtlelog.run import Origin, Run, Trajectory, build_trajectory, turn_headings

Found = list[Mapping[str, TopicColumns]]
"""The columns of each file, by topic."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseSource:
    """The messages that contain poses.

    Attributes:
        topic: Name of the topic, with the type of the messages in `found`.
        found: The messages, by file.
        home: Topic or frame whose namespace is the robot's.
        origin: Topic and frame of the poses, and whether headings are courses.
        tree: Transforms, if they were read.
        notes: Chosen topics or frames, and the alternatives.
    """

    topic: TopicInfo
    found: Found
    home: str
    origin: Origin
    tree: bag_transforms.Tree = field(default_factory=dict)
    notes: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobotTrack:
    """Positions of the robot, in the frame of its poses.

    Attributes:
        time_ns: Time on the recorder's clock [ns], shape (n,), not decreasing.
        received_ns: The same time of each pose of the run, shape (m,), nearly in order.
        xy_m: Position [m], shape (n, 2).
        frame: Frame of the poses; empty if unknown.
        tree: Transforms between frames; empty without transforms.
    """

    time_ns: TimesNs
    received_ns: TimesNs
    xy_m: Values
    frame: str
    tree: bag_transforms.Tree

    def locate_time(self, run: Run, time_ns: int) -> int:
        """Return a time on the recorder's clock on the run's clock, as of the next pose [ns]."""
        row = min(int((self.received_ns < time_ns).sum()), len(run.poses) - 1)
        return int(run.poses.time_ns[row])


def find_poses(bag: Bag, topics: Collection[TopicInfo], choice: ReadChoice) -> PoseSource:
    """Return the messages with a robot's poses."""
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
            fixes = [one for one in topics if one.type == FIX and one.count and not one.reason]
            if choice.pose_topic is not None or len(fixes) != 1:
                raise
            pick = bag_topics.Pick(topic=fixes[0])
    if asked:
        found_instead = f"found {pick.source.describe()}, which are not"
        raise LogError(f"{asked[0]}: expected poses from transforms, {found_instead}")
    return _read_poses(bag, pick, found)


def _read_poses(bag: Bag, pick: bag_topics.Pick, found: Found | None) -> PoseSource:
    """Return the messages of a topic of poses; `found` contains them if they were read before."""
    name = pick.topic.topic
    if pick.topic.type == JOINTS:
        raise LogError(f"pose_topic {pick.source.describe()}: {NEEDS_WHEELS}")
    found = [*bag.read({name})] if found is None else found
    messages = [file[name] for file in found if name in file]
    notes, origin = note_pick("pose_topic", pick), Origin(poses=pick.source)
    if pick.topic.type != FIX:
        frames = (
            str(columns.fields[place][0]).lstrip("/")
            for columns in messages
            for place in ("header.frame_id", "frame_id")
            if place in columns.fields and len(columns)
        )
        origin = replace(origin, frame=next(frames, ""))
        return PoseSource(topic=pick.topic, found=found, home=name, origin=origin, notes=notes)
    columns, more = locate_fixes(messages)
    return PoseSource(
        topic=replace(pick.topic, count=len(columns)),
        found=[{name: columns}],
        home=name,
        origin=replace(origin, has_courses=True),
        notes={**notes, **more},
    )


def _integrate_wheels(
    bag: Bag, topics: Collection[TopicInfo], choice: ReadChoice, frames: Sequence[str]
) -> PoseSource:
    """Return the odometry of two wheels as messages of a separate topic."""
    if choice.wheel_joints is None or choice.wheels is None:
        needs = "wheels: needs wheel_joints" if choice.wheels else "wheel_joints: needs wheels"
        raise LogError(f"{needs}, too: {NEEDS_WHEELS}")
    if frames:
        raise LogError(f"{frames[0]}: expected poses from transforms, found wheel_joints")
    joints, wheels_m = parse_joints(choice.wheel_joints), parse_wheels(choice.wheels)
    topic = bag_topics.choose_joint_topic(topics, choice.pose_topic)
    messages = bag.read_topic(topic.topic, is_flat=False)
    columns, note = integrate_wheels(messages, joints, wheels_m)
    pick = bag_topics.Pick(topic=topic)
    return PoseSource(
        topic=replace(topic, count=len(columns)),
        found=[{topic.topic: columns}],
        home=topic.topic,
        origin=Origin(poses=pick.source),
        notes={**note_pick("pose_topic", pick), "wheels": note},
    )


_RATES: Final = frozenset({"speed", "turn_rate", "lateral_speed"})
"""Rates in messages of poses. In a topic of sensed poses, all rates are NaN."""


def order_poses(found: Held, topic: TopicInfo) -> tuple[OrderedRows, int, int, int]:
    """Return the finite poses in order of time, and the numbers of three kinds of dropped ones.

    These are all, those at a place without a heading, and of these those that point up or down.
    """
    rows = order_topic(found, topic, extract_poses)
    columns = rows.columns
    is_unturned = np.isnan(columns["heading"])
    # A quaternion that was never set has a tilt of 0.
    is_vertical = is_unturned & (columns.get("tilt", np.zeros(1)) > 0.0)
    has_place = np.isfinite(columns["x"]) & np.isfinite(columns["y"])
    speeds = [name for name in columns if name.removeprefix("measured_") in _RATES]
    unknown = [name for name in speeds if not np.isfinite(columns[name]).any()]
    columns = {name: column for name, column in columns.items() if name not in unknown}
    # Height and tilt are only described, and few robots move sideways.
    needed = [name for name in columns if name not in {"z", "tilt", LATERAL}]
    kept, dropped = drop_not_finite(replace(rows, columns=columns), needed)
    if not len(kept.time_ns) and is_vertical.sum() == dropped:
        raise LogError(
            f"topic {topic.topic}: the forward axis points up or down in all {dropped} poses: there"
            " is no heading"
        )
    if not len(kept.time_ns):
        raise LogError(
            f"topic {topic.topic}: expected numbers in x, y and heading, found nan or infinity in"
            f" all {dropped} poses"
        )
    return kept, dropped, int((has_place & is_unturned).sum()), int((has_place & is_vertical).sum())


def match_sensed(found: Held, time_ns: TimesNs, moved: int) -> dict[str, Values]:
    """Return sensed positions and headings, NaN if not sensed; empty if times fit no poses."""
    if moved or not any(SENSED.name in of_file for of_file in found):
        return {}
    kind = TopicInfo(topic=SENSED.name, type=SENSED.schema, count=0)
    sensed = order_topic(found, kind, extract_poses)
    rows = np.searchsorted(time_ns, sensed.time_ns)
    if not np.isin(sensed.time_ns, time_ns).all() or (np.diff(sensed.time_ns) == 0).any():
        return {}
    values = np.full((len(time_ns), 3), np.nan)
    values[rows] = np.column_stack([sensed.columns[name] for name in ("x", "y", "heading")])
    return {"sensed_xy_m": values[:, :2].copy(), "sensed_heading_rad": values[:, 2].copy()}


def note_pick(name: str, pick: bag_topics.Pick) -> dict[str, str]:
    """Return notes on a chosen topic and its alternatives."""
    others = {f"other_{name}s": bag_topics.list_first_names(pick.others)} if pick.others else {}
    still = {"still": f"{pick.still} never moves and was left out"} if pick.still else {}
    return {name: pick.source.describe(), **others, **still}


def read_tree(bag: Bag, topics: Collection[TopicInfo], home: str = "") -> bag_transforms.Tree:
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
        links.update(bag_transforms.collect_links(found, is_static=is_static))
    return links


def reports_sideways(bag: Bag, topics: Collection[TopicInfo], source: PoseSource) -> bool:
    """Return whether other odometry of the robot reports speeds to its side."""
    names = (
        topic.topic
        for topic in topics
        if (topic.type, topic.reason) == (ODOMETRY, "") and topic.topic != source.topic.topic
    )
    for name in names:
        if bag_topics.is_another_robots(name, source.home):
            continue
        with suppress(LogError):  # it was not requested
            aside = (found.fields["twist.twist.linear.y"] for found in bag.read_topic(name))
            if any(np.nan_to_num(column).any() for column in aside):
                return True
    return False


def _is_static(topic: str) -> bool:
    return topic.rpartition("/")[2] == "tf_static"


def _pick(bag: Bag, topics: Collection[TopicInfo], asked: str | None) -> bag_topics.Pick:
    """Return the topic of poses, by its type or else by its fields, which must be read."""
    try:
        return bag_topics.choose_pose_topic(topics, asked)
    except bag_topics.NoPosesError:
        for topic in bag_topics.list_by_fields(topics):
            with suppress(LogError):  # another encoding, or texts and lists: no poses
                files = [file for file in bag.read({topic.topic}) if topic.topic in file]
                if any(find_pose_shape(file[topic.topic].fields) for file in files):
                    return bag_topics.Pick(topic=topic)
        raise


_FEWEST_STILL: Final = 20
"""Number of equal messages from which a topic counts as never moving; fewer may be a waiting
robot."""


def _pick_moving(
    bag: Bag, topics: Collection[TopicInfo], pick: bag_topics.Pick
) -> tuple[bag_topics.Pick, Found | None]:
    """Return a moving topic instead of one that never moves, with its messages if read."""
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
            return bag_topics.Pick(topic=other, others=others, still=pick.topic.topic), read[0]
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


def _pick_transforms(topics: Collection[TopicInfo]) -> bag_topics.Pick:
    fitting = [topic for topic in topics if topic.type in TRANSFORM_TYPES and topic.count]
    moving = [topic for topic in fitting if not _is_static(topic.topic)]
    if not moving:
        raise LogError("no transforms (/tf)")
    return bag_topics.Pick(
        topic=min(moving, key=lambda topic: (topic.topic.count("/"), topic.topic))
    )


def _trace_poses(
    bag: Bag, pick: bag_topics.Pick, topics: Collection[TopicInfo], choice: ReadChoice
) -> PoseSource:
    """Return poses of one frame in another frame as messages of a separate topic."""
    topic = pick.topic.topic
    tree = read_tree(bag, topics, topic)
    chosen = bag_transforms.choose_frames(
        tree, robot=choice.pose_frame, world=choice.world_frame, name=choice.robot
    )
    link, held = bag_transforms.trace_frame(tree, chosen)
    unheld = np.zeros(len(link.time_ns), dtype=bool)
    for one in held:
        unheld |= link.time_ns < one.time_ns[0]
    columns = bag_transforms.build_link_columns(link, topic).select(~unheld)
    source = replace(pick.source, frames=(chosen.world, chosen.robot))
    notes = note_pick("pose_topic", pick) | {"pose_topic": source.describe()}
    if chosen.others:
        notes["other_frames"] = bag_topics.list_first_names(chosen.others)
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
        topic=TopicInfo(topic=topic, type=bag_transforms.TRANSFORM, count=len(columns)),
        found=[{topic: columns}],
        home=f"/{prefix}/tf" if prefix else topic,
        origin=Origin(poses=source, frame=chosen.world),
        tree=tree,
        notes=notes,
    )


def read_bag_trajectory(bag: Bag, choice: ReadChoice, *, names_topic: bool) -> Trajectory | None:
    """Return the poses of a bag, with heights and rotations if it has them; None without poses.

    The result is also None if the poses are computed, or have a reader of their own.
    """
    with name_file(bag.path, expected="a bag"):
        is_asked = choice.pose_topic is not None and choice.robot is None
        topics = bag.topics if is_asked else bag_topics.select_robot(bag.topics, choice.robot)[0]
        try:
            source = find_poses(bag, topics, choice)
        except bag_topics.NoPosesError:
            return None  # a run may be made of commands alone
        rows, is_spatial = list[tuple[Values, Values]](), True
        files = (of_file.get(source.topic.topic) for of_file in source.found)
        kept = [columns for columns in files if columns is not None and len(columns)]
        steps = bag.find_steps(source.found, source.topic.topic).steps
        kept = undo_clock_steps(kept, steps)
        for columns in kept:
            shape = find_pose_shape(columns.fields)
            if shape is None:
                return None
            is_spatial &= shape.heading is None and f"{shape.position}z" in columns.fields
            rows.append(_read_spatial_poses(columns.fields, shape))
        if not rows:
            return None
        time_ns, clock = _choose_times(kept, choice, is_set=bool(steps))
        xyz_m, turns = (np.concatenate(parts) for parts in zip(*rows, strict=True))
        turns[(turns**2).sum(axis=1) == 0.0] = np.nan
        never = time_ns <= 0
        if never.all() and len(never) > 1:
            raise LogError(
                f"topic {source.topic.topic}: expected times of poses, found 0 or before 1970 in"
                f" all {len(never)}"
            )
        turns[never if never.sum() > 1 else []] = np.nan  # a simulation begins at 0 once
        name = bag.path.name if bag.path.is_dir() else bag.path.stem
        name += f":{source.topic.topic}" if names_topic else ""
        notes = {CHOSEN: f"poses from {source.notes['pose_topic']}", "timed_by": clock}
        found = build_trajectory(name, time_ns, xyz_m, turns, notes=notes)
    return found if is_spatial else replace(found, space="plane")


def _choose_times(
    found: Sequence[TopicColumns], choice: ReadChoice, *, is_set: bool
) -> tuple[NDArray[np.int64], str]:
    """Return the times of poses and the name of their clock.

    If the clock was set while recording, only stamps mapped to it do not jump.
    """
    log_ns, stamp_ns = join_arrays([columns.log_time_ns for columns in found]), join_stamps(found)
    if choice.time == "log" or stamp_ns is None:
        return log_ns, "the recorder's clock"
    order = np.argsort(log_ns, kind="stable")
    clock = read_stamp_clock(Stamps(log_ns=log_ns[order], stamp_ns=stamp_ns[order]))
    if not clock.reason and is_set:
        time_ns = np.empty_like(log_ns)
        time_ns[order] = clock.time_ns
        return time_ns, "header stamps, mapped to the recorder's clock"
    if not clock.reason:
        return stamp_ns, "header stamps"
    if choice.time == "stamp":
        raise LogError(f"time: expected usable stamps of poses, but {clock.reason}: take log")
    return log_ns, f"the recorder's clock ({clock.reason})"


def _read_spatial_poses(fields: Fields, shape: PoseShape) -> tuple[Values, Values]:
    """Return positions [m] and rotations as quaternions w, x, y, z."""
    place = {axis: fields[f"{shape.position}{axis}"].astype(np.float64) for axis in "xy"}
    height = fields.get(f"{shape.position}z", 0.0 * place["x"]).astype(np.float64)
    xyz_m = np.column_stack([*place.values(), height])
    if shape.heading is not None:
        heading = fields[shape.heading].astype(np.float64)
        return xyz_m, turn_headings(np.radians(heading) if shape.is_degrees else heading)
    parts = [fields[f"{shape.orientation}{axis}"].astype(np.float64) for axis in "wxyz"]
    return xyz_m, np.column_stack(parts)
