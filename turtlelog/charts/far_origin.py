"""Coordinates far from 0, such as maps have: metres from the start, and the offset named once."""

from collections.abc import Sequence
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

    Each coordinate has its own offset.
    """
    if not runs:
        return (0.0, 0.0)
    x_m, y_m = (float(value) for value in runs[0].poses.xy_m[0])
    return _round_far(x_m), _round_far(y_m)


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


def _round_far(coordinate_m: float) -> float:
    return float(round(coordinate_m)) if abs(coordinate_m) >= _FAR_M else 0.0
