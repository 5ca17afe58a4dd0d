"""Verdicts on stability: closed forms, companion matrices, and phases counted on a dense grid."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from tests.theory.polynomials import compute_pid_polynomial
from turtlelog.theory import PidGains, compute_pid_step_response, find_stable_gains, is_pid_stable
from turtlelog.theory.pid_stability import NEAREST

TICK_S = 0.016
PI = PidGains(kp=1.0, ki=0.05)
PD = PidGains(kp=1.0, kd=0.2, filter_s=0.1)
PID = PidGains(kp=1.0, ki=0.05, kd=0.1, filter_s=0.5)


def scale(gains: PidGains, kp: float) -> PidGains:
    return PidGains(kp=kp, ki=gains.ki, kd=gains.kd, filter_s=gains.filter_s)


def count_inside(gains: PidGains, dead_time_ticks: int) -> int:
    """Return the roots inside the unit circle, by the phase on a dense grid of frequencies."""
    angles = np.union1d(np.linspace(0.0, np.pi, 200_001), np.geomspace(1e-9, 0.1, 50_001))
    polynomial = compute_pid_polynomial(gains, period_s=TICK_S, dead_time_ticks=dead_time_ticks)
    z, d = np.exp(1j * angles), dead_time_ticks
    low_order = np.polyval(polynomial[-3:], z)
    if d < 3:
        value = np.polyval(polynomial, z)
    else:
        value = np.polyval(polynomial[: len(polynomial) - d], z) * z**d + low_order
    return round(float(np.unwrap(np.angle(value))[-1]) / np.pi)


@pytest.mark.parametrize("ki", [0.0001, 0.3, 20.0, 5000.0])
def test_pi_without_dead_time_is_stable_between_ki_t_and_2_over_t_plus_half_of_it(
    ki: float,
) -> None:
    # Jury's test of z^2 + (p - 2) z + 1 - p + i, p = Kp T and i = Ki T^2.
    (found,) = find_stable_gains(PidGains(kp=1.0, ki=ki), period_s=TICK_S)
    assert found == pytest.approx((ki * TICK_S, 2.0 / TICK_S + 0.5 * ki * TICK_S), rel=1e-9)


@pytest.mark.parametrize(("share", "is_there"), [(1.0 - 1e-6, True), (1.0 + 1e-6, False)])
def test_pi_without_dead_time_has_a_stable_gain_up_to_ki_t2_of_4(
    share: float, *, is_there: bool
) -> None:
    gains = PidGains(kp=1.0, ki=4.0 * share / TICK_S**2)
    assert bool(find_stable_gains(gains, period_s=TICK_S)) == is_there


@pytest.mark.parametrize("kd", [0.001, 0.5, 0.99])
def test_plain_pd_without_dead_time_is_stable_up_to_2_minus_2_kd(kd: float) -> None:
    # Jury's test of z^2 + (p + kd - 1) z - kd.
    (found,) = find_stable_gains(PidGains(kp=1.0, kd=kd), period_s=TICK_S)
    assert found == pytest.approx((0.0, (2.0 - 2.0 * kd) / TICK_S), rel=1e-9)


def test_plain_pd_without_dead_time_has_no_stable_gain_from_kd_of_1_on() -> None:
    assert find_stable_gains(PidGains(kp=1.0, kd=1.0), period_s=TICK_S) == ()
    assert find_stable_gains(PidGains(kp=1.0, kd=1.5), period_s=TICK_S) == ()


@pytest.mark.parametrize("excess", [0.5, 2.0])
def test_a_loop_as_near_to_the_limit_as_rounding_counts_as_unstable(excess: float) -> None:
    # PI without dead time: 1 + L(-1) = (4 + i - 2 p) / 4.
    i = 0.5
    p = 0.5 * (4.0 + i - 4.0 * excess * NEAREST)
    assert is_pid_stable(PidGains(kp=p, ki=i), period_s=1.0) == (excess > 1.0)


@settings(deadline=None)
@given(
    kp=st.floats(-3.0, 2.0),
    ki=st.floats(-5.0, 3.0) | st.none(),
    kd=st.floats(-3.0, 0.5) | st.none(),
    filter_s=st.floats(0.0, 1.0),
    dead_time_ticks=st.integers(0, 12),
)
def test_verdicts_are_those_of_a_companion_matrix_where_it_is_sure(
    kp: float, ki: float | None, kd: float | None, filter_s: float, dead_time_ticks: int
) -> None:
    gains = PidGains(
        kp=10.0**kp,
        ki=0.0 if ki is None else 10.0**ki,
        kd=0.0 if kd is None else 10.0**kd,
        filter_s=filter_s,
    )
    loop: Any = {"period_s": TICK_S, "dead_time_ticks": dead_time_ticks}
    largest = np.abs(np.roots(compute_pid_polynomial(gains, **loop))).max()
    if abs(largest - 1.0) > 1e-6:
        assert is_pid_stable(gains, **loop) == (largest < 1.0)
        inside = [low < gains.kp < high for low, high in find_stable_gains(gains, **loop)]
        assert any(inside) == (largest < 1.0)


@pytest.mark.everyday("0-gains0", "1-gains1", "6-gains2")
@pytest.mark.parametrize("gains", [PI, PD, PID])
@pytest.mark.parametrize("dead_time_ticks", [0, 1, 6, 100, 300, 1000])
def test_both_ends_of_the_stable_gains_divide_stable_from_unstable(
    gains: PidGains, dead_time_ticks: int
) -> None:
    weak = PidGains(kp=1.0, ki=gains.ki / 100.0, kd=gains.kd, filter_s=gains.filter_s)
    loop: Any = {"period_s": TICK_S, "dead_time_ticks": dead_time_ticks}
    ((low, high),) = find_stable_gains(weak, **loop)
    degree = len(compute_pid_polynomial(weak, **loop)) - 1
    for kp, is_stable in [
        (low * (1.0 - 1e-3), False),
        (low * (1.0 + 1e-3) or 1e-4, True),
        (high * (1.0 - 1e-3), True),
        (high * (1.0 + 1e-3), False),
    ]:
        if kp > 0.0:
            assert is_pid_stable(scale(weak, kp), **loop) == is_stable
            assert (count_inside(scale(weak, kp), dead_time_ticks) == degree) == is_stable


def test_a_companion_matrix_errs_where_two_poles_meet_near_one() -> None:
    found = []
    for p in (3e-9, 7e-9, 1.1e-8, 1.3e-8, 2e-8, 3e-8):  # poles at 1 - p / 2, twice
        for dead_time_ticks in (0, 1, 2):
            gains = PidGains(kp=p, ki=0.25 * p * p)
            loop: Any = {"period_s": 1.0, "dead_time_ticks": dead_time_ticks}
            assert is_pid_stable(gains, **loop)
            found.append(np.abs(np.roots(compute_pid_polynomial(gains, **loop))).max() > 1.0)
    assert any(found)


def test_with_100_ticks_a_step_fades_just_inside_the_limits_and_grows_just_outside() -> None:
    loop: Any = {"period_s": TICK_S, "dead_time_ticks": 100}
    gains = PidGains(kp=1.0, ki=0.02, kd=0.1, filter_s=0.2)
    ((low, high),) = find_stable_gains(gains, **loop)
    for kp, fades in [(0.9 * low, False), (1.1 * low, True), (0.95 * high, True)]:
        error = 1.0 - compute_pid_step_response(scale(gains, kp), 60_000, **loop)
        later, earlier = np.abs(error[-20_000:]).max(), np.abs(error[:20_000]).max()
        assert (later < 0.7 * earlier, later > 1.4 * earlier) == (fades, not fades)


@pytest.mark.parametrize("filter_s", [5e-324, 1e-300, 1e-25])
def test_a_filter_of_next_to_nothing_is_as_none(filter_s: float) -> None:
    for kd, is_stable in [(0.1, True), (1.0, False)]:
        gains = PidGains(kp=1.0, kd=kd, filter_s=filter_s)
        assert is_pid_stable(gains, period_s=TICK_S) == is_stable
