import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as Xml

import pytest

import turtlelog as tl
from tests.pytest_plugin.conftest import run

ROOT = Path(__file__).parents[2]
BODY = """
def test_it(recording):
    assert recording.phase("rotate").overshoot <= 0.5
    assert recording.metric("final.position_error") < 0.02
"""


def test_one_line_at_the_end_has_recordings_checks_and_worst_margins(
    suite: pytest.Pytester,
) -> None:
    run(suite, BODY).stdout.fnmatch_lines(
        [
            "turtlelog: 2 recordings, 3 checks (1 failed), worst margins: -0.50756 %"
            " rotate.overshoot (runs/kp10.mcap); 0.01148 m final.position_error (runs/kp4.mcap)"
        ]
    )


def test_junit_has_every_metric_as_a_property(suite: pytest.Pytester) -> None:
    run(suite, BODY, "--junitxml=report.xml")
    cases = Xml.parse(suite.path / "report.xml").getroot().findall("testsuite/testcase")
    assert len(cases) == 2
    for case, name in zip(cases, ("kp10", "kp4"), strict=True):
        found = {p.get("name"): p.get("value") for p in case.findall("properties/property")}
        metrics = tl.measure_run(tl.read_run(suite.path / "runs" / f"{name}.mcap"))
        assert len(found) == 1 + len(metrics)
        assert found["rotate.overshoot [%]"] == repr(metrics["rotate.overshoot"].value)
        assert found["recording"] == f"runs/{name}.mcap"
    failure = cases[0].find("failure")
    assert failure is not None
    assert "first violated  2.288 s" in (failure.text or "")


def test_artifacts_stand_in_the_folder_that_is_asked_for(suite: pytest.Pytester) -> None:
    result = run(suite, BODY, "--turtlelog-artifacts=failed")
    folder = suite.path / "failed"
    result.stdout.fnmatch_lines([f"wrote {folder}/test_it-kp10-*rotate.overshoot-*.rrd"])
    suffixes = sorted(path.suffix for path in folder.iterdir())
    assert suffixes in ([".mcap", ".png", ".rrd"], [".mcap", ".rrd"])
    assert (".png" in suffixes) == ("no picture" not in result.stdout.str())


def test_artifacts_that_cannot_be_written_are_told(suite: pytest.Pytester) -> None:
    (suite.path / "failed").write_text("a file")
    result = run(suite, BODY, "--turtlelog-artifacts=failed")
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(["artifacts: *failed: expected a folder to write to*"])


def test_workers_tell_the_same(suite: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    suite.makepyfile(f'import pytest\npytestmark = pytest.mark.recordings("runs/*")\n{BODY}')
    words = ("-n", "2", "-p", "turtlelog.pytest_plugin", "--junitxml=report.xml")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    result = suite.runpytest_subprocess(*words)
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(
        [
            "rotate.overshoot: expected <= 0.5 %",
            "  first violated  2.288 s (simulated time, from the first sample)",
            "turtlelog: 2 recordings, 3 checks (1 failed), worst margins: -0.50756 %*",
        ]
    )
    cases = Xml.parse(suite.path / "report.xml").getroot().findall("testsuite/testcase")
    counts = [len(case.findall("properties/property")) for case in cases]
    assert counts == [1 + len(tl.METRICS)] * 2


IMPORT = """
import sys, time, pytest
before, start = set(sys.modules), time.process_time()
import turtlelog.pytest_plugin
print(time.process_time() - start)
print(*sorted(name.partition(".")[0] for name in set(sys.modules) - before))
"""


def test_the_plugin_costs_little_and_imports_neither_numpy_nor_rerun() -> None:
    spent_s = []
    for _ in range(5):
        done = subprocess.run(
            [sys.executable, "-c", IMPORT], cwd=ROOT, capture_output=True, text=True, check=True
        )
        spent, names = done.stdout.splitlines()
        assert not {"numpy", "rerun", "msgspec", "matplotlib", "scipy"} & set(names.split())
        spent_s.append(float(spent))
    assert min(spent_s) < 0.020
