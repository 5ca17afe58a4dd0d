"""Where many runs end: medians and outlines of gains, and how the plane shows them."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import turtlelog as tl
from tests.draw.rerun.rrds import read_static
from turtlelog.charts.many_runs import MANY_PATHS, find_gain_ends, outline_points
from turtlelog.charts.palette import choose_run_colors
from turtlelog.draw.figures.figure_curves import color_runs
from turtlelog.draw.report_drawing import Drawn
from turtlelog.draw.report_plots import draw_plots

KP2, KP10 = (tl.simulate_run(tl.load_scenario(f"paper-kp{kp}")) for kp in (2, 10))
RANDOM = np.random.default_rng(3)


def end_at(run: tl.Run, xy_m: np.ndarray, number: int) -> tl.Run:
    """Return a run that jumps to a place in its last pose."""
    moved = run.poses.xy_m.copy()
    moved[-1] = xy_m
    poses = dataclasses.replace(run.poses, xy_m=moved)
    return dataclasses.replace(run, poses=poses, name=f"{run.name}-{number}")


def scatter(run: tl.Run, middle: tuple[float, float], count: int) -> list[tl.Run]:
    ends = np.array(middle) + RANDOM.normal(scale=[0.1, 0.01], size=(count, 2))
    return [end_at(run, xy_m, number) for number, xy_m in enumerate(ends)]


RUNS = [*scatter(KP2, (2.0, 10.0), 20), *scatter(KP10, (2.4, 10.1), 20)]


def test_nine_tenths_of_the_ends_of_a_gain_lie_in_its_outline() -> None:
    two, ten = find_gain_ends(RUNS)
    assert (two.gain, ten.gain) == (2.0, 10.0)
    assert (two.runs, ten.runs) == (tuple(range(20)), tuple(range(20, 40)))
    ends = np.array([run.poses.xy_m[-1] for run in RUNS[:20]])
    np.testing.assert_array_equal(two.median_xy_m, np.median(ends, axis=0))
    corners = two.outline_xy_m
    sides = np.roll(corners, -1, axis=0) - corners
    away = ends[:, None] - corners[None]
    is_left = sides[:, 0] * away[..., 1] - sides[:, 1] * away[..., 0] >= -1e-12
    assert is_left.all(axis=1).sum() == 18


def test_nine_ends_of_a_gain_have_no_outline_and_ten_have_one() -> None:
    assert not find_gain_ends(RUNS[:9])
    assert len(find_gain_ends(RUNS[:10])) == 1


@pytest.mark.parametrize(
    ("points", "corners"),
    [
        ([(0, 0), (2, 0), (2, 2), (0, 2), (1, 1), (1, 0)], [(0, 0), (2, 0), (2, 2), (0, 2)]),
        ([(0, 0), (1, 1), (2, 2)], [(0, 0), (2, 2)]),
        ([(1, 1), (1, 1)], [(1, 1)]),
    ],
)
def test_an_outline_has_the_corners_alone(
    points: list[tuple[float, float]], corners: list[tuple[float, float]]
) -> None:
    np.testing.assert_array_equal(outline_points(np.array(points, dtype=float)), corners)


def test_paths_of_more_than_24_runs_are_grey_and_their_ends_lie_above_them() -> None:
    for runs in (RUNS[:MANY_PATHS], RUNS[: MANY_PATHS + 1]):
        axes = tl.draw.draw_figure("plane", runs).axes[0]
        colors = color_runs(runs)
        dots = [line for line in axes.get_lines() if line.get_marker() == "o"]
        paths = [line for line in axes.get_lines() if str(line.get_label()).startswith("paper-")]
        is_grey = len(runs) > MANY_PATHS
        assert {line.get_color() for line in paths} == ({"0.8"} if is_grey else {*colors})
        assert {dot.get_color() for dot in dots} == {*colors}
        assert min(dot.get_zorder() for dot in dots) > max(line.get_zorder() for line in paths)


def test_the_bar_of_runs_that_share_gains_tells_the_gains() -> None:
    *_, bar = tl.draw.draw_figure("plane", RUNS).axes
    assert [label.get_text() for label in bar.get_xticklabels()] == ["2", "10"]
    assert bar.get_xlabel() == "Kp of 40 runs"


def test_rerun_and_reports_show_the_ends_of_many_runs_as_print_does(tmp_path: Path) -> None:
    """2 s and more: 40 runs are drawn as a recording for Rerun and as a report."""
    medians = np.array([ends.median_xy_m for ends in find_gain_ends(RUNS)])
    tl.write_comparison_rrd(RUNS, tmp_path / "many.rrd")
    shown = read_static(tmp_path / "many.rrd", "/plane/ends/medians", "Points2D:positions")
    np.testing.assert_allclose(shown, medians, rtol=1e-6)
    colors = choose_run_colors(len(RUNS))
    drawn = [
        Drawn(run=run, name=run.name, color=color) for run, color in zip(RUNS, colors, strict=True)
    ]
    plane = draw_plots(drawn, [{} for _ in RUNS], []).roots["plane"]
    diamonds = [one for one in plane.renderers if getattr(one.glyph, "marker", "") == "diamond"]
    places = [[one.data_source.data[axis][0] for axis in "xy"] for one in diamonds]
    np.testing.assert_allclose(places, medians, rtol=1e-6)
