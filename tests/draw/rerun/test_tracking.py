"""Recordings of runs that track a path, and of laws with states: what they hold is the run's."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import turtlelog as tl
from tests.draw.laws import SQUARE, simulate_law, simulate_pid, simulate_tracker, simulate_untimed
from tests.draw.rerun.rrds import (
    join_strips,
    list_entities,
    read_layout,
    read_rows,
    read_static,
    read_times,
    verify,
)
from turtlelog.charts.close_up import find_worst_place
from turtlelog.draw import write_comparison_rrd, write_run_rrd
from turtlelog.draw.rerun.content import find_corners
from turtlelog.draw.rerun.plane import find_plane_bounds
from turtlelog.draw.rerun.plots import Series
from turtlelog.draw.rerun.run_scene import build_single
from turtlelog.measure import read_signal

KANAYAMA, PURSUIT = simulate_tracker("kanayama"), simulate_tracker("pure-pursuit")
OUTLINE = [list(point) for point in (*SQUARE, SQUARE[0])]


@pytest.fixture(scope="module")
def trackers_rrd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("trackers") / "trackers.rrd"
    write_comparison_rrd([KANAYAMA, PURSUIT], path)
    return path


@pytest.fixture(scope="module")
def pid_rrd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("pid") / "pid.rrd"
    write_run_rrd(simulate_pid(), path)
    return path


def read_curve(path: Path, entity: str) -> NDArray[np.float64]:
    return np.array(read_rows(path, entity, "Scalars:scalars"), dtype=np.float64)[:, 0]


def read_strips(path: Path, entity: str) -> list[list[list[float]]]:
    strips = read_static(path, entity, "LineStrips2D:strips")
    return [[list(point) for point in strip] for strip in strips]


def test_the_path_is_that_of_the_scenario_and_drawn_once(
    tracker_rrd: Path, trackers_rrd: Path
) -> None:
    for rrd in (tracker_rrd, trackers_rrd):
        verify(rrd)
        assert read_strips(rrd, "/plane/tracked_path") == [OUTLINE]
        assert not [name for name in list_entities(rrd) if name.endswith("reference_path")]


def test_the_path_lies_below_what_is_driven(tracker_rrd: Path) -> None:
    (order,) = read_static(tracker_rrd, "/plane/tracked_path", "LineStrips2D:draw_order")
    assert order < 20.0  # that of lines by default


def test_a_path_that_the_law_does_not_track_is_not_drawn(tmp_path: Path) -> None:
    path = {"path.kind": "line", "path.points": [[1.0, 1.0], [2.0, 2.0]]}
    run = tl.simulate_run(tl.override_scenario(tl.load_scenario("textbook"), path))
    write_run_rrd(run, tmp_path / "run.rrd")
    assert "/plane/tracked_path" not in list_entities(tmp_path / "run.rrd")


def test_the_view_of_the_plane_holds_a_path_outside_of_the_world() -> None:
    far = {**KANAYAMA.parameters, "path.points": [[-20.0, 0.0], [8.0, 3.0], [8.0, 8.0]]}
    bounds = find_plane_bounds([replace(KANAYAMA, parameters=far)])
    assert bounds.center_xy_m[0] - bounds.half_size_m < -20.0


def test_the_reference_is_the_recorded_pose_with_its_heading(tracker_rrd: Path) -> None:
    samples = KANAYAMA.samples
    assert samples.reference_xy_m is not None
    assert samples.reference_heading_rad is not None
    origins = read_rows(tracker_rrd, "/plane/reference_pose", "Arrows2D:origins")
    ways = read_rows(tracker_rrd, "/plane/reference_pose", "Arrows2D:vectors")
    np.testing.assert_allclose([row[0] for row in origins], samples.reference_xy_m, rtol=1e-6)
    headings = [np.arctan2(row[0][1], row[0][0]) for row in ways]
    turned = np.exp(1j * (np.array(headings) - samples.reference_heading_rad))
    np.testing.assert_allclose(turned, 1.0, atol=1e-6)


def test_the_error_of_a_law_without_a_goal_leads_to_the_reference(tracker_rrd: Path) -> None:
    samples, rows = KANAYAMA.samples, KANAYAMA.samples.pose_sequence
    assert samples.reference_xy_m is not None
    origins = np.array(read_rows(tracker_rrd, "/plane/error", "Arrows2D:origins"))[:, 0]
    vectors = np.array(read_rows(tracker_rrd, "/plane/error", "Arrows2D:vectors"))[:, 0]
    np.testing.assert_allclose((origins + vectors)[rows], samples.reference_xy_m, atol=1e-5)


def test_along_track_has_its_reference_and_its_error(tracker_rrd: Path) -> None:
    along = read_curve(tracker_rrd, "/along_track")
    reference = read_curve(tracker_rrd, "/along_track/reference")
    due_m = 0.5 * np.maximum(read_times(tracker_rrd, "/along_track/reference") / 1e9, 0.0)
    np.testing.assert_allclose(reference, np.minimum(due_m, 12.0), atol=1e-9)
    error = read_curve(tracker_rrd, "/along_track_error")
    np.testing.assert_allclose(error, reference - along, atol=1e-12)
    offsets = read_signal(KANAYAMA, "cross_track")
    assert read_curve(tracker_rrd, "/cross_track").tolist() == offsets.values.tolist()
    levels = [name for name in list_entities(tracker_rrd) if name.startswith("/reference/")]
    assert not [name for name in levels if "track" in name]  # zero is on the axis


def test_the_layout_of_a_tracker_has_what_it_has_data_for(tracker_rrd: Path) -> None:
    views = read_layout(tracker_rrd)
    assert {view for view in views if "[" in view} == {
        *("Heading [deg]", "Heading error [deg]", "log₁₀ heading error [deg]"),
        *("Turn rate [rad/s]", "Along-track error [m]", "Along-track [m]", "Position [m]"),
        *("Cross-track [m]", "Speed [m/s]", "Wanted turn rate [rad/s]", "Wanted speed [m/s]"),
    }
    assert not [view for view in views if "goal" in view]


def test_without_a_speed_of_the_path_there_is_no_error_along_it(tmp_path: Path) -> None:
    write_run_rrd(simulate_untimed(), tmp_path / "run.rrd")
    entities = list_entities(tmp_path / "run.rrd")
    assert "/along_track" in entities
    assert not {"/along_track_error", "/along_track/reference"} & entities
    write_comparison_rrd([KANAYAMA, simulate_untimed()], tmp_path / "two.rrd")
    assert read_strips(tmp_path / "two.rrd", "/plane/tracked_path") == [OUTLINE]
    assert read_layout(tmp_path / "two.rrd")["Along-track error [m]"]


def test_of_several_paths_each_is_drawn_and_none_has_a_close_up(tmp_path: Path) -> None:
    moved = {**KANAYAMA.parameters, "path.points": [[3.0, 3.0], [6.0, 3.0], [6.0, 7.0]]}
    other = replace(KANAYAMA, parameters=moved, name="other")
    write_comparison_rrd([KANAYAMA, other], tmp_path / "two.rrd")
    assert len(read_strips(tmp_path / "two.rrd", "/plane/tracked_path")) == 2
    assert not [view for view in read_layout(tmp_path / "two.rrd") if "Furthest" in view]


def test_the_worst_place_is_shown_and_named(tracker_rrd: Path, trackers_rrd: Path) -> None:
    for rrd, runs in ((tracker_rrd, [KANAYAMA]), (trackers_rrd, [KANAYAMA, PURSUIT])):
        worst = find_worst_place(runs)
        assert worst is not None
        (strip,) = read_strips(rrd, "/plane/close_up/worst")
        np.testing.assert_allclose(strip, [worst.path_xy_m, worst.xy_m], rtol=1e-6)
        (name,) = read_static(rrd, "/plane/close_up/worst/name", "Points2D:labels")
        assert name == f"{worst.offset_m * 1e3:.3g} mm"
        (view,) = [view for view in read_layout(rrd) if "Furthest" in view]
        assert view == f"Furthest off the path, ±{worst.half_m * 1e3:.3g} mm"


def test_the_furthest_place_is_marked_on_the_error(tracker_rrd: Path) -> None:
    names = read_static(tracker_rrd, "/along_track_error/marks", "SeriesPoints:names")
    largest = tl.measure_run(KANAYAMA)["along.largest_error"].value
    assert names == [f"■ furthest off {largest:.3g} m"]
    across = read_static(tracker_rrd, "/cross_track/marks", "SeriesPoints:names")
    assert len(across) == 1


def test_trackers_over_each_other_are_compared_by_their_errors(trackers_rrd: Path) -> None:
    views = read_layout(trackers_rrd)
    expected = [f"/runs/{name}/along_track_error" for name in ("kanayama", "pure-pursuit")]
    levels = {"/reference/along_track_error/**"}
    assert sorted(set(views["Along-track error [m]"]) - levels) == expected
    drawn = join_strips(trackers_rrd, "/runs/kanayama/plane/path")
    np.testing.assert_allclose(drawn, KANAYAMA.poses.xy_m, rtol=1e-6)


def test_states_that_belong_together_share_a_plot(pid_rrd: Path) -> None:
    views = read_layout(pid_rrd)
    of_turn = ["/state/integral_angular", "/state/derivative_angular"]
    assert [
        name for name in views["States of the turn rate [rad/s]"] if "lines" not in name
    ] == of_turn
    of_speed = ["/state/integral_linear", "/state/derivative_linear"]
    assert [name for name in views["States of the speed [m/s]"] if "lines" not in name] == of_speed
    samples, names = simulate_pid().samples, simulate_pid().declaration.states
    assert samples.states is not None
    for column, name in enumerate(names):
        assert read_curve(pid_rrd, f"/state/{name}").tolist() == samples.states[:, column].tolist()
    colors = [read_static(pid_rrd, entity, "SeriesLines:colors") for entity in of_turn]
    assert colors[0] != colors[1]


@pytest.mark.thorough
def test_states_of_other_scales_and_of_several_runs_are_tabs(tmp_path: Path) -> None:
    pid = simulate_pid()
    assert pid.samples.states is not None
    states = pid.samples.states * [1.0, 1e-3, 1.0, 1.0]
    run = replace(pid, samples=replace(pid.samples, states=states))
    write_run_rrd(run, tmp_path / "run.rrd")
    views = read_layout(tmp_path / "run.rrd")
    assert "/state/derivative_angular" in views["derivative_angular [rad/s]"]
    assert "/state/integral_angular" not in views["derivative_angular [rad/s]"]
    assert "States of the speed [m/s]" in views
    idle = replace(pid.samples, states=pid.samples.states * [1.0, 1.0, 0.0, 0.0])
    write_run_rrd(replace(pid, samples=idle), tmp_path / "idle.rrd")
    assert "/state/integral_linear" in list_entities(tmp_path / "idle.rrd")
    shown = [view for view in read_layout(tmp_path / "idle.rrd") if "States" in view]
    assert shown == ["States of the turn rate [rad/s]"]
    write_comparison_rrd([pid, simulate_law("strange")], tmp_path / "two.rrd")
    views = read_layout(tmp_path / "two.rrd")
    assert views["integral_angular [rad/s]"] == ["/runs/pid/state/integral_angular"]
    assert views["State memory"] == ["/runs/strange/state/memory"]


def test_a_legend_stands_in_the_corner_with_the_fewest_rows() -> None:
    time_ns = np.arange(100)
    ranges = {"speed": (0.0, 1.0)}

    def find(values: NDArray[np.float64]) -> str:
        curve = Series(entity="speed/commanded", labels=("",), time_ns=time_ns, values=values)
        return find_corners([curve], ranges)["speed"]

    low_then_high = np.where(time_ns < 50, 0.1, 0.9)[:, np.newaxis]
    assert find(np.hstack([low_then_high, np.full((100, 1), 0.1)])) == "LeftTop"
    assert find(np.hstack([low_then_high, np.full((100, 1), 0.9)])) == "RightBottom"
    assert find(np.full((100, 1), 0.2)) in {"LeftTop", "RightTop"}
    beyond = np.hstack([np.full((100, 1), 0.2), np.full((100, 1), 7.0)])
    assert find(beyond) in {"LeftTop", "RightTop"}


def test_a_curve_that_is_always_0_has_a_range_with_ticks_that_read_well() -> None:
    run = simulate_law("OpenLoop")
    still = replace(run.samples, speed_m_s=np.zeros(len(run.samples)), wanted_speed_m_s=None)
    poses = replace(run.poses, speed_m_s=None)
    parameters = {**run.parameters, "limits.speed_m_s": np.inf}
    single = build_single(replace(run, samples=still, poses=poses, parameters=parameters))
    assert single.describe({}).ranges["speed"] == (-0.1, 0.1)
