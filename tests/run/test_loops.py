"""What a law may declare, and what is refused in one line."""

import math
import pickle
import re
from dataclasses import replace
from typing import Any

import pytest

import turtlelog as tl
from turtlelog.errors import RunError
from turtlelog.run.loops import (
    COMMAND_UNITS,
    COMMAND_WORDS,
    LIMIT_KEYS,
    REFERENCE_WORDS,
    REFERENCES,
    SIGNAL_NAMES,
    SIGNAL_WORDS,
    ControlLoop,
    Declaration,
)


def make_loop(**changes: Any) -> ControlLoop:
    values = {"name": "a", "signal": "heading", "command": "turn_rate", "reference": "zero"}
    return ControlLoop(**{**values, **changes})


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"name": "run"}, "loop: expected another name than final, pause, run, found 'run'"),
        ({"name": "a b"}, "loop: expected a name of letters, digits, - and _, up to 60"),
        ({"name": "a" * 61}, "loop: expected a name of letters"),
        ({"name": 3}, "loop: expected a name of letters"),
        ({"signal": "speed"}, "loop a: signal: expected one of heading, along_track"),
        ({"command": "torque"}, "loop a: command: expected one of turn_rate, speed"),
        ({"reference": "goal_distance"}, "loop a: reference: expected one of goal_bearing"),
        ({"signal": "distance", "reference": "goal_bearing"}, "expected one of zero, recorded"),
        ({"gain": "gain"}, "loop a: gain: expected a key such as law.kp_angular, or None"),
        ({"limit": 1.0}, "loop a: limit: expected a key such as law.kp_angular, or None"),
        ({"integral_gain": "ki"}, "loop a: integral_gain: expected a key such as law.kp_angular"),
        ({"derivative_gain": ""}, "loop a: derivative_gain: expected a key such as"),
        ({"derivative_filter": 1}, "loop a: derivative_filter: expected a key such as"),
        ({"is_proportional": "no"}, "loop a: is_proportional: expected True or False, found 'no'"),
    ],
)
def test_loop_that_cannot_be_is_refused(changes: dict[str, Any], line: str) -> None:
    with pytest.raises(RunError, match=line):
        make_loop(**changes)


@pytest.mark.parametrize(
    ("values", "line"),
    [
        ({"phases": {}}, "phases: expected 1 to 250, found 0"),
        ({"phases": {f"p{n}": () for n in range(251)}}, "phases: expected 1 to 250, found 251"),
        ({"phases": ["one"]}, r"phases: expected names of loops by phase, found \['one'\]"),
        ({"phases": {"one": "a"}}, "phase one: expected a tuple, found 'a'"),
        ({"phases": {"one": ("a", "a")}}, "phase one: expected each name once, found 'a' twice"),
        ({"loops": make_loop()}, "loops: expected a tuple, found ControlLoop"),
        ({"loops": ("a",)}, "loops: expected a ControlLoop, found 'a'"),
        ({"states": "ab"}, "states: expected a tuple, found 'ab'"),
        ({"uses_goal": "no"}, "uses_goal: expected True or False, found 'no'"),
        ({"phases": {"one\n": ()}}, "phase: expected a name of letters"),
        ({"phases": {"one": ("b",)}}, "phase one: loop: expected one of a, found 'b'"),
        ({"loops": (make_loop(), make_loop())}, "loops: expected each name once, found 'a' twice"),
        ({"states": ("Integral",)}, "state: expected a field name of ROS 2 such as integral"),
        ({"states": ("a__b",)}, "state: expected a field name"),
        ({"states": ("a_",)}, "state: expected a field name"),
        ({"states": ("heading",)}, "state: expected a name that no signal has, found 'heading'"),
        ({"states": ("m", "m")}, "states: expected each name once, found 'm' twice"),
        ({"states": tuple(f"s{n}" for n in range(251))}, "states: expected up to 250, found 251"),
    ],
)
def test_declaration_that_cannot_be_is_refused(values: dict[str, Any], line: str) -> None:
    with pytest.raises(RunError, match=line):
        Declaration(**{"loops": (make_loop(),), **values})


def test_as_many_phases_as_eight_bits_hold_can_be_declared() -> None:
    names = Declaration(phases={f"p{n}": () for n in range(250)}).phase_names
    assert len(names) == 252


def test_no_state_takes_the_name_of_a_signal() -> None:
    assert set(tl.SIGNALS) <= SIGNAL_NAMES


def test_gains_of_speed_loops_come_first() -> None:
    turn = make_loop(name="t", gain="law.kt")
    drive = make_loop(name="d", signal="distance", command="speed", gain="law.kd")
    again = make_loop(name="e", signal="distance", command="speed", gain="law.kd")
    declared = Declaration(loops=(turn, drive, again, make_loop(name="free")))
    assert declared.list_gains() == ("law.kd", "law.kt")


def test_limit_is_that_of_the_command_unless_declared() -> None:
    assert make_loop().limit_key == "limits.turn_rate_rad_s"
    assert make_loop(command="speed").limit_key == "limits.speed_m_s"
    assert make_loop(limit="law.most").limit_key == "law.most"


def test_declarations_of_one_content_are_equal_and_survive_a_process() -> None:
    declared: dict[str, Any] = {"loops": (make_loop(),), "phases": {"p": ("a",)}, "states": ("m",)}
    one = Declaration(**declared, state_units={"m": "rad s"})
    again = pickle.loads(pickle.dumps(one))
    assert again == one
    assert hash(again) == hash(one)
    assert again != Declaration(**declared)


@pytest.mark.parametrize(
    ("units", "line"),
    [
        ({"n": "m"}, "state_units: expected one of m, found 'n'"),
        ({"m": ""}, "state_units: m: expected a unit such as rad s, up to 20 letters, found ''"),
        ({"m": 1}, "state_units: m: expected a unit such as rad s, up to 20 letters, found 1"),
        ("rad", "state_units: expected units by the names of states, found 'rad'"),
    ],
)
def test_units_are_of_states_that_are_declared(units: Any, line: str) -> None:
    with pytest.raises(RunError, match=re.escape(line)):
        Declaration(states=("m",), state_units=units)


@pytest.mark.parametrize(
    ("signal", "command", "integrates"),
    [
        ("heading", "turn_rate", True),
        ("along_track", "speed", True),
        ("distance", "speed", True),
        ("heading", "speed", False),
        ("cross_track", "turn_rate", False),
        ("cross_track", "speed", False),
    ],
)
def test_a_loop_is_theorys_where_its_signal_integrates_its_command(
    signal: str, command: str, *, integrates: bool
) -> None:
    loop = ControlLoop(name="a", signal=signal, command=command, reference="zero")
    assert loop.is_integrator is integrates
    assert loop.has_theory is integrates
    assert not replace(loop, is_proportional=False).has_theory


@pytest.mark.parametrize(
    ("value", "gain"),
    [
        (2.0, 2.0),
        (3, 3.0),
        (0.0, None),
        (-1.0, None),
        (math.inf, None),
        (math.nan, None),
        (True, None),
        ("2", None),
        (None, None),
    ],
)
def test_a_gain_is_a_positive_number_of_the_parameters(value: object, gain: float | None) -> None:
    assert make_loop(gain="law.kp").read_gain({"law.kp": value}) == gain
    assert make_loop().read_gain({"law.kp": value}) is None


@pytest.mark.parametrize(
    ("signal", "command", "unit"),
    [
        ("heading", "turn_rate", "1/s"),
        ("distance", "speed", "1/s"),
        ("heading", "speed", "m/(rad s)"),
        ("cross_track", "turn_rate", "rad/(m s)"),
    ],
)
def test_a_gain_has_the_unit_of_the_command_by_that_of_the_signal(
    signal: str, command: str, unit: str
) -> None:
    assert make_loop(signal=signal, command=command).gain_unit == unit


def test_limits_of_a_command_are_those_of_its_loops_or_else_its_own() -> None:
    turn, again = make_loop(name="t"), make_loop(name="u", limit="law.most")
    declared = Declaration(loops=(turn, again))
    assert declared.list_limits("turn_rate") == ("limits.turn_rate_rad_s", "law.most")
    assert declared.list_limits("speed") == ("limits.speed_m_s",)


def test_every_signal_reference_and_command_has_a_word() -> None:
    assert set(SIGNAL_WORDS) == set(REFERENCES)
    assert set(REFERENCE_WORDS) == {name for known in REFERENCES.values() for name in known}
    assert set(COMMAND_WORDS) == set(COMMAND_UNITS) == set(LIMIT_KEYS)
