"""Messages of robots, and bags of them."""

import math
from pathlib import Path
from typing import Any

from tests.log.ros2.bags import START_NS, Said, make_vector, write_mcap

SECOND_NS = 1_000_000_000

Turn = tuple[float, float, float, float]


def turn(yaw_rad: float) -> Turn:
    return (0.0, 0.0, math.sin(yaw_rad / 2), math.cos(yaw_rad / 2))


def describe_place(x_m: float, y_m: float, by: Turn, z_m: float = 0.0) -> dict[str, Any]:
    return {
        "position": make_vector(x_m, y_m, z_m),
        "orientation": dict(zip("xyzw", by, strict=True)),
    }


def describe_head(frame: str) -> dict[str, Any]:
    return {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame}


def say_odometry(
    topic: str = "/odom",
    *,
    count: int = 3,
    x_m: float = 0.0,
    step_m: float = 1.0,
    frame: str = "odom",
    by: Turn = (0.0, 0.0, 0.0, 1.0),
) -> list[Said]:
    """Return poses a second apart, a step ahead each."""
    twist = {"twist": {"linear": make_vector(), "angular": make_vector()}}
    return [
        Said(
            topic=topic,
            type="nav_msgs/msg/Odometry",
            time_ns=START_NS + row * SECOND_NS,
            values={
                "header": describe_head(frame),
                "child_frame_id": "base_link",
                "pose": {
                    "pose": describe_place(x_m + row * step_m, 0.0, by),
                    "covariance": [0.0] * 36,
                },
                "twist": {**twist, "covariance": [0.0] * 36},
            },
        )
        for row in range(count)
    ]


def say_transform(
    parent: str,
    child: str,
    x_m: float = 0.0,
    y_m: float = 0.0,
    *,
    at_s: float = 0.0,
    by: Turn = (0.0, 0.0, 0.0, 1.0),
    topic: str = "/tf",
) -> Said:
    transform = {
        "header": describe_head(parent),
        "child_frame_id": child,
        "transform": {
            "translation": make_vector(x_m, y_m),
            "rotation": dict(zip("xyzw", by, strict=True)),
        },
    }
    return Said(
        topic=topic,
        type="tf2_msgs/msg/TFMessage",
        time_ns=START_NS + round(at_s * SECOND_NS),
        values={"transforms": [transform]},
    )


def say_goal(
    x_m: float,
    y_m: float,
    *,
    topic: str = "/goal_pose",
    frame: str = "odom",
    at_s: float = 0.0,
    by: Turn = (0.0, 0.0, 0.0, 1.0),
) -> Said:
    return Said(
        topic=topic,
        type="geometry_msgs/msg/PoseStamped",
        time_ns=START_NS + round(at_s * SECOND_NS),
        values={"header": describe_head(frame), "pose": describe_place(x_m, y_m, by)},
    )


def say_path(
    *points: tuple[float, float], topic: str = "/plan", frame: str = "odom", at_s: float = 0.0
) -> Said:
    poses = [
        {"header": describe_head(""), "pose": describe_place(x, y, turn(0.0))} for x, y in points
    ]
    return Said(
        topic=topic,
        type="nav_msgs/msg/Path",
        time_ns=START_NS + round(at_s * SECOND_NS),
        values={"header": describe_head(frame), "poses": poses},
    )


def write_robot(folder: Path, *messages: Said | list[Said], name: str = "robot") -> Path:
    flat = [one for some in messages for one in (some if isinstance(some, list) else [some])]
    return write_mcap(folder / f"{name}.mcap", flat)
