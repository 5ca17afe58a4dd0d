"""Our bytes beside those of ROS 2 itself; runs where `ros-rclpy[fastrtps]` is installed.

In an environment of its own (CPython 3.11): pip install "ros-rclpy[fastrtps]" ros-geometry-msgs
ros-std-msgs pytest, and what turtlelog needs; then pytest -m ros2 tests/log.
"""

from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

import turtlelog as tl

pytestmark = pytest.mark.ros2


@pytest.fixture(scope="module")
def payloads(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[bytes]]:
    path: Path = tmp_path_factory.mktemp("recordings") / "kp10.mcap"
    scenario = tl.override_scenario(tl.load_scenario("paper-kp10"), {"goal.heading_rad": 0.5})
    tl.write_recording(tl.simulate_run(scenario), path)
    found: dict[str, list[bytes]] = {}
    with path.open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            found.setdefault(channel.topic, []).append(message.data)
    return found


@pytest.mark.parametrize(
    ("topic", "package", "name"),
    [
        ("/turtle1/cmd_vel", "geometry_msgs", "Twist"),
        ("/turtle1/phase", "std_msgs", "String"),
        ("/turtle1/goal", "geometry_msgs", "PoseStamped"),
    ],
)
def test_ros_2_writes_the_same_bytes(
    topic: str, package: str, name: str, payloads: dict[str, list[bytes]]
) -> None:
    serialization: Any = pytest.importorskip("rclpy.serialization", reason="ROS 2 is not installed")
    kind = getattr(pytest.importorskip(f"{package}.msg", reason="ROS 2 is not installed"), name)
    for ours in payloads[topic]:
        message = serialization.deserialize_message(ours, kind)
        theirs = serialization.serialize_message(message)
        assert len(theirs) == len(ours)
        # ROS leaves the six bytes that it pads with behind the text "world" as it found them.
        padding = range(22, 28) if name == "PoseStamped" else range(0)
        differing = [place for place in range(len(ours)) if ours[place] != theirs[place]]
        assert [place for place in differing if place not in padding] == []
