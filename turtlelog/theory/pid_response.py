"""The step response of a sampled PID loop, sample by sample, and what is read from it."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.theory.inputs import require_count, require_level, require_period
from turtlelog.theory.pid_gains import PidGains
from turtlelog.theory.process import INTEGRATOR, Process, sample_process
from turtlelog.theory.sampled_loop import LARGEST_DEVIATION

_LONGEST: Final = 500_000
"""In samples, of the response that overshoot and settling time are read from: about 0.2 s of
computing, and 2.2 h at turtlesim's tick of 16 ms."""


def compute_pid_step_response(
    gains: PidGains,
    count: int,
    *,
    period_s: float,
    dead_time_ticks: int = 0,
    push: float = 0.0,
    process: Process = INTEGRATOR,
) -> NDArray[np.float64]:
    """Return a PID loop's response to a unit step of its reference at sample 0, unclipped.

    It begins at rest, with y[0] to y[d] = 0. An unstable loop is stopped: from the first sample
    further than 1e9 from the reference on, it stays at that distance, on that side.

    Args:
        gains: Of the controller.
        count: Number of samples, 1 to 1e8; a million takes about half a second.
        period_s: Sampling period T [s].
        dead_time_ticks: Dead time beside that of the process [samples], 0 to 1000.
        push: What is added to the plant's rate from sample 0 on, in steps per second.
        process: What the command passes; an integrator unless given.

    Returns:
        The response in steps at the times 0, T, 2 T ..., shape (count,).

    Raises:
        TheoryError: Where a number is not finite or outside its range.
    """
    period_s = require_period(period_s)
    sampled = sample_process(process, period_s, dead_time_ticks)
    response = np.empty(require_count(count))
    push = require_level("push", push)
    keep, slope = gains.weigh_derivative(period_s)
    kp, per_error = gains.kp, gains.ki * period_s
    lag_gap, filter_gap = sampled.lag_gap, sampled.filter_gap
    newest, older, oldest = sampled.list_weights()
    commands = [0.0] * (sampled.whole + 2)
    y = last = integral = derivative = filtered = rate = 0.0
    for k in range(len(response)):
        response[k] = y
        error = 1.0 - y
        if abs(error) > LARGEST_DEVIATION:
            response[k:] = 1.0 - math.copysign(LARGEST_DEVIATION, error)
            break
        derivative = keep * derivative - slope * (y - last)
        command = kp * error + integral + derivative
        if filter_gap is not None:
            command = filtered = filtered + filter_gap * (command - filtered)
        commands.append(command)
        integral += per_error * error
        last = y
        drive = newest * commands[k + 2] + older * commands[k + 1] + oldest * commands[k]
        rate = drive if lag_gap is None else rate + lag_gap * (drive - rate)
        y += period_s * (rate + push)
    return response


def measure_pid_step(
    gains: PidGains,
    poles: NDArray[np.complex128],
    *,
    period_s: float,
    dead_time_ticks: int,
    process: Process,
) -> tuple[float | None, float | None]:
    """Return overshoot [%] and 2 % settling time [s] of a stable loop's step response."""
    # A pole at 0, which has no logarithm, counts as one of 1e-3.
    decay = -math.log(min(max(abs(poles[0]), 1e-3), 1.0))
    # exp(-12) of the slowest pole is left after so many samples, far below 2 %.
    if decay * _LONGEST < 12.0:
        return None, None
    dead_time = sample_process(process, period_s, dead_time_ticks).whole
    count = 10 * (dead_time + 1) + math.ceil(12.0 / decay)
    error = 1.0 - compute_pid_step_response(
        gains, count, period_s=period_s, dead_time_ticks=dead_time_ticks, process=process
    )
    if np.abs(error).max() > LARGEST_DEVIATION:
        return None, None
    outside = np.flatnonzero(np.abs(error) > 0.02)
    return max(0.0, -100.0 * float(error.min())), (int(outside[-1]) + 1) * float(period_s)


def compute_steady_error(gains: PidGains, push: float, *, process: Process = INTEGRATOR) -> float:
    """Return r - y that a constant push leaves in a stable loop: -push / (K Kp), 0 with Ki.

    At rest the plant's input is 0, so K times the command is -push. Without an integral Kp e must
    make it; with one the integral does, and it is at rest only where e = 0. A derivative is 0 at
    rest.

    Args:
        gains: Of the controller.
        push: What is added to the plant's rate, in the signal's unit per second.
        process: What the command passes; only its gain counts.

    Returns:
        The error in the signal's unit.

    Raises:
        TheoryError: Where a number is not finite or outside its range.
    """
    push = require_level("push", push)
    return 0.0 if gains.ki > 0.0 else -push / (gains.kp * process.gain)
