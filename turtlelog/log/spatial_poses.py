"""Poses in space: their projection onto the plane with its losses, and rigid transforms."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]

_MOST_HEIGHT_M: Final = 0.05
"""Range of heights that counts as a plane [m]: a door sill, or noise of a tracking camera."""

_MOST_TILT_RAD: Final = 0.1
"""Tilt that counts as upright [rad]: at 0.1 rad a path seen from above is 0.5 % too short."""


_LEAST_LEVEL: Final = math.cos(math.radians(85.0))
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
    if len(heights) and (height := float(np.ptp(heights))) > _MOST_HEIGHT_M:
        low_m, high_m = float(heights.min()), float(heights.max())
        found.append(f"its height varies by {height:.3g} m ({low_m:.3g} to {high_m:.3g} m)")
    if len(tilts) and float(tilts.max()) > _MOST_TILT_RAD:
        ends = (f"{math.degrees(end):.3g}" for end in (tilts.min(), tilts.max()))
        tilt = f"{' to '.join(dict.fromkeys(ends))} deg"
        if not found and float(np.ptp(tilts)) <= _MOST_TILT_RAD:
            # For example a frame whose z axis points down, or that of a camera.
            return f"the robot or its frame is tilted by {tilt} throughout; {_SEEN}"
        found.append(f"it tilts by {tilt}")
    if not found:
        return None
    return f"the robot leaves the plane: {' and '.join(found)}; {_SEEN}"


_SEEN: Final = "most metrics are seen from above"


def describe_level(z_m: Values | None) -> str | None:
    """Return a sentence on the height of a robot that stays in a plane; None if it is about 0."""
    heights = _keep_finite(z_m)
    if not len(heights) or abs(level_m := float(np.median(heights))) <= _MOST_HEIGHT_M:
        return None
    return f"the poses are at a height of {level_m:.3g} m, which is left out"


def lift_poses(z_m: Values | None, tilt_rad: Values | None) -> dict[str, Values]:
    """Return the heights and tilts of a robot that leaves the plane, by column name."""
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

    The result is NaN if the axis points up or down (`_LEAST_LEVEL`). The quaternions may have any
    length except 0, each part has the shape (n,).
    """
    with np.errstate(over="ignore", invalid="ignore"):  # lengths beyond 1e154 overflow
        left, ahead = 2.0 * (w * z + x * y), w**2 + x**2 - y**2 - z**2
        level = np.hypot(left, ahead) >= _LEAST_LEVEL * (w**2 + x**2 + y**2 + z**2)
        return np.where(level, np.arctan2(left, ahead), np.nan)


def compute_tilt(x: Values, y: Values, z: Values, w: Values) -> Values:
    """Return the angle between the vertical axes before and after a rotation [rad], in [0, pi].

    The quaternions are as in `compute_heading`.
    """
    return 2.0 * np.arctan2(np.hypot(x, y), np.hypot(w, z))


def _keep_finite(values: Values | None) -> Values:
    return np.zeros(0) if values is None else values[np.isfinite(values)]


def compose(
    place_m: Values, turn: Values, next_m: Values, next_turn: Values
) -> tuple[Values, Values]:
    """Return a transform followed by another. Positions have shape (n, 3), rotations (n, 4)."""
    return place_m + rotate(turn, next_m), multiply(_normalise(turn), _normalise(next_turn))


def place_points(place_m: Values, turn: Values, points_m: Values) -> Values:
    """Return points of a frame, given the place and rotation of the frame, shape (n, 3)."""
    return np.asarray(place_m + rotate(np.tile(turn, (len(points_m), 1)), points_m))


def rotate(turn: Values, vector: Values) -> Values:
    """Return vectors rotated by quaternions of any length except 0."""
    axis, w = np.split(_normalise(turn), [3], axis=1)
    across = 2.0 * np.cross(axis, vector)
    return np.asarray(vector + w * across + np.cross(axis, across))


def invert(place_m: Values, turn: Values) -> tuple[Values, Values]:
    """Return the inverse transform."""
    back = turn * np.array([-1.0, -1.0, -1.0, 1.0])
    return -rotate(back, place_m), back


def multiply(left: Values, right: Values) -> Values:
    """Return the rotation `right` followed by `left`, shape (n, 4)."""
    (a, v), (b, w) = (np.split(turn, [3], axis=1) for turn in (left, right))
    vector = v * b + w * a + np.cross(a, b)
    return np.hstack([vector, v * w - (a * b).sum(axis=1, keepdims=True)])


def _normalise(turn: Values) -> Values:
    """Return quaternions of length 1, shape (n, 4)."""
    length = np.linalg.norm(turn, axis=1, keepdims=True)
    # Quaternions that were never set stay 0; the computation of headings reports them.
    return np.asarray(turn / np.where(length == 0.0, 1.0, length))


def turn_between(first: Values, last: Values, share: float) -> Values:
    """Return a rotation on the shortest arc between two quaternions."""
    first, last = _normalise(np.stack([first, last]))
    cosine = float(first @ last)
    last, cosine = (-last, -cosine) if cosine < 0.0 else (last, cosine)
    angle = float(np.arccos(min(cosine, 1.0)))
    if angle < _SMALL_RAD:
        return np.asarray((1.0 - share) * first + share * last)
    weights = np.sin([(1.0 - share) * angle, share * angle]) / np.sin(angle)
    return np.asarray(weights[0] * first + weights[1] * last)


_SMALL_RAD: Final = 1e-6
"""Angle below which an arc equals a line to the last bit [rad]."""
