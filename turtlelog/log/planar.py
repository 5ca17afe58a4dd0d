"""Poses in space -> what is lost when only x, y and heading are kept."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]

MOST_HEIGHT_M: Final = 0.05
"""Range of heights that counts as a plane [m]: a door sill, or the noise of a tracking camera."""

MOST_TILT_RAD: Final = 0.1
"""Tilt that counts as upright [rad]: at 0.1 rad a way seen from above is 0.5 % too short."""


def describe_plane(z_m: Values | None, tilt_rad: Values | None) -> str | None:
    """Return one sentence on a robot that leaves the plane, None where it stays in it.

    Args:
        z_m: Heights [m], shape (n,); None where they are not known. What is not finite is ignored.
        tilt_rad: Angles between the robot's vertical axis and the world's [rad], likewise.
    """
    heights, tilts = _keep_finite(z_m), _keep_finite(tilt_rad)
    found = []
    if len(heights) and (height := float(np.ptp(heights))) > MOST_HEIGHT_M:
        found.append(f"its height varies by {height:.3g} m")
    if len(tilts) and (tilt := float(tilts.max())) > MOST_TILT_RAD:
        found.append(f"it tilts by up to {math.degrees(tilt):.3g} deg")
    if not found:
        return None
    return f"the robot leaves the plane: {' and '.join(found)}; only x, y and heading are kept"


def compute_heading(x: Values, y: Values, z: Values, w: Values) -> Values:
    """Return the heading of the forward axis, seen from above, however the robot leans [rad].

    Args:
        x: Of quaternions of any length but 0, shape (n,), as the others.
        y: Likewise.
        z: Likewise.
        w: Their scalar part.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # of lengths beyond 1e154 there is none
        return np.arctan2(2.0 * (w * z + x * y), w**2 + x**2 - y**2 - z**2)


def compute_tilt(x: Values, y: Values, z: Values, w: Values) -> Values:
    """Return the angle between the vertical axes before and after a rotation [rad], in [0, pi].

    Args:
        x: Of quaternions of any length but 0, shape (n,), as the others.
        y: Likewise.
        z: Likewise.
        w: Their scalar part.
    """
    return 2.0 * np.arctan2(np.hypot(x, y), np.hypot(w, z))


def _keep_finite(values: Values | None) -> Values:
    return np.zeros(0) if values is None else values[np.isfinite(values)]
