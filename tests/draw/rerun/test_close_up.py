"""The close-up of the goal: how much it shows, what it says, and that it is drawn."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import turtlelog as tl
from tests.draw.rerun.rrds import list_entities, read_layout, read_static, simulate_preset
from turtlelog.charts import palette
from turtlelog.charts.close_up import (
    Lettering,
    find_close_up,
    format_length,
    list_miss_labels,
    list_ring_labels,
    name_ends,
)
from turtlelog.draw.rerun.pictures import choose_names
from turtlelog.measure import measure_run
from turtlelog.scenario import PAPER_RUNS

LETTERING = Lettering(letter=0.06, line=0.2, gap=0.1)
RUN = simulate_preset("paper-kp4")


def miss_by(x_m: float, y_m: float = 0.0, *, tolerance_m: float = 0.001) -> tl.Run:
    """Return a run that ends beside the goal (0, 0), whatever it did before."""
    xy_m = np.array(RUN.poses.xy_m)
    xy_m[-1] = x_m, y_m
    parameters = {**RUN.parameters, "law.position_tolerance_m": tolerance_m}
    poses = replace(RUN.poses, xy_m=xy_m)
    return replace(RUN, poses=poses, goal_xy_m=(0.0, 0.0), parameters=parameters)


@pytest.mark.parametrize(
    ("miss_m", "half_m", "rings_m"),
    [
        (0.1199, 0.15, [0.05, 0.1]),
        (0.1201, 0.25, [0.1, 0.2]),
        (0.3199, 0.4, [0.1, 0.2, 0.3]),
        (0.6399, 0.8, [0.2, 0.4, 0.6]),
        (0.6401, 1.2, [0.5, 1.0]),
        (0.0, 0.004, [0.001, 0.002, 0.003]),
    ],
)
def test_the_half_width_and_the_rings_are_round_and_leave_room(
    miss_m: float, half_m: float, rings_m: Sequence[float]
) -> None:
    close_up = find_close_up([miss_by(miss_m)])
    assert close_up is not None
    assert close_up.half_m == pytest.approx(half_m)
    assert close_up.rings_m == pytest.approx(rings_m)


@pytest.mark.parametrize(("tolerance_m", "half_m"), [(0.0199, 0.06), (0.0201, 0.08), (0.0, 0.001)])
def test_the_square_of_the_tolerance_is_seen(tolerance_m: float, half_m: float) -> None:
    close_up = find_close_up([miss_by(0.0, tolerance_m=tolerance_m)])
    assert close_up is not None
    assert close_up.half_m == pytest.approx(half_m, rel=0.25)
    assert close_up.half_m >= 3.0 * tolerance_m


def test_a_run_has_arrived_within_a_metre() -> None:
    assert find_close_up([miss_by(0.999)]) is not None
    assert find_close_up([miss_by(1.0)]) is None


def test_without_one_goal_for_all_there_is_no_close_up() -> None:
    other = replace(miss_by(0.1), goal_xy_m=(1.0, 0.0))
    assert find_close_up([miss_by(0.1), other]) is None
    assert find_close_up([replace(RUN, goal_xy_m=None)]) is None


def test_runs_that_end_elsewhere_are_counted() -> None:
    close_up = find_close_up([miss_by(0.1), miss_by(2.0), miss_by(0.0, -0.15)])
    assert close_up is not None
    assert close_up.describe() == "±250 mm, 1 of 3 runs outside"
    assert [end.run for end in close_up.ends] == [0, 2]


def test_a_run_without_a_goal_misses_none() -> None:
    close_up = find_close_up([replace(miss_by(0.1), goal_xy_m=None), miss_by(0.1)])
    assert close_up is not None
    assert [end.run for end in close_up.ends] == [1]


@pytest.mark.parametrize("name", PAPER_RUNS)
def test_the_miss_is_the_final_position_error(name: str) -> None:
    run = simulate_preset(name)
    close_up = find_close_up([run])
    assert close_up is not None
    assert close_up.ends[0].miss_m == measure_run(run)["final.position_error"].value


def tell_misses(runs: Sequence[tl.Run]) -> list[str]:
    close_up = find_close_up(runs)
    assert close_up is not None
    return [label.text for label in list_miss_labels(close_up, LETTERING)]


def test_ends_that_lie_together_share_their_words() -> None:
    assert tell_misses([simulate_preset(name) for name in PAPER_RUNS]) == [
        "1.01, 2.52, 8.52 mm",
        "107 mm",
    ]


@pytest.mark.parametrize(
    ("misses_m", "texts"),
    [
        ([0.001, 0.002, 0.003], ["1, 2, 3 mm"]),
        ([0.001, 0.002, 0.003, 0.004], ["4 runs: 1 to 4 mm"]),
        ([0.101, 0.1, 0.1], ["100, 101 mm"]),
    ],
)
def test_many_ends_together_are_told_by_least_and_greatest(
    misses_m: Sequence[float], texts: Sequence[str]
) -> None:
    assert tell_misses([*map(miss_by, misses_m), miss_by(-0.5)]) == [*texts, "500 mm"]


@pytest.mark.parametrize(
    ("names", "texts"),
    [
        ("abc", ["a: 1 mm\nb: 2 mm\nc: 3 mm", "d: 500 mm"]),
        ("    ", ["1, 2, 3 mm", "500 mm"]),
    ],
)
def test_ends_of_runs_with_names_have_a_line_each(names: str, texts: list[str]) -> None:
    close_up = find_close_up([*map(miss_by, (0.001, 0.002, 0.003)), miss_by(-0.5)])
    assert close_up is not None
    named = name_ends(close_up, [name.strip() for name in names.ljust(4, "d")])
    assert [label.text for label in list_miss_labels(named, LETTERING)] == texts


@pytest.mark.parametrize(
    ("letters", "told"), [(16, "x" * 16 + ": 100 mm"), (17, "x" * 13 + "...: 100 mm")]
)
def test_long_names_are_cut_in_the_close_up(letters: int, told: str) -> None:
    close_up = find_close_up([miss_by(0.1)])
    assert close_up is not None
    (label,) = list_miss_labels(name_ends(close_up, ["x" * letters]), LETTERING)
    assert label.text == told


@pytest.mark.parametrize(("furthest", "runs"), [(0, [12, 0]), (12, [12])])
def test_of_many_named_ends_the_furthest_and_the_last_run_are_told(
    furthest: int, runs: list[int]
) -> None:
    ways = [miss_by(0.5 if number == furthest else -0.1) for number in range(13)]
    close_up = find_close_up(ways)
    assert close_up is not None
    named = name_ends(close_up, [f"run {number}" for number in range(13)])
    found = [run for label in list_miss_labels(named, LETTERING) for run in label.runs]
    assert found == runs


@pytest.mark.parametrize(("line", "count"), [(0.33, 2), (0.34, 1)])
def test_where_names_of_rings_would_cover_each_other_the_widest_is_named(
    line: float, count: int
) -> None:
    close_up = find_close_up([miss_by(0.1)])  # rings of a third of the half-width
    assert close_up is not None
    rings = list_ring_labels(close_up, (0.0, -5.0), (), replace(LETTERING, line=line))
    assert [label.text for label in rings] == ["50 mm", "100 mm"][-count:]


@pytest.mark.parametrize("reach", [1.0, 1.6])
def test_words_stay_in_the_picture(reach: float) -> None:
    close_up = find_close_up([miss_by(0.199), miss_by(0.1)])
    assert close_up is not None
    lettering = replace(LETTERING, reach=reach)
    for label in list_miss_labels(close_up, lettering):
        edge_m = abs(label.xy_m[0]) + len(label.text) * lettering.letter / 2.0 * close_up.half_m
        assert edge_m <= reach * close_up.half_m * (1.0 + 1e-12)
    (label,) = list_miss_labels(close_up, lettering)[1:]
    assert (label.xy_m[0] < 0.25) == (reach == 1.0)


def test_words_of_a_dozen_ends_do_not_cover_each_other() -> None:
    turns_rad = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    close_up = find_close_up(
        [miss_by(0.5 * np.cos(turn), 0.4 * np.sin(turn)) for turn in turns_rad]
    )
    assert close_up is not None
    labels = list_miss_labels(close_up, LETTERING)
    assert sorted(run for label in labels for run in label.runs) == list(range(12))
    for number, label in enumerate(labels):
        for other in labels[:number]:
            across, up = np.abs(np.subtract(label.xy_m, other.xy_m)) / close_up.half_m
            letters = (len(label.text) + len(other.text)) / 2.0
            assert across >= 0.06 * letters or up >= 0.2 - 1e-12


@pytest.mark.parametrize(("count", "told"), [(12, 12), (13, 1)])
def test_of_more_than_a_dozen_ends_the_furthest_is_told(count: int, told: int) -> None:
    close_up = find_close_up([miss_by(0.01 + 0.001 * number) for number in range(count)])
    assert close_up is not None
    labels = list_miss_labels(close_up, LETTERING)
    assert sum(len(label.runs) for label in labels) == told
    assert count - 1 in labels[-1].runs


def test_names_of_rings_stand_where_no_words_and_no_paths_are() -> None:
    close_up = find_close_up([miss_by(0.1)])
    assert close_up is not None
    above = list_ring_labels(close_up, (0.0, -5.0), (), LETTERING)
    assert [label.text for label in above] == ["50 mm", "100 mm"]
    assert all(label.xy_m[1] > 0.0 for label in above)
    assert all(label.xy_m[1] < 0.0 for label in list_ring_labels(close_up, (0, 5), (), LETTERING))
    beside = list_ring_labels(close_up, (0.0, -5.0), above, LETTERING)
    assert [label.xy_m for label in beside] != [label.xy_m for label in above]


@pytest.mark.parametrize(
    ("length_m", "text"), [(0.9994, "999 mm"), (1.0, "1 m"), (0.0001, "0.1 mm")]
)
def test_lengths_are_in_millimetres_below_a_metre(length_m: float, text: str) -> None:
    assert format_length(length_m) == text


def test_the_viewer_shows_where_a_run_ends_whatever_the_time(run_rrd: Path) -> None:
    run = simulate_preset("paper-kp10")
    ((x_m, y_m),) = read_static(run_rrd, "/plane/end", "Points2D:positions")
    np.testing.assert_allclose((x_m, y_m), run.poses.xy_m[-1], atol=1e-6)
    assert read_static(run_rrd, "/plane/close_up/misses", "Points2D:labels") == ["107 mm"]
    names = read_static(run_rrd, "/plane/close_up/rings/names", "Points2D:labels")
    assert names == ["50 mm", "100 mm"]


def test_the_viewer_shows_where_each_of_several_runs_ends(comparison_rrd: Path) -> None:
    for name in PAPER_RUNS:
        ((x_m, y_m),) = read_static(comparison_rrd, f"/runs/{name}/plane/end", "Points2D:positions")
        np.testing.assert_allclose((x_m, y_m), simulate_preset(name).poses.xy_m[-1], atol=1e-6)
    misses = read_static(comparison_rrd, "/plane/close_up/misses", "Points2D:labels")
    assert misses == ["kp1: 2.52 mm", "kp2: 1.01 mm", "kp4: 8.52 mm", "kp10: 107 mm"]
    hues = read_static(comparison_rrd, "/plane/close_up/misses", "Points2D:colors")
    assert hues == palette.pack_colors(palette.choose_run_colors(4)).tolist()
    heights = [
        xy[1] for xy in read_static(comparison_rrd, "/plane/close_up/misses", "Points2D:positions")
    ]
    assert heights[0] > heights[1] > heights[2]


@pytest.mark.parametrize("radius_m", [0.05, 0.1])
def test_rings_have_the_radius_that_they_name(run_rrd: Path, radius_m: float) -> None:
    rings = read_static(run_rrd, "/plane/close_up/rings", "LineStrips2D:strips")
    points_m = np.array(rings[round(radius_m / 0.05) - 1])
    np.testing.assert_allclose(np.hypot(*(points_m - [2.0, 10.0]).T), radius_m, rtol=1e-4)


def test_only_the_close_up_has_rings_and_ends(comparison_rrd: Path) -> None:
    layout = read_layout(comparison_rrd)
    hidden = {"- /plane/close_up/**", "- /runs/paper-kp1/plane/end/**"}
    assert hidden <= set(layout["Plane"])
    assert not hidden & set(layout["At the goal, ±150 mm"])


def test_a_run_that_ends_far_from_its_goal_has_no_close_up(tmp_path: Path) -> None:
    tl.write_run_rrd(replace(RUN, goal_xy_m=(2.0, 2.0)), tmp_path / "far.rrd")
    assert not any(name.startswith("At the goal") for name in read_layout(tmp_path / "far.rrd"))
    assert "/plane/end" not in list_entities(tmp_path / "far.rrd")


@pytest.mark.parametrize(("count", "named"), [(28, 28), (29, 28), (1000, 28)])
def test_a_legend_names_as_many_runs_as_it_has_room_for(count: int, named: int) -> None:
    chosen = choose_names(["x" * 12] * count)
    assert (len(chosen), chosen[0], chosen[-1]) == (named, 0, count - 1)
