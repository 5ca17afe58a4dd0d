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
fourth powers keep their digits. A loop without dead time is unstable from 4 on already."""

_LONGEST: Final = 500_000
"""In samples, of the response that overshoot and settling time are read from: about 0.2 s of
computing, and 2.2 h at turtlesim's tick of 16 ms."""

_MOST_ROUNDS: Final = 300
_SMALLEST_STEP: Final = 1e-15
"""Of a root's magnitude: it moves by its last digit only."""

_ON_AXIS: Final = 1e-12
"""Imaginary part of a root, as a share of its magnitude, that is rounding."""


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
        dead_time_ticks: d [samples], 0 to 1000; several hundred take a second or two.

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
    shape = _build_shape(gains, period_s, dead_time_ticks)
    poles, zeros = _expand(shape)
    found: NDArray[np.float64] = np.concatenate((poles, np.zeros(shape.delay)))
    found[-3:] += zeros[-len(found) :]
    return found


def compute_pid_poles(
    gains: PidGains, *, period_s: float, dead_time_ticks: int = 0
) -> NDArray[np.complex128]:
    """Return the poles of a closed PID loop in the z plane, largest magnitude first.

    Where two poles meet, as every root of a polynomial they are known to half the digits, about
    1e-8. Whether the loop is stable hangs on nothing of the kind: ask `is_pid_stable`.

    Raises:
        TheoryError: Where a number is not finite or outside its range.
    """
    if gains.is_proportional:
        return compute_sampled_poles(gains.kp, period_s=period_s, dead_time_ticks=dead_time_ticks)
    shape = _build_shape(gains, period_s, dead_time_ticks)
    found = _solve_quadratic(shape) if shape.degree == 2 else _find_roots(shape)
    return found[np.lexsort((-found.imag, -np.abs(found).round(12)))]


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


def _expand(shape: LoopShape) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return A and B of z^d A + B, highest power of z first."""
    c0, c1, c2 = shape.numerator
    poles = np.array([1.0, -1.0]) if shape.integrators == 1 else np.array([1.0, -2.0, 1.0])
    if shape.a is not None:
        poles = np.polymul(poles, [1.0, -shape.a])
    return poles, np.array([c2, c1 - 2.0 * c2, c2 - c1 + c0])


def _solve_quadratic(shape: LoopShape) -> NDArray[np.complex128]:
    """Return the poles of PI or PD without dead time: exact where two meet, in s = z - 1."""
    c0, c1, _ = shape.numerator
    half = 0.5 * (c1 + (0.0 if shape.a is None else 1.0 - shape.a))
    root = np.sqrt(complex(half * half - c0))
    far = -half - (root if root.real >= 0.0 else -root)
    near = c0 / far if root.imag == 0.0 else far.conjugate()
    return np.array([1.0 + far, 1.0 + near], dtype=np.complex128)


def _find_roots(shape: LoopShape) -> NDArray[np.complex128]:
    """Return the roots by Aberth's method: Newton's steps, the other roots divided out.

    It begins on a circle, turned a little so that no two of them mirror each other, and needs some
    10 to 40 rounds where all roots are single, more where some crowd.
    """
    angles = 2.0 * math.pi * (np.arange(shape.degree) + 0.37) / shape.degree
    roots = 0.98 * np.exp(1j * angles)
    distances = np.empty((shape.degree, shape.degree), dtype=np.complex128)
    for _ in range(_MOST_ROUNDS):
        np.subtract(roots[:, None], roots, out=distances)
        distances[distances == 0.0] = np.inf
        with np.errstate(all="ignore"):  # at a root itself the slope has no bound: no step
            others = np.divide(1.0, distances, out=distances).sum(axis=1)
            step = 1.0 / (_compute_log_slope(roots, shape) - others)
        step[~np.isfinite(step)] = 0.0
        roots = roots - step
        if (np.abs(step) <= _SMALLEST_STEP * np.abs(roots)).all():
            break
    return _mirror(roots)


def _mirror(roots: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return the roots of a real polynomial as exact pairs, and those of the real axis on it."""
    is_real = np.abs(roots.imag) < _ON_AXIS * np.abs(roots)
    upper = roots[~is_real & (roots.imag > 0.0)]
    if 2 * len(upper) + is_real.sum() != len(roots):  # two that meet, on one side of the axis
        return roots
    return np.concatenate((roots[is_real].real, upper, upper.conj()))


def _compute_log_slope(z: NDArray[np.complex128], shape: LoopShape) -> NDArray[np.complex128]:
    """Return P' / P of the characteristic polynomial, computed where z^d does not overflow.

    In powers of z - 1, as slow poles crowd there.
    """
    s, d, (c0, c1, c2) = z - 1.0, shape.delay, shape.numerator
    poles, slope = s**shape.integrators, shape.integrators / s
    if shape.a is not None:
        poles, slope = poles * (z - shape.a), slope + 1.0 / (z - shape.a)
    zeros, zeros_slope = c0 + s * (c1 + s * c2), c1 + 2.0 * c2 * s
    inside = np.abs(z) <= 1.0
    power = np.where(inside, z, 1.0 / z) ** d
    within = (power * poles * (slope + d / z) + zeros_slope) / (power * poles + zeros)
    beyond = (poles * (slope + d / z) + power * zeros_slope) / (poles + power * zeros)
    found: NDArray[np.complex128] = np.where(inside, within, beyond)
    return found


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
