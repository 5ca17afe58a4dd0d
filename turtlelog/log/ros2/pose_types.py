"""The message types of poses: their priority, their fields, and the poses in their messages."""

from collections.abc import Collection
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.ros2.bag_rows import ROWS_AT_ONCE, Fields, Values
from turtlelog.log.spatial_poses import compute_heading, compute_tilt

TRANSFORMS: Final = "tf2_msgs/msg/TFMessage"
FRAME_TRANSFORM: Final = "foxglove.FrameTransform"
TRANSFORM_TYPES: Final = (TRANSFORMS, FRAME_TRANSFORM)
FIX: Final = "sensor_msgs/msg/NavSatFix"
JOINTS: Final = "sensor_msgs/msg/JointState"


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


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseType:
    """A message type with poses.

    Attributes:
        tier: Priority among the topics of a bag, the lowest number first. Odometry is first,
            because it has rates, then types with stamps. Satellite fixes come last, because they
            give no heading.
        shape: Fields of the pose; None if the type has a reader of its own.
    """

    tier: int
    shape: PoseShape | None = None


POSE_TYPES: Final = MappingProxyType(
    {
        "turtlesim/msg/Pose": PoseType(tier=0),
        "turtlesim_msgs/msg/Pose": PoseType(tier=0),
        "nav_msgs/msg/Odometry": PoseType(tier=1, shape=_name_shape("pose.pose.")),
        "geometry_msgs/msg/PoseStamped": PoseType(tier=2, shape=_name_shape("pose.")),
        "geometry_msgs/msg/PoseWithCovarianceStamped": PoseType(
            tier=2, shape=_name_shape("pose.pose.")
        ),
        "geometry_msgs/msg/Pose": PoseType(tier=3, shape=_name_shape("")),
        "geometry_msgs/msg/Pose2D": PoseType(tier=3, shape=PoseShape(position="", heading="theta")),
        "geometry_msgs/msg/TransformStamped": PoseType(
            tier=4,
            shape=PoseShape(position="transform.translation.", orientation="transform.rotation."),
        ),
        **dict.fromkeys(TRANSFORM_TYPES, PoseType(tier=5)),
        FIX: PoseType(tier=6),
    }
)
"""The message types that are read as poses, by name."""

_SHAPES: Final = {kind: one.shape for kind, one in POSE_TYPES.items() if one.shape is not None}

POSITIONS: Final = {kind: shape.position for kind, shape in _SHAPES.items()}
"""Prefix of x and y in the fields of each pose type."""

_NO_SHAPE: Final = _name_shape("pose.")
"""Shape for errors about missing fields: the shape of a stamped pose."""

_ANGLES: Final = ("theta", "heading", "yaw", "orientation.yaw", "rotation.yaw")


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
            "x": widen(fields["x"]),
            "y": widen(fields["y"]),
            "heading": widen(fields["theta"]),
            # Before Humble, turtlesim also published the sign of the speed.
            "speed": np.abs(widen(fields["linear_velocity"])),
            "turn_rate": widen(fields["angular_velocity"]),
        }
    shape = _SHAPES.get(kind) or find_pose_shape(fields) or _NO_SHAPE
    if shape.heading is not None:
        heading_rad = widen(fields[shape.heading])
        columns = {"heading": np.radians(heading_rad) if shape.is_degrees else heading_rad}
    else:
        columns = _turn_quaternions(fields, shape.orientation)
    place = {name: widen(fields[f"{shape.position}{name}"]) for name in "xy"}
    columns = {**place, **columns}
    if f"{shape.position}z" in fields:
        columns["z"] = widen(fields[f"{shape.position}z"])
    for name in ("measured_speed", "measured_turn_rate"):
        if kind == JOINTS and name in fields:
            columns[name] = widen(fields[name])
    if kind == "nav_msgs/msg/Odometry":
        rates = read_twist(fields, "twist.twist.")
        columns |= {f"measured_{name}": values for name, values in rates.items()}
    return columns


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


def read_twist(fields: Fields, prefix: str) -> dict[str, Values]:
    """Return forward and lateral speed [m/s] and turn rate [rad/s] after a prefix."""
    return {
        "speed": widen(fields[f"{prefix}linear.x"]),
        "lateral_speed": widen(fields[f"{prefix}linear.y"]),
        "turn_rate": widen(fields[f"{prefix}angular.z"]),
    }


def _turn_quaternions(fields: Fields, orientation: str) -> dict[str, Values]:
    """Return heading and tilt of quaternions of any length [rad]; NaN for length 0.

    The heading is that of the robot's forward axis seen from above, for any tilt.
    """
    parts = [fields[f"{orientation}{name}"] for name in "xyzw"]
    name = orientation.removesuffix(".")
    yaw_rad, tilt_rad = np.empty(len(parts[0])), np.empty(len(parts[0]))
    empty = np.zeros(len(yaw_rad), dtype=np.bool_)
    for first in range(0, len(yaw_rad), ROWS_AT_ONCE):
        rows = slice(first, first + ROWS_AT_ONCE)
        x, y, z, w = (widen(part[rows]) for part in parts)
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


def widen(values: NDArray[Any]) -> Values:
    """Return numbers in double precision."""
    return np.ascontiguousarray(values, dtype=np.float64)
