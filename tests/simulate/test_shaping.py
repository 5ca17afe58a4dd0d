"""Shaping and limits of commands, against closed forms."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray

from tests.effects_cases import build_case
from turtlelog.arithmetic import clip
from turtlelog.effects.acceleration import Follower, follow_with_acceleration, follow_with_jerk
from turtlelog.run import Run
from turtlelog.simulate import iterate_ticks, simulate_run

PERIOD_S = 0.016

Values = NDArray[np.floating[Any]]


class AccelerationLimiter:
    """Follows one command, clipped, with a bounded change per second."""

    def __init__(self, limit: float, largest: float) -> None:
        self._limit, self._largest, self._state = limit, largest, Follower()

    def follow(self, wanted: float, dt_s: float) -> float:
        clipped = clip(wanted, self._limit)
        return follow_with_acceleration(self._state, self._largest, clipped, dt_s)


class JerkLimiter:
    """Follows one command, clipped, with a bounded acceleration and jerk."""

    def __init__(self, limit: float, largest: float, jerk: float) -> None:
        self._limit, self._rates, self.state = limit, (largest, jerk), Follower()

    def follow(self, wanted: float, dt_s: float) -> float:
        clipped = clip(wanted, self._limit)
        return follow_with_jerk(self.state, self._limit, self._rates, clipped, dt_s)


def simulate_step(amplitude: float = 0.8, duration_s: float = 2.0, **changes: Any) -> Run:
    """Want a speed from the first sample on."""
    law: dict[str, Any] = {
        "law__kind": "open-loop",
        "law__signal": "step",
        "law__axis": "speed",
        "law__amplitude": amplitude,
        "law__duration_s": duration_s,
        "start__x_m": 1.0,
        "max_duration_s": duration_s - 0.01,
    }
    return simulate_run(build_case(**law, **changes))


def test_low_pass_follows_a_step_exponentially() -> None:
    run = simulate_step(shaping__low_pass_s=0.1)
    time_s = PERIOD_S * np.arange(1, len(run.samples) + 1)
    expected = 0.8 * (1.0 - np.exp(-time_s / 0.1))
    assert run.samples.shaped_speed_m_s is not None
    assert np.abs(run.samples.shaped_speed_m_s - expected).max() < 1e-12
    assert np.array_equal(run.samples.shaped_speed_m_s, run.samples.speed_m_s)
    assert run.samples.wanted_speed_m_s is not None
    assert set(run.samples.wanted_speed_m_s.tolist()) == {0.8}


def test_low_pass_takes_the_time_between_samples() -> None:
    run = simulate_step(shaping__low_pass_s=0.1, loop__trigger="timer", loop__period_s=0.0237)
    time_s = 0.0237 * np.arange(1, len(run.samples) + 1)
    expected = 0.8 * (1.0 - np.exp(-time_s / 0.1))
    assert run.samples.shaped_speed_m_s is not None
    assert np.abs(run.samples.shaped_speed_m_s - expected).max() < 1e-12


@pytest.mark.parametrize(("amplitude", "left"), [(0.0999, 0.0), (0.1, 0.1), (-0.0999, 0.0)])
def test_dead_zone_takes_what_is_smaller(amplitude: float, left: float) -> None:
    run = simulate_step(amplitude, 0.2, shaping__dead_zone_speed_m_s=0.1)
    assert set(run.samples.speed_m_s.tolist()) == {left}


@pytest.mark.parametrize(("amplitude", "left"), [(0.124, 0.1), (0.126, 0.15), (-0.126, -0.15)])
def test_quantum_rounds_to_the_nearest_step(amplitude: float, left: float) -> None:
    run = simulate_step(amplitude, 0.2, shaping__quantum_speed_m_s=0.05)
    assert np.abs(run.samples.speed_m_s - left).max() < 1e-12


def test_wanted_shaped_and_published_commands_stay_apart() -> None:
    changes: dict[str, Any] = {"shaping__quantum_speed_m_s": 0.5, "limits__acceleration_m_s2": 1.0}
    run = simulate_step(1.8, 1.0, **changes)
    samples = run.samples
    assert samples.wanted_speed_m_s is not None
    assert samples.shaped_speed_m_s is not None
    assert samples.shaped_turn_rate_rad_s is not None
    assert set(samples.wanted_speed_m_s.tolist()) == {1.8}
    assert set(samples.shaped_speed_m_s.tolist()) == {2.0}
    assert samples.speed_m_s[:2] == pytest.approx([0.016, 0.032])
    assert samples.speed_m_s.max() <= 1.0
    assert np.array_equal(run.commands.speed_m_s, samples.speed_m_s)


def test_without_shaping_nothing_shaped_is_recorded() -> None:
    changes: dict[str, Any] = {"limits__acceleration_m_s2": 1.0, "max_duration_s": 0.1}
    scenario = build_case(**changes)
    assert simulate_run(scenario).samples.shaped_speed_m_s is None
    samples = [sample for tick in iterate_ticks(scenario) for sample in tick.computed]
    assert all(math.isnan(sample.shaped_speed_m_s) for sample in samples)
    assert all(math.isnan(sample.shaped_turn_rate_rad_s) for sample in samples)


@pytest.mark.parametrize("acceleration", [0.5, 1.0, 3.0])
def test_ramp_takes_the_step_over_the_acceleration(acceleration: float) -> None:
    run = simulate_step(limits__acceleration_m_s2=acceleration)
    time_s = PERIOD_S * np.arange(1, len(run.samples) + 1)
    expected = np.minimum(acceleration * time_s, 0.8)
    assert np.abs(run.samples.speed_m_s - expected).max() < 1e-12


def compute_s_curve(time_s: Values, height: float, acceleration: float, jerk: float) -> Values:
    """Return the fastest curve from rest to a height; its second half mirrors the first."""
    top = min(acceleration, math.sqrt(jerk * height))
    rise_s = top / jerk
    end_s = height / top + rise_s

    def climb(since_s: Values) -> Values:
        early = 0.5 * jerk * since_s**2
        return np.where(since_s < rise_s, early, top * (since_s - 0.5 * rise_s))

    late = height - climb(np.maximum(end_s - time_s, 0.0))
    return np.where(time_s < 0.5 * end_s, climb(time_s), np.where(time_s < end_s, late, height))


@pytest.mark.parametrize(
    ("acceleration", "jerk", "duration_s"),
    # Height / acceleration + acceleration / jerk where the limit of acceleration is reached, else
    # twice the root of height / jerk.
    [(1.0, 5.0, 0.8 + 0.2), (10.0, 5.0, 2.0 * 0.4), (math.inf, 20.0, 2.0 * 0.2)],
)
def test_s_curve_takes_its_closed_form_time(
    acceleration: float, jerk: float, duration_s: float
) -> None:
    changes: dict[str, Any] = {"limits__acceleration_m_s2": acceleration, "limits__jerk_m_s3": jerk}
    run = simulate_step(**changes)
    time_s = PERIOD_S * np.arange(1, len(run.samples) + 1)
    expected = compute_s_curve(time_s, 0.8, acceleration, jerk)
    assert np.abs(run.samples.speed_m_s - expected).max() < 1e-12
    arrived_s = time_s[np.flatnonzero(run.samples.speed_m_s == 0.8)[0]]
    assert duration_s <= arrived_s < duration_s + PERIOD_S + 1e-9


def test_turn_rate_has_limits_of_its_own() -> None:
    changes: dict[str, Any] = {"limits__turn_acceleration_rad_s2": 2.0, "max_duration_s": 1.0}
    run = simulate_run(build_case(preset="paper-kp1", **changes))
    steps = np.abs(np.diff(run.samples.turn_rate_rad_s, prepend=0.0))
    # The backlog of five poses is answered at one time: no time for a change after the first.
    assert run.samples.turn_rate_rad_s[:6].tolist() == [0.0] * 6
    assert steps.max() == pytest.approx(2.0 * PERIOD_S)


TIMES_S = st.lists(st.floats(0.001, 0.2), min_size=60, max_size=60)
TARGETS = st.lists(st.floats(-1.5, 1.5), min_size=1, max_size=6)


@settings(max_examples=60, deadline=None)
@given(times_s=TIMES_S, wanted=st.floats(-1.5, 1.5))
def test_jerk_limiter_never_overshoots_whatever_the_time_between_samples(
    times_s: list[float], wanted: float
) -> None:
    limiter, target = JerkLimiter(1.0, 2.0, 10.0), min(max(wanted, -1.0), 1.0)
    values = np.array([limiter.follow(wanted, dt_s) for dt_s in times_s])
    assert (np.diff(values * np.sign(target), prepend=0.0) >= -1e-12).all()
    assert np.abs(values).max() <= abs(target) + 1e-12
    longest_s = abs(target) / 2.0 + 0.2 if abs(target) > 0.4 else 2.0 * math.sqrt(abs(target) / 10)
    is_over = np.cumsum(times_s) > longest_s + 1e-9
    assert (values[is_over] == target).all()


@settings(max_examples=60, deadline=None)
@given(times_s=TIMES_S, targets=TARGETS)
def test_jerk_limiter_keeps_all_limits_while_the_target_moves(
    times_s: list[float], targets: list[float]
) -> None:
    limiter = JerkLimiter(1.0, 2.0, 10.0)
    value, acceleration = 0.0, 0.0
    for number, dt_s in enumerate(times_s):
        now = limiter.follow(targets[number * len(targets) // len(times_s)], dt_s)
        mean = (now - value) / dt_s
        assert abs(now) <= 1.0
        assert abs(mean) <= 2.0 + 1e-9
        # The mean acceleration of an interval is that of its begin, changed by at most jerk * dt.
        assert abs(mean - acceleration) <= 10.0 * dt_s + 1e-9
        value, acceleration = now, limiter.state.rate


def test_samples_of_one_time_leave_the_command_alone() -> None:
    for limiter in (AccelerationLimiter(1.0, 2.0), JerkLimiter(1.0, 2.0, 10.0)):
        first = limiter.follow(1.0, 0.016)
        assert limiter.follow(1.0, 0.0) == first > 0.0
        assert limiter.follow(-1.0, 0.0) == first


def test_clipping_comes_before_the_rates() -> None:
    limiter = AccelerationLimiter(1.0, 2.0)
    assert [limiter.follow(100.0, 0.25) for _ in range(3)] == [0.5, 1.0, 1.0]
    assert limiter.follow(-0.2, 0.25) == 0.5
