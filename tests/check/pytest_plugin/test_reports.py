import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np
import pytest
from matplotlib.image import imread

import turtlelog as tl
from tests.check.artifact_files import read_mark
from tests.check.pytest_plugin.conftest import NAMES, run
from tests.sequential import METRICS

ROOT = Path(__file__).parents[3]
BODY = """
def test_it(recording):
    assert recording.phase("rotate").overshoot <= 0.5
    assert recording.metric("final.position_error") < 0.02
"""


def test_a_recording_that_cannot_be_read_counts_as_a_failed_check(suite: pytest.Pytester) -> None:
    cut = suite.path / "runs" / "cut.mcap"
    cut.write_bytes((suite.path / "runs" / "kp4.mcap").read_bytes()[:20_000])
    body = "def test_it(recording):\n    assert recording.holds('speed <= 1.0')\n"
    found = run(suite, body)
    found.assert_outcomes(passed=2, failed=1)
    found.stdout.fnmatch_lines(["runs/cut.mcap: truncated*"])
    found.stdout.fnmatch_lines(["turtlelog: 3 recordings, 3 checks (1 failed), worst margins: *"])


def test_a_path_beside_the_tests_is_shown_without_detours(suite: pytest.Pytester) -> None:
    (suite.mkdir("tests") / "conftest.py").write_text(NAMES)
    body = "def test_it(recording):\n    assert recording.holds('speed <= 0.5')\n"
    mark = 'pytestmark = pytest.mark.recordings("../runs/*.mcap")\n'
    (suite.path / "tests" / "test_it.py").write_text(f"import pytest\n{mark}{body}")
    plugin = ("-p", "turtlelog.check.pytest_plugin", "-p", "no:cacheprovider")
    text = suite.runpytest_inprocess(*plugin, "tests").stdout.str()
    assert "(runs/kp10.mcap)" in text
    assert "tests/../runs" not in text


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


@pytest.mark.thorough
def test_artifacts_show_the_violation(suite: pytest.Pytester) -> None:
    """Rerun's viewer starts and draws what failed."""
    result = run(suite, BODY, "--turtlelog-artifacts=failed")
    folder = suite.path / "failed"
    result.stdout.fnmatch_lines([f"wrote {folder}/test_it-kp10-rotate.overshoot-*.rrd"])
    files = {path.suffix: path for path in folder.iterdir()}
    mark = read_mark(files[".rrd"])
    assert (mark.cursor_s, mark.label) == ((2.288, 2.288), "rotate.overshoot")
    assert "first violated  2.288 s" in mark.message
    cut, whole = tl.read_recording(files[".mcap"]), tl.read_recording(suite.path / "runs/kp10.mcap")
    around = np.abs((whole.poses.time_ns - whole.start_ns) / 1e9 - 2.288) <= 1.0
    np.testing.assert_array_equal(cut.poses.heading_rad, whole.poses.heading_rad[around])
    if "no picture" in result.stdout.str():
        result.stdout.fnmatch_lines(["*no picture: viewer: expected a graphics adapter*"])
    else:
        assert imread(files[".png"]).std() > 0.05


def test_artifacts_that_cannot_be_written_are_told(suite: pytest.Pytester) -> None:
    (suite.path / "failed").write_text("a file")
    result = run(suite, BODY, "--turtlelog-artifacts=failed")
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(["artifacts: *failed: expected a folder to write to*"])


ACCEPT = """
@pytest.mark.reference("all.json")
def test_accept(recording, reference):
    assert recording.matches(reference)
"""


@pytest.mark.thorough
def test_workers_tell_the_same_and_do_not_write_over_each_other(
    suite: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two workers start and load the program."""
    suite.makeconftest(NAMES)
    head = 'import pytest\npytestmark = pytest.mark.recordings("../runs/*")\n'
    for part in ("a", "b"):
        (suite.mkdir(part) / f"test_{part}.py").write_text(head + BODY)
    (suite.path / "a" / "test_c.py").write_text(head + ACCEPT)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    for variable in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES"):
        monkeypatch.setenv(variable, "/none")
    # Each worker would load Hypothesis, which the suite does not use.
    words = ("-n", "2", "-p", "turtlelog.check.pytest_plugin", "-p", "no:hypothesispytest")
    told = ("--junitxml=report.xml", "--turtlelog-artifacts=failed")
    result = suite.runpytest_inprocess(*words, *told, "--turtlelog-accept")
    result.assert_outcomes(passed=3, failed=3)
    result.stdout.fnmatch_lines(
        [
            "rotate.overshoot: expected <= 0.5 %",
            "  first violated  2.288 s (simulated time, from the first sample)",
            "*no picture: viewer: expected a graphics adapter*",
            "turtlelog: 2 recordings, 6 checks (2 failed), worst margins: -0.50756 %*,"
            " accepted *all.json",
        ]
    )
    result.stdout.fnmatch_lines(["*expected one recording to accept, found *{stem}*"])
    assert len(list((suite.path / "failed").glob("test_it-kp10-rotate.overshoot-*.rrd"))) == 2
    cases = Xml.parse(suite.path / "report.xml").getroot().findall("testsuite/testcase")
    counts = [len(case.findall("properties/property")) for case in cases]
    assert counts == [1 + len(METRICS)] * 6


IMPORT = """
import sys, time, pytest
before, start = set(sys.modules), time.process_time()
import turtlelog.check.pytest_plugin
print(time.process_time() - start)
print(*sorted(name.partition(".")[0] for name in set(sys.modules) - before))
"""


@pytest.mark.thorough
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
