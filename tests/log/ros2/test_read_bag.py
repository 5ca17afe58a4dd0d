import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

import turtlelog as tl
from tests.log.ros2.bags import (
    START_NS,
    TICK_NS,
    Said,
    make_command,
    make_odometry,
    make_poses,
    make_stamped_pose,
    make_vector,
    write_mcap,
    write_metadata,
)
from tests.log.runs import find_shared
from turtlelog.errors import LogError
from turtlelog.log.ros2 import read_bag, read_bag_info
from turtlelog.run import Run


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "some.mcap"


def read_messages(file: Path, *messages: Said) -> Run:
    return read_bag(write_mcap(file, messages))


def test_a_real_turtlesim_is_read_to_the_last_bit() -> None:
    path = find_shared("ros2", "turtlesim_jazzy")
    run = read_bag(path)
    with AnyReader([path]) as reader:
        found: list[tuple[int, Any]] = [
            (time_ns, reader.deserialize(data, connection.msgtype))
            for connection, time_ns, data in reader.messages()
            if connection.topic == "/turtle1/pose"
        ]
    start_ns = found[0][0]
    assert run.poses.time_ns.tolist() == [time_ns - start_ns for time_ns, _ in found]
    assert run.poses.xy_m.tolist() == [[pose.x, pose.y] for _, pose in found]
    assert run.poses.heading_rad.tolist() == [pose.theta for _, pose in found]
    assert run.poses.speed_m_s is not None
    assert run.poses.speed_m_s.tolist() == [pose.linear_velocity for _, pose in found]


def test_a_real_turtlesim_names_its_source() -> None:
    run = read_bag(find_shared("ros2", "turtlesim_jazzy"))
    assert (run.name, run.source) == ("turtlesim_jazzy", "rosbag2: turtlesim_jazzy")
    assert run.notes["original_timestamp"] == "2025-11-24T22:53:37.316665187Z"
    assert (len(run.commands), len(run.samples), run.goal_xy_m) == (18, 0, None)
    assert run.commands.turn_rate_rad_s.tolist()[:3] == [0.0, -2.0, 0.0]
    assert {"samples", "goal_xy_m", "parameters", "stop_reason"} <= set(run.absent)


def test_recordings_without_poses_say_what_they_hold() -> None:
    for path in sorted(find_shared("ros2").glob("*.mcap")):
        with pytest.raises(LogError, match=rf"{path.name}: no poses; it contains \S+ \(\w+"):
            read_bag(path)


def test_odometry_gives_heading_and_speeds(file: Path) -> None:
    run = read_messages(file, make_odometry(yaw_rad=-3.0, speed=(-3.0, 4.0), turn_rate=0.7))
    assert run.poses.xy_m.tolist() == [[3.0, 4.0]]
    assert run.poses.heading_rad[0] == pytest.approx(-3.0, abs=1e-15)
    assert run.poses.measured_speed_m_s is not None
    assert run.poses.measured_turn_rate_rad_s is not None
    assert run.poses.measured_speed_m_s.tolist() == [-3.0]
    assert run.poses.measured_turn_rate_rad_s.tolist() == [0.7]
    assert run.poses.speed_m_s is None


def test_a_stamped_pose_lacks_speeds(file: Path) -> None:
    run = read_messages(file, make_stamped_pose(yaw_rad=2.5, length=0.3))
    assert run.poses.heading_rad[0] == pytest.approx(2.5, abs=1e-15)
    assert run.poses.speed_m_s is None
    assert {"poses.speed_m_s", "poses.turn_rate_rad_s", "commands"} <= set(run.absent)
    assert run.source == "mcap: some.mcap"


def test_a_robot_that_leans_keeps_its_heading(file: Path) -> None:
    message = make_stamped_pose(yaw_rad=1.0)
    turn = message.values["pose"]["orientation"]
    turn["x"], turn["y"] = 0.3 * turn["w"], 0.3 * turn["z"]
    assert read_messages(file, message).poses.heading_rad[0] == pytest.approx(1.0, abs=1e-15)


def test_a_quaternion_that_was_never_set_is_named(file: Path) -> None:
    with pytest.raises(LogError, match=r"some\.mcap: topic /pose: message 0: .* found all zeros"):
        read_messages(file, make_stamped_pose(length=0.0))


def test_commands_come_from_twists_with_and_without_a_stamp(file: Path) -> None:
    stamped = Said(
        topic="/cmd",
        type="geometry_msgs/msg/TwistStamped",
        values={
            "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
            "twist": {"linear": make_vector(1.0, 0.5), "angular": make_vector(z=2.0)},
        },
    )
    for command in (stamped, make_command()):
        commands = read_messages(file, *make_poses(), command).commands
        assert (commands.speed_m_s[0], commands.lateral_speed_m_s[0]) == (1.0, 0.5)
        assert commands.turn_rate_rad_s.tolist() == [2.0]


def test_the_newer_name_of_turtlesims_messages_is_known(file: Path) -> None:
    run = read_messages(file, *make_poses(kind="turtlesim_msgs/msg/Pose", linear_velocity=-1.5))
    assert run.poses.speed_m_s is not None
    assert run.poses.speed_m_s.tolist() == [1.5] * 3
    assert run.notes["pose_topic"] == "/turtle1/pose (turtlesim_msgs/msg/Pose)"


def test_time_counts_from_the_first_message_of_both_topics(file: Path) -> None:
    run = read_messages(file, *make_poses(2), make_command(time_ns=START_NS - 5))
    assert run.commands.time_ns.tolist() == [0]
    assert run.poses.time_ns.tolist() == [5, 5 + TICK_NS]
    assert run.notes["original_timestamp"] == "2023-11-14T22:13:20.123456784Z"


def test_poses_of_one_time_keep_their_order_and_are_counted(file: Path) -> None:
    rows = [replace(row, time_ns=START_NS) for x in (1, 2, 3) for row in make_poses(1, x=float(x))]
    run = read_messages(file, *rows)
    assert run.poses.time_ns.tolist() == [0, 1, 2]
    assert run.poses.xy_m[:, 0].tolist() == [1.0, 2.0, 3.0]
    assert (run.notes["moved_rows"], run.notes["dropped_duplicates"]) == ("2", "0")


def test_messages_that_are_there_twice_are_dropped_and_counted(file: Path) -> None:
    run = read_messages(file, *make_poses(3), *make_poses(2))
    assert len(run.poses) == 3
    assert run.notes["dropped_duplicates"] == "2"


def test_equal_commands_of_a_burst_are_no_duplicates(file: Path) -> None:
    run = read_messages(file, *make_poses(), make_command(number=0), make_command(number=1))
    assert len(run.commands) == 2
    assert run.notes["dropped_duplicates"] == "0"


def test_headings_beyond_half_a_turn_are_wrapped_and_counted(file: Path) -> None:
    run = read_messages(
        file, *make_poses(2, theta=3.5), *make_poses(3, theta=np.float32(np.pi))[2:]
    )
    assert run.poses.heading_rad[0] == pytest.approx(3.5 - 2.0 * math.pi)
    assert run.poses.heading_rad[2] == float(np.float32(np.pi))
    assert run.notes["wrapped_headings"] == "2"


def test_poses_that_are_no_numbers_are_dropped_and_counted(file: Path) -> None:
    wrong = [make_poses(3, x=math.nan)[1], *make_poses(3, theta=math.inf)[2:]]
    run = read_messages(file, *make_poses(1), *wrong, make_command(), make_command(math.nan))
    assert (len(run.poses), len(run.commands)) == (1, 1)
    assert run.notes["dropped_nan"] == "2 poses and 1 command"


def test_poses_of_which_none_is_a_number_are_named(file: Path) -> None:
    line = r"some\.mcap: topic /turtle1/pose: expected numbers .* in all 2 poses"
    with pytest.raises(LogError, match=line):
        read_messages(file, *make_poses(2, x=math.nan))


def test_turtlesims_own_topic_comes_before_others(file: Path) -> None:
    run = read_messages(file, make_stamped_pose("/goal"), *make_poses(2))
    assert run.notes["pose_topic"].startswith("/turtle1/pose ")


def test_of_two_turtles_the_first_is_read_and_the_other_named(file: Path) -> None:
    run = read_messages(file, *make_poses(2, topic="/turtle10/pose", x=7.0), *make_poses(2))
    assert run.poses.xy_m[0, 0] == 1.0
    assert run.notes["robots"] == "turtle1 of turtle1, turtle10: --robot NAME chooses"
    assert read_bag(file, pose_topic="/turtle10/pose").poses.xy_m[0, 0] == 7.0


def test_commands_come_from_the_neighbour_of_the_poses(file: Path) -> None:
    others = [make_command(9.0, topic=f"/{name}/cmd_vel") for name in ("turtle1", "robot")]
    wanted = make_command(4.0, topic="/turtle2/cmd_vel")
    run = read_messages(file, *make_poses(2, topic="/turtle2/pose"), *others, wanted)
    assert run.commands.speed_m_s.tolist() == [4.0]


def test_another_turtles_commands_are_not_taken(file: Path) -> None:
    other = make_command(9.0, topic="/turtle1/cmd_vel")
    run = read_messages(file, *make_poses(2, topic="/turtle2/pose"), other)
    assert len(run.commands) == 0


def test_two_commanders_are_a_question(file: Path) -> None:
    commands = [make_command(float(row), topic=f"/{row}/cmd_vel") for row in (1, 2)]
    write_mcap(file, [make_stamped_pose(), *commands])
    with pytest.raises(
        LogError, match=r"found /1/cmd_vel, /2/cmd_vel: choose with --command-topic"
    ):
        read_bag(file)
    assert read_bag(file, command_topic="/2/cmd_vel").commands.speed_m_s.tolist() == [2.0]


def test_a_topic_asked_for_has_to_be_there_and_to_fit(file: Path) -> None:
    write_mcap(file, [*make_poses(2), make_command()])
    with pytest.raises(LogError, match=r"pose_topic: .* found /nothing among /turtle1/"):
        read_bag(file, pose_topic="/nothing")
    with pytest.raises(
        LogError, match=r"command_topic /turtle1/pose: expected geometry_msgs.* found"
    ):
        read_bag(file, command_topic="/turtle1/pose")


def test_a_bag_of_several_files_is_one_run(tmp_path: Path) -> None:
    poses = make_poses(6)
    write_mcap(tmp_path / "b.mcap", [*poses[:2], make_command()])
    write_mcap(tmp_path / "a.mcap", poses[2:])
    run = read_bag(write_metadata(tmp_path, ["old_folder/b.mcap", '"a.mcap"']))
    assert run.poses.time_ns.tolist() == [row * TICK_NS for row in range(6)]
    assert (run.notes["sorted_rows"], len(run.commands)) == ("0", 1)


def test_files_that_overlap_are_sorted_and_counted(tmp_path: Path) -> None:
    poses = make_poses(6)
    write_mcap(tmp_path / "a.mcap", poses[3:])
    write_mcap(tmp_path / "b.mcap", poses[:4])
    run = read_bag(write_metadata(tmp_path, ["a.mcap", "b.mcap"]))
    assert run.poses.time_ns.tolist() == [row * TICK_NS for row in range(6)]
    assert (run.notes["sorted_rows"], run.notes["dropped_duplicates"]) == ("4", "1")


def test_the_topics_of_a_bag_are_listed_together(tmp_path: Path) -> None:
    write_mcap(tmp_path / "a.mcap", make_poses(3))
    write_mcap(tmp_path / "b.mcap", [*make_poses(2), make_command()])
    info = read_bag_info(write_metadata(tmp_path, ["a.mcap", "b.mcap"]))
    counts = {topic.topic: topic.count for topic in info.topics}
    assert counts == {"/turtle1/cmd_vel": 1, "/turtle1/pose": 5}
    assert (info.duration_s, info.format_version) == (2.5, None)


@pytest.mark.parametrize(
    ("storage", "mode", "line"),
    [
        ("mcap", "NONE", "relative_file_paths: expected the file a.mcap, found none"),
        ("mcap", "[file]", r"line 9: compression_mode: expected plain text, found '\[file\]'"),
    ],
)
def test_a_bag_that_cannot_be_read_says_why(
    storage: str, mode: str, line: str, tmp_path: Path
) -> None:
    write_metadata(tmp_path, ["a.mcap"], storage=storage, mode=mode)
    with pytest.raises(LogError, match=rf"metadata\.yaml: {line}"):
        read_bag(tmp_path)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", "the entry rosbag2_bagfile_information is missing"),
        ("rosbag2_bagfile_information:\n  version: 5\n", "relative_file_paths: expected a list"),
        ("rosbag2_bagfile_information:\n  ? x\n", r"line 2: expected key: value, found '\? x'"),
    ],
)
def test_a_description_of_another_kind_is_named(text: str, line: str, tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").write_text(text)
    with pytest.raises(LogError, match=rf"metadata\.yaml: {line}"):
        read_bag(tmp_path)


def test_a_folder_that_is_no_bag_is_named(tmp_path: Path) -> None:
    line = r"no recordings in this folder \(no metadata\.yaml, \.mcap or \.db3 files\)"
    with pytest.raises(LogError, match=line):
        read_bag(tmp_path)


def test_a_topic_of_sensed_poses_has_no_rates_and_is_read(tmp_path: Path) -> None:
    scenario = tl.override_scenario(
        tl.load_scenario("paper-kp4"), {"sensing.noise_position_m": 0.01}, source="test"
    )
    run = tl.simulate_run(scenario)
    tl.write_recording(run, tmp_path / "a.mcap")
    sensed = tl.read_run(tmp_path / "a.mcap", pose_topic="/turtle1/sensed_pose")
    np.testing.assert_allclose(sensed.poses.xy_m, run.poses.read_xy_m, atol=1e-6)
    assert sensed.poses.speed_m_s is None
    assert {"poses.speed_m_s", "poses.turn_rate_rad_s"} <= {*sensed.absent}
