"""Coordinates far from 0, such as maps have: metres from the start, and the offset named once."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from turtlelog.run import Run

_FAR_M: Final = 10_000.0
"""From here on a tick has five digits before the point, and those of neighbours touch."""

LEAST_SHOWN_M: Final = 0.5
"""Side of a plane at least: of less, the noise of poses would look like a way."""

_STILL_M: Final = 1e-3
"""A robot that stays within this has not moved; poses have their resolution and noise."""

_STILL_RAD: Final = 1e-3


def find_origin(runs: Sequence[Run]) -> tuple[float, float]:
    """Return from where x and y are counted [m]: the first start in whole metres, or 0 where near.

    Each coordinate has its own offset. A path that a scenario holds is near by nature.
    """
    if not runs or any(run.path is not None for run in runs):
        return (0.0, 0.0)
    x_m, y_m = (float(value) for value in runs[0].poses.xy_m[0])
    return _round_far(x_m), _round_far(y_m)


def move_near(runs: Sequence[Run]) -> tuple[list[Run], str]:
    """Return runs with coordinates counted from `find_origin`, and that offset in words.

    Pictures in 32 bits resolve half a metre at coordinates of five million.

    Returns:
        The runs, and `x from 448,262 m, y from 5,411,933 m`; empty where nothing is far.
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
    """Return that runs did not leave their start, empty where all did."""
    still = [run for run in runs if np.ptp(run.poses.xy_m, axis=0).max() < _STILL_M]
    if not still:
        return ""
    if len(runs) > 1:
        return f"{len(still)} of {len(runs)} runs stayed at their start"
    has_turned = np.ptp(np.unwrap(runs[0].poses.heading_rad)) > _STILL_RAD
    return "turned on the spot" if has_turned else "did not move"


def _move(run: Run, origin_m: tuple[float, float]) -> Run:
    """Return a run whose places are counted from an origin [m]."""
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
