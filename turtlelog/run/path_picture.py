"""The path of a run as a small picture for notebooks."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import CURVE_COLOUR

_SIDE: Final = 220.0
_ROOM: Final = 12.0
"""Size of the picture, and margin around the path [pixels]."""

_MOST_POINTS: Final = 400
"""Largest number of points; with more, points would be less than a pixel apart."""

_LEAST_M: Final = 0.5
"""Smallest side of the shown area [m]; in a smaller area, the noise of poses would look like
motion."""

_MARK: Final = 8.0
"""Width of the marks [pixels]; a path that the marks cover is not visible."""


def format_path_svg(xy_m: NDArray[np.float64], goal_xy_m: tuple[float, float] | None) -> str:
    """Return the path as SVG: a square at the start, a dot at the end, a cross at the goal.

    The text is empty if there is nothing to draw: no motion and no distance to the goal.
    """
    rows = np.unique(np.linspace(0, len(xy_m) - 1, _MOST_POINTS).round().astype(int))
    shown = xy_m if goal_xy_m is None else np.vstack([xy_m, goal_xy_m])
    extent_m = float(np.ptp(shown, axis=0).max())
    middle = (shown.min(axis=0) + shown.max(axis=0)) / 2.0
    scale = (_SIDE - 2.0 * _ROOM) / max(extent_m, _LEAST_M)
    if not extent_m * scale >= _MARK:
        return ""

    def place(points_m: NDArray[np.float64]) -> list[tuple[float, float]]:
        # The y of a picture points downward.
        pixels = (points_m - middle) * [scale, -scale] + _SIDE / 2.0
        return [(x, y) for x, y in pixels.round(1).tolist()]

    way = place(xy_m[rows])
    (left, top), (right, bottom) = way[0], way[-1]
    square = f'width="{_MARK:g}" height="{_MARK:g}" fill="currentColor"'
    marks = f'<rect x="{left - _MARK / 2}" y="{top - _MARK / 2}" {square}/>'
    marks += f'<circle cx="{right}" cy="{bottom}" r="4" fill="{CURVE_COLOUR}"/>'
    if goal_xy_m is not None:
        ((x, y),) = place(np.array([goal_xy_m]))
        cross = f"M{x - 5},{y - 5}L{x + 5},{y + 5}M{x - 5},{y + 5}L{x + 5},{y - 5}"
        marks += f'<path d="{cross}" stroke="currentColor" stroke-width="2"/>'
    points = " ".join(f"{x},{y}" for x, y in way)
    line = f'<polyline points="{points}" fill="none" stroke="{CURVE_COLOUR}" stroke-width="1.5"/>'
    side = f'width="{_SIDE:g}" height="{_SIDE:g}"'
    label = 'role="img" aria-label="path from the start (square) to the end (dot)"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {side} {label}>{line}{marks}</svg>'
