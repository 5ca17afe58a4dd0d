"""The ideal loop: an integrator under proportional feedback, Kp / (s + Kp)."""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from turtlelog.theory.inputs import require_gain, require_gains, require_positive
from turtlelog.theory.plant import PLANT, require_even_times


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
    import control

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
    import control

    gains = require_gains(kp)
    loci = control.root_locus_map(control.tf(*PLANT), gains=gains).loci
    return np.asarray(loci, dtype=np.complex128).reshape(len(gains))
