"""Noise of the poses of any robot, and what is left of a path and of its turns without it.

A robot on wheels does not step sideways and back between two poses. The second differences of its
steps across its heading therefore show the noise of the positions: of white noise they have six
times its variance. In the quietest part of a run a robot drives evenly or rests.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.measure.breaks import measure_steps
from turtlelog.measure.rates import find_changing_rows, space_poses
from turtlelog.measure.reductions import compute_median
from turtlelog.measure.references import recall
from turtlelog.run import PoseColumns, Run, take_rows

Values = NDArray[np.float64]

_BLOCK: Final = 20
"""Number of second differences that give one estimate of the noise; its error is a fifth."""

_QUIET: Final = 0.25
"""Share of a run's estimates that are below its noise: a robot that turns to and fro, or whose
wheels slip, shows more elsewhere."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WhiteNoise:
    """Standard deviations of the noise of poses.

    Attributes:
        position_m: Of x and of y [m]; 0 without noise, or for few poses.
        heading_rad: Of the heading [rad], likewise.
    """

    position_m: float
    heading_rad: float


def measure_noise(poses: PoseColumns) -> WhiteNoise:
    """Return the noise of poses, none of which repeats the one before."""
    if len(poses) < _BLOCK + 2:
        return WhiteNoise(position_m=0.0, heading_rad=0.0)
    _, aside_m, turned_rad = measure_steps(poses)
    return WhiteNoise(position_m=_estimate(aside_m), heading_rad=_estimate(turned_rad))


def find_noise(run: Run, rows: NDArray[np.int64]) -> WhiteNoise:
    """Return the noise of some rows of the poses.

    The noise of headings counts only if turns to and fro are noise: slow poses do not tell noise
    from a robot that turns round.
    """
    noise = measure_noise(take_rows(run.poses, rows))
    if noise.heading_rad and find_scatter(run).turning_rad is None:
        return replace(noise, heading_rad=0.0)
    return noise


def measure_speed_noise(run: Run) -> float:
    """Return the noise of speeds that are differences of poses [m/s]."""
    if len(run.poses) < 2:
        return 0.0
    spaced = space_poses(run)
    noise = measure_noise(take_rows(run.poses, spaced.rows))
    return math.sqrt(2.0) * noise.position_m / compute_median(np.diff(spaced.time_s))


def _estimate(steps: Values) -> float:
    """Return the standard deviation of white noise whose differences are steps."""
    bends = np.diff(steps)
    whole = bends[: len(bends) // _BLOCK * _BLOCK].reshape(-1, _BLOCK)
    return float(np.quantile(np.sqrt((whole**2).mean(axis=1) / 6.0), _QUIET))


_BACK: Final = 0.1
"""Share of a path in steps that lead back from which scatter is told. The white noise of a robot
at rest has four fifths."""

_MOST_TURNS_HZ: Final = 4.0
"""How often a robot may turn round itself. Such steps lead back at slow poses without any noise."""

_EXPLAINED: Final = 0.5
"""Share of what a path loses through medians from which noise of its positions is the cause. Noise
that lengthens a path explains all of it; a robot that drives to and fro has none."""

_SHORTER: Final = 0.93
"""Largest length through medians, as a share of the path, that is told. A curve of 1 rad/s loses a
twentieth between the medians of each second."""

_MEDIAN_NS: Final = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Scatter:
    """What is left of a path and of its turns through the median pose of each second.

    Attributes:
        path_m: Length of the path from the first pose through these medians to the last [m]; None
            if the path hardly scatters.
        turning_rad: Sum of the magnitudes of all turns, likewise [rad].
    """

    path_m: float | None
    turning_rad: float | None


def find_scatter(run: Run) -> Scatter:
    """Return what scatter of the poses, as of noise, leaves of a path and of its turns."""
    return recall(run, "scatter", lambda: _find_scatter(run.poses))


def _find_scatter(poses: PoseColumns) -> Scatter:
    rows = find_changing_rows(poses)
    heading_rad = np.unwrap(poses.heading_rad[rows])[:, None]
    poses = take_rows(poses, rows) if len(rows) < len(poses) else poses
    # The length of a step of white noise in the plane is sqrt(pi) times its standard deviation.
    noise_m = np.sqrt(np.pi) * measure_noise(poses).position_m
    path_m = _measure_through_medians(poses.time_ns, poses.xy_m, noise_m=noise_m)
    return Scatter(
        path_m=path_m,
        turning_rad=_measure_through_medians(
            poses.time_ns, heading_rad, is_noisy=path_m is not None
        ),
    )


def _measure_through_medians(
    time_ns: NDArray[np.int64], values: Values, *, noise_m: float = 0.0, is_noisy: bool = False
) -> float | None:
    """Return the length through medians of each second; None if the steps hardly lead back.

    `noise_m` is the mean length of a step that noise makes. Whether poses are noisy, because their
    positions are, decides whether slow steps back may be those of a robot that turns round.
    """
    steps = np.diff(values, axis=0)
    ways = np.linalg.norm(steps, axis=1)
    whole = float(ways.sum())
    if not whole:
        return None
    seconds = (time_ns - time_ns[0]) // _MEDIAN_NS
    starts = np.flatnonzero(np.diff(seconds, prepend=-1))
    middles = (starts + np.append(starts[1:], len(seconds)) - 1) // 2
    medians = [axis[np.lexsort((axis, seconds))][middles] for axis in values.T]
    corners = np.column_stack(medians)
    left = np.diff(corners, axis=0, prepend=values[:1], append=values[-1:])
    length = float(np.linalg.norm(left, axis=1).sum())
    if length > _SHORTER * whole:
        return None
    is_back = (steps[1:] * steps[:-1]).sum(axis=1) < 0.0
    own_s = 0.0 if is_noisy else compute_median(np.diff(time_ns)) / 1e9
    is_scatter = float(ways[1:][is_back].sum()) >= max(_BACK, _MOST_TURNS_HZ * own_s) * whole
    is_scatter |= noise_m * len(ways) >= _EXPLAINED * (whole - length)
    return length if is_scatter else None
