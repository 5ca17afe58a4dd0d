import json

import pytest

import turtlelog as tl
from tests.check.pytest_plugin.conftest import run
from turtlelog.run import slice_run

MATCHES = """
@pytest.mark.reference("good/{stem}.SUFFIX")
def test_it(recording, reference):
    assert recording.matches(reference)
"""


@pytest.mark.parametrize("suffix", ["json", "mcap"])
def test_a_reference_is_written_when_accepted_and_matched_then(
    suite: pytest.Pytester, suffix: str
) -> None:
    body = MATCHES.replace("SUFFIX", suffix)
    missing = run(suite, body)
    missing.assert_outcomes(failed=2)
    missing.stdout.fnmatch_lines(["*expected a reference, found no such file; --turtlelog-accept*"])
    accepted = run(suite, body, "--turtlelog-accept")
    accepted.assert_outcomes(passed=2)
    accepted.stdout.fnmatch_lines([f"*, accepted *kp10.{suffix}, accepted *kp4.{suffix}"])
    assert sorted(path.stem for path in (suite.path / "good").iterdir()) == ["kp10", "kp4"]
    run(suite, body).assert_outcomes(passed=2)


@pytest.mark.parametrize("suffix", ["json", "mcap"])
def test_a_changed_run_does_not_match(suite: pytest.Pytester, suffix: str) -> None:
    body = MATCHES.replace("SUFFIX", suffix)
    run(suite, body, "--turtlelog-accept")
    scenario = tl.override_scenario(tl.load_scenario("paper-kp4"), {"law.pause_ticks": 40})
    tl.write_recording(tl.simulate_run(scenario), suite.path / "runs" / "kp4.mcap")
    result = run(suite, body)
    result.assert_outcomes(passed=1, failed=1)
    wanted = "signals.x: *" if suffix == "mcap" else "metrics.rotate.duration: *"
    result.stdout.fnmatch_lines(["*within * of the reference*", "*where the reference has *"])
    assert wanted.removesuffix(": *") in result.stdout.str()


def test_one_reference_cannot_be_accepted_from_two_recordings(suite: pytest.Pytester) -> None:
    body = MATCHES.replace("{stem}.SUFFIX", "all.json")
    result = run(suite, body, "--turtlelog-accept")
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(["*expected one recording to accept, found *{stem}*"])


def test_the_metrics_command_writes_references(suite: pytest.Pytester) -> None:
    metrics = tl.measure_run(tl.read_run(suite.path / "runs" / "kp4.mcap"))
    entries = [
        {"id": m.id, "value": m.value, "unit": m.unit, "status": m.status.value}
        for m in metrics.values()
    ]
    (suite.path / "kp4.json").write_text(json.dumps([{"file": "a", "metrics": entries}]))
    body = "def test_it(recording):\n    assert recording.matches('kp4.json')\n"
    run(suite, body, marker='"runs/kp4.mcap"').assert_outcomes(passed=1)


def test_the_ini_option_names_a_reference(suite: pytest.Pytester) -> None:
    body = "def test_it(recording, reference):\n    assert recording.matches(reference)\n"
    none = run(suite, body)
    none.stdout.fnmatch_lines(["*the test needs @pytest.mark.reference(*) or *"])
    words = ("-o", "turtlelog_reference=runs/{stem}.mcap")
    run(suite, body, *words).assert_outcomes(passed=2)


def test_tolerances_of_a_file_decide(suite: pytest.Pytester) -> None:
    (suite.path / "t.toml").write_text('format = 1\n[signals.x]\nabs = 9\nreason = "wide"\n')
    body = """
def test_file(recording):
    assert recording.matches("runs/kp4.mcap", tolerance="t.toml")

def test_all(recording):
    assert recording.matches("runs/kp4.mcap", tolerance=Tolerance(abs=0.001))
"""
    run(suite, body).assert_outcomes(passed=3, failed=1)


def test_a_shorter_run_does_not_match(suite: pytest.Pytester) -> None:
    path = suite.path / "runs" / "kp4.mcap"
    run_ = tl.read_run(path)
    tl.write_recording(slice_run(run_, end_ns=run_.end_ns - 500_000_000), suite.path / "cut.mcap")
    body = "def test_it(recording):\n    assert recording.matches('runs/kp4.mcap')\n"
    result = run(suite, body, marker='"cut.mcap"')
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        ["length: expected as long as the reference", "*10.672 s long, not 11.184 s"]
    )


WHY = """def test_it(recording):
    tolerance = Tolerance(abs=0.001)
    assert recording.matches('runs/kp4.mcap', tolerance=tolerance)
"""


@pytest.mark.parametrize(("words", "is_told"), [((), True), (("--turtlelog-no-why",), False)])
def test_a_failure_says_why_the_recording_differs_from_its_reference(
    suite: pytest.Pytester, words: tuple[str, ...], *, is_told: bool
) -> None:
    report = suite.path / "report.xml"
    result = run(suite, WHY, f"--junitxml={report}", *words, marker='"runs/kp10.mcap"')
    result.assert_outcomes(failed=1)
    for text in (" ".join(result.stdout.str().split()), " ".join(report.read_text().split())):
        told = "why final.position_error rose from 0.0085 m to 0.1067 m: the gains add 0.1499 m,"
        assert (told in text) is is_told
        more = "turtlelog compare REFERENCE runs/kp10.mcap --why final.position_error"
        assert (more in text) is is_told


@pytest.mark.parametrize("words", [(), ("--turtlelog-no-why",)])
def test_an_accepted_file_of_metrics_says_why_another_recording_fails(
    suite: pytest.Pytester, words: tuple[str, ...]
) -> None:
    """Takes some 3 s: pytest runs twice, and an accepted scenario is simulated."""
    body = "def test_it(recording, reference):\n    assert recording.matches(reference)\n"
    options = ("-o", "turtlelog_reference=good.json")
    run(suite, body, *options, "--turtlelog-accept", marker='"runs/kp4.mcap"')
    report = suite.path / "report.xml"
    result = run(suite, body, *options, f"--junitxml={report}", *words, marker='"runs/kp10.mcap"')
    result.assert_outcomes(failed=1)
    for text in (" ".join(result.stdout.str().split()), " ".join(report.read_text().split())):
        assert ("final.position_error rose from 0.0085 m to 0.1067 m" in text) is (not words)
        assert ("The scenario in good.json, simulated again, has the " in text) is (not words)


BAD = {
    "empty": ("{}", "*LogError: good.json: data: expected a JSON object*"),
    "none": ('{"metrics": []}', "*metrics: must not be empty"),
    "id": ('{"metrics": [{"id": "a"}]}', "*metrics[[]0[]].id: expected the id of a metric*'a'"),
    "wrong kind": ('{"metrics": [{"id": ["a"]}]}', "*expected the id of a metric, found [[]'a'[]]"),
    "two runs": (
        '[{"metrics": []}, {"metrics": []}]',
        "*good.json: expected the metrics of one run, found 2",
    ),
    "no JSON": ("\\0\\1", "*LogError: good.json: expected *"),
    "nan": (
        '{"metrics": [{"id": "run.duration", "unit": "s", "status": "ok", "value": NaN}]}',
        "*value: expected one that goes with ok, found nan",
    ),
    "huge": (
        '{"metrics": [{"id": "run.duration", "unit": "s", "status": "ok", "value": 9'
        + f"{'9' * 400}}}]}}",
        "*value: expected one that goes with ok, found 999*",
    ),
    "unit": (
        '{"metrics": [{"id": "run.duration", "unit": "m"}]}',
        "*unit: expected s, found 'm'",
    ),
    "value": (
        '{"metrics": [{"id": "run.duration", "unit": "s", "status": "ok", "value": null}]}',
        "*value: expected one that goes with ok, found None",
    ),
    "status": (
        '{"metrics": [{"id": "run.duration", "unit": "s", "status": "fine", "value": 1}]}',
        "*status: expected one of a metric, found 'fine'",
    ),
}


@pytest.mark.parametrize(("text", "message"), BAD.values(), ids=BAD)
def test_a_wrong_reference_is_refused(suite: pytest.Pytester, text: str, message: str) -> None:
    (suite.path / "good.json").write_text(text)
    body = "def test_it(recording):\n    assert recording.matches('good.json')\n"
    result = run(suite, body, marker='"runs/kp4.mcap"')
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines([message])


def test_a_law_that_is_a_part_is_simulated(suite: pytest.Pytester) -> None:
    body = """
from dataclasses import replace
import pytest
from turtlelog.errors import CheckError
from turtlelog.laws import SequentialP

def step(settings, state, table, row, time_ns, pose):
    return SequentialP.step(settings, state, table, row, time_ns, pose)

Own = replace(SequentialP, step=step)

def test_built_in(turtlelog_simulate):
    recording = turtlelog_simulate(law=SequentialP, kp=2)
    assert recording.run.parameters["law.kind"] == "sequential-p"
    assert recording.run.parameters["law.kp_linear"] == 2.0

def test_own(turtlelog_simulate):
    recording = turtlelog_simulate(law=Own)
    assert recording.run.parameters["law.kind"].endswith(":Own")
    assert recording.phase("rotate").overshoot < 5

def test_unknown_place(turtlelog_simulate):
    with pytest.raises(CheckError, match="law: expected a class or LawPart at the top"):
        turtlelog_simulate(law=replace(Own, name="nowhere"))
"""
    run(suite, body, marker='"runs/kp4.mcap"').assert_outcomes(passed=3)


def test_a_law_of_today_is_held_to_the_recorded_answers(suite: pytest.Pytester) -> None:
    body = """
from turtlelog import load_scenario
from turtlelog.laws import SequentialP, SequentialPParameters

EXACT = Tolerance(abs=1e-9)

def test_own(recording):
    assert recording.driven_by().matches(recording, tolerance=EXACT)

def test_instance(recording):
    own = {"pause_ticks": 34, "projection": "bearing", "wrap_error": False}
    law = SequentialP(SequentialPParameters(kp_angular=4.0, kp_linear=4.0, **own))
    assert recording.driven_by(law).matches(recording, tolerance=EXACT)

def test_scenario(recording):
    assert recording.driven_by(load_scenario("paper-kp10")).matches(recording, tolerance=EXACT)

def test_other(recording, simulate):
    assert recording.driven_by().matches(simulate("paper-kp4"))
"""
    result = run(suite, body, marker='"runs/kp4.mcap"')
    result.assert_outcomes(passed=2, failed=2)
    result.stdout.fnmatch_lines(
        [
            "law.wanted_turn_rate: expected as recorded",
            "*reason *recorded *, the law answers *",
            "*matches: must be the recording that is driven",
        ]
    )


def test_a_fresh_run_is_simulated_recorded_and_read_back(suite: pytest.Pytester) -> None:
    body = """
def test_it(simulate):
    assert simulate("paper", kp=4).metric("final.position_error") < 0.02
    assert simulate("paper", kp=10).metric("final.position_error") > 0.05
    changes = {"loop.queue_policy": "newest", "law.pause_ticks": 0}
    assert simulate("paper", kp=10, changes=changes).metric("final.position_error") < 0.02
"""
    result = run(suite, body, marker="")
    result.assert_outcomes(passed=1)
    result.stdout.fnmatch_lines(["turtlelog: 3 recordings, 3 checks, worst margins: *"])
