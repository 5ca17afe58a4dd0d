"""Processes and loops as objects of python-control, which is loaded when one is asked for."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.polynomial import polynomial

from turtlelog.errors import TheoryError
from turtlelog.libraries import load_library

if TYPE_CHECKING:
    from turtlelog.theory.pid_stability import LoopShape


def build_delayed(
    numerator: Sequence[float], denominator: Sequence[float], dead_time_s: float, pade_order: int
) -> Any:
    """Return a continuous `control.TransferFunction` behind a dead time.

    Args:
        numerator: Coefficients in falling powers of s.
        denominator: Likewise.
        dead_time_s: Dead time [s].
        pade_order: Order of the Pade approximation of the dead time; 0: no dead time.

    Raises:
        TheoryError: The order is negative.
        LibraryError: python-control is not installed.
    """
    if pade_order < 0:
        raise TheoryError(f"pade_order: must be at least 0, not {pade_order}")
    control = load_library("control")
    system = control.tf(list(numerator), list(denominator))
    if not pade_order or not dead_time_s:
        return system
    return control.tf(*control.pade(dead_time_s, pade_order)) * system


def build_open_loop(shape: "LoopShape", period_s: float) -> Any:
    """Return the open loop of a sampled PID loop as a discrete `control.TransferFunction`.

    It is exact, as dead time is a power of z. `control.feedback` closes it; the derivative acts on
    the measurement, so the closed loop answers a disturbance of the command, and with P and PI the
    reference as well.

    Raises:
        LibraryError: python-control is not installed.
    """
    lags = [(gap, (gap - 1.0, 1.0)) for gap in shape.gaps]
    above: list[Any] = [
        _shift(shape.numerator),
        (shape.behind, 1.0 - shape.ahead - shape.behind, shape.ahead),
        *((gap,) for gap, _ in lags),
    ]
    below: list[Any] = [
        *[(-1.0, 1.0)] * shape.integrators,
        *([(-shape.a, 1.0)] if shape.a is not None else []),
        *(pole for _, pole in lags),
    ]
    delay = shape.delay + 1  # the weights of the process, times z
    if not shape.behind:
        above[1], delay = above[1][1:], shape.delay
    (above if delay < 0 else below).append((0.0,) * abs(delay) + (1.0,))
    tf = load_library("control").tf
    return tf(_expand(above), _expand(below), period_s)


def _shift(coefficients: Sequence[float]) -> Any:
    """Return a polynomial in z - 1 as one in z, rising powers."""
    total = np.zeros(1)
    for power, value in enumerate(coefficients):
        total = polynomial.polyadd(total, value * polynomial.polypow((-1.0, 1.0), power))
    return total


def _expand(factors: Sequence[Any]) -> Any:
    """Return a product of polynomials in falling powers."""
    product = np.ones(1)
    for factor in factors:
        product = polynomial.polymul(product, factor)
    return np.trim_zeros(product[::-1], "f")
