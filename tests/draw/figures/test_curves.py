"""Each figure draws the columns of its runs, in the units of its labels, with what they aim at."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import turtlelog as tl
from turtlelog.draw.figures.figure_curves import draw_thinned
from turtlelog.scenario import get_preset, override_scenario

Values = Any
Read = Callable[[tl.Run], Values]

LABELS = {
    "plant": ["response of 1/s", "", ""],
    "step-responses": ["response to a unit step"],
    "root-locus": ["imaginary part [1/s]", "imaginary part of z", ""],
    "heading": ["heading [deg]"],
    "position": ["x [m]", "y [m]"],
    "heading-error": ["heading error [deg]"],
    "position-error": ["error in x [m]", "error in y [m]"],
    "turn-rate": ["turn rate [rad/s]"],
    "speed": ["speed [m/s]"],
    "wanted-speed": ["wanted speed [m/s]"],
    "world-velocity": ["$K_p e_x$ [m/s]", "$K_p e_y$ [m/s]"],
    "error-log": ["|heading error| [deg]", "distance [m]"],
    "plane": ["y [m]", ""],
    "panel": [
        *("y [m]", "heading [deg]", "along-track [m]", "|heading error| [deg]", "cross-track [m]"),
        *("turn rate [rad/s]", "speed [m/s]"),
    ],
}


def find_bearing(run: tl.Run) -> float:
    assert run.samples.bearing_rad is not None
    return float(run.samples.bearing_rad[0])


def heading(run: tl.Run) -> Values:
    return np.degrees(run.poses.heading_rad)


def heading_error(run: tl.Run) -> Values:
    return np.degrees(find_bearing(run) - run.poses.heading_rad)


def to_goal(run: tl.Run) -> Values:
    return np.asarray(run.goal_xy_m) - run.poses.xy_m


def distance(run: tl.Run) -> Values:
    return np.hypot(*to_goal(run).T)


def along_track(run: tl.Run) -> Values:
    bearing_rad = find_bearing(run)
    way = np.array([np.cos(bearing_rad), np.sin(bearing_rad)])
    return np.asarray((run.poses.xy_m - run.poses.xy_m[0]) @ way)


def cross_track(run: tl.Run) -> Values:
    bearing_rad = find_bearing(run)
    left = np.array([-np.sin(bearing_rad), np.cos(bearing_rad)])
    return np.asarray((run.poses.xy_m - run.poses.xy_m[0]) @ left)


def read_world_velocity(run: tl.Run) -> Values:
    assert run.samples.world_velocity_m_s is not None
    return run.samples.world_velocity_m_s


OF_POSES: list[tuple[str, int, Read]] = [
    ("heading", 0, heading),
    ("position", 0, lambda run: run.poses.xy_m[:, 0]),
    ("position", 1, lambda run: run.poses.xy_m[:, 1]),
    ("heading-error", 0, heading_error),
    ("position-error", 0, lambda run: to_goal(run)[:, 0]),
    ("position-error", 1, lambda run: to_goal(run)[:, 1]),
    ("error-log", 0, lambda run: np.abs(heading_error(run))),
    ("error-log", 1, distance),
    ("panel", 1, heading),
    ("panel", 2, along_track),
    ("panel", 3, lambda run: np.abs(heading_error(run))),
    ("panel", 4, cross_track),
]
OF_SAMPLES: list[tuple[str, int, Read]] = [
    ("turn-rate", 0, lambda run: run.samples.turn_rate_rad_s),
    ("speed", 0, lambda run: run.samples.speed_m_s),
    ("wanted-speed", 0, lambda run: run.samples.wanted_speed_m_s),
    ("world-velocity", 0, lambda run: read_world_velocity(run)[:, 0]),
    ("world-velocity", 1, lambda run: read_world_velocity(run)[:, 1]),
    ("panel", 5, lambda run: run.samples.turn_rate_rad_s),
    ("panel", 6, lambda run: run.samples.speed_m_s),
]
IDEAL = [
    *(entry[:2] for entry in OF_POSES if entry[:2] != ("panel", 4)),
    *(("world-velocity", axis) for axis in (0, 1)),
]
TARGETS = {
    ("heading", 0): 128.502645,
    ("panel", 1): 128.502645,
    ("panel", 2): 5.693423,
    ("position", 0): 2.0,
    ("position", 1): 10.0,
}
TURNING = {("heading", 0), ("heading-error", 0), ("error-log", 0), ("panel", 1), ("panel", 3)}


@cache
def simulate(kp: int) -> tl.Run:
    return tl.simulate_run(get_preset(f"paper-kp{kp}"))


@cache
def draw(name: str) -> Figure:
    """Draw two runs that differ in every column; the tests only look."""
    return tl.draw.draw_figure(name, [simulate(10), simulate(2)])


@cache
def simulate_unequal() -> tl.Run:
    """Return a run that turns with a gain of 4 and drives with one of 10."""
    changes = {"law.kp_angular": 4.0, "name": "unequal"}
    return tl.simulate_run(override_scenario(get_preset("paper-kp10"), changes))


@cache
def draw_alone(name: str) -> Figure:
    return tl.draw.draw_figure(name, [simulate_unequal()])


def find_lines(axes: Axes, label: str) -> Iterator[tuple[Values, Values]]:
    for line in axes.get_lines():
        if line.get_label() == label:
            yield np.asarray(line.get_xdata()), np.asarray(line.get_ydata())


def find_levels(axes: Axes, label: str) -> list[float]:
    """Return the heights of the level lines that look as the one of this name."""
    levels = [line for line in axes.get_lines() if len(np.asarray(line.get_xdata())) == 2]
    (named,) = (line for line in levels if line.get_label() == label)
    alike = (line for line in levels if line.get_linestyle() == named.get_linestyle())
    same = (line for line in alike if line.get_color() == named.get_color())
    return sorted(float(np.asarray(line.get_ydata())[0]) for line in same)


@pytest.mark.parametrize("name", LABELS)
def test_every_axis_says_what_it_shows_and_in_which_unit(name: str) -> None:
    axes = draw(name).axes
    assert [panel.get_ylabel() for panel in axes] == LABELS[name]
    below, *_ = axes[-1].get_xlabel().split("\n")  # until when curves rest stands below
    across = {"plane": "x [m]", "root-locus": "real part of z"}
    ideal = name in {"plant", "step-responses"}
    expected = "time [s]" if ideal else "time from the first sample [s]"
    assert below == across.get(name, expected)


@pytest.mark.parametrize(("name", "panel", "read"), OF_POSES)
def test_what_poses_tell_is_drawn_over_their_time(name: str, panel: int, read: Read) -> None:
    for kp in (2, 10):
        run = simulate(kp)
        ((time_s, values),) = find_lines(draw(name).axes[panel], f"paper-kp{kp}")
        assert np.array_equal(time_s, (run.poses.time_ns - run.start_ns) / 1e9)
        assert values == pytest.approx(read(run), abs=1e-9)


@pytest.mark.parametrize(("name", "panel", "read"), OF_SAMPLES)
def test_what_samples_tell_is_drawn_over_their_time(name: str, panel: int, read: Read) -> None:
    for kp in (2, 10):
        run = simulate(kp)
        ((time_s, values),) = find_lines(draw(name).axes[panel], f"paper-kp{kp}")
        assert np.array_equal(time_s, (run.samples.time_ns - run.start_ns) / 1e9)
        assert np.array_equal(values, read(run))


@pytest.mark.parametrize(("name", "panel"), IDEAL)
def test_the_ideal_response_is_that_of_the_same_gain(name: str, panel: int) -> None:
    run = simulate_unequal()
    ((_, whole),) = find_lines(draw_alone(name).axes[panel], "unequal")
    ((time_s, ideal),) = find_lines(draw_alone(name).axes[panel], "ideal")
    rotate, _, translate = run.find_phase_spans()[:3]
    span, gain = (rotate, 4.0) if (name, panel) in TURNING else (translate, 10.0)
    assert time_s[0] == pytest.approx((span.start_ns - run.start_ns) / 1e9, abs=0.016)
    target = TARGETS.get((name, panel), 0.0)
    decay = (ideal[0] - target) * np.exp(-gain * (time_s - time_s[0]))
    assert ideal - target == pytest.approx(decay, abs=1e-4)
    assert ideal[0] == pytest.approx(whole[-len(ideal)])


def test_the_ideal_heading_turns_the_way_that_the_robot_turned() -> None:
    # From 170 deg to a goal at -170 deg: the heading counts on to 190 deg.
    changes = {"start.heading_rad": 2.96706, "start.x_m": 8.0, "start.y_m": 6.0}
    goal = {"law.wrap_error": True, "goal.x_m": 8.0 - 3.939231, "goal.y_m": 6.0 - 0.6945927}
    run = tl.simulate_run(override_scenario(get_preset("paper-kp4"), {**changes, **goal}))
    ((_, ideal),) = find_lines(tl.draw.draw_figure("heading", [run]).axes[0], "ideal")
    assert heading(run)[-1] == pytest.approx(-170.0, abs=0.2)
    assert (ideal[0], ideal[-1]) == pytest.approx((170.0, 190.0), abs=0.1)


@pytest.mark.parametrize(
    ("name", "panel", "label", "levels"),
    [
        ("heading", 0, "goal bearing", [128.5026]),
        ("position", 0, "goal", [2.0]),
        ("position", 1, "goal", [10.0]),
        ("panel", 2, "goal", [5.693423]),
        ("turn-rate", 0, "limit", [-1.0, 1.0]),
        ("speed", 0, "limit", [-1.0, 1.0]),
        ("wanted-speed", 0, "limit", [-1.0, 1.0]),
        ("error-log", 0, "tolerance", [0.0572958]),
        ("error-log", 1, "tolerance", [0.001]),
    ],
)
def test_goals_limits_and_tolerances_are_drawn_in(
    name: str, panel: int, label: str, levels: list[float]
) -> None:
    assert find_levels(draw_alone(name).axes[panel], label) == pytest.approx(levels, abs=1e-3)


def test_a_goal_at_zero_is_drawn_in_as_any_other() -> None:
    figure = tl.draw.draw_figure("position", [replace(simulate(2), goal_xy_m=(0.0, 0.0))])
    assert [find_levels(axes, "goal") for axes in figure.axes] == [[0.0], [0.0]]


@pytest.mark.parametrize("panel", [0, 1])
def test_the_plane_shows_where_each_run_drove_and_ended(panel: int) -> None:
    axes = draw("plane").axes[panel]
    for kp in (2, 10):
        ((x_m, y_m),) = find_lines(axes, f"paper-kp{kp}")
        assert np.array_equal(np.column_stack([x_m, y_m]), simulate(kp).poses.xy_m)
    ((x_m, y_m),) = find_lines(axes, "goal")
    assert (x_m.tolist(), y_m.tolist()) == ([2.0], [10.0])
    ((x_m, y_m),) = find_lines(axes, "start")
    assert (x_m[0], y_m[0]) == tuple(simulate(2).poses.xy_m[0])


def test_every_start_is_marked() -> None:
    elsewhere = override_scenario(get_preset("paper-kp2"), {"start.x_m": 7.0})
    figure = tl.draw.draw_figure("plane", [simulate(2), tl.simulate_run(elsewhere)])
    ((x_m, _),) = find_lines(figure.axes[0], "start")
    assert x_m == pytest.approx([5.5444446, 7.0])


@pytest.mark.parametrize(("tolerance_m", "label"), [(0.0059, ""), (0.0061, "tolerance")])
def test_the_tolerance_is_in_the_legend_where_it_is_larger_than_the_cross(
    tolerance_m: float, label: str
) -> None:
    run = simulate(10)
    parameters = {**run.parameters, "law.position_tolerance_m": tolerance_m}
    figure = tl.draw.draw_figure("plane", [replace(run, parameters=parameters)])
    assert figure.axes[1].patches[0].get_label() == label


def test_the_tolerance_stands_around_the_goal_close_up() -> None:
    box = draw("plane").axes[1].patches[0]
    corners = box.get_path().vertices @ np.diag([0.002, 0.002]) + [1.999, 9.999]
    assert box.get_patch_transform().transform(box.get_path().vertices) == pytest.approx(corners)


@pytest.mark.parametrize(
    ("name", "column"), [("turn-rate", "turn_rate_rad_s"), ("speed", "speed_m_s")]
)
def test_one_run_s_commands_are_commanded_applied_and_wanted(name: str, column: str) -> None:
    run, axes = simulate_unequal(), draw_alone(name).axes[0]
    for label, source in (("commanded", run.samples), ("applied", run.poses)):
        ((_, values),) = find_lines(axes, label)
        # turtlesim publishes no sign of the speed.
        sized = np.abs(values) if (label, name) == ("applied", "speed") else values
        assert np.array_equal(sized, getattr(source, column))
    low, high = axes.get_ylim()
    assert low < getattr(run.samples, column).min()
    assert 1.0 < high < 2.0
    ((_, values),) = find_lines(draw_alone(f"wanted-{name}").axes[0], "wanted")
    assert np.array_equal(values, getattr(run.samples, f"wanted_{column}"))


def test_a_logarithmic_axis_spans_what_was_measured() -> None:
    for panel, read in ((0, heading_error), (1, distance)):
        axes = draw_alone("error-log").axes[panel]
        sizes = np.abs(read(simulate_unequal()))
        assert axes.get_yscale() == "log"
        assert axes.get_ylim() == pytest.approx((0.6 * sizes.min(), 1.8 * sizes.max()))


def test_what_was_wanted_is_linear_to_the_limit_and_logarithmic_beyond() -> None:
    axis = draw("wanted-speed").axes[0].yaxis
    heights = axis.get_transform().transform([0.0, 0.5, 1.0, 10.0, 100.0])
    near, up_to_limit, first_decade, second_decade = np.diff(heights)
    assert near == pytest.approx(up_to_limit)
    assert first_decade == pytest.approx(second_decade)
    assert {-1.0, 0.0, 1.0, 10.0, 50.0} <= set(axis.get_majorticklocs())


def test_ideal_steps_enter_the_two_percent_band_before_four_tau() -> None:
    axes = draw("step-responses").axes[0]
    (band,) = axes.patches
    low = float(band.get_path().get_extents(band.get_patch_transform()).y0)
    assert low == pytest.approx(0.98)
    dots = [line.get_xydata() for line in axes.get_lines() if line.get_marker() == "o"]
    expected = [[4.0 / kp, 1.0 - np.exp(-4.0)] for kp in (2, 10)]
    assert np.concatenate(dots) == pytest.approx(np.array(expected))
    assert 1.0 - np.exp(-4.0) > low


def test_marks_of_a_curve_that_swings_stand_at_equal_times() -> None:
    time_s = np.linspace(0.0, 10.0, 1000)
    every = []
    for swings in (3.9, 4.1):
        axes = Figure().subplots()
        values = np.sin(2.0 * np.pi * swings * time_s / 10.0)
        draw_thinned(axes, time_s, values, values, marker="o", markevery=(0.1, 0.3))
        every.append(axes.get_lines()[0].get_markevery())
    # Each swing goes its height up and down: eight heights are four swings.
    assert every == [(0.1, 0.3), (100, 300)]


def test_runs_that_do_not_settle_are_named_once_and_their_commands_are_in_view() -> None:
    calm = tl.simulate_run(get_preset("paper-kp4"))
    gains = {"law.kp_angular": 25.0, "law.kp_linear": 25.0}
    swinging = tl.simulate_run(override_scenario(get_preset("paper-kp1"), gains, source="test"))
    long = replace(swinging, name="swinging law.kp_angular=25 law.kp_linear=25 run.long=name")
    figure = tl.draw.draw_figure("panel", [calm, replace(calm, name="again"), long])
    told = [axes.get_title("right") for axes in figure.axes if "settled" in axes.get_title("right")]
    assert told == ["pale: swinging l...n.long=name,\nnot settled"]
    figure.draw_without_rendering()
    (rate,) = [axes for axes in figure.axes if axes.get_ylabel().startswith("turn rate")]
    low, high = rate.get_ylim()
    turning = long.samples.turn_rate_rad_s
    assert low < turning.min() < turning.max() < high


def test_the_applied_speed_is_negative_where_the_turtle_moves_backward() -> None:
    run = tl.simulate_run(get_preset("posture"))
    axes = tl.draw.draw_figure("speed", [run]).axes[0]
    ((_, commanded),), ((_, applied),) = (
        find_lines(axes, label) for label in ("commanded", "applied")
    )
    assert (commanded.min(), applied.min()) == (-1.0, -1.0)
    assert run.poses.speed_m_s is not None
    assert np.array_equal(np.abs(applied), run.poses.speed_m_s)
    # At a wall, the turtle does not move, but the speed is applied.
    still = replace(run.poses, xy_m=0.0 * run.poses.xy_m + 5.0)
    axes = tl.draw.draw_figure("speed", [replace(run, poses=still)]).axes[0]
    ((_, applied),) = find_lines(axes, "applied")
    assert applied.max() == 1.0
