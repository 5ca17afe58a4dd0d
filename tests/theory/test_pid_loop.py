"""The sampled PID loop, held against python-control, closed forms and its own recursion."""

from dataclasses import replace
from typing import Any

import control
import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray

import turtlelog as tl
from tests.theory.polynomials import compute_pid_polynomial
from turtlelog.errors import TheoryError
from turtlelog.theory import (
    PidGains,
    analyse_pid_loop,
    analyse_sampled_loop,
    compute_pid_locus,
    compute_pid_poles,
    compute_pid_step_response,
    compute_sampled_poles,
    compute_sampled_step_response,
    compute_stability_gain,
    compute_steady_error,
    find_stable_gains,
    is_pid_stable,
)

TICK_S = 0.016
DEAD_TIMES = range(13)
P = PidGains(kp=4.0)
PI = PidGains(kp=4.0, ki=1.0)
PD = PidGains(kp=4.0, kd=0.2, filter_s=0.05)
PLAIN_PD = PidGains(kp=4.0, kd=0.2)
PID = PidGains(kp=4.0, ki=2.0, kd=0.2, filter_s=0.05)
PLAIN_PID = PidGains(kp=4.0, ki=2.0, kd=0.05)
ALL = [P, PI, PD, PLAIN_PD, PID, PLAIN_PID]


def build_parts(gains: PidGains, dead_time_ticks: int) -> tuple[Any, Any, Any]:
    """Return plant, P and I on the error, and D on the measurement, of python-control."""
    plant = control.sample_system(control.tf([1.0], [1.0, 0.0]), TICK_S, method="zoh")
    plant = plant * control.tf([1.0], [1.0] + [0.0] * dead_time_ticks, dt=TICK_S)
    forward = control.tf([gains.kp], [1.0], dt=TICK_S)
    if gains.ki:
        forward = forward + control.tf([gains.ki * TICK_S], [1.0, -1.0], dt=TICK_S)
    back = control.tf([0.0], [1.0], dt=TICK_S)
    if gains.kd:
        whole_s = gains.filter_s + TICK_S
        rate, keep = gains.kd / whole_s, gains.filter_s / whole_s
        back = control.tf([rate, -rate], [1.0, -keep], dt=TICK_S)
    return plant, forward, back


def measure_distance(left: NDArray[np.complex128], right: NDArray[np.complex128]) -> float:
    """Return how far the loneliest pole of either set is from the other set."""
    assert left.shape == right.shape
    distances = np.abs(left[:, None] - right)
    return float(max(distances.min(axis=0).max(), distances.min(axis=1).max()))


@pytest.mark.parametrize("dead_time_ticks", DEAD_TIMES)
@pytest.mark.parametrize("gains", ALL)
def test_the_poles_are_those_of_python_control(gains: PidGains, dead_time_ticks: int) -> None:
    plant, forward, back = build_parts(gains, dead_time_ticks)
    expected = np.asarray(control.feedback(plant, forward + back).poles(), dtype=np.complex128)
    poles = compute_pid_poles(gains, period_s=TICK_S, dead_time_ticks=dead_time_ticks)
    assert measure_distance(poles, expected) < 1e-9
    assert (np.diff(np.abs(poles)) < 1e-11).all()


@pytest.mark.parametrize("dead_time_ticks", [0, 1, 6])
@pytest.mark.parametrize("gains", ALL)
def test_the_step_response_is_that_of_python_control(gains: PidGains, dead_time_ticks: int) -> None:
    plant, forward, back = build_parts(gains, dead_time_ticks)
    closed = control.feedback(plant, forward + back) * forward
    if gains.ki:  # the integral's pole and zero at z = 1, and what rounding leaves of them
        closed = control.feedback(control.feedback(plant, back) * forward, 1.0)
    time_s = np.arange(200) * TICK_S
    expected = control.forced_response(closed, time_s, np.ones(200)).outputs
    response = compute_pid_step_response(
        gains, 200, period_s=TICK_S, dead_time_ticks=dead_time_ticks
    )
    assert response == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("dead_time_ticks", [0, 1, 6, 100, 1000])
@pytest.mark.parametrize("kp", [0.05, 1.0, 10.0, 124.0, 126.0])
def test_p_alone_is_what_the_sampled_loop_says(kp: float, dead_time_ticks: int) -> None:
    settings: Any = {"period_s": TICK_S, "dead_time_ticks": dead_time_ticks}
    found = analyse_pid_loop(PidGains(kp=kp, filter_s=0.1), **settings)
    known = analyse_sampled_loop(kp, **settings)
    assert np.array_equal(found.poles, compute_sampled_poles(kp, **settings))
    assert (found.stable, found.overshoot_percent, found.settling_time_s) == (
        known.stable,
        known.overshoot_percent,
        known.settling_time_s,
    )
    assert found.stable_gains == ((0.0, compute_stability_gain(TICK_S, dead_time_ticks)),)
    response = compute_pid_step_response(PidGains(kp=kp), 300, **settings)
    expected = compute_sampled_step_response(kp, 300, **settings)
    assert response == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_the_gain_at_the_limit_of_p_is_not_stable() -> None:
    limit = compute_stability_gain(TICK_S)
    assert not is_pid_stable(PidGains(kp=limit), period_s=TICK_S)
    assert is_pid_stable(PidGains(kp=limit * (1.0 - 1e-15)), period_s=TICK_S)


def test_two_poles_that_meet_without_dead_time_are_exact() -> None:
    poles = compute_pid_poles(PidGains(kp=2.0, ki=1.0), period_s=0.5)  # (z - 1/2)^2
    assert poles.tolist() == [0.5, 0.5]
    poles = compute_pid_poles(PidGains(kp=0.25, kd=0.25), period_s=1.0)  # (z - 1/2) (z + 0) ...
    assert sorted(poles.real.tolist()) == pytest.approx([-0.309017, 0.809017], abs=1e-6)


def test_three_poles_that_meet_are_known_to_a_third_of_the_digits() -> None:
    gains = PidGains(kp=1.0 / 3.0, ki=1.0 / 27.0)  # z (z - 1)^2 + (z - 1) / 3 + 1 / 27
    loop = analyse_pid_loop(gains, period_s=1.0, dead_time_ticks=1)
    assert loop.poles == pytest.approx(np.full(3, 2.0 / 3.0), abs=1e-4)
    assert loop.stable


@given(
    kp=st.floats(0.01, 60.0),
    ki=st.floats(0.0, 40.0),
    kd=st.floats(0.0, 1.5),
    filter_s=st.floats(0.0, 1.0),
    dead_time_ticks=st.integers(0, 40),
)
def test_the_poles_multiply_to_the_polynomial(
    kp: float, ki: float, kd: float, filter_s: float, dead_time_ticks: int
) -> None:
    gains = PidGains(kp=kp, ki=ki, kd=kd, filter_s=filter_s)
    settings: Any = {"period_s": TICK_S, "dead_time_ticks": dead_time_ticks}
    at = 1.2 * np.exp(1j * np.linspace(0.1, 3.0, 7))
    expected = np.polyval(compute_pid_polynomial(gains, **settings), at)
    product = np.prod(at[:, None] - compute_pid_poles(gains, **settings), axis=1)
    assert product == pytest.approx(expected, rel=1e-7)


@pytest.mark.everyday("0.0-4.0-40000-20", "0.2-1.0-40000-3", "0.2-4.0-40000-0")
@pytest.mark.parametrize("dead_time_ticks", [0, 3, 20])
@pytest.mark.parametrize(("ki", "samples"), [(0.01, 400_000), (1.0, 40_000), (4.0, 40_000)])
@pytest.mark.parametrize("kd", [0.0, 0.2])
def test_an_integral_makes_the_error_sum_to_zero_and_so_overshoots(
    kd: float, ki: float, samples: int, dead_time_ticks: int
) -> None:
    gains = PidGains(kp=2.0, ki=ki, kd=kd, filter_s=0.1)
    settings: Any = {"period_s": TICK_S, "dead_time_ticks": dead_time_ticks}
    loop = analyse_pid_loop(gains, **settings)
    assert loop.stable
    assert loop.overshoot_percent is not None
    assert loop.overshoot_percent > 0.0
    error = 1.0 - compute_pid_step_response(gains, samples, **settings)
    assert abs(error.sum()) < 1e-6 * np.abs(error).sum()


def test_p_with_a_small_gain_does_not_overshoot_where_pi_does() -> None:
    assert analyse_pid_loop(PidGains(kp=2.0), period_s=TICK_S).overshoot_percent == 0.0
    loop = analyse_pid_loop(PidGains(kp=2.0, ki=1.0), period_s=TICK_S)
    # Both continuous poles at -1: y = 1 - (1 - t) exp(-t), furthest at t = 2, by exp(-2).
    assert loop.overshoot_percent == pytest.approx(100.0 * np.exp(-2.0), rel=0.02)


@pytest.mark.parametrize("gains", ALL)
@pytest.mark.parametrize("push", [0.5, -2.0])
def test_a_push_leaves_the_steady_error_that_theory_says(gains: PidGains, push: float) -> None:
    response = compute_pid_step_response(
        gains, 20_000, period_s=TICK_S, dead_time_ticks=3, push=push
    )
    expected = compute_steady_error(gains, push)
    assert 1.0 - response[-1] == pytest.approx(expected, abs=1e-9)
    assert expected == (0.0 if gains.ki else -push / 4.0)


def test_an_unstable_response_is_stopped() -> None:
    response = compute_pid_step_response(PidGains(kp=1.0, ki=300.0), 5000, period_s=TICK_S)
    assert np.isfinite(response).all()
    assert abs(1.0 - response[-1]) == 1e9
    loop = analyse_pid_loop(PidGains(kp=1.0, ki=300.0), period_s=TICK_S)
    assert (loop.stable, loop.overshoot_percent, loop.settling_time_s) == (False, None, None)
    assert loop.largest_magnitude > 1.0


@pytest.mark.parametrize(("slow", "is_measured"), [(2.35e-5, False), (2.45e-5, True)])
def test_a_response_slower_than_500000_samples_is_not_measured(
    slow: float, *, is_measured: bool
) -> None:
    loop = analyse_pid_loop(PidGains(kp=0.5, ki=0.5 * slow), period_s=1.0)
    assert loop.stable
    assert (loop.overshoot_percent is not None) == is_measured


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"kp": 0.0}, "kp: expected a gain > 0, found 0.0"),
        ({"kp": 1.0, "ki": -1.0}, "ki: expected a number from 0 to 1e.100, found -1.0"),
        ({"kp": 1.0, "kd": float("nan")}, "kd: expected a number from 0 to 1e.100, found nan"),
        ({"kp": 1.0, "filter_s": float("inf")}, "filter_s: expected a number from"),
        ({"kp": 1.0, "kd": True}, "kd: expected a number from 0 to 1e.100, found True"),
    ],
)
def test_gains_that_are_none_are_refused(values: dict[str, float], message: str) -> None:
    with pytest.raises(TheoryError, match=message):
        PidGains(**values)


@pytest.mark.parametrize(
    ("gains", "message"),
    [
        (PidGains(kp=0.9e-9, ki=1.0), r"^Kp T: expected a loop gain from 1e-09 to 1e\+09"),
        (PidGains(kp=1.0, ki=1.1e9), r"^Ki T\^2: expected a loop gain from 0 to 1e\+09"),
        (PidGains(kp=1.0, kd=1.1e9), r"^Kd T / \(Tf \+ T\): expected a loop gain from 0"),
    ],
)
def test_loop_gains_out_of_all_proportion_are_refused(gains: PidGains, message: str) -> None:
    with pytest.raises(TheoryError, match=message):
        compute_pid_poles(gains, period_s=1.0)
    assert compute_pid_poles(PidGains(kp=1.1e-9, ki=0.9e9), period_s=1.0).shape == (2,)


def test_period_dead_time_and_count_are_judged_as_elsewhere() -> None:
    with pytest.raises(TheoryError, match=r"^period_s: expected a sampling period > 0, found 0"):
        is_pid_stable(PI, period_s=0)
    with pytest.raises(TheoryError, match=r"^dead_time_ticks: expected a whole number from 0"):
        find_stable_gains(PI, period_s=TICK_S, dead_time_ticks=1001)
    with pytest.raises(TheoryError, match=r"^count: expected a whole number from 1"):
        compute_pid_step_response(PI, 0, period_s=TICK_S)


@pytest.mark.parametrize("gains", ALL)
def test_the_law_sequential_pid_responds_as_theory_says(gains: PidGains) -> None:
    values = {
        "law.kind": "sequential-pid",
        "law.kp_angular": gains.kp,
        "law.ki_angular": gains.ki,
        "law.kd_angular": gains.kd,
        "law.derivative_filter_s": gains.filter_s,
        "law.heading_tolerance_rad": 1e-9,
        "limits.turn_rate_rad_s": float("inf"),
        "loop.transport_delay_ticks": 3,
        "loop.pose_precision": "float64",
        "max_duration_s": 2.0,
    }
    run = tl.simulate_run(tl.override_scenario(tl.load_scenario("textbook"), values))
    error = run.samples.heading_error_rad
    assert error is not None
    # The first sample, whose command is 0, only computes the bearing.
    response = compute_pid_step_response(gains, 100, period_s=TICK_S, dead_time_ticks=3)
    assert error[1:101] / error[1] == pytest.approx(1.0 - response, abs=1e-7)


@pytest.mark.parametrize("held", [PidGains(kp=1.0), PidGains(kp=1.0, ki=0.5, kd=0.1)])
def test_a_locus_has_the_poles_at_each_gain(held: PidGains) -> None:
    settings: Any = {"period_s": 0.1, "dead_time_ticks": 3}
    alone = [compute_pid_poles(replace(held, kp=kp), **settings) for kp in (0.5, 1.0, 2.0)]
    found = compute_pid_locus(held, (0.5, 1.0, 2.0), **settings)
    np.testing.assert_array_equal(found, np.concatenate(alone))
