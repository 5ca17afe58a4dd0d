"""Figures of a part of time."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

import turtlelog as tl
from turtlelog.draw import Page, draw_figure
from turtlelog.draw.figures.marked_panels import cut_time_axes, list_time_axes
from turtlelog.errors import ShowError
from turtlelog.scenario import get_preset

RUN = tl.simulate_run(get_preset("paper-kp10"))
TIMELESS = sorted(name for name, kind in tl.draw.FIGURES.items() if kind.is_timeless)


def test_time_axes_are_cut_and_curves_have_the_height_that_they_have_there() -> None:
    (axes,) = draw_figure("heading", [RUN], page=Page(from_s=2.0, to_s=3.0)).axes
    assert axes.get_xlim() == (2.0, 3.0)
    low, high = axes.get_ylim()
    time_s = (RUN.poses.time_ns - RUN.start_ns) / 1e9
    shown = np.degrees(RUN.poses.heading_rad[(time_s >= 2.0) & (time_s <= 3.0)])
    assert low < shown.min()
    assert high > shown.max()
    assert high - low < 1.2 * np.ptp(shown)


def test_an_axis_ends_where_its_curves_rest_from_the_first_part_on_and_says_until_when() -> None:
    (axes,) = draw_figure("heading", [RUN]).axes
    assert 2.5 < axes.get_xlim()[1] < 0.6 * float(RUN.duration_s)
    assert axes.get_xlabel() == "time from the first sample [s]\nwithin 1 % until 12.6 s"
    for name in ("along-track", "wanted-turn-rate", "panel"):
        *_, axes = draw_figure(name, [RUN]).axes
        assert axes.get_xlim()[1] > float(RUN.duration_s)
        assert axes.get_xlabel() == "time from the first sample [s]"


def test_only_a_robot_whose_position_rests_too_is_called_at_rest() -> None:
    last = int(np.searchsorted(RUN.poses.time_ns, RUN.start_ns + 2_600_000_000))
    rows = np.minimum(np.arange(len(RUN.poses)), last)
    xy_m, heading_rad = RUN.poses.xy_m[rows], RUN.poses.heading_rad[rows]
    held = replace(RUN.poses, xy_m=xy_m, heading_rad=heading_rad)
    (axes,) = draw_figure("heading", [replace(RUN, poses=held)]).axes
    assert axes.get_xlabel() == "time from the first sample [s]\nat rest until 12.6 s"
    turned = replace(RUN.poses, heading_rad=heading_rad)
    (axes,) = draw_figure("heading", [replace(RUN, poses=turned)]).axes
    assert axes.get_xlabel() == "time from the first sample [s]\nwithin 1 % until 12.6 s"


@pytest.mark.parametrize(("at_s", "is_cut"), [(5.9, True), (6.1, False)])
def test_curves_rest_where_they_stay_within_a_hundredth(at_s: float, *, is_cut: bool) -> None:
    figure = Figure()
    axes = figure.subplots()
    axes.plot([0.0, at_s - 0.1, at_s, 10.0], [0.0, 0.0, 0.991, 1.0])
    axes.set(xlim=(0.0, 10.0), ylim=(0.0, 1.0), xlabel="time from the first sample [s]")
    cut_time_axes(figure, [RUN], Page())
    assert axes.get_xlim()[1] == pytest.approx(1.15 * at_s if is_cut else 10.0)


def test_a_line_between_two_far_poses_is_drawn_to_its_end() -> None:
    figure = Figure()
    axes = figure.subplots()
    axes.plot([0.0, 4.0, 9.0, 10.0], [0.0, 0.5, 1.0, 1.0])
    axes.set(xlim=(0.0, 10.0), ylim=(0.0, 1.0), xlabel="time from the first sample [s]")
    cut_time_axes(figure, [RUN], Page())
    assert axes.get_xlim()[1] == 10.0


def test_an_axis_does_not_end_before_a_gap_in_its_curves() -> None:
    figure = Figure()
    axes = figure.subplots()
    axes.plot([0.0, 1.0, 4.0, 10.0], [0.0, 1.0, np.nan, 1.0])
    axes.set(xlim=(0.0, 10.0), ylim=(0.0, 1.0), xlabel="time from the first sample [s]")
    cut_time_axes(figure, [RUN], Page())
    assert axes.get_xlim()[1] == pytest.approx(1.15 * 4.0)


def test_only_one_end_may_be_given() -> None:
    (axes,) = draw_figure("heading", [RUN], page=Page(from_s=2.0)).axes
    assert axes.get_xlim() == pytest.approx((2.0, 12.608))


def test_panels_of_a_stack_are_cut_together_and_limits_stay_in_sight() -> None:
    figure = draw_figure("panel", [RUN], page=Page(to_s=3.0))
    assert all(axes.get_xlim()[1] == 3.0 for axes in figure.axes[1:])
    (rate,) = [axes for axes in figure.axes if axes.get_ylabel() == "turn rate [rad/s]"]
    assert rate.get_ylim()[1] > 1.0


@pytest.mark.parametrize("name", [*TIMELESS, "panel", "position"])
def test_figures_that_no_time_can_cut_have_no_such_axis(name: str) -> None:
    assert bool(list_time_axes(draw_figure(name, [RUN]))) == (name not in TIMELESS)


def test_the_plane_has_no_time_axis() -> None:
    cut, whole = (draw_figure("plane", [RUN], page=page) for page in (Page(to_s=3.0), Page()))
    assert [axes.get_xlim() for axes in cut.axes] == [axes.get_xlim() for axes in whole.axes]


def test_a_path_is_strong_within_the_times_and_faint_outside() -> None:
    whole, strong, close = draw_path(Page(from_s=4.0, to_s=5.0))
    time_s = (RUN.poses.time_ns - RUN.start_ns) / 1e9
    driven_m = RUN.poses.xy_m[(time_s >= 4.0) & (time_s <= 5.0)]
    np.testing.assert_array_equal(strong[~np.isnan(strong[:, 0])], driven_m)
    np.testing.assert_array_equal(whole, RUN.poses.xy_m)
    assert close == "whole paths, 4 to 5 s strong"


def test_without_times_a_path_is_drawn_once() -> None:
    (axes, _) = draw_figure("plane", [RUN]).axes
    assert [line.get_alpha() for line in axes.get_lines() if line.get_label() == RUN.name] == [None]


def draw_path(page: Page) -> tuple[np.ndarray, np.ndarray, str]:
    """Return the faint and the strong path, and the title."""
    (axes, _) = draw_figure("plane", [RUN], page=page).axes
    (strong,) = [line for line in axes.get_lines() if line.get_label() == RUN.name]
    (whole,) = [line for line in axes.get_lines() if line.get_alpha() == 0.25]
    found = [np.asarray(line.get_xydata()) for line in (whole, strong)]
    return found[0], found[1], axes.get_title()


def test_times_beyond_the_runs_are_refused() -> None:
    assert draw_figure("heading", [RUN], page=Page(to_s=12.608))
    with pytest.raises(ShowError, match=r"^to: expected -?[0-9.]+ to 12.608 s"):
        draw_figure("heading", [RUN], page=Page(to_s=12.609))


@pytest.mark.parametrize("name", ["heading", "panel", "plane", "gains"])
def test_every_slide_is_16_to_9(name: str) -> None:
    width, height = draw_figure(name, [RUN], page=Page(kind="slide")).get_size_inches()
    assert width / height == pytest.approx(16 / 9)
