"""The topics of a recording; no other file names one."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic and the type of its messages.

    Attributes:
        name: As ROS names it.
        schema: Its message type, a key of `SCHEMAS`.
    """

    name: str
    schema: str


GOAL: Final = Topic("/turtle1/goal", "geometry_msgs/msg/PoseStamped")
"""Where the turtle should go, once."""

POSE: Final = Topic("/turtle1/pose", "turtlesim/msg/Pose")
"""One message per pose."""

POSE64: Final = Topic("/turtle1/pose64", "geometry_msgs/msg/Pose2D")
"""The same poses, only where 32-bit floats would lose something; a reader prefers them."""

VELOCITY64: Final = Topic("/turtle1/velocity64", "geometry_msgs/msg/Twist")
"""The applied velocities of the same poses, likewise."""

CONTROL: Final = Topic("/turtle1/control", "turtlelog_msgs/msg/ControlSample")
"""One message per sample, at the time at which its pose was answered."""

COMMAND: Final = Topic("/turtle1/cmd_vel", "geometry_msgs/msg/Twist")
"""One message per command, at the time of its publication."""

PHASE: Final = Topic("/turtle1/phase", "std_msgs/msg/String")
"""The phase's name whenever it changes; for people, a reader takes it from the samples."""

EVENT: Final = Topic("/rosout", "rcl_interfaces/msg/Log")
"""One message per event."""

TOPICS: Final = (GOAL, POSE, POSE64, VELOCITY64, CONTROL, COMMAND, PHASE, EVENT)
"""All of them; messages of one time stand in this order."""
