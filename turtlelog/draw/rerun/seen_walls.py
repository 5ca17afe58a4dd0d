"""What a robot saw, below its path: the map, the walls of all scans, and the scan of the moment."""

from typing import Final

import numpy as np
import rerun as rr

from turtlelog.charts import palette
from turtlelog.draw.rerun import entities
from turtlelog.draw.rerun.entities import join_path
from turtlelog.draw.rerun.timelines import Timelines, Values, build_index
from turtlelog.draw.rerun.world import Bounds
from turtlelog.log.ros2.bag_scans import CELL_M, Surroundings

_MAP_ORDER: Final = 5.0  # paths that are tracked have 15, traces 20
_WALL_ORDER: Final = 6.0
_SCAN_ORDER: Final = 16.0
_SCAN_RADIUS: Final = 1.75  # [points]

_WIDEST: Final = 3.0
"""The plane grows at most so many times for what is around the path, which stays readable."""

_SHARE: Final = 0.95
"""Of the walls that the plane shows: rays through a door lead far away."""


def draw_surroundings(
    stream: rr.RecordingStream,
    seen: Surroundings,
    timelines: Timelines,
    shift_m: Values,
) -> None:
    """Draw what is around the robot; `shift_m` is added to all of it, as to the run's poses."""
    for entity, xy_m, size_m, color, order in (
        (entities.MAP, seen.map_xy_m, seen.map_cell_m, palette.TRACKED, _MAP_ORDER),
        (entities.WALLS, seen.walls_xy_m, CELL_M, palette.WALLS, _WALL_ORDER),
    ):
        if len(xy_m):
            cells = rr.Points2D(
                xy_m + shift_m, radii=size_m / 2.0, colors=[color], draw_order=order
            )
            stream.log(join_path(entity), cells, static=True)
    if not len(seen.time_ns):
        return
    look = rr.Points2D.from_fields(
        radii=rr.Radius.ui_points(_SCAN_RADIUS), colors=[palette.SCAN], draw_order=_SCAN_ORDER
    )
    stream.log(join_path(entities.SCAN), look, static=True)
    points = rr.Points2D.columns(positions=np.concatenate(seen.scans_xy_m) + shift_m)
    stream.send_columns(
        join_path(entities.SCAN),
        indexes=build_index(timelines.read(seen.time_ns)),
        columns=points.partition([len(one) for one in seen.scans_xy_m]),
    )


def widen_plane(bounds: Bounds, seen: Surroundings, shift_m: Values) -> Bounds:
    """Return the bounds of the plane with most of the walls within, as far as paths stay large."""
    walls = np.concatenate([seen.walls_xy_m, seen.map_xy_m]) + shift_m
    if not len(walls):
        return bounds
    away = np.abs(walls - np.asarray(bounds.center_xy_m)).max(axis=1)
    wanted_m = float(np.quantile(away, _SHARE)) * 1.05
    half_m = min(max(wanted_m, bounds.half_size_m), _WIDEST * bounds.half_size_m)
    return Bounds(center_xy_m=bounds.center_xy_m, half_size_m=half_m)
