"""The rows of a run in the messages of other people's types, put in order."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlelog.angles import wrap_angle
from turtlelog.errors import LogError
from turtlelog.log.engine.topic_columns import TopicColumns

Fields = Mapping[str, NDArray[Any]]
Values = NDArray[np.float64]


def extract_poses(kind: str, fields: Fields) -> dict[str, Values]:
    """Return x, y [m] and heading [rad], speed [m/s] and turn rate [rad/s] where the type has them.

    turtlesim publishes what it applied, a robot's odometry what it measured.

    Raises:
        LogError: Where a quaternion is no rotation.
    """
    if kind.startswith("turtlesim"):
        return {
            "x": _widen(fields["x"]),
            "y": _widen(fields["y"]),
            "heading": _widen(fields["theta"]),
            # Before Humble the sign of the speed was published, too.
            "speed": np.abs(_widen(fields["linear_velocity"])),
            "turn_rate": _widen(fields["angular_velocity"]),
        }
    pose = "pose.pose" if kind == "nav_msgs/msg/Odometry" else "pose"
    columns = {
        "x": _widen(fields[f"{pose}.position.x"]),
        "y": _widen(fields[f"{pose}.position.y"]),
        "heading": _compute_yaw(fields, f"{pose}.orientation"),
    }
    if kind == "nav_msgs/msg/Odometry":
        twist = "twist.twist"
        columns["measured_speed"] = _widen(fields[f"{twist}.linear.x"])
        columns["measured_turn_rate"] = _widen(fields[f"{twist}.angular.z"])
    return columns


def extract_commands(kind: str, fields: Fields) -> dict[str, Values]:
    """Return forward and lateral speed [m/s] and turn rate [rad/s]."""
    twist = "twist." if kind == "geometry_msgs/msg/TwistStamped" else ""
    return {
        "speed": _widen(fields[f"{twist}linear.x"]),
        "lateral_speed": _widen(fields[f"{twist}linear.y"]),
        "turn_rate": _widen(fields[f"{twist}angular.z"]),
    }


def wrap_far_headings(heading_rad: Values) -> tuple[Values, int]:
    """Return headings within a float32 step of [-pi, pi), and how many were not.

    turtlesim's own rounding leaves that interval by less than a step; such headings stay.
    """
    far = np.abs(heading_rad) > np.nextafter(np.float32(np.pi), np.float32(4.0))
    return np.where(far, wrap_angle(heading_rad), heading_rad), int(far.sum())


def _compute_yaw(fields: Fields, orientation: str) -> Values:
    """Return the turn about the vertical axis of quaternions of any length."""
    x, y, z, w = (_widen(fields[f"{orientation}.{name}"]) for name in "xyzw")
    # The default of the message is all zeros in ROS 1 and in programs that never set it.
    empty = x**2 + y**2 + z**2 + w**2 == 0.0
    if empty.any():
        raise LogError(
            f"message {int(empty.argmax())}: {orientation}: expected a rotation, found all zeros"
        )
    return np.arctan2(2.0 * (w * z + x * y), w**2 + x**2 - y**2 - z**2)


def _widen(values: NDArray[Any]) -> Values:
    return values.astype(np.float64)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OrderedRows:
    """The rows of a topic in order of time.

    Attributes:
        time_ns: As in the file [ns], shape (n,), not decreasing.
        columns: By name, each of shape (n,).
        late: Rows that stood behind a later one.
        duplicates: Rows that were there twice, to the last bit, and were dropped.
    """

    time_ns: NDArray[np.int64]
    columns: Mapping[str, Values]
    late: int
    duplicates: int


def order_rows(
    found: Sequence[TopicColumns], tables: Sequence[Mapping[str, Values]]
) -> OrderedRows:
    """Return a topic's rows in several files as one table, sorted by time, each row once.

    Args:
        found: The messages of each file.
        tables: The columns that are wanted of them.
    """
    time_ns = np.concatenate([columns.log_time_ns for columns in found])
    columns = {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}
    # Two equal commands of one burst are no duplicates; their numbers differ.
    stamps = [
        np.concatenate([columns.publish_time_ns for columns in found]),
        np.concatenate([columns.sequence for columns in found]),
    ]
    late = int((time_ns < np.maximum.accumulate(time_ns)).sum())
    order = np.argsort(time_ns, kind="stable")
    contents = [column[order] for column in (*stamps, *columns.values())]
    kept = order[~_find_duplicates(time_ns[order], contents)]
    return OrderedRows(
        time_ns=time_ns[kept],
        columns={name: column[kept] for name, column in columns.items()},
        late=late,
        duplicates=len(order) - len(kept),
    )


def separate_times(time_ns: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
    """Return strictly increasing times, and how many had to move: by 1 ns behind the one before.

    Rows of one time are as many ticks; to drop one would lose a step of the motion.
    """
    rows = np.arange(len(time_ns))
    moved = np.maximum.accumulate(time_ns - rows) + rows
    return moved, int((moved != time_ns).sum())


def _find_duplicates(
    time_ns: NDArray[np.int64], contents: Sequence[NDArray[Any]]
) -> NDArray[np.bool_]:
    """Return which rows repeat an earlier one; only rows of one time can."""
    repeated = np.zeros(len(time_ns), dtype=bool)
    same = np.flatnonzero(np.diff(time_ns) == 0)
    seen: set[tuple[int, bytes]] = set()
    for row in np.union1d(same, same + 1).tolist():
        content = int(time_ns[row]), b"".join(column[row].tobytes() for column in contents)
        repeated[row] = content in seen
        seen.add(content)
    return repeated
