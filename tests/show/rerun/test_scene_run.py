from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.show.rerun.conftest import DOCUMENTS
from tests.show.rerun.rrds import (
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
from turtlelog.measure import read_signal
from turtlelog.run import Run
from turtlelog.show import write_run_rrd

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
    path = np.array(read_static(run_rrd, "/plane/path", "LineStrips2D:strips")[0])
    np.testing.assert_array_equal(path, RUN.poses.xy_m)


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
        "law.kp_angular": 10.0,
        "law.kp_linear": 10.0,
    }
    found = {key: read_static(run_rrd, "/__properties/run", key)[0] for key in expected}
    assert found == expected


def test_time_is_simulated_time_only(run_rrd: Path) -> None:
    assert list_timelines(run_rrd) == {"sim_time"}


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
    assert curves == {"/speed/commanded", "/reference/speed"}


def test_a_run_without_samples_shows_what_it_holds(tmp_path: Path) -> None:
    run, path = make_foreign_run(300), tmp_path / "bag.rrd"
    write_run_rrd(run, path)
    verify(path)
    views = {"Plane", "Heading [deg]", "Turn rate [rad/s]", "Position [m]", "Speed [m/s]"}
    views |= {"Metrics", "Scenario"}
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


def build_single_sample_run() -> Run:
    samples = {
        name: getattr(RUN.samples, name)[:1].copy() for name in RUN.samples.__dataclass_fields__
    }
    return replace(RUN, samples=replace(RUN.samples, **samples))


def test_a_run_with_one_sample_works(tmp_path: Path) -> None:
    write_run_rrd(build_single_sample_run(), tmp_path / "run.rrd")
    verify(tmp_path / "run.rrd")
    assert "/speed/commanded" not in list_entities(tmp_path / "run.rrd")
