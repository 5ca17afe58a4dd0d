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
