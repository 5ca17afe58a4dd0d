"""What is sensed, shaped and disturbed, beside what happened: in figures and in Rerun."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes

import turtlelog as tl
from tests.draw.rerun.rrds import list_entities, read_rows, read_static, read_times
from tests.effects_cases import build_case
from turtlelog.charts.curves import find_disturbed_time
from turtlelog.draw.rerun.live_viewer import GrowingStream, LiveScene
from turtlelog.run import Run
from turtlelog.simulate import RunCollector, iterate_ticks

SCENARIO = build_case("noise", "dropout", "low_pass", "disturbance", max_duration_s=1.5)
SENSED = {"/plane/sensed", "/heading_deg/sensed", "/position/sensed"}
DROPPED = {"/plane/dropped_out", "/heading_deg/dropped_out", "/position/dropped_out"}
SHAPED = {"/wanted_speed/shaped", "/wanted_turn_rate/shaped"}


@cache
def simulate() -> Run:
    return tl.simulate_run(SCENARIO)


@cache
def simulate_plain() -> Run:
    return tl.simulate_run(build_case(max_duration_s=1.5))


def draw_first(name: str, *runs: Run) -> Axes:
    axes: Axes = tl.draw.draw_figure(name, runs).get_axes()[0]
    return axes


def read_lines(axes: Axes) -> dict[str, tuple[Any, Any]]:
    return {str(line.get_label()): line.get_data() for line in axes.get_lines()}


def test_a_figure_shows_what_was_sensed_as_points_and_drop_outs_as_strokes() -> None:
    run = simulate()
    axes, poses = draw_first("heading", run), run.poses
    lines = read_lines(axes)
    assert poses.sensed_heading_rad is not None
    is_there = ~np.isnan(poses.sensed_heading_rad)
    time_s = (poses.time_ns - run.start_ns) / 1e9
    np.testing.assert_array_equal(lines["sensed"][0], time_s[is_there])
    expected = np.degrees(poses.sensed_heading_rad[is_there])
    np.testing.assert_allclose(lines["sensed"][1], expected, atol=1e-9)
    np.testing.assert_array_equal(lines["dropped"][0], time_s[~is_there])
    styles = {line.get_label(): line.get_linestyle() for line in axes.get_lines()}
    assert styles["sensed"] == styles["dropped"] == "None"


def test_the_plane_shows_where_the_controller_saw_the_robot() -> None:
    run = simulate()
    assert run.poses.sensed_xy_m is not None
    x_m, y_m = read_lines(draw_first("plane", run))["sensed"]
    np.testing.assert_array_equal(np.column_stack([x_m, y_m]), run.poses.sensed_xy_m)


def test_commands_stand_beside_what_shaping_left_and_while_something_pushed() -> None:
    run = simulate()
    axes = draw_first("turn-rate", run)
    values = read_lines(draw_first("wanted-turn-rate", run))["shaped"][1]
    np.testing.assert_array_equal(values, run.samples.shaped_turn_rate_rad_s)
    spans = [patch for patch in axes.patches if patch.get_label() == "disturbance"]
    [(low, high)] = [(span.get_x(), span.get_x() + span.get_width()) for span in spans]  # type: ignore[attr-defined]
    assert (low, high) == pytest.approx((0.3, 1.1))


@pytest.mark.parametrize("name", ["heading", "plane", "turn-rate"])
def test_of_several_runs_and_of_runs_without_effects_none_of_it_is_shown(name: str) -> None:
    for runs in ([simulate(), simulate_plain()], [simulate_plain()]):
        axes = draw_first(name, *runs)
        labels = {*read_lines(axes), *(patch.get_label() for patch in axes.patches)}
        assert not labels & {"sensed", "dropped", "shaped", "disturbance"}


def test_the_axis_of_a_command_has_room_for_what_a_disturbance_adds() -> None:
    run = tl.simulate_run(
        tl.override_scenario(SCENARIO, {"disturbance.turn_rate_rad_s": 3.0, "max_duration_s": 0.5})
    )
    assert run.poses.turn_rate_rad_s is not None
    assert run.poses.turn_rate_rad_s.max() > 3.5
    assert draw_first("turn-rate", run).get_ylim()[1] > run.poses.turn_rate_rad_s.max()


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, (0.3, 1.1)),
        ({"disturbance.to_s": float("inf")}, (0.3, 1.488)),
        ({"disturbance.from_s": 0.0}, (0.0, 1.1)),
        ({"disturbance.from_s": 1.4889, "disturbance.to_s": 1.495}, None),
        ({"disturbance.speed_m_s": 0.0, "disturbance.turn_rate_rad_s": 0.0}, None),
    ],
)
def test_a_disturbance_is_shown_within_the_run(
    changes: dict[str, Any], expected: tuple[float, float] | None
) -> None:
    found = find_disturbed_time(tl.simulate_run(tl.override_scenario(SCENARIO, changes)))
    assert found == (None if expected is None else pytest.approx(expected))


def test_rerun_shows_what_was_sensed_shaped_and_lost(tmp_path: Path) -> None:
    run, path = simulate(), tmp_path / "a.rrd"
    tl.write_run_rrd(run, path)
    assert list_entities(path) >= {*SENSED, *DROPPED, *SHAPED}
    lost = np.flatnonzero(run.poses.dropped_out)
    assert 0 < len(lost) < len(run.poses)
    assert len(read_times(path, "/heading_deg/dropped_out")) == len(lost)
    assert len(read_times(path, "/heading_deg/sensed")) == len(run.poses) - len(lost)
    shaped = np.ravel(read_rows(path, "/wanted_turn_rate/shaped", "Scalars:scalars"))
    np.testing.assert_array_equal(shaped, run.samples.shaped_turn_rate_rad_s)
    places = read_static(path, "/plane/dropped_out", "Points2D:positions")
    np.testing.assert_array_equal(places, run.poses.xy_m[lost].astype(np.float32))
    assert len(read_static(path, "/plane/sensed", "Points2D:positions")) == len(run.poses) - len(
        lost
    )


def test_what_is_lost_time_and_again_stands_in_the_list_of_events_alone(tmp_path: Path) -> None:
    run, path = simulate(), tmp_path / "a.rrd"
    tl.write_run_rrd(run, path)
    kinds = [event.kind for event in run.events]
    assert kinds.count("poses_lost") > 5
    assert len(read_rows(path, "/events", "TextLog:text")) == len(kinds)
    marked = read_static(path, "/plane/events", "Points2D:labels")
    assert marked == [kind for kind in kinds if kind != "poses_lost"] == ["stop"]


def test_rerun_shows_no_effects_of_a_run_without(tmp_path: Path) -> None:
    tl.write_run_rrd(simulate_plain(), tmp_path / "a.rrd")
    assert not list_entities(tmp_path / "a.rrd") & {*SENSED, *DROPPED, *SHAPED}


def test_a_run_with_effects_drawn_while_it_grows_is_its_file(tmp_path: Path) -> None:
    grown, once = tmp_path / "grown.rrd", tmp_path / "once.rrd"
    stream = GrowingStream("turtlelog")
    stream.save(grown)
    scene, collector = LiveScene(stream), RunCollector(SCENARIO)
    ticks = list(iterate_ticks(SCENARIO))
    for first in range(0, len(ticks), 17):
        collector.take(ticks[first : first + 17])
        scene.update(collector.build_run())
    scene.finish(collector.build_run())
    stream.disconnect()
    tl.write_run_rrd(simulate(), once)
    assert list_entities(grown) == list_entities(once)
    for entity in (SENSED | DROPPED | SHAPED) - {"/plane/sensed", "/plane/dropped_out"}:
        rows = [read_rows(path, entity, "Scalars:scalars") for path in (grown, once)]
        assert rows[0] == rows[1], entity
