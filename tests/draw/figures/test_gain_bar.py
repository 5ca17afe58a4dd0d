"""The bar that names many runs by their gains."""

from dataclasses import replace

from matplotlib.figure import Figure

import turtlelog as tl
from turtlelog.draw import draw_figure
from turtlelog.scenario import get_preset

RUN = tl.simulate_run(get_preset("paper-kp4"))


def vary(count: int) -> list[tl.Run]:
    gains = [1.0 + 0.5 * number for number in range(count)]
    keys = ("law.kp_linear", "law.kp_angular")
    return [
        replace(
            RUN, name=f"run {gain:g}", parameters={**RUN.parameters, **dict.fromkeys(keys, gain)}
        )
        for gain in gains
    ]


def list_legend(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_up_to_seven_runs_are_named_by_the_legend() -> None:
    figure = draw_figure("heading", vary(7))
    assert len(figure.axes) == 1
    assert {run.name for run in vary(7)} <= {*list_legend(figure)}


def test_more_runs_are_named_by_a_bar_of_their_gains() -> None:
    figure = draw_figure("heading", vary(8))
    _, bar = figure.axes
    assert bar.get_xlabel() == "Kp of 8 runs [1/s]"
    labels = [text.get_text() for text in bar.get_xticklabels()]
    assert (labels[0], labels[-1], len(labels)) == ("1", "4.5", 7)
    assert list_legend(figure) == ["goal bearing", "ideal, first and last run"]


def test_twenty_runs_leave_the_curves_most_of_the_figure() -> None:
    figure = draw_figure("heading", vary(20))
    figure.draw_without_rendering()
    assert figure.axes[0].get_position().height > 0.5


def test_runs_of_one_gain_are_named_by_the_first_and_the_last() -> None:
    seeds = [replace(RUN, name=f"seed {number}") for number in range(9)]
    _, bar = draw_figure("heading", seeds).axes
    assert bar.get_xlabel() == "9 runs, from seed 0 to seed 8"
    assert list(bar.get_xticks()) == []


def test_a_figure_that_names_no_runs_has_no_bar() -> None:
    figure = draw_figure("step-responses", vary(8))
    assert len(figure.axes) == 1


def test_a_bar_names_repeated_gains_and_any_one_number_as_views_do() -> None:
    twice = [
        replace(run, name=f"{run.name}, {seed}", parameters={**run.parameters, "seed": seed})
        for run in vary(4)
        for seed in (1, 2)
    ]
    _, bar = draw_figure("heading", twice).axes
    assert bar.get_xlabel() == "Kp of 8 runs [1/s]"
    pauses = [
        replace(RUN, name=f"{ticks}", parameters={**RUN.parameters, "law.pause_ticks": ticks})
        for ticks in range(8)
    ]
    _, bar = draw_figure("heading", pauses).axes
    assert bar.get_xlabel() == "pause of 8 runs"


def test_the_bar_tells_gains_in_three_digits() -> None:
    runs = [replace(run, name=f"{number}") for number, run in enumerate(vary(8))]
    keys = ("law.kp_linear", "law.kp_angular")
    thirds = [
        replace(run, parameters={**run.parameters, **dict.fromkeys(keys, (1.0 + number) / 3.0)})
        for number, run in enumerate(runs)
    ]
    _, bar = draw_figure("heading", thirds).axes
    labels = [text.get_text() for text in bar.get_xticklabels()]
    assert labels[:3] == ["0.333", "0.667", "1"]


def test_the_name_of_a_bar_of_long_names_fits_the_figure() -> None:
    runs = [replace(RUN, name=f"{number} {'wide ' * 5}{number}") for number in range(8)]
    figure = draw_figure("heading", runs)
    figure.draw_without_rendering()
    _, bar = figure.axes
    assert "\n" in bar.get_xlabel()
    shown = bar.xaxis.label.get_window_extent()
    assert figure.bbox.x0 <= shown.x0 < shown.x1 <= figure.bbox.x1
