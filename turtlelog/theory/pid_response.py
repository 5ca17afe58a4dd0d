"""The step response of a sampled PID loop, at samples and between them, and its metrics."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.theory.inputs import require_count, require_level, require_period
from turtlelog.theory.pid_stability import PidGains
from turtlelog.theory.process import INTEGRATOR, Process, SampledProcess, sample_process
from turtlelog.theory.sampled_loop import LARGEST_DEVIATION

_LONGEST: Final = 500_000
"""Longest response for overshoot and settling time [samples]: about 0.2 s of computing, and 2.2 h
at turtlesim's tick of 16 ms."""

_BAND: Final = 0.02
"""Settling band as a share of the step."""

_LONGEST_MOTION: Final = 200_000
"""Longest motion that is followed between samples [samples]: about 0.3 s of computing."""

_SETTLED: Final = 1e-9
"""Remaining motion that counts as settled, as a share of the step: 1e-7 % of overshoot."""


def compute_pid_step_response(
    gains: PidGains,
    count: int,
    *,
    period_s: float,
    dead_time_ticks: int = 0,
    push: float = 0.0,
    process: Process = INTEGRATOR,
) -> NDArray[np.float64]:
    """Return a PID loop's response to a unit reference step at sample 0, without limits.

    The response begins at rest, with y[0] to y[d] = 0. An unstable response is limited. The first
    sample further than 1e9 from the reference, and all later samples, are set to a distance of 1e9
    on the same side.

    Args:
        gains: Gains of the controller.
        count: Number of samples, 1 to 1e8; a million takes about half a second.
        period_s: Sampling period T [s].
        dead_time_ticks: Dead time in addition to that of the process [samples], 0 to 1000.
        push: Disturbance added to the plant's rate from sample 0 on, in steps per second.
        process: Plant that the command drives. Default: an integrator.

    Returns:
        Response in steps at the times 0, T, 2 T ..., shape (count,).

    Raises:
        TheoryError: If a number is not finite or outside its range.
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
    outside = np.flatnonzero(np.abs(error) > _BAND)
    return max(0.0, -100.0 * float(error.min())), (int(outside[-1]) + 1) * float(period_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class StepMotion:
    """Motion of a loop after a reference step, also between samples.

    Attributes:
        overshoot_percent: Overshoot [% of the step]; 0: no overshoot.
        settling_time_s: Time of the first sample from which the motion stays within 2 % of the step
            [s]; None if the motion was not followed to rest.
    """

    overshoot_percent: float
    settling_time_s: float | None


def measure_step_motion(
    gains: PidGains,
    *,
    period_s: float,
    dead_time_ticks: int = 0,
    process: Process = INTEGRATOR,
    to_rest: bool = True,
) -> StepMotion | None:
    """Return the motion of a loop after a reference step, without limits.

    Between two samples the plant receives one command and then the next. The motion is therefore
    known in closed form: its rate follows each command exponentially, and the motion reverses where
    the rate is 0.

    Args:
        gains: Gains of the controller.
        period_s: Sampling period T [s].
        dead_time_ticks: Dead time in addition to that of the process [samples].
        process: Plant that the command drives. Default: an integrator.
        to_rest: Whether to follow the motion to rest; otherwise the motion is followed only until
            the overshoot is known.

    Returns:
        The motion; None if it goes beyond 1e9 steps, or if after 200,000 samples it is neither at
        rest nor past its furthest point.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    period_s = require_period(period_s)
    sampled = sample_process(process, period_s, dead_time_ticks)
    motion = _Motion(process, sampled, period_s)
    keep, slope = gains.weigh_derivative(period_s)
    kp, per_error, filter_gap = gains.kp, gains.ki * period_s, sampled.filter_gap
    commands = [0.0] * (sampled.whole + 1)
    patience = 4 * (sampled.whole + 1)
    last = integral = derivative = filtered = 0.0
    quiet = outside = 0
    furthest_at = -1
    for k in range(_LONGEST_MOTION):
        error = 1.0 - motion.y
        outside = k if abs(error) > _BAND else outside
        derivative = keep * derivative - slope * (motion.y - last)
        command = kp * error + integral + derivative
        if filter_gap is not None:
            command = filtered = filtered + filter_gap * (command - filtered)
        commands.append(command)
        integral += per_error * error
        last = motion.y
        before = motion.furthest
        motion.hold(commands[k], commands[k + 1])
        furthest_at = k if motion.furthest > before else furthest_at
        quiet = quiet + 1 if motion.is_settled() else 0
        is_known = furthest_at >= 0 and k > 2 * furthest_at + patience
        if quiet > patience or (is_known and not to_rest):
            settling_time_s = (outside + 1) * period_s if quiet else None
            return StepMotion(
                overshoot_percent=100.0 * (motion.furthest - 1.0), settling_time_s=settling_time_s
            )
        if abs(error) > LARGEST_DEVIATION:
            return None
    overshoot_percent = 100.0 * (motion.furthest - 1.0)
    found = StepMotion(overshoot_percent=overshoot_percent, settling_time_s=None)
    return found if is_known else None


class _Motion:
    """Rate and signal `y` of a process between samples, from rest; `furthest` is at least 1."""

    __slots__ = ("_gain", "_lag_s", "_pieces", "_v", "_wait_s", "furthest", "y")

    def __init__(self, process: Process, sampled: SampledProcess, period_s: float) -> None:
        self._gain = process.gain
        self._lag_s = lag_s = process.lag_s if sampled.lag_gap is not None else 0.0
        parts = enumerate((sampled.part, 1.0 - sampled.part))
        times_s = ((number, part * period_s) for number, part in parts if part > 0.0)
        self._pieces = tuple(
            (number, time_s, -math.expm1(-time_s / lag_s) if lag_s else 1.0)
            for number, time_s in times_s
        )
        self._wait_s = period_s + lag_s
        self._v, self.y, self.furthest = 0.0, 0.0, 1.0

    def is_settled(self) -> bool:
        """Return whether the process is at rest at 1, within a negligible overshoot."""
        return abs(self.y - 1.0) < _SETTLED and abs(self._v) * self._wait_s < _SETTLED

    def hold(self, *commands: float) -> None:
        """Advance by one sample, in which one command acts and then the next."""
        y, v, furthest, lag_s = self.y, self._v, self.furthest, self._lag_s
        for number, time_s, gap in self._pieces:
            w = self._gain * commands[number]
            if v > 0.0 > w and y + lag_s * v > furthest:  # it may turn back on the way
                turn_s = lag_s * math.log1p(-v / w)
                if turn_s < time_s:
                    furthest = max(furthest, y + lag_s * v + w * turn_s)
            y += w * time_s + lag_s * (v - w) * gap
            v += gap * (w - v)
            furthest = max(furthest, y)
        self.y, self._v, self.furthest = y, v, furthest


def compute_steady_error(gains: PidGains, push: float, *, process: Process = INTEGRATOR) -> float:
    """Return r - y after a constant disturbance in a stable loop: -push / (K Kp), 0 with Ki.

    At rest the plant's input is 0, so K times the command is -push. Without an integral, Kp e must
    produce this command. With an integral, the integral produces the command, and is at rest only
    if e = 0. A derivative is 0 at rest.

    Args:
        gains: Gains of the controller.
        push: Disturbance added to the plant's rate, in the signal's unit per second.
        process: Plant that the command drives; only the gain of the plant is used.

    Returns:
        Error in the signal's unit.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    push = require_level("push", push)
    return 0.0 if gains.ki > 0.0 else -push / (gains.kp * process.gain)
