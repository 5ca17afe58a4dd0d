"""Our bytes beside those of ROS 2 itself; runs where `ros-rclpy[fastrtps]` is installed.

In an environment of its own (CPython 3.11): pip install "ros-rclpy[fastrtps]" ros-geometry-msgs
ros-std-msgs pytest, and what turtlelog needs; then pytest -m ros2 tests/log.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

import turtlelog as tl
from tests.log.engine.files import Row, write_rows

pytestmark = [
    pytest.mark.ros2,
    # A parser that ROS 2 loads uses an old module of Python's.
    pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning"),
]


@pytest.fixture(scope="module")
def payloads(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[bytes]]:
    path: Path = tmp_path_factory.mktemp("recordings") / "kp10.mcap"
    changes = {"goal.heading_rad": 0.5, "loop.pose_precision": "float64"}
    scenario = tl.override_scenario(tl.load_scenario("paper-kp10"), changes)
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
        ("/turtle1/pose64", "geometry_msgs", "Pose2D"),
        ("/rosout", "rcl_interfaces", "Log"),
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
        # ROS leaves the bytes that it pads with as it found them; no value depends on them.
        for place in [place for place in range(len(ours)) if ours[place] != theirs[place]]:
            altered = ours[:place] + bytes([ours[place] ^ 0xFF]) + ours[place + 1 :]
            assert serialization.deserialize_message(altered, kind) == message


ARRAYS = (
    {"byte_array_value": [b"\1"], "bool_array_value": [True, False], "string_value": "a"},
    {"integer_array_value": [-1, 2], "double_array_value": [0.5], "string_array_value": ["", "bc"]},
    {"bool_value": True, "integer_value": 7, "double_value": 0.25},
)


def test_sequences_that_ros_2_wrote_are_read(tmp_path: Path) -> None:
    serialization: Any = pytest.importorskip("rclpy.serialization", reason="ROS 2 is not installed")
    kinds = pytest.importorskip("rcl_interfaces.msg", reason="ROS 2 is not installed")
    typesys = pytest.importorskip("rosbags.typesys")
    name = "rcl_interfaces/msg/ParameterValue"
    text, _ = typesys.get_typestore(typesys.Stores.ROS2_JAZZY).generate_msgdef(name, ros_version=2)
    messages = [kinds.ParameterValue(**values) for values in ARRAYS]
    rows = [
        Row(topic="/a", time_ns=number, data=serialization.serialize_message(message))
        for number, message in enumerate(messages)
    ]
    write_rows(tmp_path / "a.mcap", {"/a": (name, text)}, rows)
    for field, values in tl.read_columns(tmp_path / "a.mcap")["/a"].fields.items():
        for message, value in zip(messages, values, strict=True):
            expected = getattr(message, field)
            if field == "byte_array_value":
                expected = [byte[0] for byte in expected]
            is_many = isinstance(value, np.ndarray | list)
            assert list(value) == list(expected) if is_many else value == expected
