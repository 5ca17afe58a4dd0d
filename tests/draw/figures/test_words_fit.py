"""Every word of every figure lies within its page, and no two of one axes over each other."""

import dataclasses
from collections.abc import Sequence

import pytest

import turtlelog as tl
from tests.draw.words import list_clipped, list_overlapping
from turtlelog.draw.figures.page import Page, use_looks

PAGES = {
    "column": Page(),
    "page": Page(kind="page"),
    "narrow": Page(text_width_mm=120.0),
    "slide": Page(kind="slide"),
}
SCENARIO = tl.load_scenario("paper-kp4")
GAINS = (4, 1, 2, 10, *(number / 2 for number in range(5, 21) if number != 8), 11)
RUNS = [
    dataclasses.replace(
        tl.simulate_run(
            tl.override_scenario(
                SCENARIO, {"law.kp_linear": float(kp), "law.kp_angular": float(kp)}
            )
        ),
        name=f"paper-kp{kp:g}",
    )
    for kp in GAINS
]


def list_misplaced(name: str, runs: Sequence[tl.Run], page: Page) -> list[object]:
    """Return the words of a figure that lie off its page or over each other."""
    with use_looks():
        figure = tl.draw.draw_figure(name, runs, page=page)
        figure.draw_without_rendering()
        return [*list_clipped(figure), *list_overlapping(figure)]


NAMES = sorted({*tl.draw.FIGURES} - {"attribution", "luck", "rates", "violation"})
"""Those of one run alone are looked at below."""


@pytest.mark.thorough
@pytest.mark.parametrize("page", PAGES)
@pytest.mark.parametrize("count", [1, 4, 20])
@pytest.mark.parametrize("name", NAMES)
def test_words_of_figures_fit(name: str, count: int, page: str) -> None:
    runs = RUNS[:count]
    is_refused = name == "strips" and count > 12  # of so many groups `gains` is the figure
    if not is_refused and tl.draw.FIGURES[name].find_lack(runs) is None:
        assert list_misplaced(name, runs, PAGES[page]) == []


@pytest.mark.thorough
@pytest.mark.parametrize("page", PAGES)
@pytest.mark.parametrize("name", ["attribution", "luck", "rates"])
def test_words_of_figures_of_one_run_fit(name: str, page: str) -> None:
    assert list_misplaced(name, RUNS[3:4], PAGES[page]) == []
