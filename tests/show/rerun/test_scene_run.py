from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.show.rerun.conftest import DOCUMENTS
from tests.show.rerun.rrds import (
    count_chunks,
    list_entities,
    list_timelines,
    make_foreign_run,
    read_layout,
    read_rows,
    read_static,
    read_times,
    simulate_preset,
    verify,
)
from turtlelog.measure import measure_run, read_signal
from turtlelog.run import Run, SampleColumns
from turtlelog.show import write_run_rrd
from turtlelog.show.rerun import palette, run_stream

RUN = simulate_preset("paper-kp10")


def read_values(name: str) -> NDArray[np.float64]:
    signal = read_signal(RUN, name)
    assert signal is not None
    return signal.values


POSE_CURVES: dict[str, Callable[[], NDArray[np.float64] | None]] = {
    "/heading_deg": lambda: np.degrees(read_values("heading")),
    "/heading_error_deg": lambda: np.degrees(read_values("heading_error")),
    "/along_track": lambda: read_values("along_track"),
    "/cross_track": lambda: read_values("cross_track"),
    "/distance": lambda: read_values("distance"),
    "/speed/applied": lambda: RUN.poses.speed_m_s,
    "/turn_rate/applied": lambda: RUN.poses.turn_rate_rad_s,
}
SAMPLE_CURVES: dict[str, Callable[[], NDArray[np.float64] | None]] = {
    "/speed/wanted": lambda: RUN.samples.wanted_speed_m_s,
    "/speed/commanded": lambda: RUN.samples.speed_m_s,
    "/turn_rate/wanted": lambda: RUN.samples.wanted_turn_rate_rad_s,
    "/turn_rate/commanded": lambda: RUN.samples.turn_rate_rad_s,
}


@pytest.mark.parametrize("entity", POSE_CURVES)
def test_curves_hold_the_pose_columns_exactly(run_rrd: Path, entity: str) -> None:
    rows = np.array(read_rows(run_rrd, entity, "Scalars:scalars"))
    np.testing.assert_array_equal(rows[:, 0], POSE_CURVES[entity]())
    times_ns = read_times(run_rrd, entity) + RUN.start_ns
    np.testing.assert_array_equal(times_ns, RUN.poses.time_ns)


@pytest.mark.parametrize("entity", SAMPLE_CURVES)
def test_curves_hold_the_sample_columns_exactly(run_rrd: Path, entity: str) -> None:
    rows = np.array(read_rows(run_rrd, entity, "Scalars:scalars"))
    np.testing.assert_array_equal(rows[:, 0], SAMPLE_CURVES[entity]())
    times_ns = read_times(run_rrd, entity) + RUN.start_ns
    np.testing.assert_array_equal(times_ns, RUN.samples.time_ns)


def test_position_and_turtle_are_where_the_poses_are(run_rrd: Path) -> None:
    rows = np.array(read_rows(run_rrd, "/position", "Scalars:scalars"))
    np.testing.assert_array_equal(rows, RUN.poses.xy_m)
    places = np.array(read_rows(run_rrd, "/plane/turtle", "Transform3D:translation"))[:, 0]
    np.testing.assert_array_equal(places[:, :2], RUN.poses.xy_m)  # poses are 32-bit floats


def join_strips(path: Path, entity: str) -> NDArray[np.float64]:
    """Return the points of strips that begin where the last one ended."""
    strips = [np.array(strip) for strip in read_static(path, entity, "LineStrips2D:strips")]
    for before, after in pairwise(strips):
        np.testing.assert_array_equal(before[-1], after[0])
    return np.concatenate([strips[0], *(strip[1:] for strip in strips[1:])])


def test_the_trace_is_the_path_in_the_colours_of_its_phases(run_rrd: Path) -> None:
    np.testing.assert_array_equal(join_strips(run_rrd, "/plane/path"), RUN.poses.xy_m)
    colors = read_static(run_rrd, "/plane/path", "LineStrips2D:colors")
    before = [palette.NO_PHASE] if RUN.start_ns > RUN.poses.time_ns[0] else []
    phases = [*before, *(span.phase for span in RUN.find_phase_spans())]
    expected = palette.pack_colors([palette.TRACES[phase] for phase in phases])
    assert colors == expected.tolist()


def test_the_trace_by_speed_is_the_path_brightest_where_it_is_fast(run_rrd: Path) -> None:
    np.testing.assert_array_equal(join_strips(run_rrd, "/plane/path_by_speed"), RUN.poses.xy_m)
    colors = read_static(run_rrd, "/plane/path_by_speed", "LineStrips2D:colors")
    lengths = [len(s) for s in read_static(run_rrd, "/plane/path_by_speed", "LineStrips2D:strips")]
    # Most of the way it drives at the limit.
    assert colors[int(np.argmax(lengths[1:])) + 1] == palette.pack_colors(
        [palette.choose_run_colors(16)[-1]]
    )


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
    lines_ns = read_times(run_rrd, "/lines/event") + RUN.start_ns
    assert sorted(set(lines_ns.tolist())) == sorted(set(times_ns))
    levels = np.array(read_rows(run_rrd, "/lines/event", "Scalars:scalars"))[:, 0]
    assert np.nanmin(levels) < min(RUN.samples.turn_rate_rad_s.min(), -1.0)
    assert "/lines/event" in read_layout(run_rrd)["Speed [m/s]"]


def test_metrics_are_marked_where_they_are(run_rrd: Path) -> None:
    metrics = measure_run(RUN)
    labels = read_static(run_rrd, "/heading_deg/marks", "SeriesPoints:names")
    rows = np.array(read_rows(run_rrd, "/heading_deg/marks", "Scalars:scalars"))
    times_ns = read_times(run_rrd, "/heading_deg/marks")
    heading_deg = np.degrees(read_values("heading"))
    for number, name in enumerate(("settling_time", "overshoot", "rise_time")):
        metric = metrics[f"rotate.{name}"]
        assert metric.at_s is not None
        (row,) = np.flatnonzero(np.isfinite(rows[:, number]))
        assert times_ns[row] == round(metric.at_s * 1e9)
        assert f"{metric.value:.3g} {metric.unit}" in labels[number]
        level = np.interp(times_ns[row] + RUN.start_ns, RUN.poses.time_ns, heading_deg)
        assert rows[row, number] == pytest.approx(level)


def test_a_peak_is_marked_at_the_top_of_the_curve(run_rrd: Path) -> None:
    rows = np.array(read_rows(run_rrd, "/along_track/marks", "Scalars:scalars"))
    assert np.nanmax(rows[:, 1]) == read_values("along_track").max()


def test_the_ideal_response_stands_beside_the_heading(run_rrd: Path) -> None:
    rows = np.array(read_rows(run_rrd, "/heading_deg/ideal", "Scalars:scalars"))[:, 0]
    time_s = read_times(run_rrd, "/heading_deg/ideal") / 1e9
    bearing_deg = float(np.degrees(RUN.samples.bearing_rad[0]))
    np.testing.assert_allclose(rows, bearing_deg * (1.0 - np.exp(-10.0 * time_s)), atol=1e-5)


@pytest.mark.parametrize(("plot", "phase", "ticks"), [("heading_deg", 0, 4), ("along_track", 2, 6)])
def test_the_sampled_response_waits_for_the_dead_time(
    run_rrd: Path, plot: str, phase: int, ticks: int
) -> None:
    rows = np.array(read_rows(run_rrd, f"/{plot}/sampled", "Scalars:scalars"))[:, 0]
    times_ns = read_times(run_rrd, f"/{plot}/sampled") + RUN.start_ns
    assert times_ns[0] == next(s.start_ns for s in RUN.find_phase_spans() if s.phase == phase)
    assert set(np.diff(times_ns).tolist()) == {16_000_000}
    assert np.flatnonzero(np.diff(rows))[0] == ticks


def test_without_a_gain_there_is_no_response_of_theory(tmp_path: Path) -> None:
    write_run_rrd(replace(RUN, parameters={}), tmp_path / "run.rrd")
    assert not {name for name in list_entities(tmp_path / "run.rrd") if "ideal" in name}


@pytest.mark.parametrize(
    ("entity", "error"),
    [
        ("/heading_error_log10", lambda: np.degrees(read_values("heading_error"))),
        ("/distance_log10", lambda: read_values("distance")),
    ],
)
def test_errors_stand_on_a_logarithmic_scale_too(
    run_rrd: Path, entity: str, error: Callable[[], NDArray[np.float64]]
) -> None:
    rows = np.array(read_rows(run_rrd, entity, "Scalars:scalars"))[:, 0]
    np.testing.assert_allclose(10.0**rows, np.abs(error()), rtol=1e-12)


def test_an_error_of_zero_leaves_a_gap_on_the_logarithmic_scale(tmp_path: Path) -> None:
    goal_xy_m = tuple(RUN.poses.xy_m[100].tolist())
    write_run_rrd(replace(RUN, goal_xy_m=goal_xy_m), tmp_path / "run.rrd")
    rows = np.array(read_rows(tmp_path / "run.rrd", "/distance_log10", "Scalars:scalars"))[:, 0]
    assert np.isnan(rows[100])
    assert np.isfinite(rows[200:]).all()


def test_what_has_a_value_along_x_and_y_comes_in_pairs(run_rrd: Path) -> None:
    errors = np.array(read_rows(run_rrd, "/position_error", "Scalars:scalars"))
    np.testing.assert_array_equal(errors, np.array([2.0, 10.0]) - RUN.poses.xy_m)
    velocity = np.array(read_rows(run_rrd, "/world_velocity", "Scalars:scalars"))
    np.testing.assert_array_equal(velocity, RUN.samples.world_velocity_m_s)


def test_turtle_is_turned_by_its_heading(run_rrd: Path) -> None:
    turns = np.array(read_rows(run_rrd, "/plane/turtle", "Transform3D:quaternion"))[:, 0]
    heading_rad = 2.0 * np.arctan2(turns[:, 2], turns[:, 3])
    np.testing.assert_allclose(heading_rad, RUN.poses.heading_rad, atol=1e-6)


def test_references_lie_at_bearing_goal_and_limits(run_rrd: Path) -> None:
    bearing_deg = float(np.degrees(RUN.samples.bearing_rad[0]))
    expected = {
        "/reference/heading_deg": [bearing_deg],
        "/reference/heading_error_deg": [0.0],
        "/reference/position": [2.0, 10.0],
        "/reference/position_error": [0.0],
        "/reference/along_track": [float(np.hypot(*RUN.samples.error_xy_m[0]))],
        "/reference/cross_track": [0.0],
        "/reference/distance": [0.0],
        "/reference/speed": [-1.0, 1.0],
        "/reference/turn_rate": [-1.0, 1.0],
    }
    for entity, levels in expected.items():
        assert read_rows(run_rrd, entity, "Scalars:scalars") == [levels, levels]


def test_infinite_limits_draw_no_line(tmp_path: Path) -> None:
    limits = {"limits.speed_m_s": float("inf"), "limits.turn_rate_rad_s": float("inf")}
    write_run_rrd(replace(RUN, parameters={**RUN.parameters, **limits}), tmp_path / "run.rrd")
    assert not {"/reference/speed", "/reference/turn_rate"} & list_entities(tmp_path / "run.rrd")


def test_phases_change_where_the_spans_do_and_end_in_done(run_rrd: Path) -> None:
    states = [row[0] for row in read_rows(run_rrd, "/phase", "StateChange:state")]
    assert states == ["rotate", "pause", "translate", "done"]
    expected = [*(span.start_ns for span in RUN.find_phase_spans()), RUN.end_ns]
    assert (read_times(run_rrd, "/phase") + RUN.start_ns).tolist() == expected


def test_a_run_that_was_cut_does_not_end_in_done(tmp_path: Path) -> None:
    write_run_rrd(replace(RUN, stop_reason="max_duration"), tmp_path / "run.rrd")
    states = read_rows(tmp_path / "run.rrd", "/phase", "StateChange:state")
    assert [row[0] for row in states] == ["rotate", "pause", "translate", ""]


def test_events_are_listed_at_their_time(run_rrd: Path) -> None:
    texts = [row[0] for row in read_rows(run_rrd, "/events", "TextLog:text")]
    assert texts == [event.text for event in RUN.events]
    times_ns = read_times(run_rrd, "/events") + RUN.start_ns
    assert times_ns.tolist() == [event.time_ns for event in RUN.events]


def test_documents_are_kept_as_markdown(run_rrd: Path) -> None:
    entities = sorted(name for name in list_entities(run_rrd) if name.startswith("/documents/"))
    texts = {read_static(run_rrd, entity, "TextDocument:text")[0] for entity in entities}
    assert texts == set(DOCUMENTS.values())
    assert set(DOCUMENTS) < set(read_layout(run_rrd))


def test_properties_tell_the_recording_apart(run_rrd: Path) -> None:
    assert read_static(run_rrd, "/__properties", "RecordingInfo:name") == ["paper-kp10"]
    expected = {
        "name": "paper-kp10",
        "source": "simulation",
        "stop_reason": "standstill",
        "start_ns": RUN.start_ns,
    }
    found = {key: read_static(run_rrd, "/__properties/run", key)[0] for key in expected}
    assert found == expected


def test_scenario_and_metrics_are_properties(run_rrd: Path) -> None:
    for key, value in RUN.parameters.items():
        expected = float(value) if isinstance(value, bool | int | float) else str(value)
        assert read_static(run_rrd, "/__properties/scenario", key) == [expected]
    for name, metric in measure_run(RUN).items():
        (found,) = read_static(run_rrd, "/__properties/metrics", name)
        assert np.isnan(found) if metric.value is None else found == metric.value


def test_ticks_count_the_poses(run_rrd: Path) -> None:
    assert list_timelines(run_rrd) == {"sim_time", "tick"}
    ticks = read_times(run_rrd, "/plane/turtle", "tick", "Transform3D:translation")
    np.testing.assert_array_equal(ticks, np.arange(len(RUN.poses)))
    at = read_times(run_rrd, "/speed/commanded", "tick")
    np.testing.assert_array_equal(RUN.poses.time_ns[at], RUN.samples.time_ns)


def test_an_imported_run_has_wall_time(tmp_path: Path) -> None:
    path, stamp = tmp_path / "run.rrd", "2026-01-22T12:20:06.020038001Z"
    write_run_rrd(replace(RUN, notes={"original_timestamp": stamp}), path)
    times_ns = read_times(path, "/distance", "wall_time")
    start_ns = int(np.datetime64(stamp.rstrip("Z"), "ns").astype(np.int64))
    np.testing.assert_array_equal(times_ns - start_ns, RUN.poses.time_ns)


def test_the_metrics_are_a_document_with_their_places(tmp_path: Path) -> None:
    write_run_rrd(RUN, tmp_path / "run.rrd")
    (text,) = read_static(tmp_path / "run.rrd", "/documents/Metrics", "TextDocument:text")
    assert "| settling time | 2.2139 | s | 2.214 |" in text
    assert "No decay ratio: " in text
    (scenario,) = read_static(tmp_path / "run.rrd", "/documents/Scenario", "TextDocument:text")
    assert "**law**" in scenario
    assert "| kp_linear | 10.0 |" in scenario


def test_recording_verifies_and_stays_small(run_rrd: Path) -> None:
    verify(run_rrd)
    assert run_rrd.stat().st_size < 2_000_000


def test_every_view_of_the_layout_has_data(run_rrd: Path) -> None:
    entities = list_entities(run_rrd)
    layout = read_layout(run_rrd)
    assert {"Plane", "Heading [deg]", "Speed [m/s]", "Phases (brown: pause)"} < set(layout)
    named = {path for paths in layout.values() for path in paths if "*" not in path}
    assert {path.removeprefix("- ") for path in named} <= entities


def test_columns_that_a_log_lacks_are_left_out(tmp_path: Path) -> None:
    samples = replace(RUN.samples, wanted_speed_m_s=None, wanted_turn_rate_rad_s=None)
    poses = replace(RUN.poses, speed_m_s=None, turn_rate_rad_s=None)
    write_run_rrd(replace(RUN, samples=samples, poses=poses), tmp_path / "run.rrd")
    curves = {name for name in list_entities(tmp_path / "run.rrd") if "speed" in name}
    drawn = {"/speed/commanded", "/speed/marks", "/reference/speed", "/plane/path_by_speed"}
    assert curves == drawn


def test_a_run_without_samples_shows_what_it_holds(tmp_path: Path) -> None:
    run, path = make_foreign_run(300), tmp_path / "bag.rrd"
    write_run_rrd(run, path)
    verify(path)
    views = {"Plane", "Heading [deg]", "Turn rate [rad/s]", "Position [m]", "Speed [m/s]"}
    views |= {"Metrics", "Scenario", "By speed, 0 to 0.333 m/s"}
    assert set(read_layout(path)) == views
    rows = np.array(read_rows(path, "/speed/commanded", "Scalars:scalars"))
    np.testing.assert_array_equal(rows[:, 0], run.commands.speed_m_s)


def test_a_single_pose_shows_the_plane_alone(tmp_path: Path) -> None:
    write_run_rrd(make_foreign_run(1), tmp_path / "run.rrd")
    verify(tmp_path / "run.rrd")
    assert set(read_layout(tmp_path / "run.rrd")) == {"Plane", "Metrics", "Scenario"}


def test_a_path_outside_the_world_has_no_border(tmp_path: Path) -> None:
    write_run_rrd(make_foreign_run(300), tmp_path / "run.rrd")
    assert "/plane/border" not in list_entities(tmp_path / "run.rrd")


def test_a_new_recording_replaces_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    for name in ("first", "second"):
        write_run_rrd(replace(make_foreign_run(2), name=name), path)
    assert read_static(path, "/__properties", "RecordingInfo:name") == ["second"]
    assert list(tmp_path.iterdir()) == [path]


def cut_samples(count: int) -> SampleColumns:
    columns = RUN.samples.__dataclass_fields__
    return replace(
        RUN.samples, **{name: getattr(RUN.samples, name)[:count].copy() for name in columns}
    )


def cut_after(count: int) -> Run:
    """Return a run that was cut while rotating, at its nth pose."""
    columns = RUN.poses.__dataclass_fields__
    poses = replace(
        RUN.poses, **{name: getattr(RUN.poses, name)[:count].copy() for name in columns}
    )
    end_ns = poses.time_ns[-1]
    samples = cut_samples(int(np.searchsorted(RUN.samples.time_ns, end_ns)))
    rows = RUN.commands.time_ns <= end_ns
    names = RUN.commands.__dataclass_fields__
    commands = replace(RUN.commands, **{name: getattr(RUN.commands, name)[rows] for name in names})
    return replace(
        RUN,
        poses=poses,
        samples=samples,
        commands=commands,
        events=(),
        stop_reason="max_duration",
    )


def test_a_run_with_one_sample_works(tmp_path: Path) -> None:
    write_run_rrd(replace(RUN, samples=cut_samples(1)), tmp_path / "run.rrd")
    verify(tmp_path / "run.rrd")
    assert "/speed/commanded" not in list_entities(tmp_path / "run.rrd")


def test_a_run_that_never_reaches_its_goal_works(tmp_path: Path) -> None:
    cut = cut_after(100)
    write_run_rrd(cut, tmp_path / "run.rrd")
    verify(tmp_path / "run.rrd")
    assert "/along_track/marks" not in list_entities(tmp_path / "run.rrd")
    (text,) = read_static(tmp_path / "run.rrd", "/documents/Metrics", "TextDocument:text")
    assert "the run has no phase translate" in text


def test_long_tables_are_sent_in_chunks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_stream, "CHUNK_ROWS", 100)
    write_run_rrd(RUN, tmp_path / "run.rrd")
    assert count_chunks(tmp_path / "run.rrd", "/distance") == -(-len(RUN.poses) // 100)
    rows = np.array(read_rows(tmp_path / "run.rrd", "/distance", "Scalars:scalars"))[:, 0]
    np.testing.assert_array_equal(rows, read_values("distance"))
    times_ns = read_times(tmp_path / "run.rrd", "/distance") + RUN.start_ns
    np.testing.assert_array_equal(times_ns, RUN.poses.time_ns)


def test_what_is_too_long_is_thinned_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.rrd"
    monkeypatch.setattr(run_stream, "MOST_ROWS", 500)
    monkeypatch.setattr(run_stream, "THINNED_ROWS", 90)
    write_run_rrd(RUN, path)
    verify(path)
    rows = np.array(read_rows(path, "/turn_rate/commanded", "Scalars:scalars"))[:, 0]
    commanded = RUN.samples.turn_rate_rad_s
    assert len(rows) <= 91
    assert (rows.min(), rows.max()) == (commanded.min(), commanded.max())
    (text,) = read_static(path, "/documents/Drawn", "TextDocument:text")
    assert f"about 90 of up to {len(RUN.poses)} rows" in text


def test_a_long_trace_is_thinned_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_stream, "TRACE_ROWS", 100)
    write_run_rrd(RUN, tmp_path / "run.rrd")
    trace = join_strips(tmp_path / "run.rrd", "/plane/path")
    assert len(trace) <= 101
    np.testing.assert_array_equal(trace.min(axis=0), RUN.poses.xy_m.min(axis=0))
    (text,) = read_static(tmp_path / "run.rrd", "/documents/Drawn", "TextDocument:text")
    assert "about 100 of" in text
