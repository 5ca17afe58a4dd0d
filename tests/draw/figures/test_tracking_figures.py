"""Figures of runs that track a path, and of laws with states."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from numpy.typing import NDArray

import turtlelog as tl
from tests.draw.laws import SQUARE, simulate_law, simulate_pid, simulate_tracker, simulate_untimed
from turtlelog.charts.close_up import find_worst_place
from turtlelog.charts.curves import read_along_error
from turtlelog.draw import list_left_out
from turtlelog.measure import read_signal
from turtlelog.run.loops import Declaration

KANAYAMA, PURSUIT = simulate_tracker("kanayama"), simulate_tracker("pure-pursuit")
UNTIMED, PID, EXAMPLE = simulate_untimed(), simulate_pid(), simulate_law("example")
TRACKERS = [KANAYAMA, PURSUIT]


def find_lines(axes: Axes, label: str) -> list[NDArray[np.float64]]:
    found = [line for line in axes.get_lines() if line.get_label() == label]
    return [np.asarray(line.get_xydata()) for line in found]


def list_labels(run: tl.Run, name: str) -> list[str]:
    return [axes.get_ylabel() for axes in tl.draw.draw_figure(name, [run]).axes]


@pytest.mark.parametrize("runs", [[KANAYAMA], TRACKERS])
def test_the_path_is_drawn_once_and_is_that_of_the_scenario(runs: list[tl.Run]) -> None:
    for axes in tl.draw.draw_figure("plane", runs).axes:
        (drawn,) = find_lines(axes, "path")
        assert drawn.tolist() == [list(point) for point in (*SQUARE, SQUARE[0])]
        assert not find_lines(axes, "reference")


def test_no_path_is_drawn_of_a_law_that_tracks_none() -> None:
    ignoring = tl.simulate_run(
        tl.override_scenario(
            tl.load_scenario("textbook"),
            {"path.kind": "line", "path.points": [[1.0, 1.0], [2.0, 2.0]]},
        )
    )
    figure = tl.draw.draw_figure("plane", [ignoring])
    assert not any(find_lines(axes, "path") for axes in figure.axes)
    assert tl.draw.FIGURES["path-error"].find_lack([ignoring]) == "a path that its law tracks"


def test_ways_to_the_reference_end_where_it_was_recorded() -> None:
    axes = tl.draw.draw_figure("plane", [KANAYAMA]).axes[0]
    (ways,) = find_lines(axes, "to the reference, every 0.5 s")
    starts, ends = ways[::3], ways[1::3]
    assert len(starts) == 49
    rows = np.arange(49) * 0.5 / 0.016
    samples = KANAYAMA.samples
    assert samples.reference_xy_m is not None
    first = int(samples.pose_sequence[0])
    nearest = np.ceil(rows - 1e-9).astype(int) + first
    np.testing.assert_array_equal(starts, KANAYAMA.poses.xy_m[nearest])
    np.testing.assert_allclose(ends, samples.reference_xy_m[nearest - first], atol=1e-12)
    assert not find_lines(
        tl.draw.draw_figure("plane", TRACKERS).axes[0], "to the reference, every 0.5 s"
    )


def test_beside_the_plane_is_where_runs_are_furthest_off() -> None:
    worst = find_worst_place(TRACKERS)
    close_up = tl.draw.draw_figure("plane", TRACKERS).axes[1]
    assert worst is not None
    assert close_up.get_title() == "furthest off the path"
    assert [text.get_text() for text in close_up.texts] == [f"{worst.offset_m * 1e3:.3g} mm"]
    lines = [np.asarray(line.get_xydata()).tolist() for line in close_up.get_lines()]
    assert [list(worst.path_xy_m), list(worst.xy_m)] in lines


def test_errors_from_the_path_are_those_along_and_across() -> None:
    figure = tl.draw.draw_figure("path-error", TRACKERS)
    along, across = figure.axes
    assert [along.get_ylabel(), across.get_ylabel()] == ["along-track error [m]", "cross-track [m]"]
    for run in TRACKERS:
        curve, offsets = read_along_error(run), read_signal(run, "cross_track")
        assert curve is not None
        assert offsets is not None
        assert find_lines(along, run.name)[0][:, 1].tolist() == curve.values.tolist()
        assert find_lines(across, run.name)[0][:, 1].tolist() == offsets.values.tolist()


def test_of_a_path_without_a_speed_there_is_no_error_along_it() -> None:
    assert list_labels(UNTIMED, "path-error") == ["cross-track [m]"]
    assert list_labels(UNTIMED, "panel")[2] == "along-track [m]"
    left_out = list_left_out([KANAYAMA, UNTIMED], ["path-error"])
    assert left_out == (
        "left untimed out of path-error (along-track error): needs a path with a speed",
    )


def test_the_panel_of_a_tracker_has_heading_errors_and_commands() -> None:
    assert list_labels(KANAYAMA, "panel") == [
        *("y [m]", "heading [deg]", "along-track error [m]", "|heading error| [deg]"),
        *("cross-track [m]", "turn rate [rad/s]", "speed [m/s]"),
    ]


def test_one_reference_of_several_runs_is_drawn_once() -> None:
    alone = tl.draw.draw_figure("heading", [KANAYAMA]).axes[0]
    both = tl.draw.draw_figure("heading", TRACKERS).axes[0]
    (of_one,), (of_both,) = find_lines(alone, "reference"), find_lines(both, "reference")
    assert of_one.tolist() == of_both.tolist()
    timed_and_not = tl.draw.draw_figure("heading", [KANAYAMA, UNTIMED]).axes[0]
    assert len(find_lines(timed_and_not, "reference")) == 2


def test_of_a_run_on_its_path_the_reason_for_no_close_up_is_given() -> None:
    circle = {"path.kind": "circle", "path.center_x_m": 5.0, "path.center_y_m": 5.0}
    start = {"start.x_m": 7.0, "start.y_m": 5.0, "start.heading_rad": 1.5707963}
    scenario = tl.override_scenario(
        tl.load_scenario("textbook"),
        {"law.kind": "kanayama", "path.speed_m_s": 0.5, "path.size_m": 2.0, **circle, **start},
    )
    line = (
        "left out plane (furthest off the path):"
        " needs one path, and a run that is more than 1 mm off it"
    )
    assert list_left_out([tl.simulate_run(scenario)], ["plane"]) == (line,)
    assert list_left_out([KANAYAMA], ["plane"]) == ()


def test_states_stand_beside_the_command_that_they_belong_to() -> None:
    figure = tl.draw.draw_figure("panel", [PID])
    turning, driving = figure.axes[7:]
    assert turning.get_ylabel() == "states of the turn rate [rad/s]"
    assert driving.get_ylabel() == "states of the speed [m/s]"
    assert PID.samples.states is not None
    for axes, names in (
        (turning, PID.declaration.states[:2]),
        (driving, PID.declaration.states[2:]),
    ):
        for name in names:
            column = PID.declaration.states.index(name)
            (drawn,) = find_lines(axes, name)
            assert drawn[:, 1].tolist() == PID.samples.states[:, column].tolist()


def test_of_several_runs_each_state_has_a_panel() -> None:
    figure = tl.draw.draw_figure("states", [PID, EXAMPLE, simulate_law("strange")])
    expected = [f"{name} [{unit}]" for name, unit in PID.declaration.state_units.items()]
    assert [axes.get_ylabel() for axes in figure.axes] == [*expected, "memory"]
    assert find_lines(figure.axes[4], "strange")
    assert not find_lines(figure.axes[4], "pid")


def replace_states(run: tl.Run, factors: list[float]) -> tl.Run:
    assert run.samples.states is not None
    states = run.samples.states * factors
    return replace(run, samples=replace(run.samples, states=states))


def test_states_of_other_scales_have_a_panel_each() -> None:
    run = replace_states(PID, [1.0, 1e-3, 1.0, 1.0])
    expected = ["integral_angular [rad/s]", "derivative_angular [rad/s]"]
    expected.append("states of the speed [m/s]")
    assert list_labels(run, "states") == expected


def test_states_that_are_always_0_have_no_panel() -> None:
    turning = replace_states(PID, [1.0, 1.0, 0.0, 0.0])
    assert list_labels(turning, "states") == ["states of the turn rate [rad/s]"]
    idle = replace_states(PID, [0.0] * 4)
    expected = "states of its law that are not always 0"
    assert tl.draw.FIGURES["states"].find_lack([idle]) == expected
    assert len(list_labels(idle, "panel")) == 7


@pytest.mark.parametrize(("count", "left"), [(12, 0), (13, 1)])
def test_of_very_many_states_some_are_left_out_and_named(count: int, left: int) -> None:
    names = tuple(f"s{number}" for number in range(count))
    states = np.ones((len(EXAMPLE.samples), count))
    loops, phases = EXAMPLE.declaration.loops, EXAMPLE.declaration.phases
    run = replace(
        EXAMPLE,
        declaration=Declaration(loops=loops, phases=phases, states=names),
        samples=replace(EXAMPLE.samples, states=states),
    )
    assert len(tl.draw.draw_figure("states", [run]).axes) == 12
    line = "left out states (from s12 on): expected at most 12 panels, found 13"
    assert list_left_out([run], ["states"]) == (line,) * left
