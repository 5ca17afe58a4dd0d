"""Figures of runs of other laws: what they declare is drawn, and nothing else."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from numpy.typing import NDArray

import turtlelog as tl
from tests.draw.laws import (
    KINDS,
    TRACKERS,
    add_terms,
    forget_loops,
    simulate_law,
    simulate_pid,
    simulate_tracker,
)
from tests.measure.driven import make_driven_run
from turtlelog.charts.curves import compute_ideals, list_aims, list_levels, read_applied, read_curve
from turtlelog.draw import list_left_out
from turtlelog.draw.figures.figure_kinds import list_usual_figures
from turtlelog.draw.figures.theory_figures import find_gains
from turtlelog.scenario import get_preset

STRANGE, EXAMPLE, FOLLOWER = map(simulate_law, ("strange", "example", "Follower"))
KP4 = tl.simulate_run(get_preset("paper-kp4"))


def find_line(axes: Axes, label: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    (line,) = [line for line in axes.get_lines() if line.get_label() == label]
    return np.asarray(line.get_xdata()), np.asarray(line.get_ydata())


def list_labels(axes: Axes) -> set[str]:
    named = {str(line.get_label()) for line in axes.get_lines()}
    return {name for name in named if not name.startswith("_")}


def list_drawn(run: tl.Run) -> set[str]:
    return {
        name
        for name, kind in tl.draw.FIGURES.items()
        if not (kind.is_extra or kind.find_lack([run]))
    }


THEORY = {"plant", "step-responses", "root-locus"}
OF_ALL = {"position", "turn-rate", "speed", "wanted-speed", "plane", "panel"}
OF_HEADING = {"heading", "heading-error", "error-log"}


@pytest.mark.parametrize(
    ("kind", "drawn"),
    [
        ("strange", OF_ALL | THEORY | OF_HEADING | {"position-error", "states"}),
        ("example", OF_ALL | THEORY | OF_HEADING | {"position-error"}),
        ("Follower", OF_ALL | THEORY | OF_HEADING | {"position-error"}),
        ("EightPhases", OF_ALL | {"error-log", "position-error", "states"}),
        ("OpenLoop", OF_ALL | {"heading"}),
    ],
)
def test_of_a_law_that_is_drawn_which_its_loops_are_of(kind: str, drawn: set[str]) -> None:
    assert list_drawn(simulate_law(kind)) == drawn


@pytest.mark.thorough
@pytest.mark.parametrize("kind", KINDS)
def test_figures_and_tables_of_every_law_are_written(kind: str, tmp_path: Path) -> None:
    """All figures that a run allows are drawn."""
    run = simulate_law(kind)
    names = [path.stem for path in tl.write_figures([run], tmp_path, formats=["svg"])]
    assert set(names) == list_drawn(run)
    for path in tl.draw.write_tables([run], tmp_path):
        text = path.read_text("utf-8")
        assert "rotate." not in text
        assert "translate." not in text


@pytest.mark.thorough
def test_runs_of_laws_of_all_kinds_are_drawn_over_each_other() -> None:
    """All usual figures are drawn, of ten runs each."""
    runs = [KP4, *map(simulate_law, KINDS), *map(simulate_tracker, TRACKERS), simulate_pid()]
    for name in [*list_usual_figures(), "bode", "nyquist", "step", "gains", "strips"]:
        tl.draw.draw_figure(name, runs).draw_without_rendering()


def test_a_moving_reference_is_drawn_beside_the_heading() -> None:
    axes = tl.draw.draw_figure("heading", [STRANGE]).axes[0]
    assert list_labels(axes) == {"strange", "reference"}
    _, values = find_line(axes, "reference")
    expected = np.degrees(STRANGE.samples.reference_heading_rad)  # type: ignore[arg-type]
    np.testing.assert_allclose(values, expected, atol=1e-9)


def test_a_reference_pose_is_drawn_beside_the_position_and_in_the_plane() -> None:
    xy_m = FOLLOWER.samples.reference_xy_m
    assert xy_m is not None
    figure = tl.draw.draw_figure("position", [FOLLOWER])
    for axes, column in zip(figure.axes, xy_m.T, strict=True):
        np.testing.assert_array_equal(find_line(axes, "reference")[1], column)
    x_m, y_m = find_line(tl.draw.draw_figure("plane", [FOLLOWER]).axes[0], "reference")
    known = np.isfinite(xy_m[:, 0])
    np.testing.assert_array_equal(np.column_stack([x_m, y_m]), xy_m[known])


def test_the_bearing_of_the_goal_is_drawn_where_it_is_asked_for() -> None:
    axes = tl.draw.draw_figure("heading", [EXAMPLE]).axes[0]
    assert list_labels(axes) == {"example", "bearing of the goal"}


def test_the_panel_of_a_distance_loop_has_the_distance_with_its_ideal_decay() -> None:
    figure = tl.draw.draw_figure("panel", [STRANGE])
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels[:3] == ["y [m]", "heading [deg]", "distance [m]"]
    assert "along-track [m]" not in labels
    time_s, ideal = find_line(figure.axes[2], "ideal")
    two = next(span for span in STRANGE.find_phase_spans() if span.phase == "two")
    assert time_s[0] == (two.start_ns - STRANGE.start_ns) / 1e9
    np.testing.assert_allclose(ideal, ideal[0] * np.exp(-(time_s - time_s[0])))


def test_the_panel_of_several_laws_has_a_view_for_the_loops_of_each() -> None:
    labels = [axes.get_ylabel() for axes in tl.draw.draw_figure("panel", [KP4, STRANGE]).axes]
    assert labels[1:4] == ["heading [deg]", "along-track [m]", "distance [m]"]


def test_a_panel_is_no_higher_for_what_only_other_laws_have() -> None:
    kind = tl.draw.FIGURES["panel"]
    assert kind.find_height([KP4]) == kind.find_height([STRANGE]) == 1.0


@pytest.mark.parametrize(
    ("signal", "run", "count"),
    [
        ("distance", STRANGE, 1),
        ("heading", STRANGE, 0),
        ("x", STRANGE, 0),
        ("heading", EXAMPLE, 0),
        ("heading", FOLLOWER, 1),
        ("along_track", FOLLOWER, 0),
        ("distance", FOLLOWER, 0),
        ("x", KP4, 1),
        ("distance", KP4, 1),
        ("cross_track", KP4, 0),
    ],
)
def test_theory_is_drawn_where_it_holds(signal: str, run: tl.Run, count: int) -> None:
    assert len(compute_ideals(run, signal)) == count


@pytest.mark.parametrize("signal", ["heading", "heading_error", "x", "error_y", "distance"])
def test_no_ideal_response_is_drawn_of_a_loop_with_an_integral(signal: str) -> None:
    assert len(compute_ideals(KP4, signal)) == 1
    assert compute_ideals(add_terms(KP4), signal) == []
    assert [level.label for level in list_levels(add_terms(KP4), "heading")] == ["goal bearing"]


def test_theorys_figures_are_of_proportional_loops_alone() -> None:
    assert find_gains([add_terms(KP4)]) == ()
    assert find_gains([add_terms(KP4), STRANGE]) == find_gains([STRANGE])
    reason = "the law declares that its command is more than gain times error, but not its terms"
    assert list_left_out([add_terms(KP4)], ["plant", "root-locus", "bode"]) == (
        "left out plant: needs a proportional loop",
        f"left out root-locus, bode: needs a loop that theory knows ({reason})",
    )
    assert list_left_out([forget_loops(KP4)], ["plant"]) == (
        "left out plant: needs the law's gain",
    )
    robot = replace(KP4, parameters={**KP4.parameters, "plant.kind": "lagged", "plant.period_s": 1})
    assert list_left_out([robot], ["plant", "root-locus"]) == (
        "left out plant: needs a plant that is 1/s",
    )


def test_rates_of_a_robot_are_those_of_an_instant() -> None:
    robot = {**KP4.parameters, "plant.kind": "lagged", "plant.period_s": 0.016}
    runs = (KP4, replace(KP4, parameters=robot))
    curves = [read_applied(run, "speed") for run in runs]
    assert [curve is not None and curve.holds for curve in curves] == [True, False]


def test_levels_are_of_the_declared_references() -> None:
    assert [level.label for level in list_levels(KP4, "heading")] == ["goal bearing"]
    assert [level.label for level in list_levels(FOLLOWER, "heading")] == ["zero"]
    assert list_levels(STRANGE, "heading") == []
    assert [level.label for level in list_levels(forget_loops(STRANGE), "heading")] == [
        "goal bearing"
    ]


@pytest.mark.parametrize("row", [0, 300])
@pytest.mark.parametrize("turns_rad", [0.0, np.pi])
def test_the_goal_bearing_is_drawn_beside_the_heading_from_when_it_was_given(
    row: int, turns_rad: float
) -> None:
    time_s = np.arange(0.0, 60.0, 0.1)
    heading_rad = 0.1 + np.minimum(time_s / 5.0, 1.0) * 2.0 * turns_rad
    way = np.cumsum(np.where(time_s > 30.0, 0.1, 0.0))
    driven = make_driven_run(
        time_s,
        speed=(way, way),
        turn=(way, heading_rad),
        goal_xy_m=(20.0, 0.0),
        origin=tl.run.Origin(goal_given_ns=row * 100_000_000 if row else None),
    )
    levels, aims = list_levels(driven, "heading"), list_aims(driven, "heading")
    bearing_deg = 2.0 * np.degrees(turns_rad)
    assert [level.value for level in levels] == ([] if row else [pytest.approx(bearing_deg)])
    assert [aim.label for aim in aims] == (["goal bearing"] if row else [])
    for aim in aims:
        assert aim.values == pytest.approx(np.full(600 - row, bearing_deg))
        assert aim.time_s[0] == pytest.approx(row / 10.0)


def test_gains_of_theory_are_those_that_loops_declare() -> None:
    assert find_gains([STRANGE]) == (1.0, 4.0)
    undeclared = replace(EXAMPLE, parameters={**EXAMPLE.parameters, "law.kp_else": 7.0})
    assert find_gains([undeclared]) == (1.0, 4.0)
    assert find_gains([forget_loops(EXAMPLE)]) == ()


def test_world_velocity_is_drawn_of_the_samples_that_hold_it() -> None:
    velocity = np.array(KP4.samples.world_velocity_m_s)
    velocity[:100] = np.nan
    run = replace(KP4, samples=replace(KP4.samples, world_velocity_m_s=velocity))
    curve = read_curve(run, "world_velocity_x")
    assert curve is not None
    np.testing.assert_array_equal(curve.values, velocity[100:, 0])
    velocity = np.full_like(velocity, np.nan)
    run = replace(KP4, samples=replace(KP4.samples, world_velocity_m_s=velocity))
    assert read_curve(run, "world_velocity_x") is None


def test_what_is_left_out_of_other_laws_is_told_with_the_reason() -> None:
    assert list_left_out([STRANGE]) == (
        "left out world-velocity: needs gain times error",
        "left out panel (along-track): needs a loop along the track",
    )
    assert list_left_out([simulate_law("EightPhases")], ["heading", "heading-error"]) == (
        "left out heading, heading-error: needs a loop of the heading",
    )
    assert list_left_out([simulate_law("OpenLoop")], ["heading-error", "position-error"]) == (
        "left out heading-error: needs a heading to aim at",
        "left out position-error: needs a goal",
    )
    lines = list_left_out([simulate_law("OpenLoop")])
    assert "left out table1.tex: needs a gain or a goal" in lines
    assert list_left_out([KP4, STRANGE], ["panel", "world-velocity"]) == (
        "left strange out of world-velocity: needs gain times error",
    )


def test_limits_are_those_that_loops_declare() -> None:
    loop = replace(EXAMPLE.declaration.loops[1], limit="law.fastest")
    declaration = replace(EXAMPLE.declaration, loops=(EXAMPLE.declaration.loops[0], loop))
    parameters = {**EXAMPLE.parameters, "law.fastest": 0.7}
    run = replace(EXAMPLE, declaration=declaration, parameters=parameters)
    axes = tl.draw.draw_figure("speed", [run]).axes[0]
    levels = {float(np.asarray(line.get_ydata())[0]) for line in axes.get_lines()[1:3]}
    assert levels == {0.7, -0.7}


def test_a_recorded_reference_and_the_bearing_of_the_goal_have_different_dashes() -> None:
    runs = [tl.simulate_run(get_preset(name)) for name in ("track-square", "posture")]
    axes = tl.draw.draw_figure("heading", runs).axes[0]
    lines: list[Any] = [*axes.get_lines()]
    found = {
        label: {str(line._dash_pattern) for line in lines if line.get_label() == label}
        for label in ("reference", "bearing of the goal")
    }
    assert [len(dashes) for dashes in found.values()] == [1, 1]
    assert found["reference"] != found["bearing of the goal"]
