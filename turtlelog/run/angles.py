"""Wrapping and differences of headings [rad], counter-clockwise positive."""

import math
from typing import overload

import numpy as np
from numpy.typing import NDArray

from turtlelog import arithmetic

_TURN_RAD = 2.0 * math.pi


@overload
def wrap_angle(angle_rad: float) -> float: ...
@overload
def wrap_angle(angle_rad: NDArray[np.float64]) -> NDArray[np.float64]: ...
def wrap_angle(angle_rad: float | NDArray[np.float64]) -> float | NDArray[np.float64]:
    """Return the same direction in [-pi, pi) [rad]; arrays keep their shape.

    An angle already in this interval is returned unchanged.
    """
    if isinstance(angle_rad, np.ndarray):
        turned = np.fmod(angle_rad, _TURN_RAD)
        wrapped = turned - _TURN_RAD * np.floor((turned + np.pi) / _TURN_RAD)
        # Just below -pi the sum rounds up to pi itself, which is the same direction as -pi.
        wrapped = np.where(wrapped >= np.pi, -np.pi, wrapped)
        inside = (angle_rad >= -np.pi) & (angle_rad < np.pi)
        return np.asarray(np.where(inside, angle_rad, wrapped))
    return arithmetic.wrap_angle(angle_rad)


@overload
def subtract_headings(to_rad: float, from_rad: float) -> float: ...
@overload
def subtract_headings(
    to_rad: float | NDArray[np.float64], from_rad: NDArray[np.float64]
) -> NDArray[np.float64]: ...
def subtract_headings(
    to_rad: float | NDArray[np.float64], from_rad: float | NDArray[np.float64]
) -> float | NDArray[np.float64]:
    """Return the smallest rotation from one heading to another [rad], in [-pi, pi)."""
    return wrap_angle(to_rad - from_rad)
