"""What the runs of a picture share in the plane: the world's border, starts, goals, bounds."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from turtlelog.plants.turtlesim import WORLD_SIZE_M
from turtlelog.run import Run
from turtlelog.show import palette
from turtlelog.show.close_up import find_tolerance
from turtlelog.show.rerun import entities
from turtlelog.show.rerun.entities import join_path
from turtlelog.show.run_colors import Color

_WORLD_MARGIN = 0.03
_MARGIN = 0.12
_GOAL_ASIDE = 0.22
_START_ASIDE = 0.32  # beside the turtle's arrow
_NAME_UP = 0.11  # The viewer writes a name below its point.
_MARKER_RADIUS = 3.5  # [points]

UPWARD: Final = rr.Transform3D(mat3x3=np.diag([1.0, -1.0, 1.0]))
"""Turns y upward for all that lies below: Rerun's 2D views have it downward."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """A square of the plane, y upward [m]."""

    center_xy_m: tuple[float, float]
    half_size_m: float


def is_in_world(runs: Sequence[Run]) -> bool:
    """Whether every pose lies in turtlesim's world; a physical robot's need not."""
    places = [_list_places(run) for run in runs]
    return all(xy_m.min() >= 0.0 and xy_m.max() <= WORLD_SIZE_M for xy_m in places)


def find_plane_bounds(runs: Sequence[Run]) -> Bounds:
    """Return the world's bounds, or those of paths and goals where they leave it."""
    if is_in_world(runs):
        return _square(np.zeros(2), np.full(2, WORLD_SIZE_M), _WORLD_MARGIN)
    goals = np.array(_find_goals(runs)).reshape(-1, 2)
    points = np.concatenate([*map(_list_places, runs), goals])
    return _square(points.min(axis=0), points.max(axis=0), _MARGIN)


def draw_surroundings(stream: rr.RecordingStream, runs: Sequence[Run]) -> None:
    """Draw the border, and each start and goal once."""
    stream.log(join_path(entities.PLANE), UPWARD, static=True)
    if is_in_world(runs):
        half = WORLD_SIZE_M / 2.0
        border = rr.Boxes2D(
            centers=[(half, half)],
            half_sizes=[(half, half)],
            colors=[palette.REFERENCE],
            radii=rr.Radius.ui_points(0.75),
        )
        stream.log(join_path(entities.BORDER), border, static=True)
    starts, goals = _find_starts(runs), _find_goals(runs)
    _draw_marks(stream, entities.START, starts, palette.START)
    if goals:
        _draw_marks(stream, entities.GOAL, goals, palette.GOAL)
        _draw_tolerances(stream, runs)
    if len(starts) == 1 and len(goals) == 1:
        _draw_names(stream, starts[0], goals[0], find_plane_bounds(runs).half_size_m)


def _draw_marks(
    stream: rr.RecordingStream,
    entity: str,
    points: Sequence[tuple[float, float]],
    color: Color,
) -> None:
    radius = rr.Radius.ui_points(_MARKER_RADIUS)
    stream.log(join_path(entity), rr.Points2D(points, radii=radius, colors=[color]), static=True)


def _draw_names(
    stream: rr.RecordingStream,
    start: tuple[float, float],
    goal: tuple[float, float],
    half_size_m: float,
) -> None:
    """Name start and goal beside them, each on the side where the path is not."""
    (start_x_m, start_y_m), (goal_x_m, goal_y_m) = start, goal
    aside_m = half_size_m if goal_x_m <= start_x_m else -half_size_m
    up_m = _NAME_UP * half_size_m
    names = rr.Points2D(
        [
            (start_x_m + _START_ASIDE * aside_m, start_y_m + up_m),
            (goal_x_m - _GOAL_ASIDE * aside_m, goal_y_m + up_m),
        ],
        radii=rr.Radius.ui_points(0.0),
        colors=[palette.START, palette.GOAL],
        labels=["start", "goal"],
        show_labels=True,
    )
    stream.log(join_path(entities.NAMES), names, static=True)


def _draw_tolerances(stream: rr.RecordingStream, runs: Sequence[Run]) -> None:
    """Draw a square around each goal: the law checks the error's coordinates one by one."""
    squares = sorted(
        {
            (run.goal_xy_m, tolerance_m)
            for run in runs
            if run.goal_xy_m is not None and (tolerance_m := find_tolerance(run)) is not None
        }
    )
    if squares:
        boxes = rr.Boxes2D(
            centers=[goal for goal, _ in squares],
            half_sizes=[(tolerance_m, tolerance_m) for _, tolerance_m in squares],
            colors=[palette.GOAL],
            radii=rr.Radius.ui_points(0.75),
        )
        stream.log(join_path(entities.TOLERANCE), boxes, static=True)


def _list_places(run: Run) -> NDArray[np.float64]:
    """Return where the robot is, and where its law wants it to be."""
    aims = run.samples.reference_xy_m
    if aims is None:
        return run.poses.xy_m
    return np.concatenate([run.poses.xy_m, aims[np.isfinite(aims[:, 0])]])


def _find_starts(runs: Sequence[Run]) -> list[tuple[float, float]]:
    return sorted({(float(x_m), float(y_m)) for run in runs for x_m, y_m in run.poses.xy_m[:1]})


def _find_goals(runs: Sequence[Run]) -> list[tuple[float, float]]:
    return sorted({run.goal_xy_m for run in runs if run.goal_xy_m is not None})


def _square(low: NDArray[np.float64], high: NDArray[np.float64], margin: float) -> Bounds:
    x_m, y_m = (low + high) / 2.0
    size_m = max(float((high - low).max()), 0.1)
    return Bounds(center_xy_m=(float(x_m), float(y_m)), half_size_m=size_m * (0.5 + margin))
