"""Corrections of a pose: single steps that neither the motion around them nor noise explains.

A localisation that corrects itself moves all later poses. The size of a correction is the mean of
the poses after a step minus the mean of those before, less the motion in between, whose rate is
that of the poses further out. It is a correction if

- it is beyond both of these rates, so that speeding up or braking does not explain it;
- it is many times the noise of this estimate. The noise has two parts, told apart by its variance
  over one step and over two: noise of each pose (a filter), and noise of each step (a wheel);
- it is more than a robot adds that speeds up and brakes between these poses;
- it is in one step alone, and all poses on either side agree. A pose that strays returns.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from turtlelog.measure.outliers import compute_median
from turtlelog.run import PoseColumns
from turtlelog.run.angles import subtract_headings

Values = NDArray[np.float64]

ACCELERATION: Final = (2.0, 10.0)
"""What a robot reaches from rest [m/s2, rad/s2]."""

_AVERAGED: Final = (2, 4)
"""Poses on either side that are averaged: two, and four of a fast sensor."""

_LONGEST_S: Final = 0.1
"""Time [s] of the poses that are averaged on one side, where these are more than two: in a longer
time the robot speeds up by as much as a correction adds."""

_NOISES: Final = 6.0
"""A correction is this many times its standard deviation. Of normal values in the plane one in 65
million is, of a run with 3,000 poses one in 20,000 at 5 times."""

_ASIDE: Final = 0.25
"""Share of the acceleration that a robot has to its side: wheels do not slip far."""

_SHARP: Final = 0.4
"""Each of the two steps on either side is beyond driving by less than this share of the correction:
a peak of the speed takes several steps."""

_OWN: Final = 0.7
"""And the step alone holds this share of it."""

_AGREED: Final = 0.4
"""Each of two poses after the step is this share of it away from each of two before it."""

_TIMER_S: Final = 0.002
"""Timers run in whole milliseconds, and two stamps may both be off by one [s]."""

_OFF: Final = 2.5
"""A mean rate that differs from the median by this many deviations holds another correction."""

_LATE: Final = 1.5
"""A step that takes this many times the usual time lost poses: the robot may have stopped in it."""

_AROUND: Final = 5
_BLOCK: Final = 12
"""Steps on either side whose median is the motion without noise; and in a block of noise, which
with the blocks beside it is a second at 36 Hz."""

_ROUNDING: Final = 1e-9
"""Below this [m, rad] is rounding of 64 bits."""


def measure_steps(poses: PoseColumns) -> tuple[Values, Values, Values]:
    """Return each step along and across the mean heading of its poses [m], and turned [rad]."""
    turned_rad = subtract_headings(poses.heading_rad[1:], poses.heading_rad[:-1])
    mean_rad = poses.heading_rad[:-1] + 0.5 * turned_rad
    x_m, y_m = np.diff(poses.xy_m, axis=0).T
    cos, sin = np.cos(mean_rad), np.sin(mean_rad)
    return x_m * cos + y_m * sin, y_m * cos - x_m * sin, turned_rad


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Motion:
    """Steps of the position or of the heading.

    Attributes:
        time_s: Time of each pose [s], shape (n + 1,).
        steps: Steps from pose to pose [m or rad], shape (n, axes).
        way: Their sums, shape (n + 1, axes).
        usual_s: Usual time between two poses [s].
        pose_variance: Variance of each pose, shape (n,).
        step_variance: Variance of each step beside that of its poses, shape (n,).
        acceleration: Acceleration from rest, along each axis [m/s2 or rad/s2], shape (axes,).
    """

    time_s: Values
    steps: Values
    way: Values
    usual_s: float
    pose_variance: Values
    step_variance: Values
    acceleration: Values

    @property
    def step_s(self) -> Values:
        """Time of each step [s]."""
        return np.diff(self.time_s)


def find_corrections(poses: PoseColumns) -> NDArray[np.bool_]:
    """Return which steps between poses are corrections of the position or the heading."""
    found = np.zeros(max(len(poses) - 1, 0), dtype=np.bool_)
    if len(found) <= 2 * _AROUND:
        return found
    ahead_m, aside_m, turned_rad = measure_steps(poses)
    time_s = (poses.time_ns - poses.time_ns[0]) / 1e9
    usual_s = compute_median(np.diff(time_s))
    in_plane, turning = ACCELERATION
    for steps, acceleration in (
        (np.column_stack([ahead_m, aside_m]), np.array([in_plane, _ASIDE * in_plane])),
        (turned_rad[:, np.newaxis], np.array([turning])),
    ):
        with np.errstate(over="ignore", invalid="ignore"):  # of noise that no robot has
            pose_variance, step_variance = _measure_noise(steps, np.diff(time_s))
        motion = _Motion(
            time_s=time_s,
            steps=steps,
            way=np.vstack([np.zeros_like(steps[:1]), np.cumsum(steps, axis=0)]),
            usual_s=usual_s,
            pose_variance=pose_variance,
            step_variance=step_variance,
            acceleration=acceleration,
        )
        for count in _AVERAGED:
            if count == _AVERAGED[0] or count * usual_s <= _LONGEST_S:
                found |= _find_by_means(motion, count)
    return np.asarray(found & (np.diff(time_s) <= _LATE * usual_s))


def _measure_noise(steps: Values, step_s: Values) -> tuple[Values, Values]:
    """Return the variance of poses and that of steps beside it, at each step.

    Two steps together have twice the variance of one if it is the steps that vary, and the same if
    it is the poses. The larger one of that around each step and of all steps counts.
    """
    rates = np.pad(steps / step_s[:, np.newaxis], ((_AROUND, _AROUND), (0, 0)), mode="edge")
    near = np.median(sliding_window_view(rates, 2 * _AROUND + 1, axis=0), axis=2)
    off = steps - near * step_s[:, np.newaxis]
    two = off + np.vstack([off[1:], off[-1:]])
    one_variance, two_variance = (_measure_spread(values) ** 2 for values in (off, two))
    step_variance = np.clip(two_variance - one_variance, 0.0, one_variance)
    return 0.5 * (one_variance - step_variance), step_variance


_MEDIANS: Final = (0.6745, 1.1774)
"""Median of the magnitude of normal values on a line and in the plane, per deviation."""


def _measure_spread(values: Values) -> Values:
    """Return the standard deviation per axis around each row, from medians."""
    size = _measure_length(values)
    blocks = -(-len(size) // _BLOCK)
    padded = np.pad(size, (_BLOCK, (blocks + 1) * _BLOCK - len(size)), mode="reflect")
    around = sliding_window_view(padded, 3 * _BLOCK)[::_BLOCK][:blocks]
    local = np.repeat(np.median(around, axis=1), _BLOCK)[: len(size)]
    return np.asarray(np.maximum(local, compute_median(size)) / _MEDIANS[values.shape[1] - 1])


def _find_by_means(motion: _Motion, count: int) -> NDArray[np.bool_]:
    """Return which steps are corrections by the means of some poses on either side."""
    width = 3 * count // 2  # steps that tell a rate: short enough for a correction every second
    outer = count - 1 + width
    found = np.zeros(len(motion.steps), dtype=np.bool_)
    rows = np.arange(max(outer, 2), len(found) - max(outer, 2))
    if not len(rows):
        return found
    noise = _weigh_noise(motion, count, width)[rows]
    before = _measure_rates(motion, width)[rows - outer]
    after = _measure_rates(motion, width)[rows + count]
    mean, spread = 0.5 * (before + after), 0.5 * np.abs(after - before)
    moved, took_s = (_subtract_means(values, rows, count) for values in (motion.way, motion.time_s))
    beyond = _shrink(
        moved - mean * took_s[:, np.newaxis],
        np.maximum(spread * took_s[:, np.newaxis] - noise[:, np.newaxis], 0.0),
    )
    size = _measure_length(beyond)
    rests_s = (count - 0.5) * motion.usual_s  # to speed up as long, and to brake as long
    least = motion.acceleration * rests_s**2 + _TIMER_S * np.abs(mean) + _ROUNDING
    is_large = (size > _NOISES * noise) & (_measure_length(beyond / least) > 1.0)
    rows, unit = rows[is_large], beyond[is_large] / size[is_large, np.newaxis]
    size, mean, spread = size[is_large], mean[is_large], spread[is_large]
    is_sharp = _stand_alone(motion, rows, unit, size, (mean, spread))
    found[rows[is_sharp & _persist(motion, rows, unit, size, mean)]] = True
    return found


def _weigh_noise(motion: _Motion, count: int, width: int) -> Values:
    """Return the standard deviation of the size of a correction at each step, per axis."""
    weights = np.zeros(2 * (count + width))
    middle, share = count + width, 0.5 * count / width
    weights[middle : middle + count], weights[middle - count : middle] = 1.0 / count, -1.0 / count
    # The ends of the steps that tell the rates before and after.
    for place, sign in ((-count, -1), (-count - width, 1), (count - 1 + width, -1), (count - 1, 1)):
        weights[middle + place] += sign * share
    of_poses, of_steps = np.sum(weights**2), np.sum(np.cumsum(weights) ** 2)
    return np.sqrt(of_poses * motion.pose_variance + of_steps * motion.step_variance)


def _measure_rates(motion: _Motion, width: int) -> Values:
    """Return the rate over some steps from each pose on: the mean, or the median if they differ."""
    took_s = (motion.time_s[width:] - motion.time_s[:-width])[:, np.newaxis]
    mean = (motion.way[width:] - motion.way[:-width]) / took_s
    windows = sliding_window_view(motion.steps / motion.step_s[:, np.newaxis], width, axis=0)
    median = np.median(windows, axis=2)
    variance = 2.0 * motion.pose_variance + motion.step_variance
    deviation = np.sqrt(width * variance[: len(mean)])[:, np.newaxis]
    is_off = np.abs(mean - median) * width * motion.usual_s > _OFF * deviation + _ROUNDING
    return np.where(is_off, median, mean)


def _subtract_means(values: Values, rows: NDArray[np.int64], count: int) -> Values:
    """Return the mean of some poses after each step minus that of as many before."""
    sums = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    after = sums[rows + 1 + count] - sums[rows + 1]
    return np.asarray((after - (sums[rows + 1] - sums[rows + 1 - count])) / count)


def _measure_length(values: Values) -> Values:
    """Return the length of each row; a square of 1e300 would be too large for a number."""
    return np.asarray(np.abs(np.hypot.reduce(values, axis=1)))


def _shrink(values: Values, by: Values) -> Values:
    return np.asarray(np.sign(values) * np.maximum(np.abs(values) - by, 0.0))


def _stand_alone(
    motion: _Motion,
    rows: NDArray[np.int64],
    unit: Values,
    size: Values,
    rates: tuple[Values, Values],
) -> NDArray[np.bool_]:
    """Return which corrections are in one step alone.

    Args:
        motion: The motion.
        rows: Steps of the corrections.
        unit: Direction of each.
        size: Magnitude of each.
        rates: Mean of the rates before and after each, and half of their difference.
    """
    mean, spread = rates

    def measure(row: NDArray[np.int64]) -> Values:
        took_s = motion.step_s[row][:, np.newaxis]
        beyond = _shrink(motion.steps[row] - mean * took_s, spread * took_s)
        return np.asarray(np.sum(beyond * unit, axis=1))

    own = measure(rows)
    is_sharp = own > _OWN * size
    for place in (-2, -1, 1, 2):
        is_sharp &= np.abs(measure(rows + place)) < _SHARP * own
    return np.asarray(is_sharp)


def _persist(
    motion: _Motion, rows: NDArray[np.int64], unit: Values, size: Values, mean: Values
) -> NDArray[np.bool_]:
    """Return which corrections lie between each of two poses before and each of two after."""
    is_kept = np.ones(len(rows), dtype=np.bool_)
    for first in (rows - 1, rows):
        for last in (rows + 1, rows + 2):
            took_s = (motion.time_s[last] - motion.time_s[first])[:, np.newaxis]
            moved = motion.way[last] - motion.way[first] - mean * took_s
            is_kept &= np.sum(moved * unit, axis=1) > _AGREED * size
    return is_kept
