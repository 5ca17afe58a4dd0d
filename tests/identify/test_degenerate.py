"""Logs that hardly tell anything: each gets an answer or one sentence, never a traceback."""

from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray

import turtlelog as tl
from tests.identify.robots import Log, Truth, Values, build_run, make_run
from tests.known import known
from tests.log.runs import find_shared
from turtlelog.cli.identify import format_robot
from turtlelog.compare import compare_robot
from turtlelog.errors import TurtlelogError
from turtlelog.identify import build_robot_scenario
from turtlelog.identify.axis_fit import _estimate_covariance
from turtlelog.identify.axis_motion import MEMORY_S
from turtlelog.identify.robot_noise import fit_noise
from turtlelog.identify.silent_stops import find_silent_stops

find_stops = partial(find_silent_stops, memory_s=MEMORY_S)

SIZES = st.sampled_from([0.0, 1e-300, 1e-9, 0.5, 1.0, 1e8, 1e150])


def hold_still(held: float, noise_m: float = 0.0) -> tl.Run:
    """Return a robot that stands while one command is held for 12 s, after one of 0."""
    time_s = np.arange(0.0, 13.0, 0.1)
    x_m = np.random.default_rng(3).normal(0.0, noise_m, len(time_s))
    places = np.column_stack([x_m, np.zeros(len(time_s))])
    commands = np.array([0.5, 1.0]), np.array([0.0, held]), np.zeros(2)
    return build_run(time_s, places, np.zeros(len(time_s)), commands)


def test_a_robot_that_stands_while_a_command_is_held_follows_nothing() -> None:
    model = tl.identify_robot(hold_still(0.3))
    assert model.speed.reason == "no motion follows the commands"
    assert not any("stops by itself" in note for note in model.notes)


@pytest.mark.parametrize("hz", [20.0, 100.0])
def test_noise_of_a_robot_that_stands_is_no_stop(hz: float) -> None:
    time_s, stops = np.arange(0.0, 12.0, 1.0 / hz), 0
    for seed in range(100):
        wander_m = np.diff(np.random.default_rng(seed).normal(0.0, 2e-3, len(time_s)))
        stops += len(find_stops(np.zeros(1), np.array([0.3]), time_s, wander_m))
    assert stops == 0


@pytest.mark.parametrize(("went", "stops"), [(0.09, 0), (0.11, 1)])
def test_a_robot_that_hardly_moved_in_a_silence_did_not_stop_in_it(went: float, stops: int) -> None:
    # 0.1 of the command's way in a second: a quarter of it, for the shortest silence of 0.4 s.
    time_s = np.arange(0.0, 3.0, 0.01)
    moved = np.where(time_s[:-1] < 0.5, went / 50.0, 0.0)
    assert len(find_stops(np.zeros(1), np.ones(1), time_s, moved)) == stops


@pytest.mark.parametrize(("ratio", "stops"), [(2.7, 0), (3.3, 1)])
def test_a_stop_stands_out_of_how_far_the_poses_wander(ratio: float, stops: int) -> None:
    time_s = np.arange(0.0, 3.0, 0.01)
    way_m = np.minimum(time_s, 0.5) * 0.02 * ratio / 0.5
    way_m[-31::2] -= 0.02  # down and up, back at the end of what is looked at
    found = find_stops(np.zeros(1), np.array([0.01]), time_s, np.diff(way_m))
    assert len(found) == stops


def test_a_real_neato_that_stands_at_a_wall_is_identified() -> None:
    model = tl.identify_robot(tl.read_run(find_shared("robots", "neato_wall")))
    assert [axis.status for axis in model.axes] == ["ok", "ok"]


def test_a_robot_without_any_noise_or_motion_is_told_in_a_sentence() -> None:
    exact = make_run(Log(speed=Truth(gain=0.0), duration_s=8.0, noise_m=0.0, noise_rad=0.0), 1)
    model = tl.identify_robot(exact)
    assert model.speed.reason == "no motion follows the commands"
    assert model.turn_rate.is_known


def test_a_robot_that_drives_back_amid_noise_is_not_said_to_stand() -> None:
    time_s = np.arange(0.0, 13.0, 0.1)
    x_m = -0.3 * np.maximum(time_s - 1.1, 0.0)
    x_m += np.random.default_rng(1).normal(0.0, 0.2, len(time_s))
    places = np.column_stack([x_m, np.zeros(len(time_s))])
    commands = np.array([0.5, 1.0]), np.array([0.0, 0.3]), np.zeros(2)
    model = tl.identify_robot(build_run(time_s, places, np.zeros(len(time_s)), commands))
    assert model.speed.reason == "no motion follows the commands in their direction"


@pytest.mark.parametrize(("size", "is_told"), [(9e8, False), (1.1e9, True)])
def test_commands_that_no_robot_follows_are_told(size: float, *, is_told: bool) -> None:
    run = make_run(Log(duration_s=8.0), 1)
    commands = replace(run.commands, speed_m_s=run.commands.speed_m_s / 0.5 * size)
    largest = np.abs(commands.speed_m_s).max()
    commands = replace(commands, speed_m_s=commands.speed_m_s * (size / largest))
    reason = tl.identify_robot(replace(run, commands=commands)).speed.reason
    assert ("more than any robot does" in reason) is is_told


@st.composite
def draw_columns(draw: st.DrawFn) -> tuple[Values, Values, NDArray[np.bool_]]:
    """Return times of poses, times of commands, and which pose is the first to move."""
    count = draw(st.sampled_from([1, 2, 3, 55, 120]))
    apart_s: float = draw(st.sampled_from([0.01, 0.05, 0.3, 1.5]))
    time_s = np.arange(float(count)) * apart_s
    time_s[1:] += draw(st.sampled_from([0.0, 1e-4, 3.0]))
    least, most = draw(st.sampled_from([(0.0, 1.0), (-0.9, -0.1), (1.1, 2.0), (0.3, 0.3)]))
    shares = st.lists(st.floats(least, most), max_size=12)
    command_s = np.asarray(5.0 + time_s[-1] * np.array(sorted(draw(shares)), dtype=float))
    return time_s + 5.0, command_s, np.arange(count) >= draw(st.integers(0, count))


@st.composite
def draw_run(draw: st.DrawFn) -> tl.Run:
    time_s, command_s, moves = draw(draw_columns())
    rng = np.random.default_rng(draw(st.integers(0, 9)))
    signs = np.ones(len(command_s)), rng.choice([-1.0, 0.0, 1.0], len(command_s))
    speed, turns = (draw(SIZES) * signs[draw(st.integers(0, 1))] for _ in range(2))
    steps = np.ones(len(moves)), rng.normal(size=len(moves))
    way = np.cumsum(moves * steps[draw(st.integers(0, 1))])
    places = np.column_stack([draw(SIZES) * way, np.zeros(len(way))])
    heading_rad = np.mod(draw(SIZES) * way, 2.0 * np.pi)
    return build_run(time_s, places, heading_rad, (command_s, speed, turns))


@settings(max_examples=30, deadline=None, derandomize=True)
@given(run=draw_run())
def test_whatever_a_log_holds_gets_an_answer_or_a_known_error(run: tl.Run) -> None:
    model = tl.identify_robot(run)
    assert "nan" not in format_robot(model, [Path("robot")])
    assert all(axis.is_known or axis.reason for axis in model.axes)
    for ask in (
        lambda: build_robot_scenario(model, run),
        lambda: compare_robot(run, tl.load_scenario("lagged")),
    ):
        with suppress(TurtlelogError):
            ask()


def test_a_residual_of_zero_has_a_noise() -> None:
    always, never = np.ones(60), np.zeros(60, dtype=bool)
    noise = fit_noise(np.zeros(60), always, always, never).noise
    assert 0.0 < noise.slip + noise.sensing < 1e-23


def test_a_run_without_steps_beside_a_whole_one_takes_nothing_from_it() -> None:
    whole = make_run(Log(duration_s=10.0), 1)
    empty = whole.slice(end_s=0.05)
    empty = replace(empty, commands=whole.commands)
    together, alone = tl.identify_robot([whole, empty]), tl.identify_robot(whole)
    assert known(together.turn_rate.gain).value == known(alone.turn_rate.gain).value


@pytest.mark.parametrize(("size", "is_told"), [(0.9e-9, True), (1.1e-9, False)])
def test_commands_that_move_nothing_are_told(size: float, *, is_told: bool) -> None:
    run = make_run(Log(duration_s=8.0), 1)
    speed = run.commands.speed_m_s * (size / np.abs(run.commands.speed_m_s).max())
    model = tl.identify_robot(replace(run, commands=replace(run.commands, speed_m_s=speed)))
    assert ("which moves nothing" in model.speed.reason) is is_told


@pytest.mark.parametrize("lost", [0, 7])
def test_a_robot_at_one_speed_follows_no_commands_whatever_poses_are_lost(lost: int) -> None:
    # Steps over lost poses are twice as long, which a slow response explains and commands do not.
    log = Log(duration_s=20.0, poses_hz=20.0)
    run = make_run(log, 1)
    count = len(run.poses)
    x_m = 0.3 * run.poses.time_ns / 1e9
    kept = np.ones(count, dtype=np.bool_)
    if lost:
        kept[::lost] = False
    poses = tl.run.PoseColumns(
        time_ns=run.poses.time_ns[kept],
        xy_m=np.column_stack([x_m, np.zeros(count)])[kept],
        heading_rad=np.zeros(int(kept.sum())),
    )
    found = tl.identify_robot(replace(run, poses=poses)).speed
    assert found.status == "not_identifiable"


def test_a_few_steps_with_all_information_have_the_variance_of_the_noise() -> None:
    """Each is off by a usual residual, to either side in turn, so that their sums show nothing."""
    white, slopes = np.random.default_rng(1).normal(size=20_000), np.zeros((20_000, 3))
    for column in range(3):
        rows = np.arange(20) + 100 * column
        slopes[rows, column], white[rows] = 1.0, 0.905 * (-1.0) ** rows
    covariance, _ = _estimate_covariance(white, slopes)
    assert 20.0 * np.diag(covariance) == pytest.approx(1.0, rel=0.03)


def test_no_combination_of_parameters_is_known_better_than_the_noise_allows() -> None:
    """One step separates two parameters, and its residual is 0 by chance."""
    white, slopes = np.tile([1.0, -1.0], 200), np.zeros((400, 2))
    slopes[:20], slopes[0, 1], white[0] = 1.0, 3.0, 0.0
    covariance, _ = _estimate_covariance(white, slopes)
    assert min(np.linalg.eigvals(covariance @ slopes.T @ slopes).real) == pytest.approx(
        1.0, rel=0.1
    )


@pytest.mark.parametrize(("moving", "is_known"), [(5, False), (6, True)])
def test_five_steps_with_motion_may_be_a_jump(moving: int, *, is_known: bool) -> None:
    time_s = np.arange(0.0, 10.0, 0.05)
    x_m = np.clip(time_s - 5.1, 0.0, 0.05 * moving)
    commands = np.array([0.0, 5.0, 5.0 + 0.05 * moving]), np.array([0.0, 1.0, 0.0]), np.zeros(3)
    run = build_run(time_s, np.column_stack([x_m, 0.0 * x_m]), 0.0 * x_m, commands)
    axis = tl.identify_robot(run).speed
    assert axis.is_known is is_known
    told = "commands act in only 5 steps of 67 between poses, which may be a jump"
    assert axis.reason == ("" if is_known else told)
