"""Laser scans as points in the plane, and the map of a robot."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import describe_count, parse_utc
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.file_access import name_file
from turtlelog.log.file_info import TopicInfo
from turtlelog.log.ros2.bag import Bag, open_bag
from turtlelog.log.ros2.bag_maps import GRID, OccupancyMap, name_frame, pick_maps, place_map
from turtlelog.log.ros2.bag_poses import read_tree
from turtlelog.log.ros2.bag_topics import list_first_names
from turtlelog.log.ros2.bag_transforms import (
    Tree,
    find_carrier,
    is_robot_frame,
    locate_frame,
)
from turtlelog.log.ros2.rigid_transforms import rotate
from turtlelog.log.ros2.stamps import Stamps, read_stamp_clock, read_stamps
from turtlelog.run import Run
from turtlelog.run.angles import wrap_angle

Values = NDArray[np.float64]
Times = NDArray[np.int64]

SCAN: Final = "sensor_msgs/msg/LaserScan"

MOST_SCANS: Final = 400
"""Largest number of scans, evenly selected: a minute at 7 Hz, or one in seven scans of ten minutes
at 5 Hz."""

MOST_RAYS: Final = 360
"""Largest number of points per scan, evenly selected: one per degree."""

CELL_M: Final = 0.05
"""Cell size for thinning the points of all scans [m]; usual for maps."""

MOST_CELLS: Final = 20_000
"""Largest number of cells: walls of 1 km."""

_MOST_MESSAGES: Final = 20_000
"""Largest number of scans that are read: an hour at 5 Hz. More scans of 360 rays would take over
100 MB."""

_LONGEST_RAY_M: Final = 10_000.0
"""Range that no scanner on a robot reaches [m]; `range_max` may be infinite."""

_LONGEST_GAP_NS: Final = 1_000_000_000
"""Longest gap between poses in which a scan can be placed [ns]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surroundings:
    """The surroundings of a robot, in the frame of its poses.

    Attributes:
        time_ns: Time of each scan on the run's clock [ns], shape (n,), not decreasing.
        scans_xy_m: Points of each scan [m], shape (k, 2) each.
        walls_xy_m: Centers of the cells that contain scan points [m], shape (m, 2).
        maps: The last map, and the last global costmap.
        notes: Sources and parts left out, in sentences.
    """

    time_ns: Times
    scans_xy_m: tuple[Values, ...]
    walls_xy_m: Values
    maps: tuple[OccupancyMap, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def map_xy_m(self) -> Values:
        """Centers of occupied cells of the map [m], shape (c, 2); if many, an even selection."""
        return self.maps[0].list_occupied() if self.maps else np.zeros((0, 2))


def read_surroundings(path: str | Path, run: Run) -> Surroundings | None:
    """Return the laser scans and the map in the bag of a run.

    A scan is placed at the robot's linearly interpolated pose. /tf gives the place of the scanner
    on the robot; without /tf, the scanner is at the robot's origin. Scans and rays are thinned.

    Args:
        path: The bag of the run.
        run: Run read from this bag.

    Returns:
        None: If the bag has neither a scan nor a map, or the run's clock is unknown.

    Raises:
        LogError: If the bag cannot be read.
    """
    bag = open_bag(path)
    start_ns = parse_utc(run.notes.get("original_timestamp", ""))
    home = run.notes.get("pose_topic", "").partition(" ")[0].rpartition("/")[0]
    scan, grids = _pick_scan(bag.topics, home), pick_maps(bag.topics, home)
    if start_ns is None or not (scan or grids):
        return None
    with name_file(bag.path, expected="a bag"):
        return _read(bag, run, start_ns, scan, grids)


def _pick_scan(topics: Collection[TopicInfo], home: str) -> TopicInfo | None:
    """Return the topic of scans below the robot's name, or else the one with the most messages."""

    def rank(topic: TopicInfo) -> tuple[bool, int, int]:
        return topic.topic.rpartition("/")[0] == home, topic.count, -len(topic.topic)

    return max((one for one in topics if one.type == SCAN and one.count), key=rank, default=None)


def _read(
    bag: Bag, run: Run, start_ns: int, scan: TopicInfo | None, grids: Sequence[TopicInfo]
) -> Surroundings:
    tree = read_tree(bag, bag.topics, scan.topic if scan else "")
    notes: list[str] = []
    times, points = np.zeros(0, dtype=np.int64), tuple[Values, ...]()
    if scan is not None and scan.count > _MOST_MESSAGES:
        notes.append(f"{scan.topic} has {scan.count} scans, more than {_MOST_MESSAGES}: left out.")
    elif scan is not None:
        times, points = _place_scans(_collect(bag, scan), run, start_ns, tree, notes)
        notes += _name_others(bag.topics, SCAN, [scan])
    placed = [place_map(_collect(bag, grid), run, tree, notes) for grid in grids]
    notes += _name_others(bag.topics, GRID, grids)
    return Surroundings(
        time_ns=times,
        scans_xy_m=points,
        walls_xy_m=_thin(points),
        maps=tuple(one for one in placed if one is not None),
        notes=tuple(notes),
    )


def _name_others(
    topics: Collection[TopicInfo], kind: str, shown: Collection[TopicInfo]
) -> Iterator[str]:
    others = [one.topic for one in topics if one.type == kind and one.count and one not in shown]
    if others:
        noun = "scans" if kind == SCAN else "maps"
        yield f"Other {noun} are left out: {list_first_names(others)}."


def _collect(bag: Bag, topic: TopicInfo) -> list[TopicColumns]:
    return [
        file[topic.topic]
        for file in bag.read({topic.topic}, is_flat=False)
        if topic.topic in file and len(file[topic.topic])
    ]


def _place_scans(
    messages: Sequence[TopicColumns], run: Run, start_ns: int, tree: Tree, notes: list[str]
) -> tuple[Times, tuple[Values, ...]]:
    """Return times of scans [ns], and their points in the frame of the poses [m]."""
    scans = [(columns, row) for columns in messages for row in range(len(columns))]
    time_ns = np.concatenate([_time_scans(columns, run) for columns in messages]) - start_ns
    order = np.argsort(time_ns, kind="stable")
    known = order[_has_pose(run, time_ns[order])]
    if not len(known):
        notes.append(f"No scan of {messages[0].topic} was taken while the poses are known.")
        return np.zeros(0, dtype=np.int64), ()
    step = -(-len(known) // MOST_SCANS)
    kept = known[::step]
    frames = dict.fromkeys(name_frame(*scans[row]) for row in kept)
    carriers = {frame: find_carrier(tree, frame) for frame in frames}
    placed = [
        _to_world(_to_robot(scans[row], tree, carriers), run, int(time_ns[row])) for row in kept
    ]
    notes += _describe(messages, carriers, len(scans), len(kept), len(known))
    return time_ns[kept], tuple(placed)


def _time_scans(columns: TopicColumns, run: Run) -> Times:
    """Return the times of scans on the clock of the run's poses [ns]."""
    log_ns, stamp_ns = columns.log_time_ns, read_stamps(columns)
    if run.clock is None or run.clock.used == "log" or stamp_ns is None:
        return log_ns
    found = read_stamp_clock(Stamps(log_ns=log_ns, stamp_ns=stamp_ns))
    if found.is_other_pace and run.clock.offset_s is not None:
        return np.asarray(stamp_ns + round(run.clock.offset_s * 1e9))
    return log_ns if found.reason else found.time_ns


def _has_pose(run: Run, time_ns: Times) -> NDArray[np.bool_]:
    """Return whether there is a pose shortly before and shortly after each time."""
    poses_ns = run.poses.time_ns
    after = np.searchsorted(poses_ns, time_ns)
    inside = (after > 0) & (after < len(poses_ns))
    after = np.clip(after, 1, max(len(poses_ns) - 1, 1))
    if len(poses_ns) < 2:
        return np.zeros(len(time_ns), dtype=bool)
    return np.asarray(inside & (poses_ns[after] - poses_ns[after - 1] <= _LONGEST_GAP_NS))


def _to_robot(
    scan: tuple[TopicColumns, int], tree: Tree, carriers: dict[str, str | None]
) -> Values:
    """Return the points of a scan in the frame of the robot [m], shape (k, 2)."""
    columns, row = scan
    fields = columns.fields
    ranges = np.asarray(fields["ranges"][row], dtype=np.float64)
    step = -(-max(len(ranges), 1) // MOST_RAYS)
    numbers = np.arange(0, len(ranges), step)
    ranges = ranges[::step]
    low, high = float(fields["range_min"][row]), float(fields["range_max"][row])
    seen = np.isfinite(ranges) & (ranges >= low) & (ranges <= high) & (ranges > 0.0)
    angle = float(fields["angle_min"][row]) + numbers * float(fields["angle_increment"][row])
    seen &= np.isfinite(angle) & (ranges <= _LONGEST_RAY_M)
    reach, angle = ranges[seen], angle[seen]
    points = np.column_stack([reach * np.cos(angle), reach * np.sin(angle), np.zeros(len(reach))])
    frame = name_frame(columns, row)
    carrier = carriers[frame]
    if carrier is None:
        return np.asarray(points[:, :2])
    stamps_ns = read_stamps(columns)
    stamp_ns = None if stamps_ns is None else int(stamps_ns[row])
    at = locate_frame(tree, carrier, frame, columns.log_time_ns[row : row + 1], stamp_ns)
    if at is None:
        return np.asarray(points[:, :2])
    place_m, turn = at
    return np.asarray((place_m + rotate(np.tile(turn, (len(points), 1)), points))[:, :2])


def _to_world(points: Values, run: Run, time_ns: int) -> Values:
    """Return points in the robot's frame, converted to the frame of its poses [m]."""
    poses = run.poses
    after = int(np.clip(np.searchsorted(poses.time_ns, time_ns), 1, len(poses) - 1))
    span_ns = int(poses.time_ns[after] - poses.time_ns[after - 1])
    share = (time_ns - int(poses.time_ns[after - 1])) / span_ns if span_ns else 0.0
    first, last = poses.heading_rad[after - 1], poses.heading_rad[after]
    heading = float(first + share * wrap_angle(last - first))
    xy_m = (1.0 - share) * poses.xy_m[after - 1] + share * poses.xy_m[after]
    cosine, sine = np.cos(heading), np.sin(heading)
    return np.asarray(xy_m + points @ np.array([[cosine, sine], [-sine, cosine]]))


def _thin(points: Sequence[Values]) -> Values:
    """Return the centers of the cells that contain points, those with most points first."""
    if not points:
        return np.zeros((0, 2))
    cells = np.floor(np.concatenate(points) / CELL_M).astype(np.int64)
    found, counts = np.unique(cells, axis=0, return_counts=True)
    most = np.argsort(-counts, kind="stable")[:MOST_CELLS]
    return np.asarray((found[np.sort(most)] + 0.5) * CELL_M)


def _describe(
    messages: Sequence[TopicColumns],
    carriers: dict[str, str | None],
    count: int,
    kept: int,
    known: int,
) -> Iterator[str]:
    topic = messages[0].topic
    thinned = "" if kept == known else f", {kept} of them shown"
    yield f"Scans of {topic}: {describe_count(count, 'scan')}{thinned}."
    if known < count:
        lost = describe_count(count - known, "scan")
        verbs = ("has", "is") if known == count - 1 else ("have", "are")
        yield f"{lost} of {topic} {verbs[0]} no pose within 1 s and {verbs[1]} left out."
    for frame, carrier in carriers.items():
        if carrier is None and not is_robot_frame(frame):
            name = frame or "the scanner"
            yield f"No transform tells where {name} is on the robot: taken to be its middle."
