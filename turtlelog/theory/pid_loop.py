"""The sampled PID loop with a process and zero-order hold: poles, stability, step response.

The controller, as the law `sequential-pid` computes it, with e = r - y:

    u[k] = Kp e[k] + I[k] + D[k]
    I[k+1] = I[k] + Ki T e[k],  I[0] = 0
    D[k] = a D[k-1] - Kd / (Tf + T) (y[k] - y[k-1]),  a = Tf / (Tf + T),  D[0] = 0

The integral is a forward difference and acts one sample later. The derivative is that of the
measurement, a backward difference behind a filter of first order: K. J. Astrom and B. Wittenmark,
Computer-Controlled Systems, 3rd edition, chapter 8; K. J. Astrom and T. Hagglund, Advanced PID
Control, chapters 3 and 13. On an integrator, y[k+1] = y[k] + T u[k-d], the z transform of that
gives the characteristic polynomial

    z^d (z - 1)^2 (z - a) + Kp T (z - 1) (z - a) + Ki T^2 (z - a) + b (z - 1)^2

with b = Kd T / (Tf + T). Without an integral, the polynomial has one factor z - 1 less. Without a
derivative, it has no factor z - a. Lag, fractional dead time and low-pass are added in `process`
and `pid_stability`. For P alone on an integrator, the numbers come from `sampled_loop`.

Poles are the roots of z^d A(z) + B(z), found together by Aberth's method (O. Aberth, "Iteration
methods for finding all zeros of a polynomial simultaneously", Mathematics of Computation 27 (1973)
339-344). The method needs only the polynomial's value and slope, which come from A and B. 1000
poles take a third of a second; the eigenvalues of a companion matrix would take many seconds.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from turtlelog.errors import TheoryError
from turtlelog.theory import pid_stability, sampled_loop
from turtlelog.theory.pid_stability import LoopShape, Margins, PidGains
from turtlelog.theory.process import (
    INTEGRATOR,
    Process,
    build_open_loop,
    require_count,
    require_level,
    require_period,
    require_times,
    sample_process,
)
from turtlelog.theory.sampled_loop import LARGEST_DEVIATION

_LONGEST: Final = 500_000
"""Longest response for overshoot and settling time [samples]: about 0.2 s of computing, and 2.2 h
at turtlesim's tick of 16 ms."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PidLoop:
    """Properties of a sampled PID loop.

    Attributes:
        gains: Gains of the controller.
        period_s: Sampling period T [s].
        dead_time_ticks: Dead time in addition to that of the process [samples].
        process: Plant that the command drives.
        poles: Complex poles in the z plane, largest magnitude first: d + 1 for P, and one more each
            for an integral, a derivative, a time constant, a low-pass, or a fractional dead time.
            If two poles meet, only half of their digits are accurate.
        stable: Whether all poles lie inside the unit circle, by more than rounding.
        stable_gains: Intervals of Kp [1/s] in which the loop is stable with its other gains
            unchanged; () if there is no such interval.
        overshoot_percent: Largest sample beyond the reference after a step [% of the step]. None if
            the loop is unstable, or does not settle within 500,000 samples (P alone: 2,000,000).
        settling_time_s: Time of the first sample after a step from which the response stays within
            2 % of the step [s]; None under the same conditions.
        margins: Stability margins; None if the loop is unstable.
    """

    gains: PidGains
    period_s: float
    dead_time_ticks: int
    process: Process
    poles: NDArray[np.complex128]
    stable: bool
    stable_gains: tuple[tuple[float, float], ...]
    overshoot_percent: float | None
    settling_time_s: float | None
    margins: Margins | None

    @property
    def dead_time_s(self) -> float:
        """Total dead time [s]."""
        return self.dead_time_ticks * self.period_s + self.process.dead_time_s

    @property
    def largest_magnitude(self) -> float:
        """Magnitude of the slowest pole; 1 or more if the loop is unstable."""
        return float(abs(self.poles[0]))

    @property
    def moves_between(self) -> bool:
        """Whether the signal may reach its peak between samples; an integrator's turns at them."""
        sampled = sample_process(self.process, self.period_s)
        return self.process.lag_s > 0.0 or sampled.part > 0.0

    def to_control(self) -> Any:
        """Return the open loop as a `control.TransferFunction` in z, without approximation.

        `control.feedback` closes this loop. The derivative acts on the measurement, so the closed
        loop has the same response to the reference only for P and PI.

        Raises:
            LibraryError: If python-control is not installed.
        """
        shape, _ = _prepare(self.gains, self.period_s, self.dead_time_ticks, self.process)
        return build_open_loop(shape, self.period_s)


def analyse_pid_loop(
    gains: PidGains, *, period_s: float, dead_time_ticks: int = 0, process: Process = INTEGRATOR
) -> PidLoop:
    """Analyse a PID loop: poles, stability, range of its gain, step response, margins.

    Args:
        gains: Gains of the controller.
        period_s: Sampling period T [s].
        dead_time_ticks: Dead time in addition to that of the process [samples], 0 to 1000 in total;
            with 1000 the analysis takes about half a second.
        process: Plant that the command drives. Default: an integrator.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    settings: dict[str, Any] = {"dead_time_ticks": dead_time_ticks, "process": process}
    poles = compute_pid_poles(gains, period_s=period_s, **settings)
    shape, whole = _prepare(gains, period_s, dead_time_ticks, process)
    stable = _judge(shape, whole)
    overshoot_percent, settling_time_s = None, None
    if whole is not None:
        kp = gains.kp * process.gain
        known = sampled_loop.analyse_sampled_loop(kp, period_s=period_s, dead_time_ticks=whole)
        overshoot_percent, settling_time_s = known.overshoot_percent, known.settling_time_s
    elif stable:
        dead_time = sample_process(process, period_s, dead_time_ticks).whole
        respond = partial(compute_pid_step_response, gains, period_s=period_s, **settings)
        overshoot_percent, ticks = sampled_loop.measure_step(poles[0], dead_time, respond, _LONGEST)
        settling_time_s = None if ticks is None else ticks * float(period_s)
    return PidLoop(
        gains=gains,
        period_s=float(period_s),
        dead_time_ticks=int(dead_time_ticks),
        process=process,
        poles=poles,
        stable=stable,
        stable_gains=find_stable_gains(gains, period_s=period_s, **settings),
        overshoot_percent=overshoot_percent,
        settling_time_s=settling_time_s,
        margins=pid_stability.find_margins(shape, float(period_s)) if stable else None,
    )


def compute_pid_poles(
    gains: PidGains, *, period_s: float, dead_time_ticks: int = 0, process: Process = INTEGRATOR
) -> NDArray[np.complex128]:
    """Return the poles of a closed PID loop in the z plane, largest magnitude first.

    If two poles meet, only half of their digits are accurate, about 1e-8, as for every double root
    of a polynomial. The verdict of `is_pid_stable` does not depend on them.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    shape, whole = _prepare(gains, period_s, dead_time_ticks, process)
    if whole is None:
        found = _solve_quadratic(shape) if shape.degree == 2 else _iterate(shape)
        return found[np.lexsort((-found.imag, -np.abs(found).round(12)))]
    return sampled_loop.compute_sampled_poles(
        gains.kp * process.gain, period_s=period_s, dead_time_ticks=whole
    )


def compute_pid_locus(
    gains: PidGains,
    kp: Sequence[float],
    *,
    period_s: float,
    dead_time_ticks: int = 0,
    process: Process = INTEGRATOR,
) -> NDArray[np.complex128]:
    """Return the poles of a closed PID loop for several Kp with its other gains fixed, in rows.

    Each row equals the result of `compute_pid_poles`; for P on an integrator this function is much
    faster.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    _, whole = _prepare(gains, period_s, dead_time_ticks, process)
    if whole is not None:
        own = [gain * process.gain for gain in kp]
        found = sampled_loop.compute_sampled_locus(own, period_s=period_s, dead_time_ticks=whole)
        return found.ravel()
    settings: dict[str, Any] = {"dead_time_ticks": dead_time_ticks, "process": process}
    poles = [compute_pid_poles(replace(gains, kp=k), period_s=period_s, **settings) for k in kp]
    return np.concatenate(poles)


def is_pid_stable(
    gains: PidGains, *, period_s: float, dead_time_ticks: int = 0, process: Process = INTEGRATOR
) -> bool:
    """Return whether all poles of a closed PID loop lie inside the unit circle.

    The poles are counted by the argument principle, which is as accurate at 1000 ticks as at 0. At
    the stability limit, or so close that rounding could decide (1e-10), the answer is False.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    return _judge(*_prepare(gains, period_s, dead_time_ticks, process))


def find_stable_gains(
    gains: PidGains, *, period_s: float, dead_time_ticks: int = 0, process: Process = INTEGRATOR
) -> tuple[tuple[float, float], ...]:
    """Return the intervals of Kp [1/s] in which a loop is stable with its other gains fixed.

    For P and PD the first interval begins at 0. For PI and PID it begins above 0, because an
    integral needs some Kp; with a too large integral there is no interval. The loop is unstable at
    both ends of an interval. The Kp of `gains` is ignored.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    period_s = require_period(period_s)
    per_gain = period_s * process.gain
    gains = gains if gains.is_proportional else replace(gains, kp=1.0 / per_gain)
    held, whole = _prepare(gains, period_s, dead_time_ticks, process)
    if whole is not None:
        return ((0.0, sampled_loop.compute_stability_gain(period_s, whole) / process.gain),)
    found = pid_stability.find_stable_intervals(lambda p: replace(held, p=p), held)
    return tuple((low / per_gain, high / per_gain) for low, high in found)


def compute_open_loop(
    gains: PidGains,
    frequency_rad_s: ArrayLike,
    *,
    period_s: float,
    dead_time_ticks: int = 0,
    process: Process = INTEGRATOR,
) -> NDArray[np.complex128]:
    """Return the frequency response of the open loop, in the shape of the frequencies.

    Args:
        gains: Gains of the controller.
        frequency_rad_s: Frequencies [rad/s], above 0 and up to pi / T.
        period_s: Sampling period T [s].
        dead_time_ticks: Dead time in addition to that of the process [samples], 0 to 1000 in total.
        process: Plant that the command drives. Default: an integrator.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    shape, _ = _prepare(gains, period_s, dead_time_ticks, process)
    angle = require_times(frequency_rad_s) * period_s
    if not ((angle > 0.0) & (angle <= np.pi * (1.0 + 1e-12))).all():
        raise TheoryError("frequency_rad_s: expected frequencies above 0 and up to pi / T")
    return pid_stability.evaluate_open_loop(shape, angle)


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
    # The weights of commands d, d + 1 and d + 2 samples old in the input of the lag.
    weights = [sampled.ahead, 1.0 - sampled.ahead - sampled.behind, sampled.behind]
    if lag_gap is None:
        weights = [*weights[1:], 0.0]
    newest, older, oldest = (sampled.gain * weight for weight in weights)
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


def _prepare(
    gains: PidGains, period_s: float, dead_time_ticks: int, process: Process
) -> tuple[LoopShape, int | None]:
    """Return a loop, and the dead time [samples] if the loop is P on an integrator."""
    sampled = sample_process(process, period_s, dead_time_ticks)
    is_known = gains.is_proportional and sampled.is_integrator
    return pid_stability.build_shape(gains, sampled, period_s), sampled.whole if is_known else None


def _judge(shape: LoopShape, whole: int | None) -> bool:
    if whole is None:
        return pid_stability.is_stable(shape)
    return sampled_loop.compute_stability_gain(1.0, whole) / shape.p > 1.0


_MOST_ROUNDS: Final = 300
"""Largest number of iterations. Where several roots meet, each iteration halves the error; after 50
iterations no digit changes any more."""

_SMALLEST_STEP: Final = 1e-15
"""Smallest step as a share of a root's magnitude: the root moves only by its last digit."""

_ON_AXIS: Final = 1e-12
"""Imaginary part of a root, as a share of its magnitude, that counts as rounding."""


def _solve_quadratic(shape: LoopShape) -> NDArray[np.complex128]:
    """Return the poles of a loop with two poles, computed in s = z - 1; exact if the poles meet."""
    c0, c1, *_ = _expand_zeros(shape)
    gaps = shape.gaps if shape.a is None else (1.0 - shape.a, *shape.gaps)
    half = 0.5 * (c1 + sum(gaps) + shape.delay + shape.lift)
    root = np.sqrt(complex(half * half - c0))
    far = -half - (root if root.real >= 0.0 else -root)
    near = c0 / far if root.imag == 0.0 else far.conjugate()
    return np.array([1.0 + far, 1.0 + near], dtype=np.complex128)


def _expand_zeros(shape: LoopShape) -> list[float]:
    """Return the polynomial B and its factor from the process, in rising powers of z - 1."""
    weights = [1.0, shape.ahead]
    if shape.lift:
        weights = [1.0, 1.0 + shape.ahead - shape.behind, shape.ahead]
    found: list[float] = np.convolve(shape.numerator, weights).tolist()
    return [value * math.prod(shape.gaps) for value in found]


def _iterate(shape: LoopShape) -> NDArray[np.complex128]:
    """Return the roots by Newton's iterations with the other roots divided out.

    The start values lie on a circle, rotated slightly so that no two are conjugate. If all roots
    are single, 10 to 40 iterations are enough; roots close together need more.
    """
    angles = 2.0 * math.pi * (np.arange(shape.degree) + 0.37) / shape.degree
    roots: NDArray[np.complex128] = 0.98 * np.exp(1j * angles)
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
    # The roots of a real polynomial are exact conjugate pairs or exact real numbers.
    is_real = np.abs(roots.imag) < _ON_AXIS * np.abs(roots)
    upper = roots[~is_real & (roots.imag > 0.0)]
    if 2 * len(upper) + is_real.sum() != len(roots):  # two that meet, on one side of the axis
        return roots
    return np.concatenate((roots[is_real].real, upper, upper.conj()))


def _compute_log_slope(z: NDArray[np.complex128], shape: LoopShape) -> NDArray[np.complex128]:
    """Return P' / P of the characteristic polynomial, computed such that z^d does not overflow.

    The computation uses powers of z - 1, because slow poles are close to 1.
    """
    s, d = z - 1.0, shape.delay + shape.lift
    poles, slope = s**shape.integrators, shape.integrators / s
    if shape.a is not None:
        poles, slope = poles * (z - shape.a), slope + 1.0 / (z - shape.a)
    for gap in shape.gaps:
        poles, slope = poles * (s + gap), slope + 1.0 / (s + gap)
    c0, c1, c2, *c3 = _expand_zeros(shape)
    zeros, zeros_slope = c0 + s * (c1 + s * c2), c1 + 2.0 * c2 * s
    for order, value in enumerate(c3, start=3):
        zeros += value * s**order
        zeros_slope += order * value * s ** (order - 1)
    inside = np.abs(z) <= 1.0
    power = np.where(inside, z, 1.0 / z) ** d
    within = (power * poles * (slope + d / z) + zeros_slope) / (power * poles + zeros)
    beyond = (poles * (slope + d / z) + power * zeros_slope) / (poles + power * zeros)
    found: NDArray[np.complex128] = np.where(inside, within, beyond)
    return found
