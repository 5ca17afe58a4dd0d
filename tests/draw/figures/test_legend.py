from typing import Any

import pytest

import turtlelog as tl
from turtlelog import Run
from turtlelog.scenario import PAPER_RUNS, get_preset, override_scenario

RUNS = [tl.simulate_run(get_preset(name)) for name in PAPER_RUNS]


def vary(count: int) -> list[Run]:
    return [
        tl.simulate_run(
            override_scenario(
                get_preset("textbook"), {"law.kp_angular": kp, "law.kp_linear": kp}, source="test"
            )
        )
        for kp in (1.0 + 0.25 * number for number in range(count))
    ]


def list_legend(figure: Any) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_what_looks_alike_in_several_panels_shares_an_entry() -> None:
    names = list_legend(tl.draw.draw_figure("panel", RUNS[-1:]))
    assert names == [
        *("paper-kp10, commanded", "start", "goal", "goal bearing, goal", "ideal"),
        *("tolerance, limit", "applied"),
    ]


def test_a_cross_at_the_goal_shares_no_entry_with_a_line() -> None:
    assert "goal" in list_legend(tl.draw.draw_figure("plane", RUNS))


@pytest.mark.parametrize(("count", "named"), [(6, 12), (7, 7)])
def test_of_many_loops_a_legend_names_some_and_says_so(count: int, named: int) -> None:
    names = list_legend(tl.draw.draw_figure("step", vary(count)))
    assert len([name for name in names if "settles" in name]) == named
    assert ("7 of 14 are named" in names) == (named == 7)


@pytest.mark.parametrize(("count", "drawn"), [(7, 7), (8, 2)])
def test_of_many_runs_the_ideal_responses_of_the_first_and_the_last_are_drawn(
    count: int, drawn: int
) -> None:
    lines = tl.draw.draw_figure("heading", vary(count)).axes[0].get_lines()
    assert len([line for line in lines if str(line.get_label()).startswith("ideal")]) == drawn
