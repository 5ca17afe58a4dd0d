"""The poles of the sampled loop of `sampled_loop`: the roots of z^(d+1) - z^d + Kp T.

A companion matrix loses half the digits where two roots meet, which is exactly where overshoot
begins. Here every root has an equation and an interval of its own. With z = r exp(j theta), the
imaginary part of z^d (1 - z) = Kp T gives r = sin(d theta) / sin((d + 1) theta), the real part
then Kp T = r^d sin(theta) / sin((d + 1) theta). Between 2 pi m / d and (2 m + 1) pi / (d + 1) this
rises from 0 to infinity, for every m >= 1 with 2 m < d: one root each, and its conjugate. For m = 0
it rises from d^d / (d + 1)^(d + 1), at theta = 0; below that gain two roots are real, on either
side of d / (d + 1). For even d one more is negative.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from turtlelog.theory.inputs import require_dead_time, require_gain, require_period


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
    """Return the poles of the sampled loop at n gains, shape (n, d + 1), as for each gain alone.

    Raises:
        TheoryError: If a number is not finite or outside its range.
    """
    period_s, d = require_period(period_s), require_dead_time(dead_time_ticks)
    loop_gains = [require_gain(gain) * period_s for gain in kp]
    if d == 0:
        return np.array([[1.0 - loop_gain] for loop_gain in loop_gains], dtype=np.complex128)
    upper = _find_upper(loop_gains, d, np.arange(1, (d + 1) // 2))
    slow, negative = _find_slow_pairs(loop_gains, d), _find_negative(loop_gains, d)
    poles = np.concatenate((slow, upper, upper.conj(), negative), axis=1)
    order = np.lexsort((-poles.imag, -np.abs(poles).round(12)))
    return np.take_along_axis(poles, order, axis=1)


def compute_meeting_gain(dead_time_ticks: int) -> float:
    """Return Kp T = d^d / (d + 1)^(d + 1), where the two slowest poles meet; 1 for d = 0.

    It is the largest value of z^d (1 - z) between 0 and 1, at z = d / (d + 1).
    """
    d = dead_time_ticks
    return float((d / (d + 1)) ** d / (d + 1))


def _find_slow_pairs(loop_gains: Sequence[float], d: int) -> NDArray[np.complex128]:
    """Return the two poles that meet at d / (d + 1), for each gain."""
    meeting = compute_meeting_gain(d)
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
    poles = find_radius(share)[0] * np.exp(1j * (begin + width * share))
    is_fast = np.array(loop_gains)[:, np.newaxis] > 2.0 * compute_meeting_gain(d)
    return np.where((order > 0) | is_fast, _polish(poles, logs, d), poles)


def _polish(
    poles: NDArray[np.complex128], logs: NDArray[np.float64], d: int
) -> NDArray[np.complex128]:
    """Take Newton steps for log z on d log z + log(1 - z) = log Kp T; it is nearly linear."""
    for _ in range(3):
        excess = d * np.log(poles) + np.log1p(-poles) - logs
        turns = np.round(excess.imag / (2.0 * math.pi))
        slope = d - poles / (1.0 - poles)
        poles = poles * np.exp(-(excess - 2j * math.pi * turns) / slope)
    return poles


def _find_negative(loop_gains: Sequence[float], d: int) -> NDArray[np.complex128]:
    """Return the negative pole that an even dead time has, for each gain."""
    if d % 2:
        return np.empty((len(loop_gains), 0), dtype=np.complex128)
    logs = _take_logarithms(loop_gains)

    def rise(log_root: NDArray[np.float64]) -> NDArray[np.float64]:
        return d * log_root + np.log1p(np.exp(log_root)) - logs

    halved = _take_logarithms([gain / 2.0 for gain in loop_gains])
    found = _bisect(rise, np.minimum(halved / d, halved / (d + 1)), logs / d)
    return np.array([[-math.exp(root)] for root in found], dtype=np.complex128)


def _take_logarithms(numbers: Sequence[float]) -> NDArray[np.float64]:
    """Return logarithms that are the same to the last bit for one number and for many."""
    return np.array([math.log(number) for number in numbers])


def _bisect(
    rise: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return where rising functions cross zero, to the last digit of the interval."""
    for _ in range(52):  # 2^-52 of the interval is left, the last digit of a double near 1
        middle = low + 0.5 * (high - low)
        is_below = rise(middle) < 0.0
        low, high = np.where(is_below, middle, low), np.where(is_below, high, middle)
    return low + 0.5 * (high - low)
