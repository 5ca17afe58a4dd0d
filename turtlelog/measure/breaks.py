"""Breaks in the poses of any robot: segments without poses, and steps that it cannot have made.

For turtlesim, whose poses contain the applied command, `replay/breaks_and_commands.py` finds more.

Between two poses a robot moves about as far as just before and just after. A jump of its pose adds
a step that neither neighbouring step has: the excess. This holds at any speed.

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

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from turtlelog.measure.pose_noise import (
    AROUND,
    find_pose_resolution,
    measure_length,
    measure_steps,
    measure_variances,
)
from turtlelog.measure.rates import (
    GAP_STEPS,
    NEIGHBOURS,
    find_changing_rows,
    find_usual_step,
)
from turtlelog.measure.reductions import Values, compute_median
from turtlelog.measure.references import recall
from turtlelog.run import PoseColumns, Run, take_rows

_Pair = tuple[float, float]

_FAST: Final = 3.0
"""Ratio to the greatest lasting rate from which a step is a jump. A robot near that rate, and a
pose that is late by a whole step, together give a ratio of 2."""

_STRAYS: Final = 0.1
"""Largest share of steps that lead out and back at once and count as stray poses, two each. Noise
and a second program lead out and back all the time."""

_NEIGHBOURHOOD: Final = 7
_STRAYED: Final = 2.0
"""Number of poses whose median three stray poses do not move, and smallest distance from it, in the
upper quartile of second differences: 8 standard deviations of normal noise in the plane."""

_TURNED_RAD: Final = 0.1
"""Turn of a jump from which the displacement is measured along the heading before it, because there
is no mean heading. At this turn, both directions differ by 3 deg, 5 % of the displacement to the
side."""

ROUNDING: Final = 1e-5
"""Largest effect of the 32-bit rounding of two poses on a step [m, rad]."""

ACCELERATION: Final = (2.0, 10.0)
"""Largest acceleration of a robot from rest [m/s2, rad/s2]."""

LATE: Final = 1.5
"""Duration of a step, in usual steps, from which poses were lost: the robot may have stopped in
it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseGap:
    """A segment of time whose poses are missing: after start_ns, before end_ns.

    Attributes:
        row: Row of the first pose after the gap.
        start_ns: Time of the last pose before the gap [ns].
        end_ns: Time of the first pose after the gap [ns].
        usual_ns: Usual time between two poses [ns].
    """

    row: int
    start_ns: int
    end_ns: int
    usual_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseJump:
    """A step between two poses that the robot cannot have driven.

    Attributes:
        row: Row of the first pose after the jump.
        time_ns: Time of the first pose after the jump [ns].
        moved_m: Displacement along the heading, backward negative [m]; to the east if headings are
            courses.
        aside_m: Displacement to the left [m]; to the north if headings are courses.
        turned_rad: Turn, counter-clockwise positive [rad].
        excess_m: Distance beyond that of the neighbouring steps [m].
        excess_rad: Turn beyond that of the neighbouring steps [rad].
    """

    row: int
    time_ns: int
    moved_m: float
    aside_m: float
    turned_rad: float
    excess_m: float
    excess_rad: float


def find_gaps(run: Run) -> tuple[PoseGap, ...]:
    """Return the segments of time without poses, each longer than four usual steps."""
    time_ns = run.poses.time_ns
    rows = find_gap_rows(time_ns)
    if not len(rows):
        return ()
    usual_ns = int(compute_median(np.diff(time_ns)))
    starts_ns, ends_ns = time_ns[rows - 1].tolist(), time_ns[rows].tolist()
    return tuple(
        PoseGap(row=row, start_ns=start_ns, end_ns=end_ns, usual_ns=usual_ns)
        for row, start_ns, end_ns in zip(rows.tolist(), starts_ns, ends_ns, strict=True)
    )


def find_gap_rows(time_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the rows that follow the row before after more than four usual steps."""
    step_ns = np.diff(time_ns)
    if not len(step_ns):
        return np.zeros(0, dtype=np.int64)
    return np.flatnonzero(step_ns > GAP_STEPS * find_usual_step(time_ns)) + 1


def find_jumps(run: Run) -> tuple[PoseJump, ...]:
    """Return the steps that the robot cannot have driven: too fast, or a corrected pose."""
    return recall(run, "jumps", lambda: _find_jumps(run))


def _find_jumps(run: Run) -> tuple[PoseJump, ...]:
    poses, finest = run.poses, find_pose_resolution(run)
    if run.origin.has_courses:  # a course turns with the positions, and is not independent
        poses = replace(poses, heading_rad=np.zeros(len(poses)))
    rows = find_changing_rows(poses)
    if len(rows) < len(poses):
        poses = take_rows(poses, rows)
    if len(poses) < 3:
        return ()
    steps = measure_steps(poses)
    moved, turned = np.hypot(steps[0], steps[1]), np.abs(steps[2])
    is_jump = _find_jump_steps(poses, steps[2], finest)
    if not is_jump.any():
        return ()
    step_ns = np.diff(poses.time_ns)
    is_late = step_ns > LATE * compute_median(step_ns)
    ahead_m, aside_m, turned_rad = (_find_excess(step, step_ns, is_late) for step in steps)
    beyond_m, beyond_rad = np.hypot(ahead_m, aside_m), np.abs(turned_rad)
    for row in np.flatnonzero(is_jump & (beyond_rad > _TURNED_RAD)).tolist():
        # The axes turned with the robot, so only the size of the displacement is compared.
        near = moved[row - NEIGHBOURS : row + NEIGHBOURS + 1]
        beyond_m[row] = abs(moved[row] - np.median(near))
    # A jump that includes a turn is measured along the heading before it.
    off_rad = np.where(beyond_rad > _TURNED_RAD, 0.5 * turned_rad, 0.0)
    cos, sin = np.cos(off_rad), np.sin(off_rad)
    moved_m, moved_aside_m = steps[0] * cos - steps[1] * sin, steps[0] * sin + steps[1] * cos
    # At either end nothing tells what of a step is driving.
    for beyond, whole in ((beyond_m, moved), (beyond_rad, turned)):
        beyond[:NEIGHBOURS], beyond[-NEIGHBOURS:] = whole[:NEIGHBOURS], whole[-NEIGHBOURS:]
    return tuple(
        PoseJump(
            row=int(rows[row + 1]),
            time_ns=int(poses.time_ns[row + 1]),
            moved_m=float(moved_m[row]),
            aside_m=float(moved_aside_m[row]),
            turned_rad=float(steps[2][row]),
            excess_m=float(beyond_m[row]),
            excess_rad=float(beyond_rad[row]),
        )
        for row in np.flatnonzero(is_jump).tolist()
    )


def _find_jump_steps(poses: PoseColumns, turned_rad: Values, finest: _Pair) -> NDArray[np.bool_]:
    step_ns = np.diff(poses.time_ns)
    usual_s = np.maximum(step_ns, compute_median(step_ns)) / 1e9
    places = poses.xy_m, np.append(0.0, np.cumsum(turned_rad))[:, np.newaxis]
    is_jump = np.zeros(len(step_ns), dtype=bool)
    if poses.speed_m_s is None:
        is_jump |= find_corrections(poses, finest)
    for axis, seen in enumerate((poses.speed_m_s, poses.turn_rate_rad_s)):
        limits = ACCELERATION[axis], ROUNDING + math.sqrt(2.0) * finest[axis]  # along two axes
        is_jump |= _find_far_steps(places[axis], usual_s, seen=seen, limits=limits)
    return is_jump


def _find_far_steps(
    values: Values, usual_s: Values, *, seen: Values | None, limits: _Pair
) -> NDArray[np.bool_]:
    """Return which steps are far beyond the greatest rate that lasts for two of them."""
    # `seen` are the rates applied by the plant, `limits` the acceleration and the longest step that
    # rounding makes.
    acceleration, least = limits
    way = measure_length(np.diff(values, axis=0))
    # A pose that strays gives two steps, out and back.
    is_stray = _find_strays(values, acceleration * (0.5 * compute_median(usual_s)) ** 2)
    is_beside = is_stray[1:] | is_stray[:-1]
    for lasting in (np.where(is_beside, 0.0, way), way):
        rate = float((np.minimum(lasting[1:], lasting[:-1]) / usual_s[1:]).max())
        rate = rate if seen is None else max(rate, float(np.abs(seen).max()))
        is_far = np.asarray(
            way > _FAST * np.maximum(rate, acceleration * usual_s) * usual_s + least
        )
        if is_far.mean() <= _STRAYS:
            break
    return is_far


def _find_strays(values: Values, least: float) -> NDArray[np.bool_]:
    """Return which poses are far from the median of those around, as no robot that returns."""
    off = np.zeros(len(values))
    if len(values) <= _NEIGHBOURHOOD:
        return off > 0.0
    around = np.median(sliding_window_view(values, _NEIGHBOURHOOD, axis=0), axis=2)
    side = _NEIGHBOURHOOD // 2
    off[side:-side] = measure_length(values[side:-side] - around)
    bends = measure_length(np.diff(values, n=2, axis=0))
    return np.asarray(off > max(least, _STRAYED * float(np.quantile(bends, 0.75))))


def _find_excess(step: Values, step_ns: NDArray[np.int64], is_late: NDArray[np.bool_]) -> Values:
    """Return by how much each step exceeds the median rate of its neighbours; 0 at both ends."""
    # For steps with lost poses, the excess is the part that neither a rate of the neighbours nor a
    # stop explains.
    excess = np.zeros(len(step))
    if len(step) <= 2 * NEIGHBOURS:
        return excess
    windows = sliding_window_view(step / step_ns, 2 * NEIGHBOURS + 1)
    near = np.delete(windows, NEIGHBOURS, axis=1)
    inside = slice(NEIGHBOURS, -NEIGHBOURS)
    way, took_ns = step[inside], step_ns[inside]
    low = np.minimum(near.min(axis=1), 0.0) * took_ns
    high = np.maximum(near.max(axis=1), 0.0) * took_ns
    plain = way - np.median(near, axis=1) * took_ns
    excess[inside] = np.where(is_late[inside], way - np.clip(way, low, high), plain)
    return excess


_AVERAGED: Final = (2, 4)
"""Number of poses that are averaged on either side: two, or four of a fast sensor."""

_LONGEST_S: Final = 0.1
"""Longest time of more than two averaged poses on one side [s]. In a longer time, the robot may
speed up by as much as a correction adds."""

_NOISES: Final = 6.0
"""Size of a correction in standard deviations. Of normal values in the plane one in 65 million is
as large; of runs with 3,000 poses, one in 20,000 at 5 standard deviations."""

_ROUNDED: Final = 0.4
"""Least noise of a correction's size, in steps of the resolution. The means of rounded poses are
apart by up to 1 step more, and their motion by 2/3 step, in either axis: 6 times 0.4 steps."""

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

_EXACT: Final = 1e-9
"""Size below which a step is 64-bit rounding [m, rad]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Motion:
    """Steps of the position [m] or of the heading [rad] from pose to pose, along each axis."""

    time_s: Values  # of each pose, shape (n + 1,)
    step_s: Values
    steps: Values  # shape (n, axes)
    way: Values  # sums of the steps, shape (n + 1, axes)
    usual_s: float
    pose_variance: Values  # shape (n,)
    step_variance: Values  # in addition to that of its poses, shape (n,)
    resolution: float  # [m or rad]
    acceleration: Values  # from rest [m/s2 or rad/s2], shape (axes,)


def find_corrections(poses: PoseColumns, resolution: _Pair = (0.0, 0.0)) -> NDArray[np.bool_]:
    """Return which steps between poses are corrections of the position or the heading."""
    found = np.zeros(len(poses) - 1, dtype=np.bool_)
    if len(found) <= 2 * AROUND:
        return found
    ahead_m, aside_m, turned_rad = measure_steps(poses)
    time_s = (poses.time_ns - poses.time_ns[0]) / 1e9
    step_s = np.diff(time_s)
    usual_s = compute_median(step_s)
    in_plane, turning = ACCELERATION
    axes_m, acceleration_m = np.column_stack([ahead_m, aside_m]), [in_plane, _ASIDE * in_plane]
    for steps, acceleration, finest in (
        (axes_m, np.array(acceleration_m), resolution[0]),
        (turned_rad[:, np.newaxis], np.array([turning]), resolution[1]),
    ):
        with np.errstate(over="ignore", invalid="ignore"):  # of noise that no robot has
            pose_variance, step_variance = measure_variances(steps, step_s)
        motion = _Motion(
            time_s=time_s,
            step_s=step_s,
            steps=steps,
            way=np.vstack([np.zeros_like(steps[:1]), np.cumsum(steps, axis=0)]),
            usual_s=usual_s,
            pose_variance=np.maximum(pose_variance, finest * finest / 12.0),
            step_variance=step_variance,
            resolution=finest,
            acceleration=acceleration,
        )
        for count in _AVERAGED:
            if count == _AVERAGED[0] or count * usual_s <= _LONGEST_S:
                found |= _find_by_means(motion, count)
    return np.asarray(found & (step_s <= LATE * usual_s))


def _find_by_means(motion: _Motion, count: int) -> NDArray[np.bool_]:
    """Return which steps are corrections by the means of some poses on either side."""
    width = 3 * count // 2  # steps that tell a rate: short enough for a correction every second
    outer = count - 1 + width
    found = np.zeros(len(motion.steps), dtype=np.bool_)
    rows = np.arange(max(outer, 2), len(found) - max(outer, 2))
    if not len(rows):
        return found
    noise = np.maximum(_weigh_noise(motion, count, width)[rows], _ROUNDED * motion.resolution)
    before = _measure_rates(motion, width)[rows - outer]
    after = _measure_rates(motion, width)[rows + count]
    mean, spread = 0.5 * (before + after), 0.5 * np.abs(after - before)
    moved, took_s = (_subtract_means(values, rows, count) for values in (motion.way, motion.time_s))
    beyond = _shrink(
        moved - mean * took_s[:, np.newaxis],
        np.maximum(spread * took_s[:, np.newaxis] - noise[:, np.newaxis], 0.0),
    )
    size = measure_length(beyond)
    rests_s = (count - 0.5) * motion.usual_s  # to speed up as long, and to brake as long
    least = motion.acceleration * rests_s**2 + _TIMER_S * np.abs(mean) + _EXACT
    is_large = (size > _NOISES * noise) & (measure_length(beyond / least) > 1.0)
    rows, unit = rows[is_large], beyond[is_large] / size[is_large, np.newaxis]
    size, mean, spread = size[is_large], mean[is_large], spread[is_large]
    is_kept = _stand_alone(motion, rows, unit, size, (mean, spread))
    # Each of two poses before must be apart from each of two poses after.
    for first in (rows - 1, rows):
        for last in (rows + 1, rows + 2):
            took_s = (motion.time_s[last] - motion.time_s[first])[:, np.newaxis]
            moved = motion.way[last] - motion.way[first] - mean * took_s
            is_kept &= np.sum(moved * unit, axis=1) > _AGREED * size
    found[rows[is_kept]] = True
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
    is_off = np.abs(mean - median) * width * motion.usual_s > _OFF * deviation + _EXACT
    return np.where(is_off, median, mean)


def _subtract_means(values: Values, rows: NDArray[np.int64], count: int) -> Values:
    sums = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    after = sums[rows + 1 + count] - sums[rows + 1]
    return np.asarray((after - (sums[rows + 1] - sums[rows + 1 - count])) / count)


def _shrink(values: Values, by: Values) -> Values:
    return np.asarray(np.sign(values) * np.maximum(np.abs(values) - by, 0.0))


def _stand_alone(
    motion: _Motion,
    rows: NDArray[np.int64],
    unit: Values,
    size: Values,
    rates: tuple[Values, Values],
) -> NDArray[np.bool_]:
    """Return which corrections are in one step alone, by their steps, directions and magnitudes."""
    mean, spread = rates  # of the rates before and after each: their mean, and half the difference

    def measure(row: NDArray[np.int64]) -> Values:
        took_s = motion.step_s[row][:, np.newaxis]
        beyond = _shrink(motion.steps[row] - mean * took_s, spread * took_s)
        return np.asarray(np.sum(beyond * unit, axis=1))

    own = measure(rows)
    beside = np.array([measure(rows + place) for place in (-2, -1, 1, 2)])
    return np.asarray((own > _OWN * size) & (np.abs(beside) < _SHARP * own).all(axis=0))
