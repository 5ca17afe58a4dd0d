"""The sampled PID loop on an integrator: y[k+1] = y[k] + T u[k-d], held between samples.

The controller, as the law `sequential-pid` computes it, with e = r - y:

    u[k] = Kp e[k] + I[k] + D[k]
    I[k+1] = I[k] + Ki T e[k],  I[0] = 0
    D[k] = a D[k-1] - Kd / (Tf + T) (y[k] - y[k-1]),  a = Tf / (Tf + T),  D[0] = 0

The integral is a forward difference, so it acts one sample later. The derivative is that of the
measurement, a backward difference behind a filter of first order: K. J. Astrom and B. Wittenmark,
Computer-Controlled Systems, 3rd edition, chapter 8; K. J. Astrom and T. Hagglund, Advanced PID
Control, chapters 3 and 13. The z transform of that gives the characteristic polynomial

    z^d (z - 1)^2 (z - a) + Kp T (z - 1) (z - a) + Ki T^2 (z - a) + b (z - 1)^2

with b = Kd T / (Tf + T). Without an integral one factor z - 1 leaves it, without a derivative
z - a. P alone is the business of `sampled_loop`, whose numbers are returned here.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import TheoryError
from turtlelog.theory.inputs import (
    require_count,
    require_dead_time,
    require_gain,
    require_level,
    require_not_negative,
    require_period,
)
from turtlelog.theory.pid_poles import expand_polynomial, find_poles
from turtlelog.theory.pid_stability import LoopShape, find_stable_intervals, is_stable
from turtlelog.theory.sampled_loop import (
    LARGEST_DEVIATION,
    analyse_sampled_loop,
    compute_sampled_poles,
    compute_stability_gain,
)

_SMALLEST_LOOP_GAIN: Final = 1e-9
_LARGEST_LOOP_GAIN: Final = 1e9
"""Of Kp T, Ki T^2 and Kd T / (Tf + T), beside an integral or a derivative: their squares and
fourth powers keep their digits. No stable loop comes near the upper end."""

_LONGEST: Final = 500_000
"""In samples, of the response that overshoot and settling time are read from: about 0.2 s of
computing, and 2.2 h at turtlesim's tick of 16 ms."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PidGains:
    """Gains of a P, PI, PD or PID controller.

    Attributes:
        kp: Proportional gain [1/s].
        ki: Integral gain [1/s^2]; 0: no integral.
        kd: Derivative gain [1]; 0: no derivative.
        filter_s: Time constant Tf of the derivative's filter [s]; 0: a plain difference.

    Raises:
        TheoryError: Where a gain is not finite, negative, or Kp not positive.
    """

    kp: float
    ki: float = 0.0
    kd: float = 0.0
    filter_s: float = 0.0

    def __post_init__(self) -> None:
        require_gain(self.kp)
        for name in ("ki", "kd", "filter_s"):
            require_not_negative(name, getattr(self, name))

    @property
    def is_proportional(self) -> bool:
        """Whether it is P alone."""
        return self.ki == 0.0 and self.kd == 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PidLoop:
    """What a sampled PID loop does.

    Attributes:
        gains: Of the controller.
        period_s: Sampling period T [s].
        dead_time_ticks: d [samples].
        poles: Complex, in the z plane, largest magnitude first: d + 1 of P, one more with an
            integral, one more with a derivative. Of two that meet, half the digits are known.
        stable: All poles lie inside the unit circle, farther from it than rounding reaches.
        stable_gains: Intervals of Kp [1/s] in which the loop is stable with its other gains as
            they are; () where there is none.
        overshoot_percent: Furthest sample beyond the reference after a step [% of the step]; None
            where it is unstable or slower than 500,000 samples (P alone: 2,000,000).
        settling_time_s: First sample after a step from which on it stays within 2 % [s]; None as
            before.
    """

    gains: PidGains
    period_s: float
    dead_time_ticks: int
    poles: NDArray[np.complex128]
    stable: bool
    stable_gains: tuple[tuple[float, float], ...]
    overshoot_percent: float | None
    settling_time_s: float | None

    @property
    def largest_magnitude(self) -> float:
        """Magnitude of the slowest pole; 1 and above where the loop is unstable."""
        return float(abs(self.poles[0]))


def analyse_pid_loop(gains: PidGains, *, period_s: float, dead_time_ticks: int = 0) -> PidLoop:
    """Return what a PID loop does: poles, verdict, range of its gain, overshoot, settling time.

    Args:
        gains: Of the controller.
        period_s: Sampling period T [s].
        dead_time_ticks: d [samples], 0 to 1000; with 1000 it takes about half a second.

    Raises:
        TheoryError: Where a number is not finite or outside its range.
    """
    poles = compute_pid_poles(gains, period_s=period_s, dead_time_ticks=dead_time_ticks)
    stable = is_pid_stable(gains, period_s=period_s, dead_time_ticks=dead_time_ticks)
    overshoot_percent, settling_time_s = None, None
    if gains.is_proportional:
        known = analyse_sampled_loop(gains.kp, period_s=period_s, dead_time_ticks=dead_time_ticks)
        overshoot_percent, settling_time_s = known.overshoot_percent, known.settling_time_s
    elif stable:
        overshoot_percent, settling_time_s = _measure_step(
            gains, poles, period_s=period_s, dead_time_ticks=dead_time_ticks
        )
    return PidLoop(
        gains=gains,
        period_s=float(period_s),
        dead_time_ticks=int(dead_time_ticks),
        poles=poles,
        stable=stable,
        stable_gains=find_stable_gains(gains, period_s=period_s, dead_time_ticks=dead_time_ticks),
        overshoot_percent=overshoot_percent,
        settling_time_s=settling_time_s,
    )


def compute_pid_polynomial(
    gains: PidGains, *, period_s: float, dead_time_ticks: int = 0
) -> NDArray[np.float64]:
    """Return the characteristic polynomial in z of a closed PID loop, highest power first.

    Raises:
        TheoryError: Where a number is not finite or outside its range.
    """
    return expand_polynomial(_build_shape(gains, period_s, dead_time_ticks))


def compute_pid_poles(
    gains: PidGains, *, period_s: float, dead_time_ticks: int = 0
) -> NDArray[np.complex128]:
    """Return the poles of a closed PID loop in the z plane, largest magnitude first.

    Where two poles meet, as every root of a polynomial they are known to half the digits, about
    1e-8. The verdict of `is_pid_stable` does not depend on them.

    Raises:
        TheoryError: Where a number is not finite or outside its range.
    """
    if gains.is_proportional:
        return compute_sampled_poles(gains.kp, period_s=period_s, dead_time_ticks=dead_time_ticks)
    return find_poles(_build_shape(gains, period_s, dead_time_ticks))


def is_pid_stable(gains: PidGains, *, period_s: float, dead_time_ticks: int = 0) -> bool:
    """Return whether all poles of a closed PID loop lie inside the unit circle.

    They are counted by the argument principle, which is as good at 1000 ticks as at none. At the
    limit itself, and so near to it that rounding could decide (1e-10), the answer is False.

    Raises:
        TheoryError: Where a number is not finite or outside its range.
    """
    if gains.is_proportional:
        loop_gain = gains.kp * require_period(period_s)
        return compute_stability_gain(1.0, dead_time_ticks) / loop_gain > 1.0
    return is_stable(_build_shape(gains, period_s, dead_time_ticks))


def find_stable_gains(
    gains: PidGains, *, period_s: float, dead_time_ticks: int = 0
) -> tuple[tuple[float, float], ...]:
    """Return the intervals of Kp [1/s] in which a loop is stable, its other gains held.

    P and PD begin at 0. An integral needs some Kp beside it, so PI and PID begin above 0; too much
    of it and there is no interval left. The ends themselves are unstable.

    Args:
        gains: Of the controller; its own Kp does not count.
        period_s: Sampling period T [s].
        dead_time_ticks: d [samples], 0 to 1000.

    Raises:
        TheoryError: Where a number is not finite or outside its range.
    """
    if gains.is_proportional:
        return ((0.0, compute_stability_gain(period_s, dead_time_ticks)),)
    period_s = require_period(period_s)
    held = _build_shape(replace(gains, kp=1.0 / period_s), period_s, dead_time_ticks)
    found = find_stable_intervals(lambda p: replace(held, p=p), held)
    return tuple((low / period_s, high / period_s) for low, high in found)


def compute_pid_step_response(
    gains: PidGains,
    count: int,
    *,
    period_s: float,
    dead_time_ticks: int = 0,
    push: float = 0.0,
) -> NDArray[np.float64]:
    """Return a PID loop's response to a unit step of its reference at sample 0, unclipped.

    It begins at rest, with y[0] to y[d] = 0. An unstable loop is stopped: from the first sample
    further than 1e9 from the reference on, it stays at that distance, on that side.

    Args:
        gains: Of the controller.
        count: Number of samples, 1 to 1e8; a million takes about half a second.
        period_s: Sampling period T [s].
        dead_time_ticks: d [samples], 0 to 1000.
        push: What is added to the command from sample 0 on, in steps per second.

    Returns:
        The response in steps at the times 0, T, 2 T ..., shape (count,).

    Raises:
        TheoryError: Where a number is not finite or outside its range.
    """
    period_s, delay = require_period(period_s), require_dead_time(dead_time_ticks)
    response = np.empty(require_count(count))
    push = require_level("push", push)
    keep, rate = _weigh_derivative(gains, period_s)
    kp, per_error = gains.kp, gains.ki * period_s
    commands = [0.0] * delay
    y = last = integral = derivative = 0.0
    for k in range(len(response)):
        response[k] = y
        error = 1.0 - y
        if abs(error) > LARGEST_DEVIATION:
            response[k:] = 1.0 - math.copysign(LARGEST_DEVIATION, error)
            break
        derivative = keep * derivative - rate * (y - last)
        commands.append(kp * error + integral + derivative)
        integral += per_error * error
        last = y
        y += period_s * (commands[k] + push)
    return response


def compute_steady_error(gains: PidGains, push: float) -> float:
    """Return r - y that a constant push leaves in a stable loop: -push / Kp, 0 with an integral.

    At rest the plant's input is 0, so the command is -push. Without an integral Kp e must make it;
    with one the integral does, and it is at rest only where e = 0. A derivative is 0 at rest.

    Args:
        gains: Of the controller.
        push: What is added to the command, in the signal's unit per second.

    Returns:
        The error in the signal's unit.

    Raises:
        TheoryError: Where a number is not finite or outside its range.
    """
    push = require_level("push", push)
    return 0.0 if gains.ki > 0.0 else -push / gains.kp


def _weigh_derivative(gains: PidGains, period_s: float) -> tuple[float, float]:
    """Return a = Tf / (Tf + T) and Kd / (Tf + T) [1/s]."""
    whole_s = gains.filter_s + period_s
    return gains.filter_s / whole_s, gains.kd / whole_s


def _build_shape(gains: PidGains, period_s: float, dead_time_ticks: int) -> LoopShape:
    period_s, delay = require_period(period_s), require_dead_time(dead_time_ticks)
    keep, rate = _weigh_derivative(gains, period_s)
    p, i, b = gains.kp * period_s, gains.ki * period_s * period_s, rate * period_s
    if not gains.is_proportional:
        _require_loop_gain("Kp T", p, lowest=_SMALLEST_LOOP_GAIN)
        _require_loop_gain("Ki T^2", i, lowest=0.0)
        _require_loop_gain("Kd T / (Tf + T)", b, lowest=0.0)
    return LoopShape(p=p, i=i, b=b, a=keep if gains.kd > 0.0 else None, delay=delay)


def _require_loop_gain(name: str, value: float, *, lowest: float) -> None:
    if not lowest <= value <= _LARGEST_LOOP_GAIN:
        expected = f"a loop gain from {lowest:g} to {_LARGEST_LOOP_GAIN:g}"
        raise TheoryError(f"{name}: expected {expected}, found {value!r}")


def _measure_step(
    gains: PidGains, poles: NDArray[np.complex128], *, period_s: float, dead_time_ticks: int
) -> tuple[float | None, float | None]:
    """Return overshoot [%] and 2 % settling time [s] of a stable loop's step response."""
    # A pole at 0, which has no logarithm, counts as one of 1e-3.
    decay = -math.log(min(max(abs(poles[0]), 1e-3), 1.0))
    # exp(-12) of the slowest pole is left after so many samples, far below 2 %.
    if decay * _LONGEST < 12.0:
        return None, None
    count = 10 * (dead_time_ticks + 1) + math.ceil(12.0 / decay)
    error = 1.0 - compute_pid_step_response(
        gains, count, period_s=period_s, dead_time_ticks=dead_time_ticks
    )
    if np.abs(error).max() > LARGEST_DEVIATION:
        return None, None
    outside = np.flatnonzero(np.abs(error) > 0.02)
    return max(0.0, -100.0 * float(error.min())), (int(outside[-1]) + 1) * float(period_s)
