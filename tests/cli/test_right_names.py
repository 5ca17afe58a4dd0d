"""What `info` calls what is in a bag, and the names by which topics are chosen."""

from pathlib import Path

import pytest

import turtlelog as tl
from tests.cli.conftest import Call
from tests.cli.test_commands_alone import say_twist
from tests.log.ros2.bags import START_NS, Said, make_vector
from tests.log.ros2.robots import (
    describe_head,
    describe_place,
    say_goal,
    say_odometry,
    say_transform,
    turn,
    write_robot,
)


def say_imu(row: int) -> Said:
    values = {
        "header": describe_head("imu_link"),
        "orientation": make_vector() | {"w": 1.0},
        "angular_velocity": make_vector(),
        "linear_acceleration": make_vector(0.0, 0.0, 9.81),
        **dict.fromkeys(("orientation_covariance", "angular_velocity_covariance"), [0.0] * 9),
        "linear_acceleration_covariance": [0.0] * 9,
    }
    time_ns = START_NS + row * 10_000_000
    return Said(topic="/imu/data", type="sensor_msgs/msg/Imu", values=values, time_ns=time_ns)


def say_pose(row: int, x_m: float, topic: str = "/imu/pose") -> Said:
    values = {"header": describe_head("world"), "pose": describe_place(x_m, 0.0, turn(row / 10))}
    time_ns = START_NS + row * 10_000_000
    kind = "geometry_msgs/msg/PoseStamped"
    return Said(topic=topic, type=kind, values=values, time_ns=time_ns)


def test_an_imu_is_called_an_imu(call: Call, tmp_path: Path) -> None:
    bag = write_robot(tmp_path, [say_imu(row) for row in range(20)])
    found = call("info", bag)
    assert "no poses, nothing to measure: an IMU on /imu/data (sensor_msgs/msg/Imu)" in found.flat
    assert "robot" not in found.out.removeprefix("robot.mcap")


@pytest.mark.parametrize(
    ("poses", "kind"),
    [
        ([say_pose(row, 0.0) for row in range(20)], "an IMU, which turns in one place"),
        ([say_pose(row, 0.001 * row) for row in range(20)], "a robot (not turtlesim)"),
        ([say_pose(row, 0.0, "/imu0") for row in range(20)], "an IMU, which turns in one place"),
        ([say_pose(row, 0.0, "/imud") for row in range(20)], "a robot (not turtlesim)"),
        ([say_pose(row, 0.0, "/pose") for row in range(20)], "a robot (not turtlesim)"),
        ([say_pose(row, 0.0, "/simulator/pose") for row in range(20)], "a robot (not turtlesim)"),
        (
            [
                say_transform("world", "imu_link", at_s=row / 9, by=turn(row / 9))
                for row in range(9)
            ],
            "an IMU, which turns in one place",
        ),
    ],
    ids=["imu", "moves", "number", "other", "robot", "simulator", "transforms"],
)
def test_poses_of_an_imu_are_no_robot_s_as_long_as_they_stay(
    call: Call, tmp_path: Path, poses: list[Said], kind: str
) -> None:
    bag = write_robot(tmp_path, poses)
    assert f"ROS 2 bag of {kind}, " in call("info", bag).flat


def test_poses_are_told_where_only_the_command_topic_is_undecided(
    call: Call, tmp_path: Path
) -> None:
    commands = [
        say_twist(0.1, row=row, topic=f"/{name}/cmd_vel")
        for name in ("left", "nav")
        for row in range(5)
    ]
    told = call("info", write_robot(tmp_path, say_odometry(count=5), commands)).flat
    assert "a robot: 5 poses on /odom; not turtlesim; command_topic: expected one topic" in told
    assert "/left/cmd_vel, /nav/cmd_vel: choose with --command-topic" in told
    assert "cannot be read" not in told
    told = call("info", write_robot(tmp_path, commands)).flat
    assert "commands without poses; command_topic: expected one topic, found /left/cmd_vel" in told
    assert "needs" not in told


@pytest.mark.parametrize(
    ("messages", "words"),
    [
        ([say_goal(1.0, 2.0)], "goals on /goal_pose (geometry_msgs/msg/PoseStamped)"),
        (
            [say_transform("base_link", "laser", topic="/tf_static")],
            "fixed transforms on /tf_static (tf2_msgs/msg/TFMessage)",
        ),
    ],
    ids=["goal", "tf_static"],
)
def test_a_bag_without_poses_of_a_robot_has_none_to_choose(
    call: Call, tmp_path: Path, messages: list[Said], words: str
) -> None:
    told = call("info", write_robot(tmp_path, messages)).flat
    assert f"no poses, nothing to measure: {words}" in told
    assert "none is chosen" not in told
    assert "to be measured it needs nav_msgs/msg/Odometry" in told


def test_transforms_of_a_joint_give_no_poses(call: Call, tmp_path: Path) -> None:
    joint = [say_transform("base_link", "wheel", at_s=row, by=turn(row)) for row in range(5)]
    told = call("info", write_robot(tmp_path, joint)).flat
    assert "transforms on /tf, which give no poses: expected transforms in which a robot" in told


@pytest.mark.parametrize("topic", ["/left/odom", "left/odom"])
def test_a_topic_is_found_with_its_leading_slash_or_without(
    call: Call, tmp_path: Path, topic: str
) -> None:
    bag = write_robot(tmp_path, say_odometry("/left/odom"), say_odometry("/right/odom"))
    for words in ((f"{bag}:{topic}",), (bag, "--pose-topic", topic)):
        answer = call("info", *words)
        assert answer.code == 0
        assert "poses /left/odom, 3 messages" in answer.flat
    assert tl.read_run(f"{bag}:{topic}").name == f"robot:{topic}"
    wrong = call("info", f"{bag}:up/odom")
    assert (wrong.code, wrong.err.count("\n")) == (2, 1)
    assert "expected a topic up/odom, found /left/odom, /right/odom" in wrong.err


def test_a_topic_without_a_slash_in_the_file_is_found_too(call: Call, tmp_path: Path) -> None:
    bag = write_robot(tmp_path, say_odometry("odom", count=4), say_odometry("/kf/odom"))
    assert "poses odom, 4 messages" in call("info", f"{bag}:/odom").flat
    assert "poses odom, 4 messages" in call("info", f"{bag}:odom").flat


def test_a_file_whose_name_has_a_colon_is_itself(call: Call, tmp_path: Path) -> None:
    bag = write_robot(tmp_path, say_odometry(count=4), name="run:1")
    assert call("info", bag).code == 0
    assert call("info", f"{bag}:odom").code == 0
    assert "no such file" in call("info", tmp_path / "missing.mcap:odom").err
