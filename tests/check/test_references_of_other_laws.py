"""Verdicts on runs of a law that is like none of ours, against references."""

import dataclasses

import numpy as np

import turtlelog as tl
from tests.strange_law import simulate_strange
from turtlelog.run import Run
from turtlelog.run.loops import ControlLoop

ONE = simulate_strange()
TWO = simulate_strange(law__gain_b=2.0, name="faster")
PAPER = tl.simulate_run(tl.load_scenario("paper-kp4"))
CLOSE = tl.Tolerance(abs=0.1, reason="as close as that")


def judge(reference: Run, run: Run, **names: str) -> tl.check.CheckResult:
    ((kind, name),) = names.items()
    tolerance = dataclasses.replace(CLOSE, abs=0.0) if name == "phase" else CLOSE
    tolerances = tl.Tolerances(**{f"{kind}s": {name: tolerance}})
    (result,) = tl.check.match_run(run, reference, tolerances)
    return result


def test_a_state_is_judged_as_a_signal() -> None:
    assert judge(ONE, ONE, signal="memory").verdict == "PASS"
    assert judge(ONE, TWO, signal="memory").verdict == "FAIL"


def test_a_state_of_another_law_is_not_held_and_what_nobody_has_is_told_with_the_nearest() -> None:
    result = judge(PAPER, ONE, signal="memory")
    expected = "paper-kp4 does not hold it: no state of its law (it has none)"
    assert (result.verdict, result.reason) == ("FAIL", expected)
    result = judge(ONE, TWO, signal="memry")
    expected = "neither a signal nor a state of these laws (they have memory); did you mean memory?"
    assert (result.verdict, result.reason) == ("FAIL", expected)


def renumber(run: Run) -> Run:
    """Return the same run of a law that lists its phases the other way round."""
    names = dict(reversed(list(run.declaration.phases.items())))
    declared = dataclasses.replace(run.declaration, phases=names)
    numbers = np.array([declared.phase_names.index(name) for name in run.phase_names])
    samples = dataclasses.replace(run.samples, phase=numbers[run.samples.phase])
    return dataclasses.replace(run, declaration=declared, samples=samples)


def test_phases_are_judged_by_name() -> None:
    again = renumber(ONE)
    assert (again.samples.phase != ONE.samples.phase).all()
    assert judge(ONE, again, signal="phase").verdict == "PASS"
    result = judge(PAPER, ONE, signal="phase")
    assert (result.verdict, result.reason) == (
        "FAIL",
        "one where the reference has rotate at 0.000 s",
    )


def test_a_metric_that_neither_run_has_does_not_pass() -> None:
    assert judge(ONE, ONE, metric="a.rms_error").verdict == "PASS"
    result = judge(ONE, ONE, metric="rotate.overshoot")
    expected = "no_phase (the run declares no loop rotate (it declares a, b))"
    assert (result.verdict, result.reason) == ("FAIL", expected)


def test_metrics_of_one_id_and_two_units_do_not_pass() -> None:
    loop = ControlLoop(name="b", signal="heading", command="speed", reference="goal_bearing")
    declared = dataclasses.replace(ONE.declaration, loops=(ONE.declaration.loops[0], loop))
    other = dataclasses.replace(ONE, declaration=declared, name="swapped")
    result = judge(ONE, other, metric="b.rms_error")
    assert (result.verdict, result.value) == ("FAIL", None)
    assert result.reason == "in deg, where the reference has m: not compared"
