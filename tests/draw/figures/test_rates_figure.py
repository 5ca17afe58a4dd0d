"""Commands against measured rates, with the identified model."""

import re
from dataclasses import replace

import numpy as np
import pytest

import turtlelog as tl
from tests.draw.figures.paper_runs import make_figure, read
from tests.identify.robots import Log, make_run
from turtlelog.charts.curves import Curve
from turtlelog.charts.plotted_curves import find_command_changes
from turtlelog.draw.figures.robot_figures import draw_rates
from turtlelog.errors import ShowError
from turtlelog.identify import identify_robot


@pytest.fixture(scope="module")
def robot() -> tl.Run:
    return make_run(Log(duration_s=12.0, noise_m=0.0, noise_rad=0.0, jitter_s=0.0), 1)


def test_rates_name_what_identification_found(robot: tl.Run) -> None:
    figure, model = make_figure(), identify_robot([robot])
    draw_rates(figure, [robot])
    titles = [axes.get_title(loc="right") for axes in figure.axes]
    titles = [title for title in titles if "dead time" in title]
    told = [[float(number) for number in re.findall(r"(\d[\d.]*) ms", title)] for title in titles]
    for (dead_ms, lag_ms), axis in zip(told, model.axes, strict=True):
        assert axis.dead_time_s is not None
        assert axis.lag_s is not None
        assert dead_ms == pytest.approx(1e3 * axis.dead_time_s.value, abs=1.0)
        assert lag_ms == pytest.approx(1e3 * axis.lag_s.value, abs=1.0)


def test_a_step_that_does_not_count_is_marked_where_it_is_off(robot: tl.Run) -> None:
    xy_m = robot.poses.xy_m.copy()
    xy_m[100:] += 0.5
    jumping = replace(robot, poses=replace(robot.poses, xy_m=xy_m))
    model, figure = identify_robot([jumping]), make_figure()
    draw_rates(figure, [jumping], model=model)
    marks = [
        (axes, line)
        for axes in figure.axes
        for line in axes.get_lines()
        if line.get_label() == "left out of the fit"
    ]
    assert len(marks) == sum(axis.outliers > 0 for axis in model.axes) > 0
    axes, line = marks[0]
    assert axes.get_ylabel() == "residual\n[m/s]"
    residual = np.concatenate([np.asarray(one.get_ydata()) for one in axes.get_lines()[1:2]])
    assert np.abs(np.asarray(line.get_ydata())).max() == np.abs(residual).max() > 0.5
    time_s, largest = max(np.asarray(line.get_xydata()).tolist(), key=lambda at: abs(at[1]))
    told = f"left out: {largest:+.3g} m/s at {time_s:.2f} s"
    assert axes.texts[0].get_text().startswith(told)


def test_an_axis_that_is_not_identified_is_drawn_with_the_reason(robot: tl.Run) -> None:
    short = replace(
        robot, commands=replace(robot.commands, speed_m_s=0.3 + 0.0 * robot.commands.speed_m_s)
    )
    figure = make_figure()
    draw_rates(figure, [short])
    assert "not identified: " in figure.axes[0].get_title()


def test_the_motion_is_drawn_beside_commands_that_no_model_explains(robot: tl.Run) -> None:
    held = replace(robot.commands, speed_m_s=0.3 + 0.0 * robot.commands.speed_m_s)
    short = replace(robot, commands=held)
    figure = tl.draw.draw_figure("rates", [short])
    motions = {line.get_label(): line for line in figure.axes[0].get_lines()}
    motion = np.asarray(motions["motion, means of 0.1 s"].get_ydata())
    driven_m = np.linalg.norm(np.diff(robot.poses.xy_m, axis=0), axis=1).sum()
    assert np.abs(motion).mean() * robot.duration_s == pytest.approx(driven_m, rel=0.02)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert {"command", "motion, means of 0.1 s"} <= {*labels}


def test_no_line_breaks_between_a_number_and_its_unit(robot: tl.Run) -> None:
    model = identify_robot([robot])
    reason = "the interval of the total delay, 0 to 1.98 s, is wider than its value of 0.69 s"
    refused = replace(model, speed=replace(model.speed, status="not_identifiable", reason=reason))
    for letters in range(3):
        figure = make_figure()
        long = replace(refused, speed=replace(refused.speed, reason=letters * "x" + reason))
        draw_rates(figure, [robot], model=long)
        title = figure.axes[0].get_title()
        assert "\n" in title
        assert not re.search(r"\d\s*\ns", title)


@pytest.mark.parametrize(
    ("times_s", "values", "expected"),
    [
        ([0, 1, 2, 6], [0.0, 1.0, 0.0, 1.0], [(1, 0, 1), (2, 1, 0), (6, 0, 1)]),
        ([0, 1.0, 1.1, 1.2, 5], [0.0, 0.3, 0.6, 0.9, 0.9], [(1.1, 0, 0.9)]),
        ([0, 1, 3, 9], [0.0, 1.0, 0.81, 0.81], [(1, 0, 1)]),
        ([0, 1, 3, 9], [0.0, 1.0, 0.79, 0.79], [(1, 0, 1), (3, 1, 0.79)]),
        ([0, 1, 2], [0.5, 0.7, 0.9], [(0, 0, 0.5), (1, 0.5, 0.7), (2, 0.7, 0.9)]),
        ([0, 1], [0.0, 0.0], []),
    ],
    ids=["steps", "ramp", "small", "large-enough", "held", "none"],
)
def test_changes_of_a_command_are_those_in_one_direction(
    times_s: list[float], values: list[float], expected: list[tuple[float, float, float]]
) -> None:
    time_ns = np.array(np.array(times_s) * 1e9, dtype=np.int64)
    command = Curve(start_ns=0, time_ns=time_ns, values=np.array(values), holds=True)
    found = [(one.half_s, one.before, one.after) for one in find_command_changes(command)]
    assert found == [pytest.approx(one) for one in expected]


def test_the_motion_after_every_change_lies_under_its_model_and_shows_the_spread() -> None:
    """The queue of paper-kp10 lets the first command through at once, the others late."""
    figure = make_figure()
    draw_rates(figure, [read(10)])
    (axes,) = [one for one in figure.axes if "speed: 4 changes" in one.get_title("right")]
    motions = [one for one in axes.get_lines() if one.get_color() == "0.6"]
    models = [one for one in axes.get_lines() if one.get_zorder() == 2.4]
    assert len(motions) == len(models) == 4
    halves_s = [
        float(np.asarray(one.get_xdata())[np.argmax(np.asarray(one.get_ydata()) >= 0.5)])
        for one in motions
    ]
    assert halves_s[0] < 0.02
    assert min(halves_s[1:]) > 0.07


def test_responses_end_at_the_gain_and_commands_where_the_next_change_begins() -> None:
    """The turn rate changes between -0.5 and 0.5 rad/s, and back 0.1 s before the robot arrives."""
    log = Log(duration_s=24.0, noise_m=0.0, noise_rad=0.0, jitter_s=0.0)
    log = replace(log, turn_rate=replace(log.turn_rate, gain=0.9))
    time_s = np.arange(0.5, 23.5, 0.1)
    values = np.where(np.floor(time_s / 3.0) % 2.0, -0.5, 0.5)
    run, figure = make_run(log, 1, turn=(time_s, values), speed=(time_s, values)), make_figure()
    draw_rates(figure, [run])
    (axes,) = [one for one in figure.axes if "turn rate: " in one.get_title("right")]
    lines = {
        color: [one.get_xydata() for one in axes.get_lines() if one.get_color() == color]
        for color in ("0.3", "0.6")
    }
    models = [one.get_xydata() for one in axes.get_lines() if one.get_zorder() == 2.4]
    ends = [float(np.asarray(line)[-1, 1]) for line in (*models[1:], *lines["0.6"][1:])]
    assert ends == pytest.approx([0.9] * len(ends), abs=5e-3)
    assert len(ends) == 2 * (len(models) - 1) > 8
    commands = np.concatenate([np.asarray(line) for line in lines["0.3"]])
    assert commands[commands[:, 0] >= 0.0, 1] == pytest.approx(1.0)


def test_rates_over_the_whole_run_are_drawn_as_the_means_that_they_are() -> None:
    """Lines between the middles of means would begin a tenth of a second before the command."""
    figure = make_figure()
    draw_rates(figure, [read(10)])
    means = [
        line
        for axes in figure.axes
        for line in axes.get_lines()
        if line.get_drawstyle() == "steps-mid"
    ]
    assert len(means) == 6
    assert {*map(str, (line.get_label() for line in means[:2]))} == {
        "motion, means of 0.1 s",
        "model, means of 0.1 s",
    }


def test_without_commands_there_are_no_rates(robot: tl.Run) -> None:
    still = {name: 0.0 * getattr(robot.commands, name) for name in ("speed_m_s", "turn_rate_rad_s")}
    silent = replace(robot, commands=replace(robot.commands, **still))
    with pytest.raises(ShowError, match="figure rates needs commands"):
        tl.draw.draw_figure("rates", [silent])
