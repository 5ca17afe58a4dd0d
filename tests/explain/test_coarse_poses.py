"""What logs in coarse steps, and of robots with a lag, do not tell: no `fitted` that is not so."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.explain.logs import as_log, forget, simulate
from turtlelog.explain import Certainty, Finding, identify_run
from turtlelog.measure import DeadTime, Missing, find_dead_time
from turtlelog.measure.dead_time import LagInstead
from turtlelog.measure.motion import is_within_steps
from turtlelog.measure.pose_noise import find_coarse_step
from turtlelog.run import Run

COARSE = {
    "law__kp_angular": 2.858,
    "law__kp_linear": 2.858,
    "law__pause_ticks": 0,
    "loop__start_backlog": 3,
    "loop__queue_policy": "newest",
    "loop__transport_delay_ticks": 1,
    "goal__x_m": 2.217789422988637,
    "goal__y_m": 7.621838325209724,
    "sensing__quantum_position_m": 0.00468426542538751,
    "sensing__quantum_heading_rad": 0.00045900733502680636,
    "max_duration_s": 25.0,
}
"""A loop without a pause, which read poses in steps of 5 mm."""

SLOW = {
    "law__kp_linear": 1.5,
    "law__kp_angular": 1.5,
    "loop__start_backlog": 3,
    "loop__transport_delay_ticks": 1,
    "loop__queue_policy": "newest",
    "plant__turn_lag_s": 0.06,
    "plant__speed_lag_s": 0.06,
    "plant__turn_dead_time_s": 0.016,
    "plant__speed_dead_time_s": 0.016,
    "plant__period_s": 0.016,
    "max_duration_s": 25.0,
}
"""A robot with a dead time of 2 ticks in all, and a lag of 4."""


def see_sensed(run: Run) -> Run:
    """Return a run of which only the poses that the controller read are known."""
    poses = run.poses
    read = replace(
        poses,
        xy_m=poses.read_xy_m.copy(),
        heading_rad=poses.read_heading_rad.copy(),
        sensed_xy_m=None,
        sensed_heading_rad=None,
    )
    return replace(run, poses=read)


def identify(name: str, **values: Any) -> dict[str, Finding]:
    """Return what is found of a run as its controller logged it, without its scenario."""
    log = as_log(see_sensed(simulate(name, **values)), jitter_ns=300_000, seed=81)
    return dict(identify_run(log).findings)


def holds(finding: Finding, truth: Any) -> bool:
    if finding.value is None:
        return True
    low, high = finding.interval or (finding.value, finding.value)
    return truth in finding.candidates or low <= truth <= high


@pytest.mark.thorough
def test_coarse_poses_do_not_tell_a_pause_of_one_tick_from_none() -> None:
    found = identify("paper-kp4", **COARSE)
    assert found["law.pause_ticks"].candidates == (1, 0)
    assert holds(found["start.x_m"], 5.544444561004639)
    assert holds(found["start.y_m"], 5.544444561004639)


@pytest.mark.thorough
def test_a_lag_in_coarse_poses_is_not_fitted_as_dead_time() -> None:
    """A robot with lags is fitted to coarse poses, which takes the longest search."""
    steps = {"sensing__quantum_heading_rad": 2e-2, "sensing__quantum_position_m": 2e-2}
    found = identify("lagged", **SLOW, **steps)
    for key in ("dead_time.rotate", "dead_time.translate", "loop.transport_delay_ticks"):
        assert holds(found[key], 2)
        assert found[key].certainty is not Certainty.EXACT


def find_turning(size: float, **values: Any) -> DeadTime | Missing:
    run = forget(see_sensed(simulate("lagged", **SLOW | values, sensing__noise_heading_rad=size)))
    return find_dead_time(run, "rotate")


def test_a_lag_that_the_motion_shows_leaves_no_dead_time() -> None:
    found = find_turning(1e-4)
    assert isinstance(found, LagInstead)
    assert found.reason.startswith("with a lag a shorter dead time explains the motion better than")


def test_noise_leaves_a_turtlesim_its_dead_time_and_tells_what_may_be_a_lag() -> None:
    none = {"plant__turn_lag_s": 0.0, "plant__speed_lag_s": 0.0}
    little, much = (find_turning(size, **none) for size in (1e-4, 1e-2))
    assert isinstance(little, DeadTime)
    assert (little.ticks, little.least_ticks) == (2, 2)
    assert isinstance(much, DeadTime)
    assert much.ticks - much.lag_slack < 2 <= much.ticks


def test_a_recorded_scenario_of_turtlesim_has_no_lag_to_allow_for() -> None:
    run = see_sensed(simulate("textbook", sensing__noise_heading_rad=1e-2, seed=2))
    found = find_dead_time(run, "rotate")
    assert isinstance(found, DeadTime)
    assert found.lag_slack == 0


@pytest.mark.parametrize(
    ("span", "best", "is_within"),
    [(1.24, 0.5, True), (1.26, 0.5, False), (2.19, 2.0, True), (2.21, 2.0, False)],
)
def test_a_fit_within_the_steps_of_the_poses_is_as_good_as_the_best(
    span: float, best: float, *, is_within: bool
) -> None:
    assert is_within_steps(np.array([best, span]), 0, 1.0).tolist() == [True, is_within]
    assert is_within_steps(np.array([best, span]), 0, 0.0).tolist() == [True, False]


def test_few_values_have_their_least_distance_as_a_step() -> None:
    assert find_coarse_step(np.array([0.0, 0.3, 0.3, 0.5])) == pytest.approx(0.2)
    assert find_coarse_step(np.ones(5)) == 0.0
    assert find_coarse_step(np.arange(40.0) * 0.01) == pytest.approx(0.01, rel=1e-6)
    assert find_coarse_step(np.random.default_rng(1).normal(size=40)) == 0.0


def test_a_constant_command_does_not_show_an_exact_dead_time() -> None:
    values = {"plant__turn_lag_s": 0.00384, "plant__speed_lag_s": 0.00384, "law__kp_angular": 6.088}
    fast = {"loop__transport_delay_ticks": 6, "plant__turn_dead_time_s": 0.08}
    found = find_dead_time(forget(simulate("lagged", **SLOW | values | fast)), "rotate")
    assert not (isinstance(found, DeadTime) and found.is_exact)
