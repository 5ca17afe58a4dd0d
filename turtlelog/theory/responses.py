"""The ideal loop, Kp / (s + Kp), and the sampled one: step responses, pole, settling times."""

import math
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from turtlelog.theory.inputs import (
    require_count,
    require_dead_time,
    require_gain,
    require_gains,
    require_level,
    require_period,
    require_positive,
    require_times,
)
from turtlelog.theory.continuous_loop import PLANT, load_control, require_even_times

LARGEST_DEVIATION: Final = 1e9
"""Where the response of an unstable loop is stopped, in steps from the reference."""

_NEGLIGIBLE_DEVIATION: Final = 1e-20
_DECAYED: Final = 750.0


def compute_time_constant(kp: float) -> float:
    """Return tau = 1 / Kp [s] of the closed loop of an integrator with gain Kp [1/s].

    Raises:
        TheoryError: Where the gain is not a positive number.
    """
    return 1.0 / require_gain(kp)


def compute_settling_time(kp: float) -> float:
    """Return 4 tau [s], the textbook's rule for the 2 % settling time."""
    return 4.0 * compute_time_constant(kp)


def compute_exact_settling_time(kp: float) -> float:
    """Return ln 50 tau [s], when exp(-t / tau) is 2 %: 3.912 tau."""
    return math.log(50.0) * compute_time_constant(kp)


def compute_saturated_settling_time(kp: float, *, step: float, limit: float) -> float:
    """Return the 2 % settling time [s] of the ideal loop whose command is clipped to a limit.

    While Kp e > limit the error falls at that rate; the rest decays: with E = limit / Kp < step it
    takes (step - E) / limit + tau ln(E / (0.02 step)), or 0.98 step / limit where E is inside 2 %.

    Args:
        kp: Gain [1/s].
        step: How far the reference is away, > 0, in m or rad.
        limit: Largest rate, > 0, in the same unit per second.

    Raises:
        TheoryError: Where one of them is not a positive number.
    """
    tau_s = compute_time_constant(kp)
    step, limit = require_positive("step", step), require_positive("limit", limit)
    unclipped = limit * tau_s
    if unclipped >= step:
        return compute_exact_settling_time(kp)
    if unclipped <= 0.02 * step:
        return 0.98 * step / limit
    return (step - unclipped) / limit + tau_s * math.log(unclipped / (0.02 * step))


def compute_closed_loop_response(kp: float, time_s: ArrayLike) -> NDArray[np.float64]:
    """Return the unit step response of Kp / (s + Kp), by python-control (figure 4).

    Args:
        kp: Gain [1/s].
        time_s: Times [s], shape (n,), from 0 in even steps, n at least 2.

    Raises:
        TheoryError: Where the gain is not a positive number, or times are not even.
    """
    control = load_control()
    kp, times = require_gain(kp), require_even_times(time_s)
    response = control.step_response(control.tf([kp], [1.0, kp]), times)
    return np.asarray(response.outputs, dtype=np.float64)


def compute_root_locus(kp: ArrayLike) -> NDArray[np.complex128]:
    """Return the closed loop's pole for gains from 0 up, by python-control (figure 5).

    Args:
        kp: Gains [1/s], shape (n,), none negative.

    Returns:
        Poles in the s plane [1/s], shape (n,): -Kp, from the plant's pole at 0 to the left.

    Raises:
        TheoryError: Where a gain is negative or no number.
    """
    control, gains = load_control(), require_gains(kp)
    loci = control.root_locus_map(control.tf(*PLANT), gains=gains).loci
    return np.asarray(loci, dtype=np.complex128).reshape(len(gains))


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
