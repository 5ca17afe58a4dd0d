"""The poles of a sampled PID loop: the roots of z^d A(z) + B(z), found together.

Aberth's method (O. Aberth, "Iteration methods for finding all zeros of a polynomial
simultaneously", Mathematics of Computation 27 (1973) 339-344) needs the polynomial's value and its
slope only, and these come from A and B: 1000 poles take a third of a second, where the eigenvalues
of a companion matrix take many.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.theory.pid_stability import LoopShape

_MOST_ROUNDS: Final = 300
"""Where several roots meet, each round halves what is left: after 50 no digit changes any more."""

_SMALLEST_STEP: Final = 1e-15
"""Of a root's magnitude: it moves by its last digit only."""

_ON_AXIS: Final = 1e-12
"""Imaginary part of a root, as a share of its magnitude, that is rounding."""


def find_poles(shape: LoopShape) -> NDArray[np.complex128]:
    """Return the poles of a loop, largest magnitude first."""
    found = _solve_quadratic(shape) if shape.degree == 2 else _iterate(shape)
    return found[np.lexsort((-found.imag, -np.abs(found).round(12)))]


def _solve_quadratic(shape: LoopShape) -> NDArray[np.complex128]:
    """Return the poles of a loop that has two: exact where they meet, in s = z - 1."""
    c0, c1, *_ = _expand_zeros(shape)
    gaps = shape.gaps if shape.a is None else (1.0 - shape.a, *shape.gaps)
    half = 0.5 * (c1 + sum(gaps) + shape.delay + shape.lift)
    root = np.sqrt(complex(half * half - c0))
    far = -half - (root if root.real >= 0.0 else -root)
    near = c0 / far if root.imag == 0.0 else far.conjugate()
    return np.array([1.0 + far, 1.0 + near], dtype=np.complex128)


def _expand_zeros(shape: LoopShape) -> list[float]:
    """Return B and what the process multiplies it by, in rising powers of z - 1."""
    weights = [1.0, shape.ahead]
    if shape.lift:
        weights = [1.0, 1.0 + shape.ahead - shape.behind, shape.ahead]
    found: list[float] = np.convolve(shape.numerator, weights).tolist()
    return [value * math.prod(shape.gaps) for value in found]


def _iterate(shape: LoopShape) -> NDArray[np.complex128]:
    """Return the roots by Newton's steps with the other roots divided out.

    It begins on a circle, turned a little so that no two of them mirror each other, and needs some
    10 to 40 rounds where all roots are single, more where some crowd.
    """
    angles = 2.0 * math.pi * (np.arange(shape.degree) + 0.37) / shape.degree
    roots = 0.98 * np.exp(1j * angles)
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
    return _mirror(roots)


def _mirror(roots: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return the roots of a real polynomial as exact pairs, and those of the real axis on it."""
    is_real = np.abs(roots.imag) < _ON_AXIS * np.abs(roots)
    upper = roots[~is_real & (roots.imag > 0.0)]
    if 2 * len(upper) + is_real.sum() != len(roots):  # two that meet, on one side of the axis
        return roots
    return np.concatenate((roots[is_real].real, upper, upper.conj()))


def _compute_log_slope(z: NDArray[np.complex128], shape: LoopShape) -> NDArray[np.complex128]:
    """Return P' / P of the characteristic polynomial, computed where z^d does not overflow.

    In powers of z - 1, as slow poles crowd there.
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
