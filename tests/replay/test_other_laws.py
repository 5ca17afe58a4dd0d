"""A law with other loops and phases, a state and a moving reference, driven again."""

from dataclasses import replace

import numpy as np
import pytest

from tests.replay.changes import change_scenario, change_value
from tests.strange_law import KIND, simulate_strange
from turtlelog.errors import ScenarioError
from turtlelog.replay import LawReplay, LoopReplay, replay_law, replay_loop
from turtlelog.run import Run
from turtlelog.run.loops import Declaration
from turtlelog.scenario import restore_scenario
from turtlelog.simulate import simulate_run


@pytest.fixture(scope="module")
def strange() -> Run:
    return simulate_strange()


def list_signals(found: LawReplay | LoopReplay) -> set[str]:
    return {signal.signal for signal in found.signals}


def test_states_and_the_reference_pose_are_compared_by_name(strange: Run) -> None:
    for found in (
        replay_law(strange, trust_law=True),
        replay_loop(strange, trust_law=True),
    ):
        assert {"memory", "reference_x", "reference_y", "reference_heading"} <= list_signals(found)
        assert (found.first_difference, found.declaration, found.absent) == (None, None, ())
        assert {signal.largest for signal in found.signals} == {0.0}


def test_the_law_of_a_recording_runs_with_trust_only(strange: Run) -> None:
    with pytest.raises(ScenarioError, match="--trust-law"):
        replay_law(strange)
    with pytest.raises(ScenarioError, match="--trust-law"):
        replay_loop(strange)


def test_a_changed_state_is_found_by_its_name(strange: Run) -> None:
    states = np.array(strange.samples.states)
    states[7, 0] += 0.5
    run = replace(strange, samples=replace(strange.samples, states=states))
    first = replay_law(run, trust_law=True).first_difference
    assert first is not None
    assert (first.signal, first.recorded) == ("memory", states[7, 0])


def test_a_reference_that_one_side_lacks_is_a_difference(strange: Run) -> None:
    run = change_value(strange, "samples", "reference_heading_rad", 3, float("nan"))
    found = replay_law(run, trust_law=True)
    first = found.first_difference
    assert first is not None
    assert (first.signal, first.recorded) == ("reference_heading", None)
    assert first.replayed is not None
    (signal,) = (one for one in found.signals if one.signal == "reference_heading")
    assert (signal.differing, signal.largest) == (1, 0.0)


def test_phases_are_compared_by_their_names_not_by_their_numbers(strange: Run) -> None:
    declared = strange.declaration
    phases = {"other": ("a",), **declared.phases}
    renumbered = replace(
        strange,
        declaration=replace(declared, phases=phases),
        samples=replace(strange.samples, phase=strange.samples.phase + 1),
    )
    found = replay_law(renumbered, trust_law=True)
    assert found.first_difference is None
    renamed = replace(
        strange, declaration=replace(declared, phases={"other": ("a",), "two": ("b",)})
    )
    first = replay_law(renamed, trust_law=True).first_difference
    assert first is not None
    assert (first.signal, first.recorded, first.replayed) == ("phase", "other", "one")


def test_another_declaration_is_told_beside_the_differences(strange: Run) -> None:
    declared = strange.declaration
    run = replace(strange, declaration=replace(declared, loops=declared.loops[:1],
                                               phases={"one": ("a",), "two": ()}))  # fmt: skip
    for found in (replay_law(run, trust_law=True), replay_loop(run, trust_law=True)):
        told = found.declaration
        assert told is not None
        assert found.first_difference is None
        assert told.recorded == (
            "loops a (heading by turn_rate to recorded, gain law.gain_a,"
            " limit limits.turn_rate_rad_s); phases one (a), two (no loop)"
        )
        assert str(told.replayed).endswith("; phases one (a), two (b)")


def test_a_loop_that_is_no_longer_proportional_is_told(strange: Run) -> None:
    declared = strange.declaration
    loops = (replace(declared.loops[0], is_proportional=False), *declared.loops[1:])
    found = replay_law(replace(strange, declaration=replace(declared, loops=loops)), trust_law=True)
    assert found.declaration is not None
    told, answered = str(found.declaration.recorded), str(found.declaration.replayed)
    assert told.replace(", not proportional", "", 1) == answered != told


def test_another_law_answers_what_it_can_and_the_rest_is_absent(strange: Run) -> None:
    found = replay_law(strange, change_scenario("textbook"))
    assert not {"memory", "reference_x"} & list_signals(found)
    assert found.declaration is not None
    scenario = restore_scenario(strange, trust_law=True)
    back = replay_law(simulate_run(change_scenario("textbook")), scenario)
    assert {"memory", "reference_x"} <= {*back.absent}


def test_a_law_without_a_declaration_is_replayed(strange: Run) -> None:
    samples = replace(strange.samples, states=None, phase=np.zeros_like(strange.samples.phase),
                      reference_xy_m=None, reference_heading_rad=None)  # fmt: skip
    bare = replace(strange, declaration=Declaration(), samples=samples)
    found = replay_law(bare, change_scenario("textbook", law__kind=KIND, law__gain_a=4.0))
    assert {"memory", "reference_x", "reference_y", "reference_heading"} == {*found.absent}
    first = found.first_difference
    assert first is not None
    assert (first.signal, first.recorded, first.replayed) == ("phase", "control", "one")
