"""The text of every message type in a recording, as ROS 2 defines it, with its dependencies."""

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Final

_SEPARATOR: Final = "=" * 80

_TIME: Final = "int32 sec\nuint32 nanosec\n"
_HEADER: Final = "builtin_interfaces/Time stamp\nstring frame_id\n"
_XYZ: Final = "float64 x\nfloat64 y\nfloat64 z\n"
_QUATERNION: Final = "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n"

_TURTLESIM_POSE: Final = """\
float32 x
float32 y
float32 theta
float32 linear_velocity
float32 angular_velocity
"""

_LOG: Final = """\
byte DEBUG=10
byte INFO=20
byte WARN=30
byte ERROR=40
byte FATAL=50
builtin_interfaces/Time stamp
uint8 level
string name
string msg
string file
string function
uint32 line
"""

_CONTROL_SAMPLE: Final = """\
# One callback of the controller. NaN: not recorded.

# Number of the sample, and of the pose that it read, from 0.
uint32 sequence
uint32 pose_sequence
# Phase in which the command was computed: its place, from 0, among the phases of the declaration
# in the metadata record turtlelog, then pause and done where these are not among them.
uint8 phase
# Goal bearing, and bearing minus heading [rad].
float64 bearing
float64 heading_error
# Goal minus position in the world frame [m].
float64 error_x
float64 error_y
float64 distance
# Command before clipping [m/s, rad/s].
float64 wanted_speed
float64 wanted_turn_rate
# Command as published [m/s, rad/s].
float64 speed
float64 turn_rate
# Gain times error before projection, world frame [m/s].
float64 world_v_x
float64 world_v_y
"""


_STATES: Final = """\
# Numbers of the law's own, one message per sample: that of the same sequence number, which both
# messages carry, on /turtle1/control.
"""


def define_states(names: Iterable[str]) -> str:
    """Return the `ros2msg` text of the type that holds a law's states."""
    return _STATES + "".join(f"# The law's state {name}.\nfloat64 {name}\n" for name in names)


def _join(text: str, **dependencies: str) -> str:
    parts = [text]
    for name, definition in dependencies.items():
        parts.append(f"{_SEPARATOR}\nMSG: {name.replace('__', '/')}\n{definition}")
    return "".join(parts)


SCHEMAS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "geometry_msgs/msg/PoseStamped": _join(
            "std_msgs/Header header\ngeometry_msgs/Pose pose\n",
            std_msgs__Header=_HEADER,
            builtin_interfaces__Time=_TIME,
            geometry_msgs__Pose="geometry_msgs/Point position\n"
            "geometry_msgs/Quaternion orientation\n",
            geometry_msgs__Point=_XYZ,
            geometry_msgs__Quaternion=_QUATERNION,
        ),
        "turtlesim/msg/Pose": _TURTLESIM_POSE,
        "geometry_msgs/msg/Pose2D": "float64 x\nfloat64 y\nfloat64 theta\n",
        "turtlelog_msgs/msg/ControlSample": _CONTROL_SAMPLE,
        "geometry_msgs/msg/Twist": _join(
            "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n",
            geometry_msgs__Vector3=_XYZ,
        ),
        "std_msgs/msg/String": "string data\n",
        "rcl_interfaces/msg/Log": _join(_LOG, builtin_interfaces__Time=_TIME),
    }
)
"""Definition by message type; dependencies follow a line of 80 equals signs."""
