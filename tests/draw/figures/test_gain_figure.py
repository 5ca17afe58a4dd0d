"""Metrics against the gain, with theory's limits."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import turtlelog as tl
from tests.draw.figures.paper_runs import RUNS, list_points, list_texts, make_figure, read
from turtlelog.draw.figures.gain_figure import draw_gains, find_loop_gains
from turtlelog.draw.figures.strip_figure import (
    complete_name,
    measure_for_figure,
    set_ticks_at,
)
from turtlelog.errors import ShowError
from turtlelog.scenario import get_preset, override_scenario
from turtlelog.theory import compute_overshoot_gain, compute_stability_gain


def find_lines(axes: Axes, label: str) -> list[float]:
    found = [line for line in axes.get_lines() if line.get_label() == label]
    return [float(np.asarray(line.get_xdata())[0]) for line in found]


def test_points_stand_at_gain_and_metric() -> None:
    figure = tl.draw.draw_figure("gains", RUNS)
    assert len(figure.axes) == 6
    for axes, name in zip(figure.axes, ("rotate.overshoot", "translate.overshoot"), strict=False):
        values = [tl.measure_run(run, only=[name])[name].value for run in RUNS]
        assert list_points(axes)[:, 0].tolist() == [1.0, 2.0, 4.0, 10.0]
        assert list_points(axes)[:, 1] == pytest.approx(values)
    assert {"kp1", "kp2", "kp4", "kp10"} <= {*list_texts(figure.axes[0])}
    last = list_points(figure.axes[4])[:, 1]
    errors = [tl.measure_run(run)["final.position_error"].value for run in RUNS]
    assert last == pytest.approx([1e3 * (value or 0.0) for value in errors])


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_of_many_gains_only_those_are_named_whose_names_do_not_touch(scale: str) -> None:
    figure = Figure(figsize=(1.2, 1.2))
    axes = figure.subplots()
    axes.set_xscale(scale)
    gains = [round(float(gain), 3) for gain in np.geomspace(0.5, 40.0, 100)]
    axes.set_xlim(0.4, 50.0)
    set_ticks_at(axes, gains)
    figure.canvas.draw()
    names = [name for name in axes.get_xticklabels() if name.get_text()]
    extents = [name.get_window_extent() for name in names]
    assert (names[0].get_text(), names[-1].get_text()) == ("0.5", "40")
    assert all(one.x1 < other.x0 for one, other in pairwise(extents))
    set_ticks_at(axes, gains[::99])
    assert axes.get_xticks().tolist() == [0.5, 40.0]


def test_limits_are_theory_s_for_the_dead_times_that_the_runs_show() -> None:
    rotate, translate = tl.draw.draw_figure("gains", RUNS).axes[:2]
    begins, ends = "overshoot begins (theory)", "instability (theory)"
    assert find_lines(rotate, begins) == pytest.approx(
        [compute_overshoot_gain(0.016, ticks) for ticks in (5, 4)]
    )
    assert find_lines(translate, begins) == pytest.approx([compute_overshoot_gain(0.016, 6)])
    assert find_lines(translate, ends) == pytest.approx([compute_stability_gain(0.016, 6)])
    assert rotate.get_title() == "rotate\ndead time 64, 80 ms"
    assert {"3.54", "15.1"} <= {*list_texts(translate)}


def test_more_dead_times_than_lines_are_a_band(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("turtlelog.draw.figures.gain_figure._MOST_LINES", 1)
    rotate = tl.draw.draw_figure("gains", RUNS).axes[0]
    assert find_lines(rotate, "overshoot begins (theory)") == []
    labels = [patch.get_label() for patch in rotate.patches]
    assert labels.count("overshoot begins (theory)") == 1
    assert rotate.get_title() == "rotate\ndead time 64 to 80 ms"


def test_a_run_without_a_value_is_a_cross() -> None:
    wild = override_scenario(
        get_preset("paper"), {"law.kp_angular": 50.0, "law.kp_linear": 50.0, "max_duration_s": 8.0}
    )
    figure = make_figure()
    draw_gains(figure, [*RUNS, tl.simulate_run(wild)], metrics=["rotate.settling_time"])
    crosses = [line for line in figure.axes[0].get_lines() if line.get_label() == "no value"]
    assert [line.get_xdata()[0] for line in crosses] == [50.0]  # type: ignore[index]


def test_metrics_stand_over_the_gain_that_differs() -> None:
    def set_gains(rotate: float, translate: float) -> tl.Run:
        gains = {"law.kp_angular": rotate, "law.kp_linear": translate}
        return replace(read(4), parameters={**read(4).parameters, **gains})

    def list_titles(*runs: tl.Run, metrics: Sequence[str] | None = None) -> set[str]:
        figure = make_figure()
        draw_gains(figure, runs, metrics=metrics)
        return {axes.get_xlabel() for axes in figure.axes} - {""}

    one = set_gains(4.0, 1.0), set_gains(4.0, 2.0)
    assert list_titles(*one) == {"Kp of translate [1/s]"}
    figure = make_figure()
    draw_gains(figure, one)
    assert figure.get_supxlabel() == "Kp of rotate is always 4 1/s"
    assert any("final position error" in axes.get_ylabel() for axes in figure.axes)
    both = {"Kp of rotate [1/s]", "Kp of translate [1/s]"}
    assert list_titles(*one, metrics=["overshoot"]) == both
    assert list_titles(*one, set_gains(4.1, 2.0)) == both
    assert list_titles(one[0]) == both


def test_without_a_gain_there_is_nothing_to_draw_it_against() -> None:
    unknown = replace(read(4), parameters={})
    assert not find_loop_gains([unknown])
    with pytest.raises(ShowError, match="figure gains needs the law's gain"):
        tl.draw.draw_figure("gains", [unknown])
    left = tl.draw.list_left_out([read(2), unknown], ["gains"])
    assert left == ("left paper-kp4 out of gains: needs the law's gain",)


def test_names_of_metrics_stand_for_those_of_any_loop() -> None:
    assert complete_name("overshoot") == "*.overshoot"
    assert complete_name("final.position_error") == "final.position_error"
    assert [one.id for one in measure_for_figure("gains", RUNS, ["overshoot"])] == [
        "rotate.overshoot",
        "translate.overshoot",
    ]
    with pytest.raises(ShowError, match=r"gains needs a value of run\.time_to_goal"):
        measure_for_figure("gains", [replace(read(4), goal_xy_m=None)], ["run.time_to_goal"])


def test_gains_show_a_metric_of_the_whole_run_once() -> None:
    labels = [axes.get_ylabel() for axes in tl.draw.draw_figure("gains", RUNS).axes if axes.axison]
    assert labels.count("final position error [mm]") == 1
    assert labels.count("overshoot [%]") == 2
