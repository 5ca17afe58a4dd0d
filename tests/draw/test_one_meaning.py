"""Colours mean the same in print, in Rerun, in a report and in a movie; legends are short."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bokeh.models import BoxAnnotation
from matplotlib.colors import to_rgb

import turtlelog as tl
from tests.draw.laws import simulate_tracker
from tests.draw.rerun.rrds import read_static, simulate_preset
from tests.draw.robots import make_robot
from tests.draw.test_effects_shown import simulate
from turtlelog.charts.palette import (
    DEAD_TIME,
    IDEAL,
    Color,
    choose_curve_color,
    choose_run_colors,
    darken,
    to_hex,
)
from turtlelog.draw.figures.robot_figures import _DEAD
from turtlelog.draw.report_drawing import Drawn
from turtlelog.draw.report_plots import draw_plots
from turtlelog.draw.rerun.content import _LINE_LETTERS
from turtlelog.draw.rerun.run_scene import build_single
from turtlelog.run import Run

RUNS = [simulate_preset(f"paper-kp{kp}") for kp in (1, 4)]


def to_bytes(color: Any) -> Color:
    red, green, blue = (round(255 * part) for part in to_rgb(color))
    return red, green, blue


def draw_report(*runs: Run) -> Any:
    colors = choose_run_colors(len(runs))
    drawn = [Drawn(run=run, name=run.name, color=c) for run, c in zip(runs, colors, strict=True)]
    return draw_plots(drawn, [tl.measure_run(run) for run in runs], [])


def test_a_run_has_one_colour_in_every_picture(tmp_path: Path) -> None:
    expected = choose_run_colors(2)
    axes = tl.draw.draw_figure("heading", RUNS).axes[0]
    printed = {line.get_label(): to_bytes(line.get_color()) for line in axes.get_lines()}
    assert [printed[run.name] for run in RUNS] == [*expected]
    tl.write_comparison_rrd(RUNS, tmp_path / "two.rrd")
    for run, color in zip(RUNS, expected, strict=True):
        for entity in ("heading_deg", "speed/commanded"):
            place = f"/runs/{run.name}/{entity}"
            found = read_static(tmp_path / "two.rrd", place, "SeriesLines:colors")
            assert [value >> 8 for value in found] == [color[0] << 16 | color[1] << 8 | color[2]]
    data = draw_report(*RUNS).roots["plot-heading"].renderers[0].data_source.data
    shown = dict(zip(data["name"], data["color"], strict=True))
    assert [shown[run.name] for run in RUNS] == [*map(to_hex, expected)]


def test_the_ideal_loop_is_grey_in_every_picture() -> None:
    run = RUNS[1]
    lines = tl.draw.draw_figure("heading", [run]).axes[0].get_lines()
    assert {to_bytes(line.get_color()) for line in lines if line.get_label() == "ideal"} == {IDEAL}
    single = build_single(run)
    assert {s.colors for s in single.series if s.entity.endswith("/ideal")} >= {(IDEAL,)}
    data = draw_report(run).roots["plot-heading"].renderers[0].data_source.data
    assert dict(zip(data["name"], data["color"], strict=True))["ideal"] == to_hex(IDEAL)
    assert choose_curve_color("ideal", (1, 2, 3), is_alone=False) == IDEAL


def test_a_dead_time_has_one_colour_in_every_picture() -> None:
    run = RUNS[1]
    figure = tl.draw.draw_figure("heading", [run], page=tl.draw.Page(has_marks=True))
    axes = figure.axes[0]
    assert DEAD_TIME in {to_bytes(patch.get_facecolor()) for patch in axes.patches}
    words = {to_bytes(text.get_color()) for text in axes.texts if "dead time" in text.get_text()}
    assert words == {darken(DEAD_TIME)}
    boxes = draw_report(run).roots["plot-heading"].select(type=BoxAnnotation)
    assert to_hex(DEAD_TIME) in {box.fill_color for box in boxes}
    assert to_bytes(_DEAD["color"]) == DEAD_TIME


@pytest.mark.parametrize("kind", ["kp10", "tracker", "robot", "noisy"])
def test_a_legend_of_a_run_alone_has_two_lines_at_most(kind: str) -> None:
    makers: dict[str, Callable[[], Run]] = {
        "kp10": lambda: simulate_preset("paper-kp10"),
        "tracker": lambda: simulate_tracker("kanayama"),
        "robot": make_robot,
        "noisy": simulate,
    }
    run = makers[kind]()
    single = build_single(run)
    for plot in {series.plot for series in single.series}:
        if plot.startswith("state/"):
            continue
        drawn = [series for series in single.series if series.plot == plot]
        names = {label for series in drawn for label in series.labels}
        names |= {line.name for line in single.references if line.plot == plot}
        names |= {mark.label for mark in single.marks if mark.plot == plot}
        assert len(names) <= 2, (plot, names)
        assert all(len(name) <= _LINE_LETTERS for name in names), names


def test_marks_of_less_interest_leave_a_full_line_of_a_legend() -> None:
    single = build_single(simulate_preset("paper-kp10"))
    signs = {plot: {m.shape for m in single.marks if m.plot == plot} for plot in single.names}
    assert signs["heading_deg"] == {"Cross", "Circle", "Square"}
    assert signs["along_track"] == {"Circle", "Square"}


@pytest.mark.parametrize(("count", "ideals"), [(7, 7), (8, 2)])
def test_of_more_than_seven_runs_the_first_and_last_have_an_ideal_response(
    count: int, ideals: int
) -> None:
    runs = [replace(RUNS[0], name=f"run {number}") for number in range(count)]
    lines = tl.draw.draw_figure("heading", runs).axes[0].get_lines()
    assert sum(str(line.get_label()).startswith("ideal") for line in lines) == ideals
    data = draw_report(*runs).roots["plot-heading"].renderers[0].data_source.data
    assert sum(color == to_hex(IDEAL) for color in data["color"]) == ideals


def test_times_of_a_bag_are_from_its_first_pose_in_every_picture() -> None:
    robot = make_robot()
    label = "time from the first pose [s]"
    assert tl.draw.draw_figure("heading", [robot]).axes[0].get_xlabel() == label
    assert draw_report(robot).roots["plot-heading"].below[0].axis_label == label


def lose_poses(run: Run, first: int, last: int) -> Run:
    kept = np.r_[0:first, last : len(run.poses)]
    return replace(run, poses=tl.run.take_rows(run.poses, kept))


def test_curves_break_where_a_robot_sent_no_poses() -> None:
    robot = make_robot()
    step_s = float(np.median(np.diff(robot.poses.time_ns))) / 1e9
    gone = lose_poses(robot, 20, 20 + round(2.0 / step_s))
    axes = tl.draw.draw_figure("heading", [gone]).axes[0]
    values = np.asarray(axes.get_lines()[0].get_ydata(), float)
    assert np.isnan(values).sum() == 1
    assert any("s without poses" in text.get_text() for text in axes.texts)
    (series,) = [s for s in build_single(gone).series if s.entity == "heading_deg"]
    assert np.isnan(series.values).sum() == 1
    notes = build_single(gone).describe({}).notes
    assert notes["heading_deg"] == notes["position"] == "2 s without poses"
    data = draw_report(gone).roots["plot-heading"].renderers[0].data_source.data
    assert sum(int(np.isnan(ys).sum()) for ys in data["ys"]) == 1


@pytest.mark.parametrize(("lost_s", "breaks"), [(0.9, 1), (0.15, 0)])
def test_curves_break_from_a_hundredth_of_a_run_or_a_second_on(lost_s: float, breaks: int) -> None:
    gone = lose_poses(make_robot(), 20, 20 + round(lost_s / 0.05))
    (series,) = [s for s in build_single(gone).series if s.entity == "heading_deg"]
    assert np.isnan(series.values).sum() == breaks
