"""Metrics of many runs by gain, or by what else differs, and bars of one gain."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

import turtlelog as tl
from tests.draw.figures.paper_runs import PAPER, list_points, make_figure, read
from turtlelog.draw.figures.page import PageKind
from turtlelog.draw.figures.strip_figure import (
    MetricValues,
    draw_strips,
    group_runs,
    set_value_scale,
)
from turtlelog.errors import ShowError
from turtlelog.scenario import get_preset


def test_a_bar_of_one_gain_has_its_unit() -> None:
    runs = [change_gain("law.kp_angular", 1.0 + 0.5 * number) for number in range(8)]
    bar = tl.draw.draw_figure("heading", runs).axes[-1]
    assert bar.get_xlabel() == "kp_angular of 8 runs [1/s]"


def change_gain(key: str, value: float) -> tl.Run:
    scenario = get_preset("textbook")
    return tl.simulate_run(tl.override_scenario(scenario, {key: value}, source="test"))


def test_strips_of_single_runs_have_level_names_and_the_unit_of_the_gain() -> None:
    runs = [change_gain("law.kp_angular", 1.0 + 0.25 * number) for number in range(12)]
    for kind in get_args(PageKind):
        figure = tl.draw.draw_figure("strips", runs, page=tl.draw.Page(kind=kind))
        last = [axes for axes in figure.axes if axes.get_xlabel()]
        assert {axes.get_xlabel() for axes in last} == {"kp_angular [1/s]; one run each"}
        labels = last[0].get_xticklabels()
        assert [text.get_text() for text in labels][:3] == ["1", "1.25", "1.5"]
        assert {text.get_rotation() for text in labels} == {0.0}


def test_strips_tell_how_many_runs_all_groups_have_once() -> None:
    runs = [tl.read_run(PAPER / f"kp{kp}.mcap") for kp in (1, 1, 4, 4)]
    axes = tl.draw.draw_figure("strips", runs).axes[-1]
    assert axes.get_xlabel() == "Kp [1/s]; n = 2 each"
    axes = tl.draw.draw_figure("strips", runs[1:]).axes[-1]
    assert [text.get_text() for text in axes.get_xticklabels()] == ["1\nn = 1", "4\nn = 2"]


def repeat(count: int, *changes: tuple[str, float | str]) -> list[tl.Run]:
    """Return one run under several seeds."""
    parameters = {**read(4).parameters, **dict(changes)}
    found = [replace(read(4), parameters={**parameters, "seed": seed}) for seed in range(count)]
    return [replace(run, name=f"{run.name}-{seed}") for seed, run in enumerate(found)]


def test_runs_stand_together_by_gain_whatever_their_seed() -> None:
    gains = ("law.kp_angular", 9.0), ("law.kp_linear", 9.0)
    groups = group_runs([*repeat(3), *repeat(2, *gains)])
    assert (groups.label, groups.names) == ("Kp [1/s]", ("4", "9"))
    assert groups.rows == ((0, 1, 2), (3, 4))
    other = group_runs([*repeat(1), *repeat(2, ("loop.queue_policy", "newest"))])
    assert (other.label, other.names) == ("queue_policy", ("newest", "one-per-tick"))


@pytest.mark.parametrize(("count", "has_box"), [(9, False), (10, True)])
def test_of_many_runs_a_box_stands_beside_the_points(count: int, has_box: bool) -> None:  # noqa: FBT001
    figure = make_figure()
    draw_strips(figure, repeat(count), metrics=["final.position_error"])
    (axes,) = figure.axes
    assert len(list_points(axes)) == count
    assert bool(axes.patches) is has_box
    assert axes.get_xticklabels()[0].get_text() == f"n = {count}"


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_values_that_are_nearly_equal_stand_clear_of_the_edge(sign: float) -> None:
    axes = make_figure().subplots()
    values = sign * np.array([5.77, 5.7701, 5.7702])
    found = MetricValues(id="settling_time", label="settling time [s]", values=values)
    set_value_scale(axes, found)
    low, high = axes.get_ylim()
    assert min(high - values.max(), values.min() - low) > 0.1 * (high - low)


def test_too_many_groups_are_refused() -> None:
    runs = [run for kp in range(13) for run in repeat(1, ("law.kp_linear", float(kp)))]
    assert len(group_runs(runs[:12]).names) == 12
    with pytest.raises(
        ShowError, match="strips: expected at most 12 groups, found 13 by kp_linear"
    ):
        group_runs(runs)
