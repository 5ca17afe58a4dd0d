"""The commands of a robot in a bag, its goal and the path to follow."""

import math
import re
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np

from turtlelog.errors import LogError, PathError
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.file_info import TopicInfo
from turtlelog.log.planar_poses import (
    ACKERMANN_TYPES,
    COMMAND_TYPES,
    TWIST_TYPES,
    Values,
    extract_commands,
    find_twist,
)
from turtlelog.log.read_choice import (
    NEEDS_WHEELBASE,
    ReadChoice,
    parse_goal_option,
    parse_wheelbase,
)
from turtlelog.log.recording.topics import MEASURED, SHAPED, VELOCITY64
from turtlelog.log.ros2 import bag_topics
from turtlelog.log.ros2.bag_poses import PoseSource, RobotTrack, read_tree
from turtlelog.log.ros2.bag_rows import (
    Bag,
    Held,
    OrderedRows,
    drop_not_finite,
    order_topic,
    sort_messages,
)
from turtlelog.log.ros2.bag_transforms import bring_over, name_frame
from turtlelog.run import Run
from turtlelog.run.paths import LEAST_M, MOST_POINTS, Path

_NO_COMMANDS: Final = frozenset({VELOCITY64.name, SHAPED.name, MEASURED.name})
"""Topics of turtlelog recordings that contain no commands but have their type."""

_VELOCITIES: Final = re.compile(r"vel|velocity(?:_(?:local|body|world|enu|ned))?|twist|speed|accel")
"""Names of velocities that are measured if a pose has the same namespace: velocity_local and
velocity_body of /mavros/local_position/pose, twist of a motion capture's body."""

_COMMAND_NAMES: Final = (
    re.compile(r"cmd_vel"),
    re.compile(r"cmd_vel_(?:unstamped|stamped|out)"),
    # The smoother's output comes from the planner and passes through the collision monitor.
    re.compile(r"cmd_vel_smoothed"),
    re.compile(r"(?s:cmd_vel.*|.*(?:cmd|command).*)"),
)
"""Patterns for names of command topics; the topic that a base usually listens to is first."""

_CONTROLLER: Final = re.compile(r"(?:\w*_)?(?:velocity|drive|base|steering)_controller")
_SOURCE: Final = re.compile(r"(?:\w*_)?(?:joy|joystick|teleop|key|keyboard)(?:_\w*)?")
"""Namespaces of a base's last stage, and of a person's commands, its first: they name no robot."""

_NUMBERED: Final = re.compile(r"\d")
_OF_POSES: Final = re.compile(r"odom|pose|locali")

_WHOLE: Final = re.compile(r"(?:global_)?(?:plan|path)|reference(?:_path)?")
_LOCAL: Final = re.compile(r"local|transformed|received|trace|history|trail|driven")
_GOAL: Final = re.compile(r"(?:current_)?goal(?:_pose)?")

_AT_ROBOT_M: Final = 0.1
"""Largest distance of a path's end from the robot at which the path is the robot's trace [m]: a
robot's width, as the last position is a few tenths of a second old. A plan ends at the goal."""

_AT_ROBOT_SHARE: Final = 0.1
"""The same distance as a share of the path's length: a trace of 2 m, at 1 m/s, may be 0.2 s old."""

_ONE_GOAL_M: Final = 0.5
"""Largest distance between the ends of successive paths to one goal [m]; Nav2's tolerance."""

_MOST_PATHS: Final = 1000
"""Largest number of path messages that are read without request. A trace that grows point by point
takes 300 MB and 3 s. With one Nav2 plan per second, the number lasts a quarter of an hour."""

_MOST_LOOKED_AT: Final = 50
"""Number of messages of a path that are compared with the robot's position. The median decides."""


def find_commands(
    bag: Bag, topics: Sequence[TopicInfo], choice: ReadChoice, *, pose_topic: str
) -> tuple[bag_topics.Pick | None, str]:
    """Return the topic of the commands by its type or its fields, or the reason for none."""
    pick, lack = choose_commands(topics, choice, pose_topic=pose_topic)
    if pick is None:
        for topic in _list_named(topics):
            with suppress(LogError):  # texts and lists: no commands
                if any(find_twist(one.fields) is not None for one in bag.read_topic(topic.topic)):
                    return bag_topics.Pick(topic=topic), ""
    return pick, lack


def choose_commands(
    topics: Sequence[TopicInfo], choice: ReadChoice, *, pose_topic: str
) -> tuple[bag_topics.Pick | None, str]:
    """Return the topic of the commands, or the reason for none, perhaps empty.

    Ackermann commands need a wheelbase, and have priority if one is given.
    """
    asked, steering = choice.command_topic, ACKERMANN_TYPES
    choose = partial(choose_command_topic, topics, pose_topic=pose_topic)
    if choice.wheelbase is not None:
        parse_wheelbase(choice.wheelbase)
        if (pick := choose(asked, types=steering)) is not None:
            return pick, ""
        if asked is None and pose_topic == "":
            raise LogError(f"wheelbase: expected commands of {' or '.join(steering)}")
    types = COMMAND_TYPES if asked is not None else TWIST_TYPES
    pick = choose(asked, types=types)
    if pick is not None and pick.topic.type in steering:
        raise LogError(f"command_topic {pick.source.describe()}: {NEEDS_WHEELBASE}")
    if pick is not None or (steered := choose(None, types=steering)) is None:
        return pick, _describe_unread(topics) if pose_topic and pick is None else ""
    return None, f"commands on {steered.source.describe()}: {NEEDS_WHEELBASE}"


def _describe_unread(topics: Sequence[TopicInfo]) -> str:
    """Return the first topic that is named as commands and has another type; may be empty."""
    for one in _list_named(topics):
        known = "Twist and AckermannDrive are"
        if bag_topics.take_last(one.type) in {"Twist", "TwistStamped"}:
            known = "its fields are not those of a Twist"
        return f"commands on {one.topic}: {one.type} is not read, {known}"
    return ""


def _list_named(topics: Sequence[TopicInfo]) -> list[TopicInfo]:
    """Return readable topics of other types that are named as commands, the usual name first."""
    ranks = {one.topic: bag_topics.rank_name(one.topic, _COMMAND_NAMES) for one in topics}
    named = (
        one for one in topics if one.count and not one.reason and one.type not in COMMAND_TYPES
    )
    fitting = [one for one in named if ranks[one.topic] < len(_COMMAND_NAMES)]
    return sorted(fitting, key=lambda one: ranks[one.topic])


def choose_command_topic(
    topics: Iterable[TopicInfo],
    asked: str | None,
    *,
    pose_topic: str,
    types: Collection[str] = COMMAND_TYPES,
) -> bag_topics.Pick | None:
    """Return the requested topic, or else the most likely one; None if there is none.

    The topic next to the poses (/turtle2/cmd_vel for /turtle2/pose) has the highest priority, then
    the base's last stage and its usual name (cmd_vel before cmd_vel_nav), whichever of the robot's
    poses are read. Topics of other robots are never chosen. Without poses, `pose_topic` is empty.
    """
    held = [topic for topic in topics if topic.count]
    if asked is not None:
        return bag_topics.Pick(
            topic=bag_topics.find_asked(held, asked, (*COMMAND_TYPES,), "command_topic")
        )
    present, home = bag_topics.drop_unread(held), bag_topics.take_home(pose_topic)
    known = bag_topics.drop_two_types([topic for topic in present if topic.type in types], present)
    beside = [topic.topic for topic in known if home and bag_topics.take_home(topic.topic) == home]
    measured = {name for name in beside if _VELOCITIES.fullmatch(bag_topics.take_last(name))}
    fitting = [
        topic
        for topic in known
        if topic.topic not in _NO_COMMANDS | measured
        and not bag_topics.is_measured(topic.topic)
        and not bag_topics.is_another_robots(topic.topic, pose_topic)
    ]
    if not fitting:
        return None

    def rank(topic: TopicInfo) -> tuple[int, ...]:
        own, stage = _take_stage(topic.topic)
        near, depth = bag_topics.rank_place(own, _take_stage(pose_topic)[0])
        name = bag_topics.rank_name(topic.topic, _COMMAND_NAMES)
        # The robot's own commands have priority, and topics named as commands over all others.
        return int(name == len(_COMMAND_NAMES)), near, stage, name, depth

    chosen = bag_topics.require_one_topic(bag_topics.list_first(fitting, rank), "command_topic")
    return bag_topics.Pick(
        topic=chosen, others=tuple(topic.topic for topic in fitting if topic != chosen)
    )


def _take_stage(topic: str) -> tuple[str, int]:
    """Return a topic without namespaces of stages, and its stage: 0 of a controller, 2 a source."""
    words = topic.split("/")
    left = [
        word for word in words[:-1] if not (_CONTROLLER.fullmatch(word) or _SOURCE.fullmatch(word))
    ]
    stage = 1 if len(left) == len(words) - 1 else 2 * any(map(_SOURCE.fullmatch, words[:-1]))
    return "/".join([*left, words[-1]]), stage


def describe_other_robot(pose_topic: str, command_topic: str) -> str:
    """Return a sentence on commands in a namespace that is not that of the poses; else nothing.

    Poses in no namespace, or that of an estimator, belong to any robot without a number.
    """
    own = _take_stage(command_topic)[0].split("/")[1:-1]
    home = [word for word in pose_topic.split("/")[1:-1] if not _OF_POSES.search(word)]
    has_robot = bool(home) or any(map(_NUMBERED.search, own))
    if not own or not has_robot or not {*own}.isdisjoint(home):
        return ""
    where = f"the poses on {pose_topic} are not in that namespace"
    return f"the commands on {command_topic} may be another robot's, as {where}"


def order_commands(
    found: Held, topic: TopicInfo, choice: ReadChoice
) -> tuple[OrderedRows | None, int]:
    """Return finite commands and the number of dropped ones; None if no command is finite."""
    ordered = order_topic(found, topic, partial(extract_commands, wheelbase_m=choice.wheelbase))
    rows, dropped = drop_not_finite(ordered, [*ordered.columns])
    return (rows if len(rows.time_ns) else None), dropped


def add_references(
    run: Run, bag: Bag, source: PoseSource, track: RobotTrack, choice: ReadChoice
) -> Run:
    """Return a run with the goal and the path in its bag, or the requested ones."""
    topics, given = bag.topics, choice.goal
    goal_topic = None if given else _choose_goal_topic(topics, pose_topic=source.home)
    plans = _choose_path_topics(topics, choice.path_topic, pose_topic=source.home)
    goals = [] if goal_topic is None else bag.read_topic(goal_topic.topic, is_flat=False)
    is_long = bool(plans) and choice.path_topic is None and plans[0].count > _MOST_PATHS
    paths = [] if not plans or is_long else bag.read_topic(plans[0].topic, is_flat=False)
    named = {name_frame(columns) for columns in (*goals, *paths)}
    if track.frame and not track.tree and named - {track.frame, ""}:
        track = replace(track, tree=read_tree(bag, topics, source.home))
    notes, changes = dict[str, str](), dict[str, Any]()
    since_ns, goal_given_ns, path_given_ns = 0, None, None
    if given is not None:
        xy_m, heading_rad = parse_goal_option(given)
        changes, notes["goal"] = {"goal_xy_m": xy_m, "goal_heading_rad": heading_rad}, "as given"
    if goal_topic is not None:
        changes, notes["goal"], since_ns = _find_goal(goals, goal_topic.topic, track)
        notes["goal"] += "" if changes else _offer_poses(run, bag, goals, track)
        goal_given_ns = track.locate_time(run, since_ns) if changes else None
        notes |= {} if goal_given_ns is None else {"goal_set_ns": str(goal_given_ns)}
    if paths:
        points, notes["path"], given_ns = find_path(
            paths, plans[0].topic, track, since_ns=since_ns, is_asked=choice.path_topic is not None
        )
        path_given_ns = track.locate_time(run, given_ns) if points else None
        notes |= {} if path_given_ns is None else {"path_set_ns": str(path_given_ns)}
        others = bag_topics.list_first_names([topic.topic for topic in plans[1:]])
        notes |= {"other_path_topics": others} if others else {}
        if points is not None:
            notes["path_topic"] = f"{plans[0].topic} ({plans[0].type})"
            path = {"path.kind": "waypoints", "path.points": points}
            changes["parameters"] = {**run.parameters, **path}
    if is_long:
        said = f"{plans[0].count} messages, more than {_MOST_PATHS}: --path-topic reads them"
        notes["path"] = f"{plans[0].topic}: left out: {said}"
    known = {name for name, value in changes.items() if value is not None}
    absent = tuple(name for name in run.absent if name not in known)
    origin = replace(run.origin, goal_given_ns=goal_given_ns, path_given_ns=path_given_ns)
    return replace(run, absent=absent, origin=origin, notes={**run.notes, **notes}, **changes)


def _offer_poses(run: Run, bag: Bag, goals: Sequence[TopicColumns], track: RobotTrack) -> str:
    """Return the option for other poses in the frame of a goal that is left out; may be empty."""
    frames = {name_frame(columns) for columns in goals} - {track.frame, ""}
    others = filter(None, run.notes.get("other_pose_topics", "").split(", "))
    for name in others:
        with suppress(LogError):  # they are not read
            if frames & {name_frame(columns) for columns in bag.read_topic(name)}:
                return f": --pose-topic {name} takes poses in its frame"
    return ""


def _choose_path_topics(
    topics: Iterable[TopicInfo], asked: str | None, *, pose_topic: str
) -> list[TopicInfo]:
    """Return the requested path topic, or all that may contain plans (no traces), in order."""
    held = [topic for topic in topics if topic.count]
    if asked is not None:
        return [bag_topics.find_asked(held, asked, (bag_topics.PATH,), "path_topic")]

    def rank(topic: TopicInfo) -> tuple[int, ...]:
        near, depth = bag_topics.rank_place(topic.topic, pose_topic)
        return near, int(not _WHOLE.fullmatch(bag_topics.take_last(topic.topic))), depth

    present = bag_topics.drop_unread(held)
    counts = Counter(topic.topic for topic in present)
    fitting = [
        topic
        for topic in present
        if topic.type == bag_topics.PATH
        and counts[topic.topic] == 1
        and not _LOCAL.search(topic.topic)
        and not bag_topics.is_another_robots(topic.topic, pose_topic)
    ]
    return sorted(fitting, key=rank)


def _choose_goal_topic(topics: Iterable[TopicInfo], *, pose_topic: str) -> TopicInfo | None:
    fitting = (
        topic
        for topic in bag_topics.drop_unread(topic for topic in topics if topic.count)
        if topic.type == "geometry_msgs/msg/PoseStamped"
        and _GOAL.fullmatch(bag_topics.take_last(topic.topic))
        and not bag_topics.is_another_robots(topic.topic, pose_topic)
    )
    return min(
        fitting, key=lambda topic: bag_topics.rank_place(topic.topic, pose_topic), default=None
    )


def _find_goal(
    messages: Sequence[TopicColumns], topic: str, track: RobotTrack
) -> tuple[dict[str, Any], str, int]:
    """Return fields of the last goal set in the drive, a note, and when it was first given [ns].

    A goal in another frame needs transforms at its time.
    """
    rows = sort_messages(messages)
    known = [one for one in rows if one[0] <= track.time_ns[-1]] or rows
    _, number, row = known[-1]
    fields = {name: column[row] for name, column in messages[number].fields.items()}
    place_m = np.array([[float(fields[f"pose.position.{axis}"]) for axis in "xyz"]])
    turn = np.array([[float(fields[f"pose.orientation.{axis}"]) for axis in "xyzw"]])
    names = [name for name in fields if "stamp" not in name]
    texts = [
        tuple(str(messages[file].fields[name][one]) for name in names) for _, file, one in known
    ]
    others = {*texts}
    # A goal may be published again and again: it was given first after the last other goal.
    last_other = max((at for at, text in enumerate(texts) if text != texts[-1]), default=-1)
    time_ns = known[last_other + 1][0]
    many = f"the last of {len(others)} from {topic}: --goal chooses another"
    said = f"from {topic}" if len(others) == 1 else many
    if not np.isfinite(place_m).all():
        return {}, f"{topic}: left out: its position is no number", 0
    # The default of the message; programs without a goal heading leave it.
    has_heading = bool(np.isfinite(turn).all() and turn[0, :3].any())
    frame = str(fields["header.frame_id"])
    moved = bring_over(track.tree, track.frame, frame, place_m, turn, time_ns)
    if isinstance(moved, str):
        return {}, f"{topic}: left out: {moved}", 0
    place_m, ahead, how = moved
    heading_rad = math.atan2(ahead[0, 1], ahead[0, 0]) if has_heading else None
    said += how if has_heading else f"{how}, no heading"
    xy_m = float(place_m[0, 0]), float(place_m[0, 1])
    return {"goal_xy_m": xy_m, "goal_heading_rad": heading_rad}, said, time_ns


def find_path(
    messages: Sequence[TopicColumns],
    topic: str,
    track: RobotTrack,
    *,
    since_ns: int = 0,
    is_asked: bool = False,
) -> tuple[list[list[float]] | None, str, int]:
    """Return the points of the path that counts [m], None for none, a note and when it was given.

    It is the first path with a length after the goal was set (`since_ns`, on the recorder's clock),
    or, if later paths end elsewhere, the first to the last goal; in the frame of the poses.
    """
    paths = [
        (time_ns, *_read_points(messages[number], row, time_ns, track))
        for time_ns, number, row in sort_messages(messages)
    ]
    reasons = {reason for _, _, reason in paths if reason}
    known = [(time_ns, xy_m) for time_ns, xy_m, _ in paths if _measure(xy_m) >= LEAST_M]
    if not known:
        why = reasons.pop() if reasons else "no message of it has a length"
        return None, f"{topic}: left out: {why}", 0
    looked_at = known[:: -(-len(known) // _MOST_LOOKED_AT)]
    verdicts = [_is_trace(*one, track) for one in looked_at]
    told = [verdict for verdict in verdicts if verdict is not None] or [True]
    is_trace = float(np.median(told)) >= 0.5
    if is_trace and not is_asked:
        return None, f"{topic}: left out: it ends where the robot is, and is its trace", 0
    present = [one for one in known if one[0] <= track.time_ns[-1]] or known
    later = [one for one in present if one[0] >= since_ns] or present
    ends_m = np.array([one[-1] for _, one in later])
    apart = np.flatnonzero(np.hypot(*np.diff(ends_m, axis=0).T) > _ONE_GOAL_M)
    given_ns, xy_m = later[int(apart[-1]) + 1 if len(apart) else 0]  # the first to the last goal
    points = _thin(xy_m)
    try:
        Path(kind="waypoints", points=tuple((x, y) for x, y in points))
    except PathError as err:
        return None, f"{topic}: left out: {err}", 0
    plans = [*dict.fromkeys(one.tobytes() for _, one in known)]
    place = plans.index(xy_m.tobytes()) + 1
    which = "the first plan" if place == 1 else f"plan {place}"
    said = f"from {topic}" if len(plans) == 1 else f"{which} of {len(plans)} from {topic}"
    said += f", {len(points)} of its {len(xy_m)} points" if len(points) < len(xy_m) else ""
    said += ", though it ends where the robot is, as a trace does" if is_trace else ""
    return points, said, given_ns


def _is_trace(time_ns: int, xy_m: Values, track: RobotTrack) -> bool | None:
    """Return whether a path ends at the robot's position at its time of publication.

    The plan of a lap, which also begins there, is longer than the robot's drive up to then. None
    for a path that never leaves the robot: its trace at the start, or a plan after the arrival.
    """
    row = min(int(np.searchsorted(track.time_ns, time_ns)), len(track.time_ns) - 1)
    length_m = _measure(xy_m)
    near_m = max(_AT_ROBOT_M, _AT_ROBOT_SHARE * length_m)
    away_m = np.hypot(*(xy_m - track.xy_m[row]).T)
    is_lap = away_m[0] <= near_m and length_m > _measure(track.xy_m[: row + 1]) + near_m
    return None if away_m.max() <= near_m else bool(away_m[-1] <= near_m and not is_lap)


def _read_points(
    columns: TopicColumns, row: int, time_ns: int, track: RobotTrack
) -> tuple[Values, str]:
    """Return the points of a path in the frame of the poses, or no points and the reason."""
    try:
        found: list[dict[str, Any]] = columns.fields["poses"][row]
        frame = str(columns.fields["header.frame_id"][row])
    except KeyError as err:
        raise columns.describe_missing(err.args[0]) from err
    place_m = np.array(
        [[one[f"pose.position.{axis}"] for axis in "xyz"] for one in found], dtype=float
    ).reshape(-1, 3)
    place_m = place_m[np.isfinite(place_m).all(axis=1)]
    none = np.tile([0.0, 0.0, 0.0, 1.0], (len(place_m), 1))
    frame = frame or next((str(one["header.frame_id"]) for one in found), "")
    moved = bring_over(track.tree, track.frame, frame, place_m, none, time_ns)
    return (np.zeros((0, 2)), moved) if isinstance(moved, str) else (moved[0][:, :2], "")


def _measure(xy_m: Values) -> float:
    return float(np.hypot(*np.diff(xy_m, axis=0).T).sum()) if len(xy_m) > 1 else 0.0


def _thin(xy_m: Values) -> list[list[float]]:
    """Return the points without repetitions, thinned to the largest number of a path."""
    differs = np.append(True, (np.diff(xy_m, axis=0) != 0.0).any(axis=1))
    points = xy_m[differs]
    if len(points) > MOST_POINTS:
        points = points[np.linspace(0, len(points) - 1, MOST_POINTS).round().astype(np.int64)]
    found: list[list[float]] = points.tolist()
    return found
