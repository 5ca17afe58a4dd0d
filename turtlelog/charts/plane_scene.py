"""Common parts of a plane with several runs: starts, goals, origin, and groups of ends."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.charts.many_runs import group_by_gain
from turtlelog.charts.robot_curves import is_turtlesim
from turtlelog.charts.tracked_path import list_paths, outline_path
from turtlelog.plants import TURTLESIM, find_plant
from turtlelog.plants.turtlesim import WORLD_SIZE_M
from turtlelog.run import Run

Values = NDArray[np.float64]


def list_starts(runs: Sequence[Run]) -> Values:
    """Return the first pose of each run without duplicates [m], shape (n, 2)."""
    return np.unique([xy_m for run in runs for xy_m in run.poses.xy_m[:1]], axis=0).reshape(-1, 2)


def list_goals(runs: Sequence[Run]) -> Values:
    """Return the goals of the runs without duplicates [m], shape (n, 2)."""
    goals = {run.goal_xy_m for run in runs if run.goal_xy_m is not None}
    return np.array(sorted(goals)).reshape(-1, 2)


def list_places(run: Run) -> Values:
    """Return the positions of the robot, of its reference, and of the path that it tracks [m]."""
    aims, places = run.samples.reference_xy_m, [run.poses.xy_m]
    if aims is not None:
        places.append(aims[np.isfinite(aims[:, 0])])
    return np.concatenate([*places, *map(outline_path, list_paths([run]))])


def is_in_world(runs: Sequence[Run]) -> bool:
    """Return whether every position lies in turtlesim's world.

    The result is False for a robot other than turtlesim, or one known to have no walls.
    """
    if any(find_plant(run) != TURTLESIM or not is_turtlesim(run) for run in runs):
        return False
    places = [list_places(run) for run in runs]
    return all(xy_m.min() >= 0.0 and xy_m.max() <= WORLD_SIZE_M for xy_m in places)


_FAR_M: Final = 10_000.0
"""Distance from the origin beyond which coordinates are shifted [m], because their tick labels
would touch."""

LEAST_SHOWN_M: Final = 0.5
"""Smallest side of a plane [m]; in a smaller plane, noise of poses would look like a path."""

_STILL_M: Final = 1e-3
"""Extent within which a robot counts as not moved [m], because poses have noise and a
resolution."""

_STILL_RAD: Final = 1e-3


def find_origin(runs: Sequence[Run]) -> tuple[float, float]:
    """Return the origin of x and y [m]: the first start in whole metres, or 0 if the start is near.

    Each coordinate has its own offset. A path in a scenario is always near.
    """
    if not runs or any(run.path is not None for run in runs):
        return (0.0, 0.0)
    x_m, y_m = (float(value) for value in runs[0].poses.xy_m[0])
    return _round_far(x_m), _round_far(y_m)


def move_near(runs: Sequence[Run]) -> tuple[list[Run], str]:
    """Return runs with coordinates relative to `find_origin`, and text on this offset.

    Pictures with 32-bit floats resolve half a metre at coordinates of five million.

    Returns:
        The runs, and text such as `x from 448,262 m, y from 5,411,933 m`, which is empty if all
        runs are near.
    """
    origin_m = find_origin(runs)
    if origin_m == (0.0, 0.0):
        return [*runs], ""
    named = zip("xy", origin_m, strict=True)
    words = ", ".join(f"{name} from {offset_m:,.0f} m" for name, offset_m in named if offset_m)
    return [_move(run, origin_m) for run in runs], words


def label_coordinate(name: str, origin_m: float) -> str:
    """Return the name of an axis: `x [m]`, or `x from 448,262 m`."""
    return f"{name} from {origin_m:,.0f} m" if origin_m else f"{name} [m]"


def tell_still(runs: Sequence[Run]) -> str:
    """Return a sentence on runs that did not leave their start; empty if all did."""
    still = [run for run in runs if np.ptp(run.poses.xy_m, axis=0).max() < _STILL_M]
    if not still:
        return ""
    if len(runs) > 1:
        return f"{len(still)} of {len(runs)} runs stayed at their start"
    has_turned = np.ptp(np.unwrap(runs[0].poses.heading_rad)) > _STILL_RAD
    return "turned on the spot" if has_turned else "did not move"


def _move(run: Run, origin_m: tuple[float, float]) -> Run:
    """Return a run with positions relative to an origin [m]."""
    poses, samples, goal_xy_m = run.poses, run.samples, run.goal_xy_m
    sensed, reference = poses.sensed_xy_m, samples.reference_xy_m
    poses = replace(
        poses,
        xy_m=poses.xy_m - origin_m,
        sensed_xy_m=None if sensed is None else sensed - origin_m,
    )
    samples = replace(samples, reference_xy_m=None if reference is None else reference - origin_m)
    if goal_xy_m is not None:
        goal_xy_m = (goal_xy_m[0] - origin_m[0], goal_xy_m[1] - origin_m[1])
    return replace(run, poses=poses, samples=samples, goal_xy_m=goal_xy_m)


def _round_far(coordinate_m: float) -> float:
    return float(round(coordinate_m)) if abs(coordinate_m) >= _FAR_M else 0.0


MANY_PATHS: Final = 24
"""Largest number of coloured paths in a plane. More paths cover each other, and only the last drawn
would be visible."""

OUTLINE_LABEL: Final = "90 % of the ends of a gain"
MEDIAN_LABEL: Final = "median end"

_LEAST_RUNS: Final = 10
"""Smallest number of ends of a gain for an outline; of fewer ends, nine tenths are all."""

_INSIDE: Final = 0.9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GainEnds:
    """Ends of the runs of one gain.

    Attributes:
        gain: Gain Kp of the runs.
        runs: Numbers of the runs, rising.
        median_xy_m: Median of x and of y [m], shape (2,).
        outline_xy_m: Corners around the 90 % of the ends nearest to the median [m],
            counter-clockwise, shape (n, 2).
    """

    gain: float
    runs: tuple[int, ...]
    median_xy_m: Values
    outline_xy_m: Values

    @property
    def middle_run(self) -> int:
        """Number of the run whose colour represents the gain."""
        return self.runs[len(self.runs) // 2]

    @property
    def around_xy_m(self) -> Values:
        """The outline as a closed line [m], shape (n + 1, 2)."""
        return np.append(self.outline_xy_m, self.outline_xy_m[:1], axis=0)


def has_grey_paths(runs: Sequence[Run]) -> bool:
    """Return whether a plane shows grey paths, and coloured ends with medians and outlines."""
    return len(runs) > MANY_PATHS


def find_gain_ends(runs: Sequence[Run]) -> list[GainEnds]:
    """Return the ends of runs for each gain with enough runs, by rising gain."""
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
    """Return the right-hand border of sorted points (Andrew's monotone chain)."""
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
    """Return the numbers of points from the centre outward, relative to the points' spread."""
    away = points - middle
    spread = np.linalg.pinv(np.cov(points.T))
    return np.argsort(np.einsum("ni,ij,nj->n", away, spread, away), kind="stable")
