"""Loops around robots with limits: what theory knows of them, and what it leaves out."""

from typing import Any

import pytest

import turtlelog as tl
from turtlelog.simulate import list_scenario_notes
from turtlelog.theory import LoopModel

LIMITS = {"limits.turn_rate_rad_s": 2.0, "limits.speed_m_s": 1.0}
LAG = {"plant.turn_lag_s": 0.1, "plant.speed_lag_s": 0.1}


def build(**changes: Any) -> tl.Scenario:
    values = {key.replace("__", "."): value for key, value in changes.items()}
    return tl.override_scenario(tl.load_scenario("lagged"), {**LIMITS, **LAG, **values})


def model(**changes: Any) -> LoopModel:
    scenario = build(**changes)
    declaration = tl.simulate.declare_scenario(scenario)
    loops = tl.theory.model_loops(declaration, tl.scenario.flatten_scenario(scenario))
    return next(loop for loop in loops if loop.loop.name == "rotate")


@pytest.mark.parametrize(
    ("changes", "ramp_s"),
    [
        ({}, 0.0),
        # 2 rad/s at 4 rad/s^2 take 0.5 s, of which the time constant explains 0.1 s.
        ({"plant__turn_acceleration": 4.0}, 0.2 * 0.4),
        ({"plant__turn_acceleration": 4.0, "plant__turn_bound": 1.0}, 0.2 * 0.15),
        ({"plant__turn_acceleration": 4.0, "plant__turn_gain": 0.5}, 0.2 * 0.15),
        ({"plant__turn_acceleration": 20.1}, 0.0),
        ({"plant__speed_acceleration": 1.0}, 0.0),
        ({"limits__turn_acceleration_rad_s2": 4.0}, 0.2 * 0.5),
        ({"limits__turn_acceleration_rad_s2": 4.0, "plant__turn_gain": 0.5}, 0.2 * 0.5),
        ({"limits__turn_acceleration_rad_s2": 4.0, "limits__turn_rate_rad_s": float("inf")}, 0.0),
        (
            {
                "limits__turn_acceleration_rad_s2": 4.0,
                "limits__turn_rate_rad_s": float("inf"),
                "plant__turn_bound": 1.0,
            },
            0.2 * 0.25,
        ),
    ],
)
def test_a_limit_of_the_acceleration_counts_as_a_fifth_of_its_longest_ramp(
    changes: dict[str, float], ramp_s: float
) -> None:
    found = model(**changes)
    assert found.ramp_s == pytest.approx(ramp_s)
    slowest = found.require_slowest()["process"]
    assert slowest.lag_s == pytest.approx(0.1 + ramp_s)
    # The loop itself is the linear one, of small steps.
    assert found.require()[1]["process"].lag_s == 0.1


def test_a_loop_has_the_larger_gain_of_both_directions() -> None:
    gains = [(0.9, 0.7), (0.7, 0.9)]
    found = [model(plant__turn_gain=one, plant__turn_reverse_gain=other) for one, other in gains]
    assert [one.require()[1]["process"].gain for one in found] == [0.9, 0.9]
    assert "plant.turn_reverse_gain = 0.7" in found[0].left_out


def test_what_theory_leaves_out_of_a_robot_with_limits_is_named() -> None:
    limits = {
        "plant__turn_acceleration": 4.0,
        "plant__turn_bound": 1.0,
        "plant__turn_deadband": 0.1,
    }
    found = model(**limits, plant__speed_bound=0.5).left_out
    own = [name for name in found if name.startswith("plant.")]
    assert own == [
        "plant.turn_bound = 1",
        "plant.turn_acceleration = 4",
        "plant.turn_deadband = 0.1",
    ]


@pytest.mark.parametrize(
    ("limits", "is_told"),
    [
        ({}, True),
        ({"plant__turn_bound": 0.5, "plant__turn_acceleration": 2.0}, True),
        # The loop may come to rest within a deadband, and have the smaller gain.
        ({"plant__turn_deadband": 0.1}, False),
        ({"plant__turn_reverse_gain": 0.1}, False),
    ],
)
def test_a_loop_is_called_unstable_where_no_limit_can_steady_it(
    limits: dict[str, float], *, is_told: bool
) -> None:
    notes = list_scenario_notes(build(law__kp_angular=30.0, **limits))
    assert any("becomes unstable" in note for note in notes) is is_told


def test_a_gain_backwards_of_the_wrong_sign_is_told() -> None:
    notes = list_scenario_notes(build(plant__turn_reverse_gain=-0.5))
    assert any("plant.turn_reverse_gain = -0.5 feeds the error back" in note for note in notes)


@pytest.mark.parametrize("key", ["plant.turn_gain", "plant.turn_reverse_gain"])
def test_a_gain_of_the_wrong_sign_has_no_model(key: str) -> None:
    name = key.replace(".", "__")
    wrong = model(**{name: -0.01})
    assert wrong.reason == (
        f"{key} = -0.01 feeds the error back with the wrong sign, so no gain above 0 is stable"
    )
    assert not model(**{name: 0.01}).reason
