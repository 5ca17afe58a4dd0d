"""Bags as other people's recorders leave them."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from mcap_ros2.writer import Writer
from rosbags.typesys import Stores, get_typestore

START_NS: Final = 1_700_000_000_123_456_789
TICK_NS: Final = 16_000_000

_FLOATS: Final = ("x", "y", "theta", "linear_velocity", "angular_velocity")
_TURTLESIM: Final = "".join(f"float32 {name}\n" for name in _FLOATS)


@dataclass(frozen=True, kw_only=True)
class Said:
    """A message; sequence and publish time as rosbag2 leaves them."""

    topic: str
    type: str
    values: dict[str, Any] = field(default_factory=dict)
    time_ns: int = START_NS
    sequence: int = 0


def make_poses(
    count: int = 3, *, topic: str = "/turtle1/pose", kind: str = "turtlesim/msg/Pose", **values: Any
) -> list[Said]:
    pose = {"x": 1.0, "y": 2.0, "theta": 0.5, "linear_velocity": 0.25, "angular_velocity": -0.5}
    return [
        Said(topic=topic, type=kind, values=pose | values, time_ns=START_NS + row * TICK_NS)
        for row in range(count)
    ]


def make_command(
    forward: float = 1.0,
    *,
    topic: str = "/turtle1/cmd_vel",
    time_ns: int = START_NS,
    number: int = 0,
) -> Said:
    values = {"linear": make_vector(forward, 0.5), "angular": make_vector(0.0, 0.0, 2.0)}
    return Said(
        topic=topic,
        type="geometry_msgs/msg/Twist",
        values=values,
        time_ns=time_ns,
        sequence=number,
    )


def make_stamped_pose(topic: str = "/pose", *, yaw_rad: float = 0.0, length: float = 1.0) -> Said:
    return Said(
        topic=topic, type="geometry_msgs/msg/PoseStamped", values=_make_pose(yaw_rad, length)
    )


def make_odometry(*, yaw_rad: float, speed: tuple[float, float], turn_rate: float) -> Said:
    twist = {"linear": make_vector(*speed), "angular": make_vector(0.0, 0.0, turn_rate)}
    values = {
        **_make_pose(yaw_rad, 1.0),
        "child_frame_id": "base_link",
        "twist": {"twist": twist, "covariance": [0.0] * 36},
    }
    values["pose"] = {"pose": values["pose"], "covariance": [math.nan] * 36}
    return Said(topic="/odom", type="nav_msgs/msg/Odometry", values=values)


def make_vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> dict[str, float]:
    return {"x": x, "y": y, "z": z}


def _make_pose(yaw_rad: float, length: float) -> dict[str, Any]:
    turn = {"z": length * math.sin(yaw_rad / 2), "w": length * math.cos(yaw_rad / 2)}
    return {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "map"},
        "pose": {"position": make_vector(3.0, 4.0), "orientation": make_vector() | turn},
    }


def write_mcap(path: Path, messages: Iterable[Said]) -> Path:
    """Write messages in the order given."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with path.open("wb") as stream:
        writer = Writer(stream)
        schemas = {}
        for said in messages:
            if said.type not in schemas:
                text = (
                    _TURTLESIM
                    if said.type.startswith("turtlesim")
                    else store.generate_msgdef(said.type, ros_version=2)[0]
                )
                schemas[said.type] = writer.register_msgdef(said.type, text)
            writer.write_message(
                said.topic,
                schemas[said.type],
                said.values,
                log_time=said.time_ns,
                publish_time=said.time_ns,
                sequence=said.sequence,
            )
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def write_metadata(
    folder: Path, files: Sequence[str], *, storage: str = "mcap", mode: str = '""'
) -> Path:
    lines = [
        "rosbag2_bagfile_information:",
        "  version: 5",
        f"  storage_identifier: {storage}",
        "  relative_file_paths:",
        *(f"    - {file}" for file in files),
        "  duration:",
        "    nanoseconds: 2500000000",
        '  compression_format: ""',
        f"  compression_mode: {mode}",
    ]
    (folder / "metadata.yaml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder
