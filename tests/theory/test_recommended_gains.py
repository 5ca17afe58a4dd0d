"""Recommended gains, held against fine steps in time, simulated runs and python-control."""

import math
from dataclasses import replace
from functools import cache
from typing import Any

import control
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import expm

import turtlelog as tl
from turtlelog.errors import TheoryError
from turtlelog.theory import (
    INTEGRATOR,
    PidGains,
    Process,
    Recommendation,
    analyse_pid_loop,
    compute_overshoot_gain,
    compute_pid_step_response,
    find_stable_gains,
    measure_step_motion,
    recommend_gains,
)
from turtlelog.theory.loop_design import LoopDesign, find_p_without_overshoot

Array = NDArray[np.float64]
Robot = tuple[Process, float]
Case = tuple[Process, float, Recommendation]

STEPS = 10
"""Of the integration in each sample; dead times of the robots are multiples of one."""

ROBOT = Process(gain=0.9, lag_s=0.2, dead_time_s=0.08)
ENDLESS = tl.override_scenario(
    tl.load_scenario("textbook"),
    {
        "law.kind": "sequential-pid",
        "law.heading_tolerance_rad": 1e-12,
        "law.position_tolerance_m": 1e-12,
        "law.standstill_samples": 1_000_000,
        "law.settled_for_s": math.inf,
        "plant.kind": "lagged",
        "plant.period_s": 0.01,
        "limits.speed_m_s": math.inf,
        "limits.turn_rate_rad_s": math.inf,
        "loop.period_ticks": 5,
        "loop.pose_precision": "float64",
        "start.x_m": 0.0,
        "start.y_m": 0.0,
        "start.heading_rad": 0.0,
    },
)
"""A robot without limits whose law does not end by itself, and whose poses come five times in each
sample."""

EXACT = ("overshoot", "phase-margin")


@cache
def draw_cases() -> tuple[Case, ...]:
    """Return 40 robots with the exact gains of each that has them: overshoot 5 %, margin 60 deg."""
    rng = np.random.default_rng(20)
    found: list[Case] = []
    for _ in range(40):
        step_s = round(rng.uniform(0.01, 0.1) / STEPS, 6)
        dead_time_s = step_s * round(10.0 ** rng.uniform(*np.log10([0.02, 0.5])) / step_s)
        lag_s = 10.0 ** rng.uniform(*np.log10([0.02, 1.0]))
        process = Process(gain=rng.uniform(0.5, 1.2), lag_s=lag_s, dead_time_s=dead_time_s)
        period_s = STEPS * step_s
        rules = recommend_gains(process, period_s=period_s)
        found += [(process, period_s, one) for one in rules if one.rule in EXACT and one.gains]
    return tuple(found)


def integrate_cases(cases: tuple[Case, ...], count: int) -> Array:
    """Return the overshoot [%] of each in fine steps of Runge and Kutta, all at once.

    The controller is written out anew: it samples, holds, and its commands wait in a line.
    """
    gains = [one.gains or PidGains(kp=1.0) for *_, one in cases]
    kp, ki, kd = (np.array([getattr(one, name) for one in gains]) for name in ("kp", "ki", "kd"))
    gain, tau, late = np.array([(p.gain, p.lag_s, p.dead_time_s) for p, *_ in cases]).T
    period = np.array([period_s for _, period_s, _ in cases])
    h, rows = period / STEPS, np.arange(len(cases))
    wait = np.rint(late / h).astype(int)
    line = np.zeros((wait.max() + 1, len(cases)))
    y, v, integral, last, peak = np.zeros((5, len(cases)))
    command = np.zeros(len(cases))
    now = 0
    for k in range(count * STEPS):
        if k % STEPS == 0:
            error = 1.0 - y
            command = kp * error + integral - kd / period * (y - last)
            integral, last = integral + ki * period * error, y
        line[(now + wait) % len(line), rows] = gain * command
        w = line[now]
        now = (now + 1) % len(line)
        a1 = (w - v) / tau
        a2 = (w - v - 0.5 * h * a1) / tau
        a3 = (w - v - 0.5 * h * a2) / tau
        a4 = (w - v - h * a3) / tau
        y = y + h * v + h * h * (a1 + a2 + a3) / 6.0
        v = v + h * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0
        np.maximum(peak, y, out=peak)
    overshoot: Array = 100.0 * (peak - 1.0)
    return overshoot


def simulate_overshoot(process: Process, period_s: float, gains: PidGains, *, turns: bool) -> float:
    """Return the overshoot [%] of a simulated robot."""
    axis, key = ("angular", "turn") if turns else ("linear", "speed")
    end_s = 12.0 * (process.lag_s + process.dead_time_s + period_s)
    values = {
        **{f"law.{name}_{axis}": getattr(gains, name) for name in ("kp", "ki", "kd")},
        **{f"plant.{key}_{name}": getattr(process, name) for name in ("gain", "lag_s")},
        f"plant.{key}_dead_time_s": process.dead_time_s,
        "plant.period_s": period_s / 5,
        "goal.x_m": math.cos(1.0) if turns else 1.0,
        "goal.y_m": math.sin(1.0) if turns else 0.0,
        "max_duration_s": (2.5 if gains.ki else 1.0) * end_s,
    }
    run = tl.simulate_run(tl.override_scenario(ENDLESS, values))
    moved = run.poses.heading_rad if turns else run.poses.xy_m[:, 0]
    return 100.0 * (float(moved.max()) - 1.0)


@pytest.mark.thorough
def test_exact_gains_meet_what_is_wanted() -> None:
    """Gains of 40 random processes are found by root search, for this and the next test."""
    cases = draw_cases()
    assert len({process for process, *_ in cases}) == 40
    for _, _, one in cases:
        assert one.motion is not None
        assert one.margins is not None
        assert one.margins.phase_margin_rad is not None
        if one.rule == "overshoot":
            assert one.motion.overshoot_percent == pytest.approx(5.0, abs=2e-6)
        if one.rule == "phase-margin" or one.controller == "PD":
            assert one.margins.phase_margin_rad == pytest.approx(math.pi / 3.0, abs=1e-9)


@pytest.mark.thorough
def test_integration_in_fine_steps_overshoots_as_much() -> None:
    """Loops are integrated step by step in Python."""
    cases = draw_cases()
    found = integrate_cases(cases, 1200)
    expected = [one.motion.overshoot_percent for *_, one in cases if one.motion]
    # Between its steps it misses up to some thousandths of a percent of a peak.
    np.testing.assert_allclose(found.clip(0.0), expected, rtol=0.0, atol=0.02)


@pytest.mark.thorough
def test_simulated_robots_overshoot_as_wanted_on_either_axis() -> None:
    """A robot is simulated for each of 120 gains."""
    wanted = [case for case in draw_cases() if case[-1].rule == "overshoot"]
    assert len({process for process, *_ in wanted}) == 40
    for number, (process, period_s, one) in enumerate(wanted):
        assert one.gains is not None
        found = simulate_overshoot(process, period_s, one.gains, turns=number % 2 == 0)
        # Between its poses it misses up to some hundredths of a percent of a peak.
        assert found == pytest.approx(5.0, abs=0.05)


def respond(process: Process, period_s: float, gains: PidGains, angle: Array) -> Any:
    """Return the open loop at angles w T, its plant by matrix exponentials."""
    whole, part = divmod(round(process.dead_time_s / period_s * STEPS), STEPS)
    flow = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, process.gain], [0.0, 0.0, 0.0]])
    flow[1] /= process.lag_s
    later = expm(flow * period_s * (1.0 - part / STEPS))
    both = later[:2, :2] @ expm(flow * period_s * part / STEPS)[:2]
    z = np.exp(1j * angle)
    held = later[:2, 2] + both[:, 2] / z[:, None]  # the newer command, and the older one
    way, rate = held.T
    plant = (way * (z - both[1, 1]) + both[0, 1] * rate) / ((z - 1.0) * (z - both[1, 1]))
    terms = gains.kp + gains.ki * period_s / (z - 1.0) + gains.kd / period_s * (1.0 - 1.0 / z)
    return terms * plant * z**-whole


@pytest.mark.thorough
def test_margins_are_those_of_matrix_exponentials() -> None:
    cases = draw_cases()[::2]
    assert len({process for process, *_ in cases}) == 40
    for process, period_s, one in cases:
        margins, gains = one.margins, one.gains
        assert gains is not None
        assert margins is not None
        assert margins.crossover_rad_s is not None
        assert margins.phase_margin_rad is not None
        at = margins.crossover_rad_s * period_s
        angle = np.array([at, *np.geomspace(1e-3 * at, math.pi, 300)])
        value, *others = respond(process, period_s, gains, angle)
        assert value == pytest.approx(np.exp(1j * (margins.phase_margin_rad - math.pi)), abs=1e-8)
        values = np.array(others)
        # No other crossover has less, and -1 is not encircled.
        is_above = np.abs(values) > 1.0
        phases = np.angle(-values[:-1][is_above[1:] != is_above[:-1]])
        assert (np.abs(phases) > margins.phase_margin_rad - 0.1).all()
        turns = np.unwrap(np.angle(1.0 + values))
        assert abs(turns[-1] - turns[0]) < (1.1 if gains.ki else 0.6) * math.pi


@pytest.mark.thorough
def test_margins_are_those_of_python_control() -> None:
    for process, period_s, one in draw_cases()[::24]:
        assert one.gains is not None
        assert one.margins is not None
        assert one.margins.phase_margin_rad is not None
        angle = np.geomspace(1e-3, 0.999 * math.pi, 400)
        values = respond(process, period_s, one.gains, angle)
        open_loop = control.frd(values, angle / period_s, smooth=True)
        gain_margin, phase_margin, *_ = control.stability_margins(open_loop)
        assert math.radians(phase_margin) == pytest.approx(one.margins.phase_margin_rad, abs=1e-3)
        assert gain_margin == pytest.approx(one.margins.gain_margin, rel=1e-2)


@pytest.mark.parametrize("ticks", [0, 1, 6, 40])
def test_p_without_overshoot_is_the_closed_form_of_an_integrator(ticks: int) -> None:
    late = Process(gain=2.0, dead_time_s=ticks * 0.016)
    found = find_p_without_overshoot(LoopDesign(process=late, period_s=0.016))
    assert 2.0 * found == pytest.approx(compute_overshoot_gain(0.016, ticks), rel=1e-9)
    (first, *_) = recommend_gains(late, period_s=0.016, overshoot_percent=0.0)
    assert first.gains == PidGains(kp=found)


@pytest.mark.parametrize("part", [0.0, 0.1, 0.25, 0.5, 0.9])
@pytest.mark.parametrize("lag_s", [0.0, 0.004, 0.1])
@pytest.mark.parametrize("low_pass_s", [0.0, 0.03])
def test_p_without_overshoot_has_none_and_a_twentieth_more_has(
    part: float, lag_s: float, low_pass_s: float
) -> None:
    process = Process(lag_s=lag_s, dead_time_s=(1.0 + part) * 0.016, low_pass_s=low_pass_s)
    kp = find_p_without_overshoot(LoopDesign(process=process, period_s=0.016))
    below, above = (
        measure_step_motion(PidGains(kp=share * kp), period_s=0.016, process=process)
        for share in (1.0, 1.05)
    )
    assert below is not None
    assert above is not None
    assert below.overshoot_percent < 1e-9
    assert above.overshoot_percent > 1e-6


def find(rule: str, controller: str, *found: Recommendation) -> Recommendation:
    (one,) = (one for one in found if (one.rule, one.controller) == (rule, controller))
    return one


def test_every_smaller_p_overshoots_less() -> None:
    one = find("overshoot", "P", *recommend_gains(ROBOT, period_s=0.05, overshoot_percent=20.0))
    assert one.gains is not None
    motions = [
        measure_step_motion(PidGains(kp=kp), period_s=0.05, process=ROBOT)
        for kp in np.linspace(0.1, 0.99, 20) * one.gains.kp
    ]
    assert max(motion.overshoot_percent for motion in motions if motion) < 20.0


def test_no_other_pi_with_the_phase_margin_has_a_larger_ki() -> None:
    one = find("phase-margin", "PI", *recommend_gains(ROBOT, period_s=0.05))
    assert one.gains is not None
    design = LoopDesign(process=ROBOT, period_s=0.05)
    for share, reaches in [(0.99, True), (1.01, False)]:
        margins = [
            design.read_margins(PidGains(kp=kp, ki=share * one.gains.ki))
            for kp in np.linspace(0.8, 1.25, 31) * one.gains.kp
        ]
        best = max(found.phase_margin_rad or 0.0 for found in margins if found)
        assert (best > math.pi / 3.0) == reaches


def test_the_derivative_of_a_phase_margin_takes_the_lag_out_of_the_loop() -> None:
    for filter_s in (0.0, 0.1):
        found = recommend_gains(ROBOT, period_s=0.05, filter_s=filter_s)
        gains = find("phase-margin", "PD", *found).gains
        assert gains is not None
        keep, rate = filter_s / (filter_s + 0.05), gains.kd / (filter_s + 0.05)
        zero = (gains.kp * keep + rate) / (gains.kp + rate)
        assert zero == pytest.approx(math.exp(-0.05 / 0.2), rel=1e-12)


def test_motion_between_samples_passes_through_those_at_samples() -> None:
    gains = PidGains(kp=3.0, ki=0.5, kd=0.2, filter_s=0.03)
    process = replace(ROBOT, low_pass_s=0.04)
    motion = measure_step_motion(gains, period_s=0.05, process=process)
    loop = tl.theory.analyse_pid_loop(gains, period_s=0.05, process=process)
    assert motion is not None
    assert loop.overshoot_percent is not None
    assert loop.overshoot_percent < motion.overshoot_percent < loop.overshoot_percent + 0.5
    assert motion.settling_time_s == pytest.approx(loop.settling_time_s)


@pytest.mark.thorough
def test_a_motion_that_runs_away_or_never_rests_is_none() -> None:
    assert measure_step_motion(PidGains(kp=130.0), period_s=0.016) is None
    # What is left after k samples is (1 - Kp T)^k; 1e-9 of a step is rest.
    rests, creeps = (
        measure_step_motion(PidGains(kp=math.log(1e9) / count), period_s=1.0)
        for count in (195_000, 205_000)
    )
    assert rests is not None
    assert rests.settling_time_s == pytest.approx(195_000 * math.log(50) / math.log(1e9), abs=2.0)
    assert creeps is None
    ringing = measure_step_motion(PidGains(kp=124.9999), period_s=0.016)
    assert ringing is not None
    assert ringing.settling_time_s is None
    assert ringing.overshoot_percent == pytest.approx(100.0, abs=1e-3)


def test_a_motion_that_creeps_on_within_the_band_has_settled() -> None:
    """The motion is followed for 200,000 samples, which takes 1 to 2 s."""
    slow = Process(lag_s=1.0, dead_time_s=0.048)
    gains = PidGains(kp=0.01102, ki=7.0641e-07)
    motion = measure_step_motion(gains, period_s=0.016, process=slow)
    response = compute_pid_step_response(gains, 40_000, period_s=0.016, process=slow)
    outside = np.flatnonzero(np.abs(response - 1.0) > 0.02)[-1]
    assert motion is not None
    assert motion.settling_time_s == pytest.approx(0.016 * (outside + 1))
    assert motion.settling_time_s is not None
    assert 300.0 < motion.settling_time_s < 350.0
    assert abs(response[-1] - 1.0) > 0.004


def test_rules_of_skogestad_have_the_margins_that_are_published() -> None:
    # Of K exp(-theta s) / s with tau_c = theta: gain margin 2.96, phase margin 46.9 deg.
    late = Process(gain=0.5, dead_time_s=1.0)
    found = recommend_gains(late, period_s=0.02, overshoot_percent=None)
    pi = find("simc", "PI", *found)
    assert pi.gains is not None
    assert pi.margins is not None
    assert pi.margins.phase_margin_rad is not None
    assert (pi.gains.kp, pi.gains.ki) == pytest.approx((1.0 / 1.01, 0.125 / 1.01**2))
    assert pi.margins.gain_margin == pytest.approx(2.96, abs=0.01)
    assert math.degrees(pi.margins.phase_margin_rad) == pytest.approx(46.9, abs=0.05)
    p = find("simc", "P", *found)
    assert p.gains == PidGains(kp=pi.gains.kp)


def test_the_half_rule_makes_dead_time_of_half_a_lag() -> None:
    robot = Process(lag_s=0.2, dead_time_s=0.08, low_pass_s=0.02)
    found = recommend_gains(robot, period_s=0.05)
    p, pd = (find("simc", name, *found).gains for name in ("P", "PD"))
    assert p is not None
    assert pd is not None
    assert p.kp == pytest.approx(0.5 / (0.08 + 0.025 + 0.1 + 0.02))
    assert (pd.kp, pd.kd / pd.kp) == pytest.approx((0.5 / (0.08 + 0.025 + 0.01), 0.21))


def test_a_rule_is_measured_with_the_filter_of_the_derivative() -> None:
    robot, gains = Process(lag_s=0.2, dead_time_s=0.03), []
    for filter_s in (0.0, 0.1):
        pd = find("simc", "PD", *recommend_gains(robot, period_s=0.05, filter_s=filter_s))
        assert pd.gains is not None
        loop = analyse_pid_loop(replace(pd.gains, filter_s=filter_s), period_s=0.05, process=robot)
        assert pd.margins == loop.margins
        gains.append((pd.gains.kp, pd.gains.kd, pd.gains.filter_s))
    assert gains[0][:2] == gains[1][:2]
    assert (gains[0][2], gains[1][2]) == (0.0, 0.1)


def test_ziegler_and_nichols_leave_a_gain_margin_of_two() -> None:
    one = find("ziegler-nichols", "P", *recommend_gains(ROBOT, period_s=0.05))
    ((_, limit),) = find_stable_gains(PidGains(kp=1.0), period_s=0.05, process=ROBOT)
    assert one.gains == PidGains(kp=0.5 * limit)
    assert one.margins is not None
    assert one.margins.gain_margin == pytest.approx(2.0, rel=1e-9)


@pytest.mark.parametrize(
    ("rule", "controller", "process", "wishes", "reason"),
    [
        ("phase-margin", "P", ROBOT, {"phase_margin_rad": math.pi / 2}, "lags by 90 deg"),
        ("phase-margin", "PI", ROBOT, {"phase_margin_rad": 2.0}, "lags by 90 deg"),
        ("phase-margin", "PD", ROBOT, {"phase_margin_rad": 2.0}, "lags by 90 deg"),
        ("overshoot", "PD", ROBOT, {"phase_margin_rad": 2.0}, "lags by 90 deg"),
        ("overshoot", "PI", ROBOT, {"overshoot_percent": 0.0}, "an integral always overshoots"),
        ("overshoot", "PD", INTEGRATOR, {}, "no lag to cancel"),
        ("phase-margin", "PD", INTEGRATOR, {}, "no lag to cancel"),
        ("overshoot", "PD", ROBOT, {"filter_s": 0.19}, "filter is slower than the lag"),
        ("phase-margin", "PD", ROBOT, {"filter_s": 0.19}, "filter is slower than the lag"),
        ("overshoot", "PD", ROBOT, {"overshoot_percent": 9.0}, "60 deg PD overshoots less"),
        ("overshoot", "PD", Process(lag_s=0.1, dead_time_s=0.4), {}, "even where Kd cancels"),
        ("simc", "PD", Process(lag_s=0.124, dead_time_s=0.1), {}, "the lag exceeds the dead time"),
        ("overshoot", "P", Process(lag_s=101.0), {}, "longer than 2000 samples"),
        ("overshoot", "PI", Process(lag_s=101.0), {}, "longer than 2000 samples"),
        ("overshoot", "PD", Process(lag_s=101.0), {}, "longer than 2000 samples"),
        ("phase-margin", "P", Process(gain=1e-100, lag_s=0.5), {}, "kp: expected a gain"),
    ],
)
def test_gains_that_do_not_exist_have_their_reason(
    rule: str, controller: str, process: Process, wishes: dict[str, float], reason: str
) -> None:
    settings: dict[str, Any] = {"period_s": 0.05, **wishes}
    one = find(rule, controller, *recommend_gains(process, **settings))
    assert (one.gains, one.motion, one.margins) == (None, None, None)
    assert reason in one.reason


@pytest.mark.parametrize(
    ("rule", "controller", "process", "wishes"),
    [
        ("phase-margin", "P", ROBOT, {"phase_margin_rad": 0.99 * math.pi / 2}),
        ("overshoot", "PI", ROBOT, {"overshoot_percent": 0.1}),
        ("phase-margin", "PD", ROBOT, {"filter_s": 0.16}),
        ("overshoot", "PD", ROBOT, {"overshoot_percent": 7.0}),
        ("simc", "PD", Process(lag_s=0.126, dead_time_s=0.1), {}),
    ],
)
def test_gains_exist_on_the_other_side_of_each_border(
    rule: str, controller: str, process: Process, wishes: dict[str, float | None]
) -> None:
    settings: dict[str, Any] = {"period_s": 0.05, **wishes}
    one = find(rule, controller, *recommend_gains(process, **settings))
    assert one.reason == ""
    assert one.margins is not None


@pytest.mark.parametrize(("share", "is_slow"), [(0.99, False), (1.01, True)])
def test_a_loop_is_slow_beyond_2000_samples(share: float, *, is_slow: bool) -> None:
    whole = Process(lag_s=50.0 * share, low_pass_s=30.0 * share, dead_time_s=20.0 * share)
    assert LoopDesign(process=whole, period_s=0.05).is_slow == is_slow


def test_only_what_is_wanted_is_computed() -> None:
    some = recommend_gains(ROBOT, period_s=0.05, overshoot_percent=None)
    assert {one.rule for one in some} == {"phase-margin", "simc", "ziegler-nichols"}
    other = recommend_gains(ROBOT, period_s=0.05, phase_margin_rad=None)
    assert {one.rule for one in other} == {"overshoot", "simc", "ziegler-nichols"}
    margins = find("overshoot", "PD", *other).margins
    assert margins is not None
    assert margins.phase_margin_rad == pytest.approx(math.pi / 3.0)


@pytest.mark.parametrize(
    ("wishes", "message"),
    [
        ({"overshoot_percent": 100.0}, "overshoot_percent: expected less than 100 %, found 100.0"),
        ({"overshoot_percent": -1.0}, "overshoot_percent: expected a number from 0"),
        ({"overshoot_percent": math.nan}, "overshoot_percent: expected a number from 0"),
        ({"phase_margin_rad": 0.0}, "phase_margin_rad: expected a number > 0"),
        ({"phase_margin_rad": math.pi}, "phase_margin_rad: expected less than pi"),
        ({"filter_s": -1.0}, "filter_s: expected a number from 0"),
        ({"period_s": 0.0}, "period_s: expected a sampling period > 0"),
    ],
)
def test_wishes_outside_their_range_are_refused(wishes: dict[str, float], message: str) -> None:
    settings: dict[str, Any] = {"period_s": 0.05, **wishes}
    with pytest.raises(TheoryError, match=message):
        recommend_gains(ROBOT, **settings)


def test_a_sampled_response_lies_on_the_motion() -> None:
    response = compute_pid_step_response(PidGains(kp=8.0), 400, period_s=0.05, process=ROBOT)
    motion = measure_step_motion(PidGains(kp=8.0), period_s=0.05, process=ROBOT)
    assert motion is not None
    missed = motion.overshoot_percent - 100.0 * (float(response.max()) - 1.0)
    assert 0.0 <= missed < 1.0
