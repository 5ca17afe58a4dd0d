"""Pictures of runs whose laws track a path: the path, the error along it, the largest deviation."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.charts.close_up import Label, Lettering, format_length
from turtlelog.charts.curves import Curve, list_loops
from turtlelog.measure import find_signal
from turtlelog.measure.references import hold_reference, read_reference
from turtlelog.run import Run
from turtlelog.run.paths import Path

Values = NDArray[np.float64]
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
    """Position of the largest deviation from the tracked path, and the region to show.

    Attributes:
        run: Number of the run with the largest deviation.
        xy_m: Position of the robot's pose [m].
        path_xy_m: Nearest point of the path [m].
        offset_m: Distance between the pose and this point [m].
        center_xy_m: Centre of the region: the whole excursion, or its worst part [m].
        half_m: Half of the region's width and height [m].
    """

    run: int
    xy_m: Point
    path_xy_m: Point
    offset_m: float
    center_xy_m: Point
    half_m: float


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
