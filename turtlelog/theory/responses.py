"""Step responses to lay beside measured ones: the ideal loop's and the sampled loop's."""

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from turtlelog.theory.inputs import (
    require_count,
    require_dead_time,
    require_gain,
    require_level,
    require_period,
    require_times,
)

LARGEST_DEVIATION: Final = 1e9
"""Where the response of an unstable loop is stopped, in steps from the reference."""

_NEGLIGIBLE_DEVIATION: Final = 1e-20
_DECAYED: Final = 750.0


def compute_step_response(
    kp: float, time_s: ArrayLike, *, initial: float = 0.0, reference: float = 1.0
) -> NDArray[np.float64]:
    """Return the ideal loop's response to a step of its reference at time 0.

    y(t) = reference + (initial - reference) exp(-Kp t): the inverse Laplace transform of
    Kp / (s + Kp) 1 / s. Before time 0 it is `initial`.

    Args:
        kp: Gain [1/s].
        time_s: Times [s], any shape.
        initial: Level before the step, in any unit.
        reference: Level that is asked for, in the same unit.

    Returns:
        The response in that unit, in the shape of `time_s`.

    Raises:
        TheoryError: Where the gain is not positive or a number is not finite.
    """
    kp, times = require_gain(kp), require_times(time_s)
    step = require_level("initial", initial) - require_level("reference", reference)
    # exp(-750) is 0 in double precision: later times need no product that could overflow.
    return reference + step * np.exp(-kp * np.clip(times, 0.0, _DECAYED / kp))


def compute_sampled_step_response(
    kp: float,
    count: int,
    *,
    period_s: float,
    dead_time_ticks: int = 0,
    initial: float = 0.0,
    reference: float = 1.0,
) -> NDArray[np.float64]:
    """Return the sampled loop's response to a step of its reference at sample 0, unclipped.

    y[k+1] = y[k] + Kp T (reference - y[k-d]), at rest before: the command that answers sample 0
    first moves the plant between samples d and d + 1, so y[0] to y[d] are `initial`.

    An unstable loop is stopped: from the first sample further than 1e9 steps from the reference
    on, the response stays at that distance, on that side. Less than 1e-20 steps count as none.

    Args:
        kp: Gain [1/s].
        count: Number of samples, at least 1.
        period_s: Sampling period T [s].
        dead_time_ticks: d [samples], 0 to 1000.
        initial: Level before the step, in any unit.
        reference: Level that is asked for, in the same unit.

    Returns:
        The response in that unit at the times 0, T, 2 T ..., shape (count,).

    Raises:
        TheoryError: Where a number is not finite or outside its range.
    """
    loop_gain = require_gain(kp) * require_period(period_s)
    step = require_level("initial", initial) - require_level("reference", reference)
    deviation = _compute_deviation(
        loop_gain, require_count(count), require_dead_time(dead_time_ticks)
    )
    return reference + step * deviation


def _compute_deviation(loop_gain: float, count: int, dead_time_ticks: int) -> NDArray[np.float64]:
    """Return e[k+1] = e[k] - Kp T e[k-d] from e[0] = 1 and e[k] = 0 before it, shape (count,).

    Each round doubles what is known. By superposition the samples that follow sample n are the
    sum of this same response, once for every sample that the recursion still remembers at n:
    scaled by e[n] and starting there, and scaled by -Kp T e[n-j] and starting d + 1 - j later.
    """
    deviation = np.ones(max(count, dead_time_ticks + 2))
    deviation[dead_time_ticks + 1] -= loop_gain
    known = dead_time_ticks + 2
    stop = _find_stop(deviation[:known])
    while known < count and stop is None:
        remembered = deviation[known - 1 - dead_time_ticks : known]
        if np.abs(remembered).max() < _NEGLIGIBLE_DEVIATION:
            deviation[known:] = 0.0
            break
        kernel = np.concatenate((remembered[-1:], -loop_gain * remembered[:-1]))
        new = deviation[known : 2 * known - 1]
        new[:] = np.convolve(deviation[:known], kernel)[1 : len(new) + 1]
        known += len(new)
        stop = _find_stop(deviation[:known])
    if stop is not None:
        deviation[stop:] = np.copysign(LARGEST_DEVIATION, deviation[stop])
    return deviation[:count]


def _find_stop(deviation: NDArray[np.float64]) -> int | None:
    """Return the first sample that is too far away, None where there is none."""
    beyond = np.abs(deviation) > LARGEST_DEVIATION
    return int(np.argmax(beyond)) if beyond.any() else None
