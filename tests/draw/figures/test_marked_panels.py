"""Characteristics on the curves of figures."""

from itertools import combinations
from typing import get_args

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg

import turtlelog as tl
from turtlelog.draw import Page, draw_figure
from turtlelog.draw.figures.page import PageKind
from turtlelog.draw.figures.writing import list_unmarked
from turtlelog.measure import measure_run
from turtlelog.scenario import get_preset

RUNS = [tl.simulate_run(get_preset(f"paper-kp{kp}")) for kp in (1, 2, 4, 10)]
RUN = RUNS[-1]
METRICS = measure_run(RUN)
MARKED = Page(has_marks=True)


def list_words(axes: Axes) -> list[str]:
    return [text.get_text() for text in axes.texts]


def list_dots(axes: Axes) -> list[tuple[float, float]]:
    lines = [line for line in axes.get_lines() if line.get_marker() in {"o", "s", "x"}]
    return [tuple(np.asarray(line.get_xydata())[0].tolist()) for line in lines]


def test_a_heading_has_its_characteristics_with_their_values() -> None:
    (axes,) = draw_figure("heading", [RUN], page=MARKED).axes
    assert list_words(axes) == [
        "dead time 64 ms",
        "rise 1.79 s",
        "settled 2.21 s",
        "peak 129.8 deg\novershoot 1 %",
        "pause 0.528 s",
    ]


def test_dots_stand_on_the_curve_at_the_times_of_metrics() -> None:
    (axes,) = draw_figure("heading", [RUN], page=MARKED).axes
    time_s, heading_deg = (
        (RUN.poses.time_ns - RUN.start_ns) / 1e9,
        np.degrees(RUN.poses.heading_rad),
    )
    dots = list_dots(axes)
    for name in ("rotate.rise_time", "rotate.settling_time", "rotate.peak"):
        at_s = METRICS[name].at_s
        assert at_s is not None
        level = float(np.interp(at_s, time_s, heading_deg))
        assert any(dot == pytest.approx((at_s, level)) for dot in dots)


def test_marks_cut_a_panel_to_its_phase_unless_times_are_given() -> None:
    (axes,) = draw_figure("heading", [RUN], page=MARKED).axes
    assert axes.get_xlim()[1] == pytest.approx(2.992 * 1.04)
    (axes,) = draw_figure("heading", [RUN], page=Page(has_marks=True, to_s=8.0)).axes
    assert axes.get_xlim()[1] == 8.0


def test_without_marks_nothing_is_marked() -> None:
    (axes,) = draw_figure("heading", [RUN]).axes
    assert (list_words(axes), list_dots(axes)) == ([], [])


@pytest.mark.everyday("heading-slide", "along-track-column")
@pytest.mark.parametrize("kind", ["column", "page", "slide"])
@pytest.mark.parametrize("name", ["heading", "along-track"])
def test_words_cover_neither_each_other_nor_dots_nor_leave_the_panel(
    kind: PageKind, name: str
) -> None:
    figure = draw_figure(name, [RUN], page=Page(kind=kind, has_marks=True))
    FigureCanvasAgg(figure).draw()
    (axes,) = figure.axes
    boxes = [text.get_window_extent() for text in axes.texts]
    assert len(boxes) >= 4
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
    dots = axes.transData.transform(list_dots(axes))
    assert not any(box.contains(*dot) for box in boxes for dot in dots)
    panel = axes.get_window_extent()
    assert all(panel.x0 <= box.x0 and box.x1 <= panel.x1 for box in boxes)
    assert all(panel.y0 <= box.y0 and box.y1 <= panel.y1 for box in boxes)


def test_words_without_room_are_left_out_and_their_dots_stay() -> None:
    panels = {
        kind: draw_figure("panel", [RUN], page=Page(kind=kind, has_marks=True)).axes
        for kind in ("page", "slide")
    }
    for name in ("heading", "heading_error"):
        (on_page, on_slide) = (
            next(axes for axes in found if str(axes.get_label()).strip("|") == name)
            for found in panels.values()
        )
        assert {*list_words(on_slide)} < {*list_words(on_page)}
        assert list_dots(on_slide) == list_dots(on_page)
        boxes = [text.get_window_extent() for text in on_slide.texts]
        assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))


@pytest.mark.thorough
def test_several_runs_have_a_table_in_their_colours_that_covers_no_curve() -> None:
    for kind in get_args(PageKind):
        figure = draw_figure("heading", RUNS, page=Page(kind=kind, has_marks=True))
        FigureCanvasAgg(figure).draw()
        (axes,) = figure.axes
        assert list_words(axes) == [
            "kp1: settled 4.08 s",
            "kp2: settled 2.78 s",
            "kp4: settled 2.28 s",
            "kp10: settled 2.21 s, overshoot 1 %",
        ]
        assert len({text.get_color() for text in axes.texts}) == len(RUNS)
        for run in RUNS:
            time_s = (run.poses.time_ns - run.start_ns) / 1e9
            curve = np.stack([time_s, np.degrees(run.poses.heading_rad)], axis=1)
            points = axes.transData.transform(curve)
            boxes = [text.get_window_extent() for text in axes.texts]
            assert not any(box.contains(*point) for box in boxes for point in points)


@pytest.mark.parametrize(
    ("count", "words"),
    [(4, "kp1: settled 4.08 s"), (5, "settled 2.21 to 4.08 s")],
)
def test_of_more_than_four_runs_extremes_are_told(count: int, words: str) -> None:
    (axes,) = draw_figure("heading", [*RUNS, RUN][:count], page=MARKED).axes
    assert list_words(axes)[0] == words
    assert len(list_dots(axes)) >= count


def test_extremes_say_of_how_many_runs_they_are() -> None:
    (axes,) = draw_figure("heading", [*RUNS, RUNS[0]], page=MARKED).axes
    assert list_words(axes)[1] == "overshoot 1.01 % (1 of 5 runs)"


@pytest.mark.thorough
def test_extremes_take_the_place_of_a_table_without_room() -> None:
    slide = draw_figure("panel", RUNS, page=Page(kind="slide", has_marks=True))
    words = {str(axes.get_label()): list_words(axes) for axes in slide.axes}
    assert words["along_track"][0] == "settled 5.58 to 6.63 s"
    assert words["heading"][0] == "kp1: settled 4.08 s"


def test_coordinates_have_arrival_settling_and_their_own_end_values() -> None:
    figure = draw_figure("position-error", [RUN], page=MARKED)
    assert RUN.goal_xy_m is not None
    for axes, goal_m, end_m in zip(figure.axes, RUN.goal_xy_m, RUN.poses.xy_m[-1], strict=True):
        assert {*list_words(axes)} == {
            *("pause 0.528 s", "settled 5.58 s", "near the goal 8.85 s"),
            f"at the end {goal_m - end_m:.3g} m",
        }
        assert any(dot[1] == pytest.approx(goal_m - end_m) for dot in list_dots(axes))


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("names", "lines"),
    [
        (["heading", "position-error", "panel"], ()),
        (
            ["plane", "heading", "speed"],
            ("left marks out of plane, speed: needs a curve with characteristics",),
        ),
    ],
)
def test_figures_without_marks_are_told(names: list[str], lines: tuple[str, ...]) -> None:
    """All figures that have no marks are drawn."""
    assert list_unmarked(RUNS, names) == lines
    for name in names:
        words = [
            word for axes in draw_figure(name, [RUN], page=MARKED).axes for word in list_words(axes)
        ]
        plain = [word for axes in draw_figure(name, [RUN]).axes for word in list_words(axes)]
        assert (words == plain) == any(name in line for line in lines)


def test_an_error_s_band_lies_around_zero() -> None:
    (axes,) = draw_figure("heading-error", [RUN], page=MARKED).axes
    assert "settled 2.21 s" in list_words(axes)
    levels = [np.unique(np.asarray(line.get_ydata())).tolist() for line in axes.get_lines()]
    half_deg = 0.02 * 128.50264418385171
    assert [pytest.approx(half_deg)] in levels
    assert [pytest.approx(-half_deg)] in levels
