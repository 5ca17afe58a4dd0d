import math
from dataclasses import replace
from pathlib import Path

import pytest

from tests.cli.conftest import Call, call as call
from tests.log.ros2.bags import START_NS
from tests.log.ros2.robots import say_goal, say_odometry, say_path, say_transform, turn, write_robot
from turtlelog import measure_run
from turtlelog.errors import LogError
from turtlelog.log import read_run, write_recording
from turtlelog.run import Run

PLAN = ((0.0, 0.0), (1.0, 0.5), (1.0, 0.5), (2.0, 0.0))


def read(folder: Path, *messages: object, **options: object) -> Run:
    return read_run(write_robot(folder, *messages), **options)  # type: ignore[arg-type]


def test_a_goal_gives_along_and_cross_track_and_errors(tmp_path: Path) -> None:
    run = read(tmp_path, say_odometry(), say_goal(2.0, 1.0, by=turn(0.5)))
    assert run.goal_xy_m == (2.0, 1.0)
    assert run.goal_heading_rad == pytest.approx(0.5)
    assert "goal_xy_m" not in run.absent
    metrics = measure_run(run)
    assert metrics["final.position_error"].value == pytest.approx(1.0)
    assert metrics["final.heading_error"].value == pytest.approx(math.degrees(0.5))
    # The line leads from (0, 0) to (2, 1); the robot ends at (2, 0), to the right of it.
    assert metrics["final.cross_track"].value == pytest.approx(-2.0 / math.sqrt(5.0))
    assert run.notes["goal"] == "from /goal_pose"


def test_a_goal_with_the_default_orientation_asks_for_no_heading(tmp_path: Path) -> None:
    run = read(tmp_path, say_odometry(), say_goal(2.0, 1.0))
    assert (run.goal_heading_rad, run.notes["goal"]) == (None, "from /goal_pose, no heading")
    assert measure_run(run)["final.heading_error"].value is None


def test_of_several_goals_the_last_before_the_end_counts(tmp_path: Path) -> None:
    goals = [say_goal(x, 0.0, at_s=at_s) for x, at_s in ((1, 0), (1, 0.1), (5, 1), (9, 2.5))]
    run = read(tmp_path, say_odometry(), goals)
    assert run.goal_xy_m == (5.0, 0.0)
    assert run.notes["goal"].startswith("the last of 2 from /goal_pose: --goal chooses another")


def test_other_poses_in_the_frame_of_a_goal_are_offered(tmp_path: Path) -> None:
    goal = say_goal(0.0, 3.0, frame="map", at_s=1.0)
    for frame in ("map", "world"):
        run = read(tmp_path, say_odometry(), say_odometry("/other/odom_map", frame=frame), goal)
        option = ": --pose-topic /other/odom_map takes poses in its frame"
        assert run.notes["goal"].endswith(option) == (frame == "map")
    assert read(
        tmp_path,
        say_odometry(),
        say_odometry("/other/odom_map", frame="map"),
        goal,
        pose_topic="/other/odom_map",
    ).goal_xy_m == (0.0, 3.0)


def test_a_goal_that_is_asked_for_takes_the_place_of_the_bags(tmp_path: Path) -> None:
    run = read(tmp_path, say_odometry(), say_goal(2.0, 1.0), goal=(7.0, 8.0, 0.25))
    assert (run.goal_xy_m, run.goal_heading_rad) == ((7.0, 8.0), 0.25)
    assert run.notes["goal"] == "as given"
    with pytest.raises(LogError, match=r"goal: expected x, y .* found \(1.0,\)"):
        read(tmp_path, say_odometry(), goal=(1.0,))


def test_a_goal_of_another_frame_is_brought_over_or_left_out(tmp_path: Path) -> None:
    goal = say_goal(0.0, 3.0, frame="map", by=turn(math.pi / 2), at_s=1.0)
    lost = read(tmp_path, say_odometry(), goal)
    assert lost.goal_xy_m is None
    assert "it is in map, the poses in odom, and no transform joins" in lost.notes["goal"]
    correction = say_transform("map", "odom", 0.0, 1.0, by=turn(math.pi / 2))
    run = read(tmp_path, say_odometry(), goal, correction)
    # Two metres ahead of odom's origin, which looks along +y of map.
    assert run.goal_xy_m == pytest.approx((2.0, 0.0))
    assert run.goal_heading_rad == pytest.approx(0.0)
    assert "brought from map to odom" in run.notes["goal"]
    late = say_transform("map", "odom", 0.0, 1.0, at_s=1.5)
    later = say_transform("map", "odom", 0.0, 2.0, at_s=1.6)
    assert read(tmp_path, say_odometry(), goal, late, later).goal_xy_m is None


def test_a_plan_is_the_path_without_repeated_points(tmp_path: Path) -> None:
    run = read(tmp_path, say_odometry(count=21, step_m=0.1), say_path(*PLAN))
    assert run.path is not None
    assert run.path.points == (PLAN[0], PLAN[1], PLAN[3])
    assert run.notes["path_topic"] == "/plan (nav_msgs/msg/Path)"
    assert run.notes["path"] == "from /plan, 3 of its 4 points"
    assert measure_run(run)["run.cross_track_max"].value == pytest.approx(1 / math.sqrt(5.0))


def test_the_first_plan_with_a_length_after_the_goal_counts(tmp_path: Path) -> None:
    paths = [
        say_path((0.0, 0.0), (0.0, 9.0)),
        say_path(at_s=1.0),
        say_path((1.0, 0.0), (8.0, 0.0), at_s=1.1),
        say_path((2.0, 0.0), (8.0, 0.0), at_s=2.0),
    ]
    run = read(tmp_path, say_odometry(), say_goal(8.0, 0.0, at_s=1.0), paths)
    assert run.path is not None
    assert run.path.points == ((1.0, 0.0), (8.0, 0.0))
    assert run.notes["path"] == "plan 2 of 3 from /plan"


def test_each_goal_is_measured_against_its_own_plan(tmp_path: Path, call: Call) -> None:
    # East until 10 s, with a plan and its goal; then the same for the way back.
    paths = [
        say_path((0.0, 0.0), (1.0, 0.0), at_s=0.6),
        say_path((1.0, 1.0), (0.0, 1.0), at_s=11.0),
        say_path((0.9, 1.0), (0.0, 1.0), at_s=12.0),
    ]
    goals = [say_goal(1.0, 0.0, at_s=0.5), say_goal(0.0, 1.0, at_s=11.0)]
    again = say_goal(0.0, 1.0, at_s=13.0)
    there = say_odometry(count=11, step_m=0.1)
    back = [replace(one, time_ns=one.time_ns + 11 * 10**9) for one in say_odometry(count=31)]
    for row, one in enumerate(back):
        one.values["pose"]["pose"]["position"] |= {"x": max(1.0 - 0.1 * row, 0.0), "y": 1.0}
    file = write_robot(tmp_path, there, back, paths, [*goals, again])
    run = read_run(file)
    assert (run.goal_xy_m, run.goal_row, run.path_row) == ((0.0, 1.0), 11, 11)
    assert run.notes["path"] == "plan 2 of 3 from /plan"
    metrics = measure_run(run)
    assert metrics["run.cross_track_max"].value == pytest.approx(0.0)
    assert metrics["run.cross_track_rms"].value == pytest.approx(0.0)
    assert metrics["run.time_to_goal"].value == pytest.approx(9.8)
    assert metrics["run.time_to_goal"].at_s == pytest.approx(20.8)
    said = "the goal given at 11.0 s and the path given at 11.0 s."
    assert said in call("metrics", file).flat
    # Without a topic of goals, the last plans that end at one place are those to the last goal.
    alone = read_run(write_robot(tmp_path, there, back, paths))
    assert alone.path_row == 11
    assert measure_run(alone)["run.cross_track_max"].value == pytest.approx(0.0)


@pytest.mark.parametrize(("apart_m", "row"), [(0.45, 1), (0.55, 3)])
def test_plans_that_end_within_nav2s_tolerance_lead_to_one_goal(
    apart_m: float, row: int, tmp_path: Path
) -> None:
    paths = [
        say_path((0.0, 0.0), (9.0, 0.0), at_s=1.0),
        say_path((0.0, 0.0), (9.0 + apart_m, 0.0), at_s=3.0),
    ]
    assert read(tmp_path, say_odometry(count=9), paths).path_row == row


def test_the_robots_own_trace_is_no_reference(tmp_path: Path) -> None:
    traces = [say_path(*((float(x), 0.0) for x in range(k + 1)), at_s=k) for k in range(1, 6)]
    run = read(tmp_path, say_odometry(count=6), traces)
    assert run.path is None
    assert run.notes["path"] == "/plan: left out: it ends where the robot is, and is its trace"


@pytest.mark.parametrize(("behind_m", "is_trace"), [(0.09, True), (0.11, False)])
def test_a_trace_ends_within_a_robots_width(
    behind_m: float, *, is_trace: bool, tmp_path: Path
) -> None:
    path = say_path((0.5, 0.0), (1.0 - behind_m, 0.0), at_s=1.0)
    assert (read(tmp_path, say_odometry(), path).path is None) == is_trace


@pytest.mark.parametrize(("off_m", "is_trace"), [(0.09, False), (0.11, True)])
def test_plans_after_the_arrival_do_not_make_the_others_a_trace(
    off_m: float, *, is_trace: bool, tmp_path: Path
) -> None:
    plans = [say_path((float(x), 0.0), (5.0, 0.0), at_s=x) for x in (0, 1, 2)]
    last = [say_path((5.0, -off_m), (5.0, -0.01), at_s=5.0 + k / 20) for k in range(9)]
    odometry = say_odometry(count=6)
    odometry.append(replace(odometry[-1], time_ns=round(6e9)))
    run = read(tmp_path, odometry, plans, last)
    assert (run.path is None) == is_trace
    assert is_trace or run.notes["path"].startswith("the first plan of ")


@pytest.mark.parametrize(("size_m", "is_trace"), [(0.27, True), (0.28, False)])
def test_a_lap_is_a_plan_if_the_robot_has_not_driven_it(
    size_m: float, *, is_trace: bool, tmp_path: Path
) -> None:
    # After 1 m. A lap of 1.11 m is longer by a tenth of its length.
    x_m = 1.0 - size_m
    lap = say_path((1.0, 0.0), (1.0, size_m), (x_m, size_m), (x_m, 0.0), (1.0, 0.0), at_s=1.0)
    file = write_robot(tmp_path, say_odometry(), lap)
    run, asked = read_run(file), read_run(file, path_topic="/plan")
    assert (run.path is None, asked.path is None) == (is_trace, False)
    assert ("as a trace does" in asked.notes["path"]) == is_trace


def test_paths_that_are_no_reference_say_why(tmp_path: Path) -> None:
    back = say_path((0.0, 0.0), (5.0, 0.0), (1.0, 0.0))
    assert "a turn of 180 deg" in read(tmp_path, say_odometry(), back).notes["path"]
    far = say_path(*PLAN, frame="map")
    assert "it is in map, the poses in odom" in read(tmp_path, say_odometry(), far).notes["path"]
    local = read(tmp_path, say_odometry(), say_path(*PLAN, topic="/local_plan"))
    assert (local.path, "path" in local.notes) == (None, False)
    asked = read(
        tmp_path, say_odometry(), say_path(*PLAN, topic="/local_plan"), path_topic="/local_plan"
    )
    assert asked.path is not None


@pytest.mark.parametrize("count", [1000, 1001])
def test_very_many_paths_are_read_only_where_they_are_asked_for(count: int, tmp_path: Path) -> None:
    paths = [replace(say_path(PLAN[0], PLAN[3]), time_ns=START_NS + k) for k in range(count)]
    file = write_robot(tmp_path, say_odometry(), paths)
    run = read_run(file)
    assert (run.path is None) == (count > 1000)
    if count > 1000:
        expected = "/plan: left out: 1001 messages, more than 1000: --path-topic reads them"
        assert run.notes["path"] == expected
        assert read_run(file, path_topic="/plan").path is not None


def test_goal_and_path_stay_in_a_recording_made_of_a_bag(tmp_path: Path) -> None:
    run = read(tmp_path, say_odometry(), say_goal(2.0, 1.0, by=turn(0.5)), say_path(*PLAN))
    path = tmp_path / "own.mcap"
    write_recording(run, path)
    again = read_run(path)
    assert (again.goal_xy_m, again.goal_heading_rad) == (run.goal_xy_m, run.goal_heading_rad)
    assert again.path == run.path
    assert "chosen" in run.notes
    assert "chosen" not in again.notes


def test_a_goal_is_asked_of_a_recording_made_of_a_bag_but_not_of_a_controllers(
    tmp_path: Path,
) -> None:
    path = tmp_path / "own.mcap"
    write_recording(read(tmp_path, say_odometry()), path)
    assert read_run(path, goal=(3.0, 4.0)).goal_xy_m == (3.0, 4.0)
