import sys

import pytest

import turtlelog as tl
from tests.check.pytest_plugin.conftest import run
from turtlelog.run import slice_run

OVERSHOOT = """
def test_it(recording):
    assert recording.phase("rotate").overshoot <= 0.5
"""


def test_every_recording_is_an_item_of_its_own(suite: pytest.Pytester) -> None:
    result = run(suite, OVERSHOOT, "-v")
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(["*::test_it[[]kp10[]] FAILED*", "*::test_it[[]kp4[]] PASSED*"])


def test_a_failed_bound_says_all_there_is_to_say(suite: pytest.Pytester) -> None:
    result = run(suite, OVERSHOOT)
    result.stdout.fnmatch_lines(
        [
            "E * assert <Metric rotate.overshoot: 1.0076 %> <= 0.5",
            "E * rotate.overshoot of runs/kp10.mcap: expected <= 0.5 %",
            "*-- turtlelog --*",
            "rotate.overshoot: expected <= 0.5 %",
            "  value           1.0076 % at 2.336 s",
            "  limit           0.5 %",
            "  margin          -0.50756 %",
            "  first violated  2.288 s (simulated time, from the first sample)",
            "       t [[]s[]]  heading_error [[]deg[]]  turn_rate [[]rad/s[]]",
            "       2.272             -0.28344           -0.04947",
            "    >  2.288             -0.74908           -0.13074",
            "       2.304              -1.0681           -0.18641",
            "  recording       runs/kp10.mcap",
            "  gains           law.kp_angular = 10.0, law.kp_linear = 10.0",
            "  scenario        paper-kp10, max_duration_s = 60.0,*",
        ]
    )


def test_a_formula_that_fails_says_where(suite: pytest.Pytester) -> None:
    body = """
def test_it(recording):
    assert recording.holds("always(abs(cross_track) <= 0.05)", phase="translate")
"""
    run(suite, body).stdout.fnmatch_lines(
        [
            "E * assert <FAIL: 0.10774 m; always(abs(cross_track) <= 0.05) in translate;"
            " margin -0.057737 m; first violated at 5.664 s>",
            "expected always(abs(cross_track) <= 0.05) in translate",
            "  value           0.10774 m at 8.784 s",
            "  margin          -0.057737 m",
            "  first violated  5.664 s (simulated time, from the first sample)",
            "    >  5.664         -0.05008",
        ]
    )


def test_a_formula_of_several_comparisons_names_the_one_that_decides(
    suite: pytest.Pytester,
) -> None:
    body = """
def test_it(recording):
    assert recording.holds("always(abs(turn_rate) <= 1 and abs(cross_track) <= 0.05)")
"""
    run(suite, body).stdout.fnmatch_lines(
        [
            "E * decided by abs(cross_track) <= 0.05; margin -0.057737 m; *",
            "  decided by      abs(cross_track) <= 0.05",
            "  value           0.10774 m at * s",
            "  limit           0.05 m",
        ]
    )


NONE = "rotate.decay_ratio"


def test_a_metric_without_a_value_fails_whatever_the_operator(suite: pytest.Pytester) -> None:
    operators = ["<", "<=", ">", ">=", "==", "!="]
    tests = [
        f"def test_{i}(recording):\n    assert recording.metric('{NONE}') {operator} 4\n"
        for i, operator in enumerate(operators)
    ]
    result = run(suite, "\n".join(tests), marker='"runs/kp4.mcap"')
    result.assert_outcomes(failed=6)
    for operator in operators:
        result.stdout.fnmatch_lines(
            [
                f"E *MissingValueError: runs/kp4.mcap: rotate.decay_ratio: expected {operator} 4,"
                " found no value: not_reached (the response does not overshoot twice)",
                "  reason          not_reached (the response does not overshoot twice)",
            ]
        )


UNUSUAL = """
def test_bool(recording):
    assert recording.phase("rotate").overshoot

def test_nan(recording):
    assert recording.phase("rotate").overshoot != float("nan")

def test_approx(recording):
    assert recording.phase("rotate").overshoot == pytest.approx(0.5, abs=0.1)

def test_abs(recording):
    assert abs(recording.metric("final.cross_track")) <= 0.05

def test_units(recording):
    assert recording.phase("rotate").overshoot < recording.phase("rotate").settling_time
"""


def test_unusual_comparisons_say_what_is_wrong(suite: pytest.Pytester) -> None:
    result = run(suite, UNUSUAL, marker='"runs/kp10.mcap"')
    result.assert_outcomes(failed=5)
    result.stdout.fnmatch_lines(
        [
            "*rotate.overshoot: compare it with a limit*",
            "*expected a number after !=, found nan",
            "rotate.overshoot: expected == 0.5 % ± 0.1",
            "  margin          -0.40756 %",
            "*abs(final.cross_track) of runs/kp10.mcap: expected <= 0.05 m",
            "  value           0.10673 m at *",
            "  first violated  *",
            "*rotate.overshoot: expected two of one unit, found*",
        ]
    )


def test_metrics_are_measured_with_settings(suite: pytest.Pytester) -> None:
    body = """
def test_it(recording):
    rotate = recording.phase("rotate")
    assert rotate.settling_time(band=0.2) < rotate.settling_time
    assert 2 < rotate.settling_time < 3
    assert 1e9 > float(rotate.settling_time) == pytest.approx(rotate.settling_time.value)
    assert rotate.settling_time == pytest.approx(2.2, rel=0.1)
    assert not rotate.overshoot > 50
"""
    result = run(suite, body)
    result.assert_outcomes(passed=2)
    result.stdout.fnmatch_lines(["turtlelog: 2 recordings, 10 checks, worst margins: *"])


UNKNOWN = {
    'metric("rotate.overshot") < 1': '*metric: *"rotate.overshot"; *mean rotate.overshoot[?]',
    'phase("rotat")': '*phase: unknown name "rotat"; did you mean rotate[?]',
    'phase("rotate").overshot < 1': '*metric of rotate: *"overshot"; did you mean overshoot[?]',
    'holds("always(cros_track < 1)")': '*column 8: unknown name "cros_track"; *cross_track*',
    'holds("always(x < ")': "*holds: column 11: expected a number or name, found the end",
    'holds("x < 1", phase="rotat")': '*phase: unknown name "rotat"; did you mean rotate[?]',
    'metric("rotate.overshoot", bnad=1) < 1': "*expected settings among band, *, found bnad",
    'matches("nothing.mcap")': "*nothing.mcap: expected a reference, found no such file*",
}


def test_what_there_is_not_is_told_with_what_is_near_and_without_our_own_frames(
    suite: pytest.Pytester,
) -> None:
    tests = [f"def test_{i}(recording):\n    recording.{a}\n" for i, a in enumerate(UNKNOWN)]
    result = run(suite, "\n".join(tests), marker='"runs/kp4.mcap"')
    result.assert_outcomes(failed=len(UNKNOWN))
    for message in UNKNOWN.values():
        result.stdout.fnmatch_lines([message])
    assert "turtlelog/check" not in result.stdout.str()


def test_the_whole_traceback_is_there_when_asked_for(suite: pytest.Pytester) -> None:
    body = "def test_it(recording):\n    recording.metric('no')\n"
    assert "turtlelog/check" in run(suite, body, "--full-trace").stdout.str()


def test_a_truncated_recording_fails_unless_it_may_be(suite: pytest.Pytester) -> None:
    path = suite.path / "runs" / "kp4.mcap"
    path.write_bytes(path.read_bytes()[:-2000])
    body = "def test_it(recording):\n    assert recording.metric('run.duration') > 0\n"
    result = run(suite, body, marker='"runs/kp4.mcap"')
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        ["E *PartialLogError: runs/kp4.mcap: the recording is not complete:*"]
    )
    run(suite, body, marker='"runs/kp4.mcap", allow_partial=True').assert_outcomes(passed=1)
    run(suite, body, "-o", "turtlelog_allow_partial=true").assert_outcomes(passed=2)


DENIED = {
    'recording.holds("rotate.decay_ratio < 4")': "*undecided: *not_reached (the response does*",
    'recording.holds("always[0, 100](x < 99)")': "*undecided: *recording ends before the formula*",
    'recording.holds("always(x < 99)")': "*undecided: *; the recording ends before the formula*",
    'recording.holds("x < 99", phase="pause")': "*undecided: *no_phase (the run has no phase*",
    'any([recording.holds("always(x < 99)"), True])': "*undecided: *the recording ends before*",
    "recording.driven_by()": "*driven again: assert .matches(recording)",
}


def test_what_is_undecided_is_not_denied(suite: pytest.Pytester) -> None:
    run_ = tl.read_recording(suite.path / "runs" / "kp4.mcap")
    tl.write_recording(slice_run(run_, end_ns=10**9), suite.path / "cut.mcap")
    tests = [
        f"def test_{i}(recording):\n    assert not {asked}\n\n"
        f"def test_{i}_otherwise(recording):\n    assert {asked}\n"
        for i, asked in enumerate(DENIED)
    ]
    result = run(suite, "\n".join(tests), "--junitxml=r.xml", marker='"cut.mcap"')
    result.assert_outcomes(failed=2 * len(DENIED))
    for message in DENIED.values():
        result.stdout.fnmatch_lines([f"E {message}"])


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such names of files")
def test_no_name_steers_the_terminal(suite: pytest.Pytester) -> None:
    steer = "\nFAKE\x1b[31m\u202e"
    (suite.path / "runs" / "kp4.mcap").rename(suite.path / "runs" / f"a{steer}.mcap")
    (suite.path / "runs" / "kp10.mcap").write_bytes(b"junk")
    result = run(
        suite, 'def test_it(recording):\n    assert recording.metric("run.duration") < 1\n'
    )
    text = f"{result.stdout}\n{result.stderr}"
    assert "\x1b" not in text
    assert "\u202e" not in text
    assert not [line for line in text.splitlines() if line.startswith("FAKE")]
