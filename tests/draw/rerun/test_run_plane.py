from pathlib import Path

import numpy as np

import turtlelog as tl
from tests.draw.rerun.rrds import (
    join_strips,
    list_entities,
    make_foreign_run,
    read_layout,
    read_rows,
    read_static,
    read_times,
    simulate_preset,
)
from turtlelog.charts import palette
from turtlelog.charts.palette import choose_shades
from turtlelog.draw import write_run_rrd

RUN = simulate_preset("paper-kp10")


def test_position_and_turtle_are_where_the_poses_are(run_rrd: Path) -> None:
    rows = np.array(read_rows(run_rrd, "/position", "Scalars:scalars"))
    np.testing.assert_array_equal(rows, RUN.poses.xy_m)
    places = np.array(read_rows(run_rrd, "/plane/turtle", "Transform3D:translation"))[:, 0]
    np.testing.assert_array_equal(places[:, :2], RUN.poses.xy_m)  # poses are 32-bit floats


def test_turtle_is_turned_by_its_heading(run_rrd: Path) -> None:
    turns = np.array(read_rows(run_rrd, "/plane/turtle", "Transform3D:quaternion"))[:, 0]
    heading_rad = 2.0 * np.arctan2(turns[:, 2], turns[:, 3])
    np.testing.assert_allclose(heading_rad, RUN.poses.heading_rad, atol=1e-6)


def test_the_trace_is_the_path_in_the_colour_of_the_run(run_rrd: Path) -> None:
    np.testing.assert_array_equal(join_strips(run_rrd, "/plane/path"), RUN.poses.xy_m)
    colors = read_static(run_rrd, "/plane/path", "LineStrips2D:colors")
    assert {color | 255 for color in colors} == {int(palette.pack_colors([palette.MAIN])[0])}


def test_the_trace_by_speed_is_the_path_brightest_where_it_is_fast(run_rrd: Path) -> None:
    np.testing.assert_array_equal(join_strips(run_rrd, "/plane/path_by_speed"), RUN.poses.xy_m)
    colors = read_static(run_rrd, "/plane/path_by_speed", "LineStrips2D:colors")
    lengths = [len(s) for s in read_static(run_rrd, "/plane/path_by_speed", "LineStrips2D:strips")]
    # Most of the way it drives at the limit.
    assert colors[int(np.argmax(lengths[1:])) + 1] == palette.pack_colors([choose_shades(16)[-1]])


def test_the_error_arrow_points_from_the_turtle_to_the_goal(run_rrd: Path) -> None:
    origins = np.array(read_rows(run_rrd, "/plane/error", "Arrows2D:origins"))[:, 0]
    vectors = np.array(read_rows(run_rrd, "/plane/error", "Arrows2D:vectors"))[:, 0]
    np.testing.assert_array_equal(origins, RUN.poses.xy_m)
    np.testing.assert_allclose(
        origins + vectors, np.tile([2.0, 10.0], (len(origins), 1)), atol=1e-6
    )


def test_the_command_arrows_are_speed_ahead_and_turn_rate_to_the_left(run_rrd: Path) -> None:
    arrows = np.array(read_rows(run_rrd, "/plane/turtle/command", "Arrows2D:vectors"))
    samples = RUN.samples
    np.testing.assert_allclose(arrows[:, 0, 0], samples.speed_m_s, rtol=1e-6)
    np.testing.assert_allclose(arrows[:, 1, 1], samples.turn_rate_rad_s, rtol=1e-6)
    assert not arrows[:, 0, 1].any()
    assert not arrows[:, 1, 0].any()


def test_events_stand_in_the_plane_and_across_the_plots(run_rrd: Path) -> None:
    times_ns = [event.time_ns for event in RUN.events]
    rows = np.searchsorted(RUN.poses.time_ns, times_ns, side="right") - 1
    places = np.array(read_static(run_rrd, "/plane/events", "Points2D:positions"))
    np.testing.assert_array_equal(places, RUN.poses.xy_m[rows])
    labels = read_static(run_rrd, "/plane/events", "Points2D:labels")
    assert labels == [event.kind.replace("_", " ") for event in RUN.events]
    lines_ns = read_times(run_rrd, "/speed/lines/event") + RUN.start_ns
    assert sorted(set(lines_ns.tolist())) == sorted(set(times_ns))
    levels = np.array(read_rows(run_rrd, "/speed/lines/event", "Scalars:scalars"))[:, 0]
    assert np.nanmin(levels) < min(RUN.samples.turn_rate_rad_s.min(), -1.0)
    assert "/speed/lines/event" in read_layout(run_rrd)["Speed [m/s]"]


def test_a_path_outside_the_world_has_no_border(tmp_path: Path) -> None:
    write_run_rrd(make_foreign_run(300), tmp_path / "run.rrd")
    assert "/plane/border" not in list_entities(tmp_path / "run.rrd")


def test_a_robot_has_no_walls_wherever_it_drives(tmp_path: Path) -> None:
    robot = {"plant.kind": "lagged", "goal.x_m": 6.0, "goal.y_m": 6.0}
    run = tl.simulate_run(tl.override_scenario(tl.load_scenario("textbook"), robot))
    write_run_rrd(run, tmp_path / "run.rrd")
    assert "/plane/border" not in list_entities(tmp_path / "run.rrd")
