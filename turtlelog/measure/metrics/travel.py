"""Metrics of a robot's motion from poses alone: distance, speed, smoothness, and time at rest."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import degrees
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.measure.metric import ONE_POSE, Found, Missing, Result, Status
from turtlelog.measure.metric_kinds import run_metric
from turtlelog.measure.rates import AXES, NEAR, SAME, Axis, Rates
from turtlelog.measure.reductions import Values, compute_median, subtract_neighbours, sum_products
from turtlelog.measure.references import recall
from turtlelog.measure.run_context import RunContext
from turtlelog.run import take_rows
from turtlelog.run.angles import unwrap_headings

if TYPE_CHECKING:
    from turtlelog.measure.pose_noise import WhiteNoise


_IN_PLANE: Final = Missing(
    Status.ABSENT, "the robot stays in the plane, or its poses have no height"
)


def _on_space(
    column: str, compute: Callable[[Values, Values], Result]
) -> Callable[[RunContext], Result]:
    def compute_on_space(context: RunContext) -> Result:
        values = getattr(context.run.poses, column)
        if values is None or not np.isfinite(values).any():
            return _IN_PLANE
        rows = np.isfinite(values)
        return compute(context.run.poses.xy_m[rows], values[rows])

    return compute_on_space


def _compute_way(xy_m: Values, height_m: Values) -> Result:
    steps = np.diff(np.column_stack([xy_m, height_m]), axis=0)
    return Found(float(np.sqrt((steps**2).sum(axis=1)).sum()))


run_metric(
    "run.path_length_in_space",
    "m",
    "Length of the line through all poses with their heights.",
    grows=True,
)(_on_space("height_m", _compute_way))
run_metric("run.height_range", "m", "Greatest height minus least height.", better=None, grows=True)(
    _on_space("height_m", lambda _, height_m: Found(float(np.ptp(height_m))))
)
run_metric(
    "run.tilt_max",
    "deg",
    "Largest angle between the robot's vertical axis and the world's.",
    grows=True,
)(_on_space("tilt_rad", lambda _, tilt_rad: Found(float(np.degrees(tilt_rad.max())))))


@run_metric("run.total_turning", "deg", better=None, axis="turn_rate", grows=True)
def _compute_turning(context: RunContext) -> Result:
    """Sum of the magnitudes of all turns from pose to pose."""
    turns_rad = subtract_neighbours(unwrap_headings(context.run.poses))
    return Found(degrees(float(np.abs(turns_rad).sum())))


def _on_rates(axis: Axis, compute: Callable[[Rates], Result]) -> Callable[[RunContext], Result]:
    def compute_on_rates(context: RunContext) -> Result:
        rates = context.get_rates(axis)
        return ONE_POSE if rates is None else compute(rates)

    return compute_on_rates


_NOT_SEEN: Final = Missing(Status.UNDETERMINED, "every pose is after a gap or a jump")


def _find_largest(rates: Rates) -> Result:
    if not len(rates.values):
        return _NOT_SEEN
    row = int(np.abs(rates.values).argmax())
    return Found(abs(float(rates.values[row])), float(rates.time_s[row]))


def _compute_mean(rates: Rates) -> Result:
    step_s = subtract_neighbours(rates.edges_s)[rates.is_seen]
    if not len(step_s):
        return _NOT_SEEN
    return Found(sum_products(np.abs(rates.means[rates.is_seen]), step_s) / float(step_s.sum()))


for _axis, _unit in AXES.items():
    _words = _axis.replace("_", " ")
    run_metric(
        f"run.measured_{_axis}_max",
        _unit,
        f"Largest magnitude of the {_words} that the robot reports, or else of differences of"
        " poses; outliers, gaps and jumps left out.",
        better=None,
        axis=_axis,
    )(_on_rates(_axis, _find_largest))
    run_metric(
        f"run.measured_{_axis}_mean",
        _unit,
        f"Mean magnitude of the measured {_words} over the time with poses.",
        better=None,
        axis=_axis,
    )(_on_rates(_axis, _compute_mean))


AT_REST_M_S: Final = 0.01
AT_REST_RAD_S: Final = 0.02
"""Rates below which a robot is at rest [m/s, rad/s]: a tenth of the 0.1 m/s and 0.2 rad/s of slow
small robots. Noise of poses of 1 mm and 2 mrad gives a third of these rates."""

_REST_S: Final = 0.5
"""Time over which rest is judged [s]. In this time the rates above give 5 mm and 0.6 deg, so that
noise of poses does not count as motion."""

_LONGEST_REST_S: Final = 5.0
"""Longest time over which rest of noisy poses is judged [s]; shorter rests are not seen then.
Beyond it, as for a receiver that scatters by 4 cm at 10 Hz, noise hides rest."""

_NOISES: Final = 3.0
"""Noise of a mean rate that must be below the threshold of rest, in standard deviations."""

_RANGE: Final = 7.0
"""Range of the noise of ten poses in half a second, in standard deviations of their coordinates: 3
of 1,000 are larger. Means of several poses are needed if it exceeds the threshold of rest."""

_ENDS: Final = 5.0
"""Distance between two noisy poses that is motion, in standard deviations of their coordinates."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rest:
    """Rest of a robot.

    Attributes:
        time_s: Time at rest [s].
        seen_s: Time with poses [s].
        way_m: Distance that the robot creeps while it counts as at rest [m].
    """

    time_s: float
    seen_s: float
    way_m: float


def judge_rest(context: RunContext) -> Rest | Missing:
    """Return the rest of a robot, found in its poses, or why it is unknown.

    The time between two poses counts as rest if all poses of the half second before or after it
    lie within a threshold; a robot that swings does not rest. Fast steps beside motion do not
    count. If poses are noisy, means of several poses are compared, over as much time as the noise
    needs.
    """
    return recall(context.run, "rest", lambda: _judge_rest(context))


def _judge_rest(context: RunContext) -> Rest | Missing:
    spaced, noise = context.spaced_poses, context.noise
    if spaced is None:
        return ONE_POSE
    time_s, xy_m = spaced.time_s, context.run.poses.xy_m[spaced.rows]
    columns = (*xy_m.T, spaced.heading_rad)
    window_s = 0.0 if noise is None else _choose_window(time_s, noise)
    if noise is None or not window_s:
        is_at_rest = _find_slow_steps(time_s, columns)
    elif window_s <= _LONGEST_REST_S:
        is_at_rest = _find_slow_means(time_s, columns, window_s)
    else:
        longest_s = max(_LONGEST_REST_S, 3.0 * compute_median(subtract_neighbours(time_s)))
        is_at_rest = _find_slow_means(time_s, columns, longest_s, noise)
        if is_at_rest.any():
            return _HIDDEN
    steps_s = subtract_neighbours(time_s)
    sizes = (0.0, 0.0)
    if noise is not None:
        from turtlelog.measure.pose_noise import measure_noise

        all_rad = measure_noise(take_rows(context.run.poses, spaced.rows)).heading_rad
        sizes = noise.position_m, max(noise.heading_rad, all_rad)  # even if it turns to and fro
    _shorten_rests(is_at_rest, steps_s, columns, sizes)
    seen_s = float(time_s[-1] - time_s[0]) - float(steps_s[~spaced.is_seen].sum())
    silent_s = _measure_silence(steps_s, columns, spaced.is_seen & ~is_at_rest)
    if silent_s > _SILENT * seen_s:
        reason = f"poses are missing while the robot hardly moves: up to {silent_s:.2g} s of rest"
        return Missing(Status.UNDETERMINED, reason)
    is_at_rest &= spaced.is_seen
    # From where to where it moves meanwhile, without the noise of each end.
    ends = np.flatnonzero(np.diff(is_at_rest, prepend=False, append=False))
    crept_m = np.hypot(*(xy_m[ends[1::2]] - xy_m[ends[::2]]).T)
    crept_m = crept_m[crept_m > _ENDS * (0.0 if noise is None else noise.position_m)]
    return Rest(time_s=float(steps_s[is_at_rest].sum()), seen_s=seen_s, way_m=float(crept_m.sum()))


def _shorten_rests(
    is_at_rest: NDArray[np.bool_],
    steps_s: Values,
    columns: Sequence[Values],
    sizes: tuple[float, float],
) -> None:
    """Drop from both ends of each rest the steps that are faster than rest.

    `sizes` are the noise of positions [m] and headings [rad].
    """
    x_m, y_m, turned_rad = (np.abs(subtract_neighbours(at)) for at in columns)
    is_slow = np.hypot(x_m, y_m) <= AT_REST_M_S * steps_s + _ENDS * sizes[0]
    is_slow &= turned_rad <= AT_REST_RAD_S * steps_s + _ENDS * sizes[1]
    ends = np.flatnonzero(np.diff(is_at_rest, prepend=False, append=False))
    for first, last in zip(ends[::2].tolist(), ends[1::2].tolist(), strict=True):
        slow = first + np.flatnonzero(is_slow[first:last])
        is_at_rest[first : slow.min(initial=last)] = first == 0
        is_at_rest[slow.max(initial=first) + 1 : last] = last == len(is_slow)


_SILENT: Final = 0.05
"""Largest share of the time that may be rest between poses far apart, as for gaps: localisation
often publishes poses only after the robot has moved by a quarter of a metre."""


def _measure_silence(
    steps_s: Values, columns: Sequence[Values], is_moving: NDArray[np.bool_]
) -> float:
    """Return how long a robot may rest in the moving steps that are longer than usual [s].

    At the greatest rates of the other steps, it moves as far in the rest of their time.
    """
    from turtlelog.measure.breaks import LATE  # simulations need none of it

    x_m, y_m, turned_rad = (np.abs(subtract_neighbours(at)) for at in columns)
    is_long = steps_s > max(LATE * compute_median(steps_s), _REST_S)
    needed_s = np.zeros(len(steps_s))
    for way in (np.hypot(x_m, y_m), turned_rad):
        fastest = float((way / steps_s)[is_moving & ~is_long].max(initial=0.0))
        needed_s = np.maximum(needed_s, way / fastest if fastest else 0.0)
    return float(np.maximum(steps_s - needed_s, 0.0)[is_moving & is_long].sum())


@run_metric("run.rest_time", "s", better=None)
def _compute_rest_time(context: RunContext) -> Result:
    """Time at standstill: slower than 0.01 m/s and 0.02 rad/s, over half a second."""
    found = judge_rest(context)
    return found if isinstance(found, Missing) else Found(found.time_s)


@run_metric("run.rest_share", "1", better=None, nature="share")
def _compute_rest_share(context: RunContext) -> Result:
    """Share of the time with poses at standstill."""
    found = judge_rest(context)
    if isinstance(found, Missing):
        return found
    return Found(found.time_s / found.seen_s) if found.seen_s > 0.0 else _NOT_SEEN


_HIDDEN: Final = Missing(Status.UNDETERMINED, "noise of the poses hides whether the robot rests")


def _estimate_rate_noise(time_s: Values, size: float, window_s: float) -> float:
    """Return the noise of a rate from means of poses in a window, in multiples of `_NOISES`."""
    # Between the means of the first and the last third of a window of n poses is a time of two
    # thirds of it, and the noise of their difference is sqrt(6 / n) times that of one pose.
    count = window_s / compute_median(subtract_neighbours(time_s))
    return float(_NOISES * np.sqrt(6.0 / count) * size / (window_s * 2.0 / 3.0))


def _choose_window(time_s: Values, noise: "WhiteNoise") -> float:
    """Return the time over which means of noisy poses show rest [s]; 0 if single poses do."""
    usual_s, windows_s = compute_median(subtract_neighbours(time_s)), []
    for size, rate in ((noise.position_m, AT_REST_M_S), (noise.heading_rad, AT_REST_RAD_S)):
        if _RANGE * size > rate * max(_REST_S, usual_s):
            # The noise of a rate falls with the power 3/2 of the window.
            windows_s.append((_estimate_rate_noise(time_s, size, 1.0) / rate) ** (2.0 / 3.0))
    # Each third of a window has a pose.
    return max(*windows_s, _REST_S, 3.0 * usual_s) if windows_s else 0.0


def _find_slow_means(
    time_s: Values, columns: Sequence[Values], window_s: float, noise: "WhiteNoise | None" = None
) -> NDArray[np.bool_]:
    """Return in which steps means of the poses lie within the threshold of rest.

    The means are those of the thirds of a window before or after each step. If noise is given,
    steps that it may move beyond the threshold are found, too.
    """
    most_m_s, most_rad_s = AT_REST_M_S, AT_REST_RAD_S
    if noise is not None:
        most_m_s += _estimate_rate_noise(time_s, noise.position_m, window_s)
        most_rad_s += _estimate_rate_noise(time_s, noise.heading_rad, window_s)
    sums = [np.append(0.0, np.cumsum(at - at[0])) for at in (time_s, *columns)]

    def average(begin_s: Values, end_s: Values) -> Values:
        first, last = np.searchsorted(time_s, begin_s), np.searchsorted(time_s, end_s, side="right")
        count = np.maximum(last - first, 1)
        means = np.array([(total[last] - total[first]) / count for total in sums])
        empty = last <= first  # no pose is there: the robot is taken as moving evenly
        between_s = (begin_s[empty] + end_s[empty]) / 2.0
        means[:, empty] = [np.interp(between_s, time_s, at - at[0]) for at in (time_s, *columns)]
        return means

    found = np.zeros(len(time_s) - 1, dtype=bool)
    for begin_s in _place_windows(time_s, window_s):
        knots_s = [begin_s + share * window_s for share in (0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0)]
        thirds = np.array([average(*ends_s) for ends_s in pairwise(knots_s)])
        lasted_s, *moved = np.ptp(thirds, axis=0)
        found |= _is_slow(moved, lasted_s, most_m_s, most_rad_s)
    return found


def _place_windows(time_s: Values, window_s: Values | float) -> Iterator[Values]:
    """Yield the begins of the windows before each step, and of those after each step."""
    for first_s in (time_s[1:] - window_s, time_s[:-1]):
        yield np.clip(first_s, time_s[0], np.maximum(time_s[-1] - window_s, time_s[0]))


def _find_slow_steps(time_s: Values, columns: Sequence[Values]) -> NDArray[np.bool_]:
    """Return in which steps the poses lie within the threshold of rest."""
    found = np.zeros(len(time_s) - 1, dtype=bool)
    window_s = np.maximum(subtract_neighbours(time_s), _REST_S)
    for begin_s in _place_windows(time_s, window_s):
        last_s = np.minimum(begin_s + window_s, time_s[-1])
        moved = [_measure_ranges(time_s, at, begin_s, last_s) for at in columns]
        found |= _is_slow(moved, last_s - begin_s)
    return found


def _measure_ranges(time_s: Values, values: Values, first_s: Values, last_s: Values) -> Values:
    """Return the range of values in each window, linearly interpolated at its ends."""
    rows = np.searchsorted(time_s, first_s), np.searchsorted(time_s, last_s, side="right")
    inside, values_to_end = np.column_stack(rows).ravel(), np.append(values, values[-1])
    ends = np.interp(first_s, time_s, values), np.interp(last_s, time_s, values)
    highest = np.maximum.reduceat(values_to_end, inside)[::2]
    lowest = np.minimum.reduceat(values_to_end, inside)[::2]
    return np.asarray(np.maximum.reduce([highest, *ends]) - np.minimum.reduce([lowest, *ends]))


def _is_slow(
    moved: Sequence[Values],
    lasted_s: Values,
    most_m_s: float = AT_REST_M_S,
    most_rad_s: float = AT_REST_RAD_S,
) -> NDArray[np.bool_]:
    """Return which motions in x, y [m] and heading [rad] are slower than a threshold."""
    is_slow = np.hypot(moved[0], moved[1]) <= most_m_s * lasted_s
    return np.asarray(is_slow & (moved[2] <= most_rad_s * lasted_s))


_HIGHEST_HZ: Final = 10.0
_LEAST_AMPLITUDE: Final = 0.05
_PADDING: Final = 4
"""Cut-off frequency [Hz], amplitude threshold [1] and zero padding [powers of 2] of the source."""

_LEAST_HZ: Final = 5.0
"""Smallest rate of poses that shows smoothness [Hz]: a start of one second has five poses."""

_MOST_ROWS: Final = 20_000
"""Largest number of rows for computing smoothness: a quarter of an hour at 20 Hz."""


@run_metric(
    "run.spectral_arc_length",
    "1",
    "Smoothness of the measured speed (SPARC): -1.4 is a single smooth movement, lower is jerkier.",
    better="higher",
)
def _compute_arc_length(context: RunContext) -> Result:
    rates = context.get_rates("speed")
    if rates is None:
        return ONE_POSE
    period_s = max(compute_median(subtract_neighbours(rates.edges_s)), 0.04)
    if period_s > NEAR / _LEAST_HZ:
        reason = f"poses at {1.0 / period_s:.3g} Hz, and it takes {_LEAST_HZ:g} Hz"
        return Missing(Status.TOO_SHORT, reason)
    time_s, values = _take_longest(rates)
    if not len(values):
        return _NOT_SEEN
    time_s, values = time_s[:_MOST_ROWS], values[:_MOST_ROWS]
    fastest_m_s = float(np.abs(values).max())
    if fastest_m_s <= AT_REST_M_S:
        slow = f"it drives no faster than {fastest_m_s:.1g} m/s, which counts as rest"
        is_still = fastest_m_s <= SAME
        return Missing(
            Status.NO_MOTION, "the robot does not drive forward or back" if is_still else slow
        )
    even_s = np.arange(time_s[0], time_s[-1], period_s)
    if len(even_s) < _LEAST_HZ:
        return Missing(Status.TOO_SHORT, f"{len(values)} measured speeds")
    found = compute_spectral_arc_length(np.interp(even_s, time_s, values), 1.0 / period_s)
    return _NOISY if found is None else Found(found)


def _take_longest(rates: Rates) -> tuple[Values, Values]:
    """Return the times and values of the longest part without gaps and jumps."""
    edges_s, unseen = rates.edges_s, np.flatnonzero(~rates.is_seen)
    if not len(unseen):
        return rates.time_s, rates.values
    begins_s = np.concatenate([edges_s[:1], edges_s[unseen + 1]])
    ends_s = np.concatenate([edges_s[unseen], edges_s[-1:]])
    longest = int((ends_s - begins_s).argmax())
    first = int(np.searchsorted(rates.time_s, begins_s[longest]))
    last = int(np.searchsorted(rates.time_s, ends_s[longest], side="right"))
    return rates.time_s[first:last], rates.values[first:last]


_FLOOR: Final = 3.0
"""Noise level as a multiple of the median amplitude above half the cut-off frequency; 1 of 500
amplitudes of noise is larger. If the level reaches the threshold, noise determines the end of the
spectrum."""

_NOISY: Final = Missing(
    Status.UNDETERMINED,
    "the spectrum of the measured speed does not fall: noise of the poses, or jolts",
)


def compute_spectral_arc_length(speed: Values, rate_hz: float) -> float | None:
    """Return the spectral arc length of a speed profile [1], negative; None if noise decides it.

    This is the length of the normalised amplitude spectrum up to the last frequency with at least 5
    % of the largest value, at most 10 Hz or half the rate: S. Balasubramanian, A.
    Melendez-Calderon, A. Roby-Brami, E. Burdet, "On the analysis of movement smoothness", J.
    NeuroEngineering and Rehabilitation 12:112 (2015). Noise spreads over all frequencies and stays
    below the threshold.

    Args:
        speed: Speeds at equally spaced times, shape (n,), not all 0.
        rate_hz: Values per second [Hz].
    """
    count = 2 ** (int(np.ceil(np.log2(len(speed)))) + _PADDING)
    frequency_hz = np.arange(count // 2 + 1) * rate_hz / count
    spectrum = np.abs(np.fft.rfft(speed, count))
    spectrum = spectrum[frequency_hz <= _HIGHEST_HZ] / spectrum.max()
    frequency_hz = frequency_hz[: len(spectrum)]
    if _FLOOR * compute_median(spectrum[len(spectrum) // 2 :]) >= _LEAST_AMPLITUDE:
        return None
    high = np.flatnonzero(spectrum >= _LEAST_AMPLITUDE)
    if not len(high):  # the whole spectrum is above the highest frequency
        return None
    last = int(high[-1])
    if last == 0:
        return -0.0
    steps = subtract_neighbours(frequency_hz[: last + 1]) / frequency_hz[last]
    return -float(np.hypot(steps, subtract_neighbours(spectrum[: last + 1])).sum())
