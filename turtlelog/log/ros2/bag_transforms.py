"""Transforms between frames: the pose of one frame in another over time."""

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from itertools import pairwise
from typing import Any, Final

import numpy as np

from turtlelog.errors import LogError
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.planar_poses import FRAME_TRANSFORM, TRANSFORMS, Values
from turtlelog.log.ros2.bag_topics import list_numbers
from turtlelog.log.ros2.stamps import TimesNs
from turtlelog.run.angles import (
    compose_transforms,
    interpolate_rotation,
    invert_transform,
    rotate_vectors,
)

TRANSFORM: Final = "geometry_msgs/msg/TransformStamped"

_ROBOTS: Final = (
    re.compile(r"base_footprint"),
    re.compile(r"base_link"),
    re.compile(r"base|base_frame|robot|robot_base|chassis|body|turtle\d+"),
)
"""Patterns for robot frames (REP 105, REP 120); the frame on the ground is first."""

_WORLDS: Final = re.compile(r"earth|map|world|odom|odom_\w+|\w+_odom|mocap|optitrack|vicon")

_LONGEST_HELD_NS: Final = 1_000_000_000
"""Time that a transform is held before its first and after its last message [ns]."""

_NUMBER: Final = re.compile(r"\d+")
_NUMBERS: Final = tuple(f"transform.translation.{axis}" for axis in "xyz")
_TURNS: Final = tuple(f"transform.rotation.{axis}" for axis in "xyzw")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Link:
    """The transform from one frame to another, message by message.

    Attributes:
        parent: Frame in which the child is given.
        child: Frame that the transform places.
        time_ns: Log time of each message [ns], shape (n,), not decreasing.
        stamp_ns: Stamp of each message [ns], shape (n,).
        place_m: Position of the child's origin in the parent frame [m], shape (n, 3).
        turn: Rotation of the child as quaternions x, y, z, w, shape (n, 4).
        is_static: Whether the transform is static, so that only its last message is used.
    """

    parent: str
    child: str
    time_ns: TimesNs
    stamp_ns: TimesNs
    place_m: Values
    turn: Values
    is_static: bool = False

    @property
    def moves(self) -> bool:
        """Whether the messages differ."""
        values = np.hstack([self.place_m, self.turn])
        return not self.is_static and bool((values != values[0]).any())

    def hold(self, time_ns: TimesNs) -> tuple[Values, Values]:
        """Return the last recorded position and rotation at given times; NaN before the first."""
        if self.is_static or not self.moves:
            shape = (len(time_ns), 1)
            return np.tile(self.place_m[-1], shape), np.tile(self.turn[-1], shape)
        rows = np.searchsorted(self.time_ns, time_ns, side="right") - 1
        place_m, turn = self.place_m[rows], self.turn[rows]
        place_m[rows < 0], turn[rows < 0] = np.nan, np.nan
        return place_m, turn

    def interpolate(self, stamp_ns: int) -> tuple[Values, Values] | None:
        """Return place and turn at a stamp, between its neighbours; None if stamps are unusable.

        A stamp up to 1 s beyond the first or last message has the values of that message.
        """
        order = np.argsort(self.stamp_ns, kind="stable")
        stamps = self.stamp_ns[order]
        least, most = int(stamps[0]) - _LONGEST_HELD_NS, int(stamps[-1]) + _LONGEST_HELD_NS
        if stamps[0] <= 0 or not least <= stamp_ns <= most:
            return None
        after = int(np.clip(np.searchsorted(stamps, stamp_ns), 1, max(len(stamps) - 1, 1)))
        first, last = order[after - 1], order[min(after, len(stamps) - 1)]
        span_ns = int(self.stamp_ns[last] - self.stamp_ns[first])
        share = float(np.clip((stamp_ns - int(self.stamp_ns[first])) / max(span_ns, 1), 0.0, 1.0))
        place_m = (1.0 - share) * self.place_m[first] + share * self.place_m[last]
        turn = interpolate_rotation(self.turn[first], self.turn[last], share)
        return place_m[np.newaxis], turn[np.newaxis]

    def describe(self) -> str:
        """Return the names of both frames."""
        return f"{self.parent} -> {self.child}"


Tree = Mapping[tuple[str, str], Link]
"""Links by parent and child."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameChoice:
    """The two frames of a robot's poses.

    Attributes:
        world: Reference frame of the poses.
        robot: Frame of the robot.
        others: Other possible pairs.
    """

    world: str
    robot: str
    others: tuple[str, ...] = ()


def name_frame(columns: TopicColumns, row: int = 0) -> str:
    """Return the frame of a message, without the leading slash of early versions."""
    return str(columns.fields["header.frame_id"][row]).lstrip("/")


def collect_links(
    messages: Iterable[TopicColumns], *, is_static: bool
) -> dict[tuple[str, str], Link]:
    """Return the transforms in TFMessage messages, by parent and child."""
    rows: dict[tuple[str, str], list[tuple[int, dict[str, Any]]]] = defaultdict(list)
    for columns in map(_wrap_foxglove, messages):
        if "transforms" not in columns.fields:
            raise columns.describe_missing("transforms")
        times = columns.log_time_ns.tolist()
        for time_ns, found in zip(times, columns.fields["transforms"], strict=True):
            for one in found:
                names = one["header.frame_id"].lstrip("/"), one["child_frame_id"].lstrip("/")
                rows[names].append((time_ns, one))
    return {names: _build_link(names, found, is_static=is_static) for names, found in rows.items()}


def _wrap_foxglove(columns: TopicColumns) -> TopicColumns:
    """Return `foxglove.FrameTransform` messages as TFMessages of one transform each."""
    if columns.type != FRAME_TRANSFORM:
        return columns
    for name in _FOXGLOVE_NAMES:
        if name not in columns.fields:
            raise columns.describe_missing(name)
    found = (columns.fields[name].tolist() for name in _FOXGLOVE_NAMES)
    wrapped = np.empty(len(columns), dtype=object)
    for row, values in enumerate(zip(*found, strict=True)):
        wrapped[row] = [dict(zip(_FOXGLOVE_NAMES.values(), values, strict=True))]
    return replace(columns, type=TRANSFORMS, fields={"transforms": wrapped})


_FOXGLOVE_NAMES: Final = {
    "timestamp.sec": "header.stamp.sec",
    "timestamp.nsec": "header.stamp.nanosec",
    "parent_frame_id": "header.frame_id",
    "child_frame_id": "child_frame_id",
    **{f"translation.{axis}": f"transform.translation.{axis}" for axis in "xyz"},
    **{f"rotation.{axis}": f"transform.rotation.{axis}" for axis in "xyzw"},
}
"""Fields of Foxglove's message, and their names in the ROS message."""


def _build_link(
    names: tuple[str, str], rows: Sequence[tuple[int, dict[str, Any]]], *, is_static: bool
) -> Link:
    time_ns = np.array([time_ns for time_ns, _ in rows], dtype=np.int64)
    stamps = [
        one["header.stamp.sec"] * 1_000_000_000 + one["header.stamp.nanosec"] for _, one in rows
    ]
    order = np.argsort(time_ns, kind="stable")
    place_m, turn = (
        np.array([[one[name] for name in axes] for _, one in rows], dtype=float)
        for axes in (_NUMBERS, _TURNS)
    )
    return Link(
        parent=names[0],
        child=names[1],
        time_ns=time_ns[order],
        stamp_ns=np.array(stamps, dtype=np.int64)[order],
        place_m=place_m[order],
        turn=turn[order],
        is_static=is_static,
    )


def choose_frames(
    tree: Tree, *, robot: str | None, world: str | None, name: str | None
) -> FrameChoice:
    """Return the requested frames, completed by the most likely ones.

    Frames of a robot and of the world have well-known names, perhaps after the robot's. Without
    such names, the only moving link is chosen. A link below a robot's frame is a joint.
    """
    frames = {frame for names in tree for frame in names}
    robot, world = (None if one is None else one.lstrip("/") for one in (robot, world))
    for option, frame in (("pose_frame", robot), ("world_frame", world)):
        if frame is not None and frame not in frames:
            known = ", ".join(sorted(frames))[:300] or "none"
            raise LogError(
                f"{option}: expected a frame of the transforms, found {frame} among {known}"
            )
    if robot is not None:
        top = world or _find_world(tree, robot)
        return FrameChoice(world=top, robot=robot, others=_list_other_parents(tree, robot, top))
    # Without such names, a moving link that no frame above it moves, and that is no joint.
    found = _list_robots(tree, world) or [
        (parent, child)
        for (parent, child), link in tree.items()
        if link.moves
        and world in {None, parent}
        and not _list_moving(tree, parent)
        and not is_robot_frame(parent)
    ]
    if name is not None:
        # The frame of a named robot: turtle1, robot1/base_link.
        starts = (f"{name}/", f"{name}_")
        named = [pair for pair in found if pair[1] == name or pair[1].startswith(starts)]
        if not named and any("/" in frame for _, frame in found):
            robots = ", ".join(frame for _, frame in found)[:300]
            raise LogError(f"robot {name}: no frame begins with that name; found {robots}")
        found = named or found  # a robot's name may occur in topics alone
    if not found:
        links = ", ".join(link.describe() for link in tree.values() if link.moves) or "none"
        raise LogError(
            "expected transforms in which a robot moves in a world, such as odom -> base_link,"
            f" found those that move: {links[:300]}: --pose-frame and --world-frame choose"
        )
    if len({_NUMBER.sub("#", "|".join(pair)) for pair in found}) > 1:
        pairs = ", ".join(" -> ".join(pair) for pair in found)
        raise LogError(
            f"transforms: expected one robot, found {pairs[:300]}: choose with --pose-frame and"
            " --world-frame, or with --robot NAME"
        )
    ordered = sorted(found, key=lambda pair: list_numbers("|".join(pair)))
    others = tuple(" -> ".join(pair) for pair in ordered[1:])
    top, robot = ordered[0]
    return FrameChoice(
        world=top, robot=robot, others=(*_list_other_parents(tree, robot, top), *others)
    )


def _list_other_parents(tree: Tree, robot: str, world: str) -> tuple[str, ...]:
    """Return links from a second parent to a robot or a frame above it: two programs disagree."""
    above = _climb(tree, robot)
    below = above[: above.index(world)] if world in above else []
    return tuple(
        link.describe()
        for (parent, child), link in sorted(tree.items(), key=lambda one: one[0])
        if child in (robot, *below) and parent not in {robot, world, *below}
    )


def _list_robots(tree: Tree, world: str | None) -> list[tuple[str, str]]:
    """Return pairs of well-known frames, one pair per robot. Each robot has its own prefix."""
    robots: dict[str, tuple[int, str]] = {}
    for _, child in tree:
        prefix, _, name = child.rpartition("/")
        rank = next((k for k, kind in enumerate(_ROBOTS) if kind.fullmatch(name)), None)
        if rank is None or not _list_moving(tree, child):
            continue
        # Frames that differ only by number belong to different robots: turtle1, turtle2.
        key = f"{prefix}|{name if _NUMBER.search(name) else ''}"
        robots[key] = min(robots.get(key, (rank, child)), (rank, child))
    pairs = []
    for _, robot in robots.values():
        above = _climb(tree, robot)
        if world is not None:
            pairs += [(world, robot)] if world in above else []
        elif any(_is_world(name) for name in above):
            pairs.append((_find_world(tree, robot), robot))
    return pairs


def _list_moving(tree: Tree, frame: str) -> list[Link]:
    """Return the moving links from a frame up to the root."""
    above = [frame, *_climb(tree, frame)]
    links = [tree[parent, child] for child, parent in pairwise(above)]
    return [link for link in links if not link.is_static]


def _climb(tree: Tree, frame: str) -> list[str]:
    """Return the frames above a frame up to the root; of two parents, that with more messages."""
    above: list[str] = []
    while True:
        lower = above[-1] if above else frame
        parents = [
            (len(link.time_ns), parent) for (parent, child), link in tree.items() if child == lower
        ]
        if not parents or max(parents)[1] in [frame, *above]:
            return above
        above.append(max(parents)[1])


def _find_world(tree: Tree, robot: str) -> str:
    """Return the highest frame above a frame with a name of the world, or else the root."""
    above = _climb(tree, robot)
    if not above:
        raise LogError(f"pose_frame {robot}: no transform leads to it from another frame")
    worlds = [name for name in above if _is_world(name)]
    return worlds[-1] if worlds else above[-1]


def find_carrier(tree: Tree, frame: str) -> str | None:
    """Return the robot's frame that carries a fixed frame; None if no transform contains the frame.

    The result is the highest frame above with a robot's name, otherwise the first that moves.
    """
    if not any(frame in names for names in tree):
        return None
    above = [frame, *_climb(tree, frame)]
    robots = [name for name in above if is_robot_frame(name)]
    if robots:
        return robots[-1]
    moving = (child for child, parent in pairwise(above) if tree[parent, child].moves)
    return next(moving, above[-1])


def _is_world(frame: str) -> bool:
    return _WORLDS.fullmatch(frame.rpartition("/")[2]) is not None


def is_robot_frame(frame: str) -> bool:
    """Return whether a frame has a well-known name of a robot's frame."""
    return any(kind.fullmatch(frame.rpartition("/")[2]) for kind in _ROBOTS)


def trace_frame(tree: Tree, choice: FrameChoice) -> tuple[Link, tuple[Link, ...]]:
    """Return one frame in another frame, at every message of the moving link next to the robot.

    Other links that move, such as a localisation's correction map -> odom, are held at their last
    recorded value.

    Returns:
        The link from world to robot, NaN before the first message of a held link; the held links.
    """
    steps = _find_way(tree, choice.world, choice.robot)
    moving = [link for link, _ in steps if link.moves]
    moving = moving or [link for link, _ in steps if not link.is_static]
    if not moving:
        raise LogError(
            f"{choice.world} -> {choice.robot}: expected transforms that are sent again and again,"
            " found static ones alone"
        )
    leading = moving[-1]
    place_m, turn = _compose_way(steps, leading.time_ns)
    traced = replace(leading, parent=choice.world, child=choice.robot, place_m=place_m, turn=turn)
    return traced, tuple(link for link in moving if link is not leading)


def locate_frame(
    tree: Tree, world: str, frame: str, time_ns: TimesNs, stamp_ns: int | None = None
) -> tuple[Values, Values] | None:
    """Return the pose of a frame in another frame at some times; None if they are not connected.

    At log times [ns], shape (n,), links are as last recorded, at a stamp [ns] interpolated.
    """
    try:
        place_m, turn = _compose_way(_find_way(tree, world, frame), time_ns, stamp_ns)
    except LogError:
        return None
    return (place_m, turn) if np.isfinite(place_m).all() else None


_Step = tuple[Link, bool]
"""A link, and whether it is followed from parent to child."""


def _find_way(tree: Tree, start: str, end: str) -> list[_Step]:
    ways: dict[str, list[_Step]] = {start: []}
    waiting = [start]
    while waiting and end not in ways:
        frame = waiting.pop(0)
        for (parent, child), link in tree.items():
            for here, there, is_down in ((parent, child, True), (child, parent, False)):
                if here == frame and there not in ways:
                    ways[there] = [*ways[frame], (link, is_down)]
                    waiting.append(there)
    if end not in ways:
        raise LogError(
            f"transforms: none join {start} and {end}; frames:"
            f" {', '.join(sorted({name for names in tree for name in names}))[:300]}"
        )
    return ways[end]


def _compose_way(
    steps: Sequence[_Step], time_ns: TimesNs, stamp_ns: int | None = None
) -> tuple[Values, Values]:
    """Return place and turn at the end of a way, each link as held or interpolated."""
    none = np.zeros((len(time_ns), 3)), np.tile([0.0, 0.0, 0.0, 1.0], (len(time_ns), 1))
    parts = []
    for link, is_down in steps:
        found = link.interpolate(stamp_ns) if stamp_ns is not None and link.moves else None
        place_m, turn = link.hold(time_ns) if found is None else found
        parts.append((place_m, turn) if is_down else invert_transform(place_m, turn))
    if len(parts) == 1:
        return parts[0]  # exact, whatever the length of its quaternions
    return reduce(lambda left, right: compose_transforms(*left, *right), parts, none)


def build_link_columns(link: Link, topic: str) -> TopicColumns:
    """Return a link as TransformStamped messages of a separate topic."""
    numbers = zip((*_NUMBERS, *_TURNS), (*link.place_m.T, *link.turn.T), strict=True)
    rows = len(link.time_ns)
    frames = {"header.frame_id": link.parent, "child_frame_id": link.child}
    return TopicColumns(
        topic=topic,
        type=TRANSFORM,
        log_time_ns=link.time_ns,
        publish_time_ns=link.time_ns,
        sequence=np.zeros(rows, dtype=np.uint32),
        fields={
            "header.stamp.sec": link.stamp_ns // 1_000_000_000,
            "header.stamp.nanosec": link.stamp_ns % 1_000_000_000,
            **{name: np.full(rows, text, dtype=object) for name, text in frames.items()},
            **{name: np.ascontiguousarray(values) for name, values in numbers},
        },
    )


def bring_over(
    tree: Tree, home: str, frame: str, place_m: Values, turn: Values, time_ns: int
) -> tuple[Values, Values, str] | str:
    """Return positions and forward directions in the poses' frame, and the method; or why not."""
    frame, ahead = frame.lstrip("/"), rotate_vectors(turn, np.tile([1.0, 0.0, 0.0], (len(turn), 1)))
    if frame == home:
        return place_m, ahead, ""
    if not frame or not home:
        nameless = "poses name" if frame else "it names"
        return place_m, ahead, f", taken as in the frame of the poses, as {nameless} no frame"
    found = locate_frame(tree, home, frame, np.array([time_ns]))
    if found is None:
        return f"it is in {frame}, the poses in {home}, and no transform joins the two then"
    how = f", brought from {frame} to {home} by the transforms of that time"
    by = np.tile(found[1], (len(place_m), 1))
    return found[0] + rotate_vectors(by, place_m), rotate_vectors(by, ahead), how
