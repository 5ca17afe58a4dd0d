"""The plugin with a law that is like none of ours."""

import pytest

import turtlelog as tl
from tests.check.pytest_plugin.conftest import run
from tests.strange_law import simulate_strange

PASSES = """
def test_loops(recording):
    a, b = recording.phase("a"), recording.phase("b")
    assert a.rms_error < 10
    assert b.settling_time < 8
    assert recording.metric("a.saturated_share") < 0.5

def test_states_and_phases(recording):
    assert recording.holds("always(memory > -100)")
    assert recording.holds("always(speed == 0 or phase == 'two')", phase="one")
    assert recording.matches(recording)
    assert recording.driven_by().matches(recording)
"""

FAILS = {
    'phase("rotate")': '*phase: unknown name "rotate"; there are a, b, final, run',
    'phase("a").overshoot < 1': '*metric of a: unknown name "overshoot"; there are duration, *',
    'metric("rotate.overshoot") < 1': "*rotate.overshoot: expected < 1, found no value: no_phase"
    " (the run declares no loop rotate (it declares a, b))",
    'metric("a.rms_error") < 1': "  gains           law.gain_a = 4.0, law.gain_b = 1.0",
    'holds("always(memory < 0)")': "*memory*",
    'holds("x < 99", phase="rotate")': "*no phase rotate; it has one, two, pause)",
    'holds("integral < 1")': '*unknown name "integral"; *(the law of this run has memory)',
}


@pytest.fixture
def strange(pytester: pytest.Pytester) -> pytest.Pytester:
    runs = pytester.mkdir("runs")
    tl.write_recording(simulate_strange(), runs / "strange.mcap")
    pytester.makeini("[pytest]\nfilterwarnings = error\nstrict = true\n")
    return pytester


def test_a_test_asks_for_its_loops_states_and_phases(strange: pytest.Pytester) -> None:
    result = run(strange, PASSES, marker='"runs/*.mcap", trust_law=True')
    result.assert_outcomes(passed=2)


def test_what_its_law_does_not_have_fails_and_is_told(strange: pytest.Pytester) -> None:
    tests = [f"def test_{i}(recording):\n    assert recording.{a}\n" for i, a in enumerate(FAILS)]
    result = run(strange, "\n".join(tests))
    result.assert_outcomes(failed=len(FAILS))
    for line in FAILS.values():
        result.stdout.fnmatch_lines([line])


def test_a_scenario_of_its_own_gains_is_simulated_with_kp(strange: pytest.Pytester) -> None:
    body = """
def test_it(simulate):
    changes = {"law.kind": KIND, "law.gain_a": 4.0}
    slow = simulate("textbook", kp=2.0, changes=changes)
    assert slow.run.parameters["law.gain_b"] == 2.0
    assert slow.run.parameters["law.gain_a"] == 4.0
    assert slow.phase("a").rms_error > 1.0
"""
    from tests.strange_law import KIND

    result = run(strange, f"KIND = {KIND!r}\n{body}", marker="")
    result.assert_outcomes(passed=1)


OWN = """
from pathlib import Path
import pytest
from turtlelog.errors import CheckError
from turtlelog.laws import SequentialP

class Own(SequentialP):
    pass

def test_class(turtlelog_simulate):
    recording = turtlelog_simulate(law=Own, kp=2)
    assert recording.run.parameters["law.kind"].endswith(":Own")
    assert recording.run.parameters["loop.start_backlog"] == 1  # of textbook
    assert recording.phase("rotate").overshoot < 5
    assert recording.driven_by(Own(Own.Parameters(kp_angular=2, kp_linear=2, projection="heading",
        wrap_error=True, pause_ticks=0))).matches(recording)

def test_scenario(turtlelog_simulate):
    assert turtlelog_simulate("paper", law=Own).run.parameters["loop.start_backlog"] == 5

def test_file(turtlelog_simulate):
    assert turtlelog_simulate(law=f"{__file__}:Own").phase("rotate").overshoot < 5

def test_helper(turtlelog_simulate, tmp_path):
    (tmp_path / "gains.py").write_text("KP = 2")
    law = "import gains\\nfrom turtlelog.laws import SequentialP as Own\\nassert gains.KP == 2"
    (tmp_path / "own.py").write_text(law)
    assert turtlelog_simulate(law=f"{tmp_path / 'own.py'}:Own").phase("rotate").overshoot < 5

def test_no_class_of_a_module(turtlelog_simulate):
    class Inner(SequentialP):
        pass
    with pytest.raises(CheckError, match="law: expected a class or LawPart at the top"):
        turtlelog_simulate(law=Inner)
    with pytest.raises(CheckError, match="found 3"):
        turtlelog_simulate(law=3)
"""


def test_a_class_of_ones_own_is_simulated_by_itself(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(OWN)
    pytester.runpytest("-p", "turtlelog.check.pytest_plugin").assert_outcomes(passed=5)
