from pathlib import Path
from typing import get_args

import turtlelog as tl
from turtlelog.draw.figures.page import PageKind
from turtlelog.scenario import get_preset

PAPER = Path(__file__).parents[3] / "recordings" / "paper"


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
