"""The figure of an attribution: its waterfall, the run and its ghost."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

import turtlelog as tl
from tests.draw.figures.paper_runs import RUNS, list_points, list_texts, make_figure, read
from tests.draw.rerun.rrds import make_foreign_run
from turtlelog.draw.figures.explanation_figures import (
    Explained,
    draw_attribution,
    explain_for_figure,
)
from turtlelog.errors import ShowError


def list_bars(axes: Axes) -> list[Rectangle]:
    return [patch for patch in axes.patches if isinstance(patch, Rectangle)]


@pytest.fixture(scope="module")
def explained() -> Explained:
    return explain_for_figure([read(10)])


@pytest.fixture(scope="module")
def attribution(explained: Explained) -> Figure:
    figure = make_figure()
    draw_attribution(figure, [read(10)], explained=explained)
    return figure


def test_the_waterfall_has_the_values_of_the_attribution(
    attribution: Figure, explained: Explained
) -> None:
    found = explained.found
    shares = {
        share.cause: share.contribution for share in found.contributions if share.contribution
    }
    _, bars = attribution.axes
    sizes = [bar.get_width() for bar in list_bars(bars)]
    assert found.as_logged is not None
    assert found.without_all is not None
    expected = [found.as_logged, -shares["queue"], -shares["pause"], found.without_all]
    assert sizes == pytest.approx([1e3 * value for value in expected])
    names = [text.get_text() for text in bars.get_yticklabels()]
    assert names == ["as recorded", "queue", "pause", "left"]
    texts = [text.strip() for text in list_texts(bars)]
    assert texts[0] == "106.7 mm"
    assert texts[1:3] == ["+51.1 mm (48 %)", "+50.6 mm (47 %)"]
    assert texts[3] == "5.1 mm (5 %), no more than the tolerances leave"
    averages = "bars: averages over the orders of removal;\nno run ends between them"
    assert bars.get_xlabel() == f"final position error [mm]\n{averages}"


def test_each_bar_begins_where_the_one_above_ends(attribution: Figure) -> None:
    *above, left = list_bars(attribution.axes[1])
    ends = [bar.get_x() + bar.get_width() for bar in above]
    assert [bar.get_x() for bar in above[1:]] == pytest.approx(ends[:-1])
    assert left.get_width() == pytest.approx(ends[-1])


def test_run_and_ghost_end_where_they_are_said_to(attribution: Figure) -> None:
    texts = list_texts(attribution.axes[0])
    assert texts == [
        "recorded\n106.7 mm off",
        "ghost: without\nqueue and pause\n5.1 mm off",
        "50 mm",
        "100 mm",
    ]
    recorded, ghost = list_points(attribution.axes[0])
    misses = [float(np.hypot(*(end - (2.0, 10.0)))) for end in (recorded, ghost)]
    assert misses == pytest.approx([0.10673, 0.0051], abs=5e-5)


def test_of_a_loop_s_metric_the_signal_is_seen_where_it_arrives(explained: Explained) -> None:
    figure = make_figure()
    found = replace(explained.found, metric="rotate.overshoot")
    draw_attribution(figure, [read(10)], explained=replace(explained, found=found))
    seen, _ = figure.axes
    assert [line.get_label() for line in seen.get_lines()][1:] == [
        "recorded",
        "ghost: without queue and pause",
    ]
    low, high = seen.get_ylim()
    assert 110.0 < low < 128.5 < high < 135.0


def test_in_a_narrow_column_the_panels_stand_over_each_other(explained: Explained) -> None:
    for width, is_narrow in ((4.9, True), (5.0, False)):
        figure = make_figure(width)
        draw_attribution(figure, [read(10)], explained=explained)
        figure.draw_without_rendering()
        seen, bars = (axes.get_position() for axes in figure.axes)
        assert bool(bars.y1 < seen.y0) is is_narrow


def test_what_cannot_be_explained_is_refused_with_the_reason(
    explained: Explained, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(ShowError, match="attribution: expected one recording, found 2"):
        tl.draw.draw_figure("attribution", RUNS[:2])
    with pytest.raises(ShowError, match="attribution needs the controller's samples"):
        tl.draw.draw_figure("attribution", [make_foreign_run(50)])
    withheld = replace(explained.found, withheld="nothing reproduces it")
    monkeypatch.setattr("turtlelog.explain.attribute_run", lambda *_, **__: withheld)
    match = r"needs contributions to final\.position_error: nothing reproduces it"
    with pytest.raises(ShowError, match=match):
        explain_for_figure([read(4)])
