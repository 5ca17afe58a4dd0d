"""Corrections of a pose: single steps that neither the motion around them nor noise explains.

A localisation that corrects itself moves all later poses. The size of a step is the mean of the
poses after it minus the mean of the poses before it, minus the motion in between. The rate of this
motion comes from poses further away. A step is a correction under four conditions:

- The step is beyond the rates on both sides, so that speeding up or braking does not explain it.
- Its size is many times the noise of this estimate. The noise has two parts, which the variances
  over one step and over two steps separate: noise of each pose (a filter), and noise of each step
  (a wheel).
- It is larger than the motion of a robot that speeds up and brakes between these poses.
- It is in one step alone, and the poses on either side agree. A stray pose, in contrast, returns.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from turtlelog.measure.reductions import compute_median
from turtlelog.run import PoseColumns
from turtlelog.run.angles import subtract_headings

Values = NDArray[np.float64]

ACCELERATION: Final = (2.0, 10.0)
"""Largest acceleration of a robot from rest [m/s2, rad/s2]."""

_AVERAGED: Final = (2, 4)
"""Number of poses that are averaged on either side: two, or four of a fast sensor."""

_LONGEST_S: Final = 0.1
"""Longest time of more than two averaged poses on one side [s]. In a longer time, the robot may
speed up by as much as a correction adds."""

_NOISES: Final = 6.0
"""Size of a correction in standard deviations. Of normal values in the plane one in 65 million is
as large; of runs with 3,000 poses, one in 20,000 at 5 standard deviations."""

_ASIDE: Final = 0.25
"""Sideways acceleration of a robot as a share of its acceleration, because wheels do not slip
far."""

_SHARP: Final = 0.4
"""Largest excess of the two neighbouring steps as a share of the correction: a peak of the speed
takes several steps."""

_OWN: Final = 0.7
"""Smallest share of the correction in the step alone."""

_AGREED: Final = 0.4
"""Smallest distance between each of two poses after the step and each of two before it, as a share
of the correction."""

_TIMER_S: Final = 0.002
"""Resolution of time [s]: timers run in whole milliseconds, and two stamps may both be off by
one."""

_OFF: Final = 2.5
"""Deviation of a mean rate from the median, in standard deviations, at which the mean contains
another correction."""

LATE: Final = 1.5
"""Duration of a step, in usual steps, from which poses were lost: the robot may have stopped in
it."""

_AROUND: Final = 5
_BLOCK: Final = 12
"""Number of steps on either side whose median is the motion without noise. The same number is the
size of a block of noise, which with its neighbouring blocks is a second at 36 Hz."""

_ROUNDING: Final = 1e-9
"""Size below which a step is 64-bit rounding [m, rad]."""


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
        way: Sums of the steps, shape (n + 1, axes).
        usual_s: Usual time between two poses [s].
        pose_variance: Variance of each pose, shape (n,).
        step_variance: Variance of each step in addition to that of its poses, shape (n,).
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
    return np.asarray(found & (np.diff(time_s) <= LATE * usual_s))


def _measure_noise(steps: Values, step_s: Values) -> tuple[Values, Values]:
    """Return the variance of the poses, and the additional variance of the steps, at each step.

    If the steps vary, two steps together have twice the variance of one step. If the poses vary,
    both variances are equal. The larger of two values is used: the variance around each step, and
    the variance of all steps.
    """
    rates = np.pad(steps / step_s[:, np.newaxis], ((_AROUND, _AROUND), (0, 0)), mode="edge")
    near = np.median(sliding_window_view(rates, 2 * _AROUND + 1, axis=0), axis=2)
    off = steps - near * step_s[:, np.newaxis]
    two = off + np.vstack([off[1:], off[-1:]])
    one_variance, two_variance = (_measure_spread(values) ** 2 for values in (off, two))
    step_variance = np.clip(two_variance - one_variance, 0.0, one_variance)
    return 0.5 * (one_variance - step_variance), step_variance


_MEDIANS: Final = (0.6745, 1.1774)
"""Ratio of median magnitude to standard deviation of normal values, on a line and in the plane."""


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
    """Return the standard deviation of a correction's size at each step, per axis."""
    weights = np.zeros(2 * (count + width))
    middle, share = count + width, 0.5 * count / width
    weights[middle : middle + count], weights[middle - count : middle] = 1.0 / count, -1.0 / count
    # The ends of the steps that tell the rates before and after.
    for place, sign in ((-count, -1), (-count - width, 1), (count - 1 + width, -1), (count - 1, 1)):
        weights[middle + place] += sign * share
    of_poses, of_steps = np.sum(weights**2), np.sum(np.cumsum(weights) ** 2)
    return np.sqrt(of_poses * motion.pose_variance + of_steps * motion.step_variance)


def _measure_rates(motion: _Motion, width: int) -> Values:
    """Return the rate over several steps from each pose on: the mean, or a differing median."""
    took_s = (motion.time_s[width:] - motion.time_s[:-width])[:, np.newaxis]
    mean = (motion.way[width:] - motion.way[:-width]) / took_s
    windows = sliding_window_view(motion.steps / motion.step_s[:, np.newaxis], width, axis=0)
    median = np.median(windows, axis=2)
    variance = 2.0 * motion.pose_variance + motion.step_variance
    deviation = np.sqrt(width * variance[: len(mean)])[:, np.newaxis]
    is_off = np.abs(mean - median) * width * motion.usual_s > _OFF * deviation + _ROUNDING
    return np.where(is_off, median, mean)


def _subtract_means(values: Values, rows: NDArray[np.int64], count: int) -> Values:
    """Return the mean of several poses after each step minus the mean of as many before."""
    sums = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    after = sums[rows + 1 + count] - sums[rows + 1]
    return np.asarray((after - (sums[rows + 1] - sums[rows + 1 - count])) / count)


def _measure_length(values: Values) -> Values:
    """Return the length of each row without overflow: the square of 1e300 is not finite."""
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
    """Return which corrections are in one step alone, by their steps, directions and magnitudes.

    `rates` are the mean of the rates before and after each, and half of their difference.
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
    """Return which corrections separate each of two poses before from each of two poses after."""
    is_kept = np.ones(len(rows), dtype=np.bool_)
    for first in (rows - 1, rows):
        for last in (rows + 1, rows + 2):
            took_s = (motion.time_s[last] - motion.time_s[first])[:, np.newaxis]
            moved = motion.way[last] - motion.way[first] - mean * took_s
            is_kept &= np.sum(moved * unit, axis=1) > _AGREED * size
    return is_kept
