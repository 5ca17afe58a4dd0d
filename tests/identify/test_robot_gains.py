"""Gains that theory recommends for an identified robot, in the simulated loop of its scenario."""

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from tests.identify.robots import Log, Truth, make_run
from turtlelog.identify import build_robot_scenario
from turtlelog.run import Run
from turtlelog.theory import LoopModel, Recommendation, find_stable_gains, recommend_gains

LOG = Log(
    speed=Truth(gain=0.85, dead_time_s=0.12, lag_s=0.25),
    turn_rate=Truth(gain=0.95, dead_time_s=0.06, lag_s=0.1),
    duration_s=40.0,
    noise_m=1e-5,
    noise_rad=1e-5,
    jitter_s=0.0,
    commands_hz=10.0,
)
ENDS = {
    "rotate": {"law.heading_tolerance_rad": 1e-9},
    "translate": {"law.position_tolerance_m": 1e-9, "goal.x_m": 1.0, "goal.y_m": 0.0},
}
"""What lets a loop go on: its phase otherwise ends where it first arrives."""

NAMES = {"rotate": "angular", "translate": "linear"}


@cache
def build_robot(poses_hz: float = 30.0) -> tl.Scenario:
    run = make_run(replace(LOG, poses_hz=poses_hz), 4)
    still = replace(build_robot_scenario(tl.identify_robot(run), run).scenario, max_duration_s=40.0)
    quiet = tl.scenario.Disturbance(), tl.scenario.Sensing()
    start = tl.scenario.Start(x_m=0.0, y_m=0.0, heading_rad=0.0)
    return replace(still, disturbance=quiet[0], sensing=quiet[1], start=start)


def model(scenario: tl.Scenario, loop: str) -> LoopModel:
    declaration = tl.simulate.declare_scenario(scenario)
    models = tl.theory.model_loops(declaration, tl.scenario.flatten_scenario(scenario))
    return next(found for found in models if found.loop.name == loop)


def recommend(scenario: tl.Scenario, loop: str, **wishes: Any) -> dict[tuple[str, str], Any]:
    found = model(scenario, loop)
    settings = found.require()[1]
    if found.most_dead_time_s is not None:
        settings["process"] = replace(settings["process"], dead_time_s=found.most_dead_time_s)
    recommended = recommend_gains(settings["process"], period_s=settings["period_s"], **wishes)
    return {(one.rule, one.controller): one for one in recommended}


def drive(scenario: tl.Scenario, loop: str, **gains: float) -> Run:
    scenario = tl.override_scenario(scenario, {"law.kind": "sequential-pid"}, source="test")
    keys = {f"law.{name}_{NAMES[loop]}": value for name, value in gains.items()}
    return tl.simulate_run(tl.override_scenario(scenario, ENDS[loop] | keys, source="test"))


def measure(run: Run, loop: str) -> float:
    """Return the overshoot of the pose itself [%]."""
    x_m, y_m = run.goal_xy_m or (0.0, 0.0)
    if loop == "rotate":
        return 100.0 * (float(np.max(run.poses.heading_rad)) / math.atan2(y_m, x_m) - 1.0)
    return 100.0 * (float(np.max(run.poses.xy_m[:, 0])) / x_m - 1.0)


def simulate(scenario: tl.Scenario, loop: str, one: Recommendation) -> float:
    gains = one.gains
    assert gains is not None
    return measure(drive(scenario, loop, kp=gains.kp, ki=gains.ki, kd=gains.kd), loop)


@pytest.mark.parametrize("loop", ["rotate", "translate"])
@pytest.mark.parametrize("percent", [5.0, 20.0])
def test_the_simulated_robot_overshoots_as_was_wanted(loop: str, percent: float) -> None:
    robot = build_robot()
    found = recommend(robot, loop, overshoot_percent=percent)
    one = found["overshoot", "P"]
    assert simulate(robot, loop, one) == pytest.approx(percent, abs=0.5)
    gains = replace(one.gains, kp=1.1 * one.gains.kp), replace(one.gains, kp=0.9 * one.gains.kp)
    more, less = (simulate(robot, loop, replace(one, gains=changed)) for changed in gains)
    assert less < percent - 1.0
    assert more > percent + 1.0


@pytest.mark.parametrize("loop", ["rotate", "translate"])
def test_pi_and_pd_of_a_wanted_margin_overshoot_as_is_told(loop: str) -> None:
    robot = build_robot()
    found = recommend(robot, loop, phase_margin_rad=math.radians(60.0))
    for controller in ("P", "PI", "PD"):
        one = found["phase-margin", controller]
        told = one.motion.overshoot_percent
        assert simulate(robot, loop, one) == pytest.approx(told, abs=0.1 * told + 0.5)


@pytest.mark.parametrize("loop", ["rotate", "translate"])
def test_overshoot_begins_where_theory_says(loop: str) -> None:
    robot = build_robot()
    gains = recommend(robot, loop, overshoot_percent=0.0)["overshoot", "P"].gains
    assert measure(drive(robot, loop, kp=1.1 * gains.kp), loop) > 0.01
    assert measure(drive(robot, loop, kp=0.9 * gains.kp), loop) < 1e-3


@pytest.mark.parametrize("loop", ["rotate", "translate"])
def test_instability_begins_where_theory_says(loop: str) -> None:
    robot = build_robot()
    gains, settings = model(robot, loop).require()
    ((_, most),) = find_stable_gains(gains, **settings)
    grows = []
    for kp in (0.95 * most, 1.05 * most):
        run = drive(robot, loop, kp=kp)
        signal = run.samples.turn_rate_rad_s if loop == "rotate" else run.samples.speed_m_s
        middle = len(signal) // 2
        grows.append(np.abs(signal[middle:]).max() > np.abs(signal[5:middle]).max())
    assert grows == [False, True]


def test_poses_whose_age_changes_get_gains_for_the_oldest() -> None:
    robot = build_robot(23.0)
    found = model(robot, "rotate")
    process = found.require()[1]["process"]
    assert found.growth == "the age of the poses"
    assert found.most_dead_time_s == pytest.approx(process.dead_time_s + 1.0 / 23.0, rel=1e-3)
    one = recommend(robot, "rotate", overshoot_percent=10.0)["overshoot", "P"]
    assert 1.0 < simulate(robot, "rotate", one) < 10.5
    assert model(build_robot(), "rotate").most_dead_time_s is None
