"""The columns of a run in the messages of other people's types."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from turtlelog.angles import wrap_angle
from turtlelog.errors import LogError

Fields = Mapping[str, NDArray[Any]]
Values = NDArray[np.float64]


def extract_poses(kind: str, fields: Fields) -> dict[str, Values]:
    """Return x, y [m] and heading [rad]; speed [m/s] and turn rate [rad/s] where the type has them.

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
        columns["speed"] = np.hypot(fields[f"{twist}.linear.x"], fields[f"{twist}.linear.y"])
        columns["turn_rate"] = _widen(fields[f"{twist}.angular.z"])
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
