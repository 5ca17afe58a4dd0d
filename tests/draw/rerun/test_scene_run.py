from dataclasses import replace
from pathlib import Path

import numpy as np

from tests.draw.rerun.conftest import DOCUMENTS
from tests.draw.rerun.rrds import (
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
from turtlelog.display import parse_utc
from turtlelog.draw import write_run_rrd
from turtlelog.measure import measure_run
from turtlelog.run import Origin

RUN = simulate_preset("paper-kp10")


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
    """The file is searched for each of some 200 keys."""
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
    write_run_rrd(replace(RUN, origin=Origin(began_ns=parse_utc(stamp))), path)
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


def test_the_layout_has_its_views(run_rrd: Path) -> None:
    views = {
        "Plane (pink: to the goal, yellow: command)",
        "Heading [deg]",
        "Speed [m/s]",
        "Phases (brown: pause)",
    }
    assert views < set(read_layout(run_rrd))


def test_a_new_recording_replaces_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    for name in ("first", "second"):
        write_run_rrd(replace(make_foreign_run(2), name=name), path)
    assert read_static(path, "/__properties", "RecordingInfo:name") == ["second"]
    assert list(tmp_path.iterdir()) == [path]
