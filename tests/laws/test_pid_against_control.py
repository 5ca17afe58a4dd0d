"""The discrete loops as python-control has them, in closed loop with the integrator at 16 ms."""

import math
from typing import Any

import control
import numpy as np
import pytest
from numpy.typing import NDArray

import turtlelog as tl
from tests.laws.sequential_runs import LINEAR
from turtlelog.scenario import override_scenario

PERIOD_S = 0.016
STEPS = 250
KP = 1.5

LOOPS: list[dict[str, Any]] = [
    {},
    {"ki": 0.6},
    {"kd": 0.3},
    {"kd": 0.3, "filter_s": 0.1},
    {"ki": 0.6, "kd": 0.3},
    {"ki": 0.9, "kd": 0.2, "filter_s": 0.05},
    {"ki": 0.6, "kd": 0.3, "filter_s": 0.1, "delay": 4},
]


def respond(
    *, ki: float = 0.0, kd: float = 0.0, filter_s: float = 0.0, delay: int = 0
) -> NDArray[np.float64]:
    """Return the unit step response: of the signal that starts at 0, from the first command on."""
    h = PERIOD_S
    # A command takes effect in the step after its pose: the integrator h / (z - 1), and `delay`.
    plant = control.tf([h], [1.0, -1.0, *([0.0] * delay)], h)
    # Forward Euler: the integral of a sample holds the errors before it.
    forward = control.tf([KP, ki * h - KP], [1.0, -1.0], h)
    # Backward Euler, of the measurement.
    backward = control.tf([kd, -kd], [filter_s + h, -filter_s], h)
    inner = control.feedback(control.ss(plant), control.ss(backward))
    loop = control.feedback(control.ss(forward) * inner, 1)
    times = np.arange(STEPS) * h
    return np.asarray(control.forced_response(loop, times, np.ones(STEPS)).outputs)


def simulate(axis: str, loop: dict[str, Any], **more: Any) -> tl.Run:
    scenario = override_scenario(tl.load_scenario("textbook"), {"law.kind": "sequential-pid"})
    values = {
        **LINEAR,
        "law.timeout_s": (STEPS + 10) * PERIOD_S,
        "max_duration_s": (STEPS + 10) * PERIOD_S,
        f"law.kp_{axis}": KP,
        f"law.ki_{axis}": loop.get("ki", 0.0),
        f"law.kd_{axis}": loop.get("kd", 0.0),
        "law.derivative_filter_s": loop.get("filter_s", 0.0),
        "loop.transport_delay_ticks": loop.get("delay", 0),
        **more,
    }
    return tl.simulate_run(override_scenario(scenario, values))


@pytest.mark.parametrize("loop", LOOPS, ids=str)
def test_heading_loop_is_that_of_python_control(loop: dict[str, Any]) -> None:
    run = simulate("angular", loop)
    assert run.samples.bearing_rad is not None
    read = run.samples.pose_sequence
    # The first callback only computes the bearing.
    heading_rad = run.poses.heading_rad[read][1 : STEPS + 1]
    expected_rad = run.samples.bearing_rad[0] * respond(**loop)
    np.testing.assert_allclose(heading_rad, expected_rad, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("loop", LOOPS, ids=str)
@pytest.mark.parametrize("projection", ["bearing", "heading"])
def test_position_loop_is_that_of_python_control(loop: dict[str, Any], projection: str) -> None:
    # It looks at the goal already: the rotation ends at once.
    place = {"start.x_m": 2.0, "start.y_m": 5.0, "goal.x_m": 6.0, "goal.y_m": 5.0}
    run = simulate("linear", loop, **place, **{"law.projection": projection})
    rows = np.flatnonzero(np.array(run.phase_names)[run.samples.phase] == "translate")[:STEPS]
    x_m = run.poses.xy_m[run.samples.pose_sequence[rows], 0]
    assert len(rows) == STEPS
    np.testing.assert_allclose(x_m - 2.0, 4.0 * respond(**loop), rtol=0.0, atol=1e-9)


def test_states_are_what_they_add_to_the_command() -> None:
    run = simulate("angular", {"ki": 0.6, "kd": 0.3, "filter_s": 0.1})
    samples = run.samples
    assert samples.states is not None
    assert samples.wanted_turn_rate_rad_s is not None
    assert samples.heading_error_rad is not None
    integral, derivative = samples.states[:, 0], samples.states[:, 1]
    rows = slice(1, STEPS)
    wanted = KP * samples.heading_error_rad + integral + derivative
    np.testing.assert_allclose(samples.wanted_turn_rate_rad_s[rows], wanted[rows], atol=1e-15)
    error_s = np.cumsum(samples.heading_error_rad[1:STEPS]) * PERIOD_S
    np.testing.assert_allclose(integral[2 : STEPS + 1], 0.6 * error_s, atol=1e-12)
    assert np.abs(derivative).max() > 0.1
    assert not samples.states[:, 2:].any()


def test_difference_of_headings_goes_across_the_half_turn() -> None:
    # From 3.0 to -2.9 over pi: without wrapping the derivative would see 6 rad in one sample.
    x_m, y_m = 5.0 + 3.0 * math.cos(-2.9), 5.0 + 3.0 * math.sin(-2.9)
    place = {"start.x_m": 5.0, "start.y_m": 5.0, "start.heading_rad": 3.0}
    loop: dict[str, Any] = {"ki": 0.6, "kd": 0.3}
    run = simulate("angular", loop, **place, **{"goal.x_m": x_m, "goal.y_m": y_m})
    turned_rad = np.unwrap(run.poses.heading_rad[run.samples.pose_sequence][1 : STEPS + 1]) - 3.0
    step_rad = 2.0 * math.pi - 5.9
    # turtlesim wraps with eight decimals of pi.
    np.testing.assert_allclose(turned_rad, step_rad * respond(**loop), rtol=0.0, atol=2e-8)
