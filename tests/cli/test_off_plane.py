"""Robots that leave the plane: their heights, their tilts, and headings near the vertical."""

import math
from pathlib import Path

import numpy as np
import pytest

import turtlelog as tl
from tests.cli.conftest import Call
from tests.log.ros2.bags import START_NS, Said, make_vector
from tests.log.ros2.robots import Turn, describe_head, describe_place, write_robot

STEP_NS = 50_000_000


def pitch(angle_rad: float) -> Turn:
    return (0.0, math.sin(angle_rad / 2.0), 0.0, math.cos(angle_rad / 2.0))


def say_pose(row: int, x_m: float, z_m: float, by: Turn = (0.0, 0.0, 0.0, 1.0)) -> Said:
    values = {"header": describe_head("map"), "pose": describe_place(x_m, 0.0, by, z_m)}
    kind = "geometry_msgs/msg/PoseStamped"
    return Said(topic="/pose", type=kind, values=values, time_ns=START_NS + row * STEP_NS)


def climb(rows: int = 101) -> list[Said]:
    """Return a robot that drives 4 m up a ramp of 3 in 4, nose up."""
    by = pitch(-math.atan2(3.0, 4.0))
    return [say_pose(row, 0.04 * row, 1.0 + 0.03 * row, by) for row in range(rows)]


def test_a_climb_is_measured_in_space(call: Call, tmp_path: Path) -> None:
    bag = write_robot(tmp_path, climb())
    found = tl.measure_run(tl.read_run(bag))
    assert found["run.path_length"].value == pytest.approx(4.0)
    assert found["run.path_length_in_space"].value == pytest.approx(5.0)
    assert found["run.height_range"].value == pytest.approx(3.0)
    assert found["run.tilt_max"].value == pytest.approx(math.degrees(math.atan2(3.0, 4.0)))
    told = call("info", bag).flat
    assert "its height varies by 3 m (1 to 4 m) and it tilts by 36.9 deg" in told
    assert "path length in space 5 m" in call("metrics", bag).flat


def test_a_drone_that_only_climbs_is_no_odometry_of_zeros(call: Call, tmp_path: Path) -> None:
    twist = {"linear": make_vector(1.0), "angular": make_vector()}
    said = [
        Said(
            topic="/odom",
            type="nav_msgs/msg/Odometry",
            time_ns=START_NS + row * STEP_NS,
            values={
                "header": describe_head("map"),
                "child_frame_id": "base_link",
                "pose": {
                    "pose": describe_place(0.0, 0.0, (0.0, 0.0, 0.0, 1.0), 0.05 * row),
                    "covariance": [0.0] * 36,
                },
                "twist": {"twist": twist, "covariance": [0.0] * 36},
            },
        )
        for row in range(100)
    ]
    told = call("info", write_robot(tmp_path, said)).flat
    assert "its height varies by 4.95 m" in told
    assert "never move" not in told


def test_a_robot_in_the_plane_has_no_metrics_in_space(call: Call, tmp_path: Path) -> None:
    bag = write_robot(tmp_path, [say_pose(row, 0.04 * row, 0.04 * (row % 2)) for row in range(50)])
    run = tl.read_run(bag)
    assert run.poses.height_m is None
    metric = tl.measure_run(run)["run.path_length_in_space"]
    assert metric.status == "absent"
    assert metric.reason == "the robot stays in the plane, or its poses have no height"
    assert "in space" not in call("metrics", bag).out


@pytest.mark.parametrize(("height_m", "is_told"), [(0.051, True), (-1.5, True), (0.049, False)])
def test_the_height_of_a_plane_is_left_out_and_that_is_said(
    call: Call, tmp_path: Path, height_m: float, *, is_told: bool
) -> None:
    bag = write_robot(tmp_path, [say_pose(row, 0.04 * row, height_m) for row in range(50)])
    told = call("convert", bag, "-o", tmp_path / "o.mcap").flat
    line = f"height: the poses are at a height of {height_m:.3g} m, which is left out"
    assert (line in told) is is_told


@pytest.mark.parametrize(("pitch_deg", "count"), [(84.9, 21), (85.1, 20), (-90.0, 20)])
def test_a_forward_axis_near_the_vertical_tells_no_heading(
    call: Call, tmp_path: Path, pitch_deg: float, count: int
) -> None:
    said = [say_pose(row, 0.1 * row, 0.0) for row in range(20)]
    bag = write_robot(tmp_path, said, say_pose(20, 2.0, 0.0, pitch(math.radians(pitch_deg))))
    run = tl.read_run(bag)
    assert len(run.poses) == count
    assert run.poses.heading_rad == pytest.approx(0.0)
    words = "left out: 1 pose has no heading, as the forward axis points up or down"
    assert (words in call("info", bag).flat) == (count == 20)


def test_a_bag_of_nothing_but_a_vertical_axis_is_refused(tmp_path: Path) -> None:
    said = [say_pose(row, 0.1 * row, 0.0, pitch(math.pi / 2.0)) for row in range(5)]
    with pytest.raises(
        tl.errors.LogError, match="the forward axis points up or down in all 5 poses"
    ):
        tl.read_run(write_robot(tmp_path, said))


def test_convert_keeps_heights_in_tables_and_says_where_not(
    call: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = write_robot(tmp_path, climb())
    monkeypatch.chdir(tmp_path)
    table = call("convert", bag, "-o", "poses.csv")
    assert "without height" not in table.flat
    back = tl.read_run("poses.csv")
    assert back.poses.height_m is not None
    assert np.ptp(back.poses.height_m) == pytest.approx(3.0)
    told = call("convert", bag, "-o", "run.mcap")
    assert told.code == 0
    assert "run.mcap holds x, y and heading alone, without height and tilt" in told.flat
    assert tl.read_run("run.mcap").poses.height_m is None


def test_python_writes_a_recording_of_the_plane_alone(tmp_path: Path) -> None:
    run = tl.read_run(write_robot(tmp_path, climb()))
    part = run.slice(1.0, 2.0)
    assert part.poses.height_m is not None
    assert len(part.poses.height_m) == len(part.poses) == 21
    assert run.to_arrow().column_names[-2:] == ["height_m", "tilt_rad"]


def test_a_format_without_heights_is_not_called_equal(call: Call, tmp_path: Path) -> None:
    bag = write_robot(tmp_path, climb())
    for name, lost in (("a.tum", " without height and tilt"), ("a.csv", "")):
        answer = call("convert", bag, "-o", tmp_path / name)
        assert answer.out.startswith(f"{name}: 101 poses of ")
        assert f"{lost}, read back and equal." in answer.flat
        assert ("without height and tilt, read" in answer.flat) == bool(lost)
