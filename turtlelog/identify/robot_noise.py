"""The noise of poses, of steps between them, and of rates.

Errors of poses do not grow with time; errors of rates grow. The mean square error of the
displacement in a time t is `still` + noise^2 t. The noise of poses is measured while the robot is
at rest, because in motion errors of time stamps look the same.

An error of a pose makes one step too long and the next too short. Slip, in contrast, remains.
Therefore the variance of a step is `slip` + 2 `sensing`, and the covariance of neighbours is
-`sensing`, times the cosine of the angle between them.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlelog.identify.axis_model import predict_axis
from turtlelog.identify.axis_motion import (
    AXES,
    NAMES,
    RESTED_S,
    Axis,
    get_commands,
    read_axis_motion,
)
from turtlelog.identify.held_response import Values
from turtlelog.identify.robot_model import RobotModel
from turtlelog.run import Run

_SETTLED_S: Final = 0.5
"""Time until a robot is at rest, after dead time and five time constants of the last command
[s]."""

_FADED: Final = 5.0  # time constants after which less than 1 % of a rate is left

_MOST_RATE: Final = 0.05
"""Mean rate above which a robot is not at rest, as a share of the largest command."""

_SHORTEST_S, _LONGEST_S = 0.1, 5.0
"""Range of times over which the model's error is evaluated [s]. Shorter times show the noise of
poses and stamps; longer times occur too rarely in a log."""

_FEWEST_WAYS: Final = 10.0
"""Smallest number of times that a time must fit into a log; the mean square is then accurate to a
half."""

_SURE: Final = 3.0
"""Standard deviations above chance from which noise is reported: in 1 of 700 robots without
noise."""

_MATTERS: Final = 0.3
"""Smallest growth of the error over the longest time, as a share of the constant part. A smaller
growth changes no prediction, and looks like small errors of dead times and time constants."""

_HIDES: Final = 2.0
"""Growth that would have been reported, as a multiple of the reported growth: with few intervals of
the longest time, the growth is accurate to a half."""

_STILL_HIDES: Final = 4.0
"""Square of the poses' noise that would be visible in 39 of 40 robots, as a multiple of chance."""

_LEAST: Final = 1e-6
"""Smallest reported noise [m] or [rad]: a tenth of the step of the finest odometry."""

_FEWEST_HORIZONS: Final = 3
"""Smallest number of times, each twice the previous time; with two times, a curve looks like
growth."""

Stretch = NDArray[np.float64]
"""Times and sums of some quantities from pose to pose, shape (n, 1 + k)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Noise:
    """A measured noise.

    Attributes:
        size: Standard deviation [m or rad], for rates per root of a second; 0: no noise is visible.
        hidden: Upper bound of the noise if no noise is visible.
    """

    size: float
    hidden: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SensingNoise:
    """Noise of a pose.

    Attributes:
        position: Noise of both x and y [m].
        heading: Noise of the heading [rad].
        standing_s: Total time for which the robot is at rest [s].
    """

    position: Noise
    heading: Noise
    standing_s: float


WRITTEN_DIGITS: Final = 6
"""Significant digits of written numbers: a hundredth of the narrowest interval."""


def round_written(value: float) -> float:
    """Return a value with the digits of written numbers."""
    return float(f"{value:.{WRITTEN_DIGITS}g}")


def list_noise(model: RobotModel, runs: Sequence[Run]) -> tuple[dict[str, Any], list[str]]:
    """Return the keys of a scenario for the noise of a robot, and sentences on them."""
    sensing = measure_sensing_noise(model, runs)
    values: dict[str, Any] = {}
    notes = []
    if sensing is None:
        notes.append(
            "The robot never stands for long with commands of 0, so the noise of poses is not"
            " known: it is 0."
        )
    else:
        position_m, heading_rad = (
            round_written(sensing.position.size),
            round_written(sensing.heading.size),
        )
        hidden = [
            f"{1e3 * noise.hidden:.2g} {unit}"
            for noise, unit in ((sensing.position, "mm"), (sensing.heading, "mrad"))
            if not noise.size
        ]
        zero = f" What shows none has 0: up to {' and '.join(hidden)} may hide." if hidden else ""
        values |= {"sensing.noise_position_m": position_m, "sensing.noise_heading_rad": heading_rad}
        notes.append(
            f"The noise of poses is that of {sensing.standing_s:.3g} s in which the robot stands:"
            f" {1e3 * position_m:.3g} mm and {1e3 * heading_rad:.3g} mrad.{zero}"
        )
    for axis, key in zip(AXES, ("noise_speed", "noise_turn_rate"), strict=True):
        noise = measure_disturbance_noise(model, axis, runs)
        values[f"disturbance.{key}"] = round_written(noise.size if noise else 0.0)
        notes += _tell_rate_noise(axis, noise)
    return values, notes


def _tell_rate_noise(axis: Axis, noise: Noise | None) -> Iterator[str]:
    name, unit = NAMES[axis], "mm" if axis == "speed" else "mrad"
    if noise is None:
        yield f"How the noise of the {name} grows is not known: it is 0."
    elif noise.size:
        yield (
            f"The noise of the {name} is how the model's error grows with time:"
            f" {1e3 * noise.size:.3g} {unit} by the root of a second."
        )
    else:
        yield (
            f"The model's error of the {name} does not clearly grow with time: its noise is 0."
            f" Up to {1e3 * noise.hidden:.2g} {unit} by the root of a second may hide."
        )


def measure_sensing_noise(model: RobotModel, runs: Sequence[Run]) -> SensingNoise | None:
    """Return the noise of poses while a robot is at rest; None if the robot is never at rest."""
    places, headings, standing_s = [], [], 0.0
    for run in runs:
        for rows in _list_standing(model, run):
            # The log of a simulated robot also contains true poses; the noise is that of sensed
            # ones.
            sensed = np.flatnonzero(~run.poses.dropped_out[rows]) + rows.start
            time_s = run.poses.time_ns[sensed] / 1e9
            headings_rad = run.poses.read_heading_rad[sensed]
            xy_m, turned = _remove_drift(model, time_s, run.poses.read_xy_m[sensed], headings_rad)
            places.append(np.column_stack([time_s, xy_m]))
            headings.append(np.column_stack([time_s, turned]))
            standing_s += float(time_s[-1] - time_s[0]) if len(time_s) else 0.0
    if not standing_s:
        return None
    return SensingNoise(
        position=_measure_still(places), heading=_measure_still(headings), standing_s=standing_s
    )


def measure_disturbance_noise(model: RobotModel, axis: Axis, runs: Sequence[Run]) -> Noise | None:
    """Return the growth of a model's error [m or rad per root of a second]; None if unknown."""
    if not getattr(model, axis).is_known:
        return None
    stretches = [stretch for run in runs for stretch in _list_errors(model, axis, run)]
    horizons_s, squares, in_line, in_all = _measure_growth(stretches)
    if len(horizons_s) < _FEWEST_HORIZONS:
        return None
    weight = np.sqrt(in_line) / squares
    terms = np.column_stack([horizons_s, np.ones(len(horizons_s))]) * weight[:, None]
    power, still = scipy.optimize.nnls(terms, squares * weight)[0].tolist()
    # With noise of poses alone, all mean squares are equal, apart from chance.
    sure = max(_SURE * float(np.sqrt(2.0 / in_all[-1])), _MATTERS)
    noise = float(np.sqrt(power))
    shows = power * horizons_s[-1] > sure * still and noise > _LEAST
    hidden = float(np.sqrt(_HIDES * sure * still / horizons_s[-1]))
    return Noise(size=noise if shows else 0.0, hidden=max(hidden, _LEAST))


def _list_standing(model: RobotModel, run: Run) -> Iterator[slice]:
    """Yield the rows of poses while the robot is at rest, long enough after commands of 0."""
    if not len(run.commands):
        return
    settle_s = _SETTLED_S + max(
        float(axis.dead_time_s) + _FADED * float(axis.lag_s)
        for axis in model.axes
        if axis.dead_time_s is not None and axis.lag_s is not None
    )
    time_s, command_s = run.poses.time_ns / 1e9, run.commands.time_ns / 1e9
    moves = np.logical_or(*(get_commands(run, axis) != 0.0 for axis in AXES))
    edges = np.flatnonzero(np.diff(moves, prepend=True))
    ends_s = np.append(command_s[edges], np.inf)[1:].tolist()
    stretches = [
        (float(command_s[row]) + settle_s, end_s)
        for row, end_s in zip(edges.tolist(), ends_s, strict=True)
        if not moves[row]
    ]
    # The command before the first one is unknown; the motion shows it.
    second = slice(0, int(np.searchsorted(time_s, time_s[0] + RESTED_S, side="right")))
    if not moves[0] and second.stop > 2 and _stands(model, run, second):
        stretches[0] = (-np.inf, ends_s[0])
    else:
        stretches.insert(0, (-np.inf, float(command_s[0])))
    for begin_s, end_s in stretches:
        first, last = np.searchsorted(time_s, [begin_s, end_s]).tolist()
        rows = slice(first, last)
        is_long = last - first > 2 and time_s[last - 1] - time_s[first] >= RESTED_S
        if is_long and _stands(model, run, rows):
            yield rows


def _remove_drift(
    model: RobotModel, time_s: Values, xy_m: Values, heading_rad: Values
) -> tuple[Values, Values]:
    """Return positions and unwrapped headings while a robot is at rest, without its drift."""
    speed_m_s, turn_rate_rad_s = (
        0.0 if axis.drift is None else axis.drift.value for axis in model.axes
    )
    turned = np.unwrap(heading_rad)
    middle_rad = 0.5 * (turned[1:] + turned[:-1])
    ways = speed_m_s * np.diff(time_s)[:, None]
    steps_m = ways * np.column_stack([np.cos(middle_rad), np.sin(middle_rad)])
    drifted_m = np.concatenate([np.zeros((min(len(time_s), 1), 2)), np.cumsum(steps_m, axis=0)])
    return xy_m - drifted_m, turned - turn_rate_rad_s * time_s


def _stands(model: RobotModel, run: Run, rows: slice) -> bool:
    poses = run.poses
    time_s = poses.time_ns[rows] / 1e9
    xy_m, turned = _remove_drift(model, time_s, poses.xy_m[rows], poses.heading_rad[rows])
    most_m, most_rad = (
        _MOST_RATE * float(np.abs(get_commands(run, axis)).max()) * (time_s[-1] - time_s[0])
        for axis in AXES
    )
    # An axis that is never commanded has no scale of its own.
    still_m = not most_m or float(np.hypot(*(xy_m[-1] - xy_m[0]))) <= most_m
    return still_m and (not most_rad or abs(float(turned[-1] - turned[0])) <= most_rad)


def _measure_still(stretches: Sequence[Stretch]) -> Noise:
    """Return the standard deviation of the constant part; 0 if the part is not significant."""
    # If nothing grows, the changes of neighbours are correlated with -1/2.
    changes = [np.diff(stretch[:, 1:], axis=0) for stretch in stretches]
    size = sum(change.size for change in changes)
    variance = sum(float((change**2).sum()) for change in changes) / size
    beside = -sum(float((change[1:] * change[:-1]).sum()) for change in changes) / size
    sure = max(_SURE * variance / float(np.sqrt(size)), _LEAST**2)
    found = float(np.sqrt(beside)) if beside > sure else 0.0
    return Noise(size=found, hidden=float(np.sqrt(max(beside, 0.0) + _STILL_HIDES * sure)))


def _list_errors(model: RobotModel, axis: Axis, run: Run) -> Iterator[Stretch]:
    """Yield the cumulated error of the model along a run, for each unbroken segment."""
    motion = read_axis_motion(run, axis)
    if not len(motion.moved):
        return
    way, _ = predict_axis(getattr(model, axis), run, motion.time_s)
    first = motion.first
    off = motion.moved - (way[first + 1] - way[first])
    jumps_s = [
        event.time_s for event in model.events if (event.file, event.axis) == (run.name, axis)
    ]
    is_jump = np.isin(motion.time_s[first + 1], jumps_s)
    begins = ~motion.follows | is_jump | np.concatenate([[False], is_jump[:-1]])
    for rows in np.split(np.arange(len(off)), np.flatnonzero(begins)):
        if len(rows) > 1 and not is_jump[rows[0]]:
            time_s = motion.time_s[[first[rows[0]], *(first[rows] + 1)]]
            yield np.column_stack([time_s, np.concatenate([[0.0], np.cumsum(off[rows])])])


def _measure_growth(stretches: Sequence[Stretch]) -> tuple[Values, Values, Values, Values]:
    """Return times, the model's mean square error after each time, and its uncertainty."""
    # The last two values are the numbers of successive intervals and of intervals from any pose.
    total_s = sum(float(stretch[-1, 0] - stretch[0, 0]) for stretch in stretches)
    steps = sum(len(stretch) - 1 for stretch in stretches)
    usual_s = total_s / max(steps, 1)
    found = []
    length = max(round(_SHORTEST_S / usual_s), 1) if total_s else 0
    while total_s and length * usual_s <= min(_LONGEST_S, total_s / _FEWEST_WAYS):
        ways = [stretch[length:] - stretch[:-length] for stretch in stretches]
        if not (count := sum(len(way) for way in ways)):
            break
        horizon_s, square = (
            float((np.concatenate([way[:, column] for way in ways]) ** power).mean())
            for column, power in ((0, 1), (1, 2))
        )
        found.append((horizon_s, square, count / length, count))
        length *= 2
    columns = np.array(found, dtype=float).reshape(-1, 4).T
    return columns[0], np.maximum(columns[1], np.finfo(float).tiny), columns[2], columns[3]


_RATIOS: Final = tuple(range(-5, 5))
"""Powers of ten of the slip in a step by the variance of a pose that are tried: below the least,
steps more than 300 poses apart are compared, and every odometry drifts; above the largest, none of
the noise is that of poses."""

_FINE: Final = 0.05
"""Error of that power of ten: noise that is 12 % off costs less than 1 % of the accuracy."""

LEAST_STEP: Final = 1e-12
"""Smallest deviation of a step [m] or [rad]: the resolution of doubles some kilometres from the
origin. A robot without noise may have a deviation of exactly 0, which has no weight."""

_EXCLUDED: Final = 1e6
"""Factor on the variance of an outlier, large enough that the outlier does not count."""

NORMAL_MAD: Final = 1.4826
"""Standard deviation of normal noise divided by the median of its magnitude."""

_OUTLIER: Final = 8.0
"""Size of an outlier in robust standard deviations; outliers do not count. Normal noise exceeds
this size once in 1e15 steps; stamp jitter at the highest speed has five times the usual
residual."""

_MOST_OUTLIERS: Final = 0.05
"""Largest share of the steps that may be outliers. A simulated robot rests exactly, and all its
moving steps deviate more than its rests: these steps are its motion."""

_LONGEST_JUMP: Final = 5
"""Largest number of steps of a jump: a wrong pose gives two, an odometry filter some more."""


def find_outlying_steps(residual: Values, rounding: float = 0.0) -> NDArray[np.bool_]:
    """Return which residuals are outliers, of poses with a standard deviation of rounding."""
    size = np.abs(residual)
    # A robot that rests long repeats its pose exactly, but its motion is rounded.
    scale = max(NORMAL_MAD * float(np.median(size)), 2.0**0.5 * rounding)
    if scale <= 0.0:
        return np.zeros(len(size), dtype=bool)
    # Steps that are off for long, and in one direction, are a motion that the model lacks.
    least = max(_OUTLIER * scale, float(np.quantile(size, 1.0 - _MOST_OUTLIERS)))
    return find_short_runs(np.where(size > least, np.sign(residual), 0.0))


def find_short_runs(signs: Values) -> NDArray[np.bool_]:
    """Return which steps may be of a jump, from the signs of those that are off; else 0."""
    begins = np.flatnonzero(np.diff(signs, prepend=np.nan) != 0.0)
    lengths = np.diff(np.append(begins, len(signs)))
    return np.asarray((signs != 0.0) & (np.repeat(lengths, lengths) <= _LONGEST_JUMP))


@dataclass(frozen=True, slots=True, kw_only=True)
class StepNoise:
    """Variances of the noise of steps.

    Attributes:
        slip: Variance of a step of usual duration [m^2 or rad^2].
        sensing: Variance of a pose [m^2 or rad^2].
        rounded: Share of the variance of a step that is the rounding of poses [1].
    """

    slip: float
    sensing: float
    rounded: float = 0.0


class Whitening:
    """A transform of the residuals of steps into independent values with a variance of 1.

    Attributes:
        noise: Noise of the steps.
        log_size: Logarithm of the determinant of the covariance.
    """

    def __init__(
        self, noise: StepNoise, duration_s: Values, shared: Values, is_outlier: NDArray[np.bool_]
    ) -> None:
        """Prepare the whitening for steps of given durations [s]; `shared` as of a motion."""
        self.noise = noise
        usual_s = float(np.median(duration_s))
        variance = noise.slip * duration_s / usual_s + 2.0 * noise.sensing
        variance = variance * np.where(is_outlier, _EXCLUDED, 1.0)
        beside = -noise.sensing * shared[1:]
        bands = np.stack([variance, np.append(beside, 0.0)])
        self._factor = scipy.linalg.cholesky_banded(bands, lower=True, check_finite=False)
        self.log_size = 2.0 * float(np.log(self._factor[0]).sum())

    def apply(self, values: Values) -> Values:
        """Whiten the values of each step and return them, shape (n,) or (n, k)."""
        solve = scipy.linalg.solve_banded
        return np.asarray(solve((1, 0), self._factor, values, check_finite=False))


def fit_noise(
    residual: Values,
    duration_s: Values,
    shared: Values,
    is_outlier: NDArray[np.bool_],
    rounding: float = 0.0,
) -> Whitening:
    """Return the whitening by the likeliest noise of a residual, for steps of given durations.

    The noise is at least the rounding of poses, whose standard deviation is `rounding`.
    """
    least = 2.0 * max(rounding, LEAST_STEP) ** 2
    kept = ~is_outlier
    count = max(int(np.count_nonzero(kept)), 1)

    def scale(power: float) -> tuple[float, float, Whitening]:
        """Return the misfit of a ratio, and the variance by which its noise must be scaled."""
        noise = StepNoise(slip=10.0**power, sensing=1.0)
        whitening = Whitening(noise, duration_s, shared, is_outlier)
        variance = float(np.sum(whitening.apply(residual)[kept] ** 2)) / count
        variance = max(variance, least / (10.0**power + 2.0))
        return count * math.log(variance) + whitening.log_size, variance, whitening

    near = min(_RATIOS, key=lambda power: scale(power)[0])
    ends = max(near - 1, _RATIOS[0]), min(near + 1, _RATIOS[-1])
    power = scipy.optimize.minimize_scalar(
        lambda power: scale(power)[0], bounds=ends, method="bounded", options={"xatol": _FINE}
    ).x
    power = min((float(power), *ends), key=lambda power: scale(power)[0])
    variance = scale(power)[1]
    slip = variance * 10.0**power
    share = min(2.0 * rounding**2 / (slip + 2.0 * variance), 1.0)
    noise = StepNoise(slip=slip, sensing=variance, rounded=share)
    return Whitening(noise, duration_s, shared, is_outlier)


def learn_noise(
    residual: Values, duration_s: Values, shared: Values, rounding: float
) -> tuple[NDArray[np.bool_], Whitening]:
    """Return which residuals are outliers, and the whitening by the noise of the others."""
    is_outlier = find_outlying_steps(residual, rounding)
    return is_outlier, fit_noise(residual, duration_s, shared, is_outlier, rounding)
