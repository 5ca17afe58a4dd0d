"""What a bag's poses contradict: reported speeds and turn rates, units, constant orientations."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import turtlelog as tl
from tests.cli.conftest import Call, call as call
from tests.cli.test_commands_alone import say_twist
from tests.log.ros2.bags import START_NS, Said, make_vector
from tests.log.ros2.robots import describe_head, describe_place, turn, write_robot
from tests.log.runs import find_shared
from turtlelog.log.planar_poses import describe_small_leaps
from turtlelog.log.ros2.reported_motion import (
    LATERAL,
    SPEED,
    describe_paths,
    measure_paths,
)

Values = NDArray[np.float64]
COUNT, HZ = 401, 20.0
TIME_NS = (np.arange(COUNT) * 1e9 / HZ).astype(np.int64)


def drive(speed: float = 0.5, *, reported: float = 0.5) -> dict[str, Values]:
    """Return 20 s of a robot that goes straight ahead, and what it reports."""
    return {
        "x": speed * TIME_NS / 1e9,
        "y": np.zeros(COUNT),
        SPEED: np.full(COUNT, reported),
    }


def tell(columns: dict[str, Values], commanded: float | None = None) -> str | None:
    speeds = None if commanded is None else (TIME_NS, np.full(COUNT, commanded))
    return describe_paths(measure_paths(TIME_NS, columns, speeds))


def say_odometry(
    xy_m: Values, *, speed: float, topic: str = "/odom", hz: float = HZ, first_s: float = 0.0
) -> list[Said]:
    twist = {"linear": make_vector(speed), "angular": make_vector()}
    return [
        Said(
            topic=topic,
            type="nav_msgs/msg/Odometry",
            time_ns=START_NS + round((first_s + row / hz) * 1e9),
            sequence=row,
            values={
                "header": describe_head("odom"),
                "child_frame_id": "base_link",
                "pose": {
                    "pose": describe_place(float(x), float(y), turn(0.0)),
                    "covariance": [0.0] * 36,
                },
                "twist": {"twist": twist, "covariance": [0.0] * 36},
            },
        )
        for row, (x, y) in enumerate(xy_m)
    ]


def straight(speed: float, count: int = 201, hz: float = HZ) -> Values:
    return np.column_stack([speed * np.arange(count) / hz, np.zeros(count)])


@pytest.mark.parametrize(("reported", "is_said"), [(0.41, False), (0.39, True), (0.65, True)])
def test_paths_that_differ_by_a_fifth_are_said(reported: float, *, is_said: bool) -> None:
    told = tell(drive(reported=reported))
    assert (told is not None) == is_said
    if told is not None:
        assert told.startswith(f"the path is 10 m by the poses and {20 * reported:g} m by the")
        assert told.endswith("nothing tells which is wrong")


def test_a_short_way_is_not_judged() -> None:
    assert tell(drive(0.02, reported=0.01)) is None
    assert tell(drive(0.03, reported=0.01)) is not None


@pytest.mark.parametrize(("lasts_s", "is_said"), [(0.19, False), (0.21, True)])
def test_poses_that_share_a_time_are_not_blamed(lasts_s: float, *, is_said: bool) -> None:
    time_ns = np.linspace(0, lasts_s * 1e9, COUNT).astype(np.int64)
    assert (describe_paths(measure_paths(time_ns, drive())) is not None) == is_said


def test_a_robot_that_drives_sideways_reports_both_speeds() -> None:
    assert tell(drive(reported=0.3) | {LATERAL: np.full(COUNT, 0.4)}) is None


def test_an_odometry_of_zeros_is_more_likely_wrong_than_its_speed() -> None:
    assert tell(drive(0.0)) == (
        "the poses never move, and are likely wrong: the reported speed drives 10 m"
    )
    told = tell(drive(0.0, reported=0.0), commanded=0.5)
    assert told is not None
    assert told.startswith("the poses never move though commands ask for 10 m")
    assert tell(drive(0.0, reported=0.0)) is None


def test_jumps_are_blamed_for_what_they_add() -> None:
    columns = drive()
    columns["y"][100:] += 3.0
    columns["y"][200:] -= 2.0
    told = tell(columns)
    assert told is not None
    assert told.endswith("the poses are more likely wrong, whose jumps add 4.95 m")


def test_noise_from_pose_to_pose_is_blamed() -> None:
    columns = drive()
    columns["y"] += np.random.default_rng(0).normal(0.0, 0.02, COUNT)
    told = tell(columns)
    assert told is not None
    assert "the poses are more likely wrong from one to the next, where they scatter" in told


@pytest.mark.parametrize("drift", [0.0, 0.05])
def test_noise_of_a_robot_that_stays_contradicts_no_speed(drift: float) -> None:
    columns = drive(drift, reported=0.0)
    columns["y"] += np.random.default_rng(0).normal(0.0, 0.003, COUNT)
    assert (tell(columns) is not None) == (drift > 0.0)


@pytest.mark.parametrize(
    ("commanded", "wrong"),
    [
        (0.5, "the reported speed is more likely wrong"),
        (
            1.0,
            "the poses are wrong, the wheels slip, or the reported speed is 2 times the true one;"
            " commands ask for 20 m",
        ),
        (0.74, "nothing tells"),
    ],
)
def test_commands_tell_which_of_two_paths_is_likely_wrong(commanded: float, wrong: str) -> None:
    told = tell(drive(0.5, reported=1.0), commanded=commanded)
    assert told is not None
    assert told.partition(": ")[2].startswith(wrong)


def test_other_poses_are_offered_where_the_poses_may_be_wrong() -> None:
    for speed, commanded, is_offered in ((1.0, 0.5, False), (1.0, 1.0, True), (1.0, None, True)):
        held = None if commanded is None else (TIME_NS, np.full(COUNT, commanded))
        paths = measure_paths(TIME_NS, drive(reported=speed), held)
        told = describe_paths(paths, "/amcl_pose")
        assert told is not None
        assert told.endswith("; others: /amcl_pose") == is_offered


def test_real_robots_agree_with_themselves() -> None:
    for name in ("tb3", "neato_wall", "sim_time"):
        assert "path_by_speed" not in tl.read_run(find_shared("robots", name)).notes


def test_of_two_odometries_that_which_moves_is_read(call: Call, tmp_path: Path) -> None:
    still, moving = straight(0.0), straight(0.5)
    bag = write_robot(
        tmp_path,
        say_odometry(still, speed=0.0),
        say_odometry(moving, speed=0.5, topic="/wheel/odometry"),
    )
    told = call("info", bag).flat
    assert "poses /wheel/odometry, 20 Hz, 201 messages" in told
    assert "still /odom never moves and was left out" in told
    assert "poses from /wheel/odometry" in call("metrics", bag).err
    assert not tl.read_run(f"{bag}:/odom").poses.xy_m.any()
    both = write_robot(
        tmp_path,
        say_odometry(still, speed=0.0),
        say_odometry(still, speed=0.0, topic="/wheel/odometry"),
    )
    assert tl.read_run(both).notes["pose_topic"].startswith("/odom ")


def test_a_bag_says_that_its_poses_never_move_and_where_others_are(
    call: Call, tmp_path: Path
) -> None:
    commands = [say_twist(0.5, row=row) for row in range(200)]
    bag = write_robot(tmp_path, say_odometry(straight(0.0), speed=0.5), commands)
    told = call("info", bag).flat
    assert "path by speed the poses never move, and are likely wrong: the reported speed" in told
    answer = call("metrics", bag)
    assert "path by speed: the poses never move" in answer.err
    assert "the robot reports, and the poses contradict them." in answer.flat


def test_poses_that_never_move_agree_with_a_reported_speed_of_0(call: Call, tmp_path: Path) -> None:
    commands = [say_twist(0.5, row=row) for row in range(200)]
    bag = write_robot(tmp_path, say_odometry(straight(0.0), speed=0.0), commands)
    answer = call("metrics", bag)
    assert "path by speed: the poses never move though commands ask" in answer.err
    assert "Measured rates are those that the robot reports. " in answer.flat


@pytest.mark.parametrize("off_m", [0.02, 0.04])
@pytest.mark.parametrize("share", [2, 3])
def test_two_programs_a_few_centimetres_apart_are_said(
    call: Call, tmp_path: Path, off_m: float, share: int
) -> None:
    xy_m = straight(0.5) + np.random.default_rng(0).normal(0.0, 0.001, (201, 2))
    xy_m[::share] += [0.6 * off_m, 0.8 * off_m]
    told = call("info", write_robot(tmp_path, say_odometry(xy_m, speed=0.5))).flat
    assert "two programs seem to publish them; a reported speed is more likely right" in told


def test_messages_recorded_twice_are_no_second_program() -> None:
    assert describe_small_leaps(np.repeat(straight(0.3, 400), 2, axis=0)) is None


@pytest.mark.parametrize("size_m", [0.001, 0.01, 0.1])
@pytest.mark.parametrize("kind", ["normal", "laplace", "lateral", "grid"])
def test_noise_and_rounding_are_no_second_program(kind: str, size_m: float) -> None:
    random = np.random.default_rng(4)
    xy_m = straight(0.3, 2000)
    if kind == "grid":
        noise_m = random.normal(0.0, size_m / 4.0, xy_m.shape)
        assert describe_small_leaps(np.round((xy_m + noise_m) / size_m) * size_m) is None
        assert describe_small_leaps(np.round(noise_m / size_m) * size_m) is None
        return
    noise_m = (random.laplace if kind == "laplace" else random.normal)(0.0, size_m, xy_m.shape)
    noise_m[:, 0] *= kind != "lateral"
    assert describe_small_leaps(xy_m + noise_m) is None


def test_a_step_apart_of_less_than_a_centimetre_is_not_judged() -> None:
    xy_m = straight(0.5)
    for off_m, is_said in ((0.0094, False), (0.0106, True)):
        apart_m = xy_m.copy()
        apart_m[::2, 1] += off_m
        assert (describe_small_leaps(apart_m) is not None) == is_said


def arc(turned_rad: float, noise_m: float = 0.0) -> Values:
    """Return 20 s along an arc at 0.5 m/s that begins along +x."""
    angle_rad = np.linspace(0.0, turned_rad, 401)
    radius_m = 10.0 / turned_rad
    xy_m = radius_m * np.column_stack([np.sin(angle_rad), 1.0 - np.cos(angle_rad)])
    return xy_m + np.random.default_rng(0).normal(0.0, noise_m, xy_m.shape)


@pytest.mark.parametrize(("turned_rad", "is_course"), [(0.46, False), (0.58, True), (3.0, True)])
def test_courses_stand_for_an_orientation_that_never_changes_on_a_curve(
    turned_rad: float, tmp_path: Path, *, is_course: bool
) -> None:
    # Courses are held over the first and last quarter of a metre of ten.
    run = tl.read_run(write_robot(tmp_path, say_odometry(arc(turned_rad), speed=0.0)))
    assert run.origin.has_courses == is_course
    assert ("the orientation never changes" in run.notes.get("heading", "")) == is_course
    turned = run.poses.heading_rad[-1] - run.poses.heading_rad[0]
    assert turned == pytest.approx(0.95 * turned_rad if is_course else 0.0, abs=0.02)


def test_single_outliers_turn_no_course(tmp_path: Path) -> None:
    xy_m = arc(3.0)
    xy_m[50:400:50] += 4.0
    poses = tl.read_run(write_robot(tmp_path, say_odometry(xy_m, speed=0.0))).poses
    turned_rad = np.abs(np.diff(np.unwrap(poses.heading_rad))).sum()
    assert turned_rad == pytest.approx(2.85, abs=0.3)  # each outlier would turn the course by pi


def test_a_robot_that_moves_to_the_side_keeps_its_orientation(tmp_path: Path) -> None:
    said = say_odometry(arc(3.0), speed=0.5)
    for one in said:
        one.values["twist"]["twist"]["linear"] = make_vector(0.5, 0.1)
    run = tl.read_run(write_robot(tmp_path, said))
    assert not run.poses.heading_rad.any()
    assert not run.origin.has_courses


def say_staircase(ahead_share: float = 1.0, topic: str = "/odom") -> list[Said]:
    """Return odometry ahead and to the left in turns, at 0.5 m/s and a constant orientation.

    The reported speed is between the way along the path (a share of 0) and that ahead (1).
    """
    ways = [(0.5, 0.0) if row // 60 % 2 == 0 else (0.0, 0.5) for row in range(COUNT)]
    xy_m = np.cumsum(np.array(ways), axis=0) / HZ
    said = say_odometry(xy_m, speed=0.0, topic=topic)
    for one, (ahead, _) in zip(said, ways, strict=True):
        speed = ahead_share * ahead + (1.0 - ahead_share) * 0.5
        one.values["twist"]["twist"] = {"linear": make_vector(speed), "angular": make_vector()}
    return said


@pytest.mark.parametrize(("ahead_share", "is_course"), [(1.0, False), (0.8, False), (0.7, True)])
def test_a_speed_reported_along_the_orientation_keeps_it(
    ahead_share: float, tmp_path: Path, *, is_course: bool
) -> None:
    run = tl.read_run(write_robot(tmp_path, say_staircase(ahead_share)))
    assert run.origin.has_courses == is_course
    assert run.poses.heading_rad.any() == is_course


@pytest.mark.parametrize(
    ("topic", "aside", "is_course"),
    [
        ("/odom", 0.5, False),
        ("/odom", 0.0, True),
        ("/odom", math.nan, True),
        ("/robot2/odom", 0.5, True),
    ],
)
def test_other_odometry_that_reports_a_speed_to_the_side_keeps_the_orientation(
    topic: str, aside: float, tmp_path: Path, *, is_course: bool
) -> None:
    odometry = say_staircase(topic=topic)
    places = [one.values["pose"]["pose"]["position"] for one in odometry]
    poses = [
        replace(say_pose([at["x"], at["y"]], 0.0, row), topic="/robot1/pose")
        for row, at in enumerate(places)
    ]
    for one in odometry:
        one.values["twist"]["twist"]["linear"] = make_vector(0.0, aside)
    run = tl.read_run(write_robot(tmp_path, poses, odometry), pose_topic="/robot1/pose")
    assert run.origin.has_courses == is_course


def say_pose(xy_m: list[float], theta: float, row: int) -> Said:
    return Said(
        topic="/pose",
        type="geometry_msgs/msg/Pose2D",
        time_ns=START_NS + round(row / HZ * 1e9),
        sequence=row,
        values={"x": xy_m[0], "y": xy_m[1], "theta": theta},
    )


@pytest.mark.parametrize("unit", ["deg", "rad"])
def test_angles_of_a_bag_are_in_degrees_where_the_travel_shows_it(
    unit: str, tmp_path: Path
) -> None:
    theta = np.linspace(0.0, 3.0, 401)
    given = np.degrees(theta) if unit == "deg" else theta
    rows = zip(arc(3.0).tolist(), given.tolist(), strict=True)
    said = [say_pose(xy, angle, row) for row, (xy, angle) in enumerate(rows)]
    run = tl.read_run(write_robot(tmp_path, said))
    assert run.poses.heading_rad == pytest.approx(theta)
    assert ("in degrees" in run.notes.get("heading", "")) == (unit == "deg")


@pytest.mark.parametrize(("speed", "is_told"), [(99.0, False), (101.0, True)])
def test_positions_of_a_bag_that_may_be_in_mm_are_told(
    speed: float, tmp_path: Path, *, is_told: bool
) -> None:
    notes = tl.read_run(write_robot(tmp_path, say_odometry(straight(speed), speed=speed))).notes
    told = "x and y are read in m, so 101 m/s is usual; they may be in mm"
    assert notes.get("unlikely_units") == (told if is_told else None)


@pytest.mark.parametrize(
    ("scale", "told"),
    [(1.19, ""), (1.21, "1.21 times"), (57.3, "57.3 times that of the headings, which fits deg/s")],
)
def test_reported_turn_rates_of_a_bag_that_its_headings_contradict_are_told(
    scale: float, told: str, tmp_path: Path
) -> None:
    said = say_odometry(straight(0.0, 201), speed=0.0)
    for row, one in enumerate(said):
        one.values["pose"]["pose"] = describe_place(0.0, 0.0, turn(0.3 * row / HZ))
        rate = -140.0 if row == 100 else 0.3 * scale  # one fault is no unit
        one.values["twist"]["twist"] = {
            "linear": make_vector(),
            "angular": make_vector(z=rate),
        }
    notes = tl.read_run(write_robot(tmp_path, said)).notes
    assert told in notes.get("turning_by_rate", "")
    assert ("turning_by_rate" in notes) == bool(told)


@pytest.mark.parametrize(("scale", "is_told"), [(1.0, False), (1.5, True)])
def test_noise_of_headings_contradicts_no_turn_rate(
    scale: float, tmp_path: Path, *, is_told: bool
) -> None:
    """Noise makes the turns of the headings longer than those of the robot."""
    said, noise = say_odometry(straight(0.0, 401), speed=0.0), np.random.default_rng(2)
    heading_rad = 0.0
    for row, one in enumerate(said):
        rate = 0.1 * (row // 40 % 2)  # it turns for 2 s, and rests for 2 s
        heading_rad += rate / HZ
        shown_rad = heading_rad + float(noise.normal(0.0, 0.05))
        one.values["pose"]["pose"] = describe_place(0.0, 0.0, turn(shown_rad))
        one.values["twist"]["twist"] = {
            "linear": make_vector(),
            "angular": make_vector(z=scale * rate),
        }
    notes = tl.read_run(write_robot(tmp_path, said)).notes
    assert ("turning_by_rate" in notes) is is_told
