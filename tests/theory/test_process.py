"""Loops with lag, gain, low-pass and any dead time: by state space, simulation and formulas."""

import math
from dataclasses import replace
from typing import Any

import control
import numpy as np
import pytest
from scipy.linalg import expm

from tests.theory.polynomials import compute_pid_polynomial, expand_transfer_function
from turtlelog.errors import TheoryError
from turtlelog.theory import (
    PidGains,
    Process,
    analyse_pid_loop,
    analyse_sampled_loop,
    compute_open_loop,
    compute_pid_poles,
    compute_pid_step_response,
    compute_stability_gain,
    compute_steady_error,
    find_stable_gains,
    is_pid_stable,
)
from turtlelog.theory.process import _rest

T = 0.05

GRID_STEP = 0.04
"""Share of a limit between the gains that are tried on either side of it."""


def draw_loop(rng: np.random.Generator) -> tuple[PidGains, Process, int]:
    """Return a loop of any kind whose dead time is a twentieth of a sample or a multiple."""

    def perhaps(low: float, high: float) -> float:
        return float(rng.choice([0.0, 10.0 ** rng.uniform(low, high)]))

    gains = PidGains(
        kp=10.0 ** rng.uniform(-1, 1.3),
        ki=perhaps(-2, 1),
        kd=perhaps(-2, -0.3),
        filter_s=perhaps(-2, 0),
    )
    process = Process(
        gain=float(rng.uniform(0.5, 2.0)),
        lag_s=perhaps(-2.5, 0.5),
        dead_time_s=int(rng.integers(0, 70)) * T / 20.0,
        low_pass_s=perhaps(-2, 0),
    )
    return gains, process, int(rng.integers(0, 3))


def integrate_loop(
    gains: PidGains, process: Process, dead_time_ticks: int, count: int
) -> np.ndarray[Any, Any]:
    """Return the step response by the classical Runge-Kutta method, 40 steps in each sample."""
    steps = 40
    h, delay = T / steps, round((process.dead_time_s / T + dead_time_ticks) * steps)
    held = [0.0] * delay
    y = v = last = integral = derivative = filtered = 0.0
    found = []
    for _ in range(count):
        found.append(y)
        integral_now, error = integral, 1.0 - y
        whole_s = gains.filter_s + T
        derivative = (gains.filter_s * derivative - gains.kd * (y - last)) / whole_s
        command = gains.kp * error + integral_now + derivative
        integral, last = integral + gains.ki * T * error, y
        if process.low_pass_s > 0.0:
            filtered += (1.0 - math.exp(-T / process.low_pass_s)) * (command - filtered)
            command = filtered
        held += [process.gain * command] * steps
        for _ in range(steps):
            w = held.pop(0)
            if process.lag_s == 0.0:
                y += h * w
                continue
            a1 = (w - v) / process.lag_s
            v2 = v + 0.5 * h * a1
            a2 = (w - v2) / process.lag_s
            v3 = v + 0.5 * h * a2
            a3 = (w - v3) / process.lag_s
            v4 = v + h * a3
            a4 = (w - v4) / process.lag_s
            y += h * (v + 2.0 * v2 + 2.0 * v3 + v4) / 6.0
            v += h * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0
        if abs(y) > 1e6:
            break
    return np.array(found)


@pytest.mark.parametrize("seed", range(6))
def test_integration_grows_above_each_limit_and_fades_below_within_a_grid_step(seed: int) -> None:
    gains, process, ticks = draw_loop(np.random.default_rng(2000 + seed))
    loop: Any = {"period_s": T, "dead_time_ticks": ticks, "process": process}
    gains = replace(gains, ki=0.02 * gains.ki)
    *_, (low, high) = find_stable_gains(gains, **loop)
    assert low < high
    for share, grows in [(1.0 - GRID_STEP, False), (1.0 + GRID_STEP, True)]:
        found = integrate_loop(replace(gains, kp=share * high), process, ticks, 240)
        # An integral makes the mean creep; its changes swing at the limit's frequency.
        swing = np.abs(np.diff(found))
        early, late = swing[60:150].max(initial=0.0), swing[150:].max(initial=0.0)
        assert (late > early or len(found) < 240) == grows


def build_matrix(gains: PidGains, process: Process, dead_time_ticks: int) -> np.ndarray[Any, Any]:
    """Return the closed loop's transition matrix: matrix exponentials and stored commands."""
    total = process.dead_time_s / T + dead_time_ticks
    d = math.floor(total + 1e-9)
    late = max(total - d, 0.0) * T
    if process.lag_s > 0.0:
        a = np.array([[0.0, 1.0], [0.0, -1.0 / process.lag_s]])
        b = np.array([[0.0], [process.gain / process.lag_s]])
    else:
        a, b = np.zeros((1, 1)), np.array([[process.gain]])
    n = len(a)

    def hold(time_s: float) -> tuple[Any, Any]:
        block = expm(np.block([[a, b], [np.zeros((1, n + 1))]]) * time_s)
        return block[:n, :n], block[:n, n:]

    phi, _ = hold(T)
    after, newer = hold(T - late)
    older = after @ hold(late)[1]
    # States: plant, u[k-1] ... u[k-d-1], integral, derivative, y[k-1], filter.
    size = n + d + 1 + 4
    at = {"i": n + d + 1, "d": n + d + 2, "y": n + d + 3, "f": n + d + 4}
    keep, rate = gains.filter_s / (gains.filter_s + T), gains.kd / (gains.filter_s + T)
    now_d = np.zeros(size)
    now_d[at["d"]], now_d[0], now_d[at["y"]] = keep, -rate, rate
    u = now_d.copy()
    u[0] -= gains.kp
    u[at["i"]] += 1.0
    if process.low_pass_s > 0.0:
        gap = 1.0 - math.exp(-T / process.low_pass_s)
        u = gap * u
        u[at["f"]] += 1.0 - gap
    found = np.zeros((size, size))
    found[:n, :n] = phi
    newest = [u, *np.eye(size)[n : n + d + 1]]  # u[k], u[k-1] ... u[k-d-1]
    found[:n] += newer * newest[d] + older * newest[d + 1]
    for row, command in enumerate(newest[: d + 1]):
        found[n + row] = command
    found[at["i"], at["i"]], found[at["i"], 0] = 1.0, -gains.ki * T
    found[at["d"]], found[at["f"]] = now_d, u
    found[at["y"], 0] = 1.0
    return found


@pytest.mark.parametrize("seed", range(8))
def test_a_step_response_is_that_of_brute_force_integration(seed: int) -> None:
    gains, process, ticks = draw_loop(np.random.default_rng(seed))
    expected = integrate_loop(gains, process, ticks, 60)
    found = compute_pid_step_response(gains, 60, period_s=T, dead_time_ticks=ticks, process=process)
    assert found[: len(expected)] == pytest.approx(expected, rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("seed", range(60))
def test_poles_and_verdict_are_those_of_the_transition_matrix(seed: int) -> None:
    gains, process, ticks = draw_loop(np.random.default_rng(1000 + seed))
    loop: Any = {"period_s": T, "dead_time_ticks": ticks, "process": process}
    found = compute_pid_poles(gains, **loop)
    matrix = build_matrix(gains, process, ticks)
    for pole in found:  # each is an eigenvalue: the matrix less the pole has no full rank
        values = np.linalg.svd(matrix - pole * np.eye(len(matrix)), compute_uv=False)
        assert values[-1] < 1e-7 * values[0]
    largest = np.abs(np.linalg.eigvals(matrix)).max()
    if gains.ki == 0.0:  # the integral of nothing stays where it is
        size = len(matrix) - 4
        kept = [k for k in range(len(matrix)) if k != size]
        largest = np.abs(np.linalg.eigvals(matrix[np.ix_(kept, kept)])).max()
    if abs(largest - 1.0) > 1e-6:
        assert is_pid_stable(gains, **loop) == (largest < 1.0)
        inside = [low < gains.kp < high for low, high in find_stable_gains(gains, **loop)]
        assert any(inside) == (largest < 1.0)
    polynomial = compute_pid_polynomial(gains, **loop)
    assert len(polynomial) == len(found) + 1


def test_every_number_without_lag_and_low_pass_is_that_of_whole_ticks() -> None:
    gains = PidGains(kp=4.0, ki=1.0, kd=0.1, filter_s=0.1)
    for delay in (Process(dead_time_s=6 * 0.016), Process(dead_time_s=0.016)):
        ticks = round(delay.dead_time_s / 0.016)
        for some in (gains, PidGains(kp=10.0)):
            by_time = analyse_pid_loop(some, period_s=0.016, process=delay)
            by_ticks = analyse_pid_loop(some, period_s=0.016, dead_time_ticks=ticks)
            assert by_time.poles.tolist() == by_ticks.poles.tolist()
            assert by_time.stable_gains == by_ticks.stable_gains
            assert by_time.overshoot_percent == by_ticks.overshoot_percent
            assert by_time.settling_time_s == by_ticks.settling_time_s
            assert by_time.margins == by_ticks.margins
            assert by_time.dead_time_s == pytest.approx(by_ticks.dead_time_s)


@pytest.mark.parametrize(("part", "is_whole"), [(0.9e-9, True), (1.1e-9, False)])
def test_a_dead_time_within_a_billionth_of_a_sample_is_whole(
    part: float, *, is_whole: bool
) -> None:
    poles = compute_pid_poles(
        PidGains(kp=4.0), period_s=T, process=Process(dead_time_s=(2.0 + part) * T)
    )
    assert len(poles) == (3 if is_whole else 4)


def test_p_with_part_of_a_sample_has_jurys_limits() -> None:
    # z^2 + (g w0 - 1) z + g w2 with w0 + w2 = 1: stable below g = 2 / (1 - 2 w2), and below 1 / w2.
    for part, limit in [(0.25, 4.0), (0.5, 2.0), (0.75, 4.0 / 3.0), (0.1, 2.5)]:
        process = Process(dead_time_s=part * T, gain=2.0)
        ((low, high),) = find_stable_gains(PidGains(kp=1.0), period_s=T, process=process)
        assert (low, high * T * 2.0) == pytest.approx((0.0, limit), rel=1e-9)


def test_p_with_lag_sampled_fast_has_the_limit_of_routh_and_hurwitz() -> None:
    # tau s^3 ... no dead time: never unstable; sampling and hold act as half a period of delay.
    process = Process(lag_s=1.0, gain=0.8)
    ((_, high),) = find_stable_gains(PidGains(kp=1.0), period_s=1e-4, process=process)
    assert high * 0.8 == pytest.approx(2.0 / 1e-4, rel=1e-3)
    # PI: s^3 + s^2 + K Kp s + K Ki is stable for Kp > tau Ki.
    gains = PidGains(kp=1.0, ki=0.3)
    ((low, _),) = find_stable_gains(gains, period_s=1e-4, process=process)
    assert low == pytest.approx(0.3, rel=2e-3)


def test_jurys_limit_of_p_with_lag() -> None:
    # z^2 - (1 + e - g w1) z + e + g w0 with g = K Kp T (1 - e): unstable from e + g w0 = 1 on.
    lag, e = 0.2, math.exp(-T / 0.2)
    a = T / lag
    w1 = (math.exp(-a) - 1.0 + a) / (a * (1.0 - e))
    limit = 1.0 / (T * (1.0 - w1))
    ((low, high),) = find_stable_gains(PidGains(kp=1.0), period_s=T, process=Process(lag_s=lag))
    assert (low, high) == pytest.approx((0.0, limit), rel=1e-9)


@pytest.mark.parametrize(("share", "adds_a_pole"), [(0.99e-3, False), (1.01e-3, True)])
def test_a_lag_below_a_thousandth_of_a_sample_is_none(share: float, *, adds_a_pole: bool) -> None:
    for process in (Process(lag_s=share * T), Process(low_pass_s=share * T)):
        loop = analyse_pid_loop(PidGains(kp=4.0), period_s=T, process=process)
        assert len(loop.poles) == 1 + adds_a_pole
        assert loop.poles[0] == pytest.approx(1.0 - 4.0 * T, abs=1e-3)


@pytest.mark.parametrize("ticks", [0, 3, 40])
@pytest.mark.parametrize("lag_s", [1e3, 1e5])
def test_a_long_lag_makes_a_double_integrator(ticks: int, lag_s: float) -> None:
    # P on K / (tau s^2) is unstable at any gain; the small damping 1 / tau leaves a small limit.
    loop: Any = {"period_s": T, "dead_time_ticks": ticks, "process": Process(lag_s=lag_s)}
    ((low, high),) = find_stable_gains(PidGains(kp=1.0), **loop)
    assert low == 0.0
    # Kp (L + T / 2) < 1 where tau is long, for the crossover is slow beside T.
    assert high * (ticks + 0.5) * T == pytest.approx(1.0, rel=2e-2)
    for share, is_stable in [(1.0 - 1e-3, True), (1.0 + 1e-3, False)]:
        assert is_pid_stable(PidGains(kp=share * high), **loop) == is_stable


@pytest.mark.parametrize("seed", range(12))
def test_margins_and_frequency_response_are_those_of_python_control(seed: int) -> None:
    gains, process, ticks = draw_loop(np.random.default_rng(500 + seed))
    loop: Any = {"period_s": T, "dead_time_ticks": ticks, "process": process}
    plant = control.tf(*expand_transfer_function(gains, **loop), T)
    frequencies = np.geomspace(0.05, 0.999 * math.pi / T, 40)
    expected = plant(np.exp(1j * frequencies * T))
    assert compute_open_loop(gains, frequencies, **loop) == pytest.approx(expected, rel=1e-6)
    found = analyse_pid_loop(gains, **loop).margins
    if found is None:
        return
    assert found.phase_margin_rad is not None
    assert found.crossover_rad_s is not None
    (value,) = compute_open_loop(gains, [found.crossover_rad_s], **loop)
    assert abs(value) == pytest.approx(1.0, rel=1e-9)
    assert value / abs(value) == pytest.approx(-np.exp(1j * found.phase_margin_rad), rel=1e-9)
    # Its roots of polynomials, here, are good to three digits.
    gain, phase_deg, *_ = control.stability_margins(plant, method="poly")
    assert found.phase_margin_rad == pytest.approx(math.radians(phase_deg), rel=2e-3)
    if found.gain_margin is not None and math.isfinite(gain) and gain > 1.0:
        assert found.gain_margin == pytest.approx(gain, rel=2e-3)


def test_margins_of_p_are_those_of_the_closed_forms() -> None:
    for ticks in (0, 1, 6, 300):
        known = analyse_sampled_loop(0.3 / (ticks + 1), period_s=1.0, dead_time_ticks=ticks)
        gains = PidGains(kp=0.3 / (ticks + 1))
        margins = analyse_pid_loop(gains, period_s=1.0, dead_time_ticks=ticks).margins
        assert margins is not None
        assert margins.gain_margin == pytest.approx(known.gain_margin, rel=1e-9)
        assert margins.phase_margin_rad == pytest.approx(known.phase_margin_rad, rel=1e-9)
        assert margins.delay_margin_s == pytest.approx(known.delay_margin_s, rel=1e-9)
        assert margins.gain_reduction is None


@pytest.mark.parametrize("gains", [PidGains(kp=2.0, ki=0.5), PidGains(kp=4.0, kd=0.2)])
def test_a_loop_becomes_unstable_where_its_margins_end(gains: PidGains) -> None:
    process = Process(lag_s=0.1, dead_time_s=0.08, low_pass_s=0.05)
    margins = analyse_pid_loop(gains, period_s=T, process=process).margins
    assert margins is not None
    assert margins.gain_margin is not None
    assert margins.delay_margin_s is not None
    for share, is_stable in [(1.0 - 1e-6, True), (1.0 + 1e-6, False)]:
        k = share * margins.gain_margin
        more = PidGains(kp=k * gains.kp, ki=k * gains.ki, kd=k * gains.kd)
        assert is_pid_stable(more, period_s=T, process=process) == is_stable
    whole = math.floor(margins.delay_margin_s / T)
    verdicts = [
        is_pid_stable(gains, period_s=T, dead_time_ticks=ticks, process=process)
        for ticks in (whole, whole + 1)
    ]
    assert verdicts == [True, False]


def test_p_alone_on_an_integrator_with_a_gain_is_p_of_the_product() -> None:
    loop = analyse_pid_loop(PidGains(kp=5.0), period_s=0.016, process=Process(gain=2.0))
    known = analyse_sampled_loop(10.0, period_s=0.016)
    assert loop.poles.tolist() == known.poles.tolist()
    assert loop.settling_time_s == known.settling_time_s
    assert loop.stable_gains == ((0.0, compute_stability_gain(0.016) / 2.0),)
    assert compute_steady_error(PidGains(kp=5.0), 0.1, process=Process(gain=2.0)) == -0.01


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"gain": 0.0}, "^gain: expected a number > 0, found 0.0"),
        ({"lag_s": -1.0}, "^lag_s: expected a number from 0 to 1e.100, found -1.0"),
        ({"dead_time_s": math.nan}, "^dead_time_s: expected a number from 0"),
        ({"low_pass_s": math.inf}, "^low_pass_s: expected a number from 0"),
        (
            {"lag_s": 1.1e9},
            "^lag_s: expected at most 1e.09 s .1e.09 sampling periods., found 1.1e.09 s",
        ),
        ({"low_pass_s": 1.1e9}, "^low_pass_s: expected at most 1e.09 s .1e.09 sampling periods."),
        (
            {"dead_time_s": 1000.1},
            "^dead_time_s: expected at most 1000 s .1000 samples in all., found 1000.1 s",
        ),
    ],
)
def test_a_process_out_of_range_is_refused(values: dict[str, float], expected: str) -> None:
    with pytest.raises(TheoryError, match=expected):
        analyse_pid_loop(PidGains(kp=1.0), period_s=1.0, process=Process(**values))


def test_1000_samples_of_dead_time_with_lag_and_a_part_of_a_sample_are_no_trouble() -> None:
    process = Process(lag_s=0.3, dead_time_s=998.5 * 0.016)
    ((_, high),) = find_stable_gains(PidGains(kp=1.0), period_s=0.016, process=process)
    # The continuous loop: phase -pi / 2 - w L - atan(w tau) = -pi.
    assert high == pytest.approx(0.0966, rel=0.03)
    for share, is_stable in [(1.0 - 1e-6, True), (1.0 + 1e-6, False)]:
        gains = PidGains(kp=share * high)
        assert is_pid_stable(gains, period_s=0.016, process=process) == is_stable


def test_python_control_puts_the_crossover_elsewhere_where_dead_time_is_several_samples() -> None:
    gains, process, ticks = draw_loop(np.random.default_rng(504))
    loop: Any = {"period_s": T, "dead_time_ticks": ticks, "process": process}
    plant = control.tf(*expand_transfer_function(gains, **loop), T)
    theirs = control.stability_margins(plant, method="poly")[4]
    ours = analyse_pid_loop(gains, **loop).margins
    assert ours is not None
    assert ours.crossover_rad_s is not None
    sizes = [abs(plant(np.exp(1j * at * T))) for at in (theirs, ours.crossover_rad_s)]
    assert abs(sizes[0] - 1.0) > 1e-4
    assert sizes[1] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("value", [0.5, -0.5])
def test_series_and_closed_form_of_the_weights_meet(value: float) -> None:
    near = [_rest(value * (1.0 + step)) for step in (-1e-12, 1e-12)]
    exact = math.fsum([value**n / math.factorial(n) for n in range(2, 30)])
    assert near == pytest.approx([exact, exact], rel=1e-11)


@pytest.mark.parametrize(("samples", "is_taken"), [(0.99e9, True), (1.01e9, False)])
def test_the_longest_lag_is_a_billion_samples(samples: float, *, is_taken: bool) -> None:
    process = Process(lag_s=samples)
    if is_taken:  # Kp (L + T / 2) = 1 is the limit
        assert is_pid_stable(PidGains(kp=1.9), period_s=1.0, process=process)
        assert not is_pid_stable(PidGains(kp=2.1), period_s=1.0, process=process)
    else:
        with pytest.raises(TheoryError, match="lag_s: expected at most"):
            is_pid_stable(PidGains(kp=1.9), period_s=1.0, process=process)


def test_an_open_loop_that_vanishes_at_its_highest_frequency_has_no_gain_margin_there() -> None:
    # Half a sample of dead time: a zero at z = -1, where rounding is left of the open loop.
    margins = analyse_pid_loop(
        PidGains(kp=0.5), period_s=1.0, process=Process(dead_time_s=0.5)
    ).margins
    assert margins is not None
    assert margins.gain_margin == pytest.approx(4.0, rel=1e-9)
    assert margins.gain_reduction is None
