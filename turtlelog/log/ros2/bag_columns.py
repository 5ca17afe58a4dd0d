"""Extraction of a run's rows from third-party messages, in order of time."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.file_access import name_place
from turtlelog.log.file_info import TopicInfo
from turtlelog.log.ros2.bag_topics import ACKERMANN_TYPES, JOINTS
from turtlelog.log.ros2.stamps import Stamps, join_arrays, join_stamps
from turtlelog.log.spatial_poses import compute_heading, compute_tilt
from turtlelog.run.angles import wrap_angle

_ROWS_AT_ONCE: Final = 65_536

Held = list[dict[str, TopicColumns]]
"""Messages by topic, for each file, in file order."""

Fields = Mapping[str, NDArray[Any]]
Values = NDArray[np.float64]


def extract_poses(kind: str, fields: Fields) -> dict[str, Values]:
    """Return x, y [m] and heading [rad], and speeds, height and tilt if messages contain them.

    turtlesim publishes the applied velocities (`speed`, `turn_rate`), odometry the measured ones
    (`measured_speed`, `measured_lateral_speed`, `measured_turn_rate`). `z` is the height [m],
    `tilt` the angle between the robot's vertical axis and the world's [rad].

    Raises:
        LogError: If no quaternion is a valid rotation.
        KeyError: If a field is missing.
    """
    if kind.startswith("turtlesim"):
        return {
            "x": _widen(fields["x"]),
            "y": _widen(fields["y"]),
            "heading": _widen(fields["theta"]),
            # Before Humble, turtlesim also published the sign of the speed.
            "speed": np.abs(_widen(fields["linear_velocity"])),
            "turn_rate": _widen(fields["angular_velocity"]),
        }
    shape = _SHAPES.get(kind) or find_pose_shape(fields) or _NO_SHAPE
    if shape.heading is not None:
        heading_rad = _widen(fields[shape.heading])
        columns = {"heading": np.radians(heading_rad) if shape.is_degrees else heading_rad}
    else:
        columns = _turn_quaternions(fields, shape.orientation)
    place = {name: _widen(fields[f"{shape.position}{name}"]) for name in "xy"}
    columns = {**place, **columns}
    if f"{shape.position}z" in fields:
        columns["z"] = _widen(fields[f"{shape.position}z"])
    for name in ("measured_speed", "measured_turn_rate"):
        if kind == JOINTS and name in fields:
            columns[name] = _widen(fields[name])
    if kind == "nav_msgs/msg/Odometry":
        rates = _read_twist(fields, "twist.twist.")
        columns |= {f"measured_{name}": values for name, values in rates.items()}
    return columns


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseShape:
    """The fields of a pose in a message.

    Attributes:
        position: Prefix of x and y.
        orientation: Prefix of x, y, z and w of a quaternion, if there is no heading.
        heading: Field of the heading; None if there is a quaternion.
        is_degrees: Whether the heading is in degrees.
    """

    position: str
    orientation: str = ""
    heading: str | None = None
    is_degrees: bool = False


def _name_shape(prefix: str) -> PoseShape:
    return PoseShape(position=f"{prefix}position.", orientation=f"{prefix}orientation.")


_SHAPES: Final = {
    "nav_msgs/msg/Odometry": _name_shape("pose.pose."),
    "geometry_msgs/msg/PoseStamped": _name_shape("pose."),
    "geometry_msgs/msg/PoseWithCovarianceStamped": _name_shape("pose.pose."),
    "geometry_msgs/msg/Pose": _name_shape(""),
    "geometry_msgs/msg/Pose2D": PoseShape(position="", heading="theta"),
    "geometry_msgs/msg/TransformStamped": PoseShape(
        position="transform.translation.", orientation="transform.rotation."
    ),
}
POSITIONS: Final = {kind: shape.position for kind, shape in _SHAPES.items()}
"""Prefix of x and y in the fields of each pose type."""

_NO_SHAPE: Final = _name_shape("pose.")
"""Shape for errors about missing fields: the shape of a stamped pose."""

_ANGLES: Final = ("theta", "heading", "yaw", "orientation.yaw", "rotation.yaw")


def find_pose_shape(fields: Collection[str]) -> PoseShape | None:
    """Return the fields of a pose in an unknown type, by their names; None without such fields.

    Known fields are position and orientation, translation and rotation (quaternions), and x, y with
    theta, heading or yaw. The name of an angle in degrees ends in `_deg`.
    """
    places = [name[:-1] for name in fields if name == "x" or name.endswith(".x")]
    found = (_find_turn(fields, place) for place in places if f"{place}y" in fields)
    return next(filter(None, found), None)


def _find_turn(fields: Collection[str], place: str) -> PoseShape | None:
    """Return the pose with x and y after a prefix; None if no angle belongs to the pose."""
    home = place.removesuffix("position.").removesuffix("translation.")
    for turn in ("orientation", "rotation"):
        if home != place and all(f"{home}{turn}.{axis}" in fields for axis in "xyzw"):
            return PoseShape(position=place, orientation=f"{home}{turn}.")
    for name in (f"{home}{angle}{unit}" for angle in _ANGLES for unit in ("", "_rad", "_deg")):
        if name in fields:
            return PoseShape(position=place, heading=name, is_degrees=name.endswith("_deg"))
    return None


def extract_commands(
    kind: str, fields: Fields, *, wheelbase_m: float | None = None
) -> dict[str, Values]:
    """Return forward and lateral speed [m/s] and turn rate [rad/s].

    Ackermann commands need the distance between the axles: a car turns with speed * tan(steering
    angle) / wheelbase. The turn rate is NaN from 90 deg on.
    """
    if kind in ACKERMANN_TYPES and wheelbase_m is not None:
        drive = "drive." if kind.endswith("Stamped") else ""
        speed_m_s = _widen(fields[f"{drive}speed"])
        steering_rad = _widen(fields[f"{drive}steering_angle"])
        is_aside = np.abs(steering_rad) >= np.pi / 2.0  # No car turns with a wheel at 90 deg.
        steering_rad = np.where(is_aside, np.nan, steering_rad)
        return {
            "speed": speed_m_s,
            "lateral_speed": np.zeros_like(speed_m_s),
            "turn_rate": speed_m_s * np.tan(steering_rad) / wheelbase_m,
        }
    return _read_twist(fields, "twist." if kind == "geometry_msgs/msg/TwistStamped" else "")


def _read_twist(fields: Fields, prefix: str) -> dict[str, Values]:
    return {
        "speed": _widen(fields[f"{prefix}linear.x"]),
        "lateral_speed": _widen(fields[f"{prefix}linear.y"]),
        "turn_rate": _widen(fields[f"{prefix}angular.z"]),
    }


def wrap_far_headings(heading_rad: Values) -> tuple[Values, int]:
    """Return headings within a float32 step of [-pi, pi), and the number of changed headings.

    turtlesim's own rounding exceeds that interval by less than a step; such headings are kept.
    """
    far = np.abs(heading_rad) > np.nextafter(np.float32(np.pi), np.float32(4.0))
    return np.where(far, wrap_angle(heading_rad), heading_rad), int(far.sum())


def _turn_quaternions(fields: Fields, orientation: str) -> dict[str, Values]:
    """Return heading and tilt of quaternions of any length [rad]; NaN for length 0.

    The heading is that of the robot's forward axis seen from above, for any tilt.
    """
    parts = [fields[f"{orientation}{name}"] for name in "xyzw"]
    name = orientation.removesuffix(".")
    yaw_rad, tilt_rad = np.empty(len(parts[0])), np.empty(len(parts[0]))
    empty = np.zeros(len(yaw_rad), dtype=np.bool_)
    for first in range(0, len(yaw_rad), _ROWS_AT_ONCE):
        rows = slice(first, first + _ROWS_AT_ONCE)
        x, y, z, w = (_widen(part[rows]) for part in parts)
        # Messages have zeros by default in ROS 1, and in programs that never set the quaternion.
        empty[rows] = x**2 + y**2 + z**2 + w**2 == 0.0
        yaw_rad[rows], tilt_rad[rows] = compute_heading(x, y, z, w), compute_tilt(x, y, z, w)
    if len(empty) and empty.all():
        if len(empty) == 1:
            raise LogError(f"message 0: {name}: expected a rotation, found all zeros")
        raise LogError(
            f"{name}: expected rotations, found all zeros in each of {len(empty)} messages:"
            " it was never set, and there is no heading"
        )
    # Some programs set quaternions only from the second message on; a camera may lose its robot.
    yaw_rad[empty] = np.nan
    return {"heading": yaw_rad, "tilt": tilt_rad}


def _widen(values: NDArray[Any]) -> Values:
    return np.ascontiguousarray(values, dtype=np.float64)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OrderedRows:
    """The rows of a topic in order of time.

    Attributes:
        time_ns: Time in the file [ns], shape (n,), not decreasing.
        columns: Columns by name, shape (n,) each.
        late: Number of rows that came after a row with a later time.
        duplicates: Number of exact duplicate rows, which were dropped.
        stamp_ns: Stamp of each row [ns], shape (n,); None if the type has no stamps.
    """

    time_ns: NDArray[np.int64]
    columns: Mapping[str, Values]
    late: int
    duplicates: int
    stamp_ns: NDArray[np.int64] | None = None

    @property
    def stamps(self) -> Stamps:
        """Both times of each row."""
        return Stamps(log_ns=self.time_ns, stamp_ns=self.stamp_ns)

    def take(
        self, rows: NDArray[np.int64] | NDArray[np.bool_], time_ns: NDArray[np.int64] | None = None
    ) -> "OrderedRows":
        """Return some of the rows in any order, with given new times, if any."""
        if rows.dtype != np.bool_ and len(rows) == len(self.time_ns) and _is_whole(rows):
            return self if time_ns is None else replace(self, time_ns=time_ns)
        return replace(
            self,
            time_ns=self.time_ns[rows] if time_ns is None else time_ns,
            columns={name: column[rows] for name, column in self.columns.items()},
            stamp_ns=None if self.stamp_ns is None else self.stamp_ns[rows],
        )


def _is_whole(rows: NDArray[Any]) -> bool:
    """Return whether row numbers are those of all rows in order."""
    return all(
        np.array_equal(
            rows[first : first + _ROWS_AT_ONCE],
            np.arange(first, min(first + _ROWS_AT_ONCE, len(rows))),
        )
        for first in range(0, len(rows), _ROWS_AT_ONCE)
    )


def order_rows(
    found: Sequence[TopicColumns], tables: Sequence[Mapping[str, Values]]
) -> OrderedRows:
    """Return a topic's rows in several files as one table, sorted by time, without duplicates.

    The columns of the messages of each file are in `tables`.
    """
    time_ns = join_arrays([columns.log_time_ns for columns in found])
    late = int((time_ns < np.maximum.accumulate(time_ns)).sum())
    rows = OrderedRows(
        time_ns=time_ns,
        columns={name: join_arrays([table[name] for table in tables]) for name in tables[0]},
        late=late,
        duplicates=0,
        stamp_ns=join_stamps(found),
    )
    # Equal commands of one burst are not duplicates; their sequence numbers differ.
    others = [
        join_arrays([columns.publish_time_ns for columns in found]),
        join_arrays([columns.sequence for columns in found]),
    ]
    if late:
        order = np.argsort(time_ns, kind="stable")
        rows, others = rows.take(order), [column[order] for column in others]
    others += [] if rows.stamp_ns is None else [rows.stamp_ns]
    twice = _find_duplicates(rows.time_ns, [*others, *rows.columns.values()])
    duplicates = int(twice.sum())
    return replace(rows.take(~twice), duplicates=duplicates) if duplicates else rows


def order_topic(
    found: Held, choice: TopicInfo, extract: Callable[[str, Fields], dict[str, Values]]
) -> OrderedRows:
    """Return the rows of a topic from all files; their messages are removed from `found`."""
    tables = []
    for columns in (of_file[choice.topic] for of_file in found if choice.topic in of_file):
        if columns.type != choice.type:
            raise LogError(f"topic {choice.topic}: expected {choice.type}, found {columns.type}")
        try:
            with name_place(f"topic {choice.topic}"):
                tables.append(extract(choice.type, columns.fields))
        except KeyError as err:
            raise columns.describe_missing(err.args[0]) from err
    return order_rows(
        [of_file.pop(choice.topic) for of_file in found if choice.topic in of_file], tables
    )


_LARGEST: Final = 1e30
"""Largest plausible value [m, m/s, rad/s]: larger values come from memory that was never set. The
fourth powers of smaller values, and the 32-bit numbers of pictures, are finite."""


def drop_not_finite(rows: OrderedRows, names: Collection[str]) -> tuple[OrderedRows, int]:
    """Return the rows with usable numbers in columns of these names, and the number of others."""
    kept = np.ones(len(rows.time_ns), dtype=np.bool_)
    for name in names:
        kept &= np.abs(rows.columns[name]) <= _LARGEST  # nan is not
    if kept.all():
        return rows, 0
    return rows.take(kept), int((~kept).sum())


def separate_times(time_ns: NDArray[np.int64]) -> tuple[NDArray[np.int64], int]:
    """Return strictly increasing times, and how many were moved to 1 ns after the previous time.

    Rows with equal times are different ticks; dropping one would lose a step of the motion.
    """
    rows = np.arange(len(time_ns))
    moved = np.maximum.accumulate(time_ns - rows) + rows
    return moved, int((moved != time_ns).sum())


def _find_duplicates(
    time_ns: NDArray[np.int64], contents: Sequence[NDArray[Any]]
) -> NDArray[np.bool_]:
    """Return which rows repeat an earlier row. Only rows of equal time are compared."""
    repeated = np.zeros(len(time_ns), dtype=bool)
    same = np.flatnonzero(np.diff(time_ns) == 0)
    order = np.union1d(same, same + 1)
    # Compared as bits, so that NaN equals NaN; equal rows are adjacent, the earliest first.
    keys = [time_ns, *(column.view(f"u{column.itemsize}") for column in contents)]
    for key in reversed(keys):
        order = order[np.argsort(key[order], kind="stable")]
    equal = np.ones(max(len(order) - 1, 0), dtype=bool)
    for key in keys:
        equal &= np.diff(key[order]) == 0
    repeated[order[1:][equal]] = True
    return repeated
