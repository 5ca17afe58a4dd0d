"""Metrics of runs that hold little, stand, or overflow: a finite value or a reason."""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest

import turtlelog as tl
from tests.known import known
from tests.measure.runs import (
    EXPONENTIAL,
    GOAL_M,
    PERIOD_NS,
    make_foreign_run,
    make_straight_run,
    read,
    take_rows,
)
from turtlelog.run import Run


def make_still_run() -> Run:
    return make_straight_run(np.full(50, GOAL_M))


def make_huge_run() -> Run:
    return make_straight_run(np.linspace(0.0, 1e300, 50), np.full(50, 1e300))


def make_burst_run() -> Run:
    run = take_rows(EXPONENTIAL, 20)
    samples = dataclasses.replace(run.samples, time_ns=np.full(20, 5 * PERIOD_NS))
    return dataclasses.replace(run, samples=samples)


POOR_RUNS: dict[str, Callable[[], Run]] = {
    "foreign": make_foreign_run,
    "one-pose": lambda: make_foreign_run(poses=1, commands=0),
    "one-row": lambda: take_rows(EXPONENTIAL, 1),
    "two-rows": lambda: take_rows(EXPONENTIAL, 2),
    "still": make_still_run,
    "huge": make_huge_run,
    "burst": make_burst_run,
    "no-goal": lambda: dataclasses.replace(EXPONENTIAL, goal_xy_m=None, parameters={}),
    "wrong-gain": lambda: dataclasses.replace(EXPONENTIAL, parameters={"law.kp_linear": -1.0}),
    "wrong-note": lambda: dataclasses.replace(EXPONENTIAL, notes={"sorted_rows": "many"}),
}


@pytest.mark.parametrize("make", POOR_RUNS.values(), ids=POOR_RUNS)
def test_every_metric_of_a_poor_run_has_a_finite_value_or_a_reason(
    make: Callable[[], Run],
) -> None:
    for metric in tl.measure_run(make()).values():
        assert (metric.value is None) == (metric.status is not tl.measure.Status.OK)
        assert bool(metric.reason) == (metric.value is None)
        assert metric.value is None or math.isfinite(metric.value)
        assert metric.at_s is None or math.isfinite(metric.at_s)


def find_statuses(run: Run, *names: str) -> set[tl.measure.Status]:
    return {metric.status for metric in tl.measure_run(run, only=names).values()}


def test_what_a_foreign_bag_lacks_is_absent_and_the_rest_is_measured() -> None:
    run = make_foreign_run()
    assert find_statuses(run, "rotate.*", "translate.*", "run.dropped_samples") == {
        tl.measure.Status.ABSENT
    }
    assert read(run, "run.path_length") == pytest.approx(0.3)
    assert read(run, "run.speed_effort") == pytest.approx(0.048)
    assert read(run, "run.sample_rate") == pytest.approx(62.5)
    bare = make_foreign_run(commands=0)
    assert find_statuses(bare, "run.speed_*", "run.sample_*") == {tl.measure.Status.ABSENT}


def test_a_turtle_that_stands_has_no_step_and_no_straightness() -> None:
    run = make_still_run()
    names = ("rise_time", "overshoot", "settling_time", "peak", "decay_ratio")
    assert find_statuses(run, *(f"translate.{name}" for name in names)) == {
        tl.measure.Status.NO_STEP
    }
    assert find_statuses(run, "run.straightness") == {tl.measure.Status.NO_MOTION}
    assert read(run, "translate.iae") == 0.0
    assert read(run, "translate.crossings") == 0.0


def test_a_step_within_the_rounding_of_poses_is_none() -> None:
    # The bearing of a goal straight ahead, but for the rounding of the first pose.
    ahead = {"goal.x_m": 9.0, "goal.y_m": 5.544444}
    run = tl.simulate_run(tl.override_scenario(tl.load_scenario("textbook"), ahead))
    assert 0.0 < abs(known(run.samples.bearing_rad)[0]) < 1e-6
    assert find_statuses(run, "rotate.overshoot", "rotate.rise_time") == {tl.measure.Status.NO_STEP}


def test_figures_beyond_the_largest_float_are_told_so() -> None:
    assert find_statuses(make_huge_run(), "translate.ise", "run.ise", "run.speed_effort") == {
        tl.measure.Status.TOO_LARGE
    }


def test_samples_of_one_time_have_no_rate_and_no_slew_rate() -> None:
    run = make_burst_run()
    assert find_statuses(run, "run.sample_rate", "translate.sampled_deviation_max") == {
        tl.measure.Status.TOO_SHORT
    }
    assert read(run, "run.sample_period_p50") == 0.0
    assert read(run, "run.burst_samples") == 19.0
