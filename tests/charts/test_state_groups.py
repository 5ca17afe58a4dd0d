"""Which states of a law are shown together."""

from dataclasses import replace

import numpy as np

from tests.draw.laws import simulate_law, simulate_pid
from turtlelog.charts.plotted_curves import (
    StateGroup,
    are_comparable,
    find_state_unit,
    group_states,
)
from turtlelog.run.loops import ControlLoop, Declaration

ROTATE = ControlLoop(name="rotate", signal="heading", command="turn_rate", reference="zero")
DRIVE = ControlLoop(name="drive", signal="distance", command="speed", reference="zero")


def declare(*states: str) -> Declaration:
    phases = {"one": ("rotate", "drive")}
    return Declaration(loops=(ROTATE, DRIVE), phases=phases, states=states)


def test_states_of_a_pid_law_are_those_of_its_two_commands() -> None:
    turning, driving = group_states(simulate_pid().declaration)
    assert turning.names == ("integral_angular", "derivative_angular")
    assert turning.label == "States of the turn rate [rad/s]"
    assert turning.label_state("integral_angular") == "integral_angular [rad/s]"
    assert driving.names == ("integral_linear", "derivative_linear")
    assert driving.command == "speed"


def test_a_state_belongs_to_the_loop_whose_name_is_among_its_words() -> None:
    (turning, other) = group_states(declare("rotate_integral", "memory"))
    assert turning.names == ("rotate_integral",)
    assert other == StateGroup(title="State memory", names=("memory",), units=("",))


def test_states_of_two_units_share_no_plot_and_no_label() -> None:
    units = {"rotate_integral": "rad s", "rotate_slope": "rad/s"}
    (group,) = group_states(replace(declare("rotate_integral", "rotate_slope"), state_units=units))
    assert group.label == "States of the turn rate"
    ones = [np.ones(2), np.ones(2)]
    assert not group.can_share(group.names, ones)
    assert group.can_share(group.names[:1], ones[:1])


def test_a_state_of_one_name_and_two_units_has_none() -> None:
    seconds, metres = (
        replace(declare("memory"), state_units={"memory": unit}) for unit in ("s", "m")
    )
    assert find_state_unit("memory", [seconds, seconds]) == "s"
    assert find_state_unit("memory", [seconds, metres]) == ""
    assert find_state_unit("memory", [seconds, declare("other")]) == "s"


def test_a_state_of_two_commands_belongs_to_none() -> None:
    assert [group.command for group in group_states(declare("rotate_drive"))] == [None]


def test_up_to_three_other_states_have_a_view_each() -> None:
    assert len(group_states(declare("a", "b", "c"))) == 3
    (group,) = group_states(simulate_law("EightPhases").declaration)
    names = ("left", "seen", "worn", "old")
    assert group == StateGroup(title="States", names=names, units=("",) * 4)


def test_states_share_a_plot_unless_one_would_look_like_zero() -> None:
    one = np.array([0.0, -1.0, np.nan])
    assert are_comparable([one, np.array([0.0, 19.0])])
    assert not are_comparable([one, np.array([0.0, 21.0])])
    assert are_comparable([one, np.zeros(2)])


def test_no_more_states_share_a_plot_than_there_are_hues() -> None:
    assert are_comparable([np.ones(2)] * 7)
    assert not are_comparable([np.ones(2)] * 8)
