"""How a robot follows its commands in words, the same on the command line and in a notebook."""

from dataclasses import replace
from pathlib import Path

import pytest

import turtlelog as tl
from turtlelog.cli.identify import describe_gain, format_robot
from turtlelog.identify import (
    AxisModel,
    Estimate,
    format_delay,
    format_gain,
    list_unit_faults,
    write_robot_headline,
)
from turtlelog.identify.axis_motion import Axis
from turtlelog.identify.fit_values import describe_rivals
from turtlelog.identify.held_response import Structure

DRIVEN = AxisModel(
    axis="speed",
    status="ok",
    gain=Estimate(value=0.9, low=0.88, high=0.92, unit="1"),
    dead_time_s=Estimate(value=0.08, low=0.07, high=0.09),
    lag_s=Estimate(value=0.12, low=0.11, high=0.13),
    total_delay_s=Estimate(value=0.2, low=0.19, high=0.21),
    doubts=("the log does not tell a & b apart",),
)
UNKNOWN = AxisModel(axis="turn_rate", status="not_identifiable", reason="it never turns")


def test_the_cause_and_not_the_sentence_says_that_an_axis_is_idle() -> None:
    told = replace(UNKNOWN, reason="the turn rate is never commanded", refusal="hidden")
    assert not told.is_idle
    assert replace(told, reason="it never turns", refusal="never_commanded").is_idle


def test_the_answer_names_the_commands_to_which_the_gain_does_not_apply() -> None:
    back, taken = (Estimate(value=one, low=one, high=one, unit="m/s") for one in (0.7, 0.2))
    axis = replace(DRIVEN, reverse_gain=back, friction=taken, deadband=taken)
    told = " (backwards 0.7 times the command) less friction of 0.2 m/s above a deadband of 0.2 m/s"
    assert describe_gain(DRIVEN) == "drives at 90 % of the commanded speed"
    assert describe_gain(axis) == f"drives at 90 % of the commanded speed{told}"
    headline = write_robot_headline([axis], "bag")
    assert headline[1] == f"Gain: speed 0.900{told}."


def test_a_value_prints_as_many_digits_as_its_interval_tells() -> None:
    assert format_delay(Estimate(value=0.0804, low=0.0751, high=0.0857)) == "80 (75 to 86)"
    assert format_delay(Estimate(value=0.0804, low=0.0801, high=0.0807)) == "80.4 (80.1 to 80.7)"
    assert (format_delay(None), format_gain(None)) == ("-", "-")


def test_a_notebook_shows_the_answer_the_values_and_the_doubts() -> None:
    html = tl.RobotModel(files=("bag",), speed=DRIVEN, turn_rate=UNKNOWN)._repr_html_()
    answer = "bag: total delay of speed 200 ms (190 to 210). Gain: speed 0.900."
    rest = "The turn rate could not be identified. In doubt: speed (plan with 210 ms)."
    assert f"<strong>{answer} {rest}</strong>" in html
    sure = tl.RobotModel(files=("bag",), speed=replace(DRIVEN, doubts=()), turn_rate=UNKNOWN)
    assert "In doubt" not in sure._repr_html_()
    for text in ("dead time [ms]", "0.900 (0.880 to 0.920)", "80 (70 to 90)", "it never turns"):
        assert text in html
    assert "does not tell a &amp; b apart" in html


def test_without_a_known_axis_the_answer_says_so() -> None:
    model = tl.RobotModel(files=("bag",), speed=UNKNOWN, turn_rate=UNKNOWN)
    assert "<strong>bag: no axis could be identified.</strong>" in model._repr_html_()


def test_rivals_name_once_what_all_of_them_have() -> None:
    within = Structure(order="limited_within")
    bound = Structure(order="limited_within", bound="command")
    assert describe_rivals([bound, within]) == (
        "a limit of the acceleration within the velocity loop, alone or with a bound of the command"
    )
    rivals = [Structure(order="first_order", bound="command"), Structure(order="first_order")]
    assert describe_rivals(rivals) == "a bound of the command or one time constant alone"


@pytest.mark.parametrize(
    ("axis", "gain", "told"),
    [
        ("turn_rate", 54.4, "bag: the headings of the poses are probably in deg"),
        ("turn_rate", 0.0166, "bag: the commanded turn rates are probably in deg/s"),
        ("speed", 90.0, "bag: the positions of the poses are probably in cm"),
        ("speed", 900.0, "bag: the positions of the poses are probably in mm"),
        ("speed", 0.009, "bag: the commanded speeds are probably in cm/s"),
        ("speed", 0.0009, "bag: the commanded speeds are probably in mm/s"),
        *(("turn_rate", gain, "bag: total delay of turn rate 200 ms") for gain in (28.0, 87.0)),
        *(("speed", gain, "bag: total delay of speed 200 ms") for gain in (0.016, 49.0, 0.3)),
    ],
)
def test_a_gain_of_another_unit_is_told_first(axis: Axis, gain: float, told: str) -> None:
    wrong = replace(DRIVEN, axis=axis, gain=Estimate(value=gain, low=gain, high=gain, unit="1"))
    headline = write_robot_headline([wrong], "bag")
    assert headline[0].startswith(told)
    if "probably" in told:
        assert "add --column " in headline[0]
        assert headline[1].startswith("Total delay of ")


def test_the_note_on_a_unit_is_printed_once() -> None:
    wrong = replace(DRIVEN, gain=Estimate(value=90.0, low=89.0, high=91.0, unit="1"))
    notes = tuple(list_unit_faults([wrong, UNKNOWN]))
    model = tl.RobotModel(files=("bag",), speed=wrong, turn_rate=UNKNOWN, notes=notes)
    assert " ".join(format_robot(model, [Path("bag.csv")]).split()).count("probably") == 1
