"""Bags of ROS 1 as its recorder leaves them, written by rosbags."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

START_S: Final = 1_600_000_000

STORE: Final = get_typestore(Stores.ROS1_NOETIC)
STORE.register(
    get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
)

COMPRESSIONS: Final = {
    "none": None,
    "bz2": Writer.CompressionFormat.BZ2,
    "lz4": Writer.CompressionFormat.LZ4,
}

KINDS: Final = {
    "/odom": "nav_msgs/msg/Odometry",
    "/cmd_vel": "geometry_msgs/msg/Twist",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/joint_states": "sensor_msgs/msg/JointState",
    "/scan": "sensor_msgs/msg/LaserScan",
}

Message = tuple[str, int, bytes]
"""Topic, log time [ns] and bytes in ROS 1."""


def say_drive(count: int = 60) -> Iterator[Message]:
    """Yield a drive at 20 Hz, every message 3 ms after its stamp."""
    types = STORE.types
    vector, time = types["geometry_msgs/msg/Vector3"], types["builtin_interfaces/msg/Time"]
    for row in range(count):
        sec, nanosec = START_S + row // 20, row % 20 * 50_000_000
        head = types["std_msgs/msg/Header"](row, time(sec, nanosec), "odom")
        point = types["geometry_msgs/msg/Point"](0.01 * row, math.sin(row / 100), 0.25)
        turn = types["geometry_msgs/msg/Quaternion"](
            0.0, 0.0, math.sin(row / 400), math.cos(row / 400)
        )
        twist = types["geometry_msgs/msg/Twist"](vector(0.2, 0.0, 0.0), vector(0.0, 0.0, 0.1))
        pose = types["geometry_msgs/msg/Pose"](point, turn)
        place = vector(0.01 * row, math.sin(row / 100), 0.0)
        transform = types["geometry_msgs/msg/Transform"](place, turn)
        values: dict[str, Any] = {
            "/odom": types[KINDS["/odom"]](
                head,
                "base",
                types["geometry_msgs/msg/PoseWithCovariance"](pose, np.arange(36.0)),
                types["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
            ),
            "/cmd_vel": twist,
            "/tf": types[KINDS["/tf"]](
                [types["geometry_msgs/msg/TransformStamped"](head, "base", transform)]
            ),
            "/joint_states": types[KINDS["/joint_states"]](
                head, ["left", "a" * (row % 5)], np.arange(2.0), np.zeros(0), np.arange(3.0)
            ),
            "/scan": types[KINDS["/scan"]](
                head,
                0.0,
                1.0,
                0.1,
                0.0,
                0.0,
                0.0,
                9.0,
                np.arange(row % 4, dtype=np.float32),
                np.zeros(0, np.float32),
            ),
        }
        time_ns = sec * 10**9 + nanosec + 3_000_000
        for topic, value in values.items():
            yield topic, time_ns, bytes(STORE.serialize_ros1(value, KINDS[topic]))


def write_ros1(path: Path, *, compression: str = "none", count: int = 60) -> Path:
    """Write a drive as a bag of ROS 1."""
    writer = Writer(path)
    if (chosen := COMPRESSIONS[compression]) is not None:
        writer.set_compression(chosen)
    with writer:
        connections = {
            topic: writer.add_connection(topic, kind, typestore=STORE)
            for topic, kind in KINDS.items()
        }
        for topic, time_ns, data in say_drive(count):
            writer.write(connections[topic], time_ns, data)
    return path


def write_ros1_mcap(path: Path, *, count: int = 60) -> Path:
    """Write a drive as an MCAP file with messages of ROS 1, as `mcap convert` does."""
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start("ros1")
        channels = {}
        for topic, kind in KINDS.items():
            text, _ = STORE.generate_msgdef(kind)
            number = writer.register_schema(kind.replace("/msg/", "/"), "ros1msg", text.encode())
            channels[topic] = writer.register_channel(topic, "ros1", number)
        for topic, time_ns, data in say_drive(count):
            writer.add_message(channels[topic], time_ns, data, time_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return path
