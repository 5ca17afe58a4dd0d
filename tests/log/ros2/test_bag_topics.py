import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer

from tests.cli.conftest import Call, call as call
from tests.log.ros2.bags import (
    START_NS,
    Said,
    make_command,
    make_poses,
    make_stamped_pose,
    make_vector,
    write_mcap,
    write_metadata,
)
from tests.log.ros2.robots import (
    describe_head,
    describe_place,
    say_goal,
    say_odometry,
    turn,
    write_robot,
)
from tests.log.runs import find_shared
from turtlelog.errors import LogError
from turtlelog.log import TopicInfo, read_run
from turtlelog.log.planar_poses import describe_leaps
from turtlelog.log.read_choice import ReadChoice
from turtlelog.log.ros2.bag_commands import choose_command_topic, choose_commands
from turtlelog.log.ros2.bag_topics import choose_pose_topic


def list_topics(*pairs: tuple[str, str], count: int = 9) -> list[TopicInfo]:
    return [TopicInfo(topic=topic, type=kind, count=count) for topic, kind in pairs]


ODOMETRY = "nav_msgs/msg/Odometry"
STAMPED = "geometry_msgs/msg/PoseStamped"
WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TWIST = "geometry_msgs/msg/Twist"


@pytest.mark.parametrize(
    ("topics", "expected"),
    [
        ([("/odom_noisy", ODOMETRY), ("/odom", ODOMETRY), ("/odom_kf", ODOMETRY)], "/odom"),
        ([("/amcl_pose", WITH_COVARIANCE), ("/robot/odom", ODOMETRY)], "/robot/odom"),
        ([("/wheels/odom", ODOMETRY), ("/odometry/filtered", ODOMETRY)], "/wheels/odom"),
        ([("/robot2/odom", ODOMETRY), ("/robot10/odom", ODOMETRY)], "/robot2/odom"),
        ([("/tf", "tf2_msgs/msg/TFMessage"), ("/amcl_pose", WITH_COVARIANCE)], "/amcl_pose"),
        ([("/goal_pose", STAMPED), ("/tracker", STAMPED)], "/tracker"),
        ([("/a/odom", ODOMETRY), ("/b/odom", ODOMETRY), ("/b/cmd_vel", TWIST)], "/b/odom"),
    ],
)
def test_poses_are_chosen_by_what_they_are(topics: list[tuple[str, str]], expected: str) -> None:
    assert choose_pose_topic(list_topics(*topics), None).topic.topic == expected
    assert choose_pose_topic(list_topics(*topics[::-1]), None).topic.topic == expected


def test_names_that_say_equally_much_are_a_question() -> None:
    topics = list_topics(("/left/odom", ODOMETRY), ("/right/odom", ODOMETRY))
    line = "pose_topic: expected one topic, found /left/odom, /right/odom: .* --pose-topic"
    with pytest.raises(LogError, match=line):
        choose_pose_topic(topics, None)


@pytest.mark.parametrize(
    "name",
    [
        *("/goal_pose", "/turtle1/goal", "/move_base_simple/goal", "/currentGoal", "/initialpose"),
        *("/target_pose", "/marker_pose", "/waypoint3", "/robot/set_pose", "/clicked_point"),
    ],
)
def test_a_goal_is_never_taken_for_where_a_robot_is(name: str) -> None:
    with pytest.raises(LogError, match=f"no poses; it contains {name} "):
        choose_pose_topic(list_topics((name, STAMPED)), None)
    assert choose_pose_topic(list_topics((name, STAMPED)), name).topic.topic == name


def test_numbers_in_names_may_have_any_length() -> None:
    long = "9" * 5000
    names = [f"/robot{long}1/odom", f"/robot{long}0/odom", f"/robot1{long}0/odom"]
    topics = list_topics(*((name, ODOMETRY) for name in names))
    assert choose_pose_topic(topics, None).topic.topic == names[1]
    short = list_topics(*((f"/robot{number}/odom", ODOMETRY) for number in ("10", "02", "9")))
    assert choose_pose_topic(short, None).topic.topic == "/robot02/odom"


def test_one_message_is_no_motion() -> None:
    lone = list_topics(("/odom", ODOMETRY), count=1)
    assert choose_pose_topic([*lone, *list_topics(("/x", ODOMETRY))], None).topic.topic == "/x"


@pytest.mark.parametrize(
    ("poses", "names", "expected"),
    [
        ("/odom", ["/cmd_vel_nav", "/cmd_vel_smoothed", "/cmd_vel", "/cmd_vel_raw"], "/cmd_vel"),
        ("/odom", ["/cmd_vel_nav", "/cmd_vel_smoothed"], "/cmd_vel_smoothed"),
        ("/odom", ["/controller/cmd_vel", "/cmd_vel_nav"], "/controller/cmd_vel"),
        ("/robot1/odom", ["/robot2/cmd_vel", "/robot1/cmd_vel_nav"], "/robot1/cmd_vel_nav"),
        ("/base/odom", ["/cmd_vel", "/base/cmd_vel"], "/base/cmd_vel"),
        ("/robot1/odom", ["/robot1_base/cmd_vel"], "/robot1_base/cmd_vel"),
        ("/odom", ["/twist", "/wheels/measured"], "/twist"),
        (
            "/gps/fix",
            ["/joy_teleop/cmd_vel", "/a_base_controller/cmd_vel"],
            "/a_base_controller/cmd_vel",
        ),
        (
            "/gps/fix",
            ["/cmd_vel", "/drive_controller/cmd_vel_out"],
            "/drive_controller/cmd_vel_out",
        ),
        ("/drive_controller/odom", ["/cmd_vel", "/joy/cmd_vel"], "/cmd_vel"),
        (
            "/joystick_robot2/odom",
            ["/teleop/cmd_vel", "/controlled/cmd_vel_out"],
            "/controlled/cmd_vel_out",
        ),
        ("/a/base_controller/odom", ["/a/cmd_vel", "/drive_controller/cmd_vel"], "/a/cmd_vel"),
        ("/odom", ["/monkey/cmd_vel", "/cmd_vel_out"], "/monkey/cmd_vel"),
        ("/odom", ["/key/cmd_vel", "/cmd_vel_out"], "/cmd_vel_out"),
    ],
)
def test_commands_are_those_that_the_base_listens_to(
    poses: str, names: list[str], expected: str
) -> None:
    topics = list_topics(*((name, TWIST) for name in names))
    found = choose_command_topic(topics, None, pose_topic=poses)
    assert found is not None
    assert found.topic.topic == expected
    assert expected not in found.others


@pytest.mark.parametrize(
    "name",
    [
        *("/robot2/cmd_vel", "/robot1_1/cmd_vel", "/robot/cmd_vel"),
        *("/robot1/current_vel", "/odom_twist"),
    ],
)
def test_measured_velocities_and_another_robots_are_no_commands(name: str) -> None:
    topics = list_topics((name, TWIST))
    assert choose_command_topic(topics, None, pose_topic="/robot1/odom") is None


def test_robots_of_one_bag_have_commands_of_their_own(tmp_path: Path) -> None:
    file = write_robot(
        tmp_path,
        *(say_odometry(f"/robot{number}/odom", x_m=number) for number in (1, 2)),
        *(make_command(number, topic=f"/robot{number}/cmd_vel") for number in (1, 2)),
    )
    first, second = read_run(file), read_run(f"{file}:/robot2/odom")
    assert (first.poses.xy_m[0, 0], first.commands.speed_m_s.tolist()) == (1.0, [1.0])
    assert (second.poses.xy_m[0, 0], second.commands.speed_m_s.tolist()) == (2.0, [2.0])
    assert second.name == "robot:/robot2/odom"
    assert first.notes["chosen"] == (
        "poses from /robot1/odom (nav_msgs/msg/Odometry), commands from /robot1/cmd_vel"
        " (geometry_msgs/msg/Twist); robots robot1 of robot1, robot2: --robot NAME chooses"
    )


PLACE = describe_place(3.0, 4.0, turn(2.5))
SPREAD = {"pose": PLACE, "covariance": [0.0] * 36}


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        (WITH_COVARIANCE, {"header": describe_head("map"), "pose": SPREAD}),
        ("geometry_msgs/msg/Pose", PLACE),
        ("geometry_msgs/msg/Pose2D", {"x": 3.0, "y": 4.0, "theta": 2.5}),
        (
            "geometry_msgs/msg/TransformStamped",
            {
                "header": describe_head("world"),
                "child_frame_id": "robot",
                "transform": {
                    "translation": PLACE["position"],
                    "rotation": PLACE["orientation"],
                },
            },
        ),
    ],
)
def test_poses_of_every_usual_type_are_read(
    kind: str, values: dict[str, object], tmp_path: Path
) -> None:
    run = read_run(write_mcap(tmp_path / "a.mcap", [Said(topic="/p", type=kind, values=values)]))
    assert run.poses.xy_m.tolist() == [[3.0, 4.0]]
    assert run.poses.heading_rad[0] == pytest.approx(2.5, abs=1e-15)


def test_a_topic_of_two_types_is_named_or_left_out(tmp_path: Path) -> None:
    write_mcap(tmp_path / "a.mcap", make_poses(2, topic="/pose"))
    write_mcap(tmp_path / "b.mcap", [make_stamped_pose("/pose")])
    bag = write_metadata(tmp_path, ["a.mcap", "b.mcap"])
    line = (
        "topic /pose: expected messages of one type, found geometry_msgs.* and turtlesim/msg/Pose"
    )
    for topic in (None, "/pose"):
        with pytest.raises(LogError, match=line):
            read_run(bag, pose_topic=topic)
    write_mcap(tmp_path / "b.mcap", [make_stamped_pose("/pose"), *say_odometry()])
    assert read_run(bag).notes["pose_topic"] == "/odom (nav_msgs/msg/Odometry)"


def test_a_topic_in_some_of_the_files_is_read_from_these(tmp_path: Path) -> None:
    write_mcap(tmp_path / "a.mcap", [make_command()])
    write_mcap(tmp_path / "b.mcap", say_odometry(count=4))
    run = read_run(write_metadata(tmp_path, ["a.mcap", "b.mcap"]))
    assert (len(run.poses), len(run.commands)) == (4, 1)


def test_commands_before_the_first_pose_stay(tmp_path: Path) -> None:
    run = read_run(write_robot(tmp_path, say_odometry(), make_command(time_ns=START_NS - 7)))
    assert (run.commands.time_ns.tolist(), run.poses.time_ns[0]) == ([0], 7)


def test_quaternions_that_were_never_set_leave_the_others(tmp_path: Path) -> None:
    none = (0.0, 0.0, 0.0, 0.0)
    with pytest.raises(LogError, match="found all zeros in each of 3 messages: it was never set"):
        read_run(write_robot(tmp_path, say_odometry(by=none)))
    right = say_odometry(count=2)
    run = read_run(write_robot(tmp_path, right, say_odometry(count=3, by=none)[2:]))
    assert len(run.poses) == 2
    assert run.notes["dropped_nan"] == "1 pose, 1 of the poses without a heading"


@pytest.mark.parametrize(("tilt_rad", "is_said"), [(0.09, False), (0.11, True), (math.pi, True)])
def test_a_robot_that_leaves_the_plane_is_said(
    tilt_rad: float, *, is_said: bool, tmp_path: Path
) -> None:
    by = (math.sin(tilt_rad / 2), 0.0, 0.0, math.cos(tilt_rad / 2))
    run = read_run(write_robot(tmp_path, say_odometry(by=by)))
    assert ("plane" in run.notes) == is_said
    # It rolled: what was ahead is ahead.
    assert run.poses.heading_rad.tolist() == [0.0] * 3


def test_speeds_that_are_never_numbers_are_absent(tmp_path: Path) -> None:
    rows = say_odometry()
    for row in rows:
        row.values["twist"]["twist"]["linear"] = make_vector(math.nan)
    run = read_run(write_robot(tmp_path, rows))
    assert run.poses.measured_speed_m_s is None
    assert run.poses.measured_turn_rate_rad_s is not None
    assert len(run.poses) == 3


@pytest.mark.parametrize(
    ("name", "poses", "commands"),
    [
        ("tb3", "/odom (nav_msgs/msg/Odometry)", "/cmd_vel (geometry_msgs/msg/TwistStamped)"),
        ("sim_time", "/odom (nav_msgs/msg/Odometry)", None),
        (
            "turtlesim_sqlite",
            "/turtle1/pose (turtlesim/msg/Pose)",
            "/turtle1/cmd_vel (geometry_msgs/msg/Twist)",
        ),
        (
            "tf_only",
            "/tf (tf2_msgs/msg/TFMessage): odom -> base_footprint",
            "/controller/cmd_vel (geometry_msgs/msg/Twist)",
        ),
        ("amcl_pose", "/pose (geometry_msgs/msg/PoseWithCovarianceStamped)", None),
    ],
)
def test_other_peoples_robots_are_read(name: str, poses: str, commands: str | None) -> None:
    notes = read_run(find_shared("robots", name)).notes
    assert (notes["pose_topic"], notes.get("command_topic")) == (poses, commands)


ANGLE = {"type": "number"}
TURN = {"type": "object", "properties": dict.fromkeys("xyzw", ANGLE)}
PLACED = {"type": "object", "properties": dict.fromkeys("xyz", ANGLE)}


@pytest.mark.parametrize(
    ("fields", "values"),
    [
        (
            {"pose": {"type": "object", "properties": {"position": PLACED, "orientation": TURN}}},
            {"pose": PLACE},
        ),
        (
            {"translation": PLACED, "rotation": TURN},
            {"translation": {"x": 3, "y": 4, "z": 0}, "rotation": PLACE["orientation"]},
        ),
        (dict.fromkeys(("x", "y", "theta"), ANGLE), {"x": 3, "y": 4, "theta": 2.5}),
        (
            {
                "state": {
                    "type": "object",
                    "properties": dict.fromkeys(("x", "y", "yaw_deg"), ANGLE),
                }
            },
            {"state": {"x": 3, "y": 4, "yaw_deg": math.degrees(2.5)}},
        ),
    ],
    ids=["pose", "transform", "flat", "degrees"],
)
def test_poses_in_json_are_known_by_their_fields(
    fields: dict[str, Any], values: dict[str, Any], tmp_path: Path
) -> None:
    file = tmp_path / "a.mcap"
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start("", "test")
        other = writer.register_schema(
            "other", "jsonschema", b'{"type":"object","properties":{"k":{}}}'
        )
        schema = json.dumps({"type": "object", "properties": fields}).encode()
        kinds = {"/a": other, "/where": writer.register_schema("mine", "jsonschema", schema)}
        for topic, kind in kinds.items():
            channel = writer.register_channel(topic, "json", kind)
            writer.add_message(channel, 10, json.dumps(values).encode(), 10)
        writer.finish()  # type: ignore[no-untyped-call]
    for run in (read_run(file), read_run(f"{file}:/where")):
        assert run.poses.xy_m.tolist() == [[3.0, 4.0]]
        assert run.poses.heading_rad[0] == pytest.approx(2.5)
        assert run.notes["pose_topic"] == "/where (mine)"
    with pytest.raises(LogError, match=r"topic /a: expected other with a field pose\.orientation"):
        read_run(f"{file}:/a")


NUMBER = {"type": "number"}


def write_json_drive(path: Path, kind: str, axes: str, topic: str = "/cmd_vel") -> Path:
    """Write poses, and commands of a type, in JSON."""
    vector = {"type": "object", "properties": dict.fromkeys(axes, NUMBER)}
    schemas = {
        "/pose": ("mine", dict.fromkeys(("x", "y", "yaw"), NUMBER), {"x": 1, "y": 2, "yaw": 0}),
        topic: (
            kind,
            {"linear": vector, "angular": vector},
            {"linear": dict.fromkeys(axes, 0.5), "angular": dict.fromkeys(axes, -0.25)},
        ),
    }
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("", "test")
        for name, (of, fields, values) in schemas.items():
            schema = json.dumps({"type": "object", "properties": fields}).encode()
            number = writer.register_schema(of, "jsonschema", schema)
            channel = writer.register_channel(name, "json", number)
            for time_ns in range(3):
                at_ns = time_ns * 100_000_000
                writer.add_message(channel, at_ns, json.dumps(values).encode(), at_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


@pytest.mark.parametrize("kind", ["Cmd", "geometry_msgs/Twist", "geometry_msgs/msg/Twist"])
def test_commands_in_json_are_known_by_their_fields(kind: str, tmp_path: Path) -> None:
    run = read_run(write_json_drive(tmp_path / "a.mcap", kind, "xyz"))
    assert run.commands.speed_m_s.tolist() == [0.5] * 3
    assert run.commands.turn_rate_rad_s.tolist() == [-0.25] * 3
    asked = read_run(
        write_json_drive(tmp_path / "b.mcap", kind, "xyz", "/wanted"), command_topic="/wanted"
    )
    assert asked.commands.speed_m_s.tolist() == [0.5] * 3


@pytest.mark.parametrize(
    ("kind", "noun"), [("Cmd", "MCAP file"), ("geometry_msgs/msg/Twist", "ROS 2 bag")]
)
def test_a_file_without_types_of_ros_is_no_bag(
    call: Call, kind: str, noun: str, tmp_path: Path
) -> None:
    out = call("info", write_json_drive(tmp_path / "a.mcap", kind, "xyz")).out
    assert out.startswith(f"a.mcap: {noun} of a robot")


def test_a_twist_with_other_fields_says_so(tmp_path: Path) -> None:
    run = read_run(write_json_drive(tmp_path / "a.mcap", "geometry_msgs/Twist", "ab"))
    assert run.notes["commands"] == (
        "commands on /cmd_vel: geometry_msgs/Twist is not read, its fields are not those of a Twist"
    )


def test_a_file_is_named_once(tmp_path: Path) -> None:
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start("", "test")
        channel = writer.register_channel("/a", "json", 0)
        writer.add_message(channel, 10, b"{}", 10)
        writer.finish()  # type: ignore[no-untyped-call]
    bag = write_metadata(tmp_path, ["a.mcap"])
    with pytest.raises(LogError, match="topic /a: ") as caught:
        read_run(f"{bag}:/a")
    assert str(caught.value).startswith(f"{bag / 'a.mcap'}: topic /a: ")


def test_a_goal_beside_transforms_is_no_pose(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no poses; it contains"):
        read_run(write_robot(tmp_path, say_goal(1.0, 2.0)))


@pytest.mark.parametrize(
    ("poses", "topics", "expected"),
    [
        (
            "/mavros/local_position/pose",
            ["/mavros/local_position/velocity_local", "/mavros/setpoint_velocity/cmd_vel"],
            "/mavros/setpoint_velocity/cmd_vel",
        ),
        ("/mavros/local_position/pose", ["/mavros/local_position/velocity_body"], None),
        ("/vrpn/robot/pose", ["/vrpn/robot/twist"], None),
        ("/robot/odom", ["/robot/drive", "/cmd_vel"], "/cmd_vel"),
        ("/robot/odom", ["/drive"], "/drive"),
    ],
)
def test_what_is_called_a_command_is_one_before_velocities_beside_the_poses(
    poses: str, topics: list[str], expected: str | None
) -> None:
    found = choose_command_topic(
        list_topics(*((topic, TWIST) for topic in topics)), None, pose_topic=poses
    )
    assert (found and found.topic.topic) == expected


@pytest.mark.parametrize(("seldom", "is_said"), [(2, True), (4, True), (9, False)])
def test_two_programs_on_one_topic_are_said(seldom: int, tmp_path: Path, *, is_said: bool) -> None:
    rows = say_odometry(count=72, step_m=0.01)
    for row in rows[::seldom]:
        row.values["pose"]["pose"]["position"]["x"] += 3.0
    notes = read_run(write_robot(tmp_path, rows)).notes
    assert ("leaps" in notes) is is_said
    assert not is_said or "leap to and fro by 3 m" in notes["leaps"] or "2.9" in notes["leaps"]


@pytest.mark.parametrize(("size_m", "is_said"), [(0.11, True), (0.09, False)])
def test_noise_of_a_filter_is_no_second_program(
    size_m: float, tmp_path: Path, *, is_said: bool
) -> None:
    rows = say_odometry(count=40, step_m=0.0)
    for row in rows[::2]:
        row.values["pose"]["pose"]["position"]["x"] += size_m
    assert ("leaps" in read_run(write_robot(tmp_path, rows)).notes) is is_said


@pytest.mark.parametrize(("share", "is_said"), [(0.2, True), (0.12, False)])
def test_a_fifth_of_the_poses_must_leap(share: float, *, is_said: bool) -> None:
    """One pose in so many is elsewhere, at random: 0.24 and 0.14 of all leap and come back."""
    generator = np.random.default_rng(3)
    xy_m = np.zeros((4000, 2))
    xy_m[generator.random(4000) < share, 0] = 3.0
    assert (describe_leaps(xy_m) is not None) is is_said


def test_large_noise_is_no_second_program() -> None:
    noise_m = np.random.default_rng(1).normal(scale=5.0, size=(4000, 2))
    assert describe_leaps(noise_m) is None


@pytest.mark.parametrize(
    ("name", "is_told"), [("/control/control_cmd", True), ("/control/status", False)]
)
def test_commands_of_an_unread_type_are_named(name: str, *, is_told: bool) -> None:
    kind = "autoware_auto_control_msgs/msg/AckermannControlCommand"
    pick, lack = choose_commands(list_topics((name, kind)), ReadChoice(), pose_topic="/odom")
    assert pick is None
    assert lack.startswith(f"commands on {name}: {kind} is not read") is is_told


@pytest.mark.parametrize(
    ("poses", "commands", "is_told"),
    [
        ("/odom", "/robot2/cmd_vel", True),
        ("/odometry/filtered", "/robot2/cmd_vel", True),
        ("/alice/odom", "/bob/cmd_vel", True),
        ("/odom", "/mobile_base/commands/velocity", False),
        ("/odometry/filtered", "/nav/cmd_vel", False),
        ("/robot2/odom", "/cmd_vel", False),
        ("/robot2/odom", "/robot2/cmd_vel", False),
        ("/vrpn/tb1/pose", "/tb1/cmd_vel", False),
        ("/odom", "/teleop2_joy/cmd_vel", False),
    ],
)
def test_commands_that_may_be_another_robots_are_told(
    poses: str, commands: str, tmp_path: Path, *, is_told: bool
) -> None:
    bag = write_robot(tmp_path, say_odometry(poses), make_command(topic=commands))
    run = read_run(bag)
    told = f"the commands on {commands} may be another robot's, as the poses on {poses} are not"
    assert len(run.commands) == 1
    assert run.notes.get("other_robot", "").startswith(told) == is_told
    assert ("other_robot" in run.notes) == is_told
    assert "other_robot" not in read_run(bag, command_topic=commands).notes
