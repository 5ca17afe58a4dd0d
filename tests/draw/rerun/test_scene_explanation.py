import re
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from tests.draw.laws import simulate_law
from tests.draw.rerun.rrds import (
    list_entities,
    make_attribution,
    read_blueprint_parts,
    read_layout,
    read_rows,
    read_static,
    read_times,
    simulate_preset,
    verify,
)
from tests.known import known
from turtlelog.charts import palette
from turtlelog.charts.attribution_steps import StepScale
from turtlelog.charts.palette import choose_turtle_size
from turtlelog.draw import write_explanation_rrd, write_run_rrd
from turtlelog.draw.rerun.pictures import choose_ticks, write_tick
from turtlelog.draw.rerun.turtles import (
    MOST_SEGMENTS,
    build_ideal_ghost,
    count_segments,
    find_ideal_poses,
    list_gaps,
    measure_gap,
)
from turtlelog.errors import ShowError
from turtlelog.explain import Attribution, attribute_run, identify_run, simulate_what_ifs
from turtlelog.run import Run

RUN = simulate_preset("paper-kp10")
RECORDED = "/runs/recorded"
MAIN = "/ghosts/without_queue_and_pause"


@cache
def explain(name: str) -> tuple[Attribution, dict[str, Run]]:
    run = simulate_preset(name)
    identified = identify_run(run)
    found = attribute_run(run, identified=identified)
    return found, dict(simulate_what_ifs(identified, found))


@pytest.fixture(scope="module")
def kp10_rrd(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ghosts") / "why.rrd"
    write_explanation_rrd(RUN, *explain("paper-kp10"), path)
    return path


def read_words(path: Path, entity: str) -> list[str]:
    return list(read_static(path, entity, "Points2D:labels"))


def test_the_recorded_run_stands_beside_its_what_ifs(explanation_rrd: Path) -> None:
    verify(explanation_rrd)
    names = read_static(explanation_rrd, "/__properties/runs", "name")
    assert names == ["recorded", "without pause", "without queue"]
    rows = read_rows(explanation_rrd, f"{RECORDED}/distance", "Scalars:scalars")
    assert len(rows) == len(RUN.poses)
    entity = "/ghosts/without_pause/distance"
    other = read_rows(explanation_rrd, entity, "Scalars:scalars")
    assert len(other) == len(simulate_preset("paper-kp4").poses)


def test_the_steps_stand_with_their_words_in_a_view_of_their_own(kp10_rrd: Path) -> None:
    view = read_layout(kp10_rrd)["Why final.position_error is 106.7 mm"]
    assert view == ["/attribution/**"]
    assert read_words(kp10_rrd, "/attribution/words") == [
        "as recorded",
        "106.7 mm",
        "queue",
        "+51.1 mm (48 %)",
        "pause",
        "+50.6 mm (47 %)",
        "left",
        "5.1 mm (5 %), no more than the tolerances leave",
        "0 mm",
        "50 mm",
        "100 mm",
        "bars: averages over the orders of removal; no run ends between them",
        "Ghosts: 26.8 mm without queue, 27.4 mm without pause",
    ]
    places = np.array(read_static(kp10_rrd, "/attribution/words", "Points2D:positions"))
    assert places[:, 0].min() > 0.0
    assert places[:, 0].max() < 100.0


def test_words_behind_a_short_bar_keep_off_its_name_in_a_small_window(kp10_rrd: Path) -> None:
    words = read_words(kp10_rrd, "/attribution/words")
    places = np.array(read_static(kp10_rrd, "/attribution/words", "Points2D:positions"))[:, 0]
    pixels = 3.0  # of a unit in a window of 700 x 450, where a letter has 6.5
    row = words.index("left")
    name, text = places[row], places[row + 1]
    ends = name + len("left") / 2.0 * 6.5 / pixels
    assert text - len(words[row + 1]) / 2.0 * 6.5 / pixels > ends


def test_the_axis_of_the_steps_begins_at_zero_where_the_bars_do(kp10_rrd: Path) -> None:
    words = read_words(kp10_rrd, "/attribution/words")
    places = np.array(read_static(kp10_rrd, "/attribution/words", "Points2D:positions"))
    (total,) = read_static(kp10_rrd, "/attribution/bar_0", "Transform3D:translation")
    (frame,) = read_static(kp10_rrd, "/attribution/bar_0", "Transform3D:mat3x3")
    at = {word: places[words.index(word), 0] - total[0] for word in ("0 mm", "50 mm", "100 mm")}
    per_mm = 2.0 * frame[0] / 106.73
    assert at == pytest.approx(
        {"0 mm": 0.0, "50 mm": 50.0 * per_mm, "100 mm": 100.0 * per_mm}, abs=0.01
    )


@pytest.mark.parametrize(
    ("ends", "ticks"),
    [
        ((0.0, 0.1499), ["0 mm", "50 mm", "100 mm"]),
        ((0.0, 0.1501), ["0 mm", "100 mm"]),
        ((-0.02, 0.09), ["0 mm", "50 mm"]),
        ((-0.06, 0.06), ["-50 mm", "0 mm", "50 mm"]),
        ((0.0, 0.0), ["0 mm"]),
    ],
)
def test_an_axis_has_three_steps_at_most(ends: tuple[float, float], ticks: list[str]) -> None:
    scale = StepScale(factor=1e3, unit="mm", decimals=1)
    assert [write_tick(value, scale) for value in choose_ticks(ends, scale)] == ticks


@pytest.mark.thorough
def test_one_effect_alone_needs_no_average_and_many_ghosts_are_not_all_told(
    tmp_path: Path,
) -> None:
    alone = dict(explain("paper-kp10")[1])
    for shares, ghosts, told in (
        ({"queue": 0.01}, ("queue",), None),
        ({"queue": 0.02, "pause": 0.01}, (), "orders of removal"),
        ({"queue": 0.02, "pause": 0.01}, ("queue", "pause"), "mm without queue"),
        (
            {"queue": 0.03, "pause": 0.02, "jitter": 0.01},
            ("queue", "pause", "jitter"),
            "each thin one",
        ),
    ):
        what_ifs = dict.fromkeys(ghosts, alone["queue"])
        path = tmp_path / "why.rrd"
        write_explanation_rrd(RUN, make_attribution(RUN, shares), what_ifs, path)
        last = read_words(path, "/attribution/words")[-1]
        assert told in last if told else last.endswith(" mm")


def test_ends_at_the_goal_have_the_names_of_what_they_lack(kp10_rrd: Path) -> None:
    misses = read_words(kp10_rrd, "/plane/close_up/misses")
    assert {*misses} == {
        "recorded: 107 mm",
        "no queue: 26.8 mm",
        "no pause: 27.4 mm",
        "neither: 5.08 mm",
    }
    assert "- /plane/gap/**" in read_layout(kp10_rrd)["At the goal, ±150 mm"]
    assert "- /plane/gap/**" not in read_layout(kp10_rrd)["Plane"]


def test_a_bar_begins_where_the_one_above_it_ends(kp10_rrd: Path) -> None:
    spans = []
    for number in range(4):
        entity = f"/attribution/bar_{number}"
        (place,) = read_static(kp10_rrd, entity, "Transform3D:translation")
        (frame,) = read_static(kp10_rrd, entity, "Transform3D:mat3x3")
        spans.append((place[0], place[0] + 2.0 * frame[0]))
    total, queue, pause, left = spans
    assert queue[1] == pytest.approx(total[1], abs=1e-3)
    assert pause[1] == pytest.approx(queue[0], abs=1e-3)
    assert (left[0], left[1]) == pytest.approx((total[0], pause[0]), abs=1e-3)


def test_the_main_ghost_is_grey_and_the_others_have_their_causes_colours(
    kp10_rrd: Path,
) -> None:
    colors = palette.choose_cause_colors(explain("paper-kp10")[0].causes)
    for entity, color in (
        (RECORDED, palette.MAIN),
        (MAIN, palette.GHOST),
        ("/ghosts/without_queue", colors["queue"]),
    ):
        (shown,) = read_static(kp10_rrd, f"{entity}/plane/turtle/body", "LineStrips2D:colors")
        assert [shown >> 24, shown >> 16 & 255, shown >> 8 & 255] == list(color)
    shown = read_static(kp10_rrd, "/plane/names/key/words", "Points2D:colors")
    np.testing.assert_array_equal(shown[:2], palette.pack_colors([palette.MAIN, palette.GHOST]))
    rows = read_words(kp10_rrd, "/plane/names/key/words")
    assert rows == ["recorded", "without queue and pause", "without pause", "without queue"]


@pytest.mark.parametrize(
    ("lacks", "told"),
    [
        ("a" * 14 + " and " + "b" * 9, "without " + "a" * 14 + " and " + "b" * 9),
        ("a" * 14 + " and " + "b" * 10, "without all of these"),
    ],
)
def test_a_name_of_36_letters_has_room_in_the_key(lacks: str, told: str, tmp_path: Path) -> None:
    path = tmp_path / "why.rrd"
    write_explanation_rrd(RUN, make_attribution(RUN, {}), {lacks: RUN}, path)
    assert read_words(path, "/plane/names/key/words") == ["recorded", told]


def test_the_gap_to_the_ghost_is_written_beside_its_line(kp10_rrd: Path) -> None:
    lines = read_rows(kp10_rrd, "/plane/gap", "LineStrips2D:strips")
    names = read_rows(kp10_rrd, "/plane/names/gap", "Points2D:labels")
    assert len(lines) <= 1000
    (start, end), (label,) = lines[-1][0], names[-1]
    gap_mm = 1e3 * float(np.hypot(*np.subtract(end, start)))
    assert label == f"blue to grey: {gap_mm:.3g} mm" == "blue to grey: 102 mm"
    assert names[0] == []


@pytest.mark.parametrize(("gap_m", "label"), [(4.9e-4, []), (5.1e-4, ["blue to grey: 0.51 mm"])])
def test_a_gap_of_half_a_millimetre_is_written(
    gap_m: float, label: list[str], tmp_path: Path
) -> None:
    path = tmp_path / "near.rrd"
    write_explanation_rrd(RUN, make_attribution(RUN, {}), {"queue": shift(gap_m)}, path)
    assert read_rows(path, "/plane/names/gap", "Points2D:labels")[-1] == label


@pytest.mark.parametrize(("gap_m", "plot"), [(0.999, "gap_mm/queue"), (1.0, "gap_m/queue")])
def test_gaps_are_plotted_in_metres_from_one_metre_on(gap_m: float, plot: str) -> None:
    ghost = build_ideal_ghost(RUN)
    assert ghost is not None
    (curve,) = list_gaps(RUN, [replace(ghost, name="queue", run=shift(gap_m))])
    assert curve.entity == plot


def shift(gap_m: float) -> Run:
    moved_m = np.array(RUN.poses.xy_m) * [0.0, 1.0] + [0.0, gap_m]
    still_m = np.array(RUN.poses.xy_m) * [1.0, 0.0]
    return replace(RUN, poses=replace(RUN.poses, xy_m=moved_m + still_m))


def test_the_distance_to_the_ghost_is_a_plot(kp10_rrd: Path) -> None:
    assert "Distance to ghost [mm]" in read_layout(kp10_rrd)
    entity = f"{RECORDED}/gap_mm/without_queue_and_pause"
    values = np.array(read_rows(kp10_rrd, entity, "Scalars:scalars"))[:, 0]
    found = explain("paper-kp10")[1]["queue and pause"]
    apart_m = np.hypot(*(RUN.poses.xy_m[-1] - found.poses.xy_m[-1]))
    assert values[-1] == pytest.approx(1e3 * apart_m)
    assert len(values) == len(RUN.poses)


def test_a_trail_grows_by_segments_that_join_where_the_turtle_drives(kp10_rrd: Path) -> None:
    strips = [
        row[0] for row in read_rows(kp10_rrd, f"{RECORDED}/plane/trail", "LineStrips2D:strips")
    ]
    assert 100 < len(strips) <= MOST_SEGMENTS
    assert all(one[-1] == other[0] for one, other in pairwise(strips))
    times_ns = read_times(kp10_rrd, f"{RECORDED}/plane/trail")
    rows = np.searchsorted(RUN.poses.time_ns - RUN.start_ns, times_ns)
    np.testing.assert_allclose(RUN.poses.xy_m[rows], [s[-1] for s in strips], atol=1e-6)


@pytest.mark.parametrize(("trails", "most"), [(1, 1000), (8, 1000), (10, 800), (400, 40)])
def test_many_trails_have_fewer_segments_each(trails: int, most: int) -> None:
    assert count_segments(trails) == most


@pytest.mark.parametrize(("turtles", "size"), [(1, 1.0), (4, 1.0), (16, 0.5), (400, 0.3)])
def test_many_turtles_are_smaller(turtles: int, size: float) -> None:
    assert choose_turtle_size(turtles) == size


def test_a_view_shows_the_trail_from_its_beginning_to_the_cursor(kp10_rrd: Path) -> None:
    ranges = read_blueprint_parts(kp10_rrd, "VisibleTimeRanges:ranges")
    assert {found["timeline"] for found in ranges} >= {"sim_time", "tick", "translate_time"}
    spans = {(found["range"]["start"], found["range"]["end"]) for found in ranges}
    assert spans == {(None, 0)}


def test_the_way_ahead_is_drawn_faintly(kp10_rrd: Path) -> None:
    (color,) = read_static(kp10_rrd, f"{RECORDED}/plane/path", "LineStrips2D:colors")
    (trail,) = read_rows(kp10_rrd, f"{RECORDED}/plane/trail", "LineStrips2D:colors")[0]
    assert color >> 8 == trail >> 8
    assert (color & 255, trail & 255) == (45, 255)


def test_pause_and_dead_time_are_marked_on_the_time_axis(explanation_rrd: Path) -> None:
    spans = {span.phase: span for span in RUN.find_phase_spans()}
    pause_ns = read_times(explanation_rrd, f"{RECORDED}/lines/pause") + RUN.start_ns
    assert sorted(set(pause_ns.tolist())) == [spans["pause"].start_ns, spans["pause"].end_ns]
    dead_ns = read_times(explanation_rrd, "/phase/recorded_dead_time") + RUN.start_ns
    ticks = (np.diff(dead_ns)[::2] // 16_000_000).tolist()
    assert ticks == [4, 6]
    assert dead_ns[::2].tolist() == [spans["rotate"].start_ns, spans["translate"].start_ns]


def test_the_lines_of_pause_and_dead_time_stand_in_every_plot(explanation_rrd: Path) -> None:
    lines = {f"{RECORDED}/lines/pause", f"{RECORDED}/lines/dead_time"}
    layout = read_layout(explanation_rrd)
    plots = [view for view in layout if re.search(r"\[(deg|m|mm|m/s|rad/s)\]$", view)]
    assert len(plots) == 8
    assert all(lines < set(layout[view]) for view in plots)
    assert layout["Phases (brown: pause, pink: dead time)"] == [
        "/phase/recorded",
        "/phase/recorded_dead_time",
        "/phase/without_queue",
    ]


def test_the_shares_are_a_table_too(explanation_rrd: Path) -> None:
    (text,) = read_static(explanation_rrd, "/documents/Contributions", "TextDocument:text")
    assert "Why final.position_error is 106.7 mm" in text
    assert "| pause | 0.05 |" in text
    assert "Notes" in read_layout(explanation_rrd)


def test_a_run_that_nothing_changes_stands_beside_the_ideal_loop(tmp_path: Path) -> None:
    found = make_attribution(RUN, {})
    write_explanation_rrd(RUN, found, {}, tmp_path / "alone.rrd")
    verify(tmp_path / "alone.rrd")
    assert "/ideal_loop/plane/turtle" in list_entities(tmp_path / "alone.rrd")
    words = read_words(tmp_path / "alone.rrd", "/attribution/words")
    assert "106.7 mm, no effect changes it" in words


def test_withheld_shares_give_their_reason_in_place_of_the_steps(tmp_path: Path) -> None:
    reason = "they differ by more than a tenth of what the effects add together"
    found = replace(make_attribution(RUN, {}), withheld=reason)
    write_explanation_rrd(RUN, found, {}, tmp_path / "why.rrd")
    assert "Why there are no contributions to final.position_error" in read_layout(
        tmp_path / "why.rrd"
    )
    assert reason in " ".join(read_words(tmp_path / "why.rrd", "/attribution/words"))


def test_where_there_are_neither_shares_nor_a_ghost_nothing_is_written(tmp_path: Path) -> None:
    run = simulate_law("Follower")
    found = make_attribution(run, {}, "run.path_length")
    found = replace(found, withheld="they differ")
    with pytest.raises(ShowError, match="no contributions and no ghost to show: they differ"):
        write_explanation_rrd(run, found, {}, tmp_path / "none.rrd")
    assert not list(tmp_path.iterdir())


def test_the_ideal_loop_is_a_ghost_beside_a_single_run(run_rrd: Path) -> None:
    assert read_words(run_rrd, "/plane/names/key/words") == ["the run", "ideal loop"]
    assert "/ideal_loop/plane/turtle" in list_entities(run_rrd)
    layout = read_layout(run_rrd)
    assert "/ideal_loop/plane/**" in layout["Plane (pink: to the goal, yellow: command)"]
    assert "- /ideal_loop/plane/turtle/body/**" in layout["At the goal, ±150 mm"]


def test_the_ideal_loop_turns_and_then_drives_to_the_goal() -> None:
    poses, goal_xy_m = known(find_ideal_poses(RUN)), known(RUN.goal_xy_m)
    spans = {span.phase: span for span in RUN.find_phase_spans()}
    before = poses.time_ns <= spans["translate"].start_ns
    np.testing.assert_allclose(poses.xy_m[before], RUN.poses.xy_m[:1].repeat(before.sum(), axis=0))
    np.testing.assert_allclose(poses.xy_m[-1], goal_xy_m, atol=1e-9)
    way = np.subtract(goal_xy_m, RUN.poses.xy_m[0])
    assert poses.heading_rad[-1] == pytest.approx(np.arctan2(way[1], way[0]), abs=1e-4)
    since_s = (poses.time_ns - spans["translate"].start_ns) / 1e9
    row = int(np.argmin(np.abs(since_s - 0.1)))
    left_m = float(np.hypot(*(poses.xy_m[row] - goal_xy_m)))
    assert left_m == pytest.approx(np.hypot(*way) * np.exp(-10.0 * since_s[row]), rel=1e-6)


@pytest.mark.parametrize("name", ["posture", "track-square"])
def test_where_loops_act_together_there_is_no_ideal_loop(name: str) -> None:
    assert find_ideal_poses(simulate_preset(name)) is None


def test_a_run_without_an_ideal_loop_has_no_ghost_and_no_key(tmp_path: Path) -> None:
    write_run_rrd(simulate_preset("posture"), tmp_path / "run.rrd")
    assert not [name for name in list_entities(tmp_path / "run.rrd") if "ideal_loop" in name]


def test_a_gap_is_measured_at_the_same_time_after_the_start() -> None:
    ghost = build_ideal_ghost(RUN)
    assert ghost is not None
    late = replace(ghost.run, poses=replace(ghost.run.poses))
    gap_m = measure_gap(RUN, replace(ghost, run=late))
    expected_m = np.hypot(*(RUN.poses.xy_m - ghost.run.poses.xy_m).T)
    np.testing.assert_allclose(gap_m, expected_m, atol=1e-12)


def test_six_causes_with_long_words_stay_in_the_picture(tmp_path: Path) -> None:
    shares = dict.fromkeys(("disturbance", "quantum", "dropout", "outlier", "repeat"), 0.01)
    found = make_attribution(RUN, {**shares, "jitter": -0.02})
    write_explanation_rrd(RUN, found, {}, tmp_path / "why.rrd")
    places = np.array(read_static(tmp_path / "why.rrd", "/attribution/words", "Points2D:positions"))
    words = read_words(tmp_path / "why.rrd", "/attribution/words")
    reach = places[:, 0] + [0.95 * len(word) / 2.0 for word in words]
    assert (len(words), reach.max() < 100.0, places[:, 1].max() < 36.0) == (20, True, True)
