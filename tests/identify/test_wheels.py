"""Robots whose wheels limit both axes together: what is found of them, noted and advised."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import turtlelog as tl
from tests.identify.limited_robots import Limited
from tests.identify.robots import Log, make_run
from tests.identify.wheel_robots import Wheeled, drive_wheels
from tests.known import known
from turtlelog.cli.identify import format_robot
from turtlelog.identify import build_robot_scenario, predict_axis, read_robot_notes
from turtlelog.identify.robot_noise import find_outlying_steps
from turtlelog.run import Run

LOG = Log(duration_s=25.0, poses_hz=25.0)
TRUTH = Wheeled(wheel=Limited(gain=0.95), turn_gain=0.9, track_m=0.3, most=0.35)


@cache
def identify(coupling: str, most: float = TRUTH.most) -> tuple[Wheeled, Run, tl.RobotModel]:
    truth = replace(TRUTH, coupling=coupling, most=most)
    run = drive_wheels(truth, LOG, 2)
    return truth, run, tl.identify_robot(run)


@pytest.mark.parametrize(
    ("coupling", "kept"),
    [
        ("scaled", (0.3 * 0.7, 4.0 / 3.0 * 0.7)),
        ("clipped", (0.5 * (0.1 + 0.35), (0.35 - 0.1) / 0.3)),
        ("turning", (0.35 - 0.2, 4.0 / 3.0)),
        ("driving", (0.3, (0.35 - 0.3) / 0.15)),
    ],
)
def test_the_robots_reduce_a_command_as_they_should(
    coupling: str, kept: tuple[float, float]
) -> None:
    """Its wheels are asked for 0.1 and 0.5 m/s, and can do 0.35."""
    truth = replace(TRUTH, coupling=coupling)
    assert truth.ask(0.3, 4.0 / 3.0) == pytest.approx(kept)


@pytest.mark.everyday("scaled")
@pytest.mark.parametrize("coupling", ["scaled", "clipped", "turning", "driving"])
def test_the_limit_of_the_wheels_is_found_with_gain_and_delays(coupling: str) -> None:
    """Each robot is identified once, by the first of these tests that asks for it."""
    # Turns of up to 1.88 rad/s reach a bound of their own from wheels of 0.25 m/s alone.
    truth, _, model = identify(coupling, 0.25 if coupling == "turning" else TRUTH.most)
    acts = {"scaled": ("scaled",) * 2, "clipped": ("clipped",) * 2}
    first = {"turning": ("yielding", "command"), "driving": ("command", "yielding")}
    assert tuple(axis.bound_acts for axis in model.axes) == (acts | first)[coupling]
    for axis in model.axes:
        true = truth.list_truth(axis)
        for name in ("gain", "bound"):
            found = known(getattr(axis, name))
            assert found.low < true[name] < found.high
            assert found.value == pytest.approx(true[name], rel=0.01)
        assert known(axis.total_delay_s).value == pytest.approx(0.17, abs=3e-3)
        is_alone = axis.bound_acts == "command"
        assert is_alone is (axis.bound_beside is None)
        if axis.bound_beside is not None:
            assert axis.bound_beside.low < true["bound_beside"] < axis.bound_beside.high
            assert axis.bound_beside.value == pytest.approx(true["bound_beside"], rel=0.01)
        assert axis.doubts == ()


def test_a_bound_that_no_command_reaches_is_not_found() -> None:
    """A robot with two wheels is simulated and identified: turns of 1.88 rad/s, a bound at 2.33."""
    model = identify("turning")[2]
    assert model.turn_rate.bound_acts == ""


def test_wheels_that_no_command_brings_to_their_limit_have_none() -> None:
    model = tl.identify_robot(drive_wheels(replace(TRUTH, most=np.inf), LOG, 2))
    assert [axis.bound_acts for axis in model.axes] == ["", ""]


def test_the_model_predicts_the_turns_beside_a_speed() -> None:
    _, run, model = identify("scaled")
    way, _ = predict_axis(model.turn_rate, run, run.poses.time_ns / 1e9)
    off = np.unwrap(run.poses.heading_rad) - way
    assert float(np.std(off)) < 0.01  # of turns by 10 rad


def test_the_answer_and_the_scenario_name_the_limit_of_the_wheels() -> None:
    _, run, model = identify("scaled")
    said = " ".join(format_robot(model, [Path("robot.mcap")]).split())
    assert "The wheels limit both axes together: the turn rate settles at 2.1 rad/s" in said
    assert "a command beyond is reduced on both axes alike" in said
    notes = read_robot_notes(build_robot_scenario(model, run).text)
    assert any("The plant has no such limit" in note for note in notes)


def drive_and_turn(kept: float, alone: float) -> Run:
    """Return a robot that turns at 1 rad/s, a share of it while it drives."""
    time_s = np.arange(0.5, 29.5, 0.05)
    held = (time_s / 0.8).astype(int)
    turns = np.array([1.0, -1.0, 0.0, -1.0, 1.0, 1.0, 0.0])[held % 7]
    rests = np.linspace(0.0, 1.0, len(time_s)) < alone
    speeds = np.where(rests, 0.0, 0.3)
    obeyed = turns * np.where(speeds == 0.3, kept, 1.0)
    log = replace(LOG, duration_s=30.0)
    run = make_run(log, 4, speed=(time_s, speeds), turn=(time_s, obeyed))
    return replace(run, commands=replace(run.commands, turn_rate_rad_s=turns))


@pytest.mark.parametrize(("kept", "acts"), [(1.0, ""), (0.95, "reduced"), (0.5, "reduced")])
def test_commands_of_one_size_show_by_how_much_the_other_axis_reduces_them(
    kept: float, acts: str
) -> None:
    found = tl.identify_robot(drive_and_turn(kept, 0.5)).turn_rate
    assert found.bound_acts == acts
    assert known(found.gain).value == pytest.approx(1.0, abs=5e-3)
    assert found.bound is None
    if acts:
        assert known(found.bound_beside).value == pytest.approx(0.3 * kept, rel=0.01)


@pytest.mark.parametrize(("alone", "is_told"), [(0.034, True), (0.038, False)])
def test_a_turn_rate_beside_one_speed_only_leaves_its_gain_without_open(
    alone: float, *, is_told: bool
) -> None:
    model = tl.identify_robot(drive_and_turn(1.0, alone))
    noted = " ".join(model.notes)
    assert ("come together with a speed of 0.3 m/s" in noted) is is_told


@pytest.mark.parametrize(("count", "are_outliers"), [(5, True), (6, False)])
def test_steps_that_are_off_for_long_are_a_motion_and_no_jump(
    count: int, *, are_outliers: bool
) -> None:
    residual = np.random.default_rng(1).normal(0.0, 1e-3, 200)
    residual[50 : 50 + count] = 0.05
    assert bool(find_outlying_steps(residual)[50 : 50 + count].all()) is are_outliers
    residual[50 : 50 + count : 2] *= -1.0
    assert find_outlying_steps(residual)[50 : 50 + count].all()
