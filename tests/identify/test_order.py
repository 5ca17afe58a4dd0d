"""When a second lag or a limit of the acceleration is told: only if it matters, and is sure."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from tests.identify.robots import Log, Truth, make_run
from tests.known import known
from turtlelog.identify.axis_fit import EXTRA, AxisFit, fit_axis, refit_axis
from turtlelog.identify.axis_motion import read_axis_motion
from turtlelog.identify.held_response import SECOND_ORDER
from turtlelog.identify.structure_choice import is_distinct as judge_distinct, measure_effect

CLEAR = Log(poses_hz=50.0, noise_rad=1e-5, jitter_s=0.0, duration_s=15.0)
SHORT_LAG = Truth(gain=0.9, dead_time_s=0.1, lag_s=0.2)


def drive_first_order(law: str | None, **changes: float) -> tl.RobotModel:
    """Return what is identified of a simulated robot with one lag on each axis."""
    scenario = tl.load_scenario("lagged")
    if law is not None:
        scenario = tl.override_scenario(scenario, {"law.kind": law}, source="test")
    values: dict[str, Any] = {key.replace("__", "."): value for key, value in changes.items()}
    return tl.identify_robot(tl.simulate_run(tl.override_scenario(scenario, values, source="test")))


LATE = {
    "loop__jitter_s": 0.01,
    "plant__speed_gain": 1.032,
    "plant__speed_dead_time_s": 0.221,
    "plant__speed_lag_s": 0.495,
    "plant__turn_gain": 0.978,
    "plant__turn_dead_time_s": 0.0836,
    "plant__turn_lag_s": 0.151,
    "seed": 1,
}
"""Commands that come up to 10 ms late fit another model a little better, in a log without noise."""


@pytest.mark.everyday("posture")
@pytest.mark.parametrize("law", [None, "posture"])
def test_late_commands_make_no_second_lag_and_no_limit(law: str | None) -> None:
    for axis in drive_first_order(law, **LATE).axes:
        assert (axis.model, axis.lag_product_s2, axis.rate_limit) == ("first_order", None, None)


def test_lost_poses_make_no_second_lag_and_leave_the_first_as_it_is() -> None:
    lost = {"sensing__dropout_probability": 0.1, "plant__turn_lag_s": 0.3307, "seed": 1}
    turns = {"plant__turn_gain": 1.045, "plant__turn_dead_time_s": 0.0347}
    found = drive_first_order(None, **lost, **turns).turn_rate
    assert found.model == "first_order"
    assert known(found.lag_s).value == pytest.approx(0.3307, abs=1e-3)
    assert known(found.dead_time_s).value == pytest.approx(0.0347, abs=1e-3)


@pytest.mark.parametrize(("lag_s", "model"), [(0.02, "first_order"), (0.025, "second_order")])
def test_a_second_lag_is_told_if_it_changes_a_rate_by_2_percent(lag_s: float, model: str) -> None:
    log = replace(CLEAR, turn_rate=replace(SHORT_LAG, second_lag_s=lag_s))
    assert tl.identify_robot(make_run(log, 1)).turn_rate.model == model


def fit_both(lag_s: float) -> tuple[AxisFit, AxisFit]:
    log = replace(CLEAR, turn_rate=replace(SHORT_LAG, second_lag_s=lag_s))
    fit = fit_axis([read_axis_motion(make_run(log, 1), "turn_rate")])
    return fit, refit_axis(fit, SECOND_ORDER, [(0.005,)])


def test_the_effect_of_a_second_lag_is_by_how_much_it_changes_a_rate() -> None:
    # Of 25 ms beside 200 ms: about 0.37 * 25 / 200 at its end, less what another dead time takes.
    fit, other = fit_both(0.025)
    assert measure_effect(fit, fit) == 0.0
    assert 0.02 < measure_effect(fit, other) < 0.37 * 25.0 / 200.0


@pytest.mark.parametrize(("deviations", "is_distinct"), [(1.9, False), (2.0, True)])
def test_a_second_lag_is_told_if_its_interval_begins_above_0(
    deviations: float, *, is_distinct: bool
) -> None:
    fit, other = fit_both(0.05)
    covariance = other.covariance.copy()
    covariance[EXTRA, EXTRA] = (other.parameters[EXTRA] / deviations) ** 2
    assert judge_distinct(fit, replace(other, covariance=np.asarray(covariance))) is is_distinct
