from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

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
from turtlelog.draw import write_comparison_rrd, write_run_rrd
from turtlelog.errors import ShowError
from turtlelog.measure import measure_run, read_signal
from turtlelog.run import Run
from turtlelog.scenario import PAPER_RUNS

CURVES = ("heading_error_deg", "along_track", "distance", "speed/commanded", "turn_rate/commanded")


@pytest.mark.parametrize("name", PAPER_RUNS)
def test_runs_are_aligned_at_their_first_sample(comparison_rrd: Path, name: str) -> None:
    run = simulate_preset(name)
    poses_ns = read_times(comparison_rrd, f"/runs/{name}/distance")
    np.testing.assert_array_equal(poses_ns + run.start_ns, run.poses.time_ns)
    samples_ns = read_times(comparison_rrd, f"/runs/{name}/speed/commanded")
    assert samples_ns[0] == 0
    np.testing.assert_array_equal(samples_ns + run.start_ns, run.samples.time_ns)


@pytest.mark.parametrize("name", PAPER_RUNS)
@pytest.mark.parametrize("signal_name", ["along_track", "cross_track", "distance"])
def test_curves_hold_the_signals_exactly(comparison_rrd: Path, name: str, signal_name: str) -> None:
    signal = read_signal(simulate_preset(name), signal_name)
    rows = read_rows(comparison_rrd, f"/runs/{name}/{signal_name}", "Scalars:scalars")
    np.testing.assert_array_equal(np.array(rows)[:, 0], signal.values)


@pytest.mark.parametrize("name", PAPER_RUNS)
def test_commands_are_the_samples_exactly(comparison_rrd: Path, name: str) -> None:
    samples = simulate_preset(name).samples
    rows = read_rows(comparison_rrd, f"/runs/{name}/turn_rate/commanded", "Scalars:scalars")
    np.testing.assert_array_equal(np.array(rows)[:, 0], samples.turn_rate_rad_s)


def test_a_run_has_one_colour_in_all_views(comparison_rrd: Path) -> None:
    colors: list[int] = []
    for name in PAPER_RUNS:
        prefix = f"/runs/{name}"
        (faint,) = read_static(comparison_rrd, f"{prefix}/plane/path", "LineStrips2D:colors")
        of_run = {
            faint | 255,
            *read_static(comparison_rrd, f"{prefix}/plane/turtle", "Points2D:colors"),
            *read_static(comparison_rrd, f"{prefix}/plane/turtle/arrow", "Arrows2D:colors"),
        }
        for curve in CURVES:
            of_run.update(read_static(comparison_rrd, f"{prefix}/{curve}", "SeriesLines:colors"))
        assert len(of_run) == 1
        colors += of_run
    assert len(set(colors)) == len(PAPER_RUNS)


def test_curves_are_named_after_their_run(comparison_rrd: Path) -> None:
    for name in PAPER_RUNS:
        for curve in CURVES:
            entity = f"/runs/{name}/{curve}"
            assert read_static(comparison_rrd, entity, "SeriesLines:names") == [name]


def test_every_run_has_a_row_of_phases(comparison_rrd: Path) -> None:
    entities = [f"/phase/{name}" for name in PAPER_RUNS]
    assert read_layout(comparison_rrd)["Phases (brown: pause)"] == entities
    for entity in entities:
        states = [row[0] for row in read_rows(comparison_rrd, entity, "StateChange:state")]
        assert states == ["rotate", "pause", "translate", "done"]


def test_events_name_their_run(comparison_rrd: Path) -> None:
    texts = [row[0] for row in read_rows(comparison_rrd, "/runs/paper-kp4/events", "TextLog:text")]
    events = simulate_preset("paper-kp4").events
    assert texts == [f"paper-kp4: {event.text}" for event in events]


def test_properties_list_the_runs(comparison_rrd: Path) -> None:
    runs = [simulate_preset(name) for name in PAPER_RUNS]
    expected = {
        "name": list(PAPER_RUNS),
        "entity": [f"/runs/{name}" for name in PAPER_RUNS],
        "source": ["simulation"] * 4,
        "stop_reason": [run.stop_reason for run in runs],
        "start_ns": [run.start_ns for run in runs],
    }
    found = {key: read_static(comparison_rrd, "/__properties/runs", key) for key in expected}
    assert found == expected
    gains = read_static(comparison_rrd, "/__properties/scenario", "law.kp_linear")
    assert gains == [1.0, 2.0, 4.0, 10.0]
    errors_m = read_static(comparison_rrd, "/__properties/metrics", "final.position_error")
    assert errors_m == [measure_run(run)["final.position_error"].value for run in runs]


def test_a_parameter_that_some_runs_lack_is_nan_or_empty(tmp_path: Path) -> None:
    run, path = simulate_preset("paper-kp10"), tmp_path / "two.rrd"
    write_comparison_rrd([run, replace(run, parameters={})], path)
    assert str(read_static(path, "/__properties/scenario", "law.kp_linear")) == "[10.0, nan]"
    assert read_static(path, "/__properties/scenario", "law.projection") == ["bearing", ""]


@pytest.mark.thorough
def test_a_parameter_may_be_text_in_one_file_and_a_number_in_the_next(tmp_path: Path) -> None:
    run, path = simulate_preset("paper-kp10"), tmp_path / "odd.rrd"
    for value, found in (("high", "high"), (3, 3.0), (True, 1.0), ([1, 2], "[1, 2]")):
        write_run_rrd(replace(run, parameters={"law.strength": value}), path)
        assert read_static(path, "/__properties/scenario", "law.strength") == [found]


@pytest.mark.parametrize("name", PAPER_RUNS)
def test_a_second_timeline_starts_where_translation_does(comparison_rrd: Path, name: str) -> None:
    run, entity = simulate_preset(name), f"/phase/{name}"
    states = [row[0] for row in read_rows(comparison_rrd, entity, "StateChange:state")]
    times_ns = read_times(comparison_rrd, entity, "translate_time")
    assert times_ns[states.index("translate")] == 0
    speeds_ns = read_times(comparison_rrd, f"/runs/{name}/speed/commanded", "translate_time")
    offset_ns = read_times(comparison_rrd, entity)[states.index("translate")]
    np.testing.assert_array_equal(speeds_ns + offset_ns + run.start_ns, run.samples.time_ns)


def test_a_run_without_translation_is_not_on_that_timeline(tmp_path: Path) -> None:
    path = tmp_path / "bags.rrd"
    write_comparison_rrd([make_foreign_run(300)], path)
    assert list_timelines(path) == {"sim_time"}


def test_levels_reach_over_all_runs_on_both_timelines(comparison_rrd: Path) -> None:
    for timeline in ("sim_time", "translate_time"):
        first, last = read_times(comparison_rrd, "/reference/speed", timeline)
        for name in PAPER_RUNS:
            times_ns = read_times(comparison_rrd, f"/runs/{name}/distance", timeline)
            assert first <= times_ns[0]
            assert times_ns[-1] < last


def test_table_1_and_the_table_across_gains_are_documents(tmp_path: Path) -> None:
    path = tmp_path / "four.rrd"
    write_comparison_rrd([simulate_preset(name) for name in PAPER_RUNS], path)
    assert {"Table 1", "Side by side", "Metrics"} < set(read_layout(path))
    (text,) = read_static(path, "/documents/Side\\ by\\ side", "TextDocument:text")
    assert all(f"| {name} |" in text for name in PAPER_RUNS)


def test_recording_verifies_and_stays_small(comparison_rrd: Path) -> None:
    verify(comparison_rrd)
    assert list_timelines(comparison_rrd) == {"sim_time", "translate_time"}
    assert comparison_rrd.stat().st_size < 2_000_000


def test_the_layout_has_its_views(comparison_rrd: Path) -> None:
    views = {"Plane", "At the goal, ±150 mm", "Along-track [m]", "Table 1"}
    assert views < set(read_layout(comparison_rrd))


def test_a_turtle_shows_from_its_first_pose_on(comparison_rrd: Path) -> None:
    for name in PAPER_RUNS:
        (first_ns, *more_ns) = read_times(
            comparison_rrd, f"/runs/{name}/plane/turtle", component="Points2D:positions"
        )
        run = simulate_preset(name)
        assert (first_ns + run.start_ns, more_ns) == (run.poses.time_ns[0], [])


def move(run: Run, way_m: float) -> Run:
    return replace(run, poses=replace(run.poses, xy_m=run.poses.xy_m + way_m))


def test_runs_of_one_name_are_told_apart(tmp_path: Path) -> None:
    run, path = simulate_preset("paper-kp10"), tmp_path / "same.rrd"
    others = [move(run, 0.1), replace(move(run, 0.2), name="run")]
    write_comparison_rrd([run, *others], path)
    names = read_static(path, "/__properties/runs", "name")
    assert names == ["paper-kp10 (1)", "paper-kp10 (2)", "run"]
    entities = read_static(path, "/__properties/runs", "entity")
    assert {f"{entity}/plane/path" for entity in entities} < list_entities(path)


@pytest.mark.thorough
def test_names_need_not_be_entity_paths(tmp_path: Path) -> None:
    run, path = simulate_preset("paper-kp10"), tmp_path / "odd.rrd"
    names = ["a/b", "Läufer 🐢", "- x", "$origin/**"]
    runs = [replace(move(run, 0.1 * step), name=name) for step, name in enumerate(names)]
    write_comparison_rrd(runs, path)
    verify(path)
    for entity in read_static(path, "/__properties/runs", "entity"):
        assert len(read_rows(path, f"{entity}/distance", "Scalars:scalars")) == len(run.poses)


@pytest.mark.thorough
def test_twenty_runs_have_colours_and_a_legend_of_their_own(tmp_path: Path) -> None:
    run, path = simulate_preset("paper-kp10"), tmp_path / "many.rrd"
    names = [f"kp{number}" for number in range(20)]
    runs = [replace(move(run, 0.01 * step), name=name) for step, name in enumerate(names)]
    write_comparison_rrd(runs, path)
    assert read_static(path, "/legend", "Points2D:labels") == names
    assert len(set(read_static(path, "/legend", "Points2D:colors"))) == 20
    assert "Runs" in read_layout(path)


def test_runs_stand_in_the_order_of_their_gains_however_they_were_given(
    comparison_rrd: Path, tmp_path: Path
) -> None:
    path, runs = tmp_path / "sorted.rrd", [simulate_preset(name) for name in sorted(PAPER_RUNS)]
    write_comparison_rrd(runs, path)
    assert read_static(path, "/__properties/runs", "name") == list(PAPER_RUNS)
    for name in PAPER_RUNS:
        entity, component = f"/runs/{name}/distance", "SeriesLines:colors"
        expected = read_static(comparison_rrd, entity, component)
        assert read_static(path, entity, component) == expected


def test_runs_without_samples_show_their_position(tmp_path: Path) -> None:
    path = tmp_path / "bags.rrd"
    write_comparison_rrd([make_foreign_run(300), make_foreign_run(1)], path)
    verify(path)
    assert "Position [m]" in read_layout(path)
    rows = np.array(read_rows(path, "/runs/bag_1/position", "Scalars:scalars"))
    np.testing.assert_array_equal(rows, make_foreign_run(300).poses.xy_m)


def test_no_runs_are_an_error(tmp_path: Path) -> None:
    with pytest.raises(ShowError, match="at least one run"):
        write_comparison_rrd([], tmp_path / "none.rrd")
    assert not list(tmp_path.iterdir())
