"""Positions and rotations in space: composed, inverted, and between two of them."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]


def compose(
    place_m: Values, turn: Values, next_m: Values, next_turn: Values
) -> tuple[Values, Values]:
    """Return a transform followed by another. Positions have shape (n, 3), rotations (n, 4)."""
    return place_m + rotate(turn, next_m), multiply(normalise(turn), normalise(next_turn))


def rotate(turn: Values, vector: Values) -> Values:
    """Return vectors rotated by quaternions of any length except 0."""
    unit = normalise(turn)
    axis, w = unit[:, :3], unit[:, 3:]
    across = 2.0 * np.cross(axis, vector)
    return np.asarray(vector + w * across + np.cross(axis, across))


def invert(place_m: Values, turn: Values) -> tuple[Values, Values]:
    """Return the inverse transform."""
    back = turn * np.array([-1.0, -1.0, -1.0, 1.0])
    return -rotate(back, place_m), back


def multiply(left: Values, right: Values) -> Values:
    """Return the rotation `right` followed by `left`, shape (n, 4)."""
    a, b = left[:, :3], right[:, :3]
    v, w = left[:, 3:], right[:, 3:]
    vector = v * b + w * a + np.cross(a, b)
    return np.hstack([vector, v * w - (a * b).sum(axis=1, keepdims=True)])


def normalise(turn: Values) -> Values:
    """Return quaternions of length 1, shape (n, 4)."""
    length = np.linalg.norm(turn, axis=1, keepdims=True)
    # Quaternions that were never set stay 0; the computation of headings reports them.
    return np.asarray(turn / np.where(length == 0.0, 1.0, length))


def turn_between(first: Values, last: Values, share: float) -> Values:
    """Return a rotation on the shortest arc between two quaternions."""
    first, last = normalise(np.stack([first, last]))
    cosine = float(first @ last)
    last, cosine = (-last, -cosine) if cosine < 0.0 else (last, cosine)
    angle = float(np.arccos(min(cosine, 1.0)))
    if angle < _SMALL_RAD:
        return np.asarray((1.0 - share) * first + share * last)
    weights = np.sin([(1.0 - share) * angle, share * angle]) / np.sin(angle)
    return np.asarray(weights[0] * first + weights[1] * last)


_SMALL_RAD: Final = 1e-6
"""Angle below which an arc equals a line to the last bit [rad]."""
