"""Theory's limits in simulated runs without limits: below them a run settles, above it grows."""

from typing import Any

import numpy as np
import pytest

import turtlelog as tl
from turtlelog.simulate import list_scenario_notes
from turtlelog.theory import find_stable_gains, model_loops

GRID_STEP = 0.05
"""Share of the limit between the gains that are tried on either side of it."""

SAMPLES = 500
START_RAD = 1e-4
FAR_RAD = 1.0
"""An error that grows this far is unstable, whatever follows when the heading wraps."""


def draw_scenario(seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    changes: dict[str, Any] = {
        "law.kind": "sequential-pid",
        "law.ki_angular": 0.3 if seed % 3 == 0 else 0.0,
        "law.kd_angular": float(rng.choice([0.0, 0.2])),
        "law.derivative_filter_s": float(rng.choice([0.0, 0.1])),
        "loop.transport_delay_s": float(rng.choice([0.0, 0.013, 0.06])),
        "loop.transport_delay_ticks": int(rng.integers(0, 3)),
        "sensing.delay_s": float(rng.choice([0.0, 0.017])),
        "shaping.low_pass_s": float(rng.choice([0.0, 0.1])),
    }
    period_s = 0.016
    if seed % 4:
        period_s = 0.05
        changes |= {
            "plant.kind": "lagged",
            "plant.turn_gain": float(rng.uniform(0.5, 1.5)),
            "plant.turn_lag_s": float(rng.choice([0.0, 0.03, 0.3])),
            "plant.turn_dead_time_s": float(rng.choice([0.0, 0.033, 0.15])),
        }
    every = int(rng.integers(1, 4))
    if rng.random() < 0.5:
        changes |= {"loop.trigger": "timer", "loop.period_s": every * period_s}
    elif every == 1 and rng.random() < 0.6:
        changes |= {"loop.queue_policy": "one-per-tick", "loop.start_backlog": 3}
    else:
        changes["loop.period_ticks"] = every
    return changes


def build(changes: dict[str, Any], kp: float, period_s: float) -> tl.Scenario:
    scenario = tl.override_scenario(tl.load_scenario("textbook"), {"law.kind": "sequential-pid"})
    bearing = float(np.arctan2(4.0, -3.0))
    free = {
        "law.anti_windup": "none",
        "goal.x_m": 2.5,
        "goal.y_m": 9.5,
        "start.x_m": 5.5,
        "start.y_m": 5.5,
        "start.heading_rad": bearing - START_RAD,
        "start.precision": "float64",
        "limits.speed_m_s": float("inf"),
        "limits.turn_rate_rad_s": float("inf"),
        "law.heading_tolerance_rad": 1e-15,
        "law.wrap_error": False,
        "loop.pose_precision": "float64",
        "law.kp_angular": kp,
        "max_duration_s": min(SAMPLES * period_s, 29.0),
    }
    return tl.override_scenario(scenario, {**changes, **free})


@pytest.mark.parametrize("seed", range(24))
def test_a_run_settles_below_theorys_limit_and_grows_above_it(seed: int) -> None:
    changes = draw_scenario(seed)
    scenario = build(changes, 1.0, 0.1)
    declaration = tl.simulate.declare_scenario(scenario)
    model = model_loops(declaration, tl.scenario.flatten_scenario(scenario))[0]
    gains, settings = model.require()
    ((_, limit),) = find_stable_gains(gains, **settings)
    for share, grows in [(1.0 - GRID_STEP, False), (1.0 + GRID_STEP, True)]:
        tried = build(changes, share * limit, settings["period_s"])
        found = tl.simulate_run(tried).samples.heading_error_rad
        assert found is not None
        error = np.abs(found)
        third = len(error) // 3
        early, late = error[third : 2 * third].max(), error[2 * third :].max()
        assert (late > early or error.max() > FAR_RAD) == grows
        if model.most_dead_time_s is None:
            assert bool(list_scenario_notes(tried)) == grows
