"""The sampled loop's poles and limits, held against python-control and against simulation."""

import math
from typing import Any

import control
import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray

from turtlelog.errors import TheoryError
from turtlelog.theory import (
    analyse_sampled_loop,
    compute_overshoot_gain,
    compute_sampled_poles,
    compute_sampled_step_response,
    compute_stability_gain,
)
from turtlelog.theory.sampled_loop import compute_sampled_locus

TICK_S = 0.016
DEAD_TIMES = range(13)


def build_open_loop(kp: float, dead_time_ticks: int) -> Any:
    held_integrator = control.sample_system(control.tf([1.0], [1.0, 0.0]), TICK_S, method="zoh")
    delay = control.tf([1.0], [1.0] + [0.0] * dead_time_ticks, dt=TICK_S)
    return kp * held_integrator * delay


def find_control_poles(kp: float, dead_time_ticks: int) -> NDArray[np.complex128]:
    closed = control.feedback(build_open_loop(kp, dead_time_ticks), 1.0)
    return np.asarray(closed.poles(), dtype=np.complex128)


def measure_distance(left: NDArray[np.complex128], right: NDArray[np.complex128]) -> float:
    """Return how far the loneliest pole of either set is from the other set."""
    assert left.shape == right.shape
    distances = np.abs(left[:, None] - right)
    return float(max(distances.min(axis=0).max(), distances.min(axis=1).max()))


def find_slowest(poles: NDArray[np.complex128]) -> complex:
    return complex(poles[np.argmax(np.abs(poles))])


@pytest.mark.parametrize("dead_time_ticks", DEAD_TIMES)
@pytest.mark.parametrize("kp", [0.5, 1.0, 2.0, 4.0, 10.0, 40.0, 124.0, 200.0])
def test_the_poles_are_those_of_python_control(kp: float, dead_time_ticks: int) -> None:
    poles = compute_sampled_poles(kp, period_s=TICK_S, dead_time_ticks=dead_time_ticks)
    assert measure_distance(poles, find_control_poles(kp, dead_time_ticks)) < 1e-9


@pytest.mark.parametrize("dead_time_ticks", DEAD_TIMES)
@pytest.mark.parametrize("share", [1.0 - 1e-3, 1.0 - 1e-6, 1.0 + 1e-6])
def test_the_poles_are_those_of_python_control_where_the_slow_ones_nearly_meet(
    share: float, dead_time_ticks: int
) -> None:
    kp = share * compute_overshoot_gain(TICK_S, dead_time_ticks)
    poles = compute_sampled_poles(kp, period_s=TICK_S, dead_time_ticks=dead_time_ticks)
    assert measure_distance(poles, find_control_poles(kp, dead_time_ticks)) < 1e-9


@pytest.mark.parametrize("dead_time_ticks", DEAD_TIMES)
def test_below_the_overshoot_gain_python_controls_slowest_pole_is_positive(
    dead_time_ticks: int,
) -> None:
    limit = compute_overshoot_gain(TICK_S, dead_time_ticks)
    slowest = find_slowest(find_control_poles(limit * (1.0 - 1e-6), dead_time_ticks))
    assert slowest.imag == 0.0
    assert slowest.real > 0.0


@pytest.mark.parametrize("dead_time_ticks", DEAD_TIMES)
def test_above_the_overshoot_gain_python_control_has_no_positive_pole(
    dead_time_ticks: int,
) -> None:
    limit = compute_overshoot_gain(TICK_S, dead_time_ticks)
    poles = find_control_poles(limit * (1.0 + 1e-6), dead_time_ticks)
    assert not ((poles.imag == 0.0) & (poles.real > 0.0)).any()


@pytest.mark.parametrize("dead_time_ticks", DEAD_TIMES)
def test_at_the_stability_gain_python_controls_poles_cross_the_unit_circle(
    dead_time_ticks: int,
) -> None:
    limit = compute_stability_gain(TICK_S, dead_time_ticks)
    below = np.abs(find_control_poles(limit * (1.0 - 1e-9), dead_time_ticks)).max()
    above = np.abs(find_control_poles(limit * (1.0 + 1e-9), dead_time_ticks)).max()
    assert 1.0 - 1e-8 < below < 1.0 < above < 1.0 + 1e-8


# python-control evaluates the open loop at its pole, too.
@pytest.mark.filterwarnings("ignore:.* encountered in divide:RuntimeWarning")
@pytest.mark.parametrize("dead_time_ticks", DEAD_TIMES)
@pytest.mark.parametrize("kp", [1.0, 4.0, 10.0])
def test_the_margins_are_those_of_python_control(kp: float, dead_time_ticks: int) -> None:
    loop = analyse_sampled_loop(kp, period_s=TICK_S, dead_time_ticks=dead_time_ticks)
    open_loop = build_open_loop(kp, dead_time_ticks)
    gain_margin, phase_margin_deg, _, crossover_rad_s = control.margin(open_loop)
    assert loop.phase_margin_rad is not None
    if dead_time_ticks > 0:  # it leaves out z = -1, where the loop without dead time crosses
        assert loop.gain_margin == pytest.approx(gain_margin, rel=1e-6)
    assert math.degrees(loop.phase_margin_rad) == pytest.approx(phase_margin_deg, abs=1e-6)
    delay_s = math.radians(phase_margin_deg) / crossover_rad_s
    assert loop.delay_margin_s == pytest.approx(delay_s, rel=1e-6)


@pytest.mark.parametrize("dead_time_ticks", DEAD_TIMES)
@pytest.mark.parametrize("kp", [4.0, 10.0, 30.0, 90.0])
def test_whole_ticks_inside_the_delay_margin_keep_the_loop_stable(
    kp: float, dead_time_ticks: int
) -> None:
    loop = analyse_sampled_loop(kp, period_s=TICK_S, dead_time_ticks=dead_time_ticks)
    assert loop.delay_margin_s is not None
    assert loop.stable == (loop.delay_margin_s > 0.0)
    most = dead_time_ticks + math.floor(loop.delay_margin_s / TICK_S)
    if loop.stable:
        assert np.abs(find_control_poles(kp, most)).max() < 1.0
        assert np.abs(find_control_poles(kp, most + 1)).max() > 1.0


@pytest.mark.parametrize("dead_time_ticks", DEAD_TIMES)
@pytest.mark.parametrize("share", [0.5, 0.98, 1.02, 1.5])
def test_a_simulated_step_fades_below_the_stability_gain_and_grows_above(
    share: float, dead_time_ticks: int
) -> None:
    kp = share * compute_stability_gain(TICK_S, dead_time_ticks)
    y = compute_sampled_step_response(kp, 40_000, period_s=TICK_S, dead_time_ticks=dead_time_ticks)
    assert (abs(y[-1] - 1.0) < 1e-6) == (share < 1.0)


@pytest.mark.parametrize("dead_time_ticks", DEAD_TIMES)
@pytest.mark.parametrize("share", [0.5, 0.99, 1.1, 1.5])
def test_a_simulated_step_goes_beyond_the_reference_above_the_overshoot_gain_only(
    share: float, dead_time_ticks: int
) -> None:
    kp = share * compute_overshoot_gain(TICK_S, dead_time_ticks)
    y = compute_sampled_step_response(kp, 2000, period_s=TICK_S, dead_time_ticks=dead_time_ticks)
    loop = analyse_sampled_loop(kp, period_s=TICK_S, dead_time_ticks=dead_time_ticks)
    assert loop.overshoots == (share > 1.0)
    assert (y.max() > 1.0 + 1e-9) == loop.overshoots
    assert loop.overshoot_percent == pytest.approx(100.0 * (y.max() - 1.0), abs=1e-9)


def test_the_paper_gains_stand_where_a_student_should_see_them() -> None:
    assert round(compute_overshoot_gain(TICK_S, 6), 2) == 3.54
    assert round(compute_stability_gain(TICK_S, 6), 2) == 15.07
    four = analyse_sampled_loop(4.0, period_s=TICK_S, dead_time_ticks=6)
    ten = analyse_sampled_loop(10.0, period_s=TICK_S, dead_time_ticks=6)
    assert (four.overshoots, four.stable, ten.overshoots, ten.stable) == (True, True, True, True)
    assert four.overshoot_percent == pytest.approx(0.289, abs=1e-3)
    assert ten.overshoot_percent == pytest.approx(54.24, abs=1e-2)


def test_without_dead_time_the_limits_are_one_and_two() -> None:
    assert compute_overshoot_gain(1.0, 0) == 1.0
    assert compute_stability_gain(1.0, 0) == 2.0
    at_limit = analyse_sampled_loop(125.0, period_s=TICK_S, dead_time_ticks=0)
    assert (at_limit.stable, at_limit.poles.tolist()) == (False, [-1.0])


@pytest.mark.parametrize("dead_time_ticks", range(1, 41))
def test_the_double_pole_keeps_all_its_digits(dead_time_ticks: int) -> None:
    kp = compute_overshoot_gain(1.0, dead_time_ticks)
    poles = compute_sampled_poles(kp, period_s=1.0, dead_time_ticks=dead_time_ticks)
    expected = dead_time_ticks / (dead_time_ticks + 1)
    assert poles[:2] == pytest.approx([expected, expected], rel=1e-15)


@pytest.mark.thorough
@given(dead_time_ticks=st.integers(0, 12), logs=st.lists(st.floats(-6.0, 3.0), min_size=1))
def test_poles_at_many_gains_are_those_at_each_to_the_last_bit(
    dead_time_ticks: int, logs: list[float]
) -> None:
    """Eigenvalues are computed at each of many gains, of 100 examples."""
    meeting = compute_overshoot_gain(1.0, dead_time_ticks)
    gains = [*(10.0**log for log in logs), meeting, 2.0 * meeting]
    settings: Any = {"period_s": 1.0, "dead_time_ticks": dead_time_ticks}
    alone = [compute_sampled_poles(kp, **settings) for kp in gains]
    np.testing.assert_array_equal(compute_sampled_locus(gains, **settings), alone)


@given(
    dead_time_ticks=st.integers(1, 60) | st.sampled_from([250, 1000]),
    log_gain=st.floats(-12.0, 12.0),
)
def test_every_pole_solves_its_polynomial(dead_time_ticks: int, log_gain: float) -> None:
    loop_gain = 10.0**log_gain
    z = compute_sampled_poles(loop_gain, period_s=1.0, dead_time_ticks=dead_time_ticks)
    assert z.shape == (dead_time_ticks + 1,)
    assert abs(z.sum() - 1.0) <= 1e-9 * np.abs(z).sum()
    simple = np.abs(1.0 - z) > 1e-3
    solved = np.exp(dead_time_ticks * np.log(z) + np.log(1.0 - z) - math.log(loop_gain))
    assert solved[simple] == pytest.approx(1.0 + 0j, rel=1e-9)
    assert (np.diff(np.abs(z)) < 1e-11 * np.abs(z[0])).all()


@pytest.mark.parametrize(("kp", "settling_time_s"), [(1.0, 3.912), (4.0, 0.978)])
def test_sampled_fast_the_loop_settles_as_the_ideal_one(kp: float, settling_time_s: float) -> None:
    loop = analyse_sampled_loop(kp, period_s=1e-4)
    assert loop.settling_time_s == pytest.approx(settling_time_s, abs=3e-4)
    assert loop.damping_ratio == 1.0


def test_the_damping_ratio_is_python_controls() -> None:
    closed = control.feedback(build_open_loop(10.0, 6), 1.0)
    loop = analyse_sampled_loop(10.0, period_s=TICK_S, dead_time_ticks=6)
    ratios, poles = closed.damp()[1:]
    assert loop.damping_ratio == pytest.approx(ratios[np.argmax(np.abs(poles))], rel=1e-9)


def test_an_unstable_loop_has_no_overshoot_figure_and_no_settling_time() -> None:
    loop = analyse_sampled_loop(16.0, period_s=TICK_S, dead_time_ticks=6)
    assert (loop.stable, loop.overshoot_percent, loop.settling_time_s) == (False, None, None)
    assert loop.gain_margin < 1.0
    assert loop.damping_ratio < 0.0


def test_beyond_a_loop_gain_of_two_there_is_no_crossover() -> None:
    loop = analyse_sampled_loop(126.0, period_s=TICK_S)
    assert (loop.phase_margin_rad, loop.delay_margin_s) == (None, None)


@pytest.mark.parametrize("dead_time_ticks", [-1, 1.5, 10**9, True, math.nan, "6", None])
def test_a_dead_time_is_a_whole_number_in_a_sane_range(dead_time_ticks: Any) -> None:
    with pytest.raises(TheoryError, match="dead_time_ticks: expected a whole number from 0 to"):
        analyse_sampled_loop(1.0, period_s=TICK_S, dead_time_ticks=dead_time_ticks)
    with pytest.raises(TheoryError, match="dead_time_ticks: expected a whole number from 0 to"):
        compute_overshoot_gain(TICK_S, dead_time_ticks)


@pytest.mark.parametrize("period_s", [0.0, -0.016, math.nan, math.inf, True, "fast"])
def test_a_period_is_a_positive_number(period_s: Any) -> None:
    with pytest.raises(TheoryError, match="period_s: expected "):
        compute_stability_gain(period_s)
