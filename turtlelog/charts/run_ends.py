"""Where many runs end: the median end of each gain, and the outline of nine tenths of its ends."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.charts.many_runs import group_by_gain
from turtlelog.run import Run

Values = NDArray[np.float64]

MANY_PATHS: Final = 24
"""Paths that a plane shows in colours: more cover each other, and those drawn last decide."""

OUTLINE_LABEL: Final = "90 % of the ends of a gain"
MEDIAN_LABEL: Final = "median end"

_LEAST_RUNS: Final = 10
"""Ends of a gain that have an outline: of fewer, nine tenths are all."""

_INSIDE: Final = 0.9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GainEnds:
    """Where the runs of one gain end.

    Attributes:
        gain: Kp of these runs.
        runs: Their numbers, rising.
        median_xy_m: Median of x and of y [m], shape (2,).
        outline_xy_m: Corners around the nine tenths of the ends nearest to the median [m], counter-
            clockwise, shape (n, 2).
    """

    gain: float
    runs: tuple[int, ...]
    median_xy_m: Values
    outline_xy_m: Values

    @property
    def middle_run(self) -> int:
        """Number of the run whose colour is that of the gain."""
        return self.runs[len(self.runs) // 2]

    @property
    def around_xy_m(self) -> Values:
        """The outline as a line that ends where it begins [m], shape (n + 1, 2)."""
        return np.append(self.outline_xy_m, self.outline_xy_m[:1], axis=0)


def has_grey_paths(runs: Sequence[Run]) -> bool:
    """Whether a plane shows paths in grey and, in colours, ends with their medians and outlines."""
    return len(runs) > MANY_PATHS


def find_gain_ends(runs: Sequence[Run]) -> list[GainEnds]:
    """Return where the runs of each gain end, of gains that enough runs have; gains rise."""
    found = []
    for gain, numbers in sorted(group_by_gain(runs).items()):
        if len(numbers) < _LEAST_RUNS:
            continue
        ends_m = np.array([runs[number].poses.xy_m[-1] for number in numbers])
        median_m = np.median(ends_m, axis=0)
        inside = _order_by_distance(ends_m, median_m)[: int(np.ceil(_INSIDE * len(numbers)))]
        found.append(
            GainEnds(
                gain=gain,
                runs=tuple(numbers),
                median_xy_m=median_m,
                outline_xy_m=outline_points(ends_m[inside]),
            )
        )
    return found


def outline_points(points: Values) -> Values:
    """Return the corners of the convex hull of points, counter-clockwise, shape (n, 2)."""
    points = np.unique(points, axis=0)
    if len(points) < 3:
        return points
    return np.array([*_walk(points)[:-1], *_walk(points[::-1])[:-1]])


def _walk(points: Values) -> list[Values]:
    """Return the right-hand border of points that are in order (Andrew's monotone chain)."""
    border: list[Values] = []
    for point in points:
        while len(border) > 1 and _turns_right(border[-2], border[-1], point):
            border.pop()
        border.append(point)
    return border


def _turns_right(one: Values, other: Values, last: Values) -> bool:
    (ax, ay), (bx, by) = other - one, last - other
    return bool(ax * by - ay * bx <= 0.0)


def _order_by_distance(points: Values, middle: Values) -> NDArray[np.int64]:
    """Return the numbers of points from the middle outward, in units of their own spread."""
    away = points - middle
    spread = np.linalg.pinv(np.cov(points.T))
    return np.argsort(np.einsum("ni,ij,nj->n", away, spread, away), kind="stable")
