"""Figures of a run that starts at its goal, so that its errors are 0."""

from dataclasses import replace

import pytest

import turtlelog as tl
from tests.draw.figures.paper_runs import read
from turtlelog.errors import ShowError


@pytest.fixture(scope="module")
def still() -> tl.Run:
    """A run that starts at its goal."""
    textbook = tl.scenario.get_preset("textbook")
    start = textbook.start
    return tl.simulate_run(
        replace(textbook, goal=replace(textbook.goal, x_m=start.x_m, y_m=start.y_m))
    )


def test_a_logarithmic_panel_says_that_an_error_is_always_0(still: tl.Run) -> None:
    figure = tl.draw.draw_figure("error-log", [still])
    figure.draw_without_rendering()  # warnings are errors
    assert [text.get_text() for axes in figure.axes for text in axes.texts] == ["always 0"] * 2
    assert figure.axes[1].get_xlim()[1] == pytest.approx(still.duration_s, rel=0.1)


@pytest.mark.parametrize("name", ["speed", "panel"])
def test_a_legend_lists_only_what_its_panels_show(still: tl.Run, name: str) -> None:
    figure = tl.draw.draw_figure(name, [still])
    listed = {text.get_text() for one in figure.legends for text in one.get_texts()}
    assert not [label for label in listed if "applied" in label or "limit" in label]
    moving = tl.draw.draw_figure(name, [read(10)])
    labels = ", ".join(text.get_text() for text in moving.legends[0].get_texts())
    assert "applied" in labels
    assert "limit" in labels


def test_a_value_of_0_that_no_effect_changes_has_no_attribution(still: tl.Run) -> None:
    with pytest.raises(ShowError, match=r"final\.position_error is 0 m: no effect changes it"):
        tl.draw.draw_figure("attribution", [still])


def test_several_straight_runs_are_drawn_and_each_keeps_its_name(still: tl.Run) -> None:
    textbook = tl.scenario.get_preset("textbook")
    ahead = replace(textbook, goal=replace(textbook.goal, x_m=9.0, y_m=textbook.start.y_m))
    straight = [
        tl.simulate_run(tl.override_scenario(ahead, {"law.kp_linear": kp, "name": f"kp{kp:g}"}))
        for kp in (1.0, 4.0)
    ]
    for runs in (straight, [still, straight[0]]):
        for name in ("error-log", "panel"):
            tl.draw.draw_figure(name, runs).draw_without_rendering()  # warnings are errors
    figure = tl.draw.draw_figure("turn-rate", straight)
    listed = {text.get_text() for one in figure.legends for text in one.get_texts()}
    assert {"kp1", "kp4"} <= listed
