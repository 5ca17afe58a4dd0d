"""Processes and loops are what python-control computes of them."""

from typing import Any

import control
import numpy as np
import pytest

import turtlelog as tl
from turtlelog.errors import TheoryError
from turtlelog.theory import PidGains, Process

PERIOD_S = 0.016
LOOPS = {
    "P": (PidGains(kp=4.0), Process(), 5),
    "P with lag": (PidGains(kp=2.0), Process(gain=0.9, lag_s=0.1, dead_time_s=0.08), 0),
    "PI": (PidGains(kp=2.0, ki=0.5), Process(dead_time_s=0.021), 2),
    "PD behind a filter": (PidGains(kp=2.0, kd=0.1, filter_s=0.05), Process(lag_s=0.2), 3),
    "PID with a low-pass": (
        PidGains(kp=1.0, ki=0.2, kd=0.05),
        Process(gain=1.1, lag_s=0.1, dead_time_s=0.05, low_pass_s=0.1),
        1,
    ),
    "low-pass without dead time": (PidGains(kp=1.0), Process(low_pass_s=0.1), 0),
}


@pytest.mark.parametrize("name", LOOPS)
def test_the_open_loop_has_the_same_frequency_response(name: str) -> None:
    gains, process, ticks = LOOPS[name]
    known: dict[str, Any] = {"period_s": PERIOD_S, "dead_time_ticks": ticks, "process": process}
    loop = tl.theory.analyse_pid_loop(gains, **known)
    frequency = np.geomspace(0.1, np.pi / PERIOD_S, 50)
    wanted = tl.theory.compute_open_loop(gains, frequency, **known)
    found = loop.to_control()
    assert found.dt == PERIOD_S
    np.testing.assert_allclose(found(np.exp(1j * frequency * PERIOD_S)), wanted, rtol=1e-6)


@pytest.mark.parametrize("name", LOOPS)
def test_the_closed_loop_has_the_same_poles(name: str) -> None:
    gains, process, ticks = LOOPS[name]
    loop = tl.theory.analyse_pid_loop(
        gains, period_s=PERIOD_S, dead_time_ticks=ticks, process=process
    )
    poles = control.feedback(loop.to_control(), 1).poles()
    assert np.abs(poles).max() == pytest.approx(loop.largest_magnitude, rel=1e-6)
    assert len(poles) == len(loop.poles)


def test_a_sampled_loop_has_its_margins_and_its_step() -> None:
    loop = tl.theory.analyse_sampled_loop(4.0, period_s=PERIOD_S, dead_time_ticks=4)
    system = loop.to_control()
    gain, phase, *_ = control.margin(system)
    assert gain == pytest.approx(loop.gain_margin, rel=1e-3)
    assert np.radians(phase) == pytest.approx(loop.phase_margin_rad, rel=1e-3)
    step = control.step_response(control.feedback(system, 1), 200 * PERIOD_S).outputs
    wanted = tl.theory.compute_sampled_step_response(
        4.0, len(step), period_s=PERIOD_S, dead_time_ticks=4
    )
    np.testing.assert_allclose(step, wanted, atol=1e-9)


def test_a_process_has_its_gain_lag_and_dead_time() -> None:
    process = Process(gain=0.9, lag_s=0.2, dead_time_s=0.1, low_pass_s=0.05)
    exact = 0.9 * np.exp(-0.1j) / ((0.2j + 1.0) * (0.05j + 1.0) * 1j)
    assert process.to_control()(1j) == pytest.approx(exact, rel=1e-6)
    late = process.to_control(pade_order=0)(1j)
    assert late == pytest.approx(exact / np.exp(-0.1j), rel=1e-9)


def test_an_order_below_zero_is_refused() -> None:
    with pytest.raises(TheoryError, match="pade_order: must be at least 0, not -1"):
        Process(dead_time_s=0.1).to_control(pade_order=-1)
