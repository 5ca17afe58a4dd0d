import dataclasses
import random

import turtlelog as tl
from tests.compare.runs import make_run


def make_run_with(name: str, **gains: float) -> tl.Run:
    parameters = {f"law.kp_{loop}": gain for loop, gain in gains.items()}
    return dataclasses.replace(make_run(name=name), parameters=parameters)


def order(*runs: tl.Run) -> list[str]:
    return [run.name for run in tl.compare.order_by_gain(runs)]


def test_runs_stand_in_the_order_of_their_gains() -> None:
    runs = [make_run_with("x", linear=gain, angular=1.0) for gain in (1.0, 10.0, 2.0, 4.0)]
    found = [run.parameters["law.kp_linear"] for run in tl.compare.order_by_gain(runs)]
    assert found == [1.0, 2.0, 4.0, 10.0]


def test_the_gain_along_the_track_counts_before_the_one_of_the_heading() -> None:
    steep, turning = make_run_with("a", linear=2.0, angular=1.0), make_run_with("b", linear=1.0)
    assert order(steep, turning, make_run_with("c", linear=1.0, angular=9.0)) == ["c", "b", "a"]


def test_runs_without_gains_stand_in_the_natural_order_of_their_names() -> None:
    names = ["2", "10", "a", "run", "run2", "run2b", "run10", "run10b2", "run10b11"]
    shuffled = random.Random(0).sample(names, len(names))
    assert order(*(make_run(name=name) for name in shuffled)) == names


def test_runs_without_gains_come_last_and_digits_of_other_scripts_do_no_harm() -> None:
    assert order(make_run(name="a²٣"), make_run_with("z", linear=1.0)) == ["z", "a²٣"]


def test_numbers_in_names_may_be_of_any_length() -> None:
    names = ["run0", "run007", "run" + "9" * 4999, "run1" + "0" * 4999]
    assert order(*(make_run(name=name) for name in names[::-1])) == names


def test_runs_of_one_name_stay_as_they_were() -> None:
    runs = [dataclasses.replace(make_run(name="x"), source=source) for source in "bca"]
    assert [run.source for run in tl.compare.order_by_gain(runs)] == ["b", "c", "a"]


def shorten(*runs: tuple[str, str]) -> tuple[list[str], list[str]]:
    summaries = [
        tl.summarise_run(make_run(name=name), file=file, metrics={}) for name, file in runs
    ]
    found, notes = tl.compare.shorten_names(summaries)
    return [one.name for one in found], notes


def test_a_name_of_24_characters_stays_and_a_longer_one_is_that_of_the_file() -> None:
    assert shorten(("a" * 24, "x/a.mcap"), ("b" * 25, "x/b.mcap")) == (["a" * 24, "b.mcap"], [])
    assert shorten(("b" * 25, "x/" + "0123456789" * 3)) == (["01234567...7890123456789"], [])
    same = [("b" * 25, ""), ("b" * 25, "")]
    assert shorten(*same)[0] == [f"bbbbbbbb...bbbbbbbbb ({number})" for number in (1, 2)]


def test_what_long_names_changed_stands_once_below() -> None:
    long = "textbook kp=60 loop.transport_delay_ticks=6"
    assert shorten((long, "a.mcap")) == (["a.mcap"], [f"a.mcap: {long}"])
    many = [(long.replace("=6", f"={number}"), f"{number}.mcap") for number in range(5)]
    _, notes = shorten(*many)
    assert notes == ["Keys that these runs changed: kp, loop.transport_delay_ticks."]
