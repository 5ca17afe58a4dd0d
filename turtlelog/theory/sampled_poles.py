"""The poles of the sampled loop: the roots of z^(d+1) - z^d + Kp T, and the gains that limit it.

A companion matrix loses half the digits where two roots meet, which is exactly where overshoot
begins. Here every root has an equation and an interval of its own. With z = r exp(j theta), the
imaginary part of z^d (1 - z) = Kp T gives r = sin(d theta) / sin((d + 1) theta), the real part
then Kp T = r^d sin(theta) / sin((d + 1) theta). Between 2 pi m / d and (2 m + 1) pi / (d + 1) this
rises from 0 to infinity, for every m >= 1 with 2 m < d: one root each, and its conjugate. For m = 0
it rises from d^d / (d + 1)^(d + 1), at theta = 0; below that gain two roots are real, on either
side of d / (d + 1). For even d one more is negative.
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray


def compute_overshoot_loop_gain(dead_time_ticks: int) -> float:
    """Return Kp T = d^d / (d + 1)^(d + 1), where the two slowest poles meet; 1 for d = 0.

    It is the largest value of z^d (1 - z) between 0 and 1, at z = d / (d + 1).
    """
    d = dead_time_ticks
    return (d / (d + 1)) ** d / (d + 1)


def compute_stability_loop_gain(dead_time_ticks: int) -> float:
    """Return Kp T = 2 sin(pi / (2 (2 d + 1))), where the slowest poles cross the unit circle.

    There r = 1, so d theta and (d + 1) theta add up to pi, and Kp T = |1 - exp(j theta)|.
    """
    return 2.0 * math.sin(math.pi / (2 * (2 * dead_time_ticks + 1)))


def find_sampled_poles(loop_gain: float, dead_time_ticks: int) -> NDArray[np.complex128]:
    """Return the d + 1 poles at a loop gain Kp T, shape (d + 1,), largest magnitude first."""
    d = dead_time_ticks
    if d == 0:
        return np.array([1.0 - loop_gain], dtype=np.complex128)
    slow, negative = _find_slow_pair(loop_gain, d), _find_negative(loop_gain, d)
    upper = _find_upper(loop_gain, d, np.arange(1, (d + 1) // 2))
    poles = np.concatenate((slow, upper, upper.conj(), negative))
    return poles[np.lexsort((-poles.imag, -np.abs(poles).round(12)))]


def _find_slow_pair(loop_gain: float, d: int) -> NDArray[np.complex128]:
    """Return the two poles that meet at d / (d + 1)."""
    if math.isclose(loop_gain, compute_overshoot_loop_gain(d), rel_tol=1e-14):
        return np.full(2, d / (d + 1), dtype=np.complex128)
    if loop_gain > compute_overshoot_loop_gain(d):
        upper = _find_upper(loop_gain, d, np.array([0]))
        return np.concatenate((upper, upper.conj()))

    def rise_from_one(gap: NDArray[np.float64]) -> NDArray[np.float64]:
        return d * np.log1p(-gap) + np.log(gap / loop_gain)

    def rise_from_zero(root: NDArray[np.float64]) -> NDArray[np.float64]:
        return d * np.log(root) + np.log1p(-root) - math.log(loop_gain)

    gap = _bisect(rise_from_one, loop_gain, min(math.e * loop_gain, 1.0 / (d + 1)))
    highest = min((loop_gain * (d + 1)) ** (1.0 / d), d / (d + 1))
    root = _bisect(rise_from_zero, loop_gain ** (1.0 / d), highest)
    return np.array([1.0 - gap[0], root[0]], dtype=np.complex128)


def _find_upper(loop_gain: float, d: int, order: NDArray[np.int64]) -> NDArray[np.complex128]:
    """Return the poles above the real axis, one for each order m."""
    begin = 2.0 * math.pi * order / d
    width = (2 * order + 1) * math.pi / (d + 1) - begin

    def find_radius(share: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        # Angles from that end of the interval where their sine is small: it keeps its digits.
        last = np.where(order == 0, math.pi * share, (d + 1) * width * (1.0 - share))
        return np.sin(d * width * share) / np.sin(last), np.sin(last)

    def rise(share: NDArray[np.float64]) -> NDArray[np.float64]:
        radius, last = find_radius(share)
        sine = np.sin(begin + width * share)
        return d * np.log(radius) + np.log(sine / last) - math.log(loop_gain)

    share = _bisect(rise, np.zeros(len(order)), np.ones(len(order)))
    poles = find_radius(share)[0] * np.exp(1j * (begin + width * share))
    is_single = (order > 0) | (loop_gain > 2.0 * compute_overshoot_loop_gain(d))
    return np.where(is_single, _polish(poles, loop_gain, d), poles)


def _polish(poles: NDArray[np.complex128], loop_gain: float, d: int) -> NDArray[np.complex128]:
    """Take Newton steps for log z on d log z + log(1 - z) = log Kp T; it is nearly linear."""
    for _ in range(3):
        excess = d * np.log(poles) + np.log1p(-poles) - math.log(loop_gain)
        turns = np.round(excess.imag / (2.0 * math.pi))
        slope = d - poles / (1.0 - poles)
        poles = poles * np.exp(-(excess - 2j * math.pi * turns) / slope)
    return poles


def _find_negative(loop_gain: float, d: int) -> NDArray[np.complex128]:
    """Return the negative pole that an even dead time has."""
    if d % 2:
        return np.empty(0, dtype=np.complex128)

    def rise(log_root: NDArray[np.float64]) -> NDArray[np.float64]:
        return d * log_root + np.log1p(np.exp(log_root)) - math.log(loop_gain)

    highest = math.log(loop_gain) / d
    lowest = math.log(loop_gain / 2.0) / d
    lowest = min(lowest, math.log(loop_gain / 2.0) / (d + 1))
    return np.array([-math.exp(_bisect(rise, lowest, highest)[0])], dtype=np.complex128)


def _bisect(
    rise: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    low: float | NDArray[np.float64],
    high: float | NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return where rising functions cross zero, to the last digit of the interval."""
    low, high = np.atleast_1d(low), np.atleast_1d(high)
    for _ in range(52):
        middle = low + 0.5 * (high - low)
        is_below = rise(middle) < 0.0
        low, high = np.where(is_below, middle, low), np.where(is_below, high, middle)
    return low + 0.5 * (high - low)
