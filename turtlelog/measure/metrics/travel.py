"""Metrics of a robot's motion from poses alone: distance, speed, smoothness, and time at rest."""

from collections.abc import Callable
from math import degrees
from typing import Final

import numpy as np

from turtlelog.measure.metric import ONE_POSE, Found, Missing, Result, Status
from turtlelog.measure.metric_kinds import RunContext, run_metric
from turtlelog.measure.rates import AXES, SAME, Axis, Rates, Values
from turtlelog.measure.reductions import compute_median, subtract_neighbours, sum_products
from turtlelog.measure.rest import AT_REST_M_S, Rest, judge_rest
from turtlelog.run.angles import unwrap_headings


@run_metric("run.net_displacement", "m", "Distance from the first pose to the last.", better=None)
def _compute_displacement(context: RunContext) -> Result:
    xy_m = context.run.poses.xy_m
    return Found(float(np.hypot(*(xy_m[-1] - xy_m[0]))))


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


@run_metric("run.total_turning", "deg", better=None, grows=True)
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
    )(_on_rates(_axis, _find_largest))
    run_metric(
        f"run.measured_{_axis}_mean",
        _unit,
        f"Mean magnitude of the measured {_words} over the time with poses.",
        better=None,
    )(_on_rates(_axis, _compute_mean))


def judge_rest_of(context: RunContext) -> Rest | Missing:
    """Return the rest of a run, or why it is unknown."""

    def find() -> Rest | Missing:
        spaced = context.spaced_poses
        if spaced is None:
            return ONE_POSE
        return judge_rest(context.run.poses.xy_m[spaced.rows], spaced, context.noise)

    return context.recall("rest", find)


@run_metric("run.rest_time", "s", better=None)
def _compute_rest_time(context: RunContext) -> Result:
    """Time at standstill: slower than 0.01 m/s and 0.02 rad/s, over half a second."""
    found = judge_rest_of(context)
    return found if isinstance(found, Missing) else Found(found.time_s)


@run_metric("run.rest_share", "1", "Share of the time with poses at standstill.", better=None)
def _compute_rest_share(context: RunContext) -> Result:
    found = judge_rest_of(context)
    if isinstance(found, Missing):
        return found
    return Found(found.time_s / found.seen_s) if found.seen_s > 0.0 else _NOT_SEEN


_HIGHEST_HZ: Final = 10.0
_LEAST_AMPLITUDE: Final = 0.05
_PADDING: Final = 4
"""Cut-off frequency [Hz], amplitude threshold [1] and zero padding [powers of 2] of the source."""

_LEAST_HZ: Final = 5.0
_NEAR: Final = 1.01
"""Smallest rate of poses that shows smoothness [Hz]: a start of one second has five poses. Clocks
and times with few digits make a rate of 5 Hz appear up to a hundredth lower."""

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
    if period_s > _NEAR / _LEAST_HZ:
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
