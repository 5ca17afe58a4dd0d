import pytest

from tests.pytest_plugin.conftest import run

BODY = "def test_it(recording):\n    assert recording.metric('run.duration') > 0\n"

BAD = {
    "empty glob": ('"nothing/*.mcap"', "*recordings: expected files for 'nothing/[*].mcap' in *"),
    "no pattern": ("", '*recordings: expected a pattern such as "runs/[*].mcap", found none'),
    "no text": ("3", "*recordings: expected a pattern, found 3"),
    "keyword": (
        '"runs/*.mcap", partial=True',
        "*expected allow_partial or trust_law, found partial",
    ),
    "no bool": ('"runs/*.mcap", trust_law="no"', "*trust_law: expected True or False, found 'no'"),
}


@pytest.mark.parametrize(("marker", "message"), BAD.values(), ids=BAD)
def test_a_wrong_marker_is_an_error_at_collection(
    suite: pytest.Pytester, marker: str, message: str
) -> None:
    marker = marker or "*()"
    result = run(suite, BODY, marker=marker)
    assert result.ret == pytest.ExitCode.INTERRUPTED
    result.stdout.fnmatch_lines(["*ERROR collecting*", message, "*1 error*"])
    assert "Traceback" not in result.stdout.str()


def test_patterns_are_looked_for_beside_the_test_and_then_below_the_root(
    suite: pytest.Pytester,
) -> None:
    inner = suite.mkdir("inner")
    (inner / "test_inner.py").write_text(
        f'import pytest\npytestmark = pytest.mark.recordings("runs/*.mcap")\n{BODY}'
    )
    suite.runpytest_inprocess("-p", "turtlelog.pytest_plugin").assert_outcomes(passed=2)
    (inner / "runs").mkdir()
    (suite.path / "runs" / "kp4.mcap").rename(inner / "runs" / "kp4.mcap")
    suite.runpytest_inprocess("-p", "turtlelog.pytest_plugin").assert_outcomes(passed=1)


def test_a_name_with_signs_of_patterns_is_itself(suite: pytest.Pytester) -> None:
    (suite.path / "runs" / "kp4.mcap").rename(suite.path / "runs" / "kp[4].mcap")
    run(suite, BODY, marker='"runs/kp[4].mcap"').assert_outcomes(passed=1)


def test_files_of_one_name_are_told_apart(suite: pytest.Pytester) -> None:
    (suite.mkdir("other") / "kp4.mcap").write_bytes((suite.path / "runs/kp4.mcap").read_bytes())
    result = run(suite, BODY, "-v", marker='"*/kp4.mcap"')
    result.stdout.fnmatch_lines(["*[[]other/kp4.mcap[]] PASSED*", "*[[]runs/kp4.mcap[]] PASSED*"])


def test_a_test_without_the_marker_says_what_it_lacks(suite: pytest.Pytester) -> None:
    result = run(suite, BODY, marker="")
    result.assert_outcomes(errors=1)
    result.stdout.fnmatch_lines(["*expected @pytest.mark.recordings(*), found none"])


def test_a_fixture_of_the_same_name_stays_the_users(suite: pytest.Pytester) -> None:
    body = "@pytest.fixture\ndef recording():\n    return 3\n\ndef test_it(recording):\n"
    run(suite, f"{body}    assert recording == 3\n", marker="").assert_outcomes(passed=1)


def test_a_recording_is_read_once_and_only_when_asked(suite: pytest.Pytester) -> None:
    body = """
import turtlelog.log.any_file as place

reads = []
read_run = place.read_run

@pytest.fixture(autouse=True)
def count(monkeypatch):
    monkeypatch.setattr(place, "read_run", lambda *a, **k: reads.append(a) or read_run(*a, **k))

def test_lazy(recording):
    assert not reads

def test_first(recording):
    assert recording.metric("run.duration") > 0

def test_second(recording):
    assert recording.metric("run.duration") > 0
    assert len(reads) == 2
"""
    run(suite, body).assert_outcomes(passed=6)


def test_tests_without_recordings_are_left_alone(suite: pytest.Pytester) -> None:
    result = run(suite, "def test_it():\n    assert 1 < 2\n")
    result.assert_outcomes(passed=1)
    assert "turtlelog:" not in result.stdout.str()
