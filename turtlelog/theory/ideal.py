"""The ideal loop: an integrator under proportional feedback, Kp / (s + Kp)."""

from turtlelog.errors import TheoryError


def compute_time_constant(kp: float) -> float:
    """Return tau = 1 / Kp [s] of the closed loop of an integrator with gain Kp [1/s].

    Raises:
        TheoryError: Where the gain is not positive.
    """
    if not kp > 0.0:
        raise TheoryError(f"kp: expected a gain > 0, found {kp}")
    return 1.0 / kp


def compute_settling_time(kp: float) -> float:
    """Return 4 tau [s], the textbook's rule for the 2 % settling time (exactly: ln 50 tau)."""
    return 4.0 * compute_time_constant(kp)
