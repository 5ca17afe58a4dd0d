"""Functions of numbers, as the interpreted loop has them bit for bit."""

import math
from typing import Any

import numpy as np
from numba import njit

_TURN_RAD = 2.0 * math.pi
_SPLIT = 134217729.0  # 2**27 + 1: halves the digits of a double
_TINY_M, _HUGE_M = 1e-100, 1e100  # far from where the squares of doubles lose digits

_OPTIONS = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
# No Python calls these functions, and would crash: what it needs took a third of compiling.

# Without `_nrt` numba counts nobody's references to the arrays, and refuses what would allocate
# memory, as a set does: counting took two thirds of the loop's time.
inline = njit(forceinline=True, _nrt=False, **_OPTIONS)
"""Compiles a function into those that call it."""

call = njit(_nrt=False, **_OPTIONS)
"""Compiles one that is called: what is long, and seldom asked for."""

measure = njit(_nrt=False, **_OPTIONS)
"""Compiles one that is called, and that may allocate memory."""


@inline
def least(left: float, right: float) -> float:
    """Return `min(left, right)`."""
    return right if right < left else left


@inline
def most(left: float, right: float) -> float:
    """Return `max(left, right)`."""
    return right if right > left else left


@inline
def clip(value: float, limit: float) -> float:
    """Return a value whose magnitude is bounded."""
    return least(most(value, -limit), limit)  # type: ignore[no-any-return]


@inline
def wrap_angle(angle_rad: float) -> float:
    """Return an angle as `angles.wrap_angle` does [rad]."""
    if -math.pi <= angle_rad < math.pi:
        return angle_rad
    rest = np.fmod(angle_rad, _TURN_RAD)
    rest -= _TURN_RAD * np.floor((rest + math.pi) / _TURN_RAD)
    return -math.pi if rest >= math.pi else rest


@inline
def round_to_step(value: float, step: float) -> float:
    """Return a value as `sensing.round_to_step` does."""
    if step == 0.0:
        return value
    steps = value / step
    # Python's whole numbers know no -0.0.
    return step * (np.rint(steps) + 0.0) if math.isfinite(steps) else value


@inline
def find_direction(direction: Any, angle_rad: float) -> tuple[float, float]:
    """Return cosine and sine, of the angle before as they were."""
    if angle_rad != direction.angle_rad or angle_rad == 0.0:  # there are two zeros
        direction.angle_rad = angle_rad
        direction.cosine, direction.sine = math.cos(angle_rad), math.sin(angle_rad)
    return direction.cosine, direction.sine


@inline
def round_to_float32(value: float) -> float:
    """Return the nearest 32-bit float."""
    return np.float64(np.float32(value))


@inline
def _square(value: float) -> tuple[float, float]:
    """Return a square as a sum of two doubles, exactly (Dekker's product)."""
    product = value * value
    large = _SPLIT * value
    high = large - (large - value)
    low = value - high
    return product, ((high * high - product) + 2.0 * high * low) + low * low


@inline
def find_hypot(x: float, y: float) -> float:
    """Return the nearest double to the hypotenuse, as CPython does; the libm's is not always it.

    One step of Newton from the root of the rounded squares, with what is left of them exactly.
    """
    large, small = abs(x), abs(y)
    if large < small:
        large, small = small, large
    if small == 0.0 or not math.isfinite(large):
        return large
    # By a power of two, which changes no digit: no square overflows or loses digits.
    scale = 1.0
    if not _TINY_M < large < _HUGE_M:
        scale = math.ldexp(1.0, -max(math.frexp(large)[1], -1000))
    large, small = large * scale, small * scale
    square, rest = _square(large)
    other, other_rest = _square(small)
    root = math.sqrt(square + other)
    root_square, root_rest = _square(root)
    total = square + other
    lost = other - (total - square)
    left = (total - root_square) + (lost + (rest + other_rest - root_rest))
    return (root + left / (2.0 * root)) / scale  # type: ignore[no-any-return]
