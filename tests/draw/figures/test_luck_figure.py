"""The figure of luck: its words are read, lie within the page, and none covers another."""

from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text

import turtlelog as tl
from tests.draw.rerun.rrds import make_foreign_run
from tests.lucky_runs import METRIC, NEAR_HALF_A_TURN, measure_lucky, simulate_lucky
from turtlelog.draw.figures.explanation_figures import draw_luck, measure_luck_for_figure
from turtlelog.draw.figures.figure_kinds import FIGURES
from turtlelog.draw.figures.page import Page
from turtlelog.errors import ShowError
from turtlelog.explain import Luck

PAGES = {
    "page": Page(),
    "narrow": Page(text_width_mm=120.0),
    "slide": Page(kind="slide"),
    "wide": Page(text_width_mm=400.0),
}


def draw(luck: Luck, page: Page) -> Figure:
    kind = replace(FIGURES["luck"], draw=partial(draw_luck, luck=luck))
    run = simulate_lucky("paper-kp10")
    figure = tl.draw.draw_figure("luck", [run], page=page, kinds={"luck": kind})
    figure.draw_without_rendering()
    return figure


def list_names(axes: Axes) -> list[Text]:
    """Return the names at the right ends of the curves."""
    return [text for text in axes.texts if text.get_text().startswith("with")]


@pytest.mark.everyday("four-curves-slide")
@pytest.mark.parametrize("page", PAGES.values(), ids=PAGES)
@pytest.mark.parametrize("start", [(), NEAR_HALF_A_TURN], ids=["four-curves", "five-curves"])
def test_words_lie_within_the_page_and_none_covers_another(
    start: tuple[tuple[str, float], ...], page: Page
) -> None:
    """Take two to three seconds: a run is explained, and 65 starts of it are simulated."""
    figure = draw(measure_lucky("paper-kp10", start), page)
    plane, curves = figure.axes
    assert len(list_names(curves)) == len(measure_lucky("paper-kp10", start).curves)
    for axes in (plane, curves):
        boxes = [text.get_window_extent() for text in axes.texts if text.get_text()]
        for one, other in combinations(boxes, 2):
            assert not one.overlaps(other)
    left, low, right, high = figure.get_tightbbox().extents
    width, height = figure.get_size_inches()
    assert min(left, low) > -0.01
    assert right < width + 0.01
    assert high < height + 0.01


def test_the_figure_shows_what_was_measured() -> None:
    """Take two to three seconds: a run is explained, and 65 starts of it are simulated."""
    luck = measure_lucky("paper-kp10")
    figure = draw(luck, Page())
    title = " ".join(figure.get_suptitle().split())
    assert title.startswith("final.position_error: 39 to 473 mm with all effects, at most 5.7 mm")
    _, curves = figure.axes
    assert "this run: 107 mm" in [text.get_text() for text in curves.texts]
    points = np.concatenate([np.asarray(line.get_xydata()) for line in curves.get_lines()])
    drawn = {(round(x, 9), round(y, 6)) for x, y in points.tolist()}
    for curve in luck.curves:
        for offset_deg, value in zip(np.degrees(luck.starts_rad), curve.values, strict=True):
            assert (round(float(offset_deg), 9), round(float(1e3 * value), 6)) in drawn


@pytest.mark.thorough
def test_a_narrow_page_has_the_panels_over_each_other() -> None:
    """Take two to three seconds: a run is explained, and 65 starts of it are simulated."""
    for width_mm, is_narrow in ((126.0, True), (128.0, False)):
        figure = draw(measure_lucky("paper-kp10"), Page(text_width_mm=width_mm))
        plane, curves = (axes.get_position() for axes in figure.axes)
        assert bool(curves.y1 < plane.y0) is is_narrow


def test_without_a_goal_the_curves_stand_alone() -> None:
    """Take two to three seconds: a run is explained, and 65 starts of it are simulated."""
    figure = draw(replace(measure_lucky("paper-kp10"), goal_xy_m=None), Page())
    assert len(figure.axes) == 1


def test_what_cannot_be_varied_is_one_line_with_the_reason() -> None:
    run = simulate_lucky("paper-kp10")
    with pytest.raises(ShowError, match="figure luck: expected one recording, found 2"):
        measure_luck_for_figure([run, run])
    with pytest.raises(ShowError, match="figure luck needs the controller's samples"):
        tl.draw.draw_figure("luck", [make_foreign_run(50)])
    with pytest.raises(ShowError, match=r"figure luck of .*: no scenario stands for it: "):
        measure_luck_for_figure([make_foreign_run(50)])
    with pytest.raises(tl.errors.ExplainError, match="no metric"):
        measure_luck_for_figure([run], metric=METRIC + "s")
