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

LAW_STATE: Final = "/turtle1/law_state"
"""The numbers of the law's own, one message per sample; the type is the law's."""

REFERENCE: Final = Topic("/turtle1/reference", "geometry_msgs/msg/PoseStamped")
"""Where the robot should be by now, one message per sample that says so; for other tools."""

REFERENCE64: Final = Topic("/turtle1/reference64", "geometry_msgs/msg/Pose2D")
"""The same poses; a reader takes them from here, for a quaternion does not give a heading back."""

COMMAND: Final = Topic("/turtle1/cmd_vel", "geometry_msgs/msg/Twist")
"""One message per command, at the time of its publication."""

PHASE: Final = Topic("/turtle1/phase", "std_msgs/msg/String")
"""The phase's name whenever it changes; for people, a reader takes it from the samples."""

EVENT: Final = Topic("/rosout", "rcl_interfaces/msg/Log")
"""One message per event."""

BEFORE_STATES: Final = (GOAL, POSE, POSE64, VELOCITY64, CONTROL)
AFTER_SAMPLES: Final = (COMMAND, PHASE, EVENT)
"""Topics of every recording, before and after those that a law's declaration asks for."""

TOPIC_NAMES: Final = frozenset(
    {
        *(topic.name for topic in (*BEFORE_STATES, *AFTER_SAMPLES)),
        *(LAW_STATE, REFERENCE.name, REFERENCE64.name),
    }
)
"""Names of all that a recording may hold."""
