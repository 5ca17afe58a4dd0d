from pathlib import Path

import pytest

import turtlelog as tl
from tests.check.pytest_plugin.conftest import run
from tests.cli.test_commands_alone import say_twist
from tests.identify.robots import Log, Truth, make_run, write_bag
from tests.log.ros2.bags import write_mcap
from turtlelog.check import Recording
from turtlelog.errors import MissingValueError

LOG = Log(turn_rate=Truth(dead_time_s=0.2, lag_s=0.1), duration_s=15.0, poses_hz=20.0)


@pytest.fixture
def robots(suite: pytest.Pytester) -> pytest.Pytester:
    write_bag(make_run(LOG, 6), suite.path / "runs" / "robot.mcap")
    return suite


def test_a_robot_is_asked_for_its_dead_time(robots: pytest.Pytester) -> None:
    body = (
        "def test_quick(recording):\n    assert recording.robot().turn_rate.dead_time_s < 0.25\n"
        "def test_slow(recording):\n    assert recording.robot().turn_rate.dead_time_s < 0.15\n"
    )
    result = run(robots, body, marker='"runs/robot.mcap"')
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(["*assert <0.[12]* s, 0.1* to 0.2*> < 0.15*"])


def test_what_the_recording_does_not_tell_is_no_value(tmp_path: Path) -> None:
    scenario = tl.override_scenario(
        tl.load_scenario("lagged"), {"law.kind": "open-loop"}, source=""
    )
    turning = tl.override_scenario(scenario, {"law.signal": "prbs"}, source="")
    path = tmp_path / "turns.mcap"
    tl.write_recording(tl.simulate_run(turning), path)
    robot = Recording(path).robot()
    assert robot.turn_rate.gain > 0.99
    assert robot.turn_rate.lag_s > 0.09
    assert robot.turn_rate.total_delay_s < 0.19
    with pytest.raises(MissingValueError, match=r"speed\.lag_s: has no value: the"):
        _ = robot.speed.lag_s


@pytest.mark.parametrize("axis", ["", "turn_rate"])
def test_a_robot_alone_is_no_verdict(axis: str, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    tl.write_recording(tl.simulate_run(tl.load_scenario("textbook")), path)
    robot = Recording(path).robot()
    told = "assert one of its values" if axis else "assert a value of one of its axes"
    with pytest.raises(tl.errors.CheckError, match=told):
        assert getattr(robot, axis) if axis else robot


def test_a_bag_of_commands_alone_is_checked(suite: pytest.Pytester) -> None:
    said = [say_twist(0.2 if row < 100 else 0.1, row=row) for row in range(201)]
    (suite.path / "runs").mkdir(exist_ok=True)
    write_mcap(suite.path / "runs" / "drive.mcap", said)
    body = (
        "def test_slow(recording):\n    assert recording.holds('always(abs(speed) <= 0.2)')\n"
        "def test_slower(recording):\n    assert recording.holds('always(abs(speed) <= 0.15)')\n"
        "def test_effort(recording):\n    assert recording.metric('run.speed_effort') < 0.3\n"
        "def test_way(recording):\n    assert recording.metric('run.path_length') < 5\n"
        "def test_gain(recording):\n    assert recording.robot().speed.gain < 1\n"
        "def test_same(recording):\n    assert recording.matches(recording)\n"
    )
    result = run(suite, body, marker='"runs/drive.mcap"')
    result.assert_outcomes(passed=2, failed=4)
    result.stdout.fnmatch_lines_random(
        [
            "*always(abs(speed) <= 0.15)*",
            "*run.path_length: *no value: absent (the recording holds no poses)*",
            "*IdentifyError: drive: the recording holds no poses, only commands*",
            "*CompareError: drive: the recording holds no poses, which are compared*",
        ]
    )
