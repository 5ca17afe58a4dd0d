"""Noise, scatter, resolution and outliers of a robot's poses and measured signals.

A robot on wheels does not step sideways and back between two poses. The second differences of its
steps across its heading therefore show the noise of the positions: of white noise they have six
times its variance. In the quietest part of a run a robot drives evenly or rests. A point ahead of
the axle moves sideways as the robot turns; this part of the steps is left out.
"""

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from turtlelog.display import describe_count
from turtlelog.measure.rates import STEADY, find_changing_rows, find_outliers, space_poses
from turtlelog.measure.reductions import Values, compute_median, subtract_neighbours
from turtlelog.measure.references import recall
from turtlelog.measure.signals import find_signal
from turtlelog.run import PoseColumns, Run, take_rows
from turtlelog.run.angles import subtract_headings

FEWEST_DIFFERENT: Final = 10
"""Smallest number of different values with a common step; fewer values may have one by chance."""

OFF_GRID: Final = 0.02
"""Largest distance of a 32-bit float from a multiple of the quantisation step, in steps: 4e-7 m of
1e-4 m, plus a margin."""

_BLOCK: Final = 20
"""Number of second differences that give one estimate of the noise; its error is a fifth."""

_QUIET: Final = 0.25
"""Share of estimates that are below the noise: turns to and fro, or wheels that slip, show more."""


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
    if turning := float(turned_rad @ turned_rad):
        aside_m = aside_m - turned_rad * (float(turned_rad @ aside_m) / turning)
    return WhiteNoise(position_m=_estimate(aside_m), heading_rad=_estimate(turned_rad))


def find_noise(run: Run, rows: NDArray[np.int64]) -> WhiteNoise:
    """Return the noise of some rows of the poses, at least that of their rounding."""
    # Slow poses do not tell noise of the headings from a robot that turns round.
    noise = measure_noise(take_rows(run.poses, rows))
    if noise.heading_rad and find_scatter(run).turning_rad is None:
        noise = replace(noise, heading_rad=0.0)
    position_m, heading_rad = (_PER_STEP * finest for finest in find_pose_resolution(run))
    return WhiteNoise(
        position_m=max(noise.position_m, position_m),
        heading_rad=max(noise.heading_rad, heading_rad),
    )


_PER_STEP: Final = 12**-0.5
"""Standard deviation of rounding, in steps of the resolution."""


def measure_rate_noise(run: Run) -> tuple[float, float]:
    """Return the noise of speeds [m/s] and turn rates [rad/s] that are differences of poses."""
    if len(run.poses) < 2:
        return 0.0, 0.0
    spaced = space_poses(run)
    noise, step_s = find_noise(run, spaced.rows), compute_median(np.diff(spaced.time_s))
    per_size = math.sqrt(2.0) / step_s
    return per_size * noise.position_m, per_size * noise.heading_rad


def _estimate(steps: Values) -> float:
    """Return the standard deviation of white noise whose differences are steps."""
    bends = np.diff(steps)
    whole = bends[: len(bends) // _BLOCK * _BLOCK].reshape(-1, _BLOCK)
    # A jump is in one estimate, and of two estimates the quieter one counts.
    spreads = measure_length(whole) / math.sqrt(6.0 * _BLOCK)
    return float(np.quantile(spreads, _QUIET, method="lower"))


AROUND: Final = 5
_SPREAD_BLOCK: Final = 12
"""Number of steps on either side whose median is the motion without noise. The same number is the
size of a block of noise, which with its neighbouring blocks is a second at 36 Hz."""


def measure_variances(steps: Values, step_s: Values) -> tuple[Values, Values]:
    """Return the variance of the poses, and the additional variance of the steps, at each step.

    If the steps vary, two steps together have twice the variance of one step. If the poses vary,
    both variances are equal. The larger of two values is used: the variance around each step, and
    the variance of all steps.
    """
    rates = np.pad(steps / step_s[:, np.newaxis], ((AROUND, AROUND), (0, 0)), mode="edge")
    near = np.median(sliding_window_view(rates, 2 * AROUND + 1, axis=0), axis=2)
    off = steps - near * step_s[:, np.newaxis]
    two = off + np.vstack([off[1:], off[-1:]])
    one_variance, two_variance = (_measure_spread(values) ** 2 for values in (off, two))
    step_variance = np.clip(two_variance - one_variance, 0.0, one_variance)
    return 0.5 * (one_variance - step_variance), step_variance


_MEDIANS: Final = (0.6745, 1.1774)
"""Ratio of median magnitude to standard deviation of normal values, on a line and in the plane."""


def _measure_spread(values: Values) -> Values:
    """Return the standard deviation per axis around each row, from medians."""
    size = measure_length(values)
    blocks = -(-len(size) // _SPREAD_BLOCK)
    padded = np.pad(size, (_SPREAD_BLOCK, (blocks + 1) * _SPREAD_BLOCK - len(size)), mode="reflect")
    around = sliding_window_view(padded, 3 * _SPREAD_BLOCK)[::_SPREAD_BLOCK][:blocks]
    local = np.repeat(np.median(around, axis=1), _SPREAD_BLOCK)[: len(size)]
    return np.asarray(np.maximum(local, compute_median(size)) / _MEDIANS[values.shape[1] - 1])


_BACK: Final = 0.1
"""Share of a path in steps that lead back from which scatter is told. The white noise of a robot
at rest has four fifths."""

_MOST_TURNS_HZ: Final = 4.0
"""How often a robot may turn round itself. Such steps lead back at slow poses without any noise."""

_BY_NOISE: Final = 0.5
"""Share of what a path loses through medians from which noise of its positions is the cause."""

_NOISY_STEPS: Final = 0.25
"""Share of steps that noise makes from which positions are noisy: it adds 2 % to a path."""

_SHORTER: Final = 0.93
"""Largest length through medians, as a share of the path, that is told. A curve of 1 rad/s loses a
twentieth between the medians of each second."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scatter:
    """What is left of a path and of its turns through the median pose of each second.

    Attributes:
        path_m: Length of the path through these medians [m]; None if the path hardly scatters.
        turning_rad: Sum of the magnitudes of all turns, likewise [rad].
    """

    path_m: float | None
    turning_rad: float | None


def find_scatter(run: Run) -> Scatter:
    """Return what scatter of the poses, as of noise, leaves of a path and of its turns."""
    return recall(run, "scatter", lambda: _find_scatter(run))


def _find_scatter(run: Run) -> Scatter:
    poses, is_course = run.poses, run.origin.has_courses
    rows = find_changing_rows(poses)
    heading_rad = np.unwrap(poses.heading_rad[rows])[:, None]
    poses = take_rows(poses, rows) if len(rows) < len(poses) else poses
    noise = measure_noise(poses).position_m, _PER_STEP * find_pose_resolution(run)[0]
    # A course turns to and fro as its positions scatter, even if their path hardly gets longer.
    path_m = _measure_through_medians(poses.time_ns, poses.xy_m, noise_m=noise)
    whole_m = float(measure_length(np.diff(poses.xy_m, axis=0)).sum())
    is_noisy = math.sqrt(np.pi) * noise[0] * len(poses) > _NOISY_STEPS * whole_m
    is_noisy |= path_m is not None or is_course
    turning_rad = _measure_through_medians(poses.time_ns, heading_rad, is_noisy=is_noisy)
    return Scatter(path_m=path_m, turning_rad=turning_rad)


def _measure_through_medians(
    time_ns: NDArray[np.int64],
    values: Values,
    *,
    noise_m: tuple[float, float] = (0.0, 0.0),
    is_noisy: bool = False,
) -> float | None:
    """Return the length through medians of each second; None if the steps hardly lead back.

    `noise_m` is the white noise of values, and that of their rounding. If poses are not noisy, slow
    steps back may be those of a robot that turns round.
    """
    steps = np.diff(values, axis=0)
    ways = measure_length(steps)
    if not (whole := float(ways.sum())):
        return None
    seconds = (time_ns - time_ns[0]) // 1_000_000_000
    starts = np.flatnonzero(np.diff(seconds, prepend=-1))
    middles = (starts + np.append(starts[1:], len(seconds)) - 1) // 2
    corners = np.column_stack([one[np.lexsort((one, seconds))][middles] for one in values.T])
    left = np.diff(corners, axis=0, prepend=values[:1], append=values[-1:])
    length = float(measure_length(left).sum())
    if length > _SHORTER * whole:
        return None
    shares = steps / whole  # whose products are finite
    is_back = (shares[1:] * shares[:-1]).sum(axis=1) < 0.0
    own_s = 0.0 if is_noisy else compute_median(np.diff(time_ns)) / 1e9
    is_scatter = float(ways[1:][is_back].sum()) >= max(_BACK, _MOST_TURNS_HZ * own_s) * whole
    # In each second noise adds 4 times its variance to the mean square of the steps. Rounding adds
    # at most the mean length of white noise.
    begins = starts[starts < len(ways)]
    count = np.diff(np.append(begins, len(ways)))
    squares = np.add.reduceat((ways / whole) ** 2, begins) - count * (2.0 * noise_m[0] / whole) ** 2
    by_noise = 1.0 - float(np.sqrt(count * np.maximum(squares, 0.0)).sum())
    by_noise = max(by_noise, math.sqrt(np.pi) * noise_m[1] * len(ways) / whole)
    is_scatter |= by_noise >= _BY_NOISE * (1.0 - length / whole)
    return length if is_scatter else None


def find_pose_resolution(run: Run) -> tuple[float, float]:
    """Return the resolution of positions [m] and of headings [rad]; 0 if it does not matter."""
    return recall(run, "pose_resolution", lambda: _find_resolution(run.poses))


def _find_resolution(poses: PoseColumns) -> tuple[float, float]:
    if poses.speed_m_s is not None:
        return 0.0, 0.0
    rows = find_changing_rows(poses)
    few, many = np.quantile(np.diff(rows), [0.1, 0.9]) if len(rows) > 1 else (1.0, 1.0)
    if many <= STEADY * few:  # poses are repeated, and not coarse
        poses = take_rows(poses, rows)
    if len(poses) < 3:
        return 0.0, 0.0
    step_ns = np.diff(poses.time_ns)
    poses = take_rows(poses, np.append(True, step_ns >= _CROWDED * compute_median(step_ns)))
    step_ns = np.diff(poses.time_ns)
    ahead_m, _, turned_rad = measure_steps(poses)  # ahead, encoders count ticks
    steps = np.vstack([*np.diff(poses.xy_m, axis=0).T, ahead_m, turned_rad])
    # Steps over lost poses are longer, and are divided. Jitter leaves the others as they are, and
    # repeated poses all: the resolution decides when they change.
    longer = step_ns / compute_median(step_ns)
    steps /= np.where((np.abs(longer - 1.0) > _JITTER) & (few <= 1.0), longer, 1.0)
    *positions_m, turns_rad = map(find_dither_step, steps)
    return max(positions_m), turns_rad


_CROWDED, _JITTER = 0.25, 0.2
"""Share of the usual step below which a pose is left out, and by which times of steps jitter: lost
poses make steps at least half as long again."""


def find_common_step(values: Values) -> float:
    """Return the common step of values, if above the spacing of 32-bit floats; otherwise 0."""
    different = _sort_different(values)
    if len(different) < FEWEST_DIFFERENT:
        return 0.0
    steps = subtract_neighbours(different)
    # First from neighbours, which are few steps apart, then to all: the step becomes more exact.
    multiples = np.cumsum(np.rint(steps / steps.min()))
    step = float((different[1:] - different[0]) @ multiples / (multiples @ multiples))
    left = (different[1:] - different[0]) - step * multiples
    is_common = bool((np.abs(left) < OFF_GRID * step).all())
    return step if is_common and step > find_spacing(values) else 0.0


def find_dither_step(steps: Values) -> float:
    """Return the resolution of a coordinate whose steps from row to row dither; otherwise 0.

    Steps of a rounded coordinate, or of an encoder that counts ticks, change from one multiple of
    the resolution to the next and back at once. Exact steps do not, whatever their values are.
    """
    starts = range(0, len(steps), _RESOLVED_ROWS) if len(steps) > _RESOLVED_ROWS else ()
    parts = [steps, *(steps[first : first + _RESOLVED_ROWS] for first in starts)]
    return max(_find_dither_step(part) for part in parts)


_RESOLVED_ROWS: Final = 250
"""Number of rows whose resolution is found at a time, and the coarsest counts: a number with seven
digits is coarser beyond 1 km."""


def _find_dither_step(steps: Values) -> float:
    steps = np.where(np.abs(steps) > _LEAST_DITHER, steps, 0.0)
    bends = subtract_neighbours(steps)
    bends[np.abs(bends) <= _LEAST_DITHER] = 0.0
    way, bend = np.sign(steps), np.sign(bends)
    is_dither = bend[1:] * bend[:-1] < 0.0
    # A pose that strays returns, too, but then the steps have two signs.
    is_onward = is_dither & (way[1:-1] * way[:-2] >= 0.0) & (way[1:-1] * way[2:] >= 0.0)
    few = np.count_nonzero(is_onward) < FEWEST_DIFFERENT
    if few or np.count_nonzero(is_dither) < _DITHERING * np.count_nonzero(steps):
        return 0.0
    sizes = np.sort(np.abs(bends[bends != 0.0]))
    least = sizes[len(sizes) // _SMALLEST]
    step = compute_median(sizes[np.abs(sizes - least) < _NEAR_MULTIPLE * least])
    is_multiple = np.abs(sizes - step * np.rint(sizes / step)) < _NEAR_MULTIPLE * step
    return step if is_multiple.mean() >= _MULTIPLES else 0.0


_LEAST_DITHER: Final = 1e-5
"""Smallest resolution that matters [m, rad]: 32 bits round two poses as far."""

_DITHERING: Final = 0.05
"""Smallest share of moving steps that dither. Of a rounded coordinate a quarter does, on average
over all rates; of a turn that two wheels count, a tenth."""

_SMALLEST: Final = 20
"""The twentieth part of the changes, from the least, gives the resolution."""

_NEAR_MULTIPLE: Final = 0.1
_MULTIPLES: Final = 0.9
"""Distance from a multiple, in steps, and share of the changes that are as near to one. Of exact
coordinates a fifth is as near."""


def find_spacing(values: Values) -> float:
    """Return the spacing of 32-bit floats at the largest value; 0 if values have more bits."""
    with np.errstate(over="ignore"):
        if (values != values.astype(np.float32)).any():
            return 0.0
    return float(np.spacing(np.float32(np.abs(values).max(initial=0.0))))


def find_coarse_step(values: Values) -> float:
    """Return the common step of values, or the least distance of few values; 0 without a step."""
    different = _sort_different(values)
    if 1 < len(different) < FEWEST_DIFFERENT:
        return float(subtract_neighbours(different).min())
    return find_common_step(values)


def _sort_different(values: Values) -> Values:
    """Sort values without duplicates. np.unique would load numpy.ma, which takes 10 ms."""
    ordered = np.sort(values)
    is_first = np.ones(len(ordered), dtype=np.bool_)
    is_first[1:] = ordered[1:] != ordered[:-1]
    return ordered[is_first]


def measure_steps(poses: PoseColumns) -> tuple[Values, Values, Values]:
    """Return each step along and across the mean heading of its poses [m], and turned [rad]."""
    turned_rad = subtract_headings(poses.heading_rad[1:], poses.heading_rad[:-1])
    mean_rad = poses.heading_rad[:-1] + 0.5 * turned_rad
    x_m, y_m = np.diff(poses.xy_m, axis=0).T
    cos, sin = np.cos(mean_rad), np.sin(mean_rad)
    return x_m * cos + y_m * sin, y_m * cos - x_m * sin, turned_rad


def measure_length(values: Values) -> Values:
    """Return the length of each row without overflow: the square of 1e300 is not finite."""
    return np.asarray(np.abs(np.hypot.reduce(values, axis=1)))


MEASURED: Final = ("measured_speed", "measured_turn_rate")
"""Signals that can have outliers. Published commands cannot."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outlier:
    """A value that its neighbours on both sides contradict.

    Attributes:
        signal: Name of the signal, one of `MEASURED`.
        row: Row of the poses.
        time_ns: Time of the value [ns].
        value: Value in the signal's unit.
        unit: Unit of the signal.
    """

    signal: str
    row: int
    time_ns: int
    value: float
    unit: str


def list_outliers(run: Run) -> tuple[Outlier, ...]:
    """Return the outliers of a run's measured signals, by signal and then by time."""
    found: list[Outlier] = []
    for one in filter(None, (find_signal(run, name) for name in MEASURED)):
        for row in find_outliers(one.time_ns, one.values).tolist():
            at_ns, value = int(one.time_ns[row]), float(one.values[row])
            found += [Outlier(signal=one.name, row=row, time_ns=at_ns, value=value, unit=one.unit)]
    return tuple(found)


def describe_outliers(run: Run) -> dict[str, str]:
    """Return a sentence for each signal with outliers, by name of the signal."""
    found: dict[str, list[Outlier]] = {}
    for outlier in list_outliers(run):
        found.setdefault(outlier.signal, []).append(outlier)
    return {name: _describe(outliers, run.start_ns) for name, outliers in found.items()}


def _describe(outliers: list[Outlier], start_ns: int) -> str:
    """Return the number of outliers and the largest one: `1 outlier, -143.6 rad/s at 31.9 s`."""
    worst = max(outliers, key=lambda outlier: abs(outlier.value))
    count, at_s = describe_count(len(outliers), "outlier"), (worst.time_ns - start_ns) / 1e9
    which = "" if len(outliers) == 1 else "the largest "
    return f"{count}, {which}{worst.value:.1f} {worst.unit} at {at_s:.1f} s"
