"""The surroundings of a robot in a bag: laser scans as points, maps and costmaps by cells."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import describe_count
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.file_access import name_file
from turtlelog.log.file_info import TopicInfo
from turtlelog.log.planar_poses import Values
from turtlelog.log.ros2.bag_poses import read_tree
from turtlelog.log.ros2.bag_rows import Bag, open_bag
from turtlelog.log.ros2.bag_topics import list_first_names
from turtlelog.log.ros2.bag_transforms import (
    Tree,
    find_carrier,
    is_robot_frame,
    locate_frame,
    name_frame,
)
from turtlelog.log.ros2.stamps import Stamps, TimesNs, read_stamp_clock, read_stamps
from turtlelog.run import Run
from turtlelog.run.angles import place_points, wrap_angle

SCAN: Final = "sensor_msgs/msg/LaserScan"

MOST_SCANS: Final = 400
"""Largest number of scans, evenly selected: a minute at 7 Hz."""

MOST_RAYS: Final = 360
"""Largest number of points per scan, evenly selected: one per degree."""

CELL_M: Final = 0.05
"""Cell size for thinning the points of all scans [m]; usual for maps."""

_MOST_CELLS: Final = 20_000
"""Largest number of cells of scans, and of cells of a map that determine a view: walls of 1 km."""

_MOST_MESSAGES: Final = 20_000
"""Largest number of scans that are read: an hour at 5 Hz, which takes 100 MB with 360 rays."""

_LONGEST_RAY_M: Final = 10_000.0
"""Range that no scanner on a robot reaches [m]; `range_max` may be infinite."""

_LONGEST_GAP_NS: Final = 1_000_000_000
"""Longest gap between poses in which a scan can be placed [ns]."""

GRID: Final = "nav_msgs/msg/OccupancyGrid"

UNKNOWN: Final = 255
"""Value of a cell with unknown occupancy; the message has -1."""

_MOST_OCCUPANCY: Final = 100

_MOST_GRID: Final = 16_000_000
"""Largest number of cells of a map that is read: 200 m by 200 m with 0.05 m."""

_LONGEST_SIDE: Final = 4096
"""Largest number of cells along a picture's side; graphics cards of browsers draw no larger
pictures."""

_OCCUPIED: Final = 65
"""Occupancy from which a cell is a wall [%], the default of ROS's map_server."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OccupancyMap:
    """A map, in the frame of a robot's poses.

    Attributes:
        topic: Topic of the map.
        is_costmap: Whether the values are costs of driving, not probabilities.
        cells: Occupancy [%] or `UNKNOWN`, by row and column, shape (height, width).
        corner_xy_m: Corner of the first cell [m], shape (2,).
        column_xy_m: Vector from one column to the next [m], shape (2,).
        row_xy_m: Vector from one row to the next [m], shape (2,).
    """

    topic: str
    is_costmap: bool
    cells: NDArray[np.uint8]
    corner_xy_m: Values
    column_xy_m: Values
    row_xy_m: Values

    @property
    def is_occupied(self) -> NDArray[np.bool_]:
        """Whether each cell is a wall, shape (height, width)."""
        return np.asarray((self.cells >= _OCCUPIED) & (self.cells != UNKNOWN))

    def list_occupied(self) -> Values:
        """Return centers of occupied cells [m], shape (n, 2); of very many, an even selection."""
        places = np.flatnonzero(self.is_occupied)
        places = places[:: -(-max(len(places), 1) // _MOST_CELLS)]
        rows, columns = np.divmod(places, max(self.cells.shape[1], 1))
        along = (columns + 0.5)[:, np.newaxis] * self.column_xy_m
        return np.asarray(self.corner_xy_m + along + (rows + 0.5)[:, np.newaxis] * self.row_xy_m)


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

    time_ns: TimesNs
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
    start_ns = run.origin.began_ns
    poses = "" if run.origin.poses is None else run.origin.poses.name
    home = poses.rpartition("/")[0]
    scan, grids = _pick_scan(bag.topics, home), _pick_maps(bag.topics, home)
    if start_ns is None or not (scan or grids):
        return None
    with name_file(bag.path, expected="a bag"):
        if run.origin.was_clock_set and any(one.topic == poses for one in bag.topics):
            bag = bag.find_steps(bag.read({poses}), poses)
        return _read(bag, run, start_ns, scan, grids)


def _pick_scan(topics: Collection[TopicInfo], home: str) -> TopicInfo | None:
    """Return the topic of scans below the robot's name `home`, or else that with most messages."""

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
        messages = bag.read_topic(scan.topic, is_flat=False)
        times, points = _place_scans(messages, run, start_ns, tree, notes)
        notes += _name_others(bag.topics, SCAN, [scan])
    read = (bag.read_topic(grid.topic, is_flat=False) for grid in grids)
    placed = [_place_map(messages, run, tree, notes) for messages in read]
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


def _place_scans(
    messages: Sequence[TopicColumns], run: Run, start_ns: int, tree: Tree, notes: list[str]
) -> tuple[TimesNs, tuple[Values, ...]]:
    """Return times of scans [ns], and their points in the frame of the poses [m]."""
    scans = [(columns, row) for columns in messages for row in range(len(columns))]
    time_ns = np.concatenate([_time_scans(columns, run) for columns in messages]) - start_ns
    order = np.argsort(time_ns, kind="stable")
    # Each scan needs a pose shortly before and shortly after it.
    beyond = [_LONGEST_GAP_NS + 1]
    gaps_ns = np.concatenate([beyond, np.diff(run.poses.time_ns), beyond])
    after = np.searchsorted(run.poses.time_ns, time_ns[order])
    known = order[gaps_ns[after] <= _LONGEST_GAP_NS]
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
    notes += _describe(messages[0].topic, carriers, len(scans), len(kept), len(known))
    return time_ns[kept], tuple(placed)


def _time_scans(columns: TopicColumns, run: Run) -> TimesNs:
    """Return the times of scans on the clock of the run's poses [ns]."""
    log_ns, stamp_ns = columns.log_time_ns, read_stamps(columns)
    if run.clock is None or run.clock.used == "log" or stamp_ns is None:
        return log_ns
    found = read_stamp_clock(Stamps(log_ns=log_ns, stamp_ns=stamp_ns))
    if found.is_other_pace and run.clock.offset_s is not None:
        return np.asarray(stamp_ns + round(run.clock.offset_s * 1e9))
    return log_ns if found.reason else found.time_ns


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
    points = points if at is None else place_points(*at, points)
    return np.asarray(points[:, :2])


def _to_world(points: Values, run: Run, time_ns: int) -> Values:
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
    most = np.argsort(-counts, kind="stable")[:_MOST_CELLS]
    return np.asarray((found[np.sort(most)] + 0.5) * CELL_M)


def _describe(
    topic: str, carriers: dict[str, str | None], count: int, kept: int, known: int
) -> Iterator[str]:
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


def _pick_maps(topics: Collection[TopicInfo], home: str) -> list[TopicInfo]:
    """Return the topics of the map and of the global costmap below it, or of the only costmap."""

    def rank(topic: TopicInfo) -> tuple[bool, bool, int, int]:
        is_own = topic.topic.rpartition("/")[0] == home
        return is_own, "global" in topic.topic, topic.count, -len(topic.topic)

    grids = [topic for topic in topics if topic.type == GRID and topic.count]
    costs = [topic for topic in grids if "costmap" in topic.topic]
    maps = [topic for topic in grids if topic not in costs]
    if maps:  # a local costmap moves with the robot: its last place says little of the drive
        costs = [topic for topic in costs if "global" in topic.topic]
    return [max(found, key=rank) for found in (maps, costs) if found]


def _place_map(
    messages: Sequence[TopicColumns], run: Run, tree: Tree, notes: list[str]
) -> OccupancyMap | None:
    """Return the last map of a topic in the frame of the poses; without a map, None and a note."""
    columns, row = messages[-1], len(messages[-1]) - 1
    fields, topic = columns.fields, columns.topic
    width, height = int(fields["info.width"][row]), int(fields["info.height"][row])
    size_m = float(fields["info.resolution"][row])
    data = np.asarray(fields["data"][row])
    if not (0.0 < size_m < np.inf) or width * height != len(data) or len(data) > _MOST_GRID:
        notes.append(
            f"The map of {topic} is left out: {width} x {height} cells of {size_m:g} m, and"
            f" {describe_count(len(data), 'value')}."
        )
        return None
    places = _place_corners(columns, row, size_m)
    if places is None:
        notes.append(f"The map of {topic} is left out: its origin has nan or infinity.")
        return None
    frame, home = name_frame(columns, row), run.origin.frame
    if frame and home and frame != home:
        at = locate_frame(tree, home, frame, columns.log_time_ns[row : row + 1])
        if at is None:
            notes.append(f"The map of {topic} is left out: nothing joins {frame} and {home}.")
            return None
        places = place_points(*at, places)
    cells, step = _read_cells(data.reshape(height, width))
    corner, column, line = places[:, :2]
    joined = "" if step == 1 else f", shown as cells of {step * size_m:g} m"
    found = OccupancyMap(
        topic=topic,
        is_costmap="costmap" in topic,
        cells=cells,
        corner_xy_m=corner,
        column_xy_m=(column - corner) * step,
        row_xy_m=(line - corner) * step,
    )
    count = describe_count(int(found.is_occupied.sum()), "occupied cell")
    notes.append(f"Map of {topic}: {width} x {height} cells of {size_m:g} m{joined}, {count}.")
    return found


def _place_corners(columns: TopicColumns, row: int, size_m: float) -> Values | None:
    """Return the first cell's corner, and those one column and one row on [m], shape (3, 3)."""
    origin, turn = (
        np.array([[float(columns.fields[f"info.origin.{kind}.{axis}"][row]) for axis in axes]])
        for kind, axes in (("position", "xyz"), ("orientation", "xyzw"))
    )
    if not (np.isfinite(origin).all() and np.isfinite(turn).all()):
        return None
    local = size_m * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    turn = turn if turn.any() else np.array([[0.0, 0.0, 0.0, 1.0]])
    return place_points(origin, turn, local)


def _read_cells(data: NDArray[np.generic]) -> tuple[NDArray[np.uint8], int]:
    """Return the cells of a map, joined if there are too many, and the number of joined cells."""
    signed = data.astype(np.int8)  # messages hold signed bytes; JSON has any numbers
    known = np.where((signed < 0) | (signed > _MOST_OCCUPANCY), np.int8(-1), signed)
    height, width = known.shape
    step = max(-(-max(height, width) // _LONGEST_SIDE), 1)
    if step > 1:
        more = (-height % step, -width % step)
        padded = np.pad(known, ((0, more[0]), (0, more[1])), constant_values=-1)
        tall, wide = padded.shape
        # The largest: a wall of one cell stays one, and what is known beside it stays known.
        known = padded.reshape(tall // step, step, wide // step, step).max(axis=(1, 3))
    return known.astype(np.uint8), step
