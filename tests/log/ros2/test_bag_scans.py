"""Scans of a known wall lie on it, wherever the scanner sits; what has no place is left out."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.log.ros2.bags import START_NS, Said
from tests.log.ros2.robots import (
    SECOND_NS,
    Turn,
    describe_head,
    describe_place,
    say_odometry,
    say_transform,
    turn,
    write_robot,
)
from turtlelog import read_run
from turtlelog.log import Surroundings, read_surroundings
from turtlelog.log.ros2.bag_surroundings import CELL_M, MOST_RAYS, MOST_SCANS, UNKNOWN
from turtlelog.log.ros2.bag_transforms import Link

WALL_M = 5.0
"""Where a wall stands across the way of the robot, which drives along x at 1 m/s."""


def say_scan(
    at_s: float,
    *,
    away_m: float | None = None,
    facing_rad: float = 0.0,
    rays: int = 41,
    frame: str = "laser",
    topic: str = "/scan",
) -> Said:
    """Return a scan of the wall by a scanner that is so far from it, turned by an angle."""
    away_m = WALL_M - at_s if away_m is None else away_m
    seen = np.linspace(-0.5, 0.5, rays)
    return Said(
        topic=topic,
        type="sensor_msgs/msg/LaserScan",
        time_ns=START_NS + round(at_s * SECOND_NS),
        values={
            "header": describe_head(frame),
            "angle_min": float(seen[0]) - facing_rad,
            "angle_max": float(seen[-1]) - facing_rad,
            "angle_increment": float(seen[1] - seen[0]) if rays > 1 else 0.0,
            "time_increment": 0.0,
            "scan_time": 0.1,
            "range_min": 0.1,
            "range_max": 20.0,
            "ranges": (away_m / np.cos(seen)).tolist(),
            "intensities": [],
        },
    )


def say_map(
    cells: list[int], width: int, *, frame: str = "odom", topic: str = "/map", at_s: float = 0.0
) -> Said:
    info = {
        "map_load_time": {"sec": 0, "nanosec": 0},
        "resolution": 0.5,
        "width": width,
        "height": len(cells) // width,
        "origin": describe_place(1.0, 2.0, turn(0.0)),
    }
    return Said(
        topic=topic,
        type="nav_msgs/msg/OccupancyGrid",
        time_ns=START_NS + round(at_s * SECOND_NS),
        values={"header": describe_head(frame), "info": info, "data": cells},
    )


def look(folder: Path, *messages: Said | list[Said]) -> Surroundings:
    bag = write_robot(folder, say_odometry(count=4), *messages)
    seen = read_surroundings(bag, read_run(bag))
    assert seen is not None
    return seen


@pytest.mark.parametrize(("x_m", "yaw_rad"), [(0.0, 0.0), (0.2, 0.0), (-0.1, math.pi), (0.3, 1.0)])
def test_a_wall_is_where_it_is_wherever_the_scanner_sits(
    x_m: float, yaw_rad: float, tmp_path: Path
) -> None:
    fixed = say_transform("base_link", "laser", x_m, by=turn(yaw_rad), topic="/tf_static")
    scans = [
        say_scan(at_s, away_m=WALL_M - at_s - x_m, facing_rad=yaw_rad) for at_s in (0.5, 1.25, 2.5)
    ]
    seen = look(tmp_path, fixed, scans)
    assert [*seen.time_ns] == [500_000_000, 1_250_000_000, 2_500_000_000]
    for points in seen.scans_xy_m:
        np.testing.assert_allclose(points[:, 0], WALL_M, atol=1e-5)
    assert np.abs(seen.walls_xy_m[:, 0] - WALL_M).max() <= CELL_M
    assert seen.notes == ("Scans of /scan: 3 scans.",)


def test_a_scanner_that_hangs_upside_down_sees_left_on_the_left(tmp_path: Path) -> None:
    over: Turn = (1.0, 0.0, 0.0, 0.0)
    seen = look(
        tmp_path, say_transform("base_link", "laser", by=over, topic="/tf_static"), say_scan(1.0)
    )
    first, last = seen.scans_xy_m[0][[0, -1], 1]
    assert first > 0.0 > last


def stamp(said: Said, *, late_s: float = 0.0) -> Said:
    """Return a message whose header has its time, and that was recorded later."""
    head = said.values.get("header") or said.values["transforms"][0]["header"]
    head["stamp"] = {"sec": said.time_ns // SECOND_NS, "nanosec": said.time_ns % SECOND_NS}
    return replace(said, time_ns=said.time_ns + round(late_s * SECOND_NS))


@pytest.mark.parametrize("rate_rad_s", [1.0, -2.0, 6.0])
def test_a_scanner_that_rotates_is_turned_as_at_the_stamp_of_each_scan(
    rate_rad_s: float, tmp_path: Path
) -> None:
    # Transforms come five times a second, a tenth of a second late.
    turns = [
        say_transform("base_link", "laser", 0.1, at_s=at_s, by=turn(rate_rad_s * at_s))
        for at_s in np.arange(0.0, 3.1, 0.2).tolist()
    ]
    times_s = (0.53, 1.0, 1.77, 2.49)
    scans = [
        say_scan(at_s, away_m=WALL_M - at_s - 0.1, facing_rad=rate_rad_s * at_s) for at_s in times_s
    ]
    seen = look(tmp_path, [stamp(one, late_s=0.1) for one in turns], [*map(stamp, scans)])
    assert len(seen.scans_xy_m) == len(times_s)
    for points in seen.scans_xy_m:
        np.testing.assert_allclose(points[:, 0], WALL_M, atol=1e-5)


def test_a_scanner_that_rotates_without_stamps_is_turned_as_last_recorded(tmp_path: Path) -> None:
    turns = [
        say_transform("base_link", "laser", at_s=at_s, by=turn(at_s)) for at_s in (0.0, 0.9, 2.0)
    ]
    seen = look(tmp_path, turns, say_scan(1.0, facing_rad=0.9))
    np.testing.assert_allclose(seen.scans_xy_m[0][:, 0], WALL_M, atol=1e-5)


@pytest.mark.parametrize(("away_s", "is_held"), [(0.99, True), (1.01, False)])
def test_a_transform_is_held_for_a_second(away_s: float, *, is_held: bool) -> None:
    stamps = np.array([5, 6], dtype=np.int64) * SECOND_NS
    link = Link(
        parent="base_link",
        child="laser",
        time_ns=stamps,
        stamp_ns=stamps,
        place_m=np.array([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]),
        turn=np.array([turn(0.0), turn(1.0)]),
    )
    before, after = (link.interpolate(round(at * SECOND_NS)) for at in (5 - away_s, 6 + away_s))
    assert (before is not None) == (after is not None) == is_held
    if before and after:
        assert (before[0][0, 0], after[0][0, 0]) == (1.0, 2.0)
    middle = link.interpolate(round(5.25 * SECOND_NS))
    assert middle is not None
    np.testing.assert_allclose(middle[0], [[1.25, 0.0, 0.0]])
    np.testing.assert_allclose(middle[1], [turn(0.25)])


def test_without_a_transform_the_scanner_is_in_the_middle_and_that_is_said(tmp_path: Path) -> None:
    seen = look(tmp_path, say_scan(1.0))
    np.testing.assert_allclose(seen.scans_xy_m[0][:, 0], WALL_M, atol=1e-5)
    assert seen.notes[1].startswith("No transform tells where laser is on the robot")


def test_a_scan_in_the_frame_of_the_robot_needs_no_transform(tmp_path: Path) -> None:
    assert look(tmp_path, say_scan(1.0, frame="base_link")).notes == ("Scans of /scan: 1 scan.",)


def test_a_second_scanner_is_named_as_left_out(tmp_path: Path) -> None:
    rear = [say_scan(1.0, topic="/rear"), say_scan(2.0, topic="/rear")]
    seen = look(tmp_path, say_scan(1.0, topic="/front"), rear)
    assert "Scans of /rear: 2 scans." in seen.notes
    assert "Other scans are left out: /front." in seen.notes


def test_two_scanners_on_one_topic_each_sit_where_they_do(tmp_path: Path) -> None:
    fixed = [
        say_transform("base_link", frame, x_m, topic="/tf_static")
        for frame, x_m in (("laser", 0.0), ("bumper", 0.5))
    ]
    scans = [say_scan(0.5), say_scan(1.0, away_m=WALL_M - 1.5, frame="bumper")]
    for points in look(tmp_path, fixed, scans).scans_xy_m:
        np.testing.assert_allclose(points[:, 0], WALL_M, atol=1e-5)


@pytest.mark.parametrize("name", ["angle_min", "angle_increment"])
def test_rays_of_unknown_direction_are_left_out(name: str, tmp_path: Path) -> None:
    scan = say_scan(1.0)
    scan.values[name] = math.nan
    assert not look(tmp_path, scan).scans_xy_m[0][1:].size


@pytest.mark.parametrize(("range_m", "kept"), [(9_900.0, 1), (10_100.0, 0), (3e38, 0)])
def test_rays_beyond_any_scanner_are_left_out(range_m: float, kept: int, tmp_path: Path) -> None:
    scan = say_scan(1.0, rays=1)
    scan.values.update(ranges=[range_m], range_max=math.inf)
    assert len(look(tmp_path, scan).scans_xy_m[0]) == kept


def test_rays_that_hit_nothing_are_left_out(tmp_path: Path) -> None:
    scan = say_scan(1.0, rays=5)
    scan.values["ranges"] = [math.inf, math.nan, 4.0, 0.05, 25.0]
    assert len(look(tmp_path, scan).scans_xy_m[0]) == 1
    scan.values["ranges"] = []
    assert len(look(tmp_path, scan).scans_xy_m[0]) == 0


def test_scans_without_a_pose_are_left_out_and_counted(tmp_path: Path) -> None:
    seen = look(tmp_path, [say_scan(1.0), say_scan(3.5), say_scan(9.0, away_m=1.0)])
    assert len(seen.time_ns) == 1
    assert "2 scans of /scan have no pose within 1 s and are left out." in seen.notes


def test_scans_that_all_lie_outside_of_the_poses_are_no_error(tmp_path: Path) -> None:
    seen = look(tmp_path, say_scan(60.0, away_m=1.0))
    assert (len(seen.time_ns), len(seen.walls_xy_m)) == (0, 0)
    assert seen.notes == ("No scan of /scan was taken while the poses are known.",)


@pytest.mark.parametrize(("count", "kept"), [(MOST_SCANS, MOST_SCANS), (MOST_SCANS + 1, 201)])
def test_many_scans_are_thinned_evenly(count: int, kept: int, tmp_path: Path) -> None:
    scans = [say_scan(0.001 + 2.0 * row / count, rays=3) for row in range(count)]
    assert len(look(tmp_path, scans).time_ns) == kept


@pytest.mark.parametrize(("rays", "kept"), [(MOST_RAYS, MOST_RAYS), (2 * MOST_RAYS, MOST_RAYS)])
def test_many_rays_are_thinned_evenly(rays: int, kept: int, tmp_path: Path) -> None:
    (points,) = look(tmp_path, say_scan(1.0, rays=rays)).scans_xy_m
    assert len(points) == kept
    assert np.ptp(points[:, 1]) == pytest.approx(2.0 * 4.0 * math.tan(0.5), rel=0.01)


def test_the_scanner_of_the_named_robot_is_taken(tmp_path: Path) -> None:
    bag = write_robot(
        tmp_path,
        say_odometry("/a/odom", count=3),
        say_odometry("/b/odom", count=3, x_m=9.0),
        [say_scan(0.5, topic="/a/scan"), say_scan(0.6, topic="/a/scan")],
        say_scan(1.0, away_m=1.0, topic="/b/scan"),
    )
    seen = read_surroundings(bag, read_run(bag, pose_topic="/b/odom"))
    assert seen is not None
    assert seen.notes[0] == "Scans of /b/scan: 1 scan."
    np.testing.assert_allclose(seen.scans_xy_m[0][:, 0], 11.0, atol=1e-5)


def test_a_map_has_its_occupied_cells_where_its_origin_says(tmp_path: Path) -> None:
    seen = look(tmp_path, say_map([0, 100, 64, -1, 65, 0], 3))
    np.testing.assert_allclose(seen.map_xy_m, [[1.75, 2.25], [1.75, 2.75]])
    (found,) = seen.maps
    assert found.cells.tolist() == [[0, 100, 64], [UNKNOWN, 65, 0]]
    assert seen.notes == ("Map of /map: 3 x 2 cells of 0.5 m, 2 occupied cells.",)


def test_the_map_is_taken_and_not_the_costmap_that_is_sent_more_often(tmp_path: Path) -> None:
    costs = [say_map([100] * 4, 2, topic="/global_costmap/costmap", at_s=at) for at in (1.0, 2.0)]
    local = say_map([100], 1, topic="/local_costmap/costmap")
    seen = look(tmp_path, say_map([100], 1), costs, local)
    assert len(seen.map_xy_m) == 1
    assert [(found.topic, found.is_costmap) for found in seen.maps] == [
        ("/map", False),
        ("/global_costmap/costmap", True),
    ]
    assert seen.notes[-1] == "Other maps are left out: /local_costmap/costmap."
    (tmp_path / "alone").mkdir()
    assert len(look(tmp_path / "alone", costs).map_xy_m) == 4


@pytest.mark.parametrize(("side", "step"), [(4096, 1), (4097, 2), (9000, 3)])
def test_a_map_that_no_picture_holds_is_joined_and_keeps_its_walls(
    side: int, step: int, tmp_path: Path
) -> None:
    cells = [-1] * (2 * side)
    cells[side - 1] = 100
    cells[0] = 0
    (found,) = look(tmp_path, say_map(cells, side)).maps
    width = -(-side // step)
    assert found.cells.shape == (2 if step == 1 else 1, width)
    assert found.cells[0, -1] == 100
    assert found.cells[0, 0] == 0
    assert found.cells[0, 1] == UNKNOWN
    np.testing.assert_allclose(found.column_xy_m, [0.5 * step, 0.0])


def test_a_turned_map_lies_as_its_origin_says(tmp_path: Path) -> None:
    grid = say_map([100, 0], 2)
    grid.values["info"]["origin"] = describe_place(1.0, 2.0, turn(math.pi / 2))
    (found,) = look(tmp_path, grid).maps
    np.testing.assert_allclose(found.corner_xy_m, [1.0, 2.0])
    np.testing.assert_allclose(found.column_xy_m, [0.0, 0.5], atol=1e-12)
    np.testing.assert_allclose(found.row_xy_m, [-0.5, 0.0], atol=1e-12)
    np.testing.assert_allclose(found.list_occupied(), [[0.75, 2.25]])


def test_a_map_in_another_frame_follows_the_transforms(tmp_path: Path) -> None:
    seen = look(tmp_path, say_transform("map", "odom", 1.0), say_map([100], 1, frame="map"))
    np.testing.assert_allclose(seen.map_xy_m, [[0.25, 2.25]])


def test_a_map_that_nothing_joins_to_the_poses_is_left_out(tmp_path: Path) -> None:
    seen = look(tmp_path, say_map([100], 1, frame="elsewhere"))
    assert len(seen.map_xy_m) == 0
    assert seen.notes == ("The map of /map is left out: nothing joins elsewhere and odom.",)


def test_a_map_whose_size_is_false_is_left_out(tmp_path: Path) -> None:
    grid = say_map([100, 0], 2)
    grid.values["info"]["width"] = 4_000_000_000
    assert look(tmp_path, grid).notes[0].startswith("The map of /map is left out: 4000000000 x 1")


def test_a_map_without_an_origin_is_left_out(tmp_path: Path) -> None:
    grid = say_map([100], 1)
    grid.values["info"]["origin"]["position"]["x"] = math.nan
    seen = look(tmp_path, grid)
    assert len(seen.map_xy_m) == 0
    assert seen.notes == ("The map of /map is left out: its origin has nan or infinity.",)


def test_a_bag_without_scans_has_no_surroundings(tmp_path: Path) -> None:
    bag = write_robot(tmp_path, say_odometry())
    assert read_surroundings(bag, read_run(bag)) is None
