"""Bags of a robot in the command that checks, and what is said around a violation."""

import math
from dataclasses import replace
from pathlib import Path

import pytest

import turtlelog as tl
from tests.cli.conftest import Call
from tests.cli.step_robots import write_robot
from turtlelog.check.failure_report import describe_failure
from turtlelog.check.spec import Check


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_robot(tmp_path_factory.mktemp("robot") / "robot.mcap")


@pytest.fixture(scope="module")
def silent(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_robot(tmp_path_factory.mktemp("silent") / "silent.mcap", commands=False)


@pytest.mark.parametrize(("bound", "code"), [(0.19, 1), (0.21, 0)])
def test_the_commands_of_a_bag_are_checked(
    call: Call, robot: Path, bound: float, code: int
) -> None:
    answer = call("check", robot, "--expect", f"always(abs(speed) <= {bound})", "--json")
    assert answer.code == code
    (result,) = answer.json["results"]
    assert (result["value"], result["decided"]) == (0.2, True)
    assert result["first_violation_s"] == (1.0 if code else None)


def test_without_commands_a_check_of_them_is_undecided_and_says_why(
    call: Call, silent: Path
) -> None:
    answer = call("check", silent, "--expect", "always(abs(speed) <= 1.5)", "--json")
    (result,) = answer.json["results"]
    assert (answer.code, result["verdict"], result["decided"]) == (1, "FAIL", False)
    assert result["reason"] == "no value: speed (the recording holds no commands)"


def test_what_names_more_than_commands_is_judged_from_the_first_one(
    call: Call, robot: Path
) -> None:
    answer = call("check", robot, "--expect", "always(x < 1 and abs(speed) <= 0.3)", "--json")
    (result,) = answer.json["results"]
    assert (answer.code, result["verdict"]) == (0, "PASS")
    assert result["reason"] == "judged from the first command on, at 0.500 s"


def test_several_formulas_are_checked_without_a_file(call: Call, robot: Path) -> None:
    formulas = ("--expect", "run.path_length <= 0.1", "--expect", "always(x < 1)")
    answer = call("check", robot, *formulas, "--all")
    assert answer.code == 1
    assert "PASS  always(x < 1)" in answer.out
    assert "FAIL  run.path_length <= 0.1" in answer.out


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--expect", "always(speed <"], "--expect: column 15: expected a number or name"),
        (
            ["--expect", "x < 1", "--reference", "x.mcap"],
            "--reference: leave it out beside --expect, which has no tolerances",
        ),
    ],
)
def test_a_formula_that_cannot_be_judged_is_refused(
    call: Call, robot: Path, words: list[str], line: str
) -> None:
    answer = call("check", robot, *words)
    assert (answer.code, answer.out) == (2, "")
    assert line in answer.err


def test_a_first_specification_of_a_bag_holds_bounds_that_it_passes(
    call: Call, robot: Path, tmp_path: Path
) -> None:
    spec = tmp_path / "spec.toml"
    assert call("check", "--init", robot, "-o", spec).code == 0
    text = spec.read_text(encoding="utf-8")
    assert "no value here" not in text
    assert 'holds = "always(abs(speed) <= 0.22)"' in text
    assert "run.speed_lag <= " in text
    assert call("check", spec, robot).code == 0
    faster = write_robot(tmp_path / "faster.mcap", gain=1.5)
    answer = call("check", spec, faster, "--json")
    failed = {one["check"] for one in answer.json["results"] if one["verdict"] == "FAIL"}
    assert {"run.path_length", "run.measured_speed_max"} <= failed
    assert "speed" not in failed


def test_a_first_specification_reads_later_runs_as_the_good_one_was_read(
    call: Call, robot: Path, tmp_path: Path
) -> None:
    spec = tmp_path / "spec.toml"
    chosen = ("--command-topic", "/cmd_vel", "--goal", "1,0,90", "--time", "log")
    assert call("check", "--init", f"{robot}:/odom", *chosen, "-o", spec).code == 0
    read = tl.load_spec(spec).read
    assert (read.pose_topic, read.command_topic, read.time) == ("/odom", "/cmd_vel", "log")
    assert read.goal == pytest.approx((1.0, 0.0, math.pi / 2.0))
    reference = tl.load_spec(spec).reference
    assert reference is not None
    assert reference.resolve() == robot.resolve()
    answer = call("check", spec, robot)
    assert (answer.code, "final.position_error" in answer.out) == (0, True)


def test_a_robot_that_is_no_turtlesim_is_sent_to_what_can_tell_of_it(
    call: Call, robot: Path
) -> None:
    for mode in (["--plant"], ["--law"], []):
        answer = call("replay", robot, *mode)
        assert answer.code == 2
        assert answer.err.splitlines()[-1].endswith(
            "; for another robot use turtlelog metrics and turtlelog identify"
        )
        assert "--plant" not in answer.err


@pytest.mark.parametrize(
    "formula",
    ["always(abs(speed) <= 0.1)", "run.path_length <= 0.1", "run.measured_speed_max <= 0.1"],
)
def test_around_a_violation_a_bag_shows_values(robot: Path, formula: str) -> None:
    recording = tl.check.Recording(robot)
    lines = recording.describe(*recording.holds(formula).results)
    (first,) = (row for row, line in enumerate(lines) if "first violated" in line)
    table = [line.split() for line in lines[first + 1 :] if line.startswith("    ")]
    assert len(table) >= 6
    assert not any("-" in cells for cells in table)
    assert any("(the recording's clock, from the first pose)" in line for line in lines)


def test_a_command_between_two_poses_has_its_own_line(robot: Path) -> None:
    run = tl.read_run(robot)
    moved = replace(run.commands, time_ns=run.commands.time_ns + 10_000_000)
    run = replace(run, commands=moved)
    formula = tl.expressions.parse_expression("always(abs(speed) <= 0.1)")
    spec = tl.Spec(checks=(Check(name="speed", kind="holds", formula=formula),))
    (result,) = tl.check.check_runs(spec, [("robot", run)])
    lines = describe_failure(run, result)
    (marked,) = (line for line in lines if line.lstrip().startswith(">"))
    assert marked.split() == [">", "1.010", "0.2"]
