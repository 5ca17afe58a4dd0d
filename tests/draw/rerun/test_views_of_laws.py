"""Recordings of runs of other laws: what they declare is shown, and nothing else."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.draw.laws import KINDS, add_terms, forget_loops, simulate_law
from tests.draw.rerun.rrds import (
    list_entities,
    list_timelines,
    make_attribution,
    read_blueprint_parts,
    read_layout,
    read_rows,
    read_static,
    read_times,
    simulate_preset,
    verify,
)
from turtlelog.charts import palette
from turtlelog.charts.time_plots import name_phase_timeline
from turtlelog.draw import write_comparison_rrd, write_explanation_rrd, write_run_rrd
from turtlelog.draw.rerun.plane import find_plane_bounds
from turtlelog.draw.rerun.recording_stream import build_compared_timelines
from turtlelog.measure import measure_run
from turtlelog.run import Run
from turtlelog.run.loops import Declaration

STRANGE, EXAMPLE = simulate_law("strange"), simulate_law("example")
FOLLOWER = simulate_law("Follower")
assert FOLLOWER.samples.reference_xy_m is not None
REFERENCE_XY_M = FOLLOWER.samples.reference_xy_m
KP10 = simulate_preset("paper-kp10")
TABS = 1
"""Rerun's number of a container of tabs."""


@cache
def write(kind: str) -> Path:
    """Write a run of a law; the tests only read."""
    path = Path(mkdtemp()) / f"{kind}.rrd"
    write_run_rrd(simulate_law(kind), path)
    return path


def read_curve(path: Path, entity: str) -> NDArray[np.float64]:
    return np.array(read_rows(path, entity, "Scalars:scalars"), dtype=np.float64)


@pytest.mark.everyday("strange", "OpenLoop")
@pytest.mark.parametrize("kind", KINDS)
def test_runs_of_every_law_make_sound_recordings(kind: str) -> None:
    verify(write(kind))
    text = read_static(write(kind), "/documents/Metrics", "TextDocument:text")[0]
    for loop in ("Rotate", "Translate"):
        assert loop not in text


def test_runs_of_laws_of_all_kinds_stand_beside_each_other(laws_rrd: Path) -> None:
    verify(laws_rrd)
    views = read_layout(laws_rrd)
    assert {"State memory", "State left", "Heading [deg]", "Distance [m]"} <= set(views)
    assert views["State memory"] == ["/runs/strange/state/memory"]


def test_phases_are_named_as_declared_and_coloured_in_their_order() -> None:
    values = read_static(write("strange"), "/phase", "StateConfiguration:values")
    colors = read_static(write("strange"), "/phase", "StateConfiguration:colors")
    assert values == ["one", "two", "pause", "done"]
    bars = [(46, 96, 148), (20, 110, 84), (140, 70, 20), (90, 90, 90)]
    assert colors == palette.pack_colors(bars).tolist()
    states = [row[0] for row in read_rows(write("strange"), "/phase", "StateChange:state")]
    assert states == ["one", "pause", "two", "done"]


def test_eight_phases_have_eight_colours_and_more_begin_again() -> None:
    found = palette.choose_phase_colors([*"abcdefgh", "pause", "i", "done"])
    assert len(set(found)) == 10
    assert found[9] == found[0]


def test_a_moving_reference_is_drawn_where_it_is_recorded() -> None:
    samples = STRANGE.samples
    assert samples.reference_heading_rad is not None
    assert samples.reference_xy_m is not None
    expected = np.degrees(samples.reference_heading_rad)
    assert np.isnan(expected).any()
    reference = read_curve(write("strange"), "/heading_deg/reference")[:, 0]
    np.testing.assert_allclose(reference, expected, atol=1e-9)
    pair = read_curve(write("strange"), "/position/reference")
    np.testing.assert_array_equal(pair, samples.reference_xy_m)
    times_ns = read_times(write("strange"), "/heading_deg/reference") + STRANGE.start_ns
    np.testing.assert_array_equal(times_ns, samples.time_ns)
    assert "/reference/heading_deg" not in list_entities(write("strange"))


def test_the_reference_pose_is_an_arrow_in_the_plane_while_there_is_one() -> None:
    known = np.isfinite(REFERENCE_XY_M[:, 0])
    origins = read_rows(write("Follower"), "/plane/reference_pose", "Arrows2D:origins")
    assert [bool(row) for row in origins] == known.tolist()
    assert not known.all()
    expected = REFERENCE_XY_M[known]
    np.testing.assert_allclose([row[0] for row in origins if row], expected, rtol=1e-6)
    strips = read_static(write("Follower"), "/plane/reference_path", "LineStrips2D:strips")
    np.testing.assert_allclose(np.concatenate(strips), expected, rtol=1e-6)


def test_headings_asked_for_are_near_those_of_a_robot_that_has_turned_around() -> None:
    poses = STRANGE.poses
    heading_deg = np.degrees(np.unwrap(poses.heading_rad))[STRANGE.samples.pose_sequence]
    reference = read_curve(write("strange"), "/heading_deg/reference")[:, 0]
    assert np.nanmax(np.abs(reference - heading_deg)) < 180.0


def test_the_bearing_from_the_present_position_is_a_curve() -> None:
    bearings = read_curve(write("example"), "/heading_deg/reference")[:, 0]
    assert EXAMPLE.goal_xy_m is not None
    away = np.array(EXAMPLE.goal_xy_m) - EXAMPLE.poses.xy_m
    np.testing.assert_allclose(bearings, np.degrees(np.arctan2(away[:, 1], away[:, 0])), atol=1e-9)
    entities = list_entities(write("example"))
    assert "/heading_deg/ideal" not in entities
    assert "/reference/heading_deg" not in entities


def test_theory_stands_beside_the_distance_that_a_loop_controls() -> None:
    ideal = read_curve(write("strange"), "/distance/ideal")[:, 0]
    times_ns = read_times(write("strange"), "/distance/ideal") + STRANGE.start_ns
    two = next(span for span in STRANGE.find_phase_spans() if span.phase == "two")
    assert times_ns[0] == two.start_ns
    decay = ideal[0] * np.exp(-(times_ns - two.start_ns) / 1e9)
    np.testing.assert_allclose(ideal, decay, atol=1e-8)
    assert "/along_track/ideal" not in list_entities(write("strange"))


def test_a_loop_with_an_integral_has_its_levels_and_no_response_of_theory(tmp_path: Path) -> None:
    write_run_rrd(KP10, tmp_path / "p.rrd")
    write_run_rrd(add_terms(KP10), tmp_path / "pid.rrd")
    of_p, of_pid = list_entities(tmp_path / "p.rrd"), list_entities(tmp_path / "pid.rrd")
    ghosts = {name for name in of_p if name.startswith(("/ideal_loop/", "/plane/names/key"))}
    lines = {name for name in of_p if name.endswith(("/ideal", "/sampled"))}
    assert {"/heading_deg/ideal", "/along_track/ideal", "/along_track/sampled"} < lines
    assert of_p - of_pid == lines | ghosts
    assert of_pid < of_p


def test_loops_that_follow_have_no_response_of_theory() -> None:
    entities = list_entities(write("Follower"))
    ideal = {entity for entity in entities if "ideal" in entity}
    assert ideal == {"/heading_deg/ideal", "/heading_error_deg/ideal", "/heading_error_log10/ideal"}
    assert {"/along_track/reference", "/distance/to_reference"} <= entities


def test_the_distance_that_a_loop_controls_is_the_one_to_its_reference() -> None:
    away = REFERENCE_XY_M - FOLLOWER.poses.xy_m[FOLLOWER.samples.pose_sequence]
    drawn = read_curve(write("Follower"), "/distance/to_reference")[:, 0]
    np.testing.assert_allclose(drawn, np.hypot(*away.T))
    largest = measure_run(FOLLOWER)["near.largest_error"]
    marks = read_curve(write("Follower"), "/distance/marks")
    assert largest.value in marks[np.isfinite(marks)].tolist()
    labels = " ".join(read_static(write("Follower"), "/distance/marks", "SeriesPoints:names"))
    assert f"furthest off {largest.value:.3g} m" in labels


def test_marks_of_loops_that_share_a_command_say_whose_they_are() -> None:
    fast = simulate_law("Follower", **{"law.gain": 12.0})
    path = Path(mkdtemp()) / "fast.rrd"
    write_run_rrd(fast, path)
    labels = " ".join(read_static(path, "/speed/marks", "SeriesPoints:names"))
    assert "near saturated for" in labels
    assert "along saturated for" in labels


def test_states_of_a_law_have_views_of_their_own() -> None:
    assert STRANGE.samples.states is not None
    drawn = read_curve(write("strange"), "/state/memory")[:, 0]
    np.testing.assert_array_equal(drawn, STRANGE.samples.states[:, 0])
    views = read_layout(write("EightPhases"))
    states = {name for name in views if name.startswith("State ")}
    assert states == {"State left", "State seen", "State worn", "State old"}


def test_a_run_without_a_goal_shows_none() -> None:
    entities = list_entities(write("OpenLoop"))
    of_goal = ("goal", "error", "distance", "track", "names", "/reference/position", "close_up")
    assert not {name for name in entities if any(word in name for word in of_goal)}
    assert {"/heading_deg", "/position", "/phase", "/speed/commanded"} <= entities


def test_a_heading_that_nothing_controls_has_no_level() -> None:
    entities = list_entities(write("EightPhases"))
    assert "/reference/heading_deg" not in entities
    assert "/reference/along_track" in entities


def test_of_a_law_whose_loops_are_not_known_the_geometry_is_drawn(tmp_path: Path) -> None:
    run = forget_loops(EXAMPLE)
    write_run_rrd(run, tmp_path / "run.rrd")
    assert run.goal_line is not None
    levels = read_rows(tmp_path / "run.rrd", "/reference/heading_deg", "Scalars:scalars")
    assert levels[0] == [float(np.degrees(run.goal_line.bearing_rad))]
    entities = list_entities(tmp_path / "run.rrd")
    assert not {name for name in entities if "ideal" in name or "bearing_now" in name}


def test_only_an_error_that_is_left_is_a_close_up() -> None:
    assert "Heading error, close up [deg]" in read_layout(write("strange"))
    for kind in ("example", "Follower", "EightPhases"):
        assert "Heading error [deg]" in read_layout(write(kind))


def test_the_view_that_opens_is_of_what_a_loop_controls() -> None:
    views = read_layout(write("strange"))
    assert views["Distance [m]"][:2] == ["/distance/ideal", "/distance"]


def test_each_later_phase_is_the_zero_of_a_timeline(laws_rrd: Path) -> None:
    of_eight = {f"{phase}_time" for phase in "cdefgh"} | {"phase.wall_time"}
    names = {"sim_time", "translate_time", "two_time", "follow_time", *of_eight}
    assert list_timelines(laws_rrd) == names
    times_ns = read_times(laws_rrd, "/runs/strange/heading_deg", "two_time")
    two = next(span for span in STRANGE.find_phase_spans() if span.phase == "two")
    np.testing.assert_array_equal(times_ns + two.start_ns, STRANGE.poses.time_ns)


def test_a_law_of_one_phase_needs_no_other_timeline(tmp_path: Path) -> None:
    write_comparison_rrd([EXAMPLE, simulate_law("OpenLoop")], tmp_path / "one.rrd")
    assert list_timelines(tmp_path / "one.rrd") == {"sim_time"}


@pytest.mark.parametrize("phase", ["sim", "wall"])
def test_no_phase_takes_the_name_of_another_timeline(phase: str) -> None:
    assert name_phase_timeline(phase) == f"phase.{phase}_time"
    assert name_phase_timeline(f"{phase}2") == f"{phase}2_time"


def test_tables_have_rows_of_the_loops_that_the_runs_have(laws_rrd: Path) -> None:
    text = read_static(laws_rrd, "/documents/Metrics", "TextDocument:text")[0]
    rows = [row.split(" | ") for row in text.splitlines() if row.startswith("| ")]
    groups = list(dict.fromkeys(row[0].removeprefix("| ").partition(".")[0] for row in rows[2:]))
    assert set(groups) == {"rotate", "translate", "a", "b", "align", "approach", "creep"} | {
        *("near", "along", "straight", "final", "run")
    }
    heads = [head.strip(" |") for head in rows[0]]
    (row,) = [row for row in rows if row[0] == "| rotate.overshoot"]
    cells = dict(zip(heads, (cell.strip(" |") for cell in row), strict=True))
    assert cells["paper-kp10"] != "-"
    assert {cells[name] for name in KINDS} == {"-"}


def test_a_metric_that_some_laws_do_not_have_is_nan_for_them(laws_rrd: Path) -> None:
    names = read_static(laws_rrd, "/__properties/runs", "name")
    overshoot = read_static(laws_rrd, "/__properties/metrics", "rotate.overshoot")
    known = dict(zip(names, overshoot, strict=True))
    assert known["paper-kp10"] == measure_run(KP10)["rotate.overshoot"].value
    assert all(np.isnan(known[kind]) for kind in KINDS)


def test_an_explanation_is_of_a_metric_that_the_law_has(tmp_path: Path) -> None:
    without = {"hesitation": simulate_law("strange", **{"law.hesitates_ticks": 0})}
    path, metric = tmp_path / "why.rrd", "b.settling_time"
    found = make_attribution(STRANGE, {"hesitation": 0.2}, metric)
    write_explanation_rrd(STRANGE, found, without, path)
    verify(path)
    assert f"Why {metric} is {found.resimulated:.3f} s" in read_layout(path)
    assert "/runs/recorded/lines/pause" in list_entities(path)


def test_loops_that_begin_together_share_a_bar_of_dead_time(tmp_path: Path) -> None:
    delays = {"loop.transport_delay_ticks": 3}
    late = simulate_law("example", **delays)
    found = make_attribution(late, {"delay": 0.1})
    write_explanation_rrd(late, found, {"delay": EXAMPLE}, tmp_path / "why.rrd")
    times_ns = read_times(tmp_path / "why.rrd", "/phase/recorded_dead_time")
    assert times_ns.tolist() == [0, 48_000_000]


def name_phases(count: int) -> Run:
    """Return a run that passes through so many phases."""
    run = simulate_law("OpenLoop")
    phase = np.minimum(np.arange(len(run.samples)) // 5, count - 1)
    declaration = Declaration(phases={f"p{number}": () for number in range(count)}, uses_goal=False)
    return replace(run, declaration=declaration, samples=replace(run.samples, phase=phase))


@pytest.mark.parametrize(("phases", "timelines"), [(1, 0), (2, 1), (9, 8), (10, 8)])
def test_up_to_eight_later_phases_have_a_timeline(phases: int, timelines: int) -> None:
    starts_ns = build_compared_timelines(name_phases(phases)).starts_ns
    assert list(starts_ns) == [f"p{number}_time" for number in range(1, 1 + timelines)]


@pytest.mark.parametrize(
    ("count", "largest", "tabs"), [(0, 1.0, 0), (3, 21.0, 0), (4, 19.0, 0), (4, 21.0, 1)]
)
def test_up_to_three_states_stand_beside_each_other_and_more_over_each_other_or_as_tabs(
    count: int, largest: float, tabs: int, tmp_path: Path
) -> None:
    run = simulate_law("OpenLoop")
    declaration = replace(run.declaration, states=tuple("abcd"[:count]))
    states = np.ones((len(run.samples), count)) if count else None
    if states is not None:
        states[:, 0] = largest
    samples = replace(run.samples, states=states)
    found = []
    for name, drawn in (
        ("with", replace(run, declaration=declaration, samples=samples)),
        ("without", run),
    ):
        write_run_rrd(drawn, tmp_path / f"{name}.rrd")
        kinds = read_blueprint_parts(tmp_path / f"{name}.rrd", "ContainerBlueprint:container_kind")
        found.append(kinds.count(TABS))
    assert found[0] - found[1] == tabs


def test_the_plane_holds_what_the_law_asks_for() -> None:
    away_m = REFERENCE_XY_M + np.array([20.0, 0.0])
    run = replace(FOLLOWER, samples=replace(FOLLOWER.samples, reference_xy_m=away_m))
    bounds = find_plane_bounds([run])
    assert bounds.center_xy_m[0] + bounds.half_size_m > np.nanmax(away_m[:, 0])
    assert find_plane_bounds([FOLLOWER]).half_size_m < bounds.half_size_m
