"""What figures show, read from their structure."""

import io
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

import turtlelog as tl
from tests.draw.figures.paper_runs import keep_poses, simulate
from tests.draw.laws import simulate_pid, simulate_tracker
from tests.draw.rerun.rrds import make_foreign_run
from turtlelog.draw.figures.figure_curves import choose_lines
from turtlelog.draw.figures.page import Page, PageKind, break_label, save_figure
from turtlelog.draw.figures.theory_figures import find_gains
from turtlelog.errors import ShowError
from turtlelog.run import PoseColumns
from turtlelog.scenario import get_preset

GAINS = (1, 2, 4, 10)
RUNS = [simulate(kp) for kp in GAINS]


def list_legend(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def find_line(figure: Figure, label: str, axes: int = 0) -> tuple[np.ndarray, np.ndarray]:
    (line,) = [line for line in figure.axes[axes].get_lines() if line.get_label() == label]
    return np.asarray(line.get_xdata()), np.asarray(line.get_ydata())


@pytest.mark.parametrize("kp", GAINS)
def test_the_plant_s_responses_and_the_closed_loop_s_are_the_textbook_s(kp: int) -> None:
    time_s, values = find_line(tl.draw.draw_figure("step-responses", [simulate(kp)]), f"Kp = {kp}")
    assert values == pytest.approx(1.0 - np.exp(-kp * time_s), abs=1e-12)
    place, _ = find_line(tl.draw.draw_figure("root-locus", [simulate(kp)]), f"Kp = {kp}")
    assert place.tolist() == [-kp]


def test_the_plant_answers_a_ramp_with_a_parabola() -> None:
    figure = tl.draw.draw_figure("plant")
    curves = [axes.get_lines()[0].get_xydata() for axes in figure.axes]
    assert all(np.asarray(curve).shape == (201, 2) for curve in curves)
    impulse, step, ramp = (np.asarray(curve) for curve in curves)
    assert (impulse[:, 1] == 1.0).all()
    # python-control integrates step by step: 4e-14 off after 5 s.
    assert step[:, 1] == pytest.approx(step[:, 0], abs=1e-12)
    assert ramp[:, 1] == pytest.approx(ramp[:, 0] ** 2 / 2.0)


def test_commands_hold_until_the_next() -> None:
    (line,) = [
        line
        for line in tl.draw.draw_figure("turn-rate", [simulate(4)]).axes[0].get_lines()
        if line.get_label() == "commanded"
    ]
    assert line.get_drawstyle() == "steps-post"


def test_what_the_law_wanted_reaches_57_metres_a_second() -> None:
    figure = tl.draw.draw_figure("wanted-speed", RUNS)
    largest = [float(find_line(figure, f"paper-kp{kp}")[1].max()) for kp in GAINS]
    assert largest == pytest.approx([5.69, 11.39, 22.77, 56.94], abs=0.02)


def test_errors_stand_on_a_logarithmic_scale_where_exponentials_are_straight() -> None:
    figure = tl.draw.draw_figure("error-log", [simulate(1)])
    assert [axes.get_yscale() for axes in figure.axes] == ["log", "log"]
    time_s, sizes = find_line(figure, "paper-kp1")
    free = (time_s > 3.0) & (time_s < 6.0)
    slope = np.polyfit(time_s[free], np.log(sizes[free]), 1)[0]
    # Six ticks of dead time let it decay a little faster than exp(-t).
    assert slope == pytest.approx(-1.1, abs=0.02)


def test_the_plane_keeps_its_proportions_and_shows_how_runs_end() -> None:
    figure = tl.draw.draw_figure("plane", RUNS)
    whole, close = figure.axes
    assert (whole.get_aspect(), close.get_aspect()) == (1.0, 1.0)
    low, high = close.get_xlim()
    assert high - low < 0.5
    assert low < 2.0 < high


@pytest.mark.parametrize(("kind", "width_mm"), [("column", 87.5), ("page", 181.0)])
def test_figures_are_as_wide_as_the_page_has_room(kind: PageKind, width_mm: float) -> None:
    figure = tl.draw.draw_figure("heading", [simulate(1)], page=tl.draw.Page(kind=kind))
    assert figure.get_size_inches()[0] * 25.4 == pytest.approx(width_mm)


@pytest.mark.parametrize("text_width_mm", [0.0, 119.0, 1001.0, float("nan"), float("inf")])
def test_a_page_of_no_sensible_width_is_refused(text_width_mm: float) -> None:
    with pytest.raises(ShowError, match="text width: expected 120 to 1000 mm"):
        tl.draw.Page(text_width_mm=text_width_mm)


def test_runs_stand_in_the_order_of_their_gains() -> None:
    figure = tl.draw.draw_figure("heading", [simulate(10), simulate(2), simulate(4), simulate(1)])
    assert list_legend(figure)[:4] == ["paper-kp1", "paper-kp2", "paper-kp4", "paper-kp10"]


@pytest.mark.everyday("panel-4", "heading-1")
@pytest.mark.parametrize(
    ("name", "runs"), [("heading", 1), ("panel", 4), ("plane", 20), ("root-locus", 20)]
)
def test_a_legend_names_everything_once_and_covers_no_curve(name: str, runs: int) -> None:
    drawn = (RUNS * 5)[:runs]
    figure = tl.draw.draw_figure(name, drawn, page=tl.draw.Page(text_width_mm=120.0))
    figure.draw_without_rendering()
    names = list_legend(figure)
    assert len(set(names)) == len(names)
    box = figure.legends[0].get_window_extent()
    # The last pixel of each side is the renderer's rounding.
    assert box.x0 > -1.0
    assert box.x1 < figure.bbox.x1 + 1.0
    assert box.y1 < figure.bbox.y1 + 1.0
    assert all(axes.get_window_extent().y1 <= box.y0 + 1.0 for axes in figure.axes)


def test_a_plane_that_stands_alone_takes_one_column() -> None:
    short = simulate(1).slice(end_s=1.0)
    figure = tl.draw.draw_figure("plane", [short])
    width, height = figure.get_size_inches()
    assert len(figure.axes) == 1
    assert width == pytest.approx(87.5 / 25.4)
    assert height > width


OF_ONE = ("attribution", "luck", "rates")
"""Figures of one run."""


@pytest.mark.everyday("panel", "plane")
@pytest.mark.parametrize("name", [name for name in tl.draw.FIGURES if name != "violation"])
def test_no_lettering_is_cut_off_on_the_narrowest_page(name: str) -> None:
    """A figure is drawn as a whole."""
    runs = {"path-error": [simulate_tracker("kanayama")], "states": [simulate_pid()]}
    narrow = tl.draw.Page(text_width_mm=120.0)
    drawn = RUNS[-1:] if name in OF_ONE else runs.get(name, RUNS)
    figure = tl.draw.draw_figure(name, drawn, page=narrow)
    figure.draw_without_rendering()
    page = figure.bbox
    left, low, right, high = np.multiply(figure.get_tightbbox().extents, figure.dpi)
    assert left > -1.0
    assert low > -1.0
    assert right < page.x1 + 1.0
    assert high < page.y1 + 1.0


@pytest.mark.parametrize(("count", "markers"), [(1, 0), (2, 2), (4, 4), (7, 7), (8, 0)])
def test_a_few_runs_differ_in_colour_and_marker_and_in_no_dash(count: int, markers: int) -> None:
    looks = choose_lines(count)
    assert len({to_rgb(look["color"]) for look in looks}) == count
    assert len({look["marker"] for look in looks if "marker" in look}) == markers
    assert not any("linestyle" in look for look in looks)


@pytest.mark.parametrize(("count", "width"), [(13, None), (24, None), (25, 0.7), (100, 0.7)])
def test_of_many_runs_the_lines_are_thin(count: int, width: float | None) -> None:
    assert {look.get("linewidth") for look in choose_lines(count)} == {width}


@pytest.mark.parametrize("count", [2, 3, 4, 20])
def test_runs_stay_apart_in_grey(count: int) -> None:
    red_green_blue = np.array([to_rgb(look["color"]) for look in choose_lines(count)])
    greys = np.sort(red_green_blue @ [0.299, 0.587, 0.114])
    # With 3:1 to paper and to the viewer's ground, 20 runs share a quarter of the greys.
    assert np.diff(greys).min() > (0.08 if count <= 4 else 0.008)
    assert greys.max() < 0.8  # of white


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("_first", " _first"),
        ("ideal", "run ideal"),
        ("cost $5 and $x_", "cost \\$5 and \\$x_"),
        ("\u9f9f \u03c4", "? \u03c4"),
        ("a-long-name-of-a-run-" * 5, "a-long-name-of…ame-of-a-run-"),
    ],
    ids=["hidden", "taken", "dollars", "no glyph", "long"],
)
def test_names_of_all_kinds_can_be_printed(name: str, shown: str) -> None:
    figure = tl.draw.draw_figure("heading", [replace(simulate(1), name=name)])
    figure.draw_without_rendering()
    assert list_legend(figure) == [shown, "goal bearing", "ideal"]


def test_names_that_differ_in_the_middle_stay_apart() -> None:
    runs = [replace(simulate(1), name=f"{'a' * 40}{part}{'b' * 40}") for part in "xy"]
    first, second = list_legend(tl.draw.draw_figure("heading", runs))[:2]
    assert (first[:2], second[:2]) == ("1:", "2:")


@pytest.mark.parametrize("command", ["speed", "turn-rate"])
def test_commands_of_a_bag_are_those_of_its_topic(command: str) -> None:
    bag = make_foreign_run(50)
    time_s, values = find_line(tl.draw.draw_figure(command, [bag]), "commanded")
    commands = bag.commands
    expected = commands.speed_m_s if command == "speed" else commands.turn_rate_rad_s
    assert values.tolist() == expected.tolist()
    assert time_s == pytest.approx((commands.time_ns - bag.start_ns) / 1e9)
    _, compared = find_line(tl.draw.draw_figure(command, [bag, simulate(4)]), "bag")
    assert compared.tolist() == expected.tolist()


def test_an_axis_says_what_time_zero_is() -> None:
    bag = make_foreign_run(50)
    labels = [
        tl.draw.draw_figure("position", runs).axes[-1].get_xlabel()
        for runs in ([simulate(4)], [bag], [simulate(4), bag])
    ]
    assert labels == [
        "time from the first sample [s]",
        "time from the first pose [s]",
        "time from the first sample or pose [s]",
    ]


def test_an_axis_of_commands_holds_those_of_a_run_without_limits() -> None:
    bag = make_foreign_run(50)
    fast = replace(bag, commands=replace(bag.commands, speed_m_s=np.full(50, 2.0)))
    low, high = tl.draw.draw_figure("speed", [simulate(4), fast]).axes[0].get_ylim()
    assert low < 0.0
    assert high > 2.0


def test_a_panel_has_no_empty_views() -> None:
    figure = tl.draw.draw_figure("panel", [make_foreign_run(50)])
    assert [axes.get_ylabel() for axes in figure.axes] == [
        "y [m]",
        "heading\n[deg]",
        "turn rate\n[rad/s]",
        "speed\n[m/s]",
    ]
    assert all(axes.lines for axes in figure.axes)
    whole = tl.draw.draw_figure("panel", [simulate(4)])
    assert figure.get_size_inches()[1] < whole.get_size_inches()[1]


def test_theory_is_of_the_gains_of_the_runs_or_of_the_paper_s() -> None:
    bag = make_foreign_run(50)
    assert find_gains([bag]) == ()
    assert find_gains([bag, simulate(4)]) == (4.0,)
    assert find_gains([]) == (1.0, 2.0, 4.0, 10.0)


def list_words(axes: Axes) -> list[str]:
    return [text.get_text() for text in axes.texts]


@pytest.mark.parametrize(
    ("label", "lines"),
    [
        ("turn rate [rad/s]", "turn rate\n[rad/s]"),
        ("along-track error [m]", "along-track\nerror [m]"),
        ("|heading error| [deg]", "|heading\nerror| [deg]"),
        ("lyapunov", "lyapunov"),
    ],
)
def test_labels_of_low_panels_have_two_lines_of_similar_length(label: str, lines: str) -> None:
    assert break_label(label) == lines


def test_a_slide_has_room_for_the_labels_of_planes() -> None:
    figure = tl.draw.draw_figure("plane", RUNS, page=Page(kind="slide"))
    save_figure(figure, io.BytesIO(), "png", Page(kind="slide"))
    boxes = [axes.get_tightbbox() for axes in figure.axes]
    assert all(box is not None and box.y0 >= 0.0 for box in boxes)


def test_the_close_up_tells_how_far_each_run_ends_from_the_goal() -> None:
    _, close = tl.draw.draw_figure("plane", RUNS).axes
    assert list_words(close) == [
        *("kp1: 2.52 mm\nkp2: 1.01 mm\nkp4: 8.52 mm", "kp10: 107 mm", "50 mm", "100 mm")
    ]
    assert close.get_xlim() == pytest.approx((1.85, 2.15))
    assert close.get_ylim() == pytest.approx((9.85, 10.15))


def test_where_no_run_ends_at_the_goal_there_is_no_close_up() -> None:
    far = replace(simulate(4), goal_xy_m=(2.0, 2.0))
    (whole,) = tl.draw.draw_figure("plane", [far]).axes
    assert whole.get_title() == "whole paths"
    _, close = tl.draw.draw_figure("plane", [simulate(4), stop_far_away(simulate(1))]).axes
    assert close.get_title() == "how each run ends, 1 of 2 runs outside"


def stop_far_away(run: tl.Run) -> tl.Run:
    xy_m = np.array(run.poses.xy_m)
    xy_m[-1] = 5.0, 5.0
    return replace(run, poses=replace(run.poses, xy_m=xy_m))


def test_a_run_of_one_pose_is_a_dot() -> None:
    poses = PoseColumns(time_ns=np.array([0]), xy_m=np.zeros((1, 2)), heading_rad=np.zeros(1))
    figure = tl.draw.draw_figure("position", [replace(keep_poses(simulate(4)), poses=poses)])
    (line,) = (line for line in figure.axes[0].get_lines() if line.get_label() == "paper-kp4")
    assert (len(np.asarray(line.get_xdata())), line.get_marker()) == (1, "o")


def test_a_long_run_is_thinned_and_says_so() -> None:
    poses = tl.simulate_run(get_preset("textbook")).poses
    rows = np.arange(30_000)
    long = replace(
        poses,
        time_ns=rows * 16_000_000,
        xy_m=np.column_stack([np.sin(rows / 100.0), np.cos(rows / 100.0)]),
        heading_rad=np.zeros(30_000),
        speed_m_s=None,
        turn_rate_rad_s=None,
    )
    run = replace(keep_poses(simulate(4)), poses=long)
    for name in ("position", "plane"):
        figure = tl.draw.draw_figure(name, [run])
        (line,) = (line for line in figure.axes[0].get_lines() if line.get_label() == run.name)
        drawn = np.asarray(line.get_ydata())
        assert len(drawn) < 21_000
        assert drawn.max() == long.xy_m[:, 0 if name == "position" else 1].max()
        assert "over 20,000 points are\nthinned" in figure.get_supxlabel()


@pytest.mark.parametrize(("far_m", "is_drawn"), [(1e150, True), (1.1e150, False), (1.7e308, False)])
def test_a_pose_that_no_axis_reaches_is_an_error(far_m: float, *, is_drawn: bool) -> None:
    run = simulate(4)
    xy_m = run.poses.xy_m.copy()
    xy_m[7, 0] = -far_m
    far = replace(run, poses=replace(run.poses, xy_m=xy_m))
    if is_drawn:
        tl.draw.draw_figure("plane", [far])
        return
    with pytest.raises(ShowError, match=r"from the origin, and pictures show 1e\+150 m at most"):
        tl.draw.draw_figure("plane", [far])
