"""A fit of another kind, to hold the identification against: of the whole way, not of its steps.

It shares no code with the fit of the package: responses to single steps are added up, and the way
between two jumps is fitted with a free offset, by scipy's `least_squares`.
"""

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from tests.identify.robots import Truth, Values, find_changes, respond
from turtlelog.run import Run

_SUDDEN_RAD = 0.8
"""No robot turns this far from one pose to the next; a heading that is wrong seems to."""

_LOWEST, _HIGHEST = (0.0, 0.0, 1e-4), (3.0, 1.5, 3.0)


def fit_whole_way(run: Run, axis: Literal["speed", "turn_rate"]) -> tuple[Values, Values]:
    """Return gain, dead time, lag and the sum of both, and half of their intervals."""
    time_s, moved = _measure(run, axis)
    commands = run.commands.speed_m_s if axis == "speed" else run.commands.turn_rate_rad_s
    changes = find_changes(run.commands.time_ns / 1e9, commands)

    def miss(parameters: Values) -> Values:
        gain, dead_time_s, lag_s = parameters.tolist()
        truth = Truth(gain=gain, dead_time_s=dead_time_s, lag_s=lag_s)
        steps = np.diff(respond(truth, time_s, changes)[1])
        return np.where(np.isnan(moved), 0.0, moved - steps)

    near = _search(miss, moved, 1.5 * np.abs(commands).max() * np.diff(time_s))
    size = np.abs(miss(near))
    jumps = np.isnan(moved) | (size > 8.0 * 1.4826 * np.median(size))
    stretch = np.cumsum(jumps)
    count = np.maximum(np.bincount(stretch), 1)

    def miss_way(parameters: Values) -> Values:
        off = np.cumsum(np.where(jumps, 0.0, miss(parameters)))
        return np.asarray(off - (np.bincount(stretch, off) / count)[stretch])

    bounds = _LOWEST, _HIGHEST
    found = least_squares(miss_way, near, bounds=bounds, x_scale=(0.1, 0.05, 0.05))
    variance = 2.0 * found.cost / (len(moved) - len(count) - 3) * _count_alike(found.fun)
    covariance = variance * np.linalg.inv(found.jac.T @ found.jac)
    adds = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 1.0]])
    return adds @ found.x, 1.96 * np.sqrt(np.diag(adds @ covariance @ adds.T))


def _count_alike(residual: Values) -> float:
    """Return how many neighbours tell what one does: a way adds up what its direction is off."""
    size = float(residual @ residual)
    shares = [float(residual[lag:] @ residual[:-lag]) / size for lag in range(1, 200)]
    alike = next((row for row, share in enumerate(shares) if share <= 0.0), len(shares))
    return 1.0 + 2.0 * sum(shares[:alike])


def _measure(run: Run, axis: str) -> tuple[Values, Values]:
    """Return times, and how far each step went: NaN where its direction is wrong."""
    turned = np.diff(np.unwrap(run.poses.heading_rad))
    moved = turned
    if axis == "speed":
        along_rad = run.poses.heading_rad[:-1] + 0.5 * turned
        dx_m, dy_m = np.diff(run.poses.xy_m, axis=0).T
        moved = (dx_m * np.cos(along_rad) + dy_m * np.sin(along_rad)) * (1.0 + turned**2 / 24.0)
    return run.poses.time_ns / 1e9, np.where(np.abs(turned) > _SUDDEN_RAD, np.nan, moved)


def _search(miss: Callable[[Values], Values], moved: Values, most: NDArray[np.float64]) -> Values:
    """Return what fits the steps about as well as anything does."""
    seen = np.clip(np.nan_to_num(moved), -most, most)
    tried = []
    for dead_time_s in np.arange(0.05, 0.6, 0.1).tolist():
        for lag_s in (0.1, 0.4, 0.8):
            way = np.nan_to_num(moved) - miss(np.array([1.0, dead_time_s, lag_s]))
            gain = float(way @ seen / (way @ way))
            tried.append((float(np.abs(seen - gain * way).sum()), gain, dead_time_s, lag_s))
    start = np.clip(min(tried)[1:], _LOWEST, _HIGHEST)
    scale = 1.4826 * float(np.median(np.abs(miss(start)))) + 1e-9
    bounds = _LOWEST, _HIGHEST
    return np.asarray(
        least_squares(
            miss, start, bounds=bounds, loss="soft_l1", f_scale=scale, x_scale=(0.1, 0.05, 0.05)
        ).x
    )
