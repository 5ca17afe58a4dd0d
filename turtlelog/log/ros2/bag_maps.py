"""Maps and costmaps of a bag: occupancy by cells, and the positions of the cells."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import describe_count
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.file_info import TopicInfo
from turtlelog.log.ros2.bag_transforms import Tree, locate_frame
from turtlelog.log.ros2.rigid_transforms import rotate
from turtlelog.run import Run

Values = NDArray[np.float64]

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

_MOST_CELLS: Final = 20_000
"""Largest number of occupied cells that determine the range of a view: walls of 1 km."""


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

    def list_occupied(self) -> Values:
        """Return centers of occupied cells [m], shape (n, 2); of very many, an even selection."""
        occupied = (self.cells >= _OCCUPIED) & (self.cells != UNKNOWN)
        places = np.flatnonzero(occupied)
        places = places[:: -(-max(len(places), 1) // _MOST_CELLS)]
        rows, columns = np.divmod(places, max(self.cells.shape[1], 1))
        along = (columns + 0.5)[:, np.newaxis] * self.column_xy_m
        return np.asarray(self.corner_xy_m + along + (rows + 0.5)[:, np.newaxis] * self.row_xy_m)


def pick_maps(topics: Collection[TopicInfo], home: str) -> list[TopicInfo]:
    """Return the topics of the map and of the global costmap below it, or of the only costmap.

    Args:
        topics: Topics of the bag.
        home: Beginning of the names of the robot's own topics.
    """

    def rank(topic: TopicInfo) -> tuple[bool, bool, int, int]:
        is_own = topic.topic.rpartition("/")[0] == home
        return is_own, "global" in topic.topic, topic.count, -len(topic.topic)

    grids = [topic for topic in topics if topic.type == GRID and topic.count]
    costs = [topic for topic in grids if _is_costmap(topic.topic)]
    maps = [topic for topic in grids if topic not in costs]
    if not maps:
        return [max(costs, key=rank)] if costs else []
    # A local costmap moves with the robot: its last place says little of the drive.
    costs = [topic for topic in costs if "global" in topic.topic]
    return [max(found, key=rank) for found in (maps, costs) if found]


def _is_costmap(topic: str) -> bool:
    return "costmap" in topic


def place_map(
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
    frame, home = name_frame(columns, row), run.notes.get("frame", "")
    if frame and home and frame != home:
        at = locate_frame(tree, home, frame, columns.log_time_ns[row : row + 1])
        if at is None:
            notes.append(f"The map of {topic} is left out: nothing joins {frame} and {home}.")
            return None
        places = at[0] + rotate(np.tile(at[1], (len(places), 1)), places)
    cells, step = _read_cells(data.reshape(height, width))
    corner, column, line = places[:, :2]
    joined = "" if step == 1 else f", shown as cells of {step * size_m:g} m"
    occupied = int(((cells >= _OCCUPIED) & (cells != UNKNOWN)).sum())
    count = describe_count(occupied, "occupied cell")
    notes.append(f"Map of {topic}: {width} x {height} cells of {size_m:g} m{joined}, {count}.")
    return OccupancyMap(
        topic=topic,
        is_costmap=_is_costmap(topic),
        cells=cells,
        corner_xy_m=corner,
        column_xy_m=(column - corner) * step,
        row_xy_m=(line - corner) * step,
    )


def _place_corners(columns: TopicColumns, row: int, size_m: float) -> Values | None:
    """Return the first cell's corner, and those one column and one row on [m], shape (3, 3)."""
    origin, turn = (
        np.array([[float(columns.fields[f"info.origin.{kind}.{axis}"][row]) for axis in axes]])
        for kind, axes in (("position", "xyz"), ("orientation", "xyzw"))
    )
    if not (np.isfinite(origin).all() and np.isfinite(turn).all()):
        return None
    local = size_m * np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    turns = np.tile(turn if turn.any() else [0.0, 0.0, 0.0, 1.0], (3, 1))
    return np.asarray(origin + rotate(turns, local))


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


def name_frame(columns: TopicColumns, row: int) -> str:
    """Return the frame of a message, without the leading slash of early versions."""
    return str(columns.fields["header.frame_id"][row]).lstrip("/")
