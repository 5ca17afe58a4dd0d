"""The sampled loop: y[k+1] = y[k] + Kp T (r - y[k-d]), an integrator with zero-order hold.

T is the sampling period, d the dead time in samples. The poles are the roots of z^(d+1) - z^d + Kp
T. The open loop is Kp T / (z^d (z - 1)), with the magnitude Kp T / (2 sin(w T / 2)) and the phase
-(pi / 2 + (d + 1/2) w T) at the frequency w.

A companion matrix loses half the digits where two roots meet, which is exactly where overshoot
begins. Here every root has its own equation and interval. With z = r exp(j theta), the imaginary
part of z^d (1 - z) = Kp T gives r = sin(d theta) / sin((d + 1) theta), and the real part Kp T = r^d
sin(theta) / sin((d + 1) theta). For every m >= 1 with 2 m < d, this expression rises from 0 to
infinity between 2 pi m / d and (2 m + 1) pi / (d + 1), which gives one root and its conjugate. For
m = 0 it rises from d^d / (d + 1)^(d + 1), at theta = 0. Below this gain two roots are real, on
either side of d / (d + 1). For even d, one more root is negative.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.arithmetic import SETTLING_BAND
from turtlelog.libraries import load_library
from turtlelog.theory.process import (
    require_count,
    require_dead_time,
    require_gain,
    require_level,
    require_period,
)

LARGEST_DEVIATION: Final = 1e9
"""Distance from the reference at which the response of an unstable loop is limited [steps]."""

_NEGLIGIBLE_DEVIATION: Final = 1e-20
"""Distance from the reference that counts as 0 [steps]: far below the last digit of a double near
1, 2e-16."""

_ROUNDING: Final = 1e-9  # share of a response that is larger than any rounding error of an addition

_LONGEST: Final = 2_000_000
"""Longest response for overshoot and settling time [samples]: 16 MB as doubles, and 8.9 h at
turtlesim's tick of 16 ms."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SampledLoop:
    """Properties of the sampled loop at one gain.

    Attributes:
        kp: Gain [1/s].
        period_s: Sampling period T [s].
        dead_time_ticks: Dead time d [samples].
        poles: Complex poles in the z plane, largest magnitude first, shape (d + 1,).
        stable: Whether all poles lie inside the unit circle.
        overshoots: Whether the slowest poles have left the positive real axis.
        damping_ratio: Damping ratio of the slowest pole: 1 on the positive real axis, negative if
            unstable.
        overshoot_percent: Largest sample beyond the reference after a step [% of the step]. None if
            the loop is unstable, or does not settle within 2,000,000 samples.
        settling_time_s: Time of the first sample after a step from which the response stays within
            2 % of the step [s]; None under the same conditions.
        gain_margin: Factor on Kp at the stability limit; below 1 if the loop is unstable.
        phase_margin_rad: Phase above -pi at an open-loop magnitude of 1 [rad]. None if Kp T > 2,
            because the magnitude is then above 1 at all frequencies.
        delay_margin_s: Additional dead time up to which the loop is stable [s]: phase margin
            divided by crossover frequency, exact for whole periods. None if there is no phase
            margin.
    """

    kp: float
    period_s: float
    dead_time_ticks: int
    poles: NDArray[np.complex128]
    stable: bool
    overshoots: bool
    damping_ratio: float
    overshoot_percent: float | None
    settling_time_s: float | None
    gain_margin: float
    phase_margin_rad: float | None
    delay_margin_s: float | None

    def to_control(self) -> Any:
        """Return the open loop as a `control.TransferFunction` in z, Kp T / (z^d (z - 1)).

        The function is exact. Close the loop with `control.feedback`.

        Raises:
            LibraryError: If python-control is not installed.
        """
        poles = [1.0, -1.0, *[0.0] * self.dead_time_ticks]
        return load_library("control").tf([self.kp * self.period_s], poles, self.period_s)


def compute_overshoot_gain(period_s: float, dead_time_ticks: int = 0) -> float:
    """Return the largest Kp [1/s] without overshoot: d^d / (d + 1)^(d + 1) / T; 1 / T for d = 0.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    return _compute_meeting_gain(require_dead_time(dead_time_ticks)) / require_period(period_s)


def compute_stability_gain(period_s: float, dead_time_ticks: int = 0) -> float:
    """Return the Kp [1/s] at the stability limit: 2 sin(pi / (2 (2 d + 1))) / T.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    loop_gain = _compute_stability_loop_gain(require_dead_time(dead_time_ticks))
    return loop_gain / require_period(period_s)


def analyse_sampled_loop(kp: float, *, period_s: float, dead_time_ticks: int = 0) -> SampledLoop:
    """Analyse the sampled loop at a gain: poles, margins, overshoot, settling time.

    Args:
        kp: Gain [1/s].
        period_s: Sampling period T [s].
        dead_time_ticks: Dead time d [samples], 0 to 1000.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    poles = compute_sampled_poles(kp, period_s=period_s, dead_time_ticks=dead_time_ticks)
    loop_gain = kp * period_s
    gain_margin = _compute_stability_loop_gain(dead_time_ticks) / loop_gain
    phase_margin_rad, delay_margin_s = None, None
    if loop_gain <= 2.0:
        crossover = 2.0 * math.asin(0.5 * loop_gain)
        phase_margin_rad = 0.5 * math.pi - (dead_time_ticks + 0.5) * crossover
        delay_margin_s = phase_margin_rad / crossover * float(period_s)
    respond = partial(
        compute_sampled_step_response, loop_gain, period_s=1.0, dead_time_ticks=dead_time_ticks
    )
    overshoot_percent, settling_ticks = measure_step(poles[0], dead_time_ticks, respond, _LONGEST)
    damping_ratio = 1.0
    if poles[0] not in {0.0, 1.0}:  # -Re s / |s| for s = log z / T
        exponent = np.log(complex(poles[0]))
        damping_ratio = float(-exponent.real / abs(exponent))
    return SampledLoop(
        kp=float(kp),
        period_s=float(period_s),
        dead_time_ticks=int(dead_time_ticks),
        poles=poles,
        stable=gain_margin > 1.0,
        overshoots=loop_gain > _compute_meeting_gain(dead_time_ticks),
        damping_ratio=damping_ratio,
        overshoot_percent=overshoot_percent,
        settling_time_s=None if settling_ticks is None else settling_ticks * float(period_s),
        gain_margin=gain_margin,
        phase_margin_rad=phase_margin_rad,
        delay_margin_s=delay_margin_s,
    )


def compute_sampled_step_response(
    kp: float,
    count: int,
    *,
    period_s: float,
    dead_time_ticks: int = 0,
    initial: float = 0.0,
    reference: float = 1.0,
) -> NDArray[np.float64]:
    """Return the sampled loop's response to a reference step at sample 0, without limits.

    y[k+1] = y[k] + Kp T (reference - y[k-d]), starting at rest. The command that answers sample 0
    first moves the plant between samples d and d + 1, so y[0] to y[d] are `initial`.

    An unstable response is limited. The first sample further than 1e9 steps from the reference, and
    all later samples, are set to this distance on the same side. Distances below 1e-20 steps count
    as 0.

    Args:
        kp: Gain [1/s].
        count: Number of samples, at least 1.
        period_s: Sampling period T [s].
        dead_time_ticks: Dead time d [samples], 0 to 1000.
        initial: Level before the step, in any unit.
        reference: Level after the step, in the same unit.

    Returns:
        Response in the same unit at the times 0, T, 2 T ..., shape (count,).

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    loop_gain = require_gain(kp) * require_period(period_s)
    step = require_level("initial", initial) - require_level("reference", reference)
    deviation = _compute_deviation(
        loop_gain, require_count(count), require_dead_time(dead_time_ticks)
    )
    return reference + step * deviation


def interpolate_sampled_response(
    kp: float,
    time_s: NDArray[np.float64],
    *,
    period_s: float,
    dead_time_ticks: int,
    initial: float,
    reference: float,
) -> NDArray[np.float64] | None:
    """Return the sampled loop's response at rising times after the step [s], joined by lines.

    The result is None if the loop is unstable and goes beyond `LARGEST_DEVIATION` before the last
    time. The arguments are those of `compute_sampled_step_response`.
    """
    count = int(np.ceil(time_s[-1] / period_s)) + 2
    values = compute_sampled_step_response(
        kp,
        count,
        period_s=period_s,
        dead_time_ticks=dead_time_ticks,
        initial=initial,
        reference=reference,
    )
    # Where theory stops an unstable loop, what follows is no response of that loop.
    furthest = np.abs(values[:-1] - reference).max()
    if furthest > (1.0 - _ROUNDING) * LARGEST_DEVIATION * abs(reference - initial) > 0.0:
        return None
    return np.interp(time_s, np.arange(count) * period_s, values)


def _compute_stability_loop_gain(dead_time_ticks: int) -> float:
    """Return Kp T = 2 sin(pi / (2 (2 d + 1))), at which the slowest poles cross the unit circle.

    At the crossing r = 1, so d theta + (d + 1) theta = pi, and Kp T = |1 - exp(j theta)|.
    """
    return 2.0 * math.sin(math.pi / (2 * (2 * dead_time_ticks + 1)))


def measure_step(
    slowest: complex, dead_time: int, respond: Callable[[int], NDArray[np.float64]], longest: int
) -> tuple[float | None, int | None]:
    """Return overshoot [%] and 2 % settling time [samples] of a step response.

    `slowest` is the slowest pole, and `respond` returns the first samples of the response. The
    result is None if the loop is unstable, or does not settle within the `longest` response.
    """
    # A pole at 0, which has no logarithm, counts as one of 1e-3: 0.1 % is left after one sample.
    decay = -math.log(min(max(abs(slowest), 1e-3), 1.0))
    # exp(-12) of the slowest pole is left after so many samples, far below 2 %.
    if decay * longest < 12.0:
        return None, None
    error = 1.0 - respond(10 * (dead_time + 1) + math.ceil(12.0 / decay))
    if np.abs(error).max() >= LARGEST_DEVIATION:
        return None, None
    outside = np.flatnonzero(np.abs(error) > SETTLING_BAND)
    return max(0.0, -100.0 * float(error.min())), int(outside[-1]) + 1


def _compute_deviation(loop_gain: float, count: int, dead_time_ticks: int) -> NDArray[np.float64]:
    """Return e[k+1] = e[k] - Kp T e[k-d] from e[0] = 1 and e[k] = 0 before it, shape (count,).

    Each iteration doubles the known samples. By superposition, the samples after sample n are a sum
    of copies of this response, one for every sample that the recursion still uses at n. One copy is
    scaled by e[n] and starts at n; the others are scaled by -Kp T e[n-j] and start d + 1 - j later.
    """
    deviation = np.ones(max(count, dead_time_ticks + 2))
    deviation[dead_time_ticks + 1] -= loop_gain
    known = dead_time_ticks + 2
    stop = _find_stop(deviation, 0, known)
    while known < count and stop is None:
        remembered = deviation[known - 1 - dead_time_ticks : known]
        if np.abs(remembered).max() < _NEGLIGIBLE_DEVIATION:
            deviation[known:] = 0.0
            break
        kernel = np.concatenate((remembered[-1:], -loop_gain * remembered[:-1]))
        new = deviation[known : 2 * known - 1]
        new[:] = np.convolve(deviation[:known], kernel)[1 : len(new) + 1]
        known, before = known + len(new), known
        stop = _find_stop(deviation, before, known)
    if stop is not None:
        deviation[stop:] = np.copysign(LARGEST_DEVIATION, deviation[stop])
    return deviation[:count]


def _find_stop(deviation: NDArray[np.float64], first: int, end: int) -> int | None:
    """Return the first of some samples that is too far away; None if there is none."""
    beyond = np.abs(deviation[first:end]) > LARGEST_DEVIATION
    return first + int(np.argmax(beyond)) if beyond.any() else None


def compute_sampled_poles(
    kp: float, *, period_s: float, dead_time_ticks: int = 0
) -> NDArray[np.complex128]:
    """Return the poles of the sampled loop, shape (d + 1,), largest magnitude first.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    loop_gain = require_gain(kp) * require_period(period_s)
    locus = compute_sampled_locus([loop_gain], period_s=1.0, dead_time_ticks=dead_time_ticks)
    return locus.ravel()


def compute_sampled_locus(
    kp: Sequence[float], *, period_s: float, dead_time_ticks: int = 0
) -> NDArray[np.complex128]:
    """Return the poles of the sampled loop at n gains, shape (n, d + 1), one row for each gain."""
    period_s, d = require_period(period_s), require_dead_time(dead_time_ticks)
    loop_gains = [require_gain(gain) * period_s for gain in kp]
    if d == 0:
        return np.array([[1.0 - loop_gain] for loop_gain in loop_gains], dtype=np.complex128)
    upper = _find_upper(loop_gains, d, np.arange(1, (d + 1) // 2))
    slow, negative = _find_slow_pairs(loop_gains, d), _find_negative(loop_gains, d)
    poles = np.concatenate((slow, upper, upper.conj(), negative), axis=1)
    order = np.lexsort((-poles.imag, -np.abs(poles).round(12)))
    return np.take_along_axis(poles, order, axis=1)


def _compute_meeting_gain(dead_time_ticks: int) -> float:
    """Return Kp T = d^d / (d + 1)^(d + 1), the maximum of z^d (1 - z), where two poles meet."""
    d = dead_time_ticks
    return float((d / (d + 1)) ** d / (d + 1))


def _find_slow_pairs(loop_gains: Sequence[float], d: int) -> NDArray[np.complex128]:
    """Return the two poles that meet at d / (d + 1), for each gain."""
    meeting = _compute_meeting_gain(d)
    pairs = np.full((len(loop_gains), 2), d / (d + 1), dtype=np.complex128)
    apart = [not math.isclose(gain, meeting, rel_tol=1e-14) for gain in loop_gains]
    above = np.array(loop_gains) > meeting
    if (rows := np.flatnonzero(apart & above)).size:
        upper = _find_upper([loop_gains[row] for row in rows.tolist()], d, np.array([0]))
        pairs[rows] = np.concatenate((upper, upper.conj()), axis=1)
    if (rows := np.flatnonzero(apart & ~above)).size:
        pairs[rows] = _find_real_pairs([loop_gains[row] for row in rows.tolist()], d)
    return pairs


def _find_real_pairs(loop_gains: Sequence[float], d: int) -> NDArray[np.complex128]:
    gains: NDArray[np.float64] = np.array(loop_gains)
    logs = _take_logarithms(loop_gains)

    def rise_from_one(gap: NDArray[np.float64]) -> NDArray[np.float64]:
        rise: NDArray[np.float64] = d * np.log1p(-gap) + np.log(gap / gains)
        return rise

    def rise_from_zero(root: NDArray[np.float64]) -> NDArray[np.float64]:
        return d * np.log(root) + np.log1p(-root) - logs

    gap = _bisect(rise_from_one, gains, np.minimum(math.e * gains, 1.0 / (d + 1)))
    lowest = np.array([gain ** (1.0 / d) for gain in loop_gains])
    highest = [min((gain * (d + 1)) ** (1.0 / d), d / (d + 1)) for gain in loop_gains]
    root = _bisect(rise_from_zero, lowest, np.array(highest))
    return np.column_stack((1.0 - gap, root)).astype(np.complex128)


def _find_upper(
    loop_gains: Sequence[float], d: int, order: NDArray[np.int64]
) -> NDArray[np.complex128]:
    """Return the poles above the real axis, one for each gain and order m."""
    logs = _take_logarithms(loop_gains)[:, np.newaxis]
    begin = 2.0 * math.pi * order / d
    width = (2 * order + 1) * math.pi / (d + 1) - begin

    def find_radius(share: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        # Angles from that end of the interval where their sine is small: it keeps its digits.
        last = np.where(order == 0, math.pi * share, (d + 1) * width * (1.0 - share))
        return np.sin(d * width * share) / np.sin(last), np.sin(last)

    def rise(share: NDArray[np.float64]) -> NDArray[np.float64]:
        radius, last = find_radius(share)
        sine = np.sin(begin + width * share)
        return d * np.log(radius) + np.log(sine / last) - logs

    shape = (len(loop_gains), len(order))
    share = _bisect(rise, np.zeros(shape), np.ones(shape))
    poles: NDArray[np.complex128] = find_radius(share)[0] * np.exp(1j * (begin + width * share))
    is_fast = np.array(loop_gains)[:, np.newaxis] > 2.0 * _compute_meeting_gain(d)
    polished = poles
    for _ in range(3):  # Newton's steps for log z, in which the equation is nearly linear
        excess = d * np.log(polished) + np.log1p(-polished) - logs
        turns = np.round(excess.imag / (2.0 * math.pi))
        slope = d - polished / (1.0 - polished)
        polished = polished * np.exp(-(excess - 2j * math.pi * turns) / slope)
    return np.where((order > 0) | is_fast, polished, poles)


def _find_negative(loop_gains: Sequence[float], d: int) -> NDArray[np.complex128]:
    """Return the negative pole for an even dead time, for each gain."""
    if d % 2:
        return np.empty((len(loop_gains), 0), dtype=np.complex128)
    logs = _take_logarithms(loop_gains)

    def rise(log_root: NDArray[np.float64]) -> NDArray[np.float64]:
        return d * log_root + np.log1p(np.exp(log_root)) - logs

    halved = _take_logarithms([gain / 2.0 for gain in loop_gains])
    found = _bisect(rise, np.minimum(halved / d, halved / (d + 1)), logs / d)
    return np.array([[-math.exp(root)] for root in found], dtype=np.complex128)


def _take_logarithms(numbers: Sequence[float]) -> NDArray[np.float64]:
    """Return logarithms with the same bits for a single number and for an array."""
    return np.array([math.log(number) for number in numbers])


def _bisect(
    rise: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the zero crossings of rising functions, to the last digit of the interval."""
    for _ in range(52):  # 2^-52 of the interval is left, the last digit of a double near 1
        middle = low + 0.5 * (high - low)
        is_below = rise(middle) < 0.0
        low, high = np.where(is_below, middle, low), np.where(is_below, high, middle)
    return low + 0.5 * (high - low)
