"""Figures of somebody's robot: poses, and commands and measured rates where there are any."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import turtlelog as tl
from tests.compare.trajectories import make_trajectory
from tests.draw.rerun.rrds import make_foreign_run
from tests.draw.robots import OUTLIER, OUTLIER_ROW, keep_no_commands, make_robot
from tests.log.runs import find_shared
from turtlelog.compare import compare_trajectories
from turtlelog.compare.trajectory_errors import take_poses
from turtlelog.draw import Page
from turtlelog.draw.figures import page, robot_figures
from turtlelog.draw.figures.time_panels import draw_time_plot
from turtlelog.draw.figures.writing import list_left_out
from turtlelog.errors import ShowError
from turtlelog.log.ros2 import read_bag


def find_axes(figure: Figure, label: str) -> Axes:
    [found] = [axes for axes in figure.axes if axes.get_ylabel().split()[0] == label]
    return found


def list_labels(axes: Axes) -> list[str]:
    return axes.get_legend_handles_labels()[1]


def test_measured_rates_stand_beside_the_commands() -> None:
    axes = tl.draw.draw_figure("speed", [make_robot()]).axes[0]
    assert list_labels(axes) == ["commanded", "measured"]
    measured = axes.get_lines()[-1].get_ydata()
    assert np.asarray(measured) == pytest.approx(make_robot().poses.measured_speed_m_s)


def test_an_outlier_is_named_and_does_not_set_the_range() -> None:
    axes = tl.draw.draw_figure("turn-rate", [make_robot()]).axes[0]
    low, high = axes.get_ylim()
    assert -0.6 < low < high < 0.5
    assert [text.get_text() for text in axes.texts] == ["outlier -143.6 rad/s at 6.0 s"]
    assert list_labels(axes) == ["commanded", "measured", "outlier"]
    drawn = np.concatenate([np.asarray(line.get_ydata(), float) for line in axes.get_lines()])
    assert np.abs(drawn).max() < 1.0
    # It stays in the data.
    assert make_robot().poses.measured_turn_rate_rad_s[OUTLIER_ROW] == OUTLIER  # type: ignore[index]


def test_what_a_robot_measured_is_enough_for_a_panel() -> None:
    bag = keep_no_commands(make_robot())
    axes = tl.draw.draw_figure("turn-rate", [bag]).axes[0]
    assert list_labels(axes) == ["measured", "outlier"]
    assert not any("turn-rate" in line for line in list_left_out([bag]))


def test_of_several_robots_each_has_its_measured_rate_and_its_commands_in_its_colour() -> None:
    axes = tl.draw.draw_figure("turn-rate", [make_robot("a"), make_robot("b")]).axes[0]
    assert list(dict.fromkeys(list_labels(axes))) == ["commanded", "a", "b", "outlier"]
    by_label = {line.get_label(): line.get_color() for line in axes.get_lines()}
    assert by_label["a"] != by_label["b"]
    assert [text.get_text() for text in axes.texts] == [
        "a: outlier -143.6 rad/s at 6.0 s\nb: outlier -143.6 rad/s at 6.0 s"
    ]


def test_a_command_is_thin_beside_the_measured_rate_of_another_robot() -> None:
    poses = replace(make_robot().poses, measured_turn_rate_rad_s=None, measured_speed_m_s=None)
    unmeasured = replace(make_robot("b"), poses=poses)
    axes = tl.draw.draw_figure("turn-rate", [make_robot("a"), unmeasured]).axes[0]
    widths = {(line.get_label(), line.get_linewidth()) for line in axes.get_lines()}
    assert {width for label, width in widths if label == "commanded"} == {0.5}
    assert "b" not in {label for label, _ in widths}


def test_the_overview_of_a_robot_holds_its_path_and_what_is_there() -> None:
    figure = tl.draw.draw_figure("panel", [make_robot()])
    assert [axes.get_ylabel().split()[0] for axes in figure.axes] == [
        *("y", "heading", "turn", "speed"),
    ]
    plane = find_axes(figure, "y")
    xy_m = make_robot().poses.xy_m
    (low, high), size = plane.get_xlim(), np.ptp(xy_m, axis=0).max()
    assert low < xy_m[:, 0].min()
    assert xy_m[:, 0].max() < high < low + 1.3 * size
    assert list_labels(plane) == ["robot", "end", "start"]
    bag = keep_no_commands(replace(make_robot(), poses=make_foreign_run(50).poses))
    bare = replace(bag.poses, speed_m_s=None, turn_rate_rad_s=None)
    alone = tl.draw.draw_figure("panel", [replace(bag, poses=bare)])
    assert [axes.get_ylabel().split()[0] for axes in alone.axes] == ["y", "heading"]


def test_the_plane_of_a_robot_stands_alone() -> None:
    figure = tl.draw.draw_figure("plane", [make_robot()])
    assert [axes.get_title() for axes in figure.axes] == [""]
    width, height = figure.get_size_inches()
    assert width < 4.0
    assert height > 0.9 * width


def test_what_only_a_controller_has_is_left_out_in_one_line() -> None:
    lines = list_left_out([make_robot()])
    assert [line.partition(": ")[2] for line in lines] == [
        "needs the controller's samples",
        "needs a goal",
    ]


@pytest.mark.parametrize("signal", ["x", "heading"])
def test_no_curve_leads_across_a_jump_of_a_real_turtlesim(signal: str) -> None:
    run = tl.read_run(find_shared("ros2", "turtlesim_jazzy"))
    axes = Figure().subplots()
    draw_time_plot(axes, [run], name=signal)
    (line,) = axes.lines
    time_s, values = np.asarray(line.get_xydata()).T
    rows = np.flatnonzero(np.isnan(values))
    assert len(values) == len(run.poses) + len(rows)
    (row,) = [row for row in rows if abs(time_s[row] - 15.632) < 1e-3]
    assert time_s[row - 1 : row + 2] == pytest.approx([14.032, 15.632, 15.632], abs=1e-3)


def test_a_jump_of_a_real_turtlesim_is_no_part_of_its_path() -> None:
    run = read_bag(find_shared("ros2", "turtlesim_jazzy"))
    line = tl.draw.draw_figure("plane", [run]).axes[0].get_lines()[0]
    xy_m = np.column_stack([np.asarray(values, float) for values in line.get_data()])
    [row] = np.flatnonzero(np.isnan(xy_m).any(axis=1))
    assert run.poses.time_ns[row] == 15_632_487_045
    assert np.nanmax(np.hypot(*np.diff(xy_m, axis=0).T)) < 0.1


def test_a_figure_that_no_panel_can_fill_says_what_it_needs() -> None:
    with pytest.raises(ShowError, match="wanted-turn-rate needs what the law wanted before"):
        tl.draw.draw_figure("wanted-turn-rate", [make_robot()])


def test_a_window_fades_the_path_on_both_sides_of_a_gap() -> None:
    run = make_robot()
    late_ns = 3_000_000_000 * (np.arange(len(run.poses)) >= len(run.poses) // 2)
    run = replace(run, poses=replace(run.poses, time_ns=run.poses.time_ns + late_ns))
    axes = tl.draw.draw_figure("plane", [run], page=Page(from_s=2.0, to_s=9.0)).axes[0]
    (strong,) = [line for line in axes.get_lines() if line.get_label() == "robot"]
    x_m = np.asarray(strong.get_xdata(), float)
    time_s = (run.poses.time_ns - run.start_ns) / 1e9
    assert np.isfinite(x_m).sum() == ((time_s >= 2.0) & (time_s <= 9.0)).sum()


@pytest.mark.parametrize(
    ("lost", "gaps"), [(0, []), (20, ["1 s without pairs"]), (100, ["5 s without pairs"])]
)
def test_errors_of_a_trajectory_break_where_it_has_no_pairs(
    lost: int, gaps: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its reference is continuous there, and is drawn with all of its poses."""
    drawn: list[Figure] = []
    monkeypatch.setattr(page, "write_figure", lambda figure, *_: drawn.append(figure))
    truth = make_trajectory(400)
    rows = np.delete(np.arange(400), np.arange(200, 199 + lost))
    found = compare_trajectories(truth, replace(take_poses(truth, rows), name="estimate"))
    robot_figures.write_trajectory_figure(found, tmp_path / "ate.svg")
    plane, *over_time = drawn[0].axes
    reference, estimate = (np.asarray(line.get_xydata()) for line in plane.get_lines()[:2])
    assert len(reference) == 400
    assert np.isfinite(reference).all()
    assert np.isnan(estimate).any(axis=1).sum() == len(gaps)
    for axes, broken in zip(over_time, (0, 0, 1), strict=True):
        errors = np.asarray(axes.get_lines()[broken].get_xydata())
        assert np.isnan(errors).any(axis=1).sum() == len(gaps)
        if not broken:
            assert [text.get_text() for text in axes.texts] == gaps
