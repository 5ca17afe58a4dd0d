"""Wheel odometry of joints, places of satellite receivers, and steered commands."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from tests.cli.conftest import Call, call as call
from tests.cli.test_commands_alone import say_twist
from tests.log.ros2.bags import START_NS, Said, write_mcap, write_metadata
from tests.log.ros2.moved_robots import drive_wheels, say_fix, say_joints
from tests.log.ros2.robots import say_odometry, say_transform, turn, write_robot
from tests.log.runs import find_shared
from turtlelog.log.ros2.computed_poses import find_courses, project_fixes

WHEELS = {"wheel_joints": "left,right", "wheels": (0.05, 0.4)}


@pytest.mark.parametrize("has_positions", [True, False], ids=["positions", "velocities"])
def test_wheels_that_turn_evenly_drive_an_exact_circle(
    tmp_path: Path, *, has_positions: bool
) -> None:
    bag = write_robot(tmp_path, drive_wheels(has_positions=has_positions))
    run = tl.read_run(bag, **WHEELS)  # type: ignore[arg-type]
    turned_rad = 0.25 * np.arange(101) * 0.1
    expected_m = 2.0 * np.column_stack([np.sin(turned_rad), 1.0 - np.cos(turned_rad)])
    assert np.abs(run.poses.xy_m - expected_m).max() < 1e-9
    assert run.poses.heading_rad == pytest.approx(turned_rad)
    assert ("by their velocities, as positions are absent" in run.notes["wheels"]) != has_positions
    assert (run.poses.measured_speed_m_s is None) == has_positions
    if run.poses.measured_speed_m_s is not None:
        assert run.poses.measured_speed_m_s == pytest.approx(0.5)
        assert run.poses.measured_turn_rate_rad_s == pytest.approx(0.25)


def test_wheels_that_wrap_drive_on(tmp_path: Path) -> None:
    run, wrapped = (
        tl.read_run(write_robot(tmp_path, drive_wheels(wraps=wraps), name=name), **WHEELS)  # type: ignore[arg-type]
        for name, wraps in (("on", False), ("wrapped", True))
    )
    assert wrapped.poses.xy_m == pytest.approx(run.poses.xy_m)
    # 9 and 11 rad/s for 10 s are 90 and 110 rad: 14 and 18 times through half a turn.
    assert "32 steps beyond half a turn taken as wrapped" in wrapped.notes["wheels"]
    assert "wrapped" not in run.notes["wheels"]


@pytest.mark.parametrize(("most", "wraps"), [(1.0, True), (1.1, False)])
def test_encoders_from_0_to_a_turn_wrap_and_further_ones_do_not(
    tmp_path: Path, most: float, *, wraps: bool
) -> None:
    turned = [[9.0 * row / 10, 9.0 * row / 10] for row in range(101)]
    said = [
        say_joints(["left", "right"], [a % (most * math.tau) for a in angles], at_s=row / 10)
        for row, angles in enumerate(turned)
    ]
    run = tl.read_run(write_robot(tmp_path, said), **WHEELS)  # type: ignore[arg-type]
    assert ("taken as wrapped" in run.notes["wheels"]) == wraps
    assert (run.poses.xy_m[-1, 0] == pytest.approx(0.05 * 90.0)) == wraps


def test_wheels_stand_anywhere_among_other_joints_and_messages(tmp_path: Path) -> None:
    said = drive_wheels(rows=5)
    arm = [say_joints(["elbow"], [0.1], at_s=row / 10 + 0.05) for row in range(5)]
    others = [
        say_joints(
            ["elbow", "right", "left"], [0.1, 11.0 * row / 10, 9.0 * row / 10], at_s=row / 10
        )
        for row in range(5)
    ]
    alone, among = (
        tl.read_run(write_robot(tmp_path, *some, name=name), **WHEELS)  # type: ignore[arg-type]
        for name, some in (("alone", [said]), ("among", [others, arm]))
    )
    assert among.poses.xy_m == pytest.approx(alone.poses.xy_m)


def test_wheels_go_on_in_the_next_file_of_a_bag(tmp_path: Path) -> None:
    said = drive_wheels(rows=20)
    (tmp_path / "bag").mkdir()
    write_mcap(tmp_path / "bag" / "bag_0.mcap", said[:10])
    write_mcap(tmp_path / "bag" / "bag_1.mcap", said[10:])
    bag = write_metadata(tmp_path / "bag", ["bag_0.mcap", "bag_1.mcap"])
    whole = tl.read_run(write_robot(tmp_path, said), **WHEELS)  # type: ignore[arg-type]
    assert tl.read_run(bag, **WHEELS).poses.xy_m == pytest.approx(whole.poses.xy_m)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("choice", "reason"),
    [
        ({}, "joints give poses with --wheel-joints LEFT,RIGHT --wheels RADIUS,TRACK"),
        ({"wheels": (0.05, 0.4)}, "wheels: needs wheel_joints, too"),
        ({"wheel_joints": "left,right"}, "wheel_joints: needs wheels, too"),
        (WHEELS | {"wheel_joints": "left"}, "wheel_joints: expected LEFT,RIGHT"),
        (WHEELS | {"wheel_joints": "left,left"}, "wheel_joints: expected LEFT,RIGHT"),
        (WHEELS | {"wheel_joints": "left,up"}, "expected the joint up, found left, right"),
        (WHEELS | {"wheels": (0.05, 0.0)}, "wheels: expected radius and track above 0 in m"),
        (WHEELS | {"wheels": (math.nan, 0.4)}, "wheels: expected radius and track above 0 in m"),
        (WHEELS | {"pose_frame": "base"}, "pose_frame: expected poses from transforms"),
        (WHEELS | {"pose_topic": "/odom"}, "pose_topic /odom: expected sensor_msgs/msg/JointState"),
    ],
)
def test_what_is_missing_of_wheels_is_named(
    tmp_path: Path, choice: dict[str, object], reason: str
) -> None:
    odometry = say_odometry() if "pose_topic" in choice else []
    bag = write_robot(tmp_path, drive_wheels(rows=3), odometry)
    with pytest.raises(tl.errors.LogError, match=reason):
        tl.read_run(bag, **choice)  # type: ignore[arg-type]


def test_wheels_in_messages_of_their_own_are_refused(tmp_path: Path) -> None:
    said = [
        say_joints([name], [0.1 * row], at_s=row / 10 + shift)
        for row in range(5)
        for name, shift in (("left", 0.0), ("right", 0.05))
    ]
    with pytest.raises(
        tl.errors.LogError, match="expected left and right in one message, found each in"
    ):
        tl.read_run(write_robot(tmp_path, said), **WHEELS)  # type: ignore[arg-type]


def test_wheels_of_a_real_robot_drive_as_far_as_its_odometry_says() -> None:
    bag = find_shared("robots", "tb3")
    wheels = {"wheel_joints": "wheel_left_joint,wheel_right_joint", "wheels": (0.033, 0.16)}
    by_wheels = tl.read_run(bag, **wheels)  # type: ignore[arg-type]
    lengths_m = [
        tl.measure_run(run, only=["run.path_length"])["run.path_length"].value
        for run in (tl.read_run(bag), by_wheels)
    ]
    # Its heading is a gyroscope's, and the way its wheels'.
    assert lengths_m[1] == pytest.approx(lengths_m[0], rel=0.002)


def say_drive(rows: int = 61, **more: float) -> list[Said]:
    """Return fixes of a receiver that drives 1 m/s to the north-east, near 48 deg north."""
    north_m, east_m = (111_200.0, 74_600.0)
    return [
        say_fix(48.0 + row / 2**0.5 / north_m, 11.0 + row / 2**0.5 / east_m, at_s=row, **more)  # type: ignore[arg-type]
        for row in range(rows)
    ]


def test_fixes_are_metres_east_and_north_of_the_first(tmp_path: Path) -> None:
    run = tl.read_run(write_robot(tmp_path, say_drive()))
    assert run.notes["pose_topic"] == "/fix (sensor_msgs/msg/NavSatFix)"
    assert run.poses.xy_m[0] == pytest.approx([0.0, 0.0])
    assert run.poses.xy_m[-1] == pytest.approx(60.0 / 2**0.5, abs=0.1)
    assert run.poses.heading_rad == pytest.approx(math.pi / 4, abs=0.01)
    assert "the course over 0.5 m, as a receiver has no heading" in run.notes["heading"]
    assert "48.0000000 deg, 11.0000000 deg (WGS84)" in run.notes["origin"]


def test_the_plane_touches_the_ellipsoid_of_wgs84() -> None:
    # A degree of the meridian at 45 deg is 111,132.95 m of arc from 44.5 to 45.5 deg, one of the
    # parallel 78,846.81 m (lengths of WGS84, as geodesy's tables have them); near them the plane
    # is as the arc.
    north_m = project_fixes(np.array([45.0, 45.001]), np.array([7.0, 7.0]), np.zeros(2))[1]
    east_m = project_fixes(np.array([45.0, 45.0]), np.array([7.0, 7.001]), np.zeros(2))[1]
    assert north_m == pytest.approx([0.0, 111.1317, 0.0], abs=2e-3)
    far_m = project_fixes(np.array([45.0, 45.1]), np.array([7.0, 7.0]), np.full(2, 500.0))[1]
    assert far_m[2] == 0.0  # on the tangent plane -9.7 m
    assert east_m == pytest.approx([78.8468, 0.0, 0.0], abs=1e-3)
    up_m = project_fixes(np.array([45.0, 45.0]), np.array([7.0, 7.0]), np.array([100.0, 105.0]))[1]
    assert up_m == pytest.approx([0.0, 0.0, 5.0], abs=1e-6)


def test_messages_without_a_fix_are_left_out_and_counted(tmp_path: Path) -> None:
    said = [
        say_fix(48.0, 11.0, at_s=-3.0, status=-1),
        say_fix(0.0, 0.0, at_s=-2.0),
        say_fix(math.nan, 11.0, at_s=-1.0),
        *say_drive(),
    ]
    run = tl.read_run(write_robot(tmp_path, said))
    assert len(run.poses) == 61
    assert "3 messages without a fix left out" in run.notes["heading"]
    with pytest.raises(
        tl.errors.LogError, match="expected a satellite fix, found none in 3 messages"
    ):
        tl.read_run(write_robot(tmp_path, said[:3]))


def test_a_receiver_that_stands_has_no_heading(tmp_path: Path) -> None:
    random = np.random.default_rng(1)
    said = [
        say_fix(48.0 + 1e-6 * north, 11.0 + 1e-6 * east, at_s=row)
        for row, (north, east) in enumerate(random.normal(size=(120, 2)))
    ]
    with pytest.raises(
        tl.errors.LogError, match=r"found a slower one, within .* m in all: it has no h"
    ):
        tl.read_run(write_robot(tmp_path, said))


@pytest.mark.parametrize(
    ("count", "step_s", "reason"),
    [
        (1, 1.0, "found fewer than 3 fixes"),
        (2, 1.0, "found fewer than 3 fixes"),
        (3, 4.9, ""),
        (9, 5.1, "found fixes 5.1 s apart, which is too seldom"),
    ],
)
def test_too_few_fixes_are_told_from_a_receiver_that_stands(
    tmp_path: Path, count: int, step_s: float, reason: str
) -> None:
    said = [say_fix(48.0 + 1e-4 * row, 11.0, at_s=row * step_s) for row in range(count)]
    bag = write_robot(tmp_path, said)
    if not reason:
        note = tl.read_run(bag).notes["heading"]
        assert "held at either end and where it stands, for 2 of 3 poses" in note
        return
    with pytest.raises(tl.errors.LogError, match=reason):
        tl.read_run(bag)


@pytest.mark.parametrize(("noise_m", "most_deg"), [(0.0, 0.1), (0.02, 7.0), (0.3, 20.0)])
def test_courses_are_those_of_the_motion_whatever_the_noise(
    noise_m: float, most_deg: float
) -> None:
    time_s = np.arange(0.0, 60.0, 0.2)
    angle_rad = time_s / 20.0
    xy_m = 40.0 * np.column_stack([np.sin(angle_rad), 1.0 - np.cos(angle_rad)])
    noisy_m = xy_m + np.random.default_rng(0).normal(0.0, noise_m, xy_m.shape)
    courses_rad, way_m, held = find_courses(time_s, noisy_m)
    off_deg = np.degrees(np.abs(np.angle(np.exp(1j * (courses_rad - angle_rad)))))
    inside = slice(10, -10)
    assert off_deg[inside].max() < most_deg
    assert way_m == pytest.approx(max(0.5, 10.0 * noise_m), rel=0.35)
    assert held < 20


def test_a_course_is_held_where_the_receiver_stands() -> None:
    time_s = np.arange(60.0)
    x_m = np.clip(time_s - 20.0, 0.0, 10.0)
    courses_rad, _, held = find_courses(time_s, np.column_stack([np.zeros(60), x_m]))
    assert courses_rad == pytest.approx(math.pi / 2)
    assert 45 < held < 55


def test_a_receiver_comes_after_odometry_and_moving_transforms(tmp_path: Path) -> None:
    fixes = say_drive()
    moving = [say_transform("odom", "base_link", row, at_s=row) for row in range(5)]
    joint = [say_transform("base_link", "wheel", at_s=row, by=turn(row)) for row in range(5)]
    pairs = [(say_odometry(), "/odom"), (moving, "/tf"), (joint, "/fix")]
    for number, (others, topic) in enumerate(pairs):
        run = tl.read_run(write_robot(tmp_path, fixes, others, name=f"robot{number}"))
        assert run.notes["pose_topic"].startswith(f"{topic} ")


def say_steering(row: int, *, stamped: bool, speed: float = 2.0, angle: float = 0.3) -> Said:
    drive = {
        "steering_angle": angle,
        "steering_angle_velocity": 0.0,
        "speed": speed,
        "acceleration": 0.0,
        "jerk": 0.0,
    }
    head = {"header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}, "drive": drive}
    kind = f"ackermann_msgs/msg/AckermannDrive{'Stamped' if stamped else ''}"
    values = head if stamped else drive
    return Said(topic="/drive", type=kind, values=values, time_ns=START_NS + row * 50_000_000)


@pytest.mark.parametrize("stamped", [True, False])
def test_steering_turns_a_car_with_its_wheelbase(tmp_path: Path, *, stamped: bool) -> None:
    said = [say_steering(row, stamped=stamped) for row in range(5)]
    bag = write_robot(tmp_path, say_odometry(count=5), said)
    run = tl.read_run(bag, wheelbase=0.33)
    # Messages of SQLite and MCAP hold 32 bits.
    assert run.commands.speed_m_s == pytest.approx(2.0)
    assert run.commands.turn_rate_rad_s == pytest.approx(2.0 * math.tan(0.3) / 0.33, rel=1e-6)
    bare = tl.read_run(bag)
    assert len(bare.commands) == 0
    kind = said[0].type
    assert bare.notes["commands"] == (
        f"commands on /drive ({kind}): steering gives turn rates with --wheelbase L, in m"
    )
    assert "--wheelbase L" in bare.notes["chosen"]


@pytest.mark.parametrize(("angle", "kept"), [(1.57, 6), (math.pi / 2 + 1e-3, 5), (-3.0, 5)])
def test_a_wheel_that_stands_across_turns_no_car(tmp_path: Path, angle: float, kept: int) -> None:
    said = [say_steering(row, stamped=True) for row in range(5)]
    bag = write_robot(tmp_path, say_odometry(), said, say_steering(5, stamped=True, angle=angle))
    run = tl.read_run(bag, wheelbase=0.33)
    assert len(run.commands) == kept
    assert run.notes.get("dropped_nan") == (None if kept == 6 else "1 command")


def test_steering_comes_first_where_a_wheelbase_is_given(tmp_path: Path) -> None:
    twists = [say_twist(0.1, row=row) for row in range(5)]
    said = [say_steering(row, stamped=True) for row in range(5)]
    bag = write_robot(tmp_path, say_odometry(count=5), twists, said)
    assert tl.read_run(bag).commands.speed_m_s[0] == 0.1
    assert tl.read_run(bag, wheelbase=0.33).commands.speed_m_s[0] == 2.0
    assert tl.read_run(bag, wheelbase=1.0, command_topic="/cmd_vel").commands.speed_m_s[0] == 0.1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"robot": "bob"}, "robot bob: no topic below that name"),
        ({"wheel_joints": "a,b", "wheels": (0.1, 0.3)}, "JointState"),
    ],
)
def test_a_recording_of_ours_does_not_pass_over_what_it_lacks(
    tmp_path: Path, options: dict[str, Any], message: str
) -> None:
    path = tmp_path / "a.mcap"
    tl.write_recording(tl.simulate_run("textbook", changes={"max_duration_s": 0.5}), path)
    assert len(tl.read_run(path, robot="turtle1").samples)
    with pytest.raises(tl.errors.LogError, match=message):
        tl.read_run(path, **options)


def test_steering_alone_needs_a_wheelbase(tmp_path: Path) -> None:
    bag = write_robot(tmp_path, [say_steering(row, stamped=True) for row in range(5)])
    with pytest.raises(
        tl.errors.LogError, match=r"no poses; commands on /drive .*: steering gives turn"
    ):
        tl.read_run(bag, allow_no_poses=True)
    assert len(tl.read_run(bag, allow_no_poses=True, wheelbase=0.3).commands) == 5
    with pytest.raises(tl.errors.LogError, match="wheelbase: expected a length above 0"):
        tl.read_run(bag, allow_no_poses=True, wheelbase=-1.0)
    with pytest.raises(
        tl.errors.LogError, match=r"command_topic /drive .*: steering gives turn rates"
    ):
        tl.read_run(bag, allow_no_poses=True, command_topic="drive")


def test_the_command_line_a_specification_and_a_test_choose_wheels_alike(
    tmp_path: Path, call: Call
) -> None:
    bag = write_robot(tmp_path, drive_wheels())
    words = ("--wheel-joints", "left,right", "--wheels", "0.05,0.4")
    assert call("metrics", bag, *words).flat.startswith("robot.mcap: the path is 5 m long")
    spec = tmp_path / "spec.toml"
    proposed = call("check", "--init", bag, *words).out
    assert 'wheel_joints = "left,right"\nwheels = [0.05, 0.4]\n' in proposed
    spec.write_text(
        'format = 1\n[read]\nwheel_joints = "left,right"\nwheels = [0.05, 0.4]\nwheelbase = 0.3\n'
        '[checks.far]\nexpect = "run.path_length > 4.9"\n'
    )
    assert call("check", spec, bag).code == 0
    recording = tl.check.Recording(bag, **WHEELS)  # type: ignore[arg-type]
    assert recording.metric("run.path_length").value == pytest.approx(5.0, abs=0.01)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("wheels = [0.05]", "read.wheels: expected [radius, track] above 0 in m"),
        ('wheels = "0.05,0.4"', "read.wheels: expected [radius, track] above 0 in m"),
        ("wheelbase = true", "read.wheelbase: expected a length above 0 in m, found true"),
        ("wheelbase = -1", "read.wheelbase: expected a length above 0 in m"),
        ("wheel_joints = 3", "read.wheel_joints: expected text"),
    ],
)
def test_a_specification_names_what_is_wrong_with_wheels(
    tmp_path: Path, call: Call, line: str, reason: str
) -> None:
    spec = tmp_path / "spec.toml"
    spec.write_text(f'format = 1\n[read]\n{line}\n[checks.a]\nexpect = "run.duration > 1"\n')
    answer = call("check", spec, tmp_path / "a.mcap")
    assert (answer.code, answer.err.count("\n")) == (2, 1)
    assert reason in answer.err


def test_info_names_wheels_steering_and_receivers(tmp_path: Path, call: Call) -> None:
    joints = call("info", write_robot(tmp_path, drive_wheels(rows=3)))
    assert "joints on /joint_states (sensor_msgs/msg/JointState)" in joints.flat
    assert "joints give poses with --wheel-joints LEFT,RIGHT --wheels RADIUS,TRACK" in joints.flat
    said = [say_steering(row, stamped=True) for row in range(3)]
    steering = call("info", write_robot(tmp_path, say_odometry(), said))
    assert "steering gives turn rates with --wheelbase L" in steering.flat
    alone = call("info", write_robot(tmp_path, said))
    assert "steering gives turn rates with --wheelbase L" in alone.flat
    receiver = call("info", write_robot(tmp_path, say_drive()))
    assert "heading the course over 0.5 m" in receiver.flat
    assert "origin x is east and y north of 48.0000000 deg" in receiver.flat


@pytest.mark.parametrize(
    ("kinds", "unused"),
    [
        ("steering", None),
        ("twists", "--wheelbase is not used: the commands on /cmd_vel (geometry_msgs/msg/Twist)"),
        ("none", "--wheelbase is not used: no commands were read"),
    ],
)
def test_a_wheelbase_without_steering_is_reported(
    call: Call, tmp_path: Path, kinds: str, unused: str | None
) -> None:
    said = {
        "steering": [say_steering(row, stamped=True) for row in range(5)],
        "twists": [say_twist(0.1, row=row) for row in range(5)],
        "none": [],
    }
    bag = write_robot(tmp_path, say_odometry(count=5), said[kinds])
    answer = call("metrics", bag, "--wheelbase", "0.3")
    assert answer.code == 0
    assert ("not used" in answer.err) == (unused is not None)
    assert (unused or "") in answer.err
    (described,) = call("info", bag, "--wheelbase", "0.3", "--json").json
    assert described["notes"].get("unused", "").startswith(unused or "")


def test_options_for_bags_are_reported_beside_other_files(call: Call, tmp_path: Path) -> None:
    run = tl.simulate_run(tl.load_scenario("paper-kp4"))
    tl.log.write_recording(run, tmp_path / "kp4.mcap")
    tl.log.export_csv(run, tmp_path / "kp4.csv", table="poses")
    asked = {"wheelbase": 0.3, "time": "log"}
    own = tl.read_run(tmp_path / "kp4.mcap", **asked)  # type: ignore[arg-type]
    expected = "--time and --wheelbase are not used: this is a turtlelog recording"
    assert own.notes["unused"] == expected
    assert tl.read_run(tmp_path / "kp4.csv", pose_topic="/odom").notes["unused"] == (
        "--pose-topic is not used: this is a table"
    )
    # Another reading of the same file may use them: no recording keeps the note.
    tl.log.write_recording(own, tmp_path / "again.mcap")
    assert "unused" not in tl.read_run(tmp_path / "again.mcap").notes
    answer = call("info", tmp_path / "kp4.mcap", "--wheelbase", "0.3").flat
    assert "--wheelbase is not used: this is a turtlelog recording" in answer
