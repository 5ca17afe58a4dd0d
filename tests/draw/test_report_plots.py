"""What stands in the plots of a report, read from its models."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from tests.draw.laws import simulate_pid, simulate_tracker
from tests.draw.rerun.rrds import make_foreign_run
from turtlelog.check.spec import build_spec
from turtlelog.check.violation import find_violated_signal
from turtlelog.draw.report_drawing import MOST_VIOLATIONS, RED, Drawn, Plots
from turtlelog.draw.report_plots import MOST_MARKED, draw_plots
from turtlelog.draw.report_sections import CheckLine, conclude_runs
from turtlelog.errors import ShowError
from turtlelog.run import Run

pytest.importorskip("bokeh")
RECORDINGS = Path(__file__).parents[2] / "recordings" / "paper"


def draw(*runs: Run, violations: tuple[CheckLine, ...] = ()) -> Plots:
    drawn = [
        Drawn(run=run, name=f"run {number}", color=(number, 0, 0))
        for number, run in enumerate(runs)
    ]
    return draw_plots(drawn, [tl.measure_run(run) for run in runs], violations)


def read(gain: int) -> Run:
    return tl.read_run(RECORDINGS / f"kp{gain}.mcap")


def violate(run: Run, formula: str) -> CheckLine:
    (result,) = tl.check_runs(build_spec([formula]), [("kp10.mcap", run)])
    signal = find_violated_signal(run, result).signal
    return CheckLine(
        run="run 0",
        check=result.check,
        verdict="FAIL",
        names=result.names,
        first_violation_s=result.first_violation_s,
        signal=signal,
    )


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
    assert figure.title.text == "distance [m], close up: the signal goes to 5.6934 m"
    assert figure.y_range.start < 0.05
    assert 0.1067 < figure.y_range.end < 0.2


@pytest.mark.thorough
def test_no_more_than_six_failed_checks_have_a_plot() -> None:
    run = read(10)
    one = violate(run, "always(abs(cross_track) <= 0.05)")
    places = draw(run, violations=(one,) * (MOST_VIOLATIONS + 1)).roots
    assert len([place for place in places if place.startswith("violation-")]) == 6


@pytest.mark.thorough
def test_many_runs_of_which_few_have_one_gain_end_in_dots_without_a_legend() -> None:
    some = [read(gain) for gain in (1, 2, 4, 10)]
    few, many = (draw(*some * count).roots["plane"] for count in (7, 12))
    assert len(few.legend) == 0
    assert len(many.legend) == 1


def test_the_marks_of_one_run_are_named_and_those_of_many_are_left_out() -> None:
    run = read(10)
    figure = draw(run).roots["plot-heading"]
    words = [text for text in list_texts(figure) if not text.startswith("run 0: ")]
    assert words == [
        "\N{MULTIPLICATION SIGN} dead time 64 ms",
        "\N{MULTIPLICATION SIGN} rise 1.79 s",
        "● settled 2.21 s",
        "■ peak 129.8 deg, overshoot 1 %",
    ]
    assert len(draw(*[run] * MOST_MARKED).config["marks"]) > 0
    assert draw(*[run] * (MOST_MARKED + 1)).config["marks"] == []


@pytest.mark.thorough
def test_every_plot_says_in_words_what_it_shows() -> None:
    run = read(10)
    plots = draw(run, violations=(violate(run, "always(abs(cross_track) <= 0.05)"),))
    assert plots.alternatives.keys() == plots.roots.keys()
    assert plots.alternatives["plot-heading"] == (
        "heading [deg] over time. run 0: from 0 to 127.4, between 0 and 129.8."
    )
    assert plots.alternatives["plane"].endswith("drives from (5.544, 5.544) to (2.084, 10.07) m.")


@pytest.mark.thorough
def test_a_hundred_runs_share_one_model_for_each_plot() -> None:
    """Plots of a hundred runs are made."""
    plots = draw(*[read(4)] * 100)
    figure = plots.roots["plot-speed"]
    (lines,) = figure.renderers
    assert len(lines.data_source.data["ys"]) == 100
    # Thinned, a command no longer holds until the next row.
    of_many, of_one = (found.config["plots"][-1]["curves"] for found in (plots, draw(read(4))))
    assert {curve["holds"] for curve in of_many} == {False}
    assert {curve["holds"] for curve in of_one} == {True}


@pytest.mark.thorough
def test_references_that_move_and_states_are_plotted_where_a_run_has_them() -> None:
    places = draw(simulate_tracker("kanayama")).roots
    assert {"plot-x", "plot-y", "plot-along_track", "plot-along_track_error"} < set(places)
    names = places["plot-heading"].renderers[0].data_source.data["name"]
    assert names == ["reference", "heading"]
    pid = draw(simulate_pid()).roots
    assert [place for place in pid if "integral" in place] == [
        "plot-integral_angular",
        "plot-integral_linear",
    ]
    assert "plot-x" not in pid


@pytest.mark.parametrize(
    ("spikes", "title"),
    [
        (1, "turn rate [rad/s], close up: single values go to 143"),
        (3, "turn rate [rad/s]"),
    ],
)
def test_single_faults_of_a_sensor_do_not_flatten_the_plot(spikes: int, title: str) -> None:
    bag = make_foreign_run(1200)
    rates = np.sin(np.arange(1200.0))
    rates[5 : 5 + spikes] = 143.0
    bag = replace(bag, commands=replace(bag.commands, turn_rate_rad_s=rates))
    assert draw(bag).roots["plot-turn_rate"].title.text == title


def test_the_state_of_one_law_is_plotted_of_its_runs_alone() -> None:
    plots = draw(read(4), tl.simulate_run(tl.load_scenario("posture")))
    figure = plots.roots["plot-lyapunov"]
    assert figure.renderers[0].data_source.data["name"] == ["run 1"]


def test_equal_runs_are_said_to_be_equal() -> None:
    runs, names = [read(4), read(10), read(4)], ["a", "b", "c"]
    metrics = [tl.measure_run(run) for run in runs]
    assert "a and c are equal in every row." in conclude_runs(runs, names, metrics)
    assert not any("equal" in text for text in conclude_runs(runs[:2], names[:2], metrics[:2]))


def test_a_pose_that_no_axis_reaches_is_an_error(tmp_path: Path) -> None:
    run = read(4)
    xy_m = run.poses.xy_m.copy()
    xy_m[7, 0] = 1.7e308
    far = replace(run, poses=replace(run.poses, xy_m=xy_m))
    with pytest.raises(ShowError, match=r"from the origin, and pictures show 1e\+150 m at most"):
        tl.draw.write_report([far], tmp_path / "far.html")
    assert [*tmp_path.iterdir()] == []
