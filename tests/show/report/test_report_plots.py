"""What stands in the plots of a report, read from its models."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from turtlelog.check.violation import find_violated_signal
from turtlelog.cli.check import build_spec
from turtlelog.run import Run
from turtlelog.show.report.drawn import Drawn, Plots
from turtlelog.show.report.marked_plots import MOST_MARKED
from turtlelog.show.report.page_plots import Violation, draw_plots
from turtlelog.show.report.violation_plots import MOST_VIOLATIONS, RED

pytest.importorskip("bokeh")
RECORDINGS = Path(__file__).parents[3] / "recordings" / "paper"


def draw(*runs: Run, violations: tuple[Violation, ...] = ()) -> Plots:
    drawn = [
        Drawn(run=run, name=f"run {number}", color=(number, 0, 0))
        for number, run in enumerate(runs)
    ]
    return draw_plots(drawn, [tl.measure_run(run) for run in runs], violations)


def read(gain: int) -> Run:
    return tl.read_run(RECORDINGS / f"kp{gain}.mcap")


def violate(run: Run, formula: str) -> Violation:
    (result,) = tl.check_runs(build_spec([formula]), [("kp10.mcap", run)])
    signal = find_violated_signal(run, result).signal
    return Violation(names=result.names, first_s=result.first_violation_s, run=0, signal=signal)


def list_texts(figure: Any) -> list[str]:
    return [text for one in figure.renderers for text in one.data_source.data.get("text", [])]


def test_a_failed_check_is_drawn_with_its_limit_and_in_red_where_it_is_outside() -> None:
    run = read(10)
    figure = draw(run, violations=(violate(run, "always(abs(cross_track) <= 0.05)"),)).roots[
        "violation-0"
    ]
    (red,) = [one for one in figure.renderers if getattr(one.glyph, "line_color", "") == RED]
    values = red.data_source.data["y"]
    assert np.nanmax(values) < -0.05
    assert np.isfinite(values).sum() > 100
    assert list_texts(figure) == [
        "limit -0.05 m",
        "limit 0.05 m",
        "worst -0.10774 m at 8.784 s",
        "first -0.05008 m at 5.664 s",
    ]


def test_a_signal_that_goes_far_beyond_its_limit_is_shown_close_up() -> None:
    run = read(10)
    close = draw(run, violations=(violate(run, "final.position_error <= 0.05"),))
    figure = close.roots["violation-0"]
    assert figure.title.text == "distance [m], close up: its magnitude goes to 5.6934 m"
    assert figure.y_range.start < 0.05
    assert 0.1067 < figure.y_range.end < 0.2


def test_no_more_than_six_failed_checks_have_a_plot() -> None:
    run = read(10)
    one = violate(run, "always(abs(cross_track) <= 0.05)")
    places = draw(run, violations=(one,) * (MOST_VIOLATIONS + 1)).roots
    assert len([place for place in places if place.startswith("violation-")]) == 6


def test_the_marks_of_one_run_are_named_and_those_of_many_are_left_out() -> None:
    run = read(10)
    figure = draw(run).roots["plot-heading"]
    words = [text for text in list_texts(figure) if not text.startswith("run 0: ")]
    assert words == [
        "■ dead time 64 ms",
        "▲ rise 1.79 s",
        "● settled 2.21 s",
        "◆ peak 129.8 deg, overshoot 1 %",
    ]
    assert len(draw(*[run] * MOST_MARKED).config["marks"]) > 0
    assert draw(*[run] * (MOST_MARKED + 1)).config["marks"] == []
