"""By how much each step between two poses exceeds what the robot drove, as its neighbours say.

A robot that drives takes the same way from pose to pose as just before and just after. A correction
of its pose adds a step that neither of them has: that is what exceeds driving, however fast it is.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from turtlelog.measure.outliers import NEIGHBOURS, compute_median
from turtlelog.run import PoseColumns
from turtlelog.run.angles import subtract_headings

Values = NDArray[np.float64]

ACCELERATION: Final = (2.0, 10.0)
"""What a robot reaches from rest [m/s2, rad/s2], where it was never seen to move so fast."""

_BEYOND: Final = 3.0
"""An excess is a jump from this many times what acceleration makes of a step on."""

_ALONE: Final = 3.0
"""And this many times the excess of each neighbour: a pose that came late has one of its own."""

_USUAL: Final = 0.8
_NOISES: Final = 6.0
"""And this many times what 80 % of the excesses are within: noise with normal or Laplace values
reaches that in 1 of 15,000 steps, and seldom beside such neighbours. Of poses at 10 Hz a correction
every second is in 10 % of the steps."""

LATE: Final = 1.5
"""A step that takes this many times the usual time lost poses: the robot may have stopped in it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ExcessSteps:
    """Steps between poses, each with what exceeds driving.

    Attributes:
        ahead_m: Excess along the heading, backward negative [m], shape (n,).
        aside_m: To the left [m], shape (n,).
        turned_rad: Counter-clockwise [rad], shape (n,).
        is_jump: Whether that is a jump, shape (n,).
    """

    ahead_m: Values
    aside_m: Values
    turned_rad: Values
    is_jump: NDArray[np.bool_]


def measure_steps(poses: PoseColumns) -> tuple[Values, Values, Values]:
    """Return each step along and across the mean heading of its poses [m], and turned [rad]."""
    turned_rad = subtract_headings(poses.heading_rad[1:], poses.heading_rad[:-1])
    mean_rad = poses.heading_rad[:-1] + 0.5 * turned_rad
    x_m, y_m = np.diff(poses.xy_m, axis=0).T
    cos, sin = np.cos(mean_rad), np.sin(mean_rad)
    return x_m * cos + y_m * sin, y_m * cos - x_m * sin, turned_rad


def find_excess_steps(poses: PoseColumns) -> ExcessSteps:
    """Return the steps from pose to pose with what exceeds driving."""
    steps = measure_steps(poses)
    step_ns = np.diff(poses.time_ns)
    is_jump = np.zeros(len(step_ns), dtype=bool)
    excess = [np.zeros(len(step_ns)) for _ in steps]
    if len(step_ns) > 2 * NEIGHBOURS:
        usual_ns = compute_median(step_ns)
        is_late = step_ns > LATE * usual_ns
        pairs = [_find_excess(step, step_ns, is_late) for step in steps]
        plain, excess = ([pair[kind] for pair in pairs] for kind in (0, 1))
        for axes, acceleration in zip((slice(0, 2), slice(2, 3)), ACCELERATION, strict=True):
            size, usual = (np.hypot.reduce(found[axes]) for found in (excess, plain))
            least = _BEYOND * acceleration * (step_ns / 1e9) ** 2
            is_jump |= (np.abs(size) > least) & _stands_alone(size, np.abs(usual))
    return ExcessSteps(
        ahead_m=excess[0],
        aside_m=excess[1],
        turned_rad=excess[2],
        is_jump=is_jump,
    )


def find_changing_rows(poses: PoseColumns) -> NDArray[np.int64]:
    """Return the rows of poses that differ from the one before, where most repeat it.

    Some programs publish each pose several times. Of others a pose that repeats is a robot that
    stands, and counts.
    """
    every = np.arange(len(poses))
    moved = (np.diff(poses.xy_m, axis=0) != 0.0).any(axis=1) | (np.diff(poses.heading_rad) != 0.0)
    changing = np.flatnonzero(moved) + 1
    if len(changing) < 2 or compute_median(np.diff(changing)) < 2:
        return every
    return np.concatenate([[0], changing])


def _find_excess(
    step: Values, step_ns: NDArray[np.int64], is_late: NDArray[np.bool_]
) -> tuple[Values, Values]:
    """Return what each step has beyond the median rate of its neighbours; at either end nothing.

    The second value is the same without what another rate explains of steps that lost poses.
    """
    windows = sliding_window_view(step / step_ns, 2 * NEIGHBOURS + 1)
    near = np.delete(windows, NEIGHBOURS, axis=1)
    inside = slice(NEIGHBOURS, -NEIGHBOURS)
    way, took_ns = step[inside], step_ns[inside]
    # Of a step that lost poses, no way that a neighbour's rate or a stop explains is beyond.
    low = np.minimum(near.min(axis=1), 0.0) * took_ns
    high = np.maximum(near.max(axis=1), 0.0) * took_ns
    plain, excess = np.zeros(len(step)), np.zeros(len(step))
    plain[inside] = way - np.median(near, axis=1) * took_ns
    excess[inside] = np.where(is_late[inside], way - np.clip(way, low, high), plain[inside])
    return plain, excess


def _stands_alone(size: Values, plain: Values) -> NDArray[np.bool_]:
    """Return which excesses are far beyond those of their neighbours, and beyond the usual."""
    padded = np.pad(plain, NEIGHBOURS)
    near = np.delete(sliding_window_view(padded, 2 * NEIGHBOURS + 1), NEIGHBOURS, axis=1)
    usual = float(np.quantile(plain, _USUAL))
    return np.asarray((np.abs(size) > _ALONE * near.max(axis=1)) & (np.abs(size) > _NOISES * usual))
