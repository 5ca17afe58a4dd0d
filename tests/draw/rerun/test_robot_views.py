"""Views of somebody's robot: poses, and commands and measured rates where there are any."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.draw.rerun.rrds import (
    list_entities,
    read_blueprint_parts,
    read_layout,
    read_rows,
    read_static,
    verify,
)
from tests.draw.robots import OUTLIER, keep_no_commands, make_robot
from tests.log.runs import find_shared
from turtlelog.draw import write_comparison_rrd, write_run_rrd
from turtlelog.draw.rerun.run_scene import build_single
from turtlelog.log.ros2 import read_bag


def test_a_robot_s_commands_and_measured_rates_are_entities_of_their_own(tmp_path: Path) -> None:
    path = tmp_path / "robot.rrd"
    write_run_rrd(make_robot(), path)
    verify(path)
    found = {name for name in list_entities(path) if name.startswith("/turn_rate")}
    assert found == {
        *("/turn_rate/commanded", "/turn_rate/as_measured", "/turn_rate/as_measured/outliers"),
    }
    views = {"Plane (yellow: command)", "Heading [deg]", "Position [m]", "Speed [m/s]"}
    views.add("Turn rate [rad/s], 1 outlier left out")
    assert set(read_layout(path)) == {
        *(*views, "Metrics", "Scenario", "By speed, 0 to 0.21 m/s"),
    }


def test_an_outlier_is_kept_and_named_and_does_not_set_the_range(tmp_path: Path) -> None:
    path = tmp_path / "robot.rrd"
    write_run_rrd(make_robot(), path)
    entity = "/turn_rate/as_measured/outliers"
    assert np.array(read_rows(path, entity, "Scalars:scalars")).tolist() == [[OUTLIER]]
    [names] = [np.ravel(read_static(path, entity, "SeriesPoints:names")).tolist()]
    assert names == ["measured, \N{MULTIPLICATION SIGN} outlier -143.6 rad/s at 6.0 s"]
    low, high = build_single(make_robot()).describe({}).ranges["turn_rate"]
    assert -0.4 < low < high < 0.4


def test_of_a_robot_without_commands_what_it_measured_is_shown(tmp_path: Path) -> None:
    path = tmp_path / "robot.rrd"
    write_run_rrd(keep_no_commands(make_robot()), path)
    assert "/speed/commanded" not in list_entities(path)
    assert "Speed [m/s]" in read_layout(path)
    visible = read_blueprint_parts(path, "PlotLegend:visible")
    assert sum(visible) == 2  # x and y, and the outlier


def test_compared_robots_show_commands_beside_what_was_measured(tmp_path: Path) -> None:
    path = tmp_path / "robots.rrd"
    other = make_robot("b")
    moved = replace(other, poses=replace(other.poses, xy_m=other.poses.xy_m + 0.1))
    write_comparison_rrd([make_robot("a"), moved], path)
    verify(path)
    for name in "ab":
        for kind, label in (("as_measured", name), ("commanded", f"{name} commanded")):
            entity = f"/runs/{name}/speed/{kind}"
            assert np.ravel(read_static(path, entity, "SeriesLines:names")).tolist() == [label]
        outliers = f"/runs/{name}/turn_rate/as_measured/outliers"
        assert np.array(read_rows(path, outliers, "Scalars:scalars")).tolist() == [[OUTLIER]]
    assert "Turn rate [rad/s], 2 outliers left out" in read_layout(path)


def test_a_robot_within_turtlesim_s_square_is_not_in_its_world(tmp_path: Path) -> None:
    robot = make_robot()
    inside = replace(robot.poses, xy_m=robot.poses.xy_m + 6.0)
    path = tmp_path / "robot.rrd"
    write_run_rrd(replace(robot, poses=inside), path)
    assert "/plane/border" not in list_entities(path)
    bounds = build_single(replace(robot, poses=inside)).describe({}).plane
    assert bounds.half_size_m == pytest.approx(0.62 * np.ptp(inside.xy_m, axis=0).max())


def test_a_jump_of_a_real_turtlesim_parts_its_path(tmp_path: Path) -> None:
    run = read_bag(find_shared("ros2", "turtlesim_jazzy"))
    path = tmp_path / "turtle.rrd"
    write_run_rrd(run, path)
    strips = [np.array(strip) for strip in read_static(path, "/plane/path", "LineStrips2D:strips")]
    assert [len(strip) for strip in strips] == [878, 1623]
    assert "/plane/border" in list_entities(path)
    assert "By speed, 0 to 2 m/s" in read_layout(path)
