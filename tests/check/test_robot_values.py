"""Values of an identified robot in checks."""

import pytest

import turtlelog as tl
from turtlelog.check.spec import ROBOT_VALUES, build_spec, measure_robot


@pytest.fixture(scope="module")
def robot() -> tl.Run:
    return tl.simulate_run(tl.load_scenario("lagged"))


def test_values_are_those_that_identify_finds(robot: tl.Run) -> None:
    model = tl.identify_robot(robot)
    found = measure_robot(robot, ["robot.speed.dead_time.high", "robot.turn_rate.gain"])
    assert model.speed.dead_time_s is not None
    assert model.turn_rate.gain is not None
    assert [metric.value for metric in found.values()] == [
        model.speed.dead_time_s.high,
        model.turn_rate.gain.value,
    ]
    assert [metric.unit for metric in found.values()] == ["s", "1"]


@pytest.mark.parametrize(
    ("formula", "verdict"),
    [
        ("robot.speed.dead_time.high < 0.15", "PASS"),
        ("robot.speed.dead_time.low > 0.15", "FAIL"),
        ("robot.turn_rate.gain > 0.9 and rotate.overshoot < 50", "PASS"),
    ],
)
def test_a_robot_is_held_to_bounds_of_its_interval(
    robot: tl.Run, formula: str, verdict: str
) -> None:
    (result,) = tl.check_runs(build_spec([formula]), [("robot", robot)])
    assert (result.verdict, result.is_decided) == (verdict, True)


def test_what_is_not_identified_is_undecided(robot: tl.Run) -> None:
    still = tl.run.slice_run(robot, end_ns=int(robot.poses.time_ns[5]))
    (result,) = tl.check_runs(build_spec(["robot.speed.gain > 0"]), [("robot", still)])
    assert (result.verdict, result.is_decided) == ("FAIL", False)
    assert "robot.speed.gain: undetermined (" in result.reason


def test_a_value_that_is_misspelled_is_named_with_the_nearest() -> None:
    with pytest.raises(tl.errors.ExpressionError, match=r"did you mean robot\.speed\.dead_time"):
        build_spec(["robot.speed.deadtime < 1"])
    assert "robot.speed.dead_time" in ROBOT_VALUES
