"""Projection of 3D poses to x, y and heading, with a description of the loss."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]

MOST_HEIGHT_M: Final = 0.05
"""Range of heights that counts as a plane [m]: a door sill, or noise of a tracking camera."""

MOST_TILT_RAD: Final = 0.1
"""Tilt that counts as upright [rad]: at 0.1 rad a path seen from above is 0.5 % too short."""


LEAST_LEVEL: Final = math.cos(math.radians(85.0))
"""Smallest horizontal part of a forward axis of length 1 that gives a heading.

At 85 deg of pitch, 1 deg of noise turns the heading by 11 deg."""


def describe_height(z_m: Values | None, tilt_rad: Values | None) -> str | None:
    """Return a sentence on a robot that leaves the plane; None if it stays in the plane.

    Args:
        z_m: Heights [m], shape (n,); None if unknown. Values that are not finite are ignored.
        tilt_rad: Angles between the robot's vertical axis and the world's [rad], shape (n,).
    """
    heights, tilts = _keep_finite(z_m), _keep_finite(tilt_rad)
    found = []
    if len(heights) and (height := float(np.ptp(heights))) > MOST_HEIGHT_M:
        low_m, high_m = float(heights.min()), float(heights.max())
        found.append(f"its height varies by {height:.3g} m ({low_m:.3g} to {high_m:.3g} m)")
    if len(tilts) and float(tilts.max()) > MOST_TILT_RAD:
        ends = (f"{math.degrees(end):.3g}" for end in (tilts.min(), tilts.max()))
        tilt = f"{' to '.join(dict.fromkeys(ends))} deg"
        if not found and float(np.ptp(tilts)) <= MOST_TILT_RAD:
            # For example a frame whose z axis points down, or that of a camera.
            return f"the robot or its frame is tilted by {tilt} throughout; {_SEEN}"
        found.append(f"it tilts by {tilt}")
    if not found:
        return None
    return f"the robot leaves the plane: {' and '.join(found)}; {_SEEN}"


_SEEN: Final = "most metrics are seen from above"


def describe_level(z_m: Values | None) -> str | None:
    """Return a sentence on the height of a robot that stays in a plane; None if it is about 0.

    Args:
        z_m: As in `describe_height`.
    """
    heights = _keep_finite(z_m)
    if not len(heights) or abs(level_m := float(np.median(heights))) <= MOST_HEIGHT_M:
        return None
    return f"the poses are at a height of {level_m:.3g} m, which is left out"


def lift_poses(z_m: Values | None, tilt_rad: Values | None) -> dict[str, Values]:
    """Return the heights and tilts of a robot that leaves the plane, by column name.

    Args:
        z_m: As in `describe_height`.
        tilt_rad: As in `describe_height`.
    """
    if describe_height(z_m, tilt_rad) is None:
        return {}
    found = {"height_m": z_m, "tilt_rad": tilt_rad}
    return {
        name: np.where(np.isfinite(values), values, np.nan)
        for name, values in found.items()
        if values is not None and np.isfinite(values).any()
    }


def compute_heading(x: Values, y: Values, z: Values, w: Values) -> Values:
    """Return the heading of the forward axis projected onto the plane, for any tilt [rad].

    The result is NaN if the axis points up or down (`LEAST_LEVEL`).

    Args:
        x: x of quaternions of any length except 0, shape (n,), like the others.
        y: y of the quaternions.
        z: z of the quaternions.
        w: Scalar part of the quaternions.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # lengths beyond 1e154 overflow
        left, ahead = 2.0 * (w * z + x * y), w**2 + x**2 - y**2 - z**2
        level = np.hypot(left, ahead) >= LEAST_LEVEL * (w**2 + x**2 + y**2 + z**2)
        return np.where(level, np.arctan2(left, ahead), np.nan)


def compute_tilt(x: Values, y: Values, z: Values, w: Values) -> Values:
    """Return the angle between the vertical axes before and after a rotation [rad], in [0, pi].

    Args:
        x: x of quaternions of any length except 0, shape (n,), like the others.
        y: y of the quaternions.
        z: z of the quaternions.
        w: Scalar part of the quaternions.
    """
    return 2.0 * np.arctan2(np.hypot(x, y), np.hypot(w, z))


def _keep_finite(values: Values | None) -> Values:
    return np.zeros(0) if values is None else values[np.isfinite(values)]
