"""Robots of known noise, periods and limits, as scenarios."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

import turtlelog as tl
from tests.identify.robots import (
    Log,
    Truth,
    Values,
    build_run,
    draw_steps,
    find_changes,
    make_run,
    respond,
    turn_with_limit,
)
from tests.known import known
from turtlelog.identify import RobotScenario, build_robot_scenario
from turtlelog.identify.axis_motion import AXES
from turtlelog.identify.robot_noise import measure_disturbance_noise, measure_sensing_noise
from turtlelog.run import Run

LOG = Log(
    speed=Truth(gain=0.9, dead_time_s=0.08, lag_s=0.12),
    turn_rate=Truth(gain=0.95, dead_time_s=0.06, lag_s=0.1),
    duration_s=40.0,
    commands_hz=10.0,
    poses_hz=20.0,
)
FINE_S = 2e-3


def draw_drive(rng: np.random.Generator, log: Log, largest: float, stand_s: float) -> Values:
    """Return random steps between two stretches of 0."""
    time_s = np.arange(0.5, log.duration_s, 1.0 / log.commands_hz)
    value, changes_s = np.zeros(len(time_s)), stand_s
    while changes_s < log.duration_s:
        value[time_s >= changes_s] = rng.uniform(-largest, largest)
        changes_s += rng.uniform(0.5, 3.0)
    value[time_s >= log.duration_s - stand_s] = 0.0
    return value


def drive_with_noise(
    seed: int,
    *,
    rates: tuple[float, float] = (0.0, 0.0),
    sensing: tuple[float, float] = (0.0, 0.0),
    jitter_s: float = 0.0,
    stand_s: float = 6.0,
    log: Log = LOG,
) -> Run:
    """Return the run of a robot whose rates and poses have noise, summed up in steps of 2 ms."""
    rng = np.random.default_rng([seed, 5])
    time_s = np.arange(0.5, log.duration_s, 1.0 / log.commands_hz)
    speeds, turns = (draw_drive(rng, log, largest, stand_s) for largest in (0.5, 1.5))
    fine_s = np.arange(0.0, log.duration_s, FINE_S)
    noise = [rng.normal(0.0, size * math.sqrt(FINE_S), len(fine_s)) for size in rates]
    speed = respond(log.speed, fine_s, find_changes(time_s, speeds))[0]
    turned = respond(log.turn_rate, fine_s, find_changes(time_s, turns))[1]
    heading_rad = turned + np.cumsum(noise[1])
    step_m = speed * FINE_S + noise[0]
    xy_m = np.cumsum(
        step_m[:, None] * np.column_stack([np.cos(heading_rad), np.sin(heading_rad)]), 0
    )
    rows = np.arange(0, len(fine_s), round(1.0 / (log.poses_hz * FINE_S)))
    stamp_s = np.maximum(fine_s[rows] + rng.normal(0.0, jitter_s, len(rows)), 0.0)
    order = np.argsort(stamp_s, kind="stable")
    seen_m = xy_m[rows] + rng.normal(0.0, sensing[0], (len(rows), 2))
    seen_rad = heading_rad[rows] + rng.normal(0.0, sensing[1], len(rows))
    return build_run(stamp_s[order], seen_m[order], seen_rad[order], (time_s, speeds, turns))


def build(*runs: Run) -> RobotScenario:
    return build_robot_scenario(tl.identify_robot(runs), runs)


def list_noise(scenario: tl.Scenario) -> tuple[float, float, float, float]:
    push, sensing = scenario.disturbance, scenario.sensing
    return (
        *(push.noise_speed, push.noise_turn_rate),
        *(sensing.noise_position_m, sensing.noise_heading_rad),
    )


@pytest.mark.everyday("1.0")
@pytest.mark.parametrize("level", [0.1, 1.0, 10.0])
def test_the_noise_of_rates_is_right_to_a_third(level: float) -> None:
    rates = 3e-3 * level, 1e-2 * level
    found = [list_noise(build(drive_with_noise(seed, rates=rates)).scenario) for seed in range(3)]
    for speed, turn_rate, *sensing in found:
        assert speed == pytest.approx(rates[0], rel=1 / 3)
        assert turn_rate == pytest.approx(rates[1], rel=1 / 3)
        assert sensing == [0.0, 0.0]


@pytest.mark.everyday("1.0")
@pytest.mark.parametrize("level", [0.1, 1.0, 10.0])
def test_the_noise_of_poses_is_right_to_a_third(level: float) -> None:
    sensing = 5e-4 * level, 1e-3 * level
    for seed in range(3):
        noise = list_noise(build(drive_with_noise(seed, sensing=sensing)).scenario)
        assert noise[:2] == (0.0, 0.0)
        assert noise[2:] == pytest.approx(sensing, rel=1 / 3)


@pytest.mark.thorough
def test_noise_of_both_kinds_is_told_apart() -> None:
    rates, sensing = (2e-3, 4e-3), (2e-3, 4e-3)
    for seed in range(3):
        noise = list_noise(build(drive_with_noise(seed, rates=rates, sensing=sensing)).scenario)
        assert noise == pytest.approx((*rates, *sensing), rel=0.5)


def test_a_robot_without_noise_has_none() -> None:
    assert list_noise(build(drive_with_noise(1)).scenario) == (0.0, 0.0, 0.0, 0.0)


@pytest.mark.thorough
def test_times_that_jitter_are_no_noise() -> None:
    for seed in range(3):
        noise = list_noise(build(drive_with_noise(seed, jitter_s=5e-3)).scenario)
        assert noise == (0.0, 0.0, 0.0, 0.0)
    rates = 3e-3, 1e-2
    noise = list_noise(build(drive_with_noise(1, rates=rates, jitter_s=5e-3)).scenario)
    assert noise[:2] == pytest.approx(rates, rel=0.4)
    assert noise[2:] == (0.0, 0.0)


@pytest.mark.parametrize(("stand_s", "is_known"), [(1.0, False), (3.0, True)])
def test_poses_have_noise_only_where_the_robot_stands(stand_s: float, is_known: bool) -> None:  # noqa: FBT001
    # It stands from 0.5 s, five lags and the dead time after the last command on: 1.2 s.
    run = drive_with_noise(2, sensing=(5e-4, 1e-3), stand_s=stand_s)
    rows = run.poses.time_ns >= run.commands.time_ns[0]
    poses = replace(
        run.poses,
        time_ns=run.poses.time_ns[rows],
        xy_m=run.poses.xy_m[rows],
        heading_rad=run.poses.heading_rad[rows],
    )
    robot = build(replace(run, poses=poses))
    assert (list_noise(robot.scenario)[2] > 0.0) == is_known
    assert ("never stands" in " ".join(robot.notes)) == (not is_known)


def test_a_robot_that_is_pushed_while_nothing_is_commanded_does_not_stand() -> None:
    run = drive_with_noise(2, sensing=(5e-4, 1e-3))
    since_s = run.poses.time_ns / 1e9
    for rate, stands in ((0.4, True), (0.6, False)):
        # 5 % of the largest command, which is below 0.5 m/s.
        slide_m = rate * 0.05 * np.abs(run.commands.speed_m_s).max() * 2.0 * since_s
        slid = run.poses.xy_m + np.column_stack([slide_m, 0.0 * slide_m])
        pushed = replace(run, poses=replace(run.poses, xy_m=slid))
        found = build_robot_scenario(tl.identify_robot(run), pushed)
        assert ("in which the robot stands" in " ".join(found.notes)) == stands


@pytest.mark.thorough
def test_noise_that_may_hide_is_bounded() -> None:
    """Four seeds of two sizes of noise are identified, each twice."""
    sensing, rates = (2e-3, 4e-3), (5e-3, 1e-2)
    still = drive_with_noise(1, sensing=sensing)
    model = tl.identify_robot(still)
    speed, turn_rate = (known(measure_disturbance_noise(model, axis, [still])) for axis in AXES)
    pushed = drive_with_noise(1, rates=rates)
    poses = known(measure_sensing_noise(tl.identify_robot(pushed), [pushed]))
    hidden = speed.hidden, turn_rate.hidden, poses.position.hidden, poses.heading.hidden
    assert (speed.size, turn_rate.size, poses.position.size, poses.heading.size) == (0.0,) * 4
    assert max(hidden[:2]) < max(rates)
    shown = {1.0: 0, 0.1: 0}
    for seed in range(4):
        for scale in shown:
            size = [scale * one for one in hidden]
            first = build(drive_with_noise(seed, rates=(size[0], size[1]), sensing=sensing))
            other = build(drive_with_noise(seed, rates=rates, sensing=(size[2], size[3])))
            found = *list_noise(first.scenario)[:2], *list_noise(other.scenario)[2:]
            shown[scale] += int(np.count_nonzero(found))
    # Chance hides one of 40 that are as large as is told.
    assert shown[1.0] >= 15
    assert shown[0.1] <= 1


def test_what_may_hide_is_told() -> None:
    told = " ".join(build(drive_with_noise(1, rates=(5e-3, 1e-2))).notes)
    assert re.search(r"What shows none has 0: up to 0\.\d+ mm and [\d.]+ mrad may hide\.", told)
    told = " ".join(build(drive_with_noise(1, sensing=(2e-3, 4e-3))).notes)
    assert re.search(r"speed does not clearly grow .* 0\. Up to [\d.]+ mm by the root of", told)
    assert "may hide" not in " ".join(
        build(drive_with_noise(1, rates=(5e-3, 1e-2), sensing=(2e-3, 4e-3))).notes
    )


def test_a_goal_is_set_and_the_start_is_the_first_pose() -> None:
    run = drive_with_noise(1)
    run = replace(run, poses=replace(run.poses, xy_m=run.poses.xy_m + np.array([3.0, -2.0])))
    scenario = build(run).scenario
    assert (scenario.start.x_m, scenario.start.y_m) == (3.0, -2.0)
    assert (scenario.goal.x_m, scenario.goal.y_m) == (4.0, -1.0)
    assert build(replace(run, goal_xy_m=(7.0, 1.5))).scenario.goal == tl.scenario.Target(
        x_m=7.0, y_m=1.5
    )


def test_the_tolerance_of_the_goal_grows_with_noise() -> None:
    law = build(drive_with_noise(1)).scenario.law.parameters
    assert (law.heading_tolerance_rad, law.position_tolerance_m) == (0.01, 0.014)
    robot = build(drive_with_noise(1, rates=(0.0, 1e-2), sensing=(5e-3, 1e-2)))
    found, law = list_noise(robot.scenario), robot.scenario.law.parameters
    assert law.heading_tolerance_rad == pytest.approx(5.0 * found[3], rel=0.05)
    drift_rad = 2.0 * math.sqrt(5.0) * found[1]
    expected = math.sqrt(2.0) * (5.0 * found[3] + drift_rad)
    assert law.position_tolerance_m == pytest.approx(expected, rel=0.05)


def test_the_text_is_the_scenario_with_its_notes() -> None:
    robot = build(drive_with_noise(1, rates=(3e-3, 1e-2)))
    assert tl.parse_scenario(robot.text) == robot.scenario
    assert robot.text == build(drive_with_noise(1, rates=(3e-3, 1e-2))).text
    comments = [line[2:] for line in robot.text.splitlines() if line.startswith("# ")]
    assert " ".join(comments).endswith(" ".join(robot.notes))


@pytest.mark.parametrize(
    ("commands_hz", "poses_hz", "plant_s"),
    [(10.0, 20.0, 0.05), (10.0, 30.0, 1 / 30), (20.0, 50 / 1.5, 0.03), (10.0, 20.6, 0.05)],
)
def test_periods_are_those_of_the_messages(
    commands_hz: float, poses_hz: float, plant_s: float
) -> None:
    log = replace(LOG, commands_hz=commands_hz, poses_hz=poses_hz, lost=0.05)
    rng = np.random.default_rng(3)
    time_s, speeds = draw_steps(rng, log, 0.5)
    time_s = np.arange(len(time_s)) / commands_hz + 0.5 + rng.normal(0.0, 3e-3, len(time_s))
    run = make_run(log, 3, (time_s, speeds), (time_s, draw_steps(rng, log, 1.5)[1]))
    scenario = build(run).scenario
    assert (scenario.loop.trigger, scenario.loop.period_ticks) == ("timer", 1)
    assert scenario.loop.period_s == pytest.approx(1.0 / commands_hz, rel=2e-3)
    assert scenario.plant.period_s == pytest.approx(plant_s, rel=5e-3)
    if plant_s != 0.03:
        times = float(scenario.loop.period_s or 0.0) / float(scenario.plant.period_s or 1.0)
        assert times == pytest.approx(round(times), abs=1e-6)


@pytest.mark.parametrize(("poses_hz", "is_multiple"), [(20.9, True), (21.1, False)])
def test_a_timer_near_a_multiple_of_the_poses_is_made_one(
    poses_hz: float,
    is_multiple: bool,  # noqa: FBT001
) -> None:
    # 5 % of two poses a period: 20 to 21 poses per second.
    run = make_run(replace(LOG, poses_hz=poses_hz, jitter_s=0.0), 3)
    commands = replace(
        run.commands,
        time_ns=np.rint(1e9 * (0.5 + 0.1 * np.arange(len(run.commands)))).astype(np.int64),
    )
    model = tl.identify_robot(run)
    scenario = build_robot_scenario(model, replace(run, commands=commands)).scenario
    assert scenario.plant.period_s == pytest.approx(0.05 if is_multiple else 1 / poses_hz, rel=1e-3)


@pytest.mark.parametrize(("share", "trigger"), [(0.15, "timer"), (0.25, "pose")])
def test_most_commands_keep_the_period_of_a_timer(share: float, trigger: str) -> None:
    run = make_run(LOG, 3)
    apart_s = np.full(len(run.commands) - 1, 0.1)
    late = np.random.default_rng(1).choice(len(apart_s), round(share * len(apart_s)), replace=False)
    apart_s[late] = 0.15
    time_ns = np.rint(1e9 * (0.5 + np.concatenate([[0.0], np.cumsum(apart_s)]))).astype(np.int64)
    commands = replace(run.commands, time_ns=time_ns)
    robot = build_robot_scenario(tl.identify_robot(run), replace(run, commands=commands))
    assert robot.scenario.loop.trigger == trigger


def test_commands_without_a_period_have_no_timer() -> None:
    log = replace(LOG, commands_hz=4.0)
    rng = np.random.default_rng(1)
    (time_s, speeds), turns = draw_steps(rng, log, 0.5), draw_steps(rng, log, 1.5)[1]
    time_s = np.sort(rng.uniform(0.5, 39.0, len(time_s)))
    robot = build(make_run(log, 1, (time_s, speeds), (time_s, turns)))
    assert robot.scenario.loop.trigger == "pose"
    assert "Commands keep no period" in " ".join(robot.notes)


@pytest.mark.parametrize(("arrivals", "limit"), [(2, math.inf), (3, 0.6)])
def test_a_limit_is_where_commands_arrive_three_times(arrivals: int, limit: float) -> None:
    run = drive_with_noise(1)
    speeds = run.commands.speed_m_s.copy()
    for number in range(arrivals):
        speeds[80 + 20 * number : 85 + 20 * number] = 0.6 if number % 2 else 0.6 * (1.0 - 1e-8)
    commands = replace(run.commands, speed_m_s=speeds)
    found = build_robot_scenario(tl.identify_robot(run), replace(run, commands=commands)).scenario
    assert found.limits.speed_m_s == limit
    assert found.limits.turn_rate_rad_s == math.inf


def test_a_limit_of_the_acceleration_is_one_of_commands() -> None:
    log = Log(duration_s=40.0, noise_rad=1e-4)
    run = turn_with_limit(Truth(gain=0.8), log, 2.0, 3)
    limits = build(run).scenario.limits
    assert limits.turn_acceleration_rad_s2 == pytest.approx(2.0 / 0.8, rel=0.1)
    assert limits.acceleration_m_s2 == math.inf


@pytest.mark.thorough
def test_of_second_order_the_lag_is_the_sum() -> None:
    log = replace(LOG, noise_m=1e-5, noise_rad=1e-5, jitter_s=0.0)
    log = replace(log, turn_rate=Truth(second_lag_s=0.2), poses_hz=30.0)
    robot = build(make_run(log, 1))
    assert robot.scenario.plant.turn_lag_s == pytest.approx(0.3, rel=0.01)
    assert "The turn rate is of second order" in " ".join(robot.notes)


def test_an_axis_that_is_never_commanded_follows_at_once() -> None:
    steps = draw_steps(np.random.default_rng(1), LOG, 0.5)
    robot = build(make_run(LOG, 1, steps, (steps[0], 0.0 * steps[1])))
    plant = robot.scenario.plant
    assert (plant.turn_gain, plant.turn_dead_time_s, plant.turn_lag_s) == (1.0, 0.0, 0.0)
    assert (plant.turn_assumed, plant.speed_assumed) == (True, None)
    assert plant.speed_gain == pytest.approx(0.9, rel=0.02)
    assert "The turn rate is never commanded, and so its dynamics are unknown" in " ".join(
        robot.notes
    )


def test_an_axis_that_is_not_known_is_refused_with_its_reason() -> None:
    run = make_run(LOG, 1)
    constant = replace(run.commands, turn_rate_rad_s=np.full(len(run.commands), 0.3))
    with pytest.raises(
        tl.errors.IdentifyError, match=r"^robot: turn rate: not identifiable: the comm"
    ):
        build(replace(run, commands=constant))
    still = replace(run.commands, speed_m_s=0.0 * run.commands.speed_m_s)
    still = replace(still, turn_rate_rad_s=still.speed_m_s)
    with pytest.raises(
        tl.errors.IdentifyError, match=r"^robot: speed: not identifiable: the speed is ne"
    ):
        build(replace(run, commands=still))
    with pytest.raises(tl.errors.IdentifyError, match="runs: must not be empty"):
        build_robot_scenario(tl.identify_robot(run), [])


def test_turtlesim_is_no_robot() -> None:
    run = tl.simulate_run(tl.load_scenario("paper-kp4"))
    with pytest.raises(
        tl.errors.IdentifyError, match=r"found turtlesim, .*`turtlelog explain FILE --sc"
    ):
        build(run)


def test_a_robot_outside_of_the_world_is_refused() -> None:
    run = make_run(LOG, 1)
    far = replace(run, poses=replace(run.poses, xy_m=run.poses.xy_m + 4e6))
    with pytest.raises(
        tl.errors.IdentifyError, match=r"start\.x_m: expected a number from -1000000 to"
    ):
        build_robot_scenario(tl.identify_robot(run), far)


def test_a_simulated_robot_comes_back() -> None:
    changes = {
        "law.signal": "prbs",
        "law.axis": "both",
        "law.start_s": 4.0,
        "plant.speed_gain": 0.92,
        "plant.turn_gain": 0.9,
        "plant.turn_dead_time_s": 0.06,
        "loop.trigger": "timer",
        "loop.period_s": 0.1,
        "sensing.noise_position_m": 5e-4,
        "sensing.noise_heading_rad": 1e-3,
        "disturbance.noise_speed": 2e-3,
        "disturbance.noise_turn_rate": 2e-3,
    }
    base = tl.override_scenario(
        tl.load_scenario("lagged"), {"law.kind": "open-loop"}, source="test"
    )
    base = tl.override_scenario(base, changes, source="test")
    run = tl.simulate_run(base)
    found = build(replace(run, name="lagged law.kind=open-loop law.axis=both")).scenario
    # Changed keys are those of the log, not of this scenario.
    assert found.name == "lagged"
    assert build(replace(run, name="law.kind=open-loop")).scenario.name == "robot"
    for name in ("gain", "dead_time_s", "lag_s"):
        for axis in ("speed", "turn"):
            one, truth = (getattr(plant, f"{axis}_{name}") for plant in (found.plant, base.plant))
            assert one == pytest.approx(truth, rel=0.1)
    assert (found.plant.period_s, found.loop.period_s) == (0.05, 0.1)
    assert list_noise(found) == pytest.approx((2e-3, 2e-3, 5e-4, 1e-3), rel=0.5)
    assert (found.limits.speed_m_s, found.loop.transport_delay_s) == (0.5, 0.0)
