"""Definitions of common ROS 2 types, for files that name a type without defining it."""

import re
from collections.abc import Iterator, Mapping
from functools import cache
from types import MappingProxyType
from typing import Final

from turtlelog.log.engine.message_types import shorten_type

_SEPARATOR: Final = "=" * 80

_FIELDS: Final = """\
builtin_interfaces/Time: int32 sec, uint32 nanosec
builtin_interfaces/Duration: int32 sec, uint32 nanosec
std_msgs/Header: builtin_interfaces/Time stamp, string frame_id
std_msgs/Empty:
std_msgs/String: string data
std_msgs/Bool: bool data
std_msgs/Byte: byte data
std_msgs/Char: char data
std_msgs/Float32: float32 data
std_msgs/Float64: float64 data
std_msgs/Int8: int8 data
std_msgs/Int16: int16 data
std_msgs/Int32: int32 data
std_msgs/Int64: int64 data
std_msgs/UInt8: uint8 data
std_msgs/UInt16: uint16 data
std_msgs/UInt32: uint32 data
std_msgs/UInt64: uint64 data
geometry_msgs/Vector3: float64 x, float64 y, float64 z
geometry_msgs/Point: float64 x, float64 y, float64 z
geometry_msgs/Quaternion: float64 x 0, float64 y 0, float64 z 0, float64 w 1
geometry_msgs/Pose: geometry_msgs/Point position, geometry_msgs/Quaternion orientation
geometry_msgs/Pose2D: float64 x, float64 y, float64 theta
geometry_msgs/PoseStamped: std_msgs/Header header, geometry_msgs/Pose pose
geometry_msgs/PoseArray: std_msgs/Header header, geometry_msgs/Pose[] poses
geometry_msgs/PoseWithCovariance: geometry_msgs/Pose pose, float64[36] covariance
geometry_msgs/PoseWithCovarianceStamped: \
std_msgs/Header header, geometry_msgs/PoseWithCovariance pose
geometry_msgs/Transform: \
geometry_msgs/Vector3 translation, geometry_msgs/Quaternion rotation
geometry_msgs/TransformStamped: \
std_msgs/Header header, string child_frame_id, geometry_msgs/Transform transform
geometry_msgs/Twist: geometry_msgs/Vector3 linear, geometry_msgs/Vector3 angular
geometry_msgs/TwistStamped: std_msgs/Header header, geometry_msgs/Twist twist
geometry_msgs/TwistWithCovariance: geometry_msgs/Twist twist, float64[36] covariance
geometry_msgs/TwistWithCovarianceStamped: \
std_msgs/Header header, geometry_msgs/TwistWithCovariance twist
nav_msgs/Odometry: \
std_msgs/Header header, string child_frame_id, \
geometry_msgs/PoseWithCovariance pose, geometry_msgs/TwistWithCovariance twist
nav_msgs/Path: std_msgs/Header header, geometry_msgs/PoseStamped[] poses
tf2_msgs/TFMessage: geometry_msgs/TransformStamped[] transforms
sensor_msgs/Imu: \
std_msgs/Header header, \
geometry_msgs/Quaternion orientation, float64[9] orientation_covariance, \
geometry_msgs/Vector3 angular_velocity, float64[9] angular_velocity_covariance, \
geometry_msgs/Vector3 linear_acceleration, float64[9] linear_acceleration_covariance
sensor_msgs/JointState: \
std_msgs/Header header, string[] name, float64[] position, float64[] velocity, float64[] effort
sensor_msgs/LaserScan: \
std_msgs/Header header, float32 angle_min, float32 angle_max, float32 angle_increment, \
float32 time_increment, float32 scan_time, float32 range_min, float32 range_max, \
float32[] ranges, float32[] intensities
sensor_msgs/BatteryState: \
std_msgs/Header header, float32 voltage, float32 temperature, float32 current, float32 charge, \
float32 capacity, float32 design_capacity, float32 percentage, uint8 power_supply_status, \
uint8 power_supply_health, uint8 power_supply_technology, bool present, \
float32[] cell_voltage, float32[] cell_temperature, string location, string serial_number
sensor_msgs/NavSatStatus: int8 status, uint16 service
sensor_msgs/NavSatFix: \
std_msgs/Header header, sensor_msgs/NavSatStatus status, \
float64 latitude, float64 longitude, float64 altitude, \
float64[9] position_covariance, uint8 position_covariance_type
rcl_interfaces/Log: \
byte DEBUG=10, byte INFO=20, byte WARN=30, byte ERROR=40, byte FATAL=50, \
builtin_interfaces/Time stamp, uint8 level, string name, string msg, string file, \
string function, uint32 line
rosgraph_msgs/Clock: builtin_interfaces/Time clock
turtlesim/Pose: \
float32 x, float32 y, float32 theta, float32 linear_velocity, float32 angular_velocity
turtlesim_msgs/Pose: \
float32 x, float32 y, float32 theta, float32 linear_velocity, float32 angular_velocity
ackermann_msgs/AckermannDrive: \
float32 steering_angle, float32 steering_angle_velocity, float32 speed, float32 acceleration, \
float32 jerk
ackermann_msgs/AckermannDriveStamped: \
std_msgs/Header header, ackermann_msgs/AckermannDrive drive
"""

_TEXTS: Final[Mapping[str, str]] = MappingProxyType(
    {
        name: "".join(f"{field.strip()}\n" for field in fields.split(",") if field.strip())
        for name, _, fields in (line.partition(":") for line in _FIELDS.splitlines())
    }
)
"""Fields of each type in `ros2msg`, by `package/Type`."""

KNOWN_TYPES: Final = tuple(name.replace("/", "/msg/") for name in _TEXTS)
"""ROS 2 names of the types with a definition in this module."""

_NESTED: Final = re.compile(r"^(\w+/\w+)", re.MULTILINE | re.ASCII)


@cache
def find_definition(type_name: str) -> str | None:
    """Return the `ros2msg` text of a common type and its nested types; None for other types.

    Args:
        type_name: `package/msg/Type` or `package/Type`.
    """
    name = shorten_type(type_name)
    if name not in _TEXTS:
        return None
    # Each type once, before the types that follow it in its fields.
    nested = dict.fromkeys(_iterate_nested(name))
    parts = [f"{_SEPARATOR}\nMSG: {other}\n{_TEXTS[other]}" for other in nested]
    return "".join([_TEXTS[name], *parts])


def _iterate_nested(name: str) -> Iterator[str]:
    for other in _NESTED.findall(_TEXTS[name]):
        yield other
        yield from _iterate_nested(other)
