"""The ideal loop: an integrator under proportional feedback, Kp / (s + Kp)."""

import math

from turtlelog.theory.inputs import require_gain


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
