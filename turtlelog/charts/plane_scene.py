"""The plane of several runs: starts, goals, origin, groups of ends, and tracked paths."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.charts.close_up import Label, Lettering, format_length
from turtlelog.charts.curves import Curve, Values, list_loops
from turtlelog.charts.many_runs import group_by_gain
from turtlelog.charts.robot_curves import is_turtlesim
from turtlelog.measure import find_signal
from turtlelog.measure.references import hold_reference, read_reference
from turtlelog.plants import TURTLESIM, find_plant
from turtlelog.plants.turtlesim import WORLD_SIZE_M
from turtlelog.run import Run
from turtlelog.run.paths import Path


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

    Pictures with 32-bit floats resolve half a metre at coordinates of five million. The text, such
    as `x from 448,262 m, y from 5,411,933 m`, is empty if all runs are near.
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
    """Ends of the runs of one gain."""

    gain: float  # gain Kp of the runs
    runs: tuple[int, ...]  # numbers of the runs, rising
    median_xy_m: Values  # median of x and of y [m], shape (2,)
    outline_xy_m: Values  # corners around 90 % of the ends [m], counter-clockwise, shape (n, 2)

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


Point = tuple[float, float]

_POINTS_PER_TURN: Final = 1440
"""Points of a drawn circle. The drawn circle differs from the exact one by 2.4e-6 of the radius,
about the rounding of poses."""

ON_PATH_M: Final = 1e-3
"""Largest deviation from a path that is not shown [m]. Corners of a path are drawn sharp, and in
print a millimetre of a path of metres is thinner than the path's line."""

_SHARE: Final = 0.1
"""Share of the largest deviation from which poses around it are in view: the whole excursion."""

_ROOM: Final = 1.15
"""Half-width of the view, as a multiple of half of the excursion's size."""

_MOST_HALVES: Final = 10.0
"""Largest half-width of the view, as a multiple of the largest deviation, which must stay visible
next to a long segment."""

_LEAST_HALVES: Final = 1.5
"""Smallest half-width of the view, as such a multiple, so that both robot and path are in view."""


def list_paths(runs: Sequence[Run]) -> tuple[Path, ...]:
    """Return the paths that the laws of runs track, at any speed, without duplicates."""
    paths = [run.path for run in runs]
    return tuple(dict.fromkeys(replace(path, speed_m_s=None) for path in paths if path is not None))


def outline_path(path: Path) -> Values:
    """Return the points for drawing a path [m], shape (n, 2); a closed path is closed."""
    if path.points is not None:
        points = [*path.points, *path.points[:1]] if path.is_closed else path.points
        return np.array(points, dtype=np.float64)
    turns = 1 if path.kind == "circle" else 2
    arcs_m = np.linspace(0.0, path.length_m, turns * _POINTS_PER_TURN + 1).tolist()
    return np.array([path.locate(arc_m)[:2] for arc_m in arcs_m])


def has_own_way(run: Run) -> bool:
    """Return whether the run's reference moves on its own trajectory, not on the tracked path."""
    return run.path is None or any(loop.reference == "recorded" for loop in run.declaration.loops)


def read_along_error(run: Run) -> Curve | None:
    """Return the robot's distance behind its moving reference along the track, at every pose [m].

    The result is None if no loop follows a reference along the track, or the path has no speed.
    """
    loops = [loop for loop in list_loops(run, "along_track") if loop.moves]
    along, reference = (
        find_signal(run, "along_track"),
        read_reference(run, loops[0]) if loops else None,
    )
    if along is None or not isinstance(reference, np.ndarray):
        return None
    values = reference - along.values
    return Curve(start_ns=run.start_ns, time_ns=along.time_ns, values=values)


def read_way_to_reference(run: Run) -> Values | None:
    """Return the vector from every pose to the reference held at that time [m], shape (n, 2)."""
    held_xy_m = hold_reference(run, run.samples.reference_xy_m)
    return None if held_xy_m is None else held_xy_m - run.poses.xy_m


@dataclass(frozen=True, slots=True, kw_only=True)
class WorstPlace:
    """Position of the largest deviation from the tracked path, and the region to show."""

    run: int  # number of the run with the largest deviation
    xy_m: Point  # position of the robot's pose [m]
    path_xy_m: Point  # nearest point of the path [m]
    offset_m: float  # distance between the pose and this point [m]
    center_xy_m: Point  # centre of the region: the whole excursion, or its worst part [m]
    half_m: float  # half of the region's width and height [m]


def find_worst_place(runs: Sequence[Run]) -> WorstPlace | None:
    """Return the position of the runs' largest deviation from their common path.

    The result is None if the runs track no path or several paths, or if no deviation exceeds
    `ON_PATH_M`.
    """
    paths = list_paths(runs)
    if len(paths) != 1:
        return None
    found = [(number, _read_offsets(run)) for number, run in enumerate(runs) if run.path]
    number, offsets_m = max(found, key=lambda pair: float(pair[1].max(initial=0.0)))
    if not len(offsets_m) or not offsets_m.max() > ON_PATH_M:
        return None
    row, run = int(offsets_m.argmax()), runs[number]
    along = find_signal(run, "along_track")
    arc_m = 0.0 if along is None else float(along.values[row])
    point = paths[0].locate(arc_m)
    path_xy_m, xy_m = (point.x_m, point.y_m), _to_point(run.poses.xy_m[row])
    offset_m = float(offsets_m[row])
    shown = np.vstack([run.poses.xy_m[_find_stretch(offsets_m, row)], path_xy_m])
    low, high = shown.min(axis=0), shown.max(axis=0)
    center, half_m = (low + high) / 2.0, _ROOM * float((high - low).max()) / 2.0
    if half_m > _MOST_HALVES * offset_m:
        center, half_m = np.add(xy_m, path_xy_m) / 2.0, _MOST_HALVES * offset_m
    return WorstPlace(
        run=number,
        xy_m=xy_m,
        path_xy_m=path_xy_m,
        offset_m=offset_m,
        center_xy_m=_to_point(center),
        half_m=max(half_m, _LEAST_HALVES * offset_m),
    )


def label_worst_place(worst: WorstPlace, lettering: Lettering) -> Label:
    """Return the label of the largest deviation, beyond the robot as seen from the path."""
    text = format_length(worst.offset_m)
    away = np.subtract(worst.xy_m, worst.path_xy_m) / worst.offset_m
    sides = np.abs(away) * (lettering.letter * len(text) / 2.0, lettering.line / 2.0)
    aside_m = (lettering.gap + float(sides.sum())) * worst.half_m
    return Label(text=text, xy_m=_to_point(worst.xy_m + aside_m * away), runs=(worst.run,))


def _read_offsets(run: Run) -> Values:
    signal = find_signal(run, "cross_track")
    return np.zeros(0) if signal is None else np.abs(signal.values)


def _find_stretch(offsets_m: Values, row: int) -> slice:
    """Return the rows around a row in which the offset exceeds a fraction of its value there."""
    near = np.flatnonzero(offsets_m <= _SHARE * offsets_m[row])
    place = int(np.searchsorted(near, row))
    first = int(near[place - 1]) + 1 if place else 0
    after = int(near[place]) if place < len(near) else len(offsets_m)
    return slice(first, after)


def _to_point(xy_m: Values) -> Point:
    return float(xy_m[0]), float(xy_m[1])
