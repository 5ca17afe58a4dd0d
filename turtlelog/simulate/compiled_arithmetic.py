"""Functions of `arithmetic` whose compiled code is another one, with the same values.

Compiled into the loops that call them; plain Python never comes here.
"""

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final

from numpy import (
    ceil as ceil_of_numpy,
    float32,
    float64,
    floor as floor_of_numpy,
    fmod as fmod_of_numpy,
    rint,
)

from turtlelog import arithmetic
from turtlelog.run import angles

_SPLIT: Final = 134217729.0  # 2**27 + 1: halves the digits of a double
_TINY_M, _HUGE_M = 1e-100, 1e100  # far from where the squares of doubles lose digits


def _nearest(value: float) -> float:
    found: float = rint(value) + 0.0
    return found


def _nearest_int(value: float) -> int:
    return int(rint(value))


def _fmod(value: float, by: float) -> float:
    found: float = fmod_of_numpy(value, by)
    return found


def _floor(value: float) -> float:
    found: float = floor_of_numpy(value)
    return found


def _ceil(value: float) -> float:
    found: float = ceil_of_numpy(value) + 0.0
    return found


def _to_float32(value: float) -> float:
    return float64(float32(value))


def _pose_to_float32(x_m: float, y_m: float, heading_rad: float) -> tuple[float, float, float]:
    return float64(float32(x_m)), float64(float32(y_m)), float64(float32(heading_rad))


def _message_to_float32(
    x_m: float, y_m: float, heading_rad: float, speed: float, turn_rate: float
) -> tuple[float, float, float, float, float]:
    x_m, y_m, heading_rad = _pose_to_float32(x_m, y_m, heading_rad)
    return x_m, y_m, heading_rad, _to_float32(speed), _to_float32(turn_rate)


def _begin_row(rows: Any, new: Any, number: int) -> Any:
    rows[number] = new
    return rows[number]


def _square(value: float) -> tuple[float, float]:
    """Return a square as a sum of two doubles, exactly (Dekker's product)."""
    product = value * value
    large = _SPLIT * value
    high = large - (large - value)
    low = value - high
    return product, ((high * high - product) + 2.0 * high * low) + low * low


def _find_hypot(x: float, y: float) -> float:
    """Return the nearest double to the hypotenuse, as CPython does.

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
    return (root + left / (2.0 * root)) / scale


TWINS: Final[Mapping[Callable[..., Any], Callable[..., Any]]] = MappingProxyType(
    {
        arithmetic.hypot: _find_hypot,
        arithmetic.fmod: _fmod,
        arithmetic.floor: _floor,
        arithmetic.ceil: _ceil,
        arithmetic.nearest: _nearest,
        arithmetic.nearest_int: _nearest_int,
        arithmetic.to_float32: _to_float32,
        arithmetic.pose_to_float32: _pose_to_float32,
        arithmetic.message_to_float32: _message_to_float32,
        arithmetic.begin_row: _begin_row,
        angles.wrap_angle: arithmetic.wrap_angle,
    }
)
"""What compiled code calls in place of a function."""
