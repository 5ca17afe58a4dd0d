import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import ClassVar

import pytest

from tests.check.pytest_plugin.conftest import NAMES, run
from tests.log.ros2.robots import say_odometry, write_robot

BODY = "def test_it(recording):\n    assert recording.metric('run.duration') > 0\n"

BAD = {
    "empty glob": ('"nothing/*.mcap"', "*recordings: no files match 'nothing/[*].mcap' in *"),
    "no pattern": ("", '*recordings: needs a pattern such as "runs/[*].mcap"'),
    "no text": ("3", "*recordings: expected a pattern, found 3"),
    "keyword": (
        '"runs/*.mcap", partial=True',
        "*expected one of allow_partial, trust_law, pose_topic, *, found partial",
    ),
    "no bool": ('"runs/*.mcap", trust_law="no"', "*trust_law: expected True or False, found 'no'"),
    "no topic": ('"runs/*.mcap", pose_topic=3', "*pose_topic: expected text, found 3"),
    "no time": ('"runs/*.mcap", time="now"', "*time: expected auto, log or stamp, found 'now'"),
}


@pytest.mark.everyday("empty glob", "no bool", "no topic")
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
    suite.makeconftest(NAMES)
    (inner / "test_inner.py").write_text(
        f'import pytest\npytestmark = pytest.mark.recordings("runs/*.mcap")\n{BODY}'
    )
    suite.runpytest_inprocess("-p", "turtlelog.check.pytest_plugin").assert_outcomes(passed=2)
    (inner / "runs").mkdir()
    (suite.path / "runs" / "kp4.mcap").rename(inner / "runs" / "kp4.mcap")
    suite.runpytest_inprocess("-p", "turtlelog.check.pytest_plugin").assert_outcomes(passed=1)


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
    result.stdout.fnmatch_lines(["*the test needs @pytest.mark.recordings(*)"])


@pytest.mark.parametrize("name", ["recording", "reference", "simulate"])
def test_a_plain_name_stays_the_users(suite: pytest.Pytester, name: str) -> None:
    body = f"def test_it({name}):\n    assert {name} == 3\n"
    suite.makeconftest("")
    missing = run(suite, body, marker="")
    missing.assert_outcomes(errors=1)
    missing.stdout.fnmatch_lines([f"*fixture '{name}' not found"])
    own = f"@pytest.fixture\ndef {name}():\n    return 3\n\n"
    run(suite, own + body, marker="").assert_outcomes(passed=1)


def read_entry() -> EntryPoint:
    """Return the entry point that an installation of this tree has."""
    text = (Path(__file__).parents[3] / "pyproject.toml").read_text(encoding="utf-8")
    ((name, value),) = tomllib.loads(text)["project"]["entry-points"]["pytest11"].items()
    return EntryPoint(name=name, value=value, group="pytest11")


@pytest.mark.parametrize(
    ("words", "outcome"),
    [
        ([], {"passed": 1}),
        (["-p", "turtlelog.check.pytest_plugin"], {"passed": 1}),
        (["-p", "turtlelog"], {"passed": 1}),
        (["-p", "no:turtlelog"], {"errors": 1}),
        (["-p", "no:turtlelog.check.pytest_plugin"], {"errors": 1}),
    ],
    ids=" ".join,
)
def test_an_installed_plugin_loads_once_and_can_be_blocked(
    pytester: pytest.Pytester,
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    outcome: dict[str, int],
) -> None:
    class Installed:
        metadata: ClassVar = {"name": "turtlelog"}
        name, version = "turtlelog", "1.0"
        files: ClassVar[list[str]] = []
        entry_points: ClassVar = [read_entry()]

    monkeypatch.setattr("importlib.metadata.distributions", lambda: [Installed])
    pytester.makepyfile("def test_it(turtlelog_simulate):\n    assert turtlelog_simulate\n")
    pytester.runpytest_inprocess("-p", "no:cacheprovider", *words).assert_outcomes(**outcome)


def test_a_recording_is_read_once_and_only_when_asked(suite: pytest.Pytester) -> None:
    body = """
import turtlelog.log.any_file as place

reads = []
read_run = place.read_run

@pytest.fixture(autouse=True)
def count(monkeypatch):
    monkeypatch.setattr(place, "read_run", lambda *a, **k: reads.append(a) or read_run(*a, **k))

def test_lazy(turtlelog_recording):
    assert not reads

def test_first(turtlelog_recording):
    assert turtlelog_recording.metric("run.duration") > 0

def test_second(turtlelog_recording):
    assert turtlelog_recording.metric("run.duration") > 0
    assert len(reads) == 2
"""
    run(suite, body).assert_outcomes(passed=6)


def test_tests_without_recordings_are_left_alone(suite: pytest.Pytester) -> None:
    result = run(suite, "def test_it():\n    assert 1 < 2\n")
    result.assert_outcomes(passed=1)
    assert "turtlelog:" not in result.stdout.str()


def test_topics_and_goal_of_a_robots_bag_are_chosen_in_the_marker(suite: pytest.Pytester) -> None:
    robots = [say_odometry("/odom"), say_odometry("/odom_kf", x_m=5.0)]
    write_robot(suite.path / "runs", *robots)
    body = (
        "def test_it(recording):\n"
        "    assert recording.run.goal_xy_m == (7.0, 0.0)\n"
        "    assert recording.metric('final.position_error') <= 0.001\n"
    )
    marker = '"runs/robot.mcap", pose_topic="/odom_kf", goal=(7, 0)'
    run(suite, body, marker=marker).assert_outcomes(passed=1)
    run(suite, body, marker='"runs/robot.mcap", goal=(7, 0)').assert_outcomes(failed=1)
    named = run(suite, body, "-v", marker='"runs/rob*.mcap:/odom_kf", goal=(7, 0)')
    named.assert_outcomes(passed=1)
    named.stdout.fnmatch_lines(["*[[]robot-odom_kf[]] PASSED*"])
