"""Metrics of sampling times and of the sequence numbers of samples.

A period is the time from one row to the next, `np.diff(time_s)`, shape (n - 1,). The rows of a
burst share one time: their periods are 0 and are counted. The silence before a burst is one long
period. Therefore the mean is the length divided by the count. The median is the usual period of the
loop, and the percentiles show bursts and pauses.
"""

import math
from collections.abc import Callable
from typing import Any, Final, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from turtlelog.arithmetic import compiled_as
from turtlelog.measure.breaks import find_jumps
from turtlelog.measure.metric import (
    FOUND,
    ONE_POSE,
    REASONS,
    Found,
    Missing,
    Outcome,
    Result,
    Status,
    add_reason,
)
from turtlelog.measure.metric_kinds import course_metric, read_meaning, run_metric
from turtlelog.measure.reductions import (
    PIECES,
    Values,
    compute_median,
    find_furthest_row,
    subtract_neighbours,
)
from turtlelog.measure.run_context import RunContext

Rows = Literal["sample", "pose"]
OfPeriods = Callable[[Values], float | None]
_OfPeriods = TypeVar("_OfPeriods", bound=OfPeriods)

_ROWS_UNKNOWN: Final = add_reason(Status.ABSENT, "neither samples nor commands were read")
_NO_ROWS: Final = REASONS[_ROWS_UNKNOWN]
_ONE_SAMPLE: Final = add_reason(Status.TOO_SHORT, "1 sample")
_NO_SAMPLES: Final = Missing(Status.ABSENT, "no samples of a controller were read")


def _period_metric(
    rows: Rows, name: str, unit: str, meaning: str = "", *, fewest: int = 1, **traits: Any
) -> Callable[[_OfPeriods], _OfPeriods]:
    """Enter a function of the periods of samples or poses as a metric; `fewest` are needed."""

    def enter(compute: _OfPeriods) -> _OfPeriods:
        def compute_on_periods(context: RunContext) -> Result:
            periods_s = _get_periods(context, rows)
            if isinstance(periods_s, Missing):
                return periods_s
            value = compute(periods_s) if len(periods_s) >= fewest else None
            if value is None:
                found = len(periods_s) + 1
                reason = f"{found} {rows}{'s' if found > 1 else ''}, or no time between them"
                return Missing(Status.TOO_SHORT, reason)
            return Found(float(value))

        traits["needs_poses"] = rows == "pose"
        enter_run = run_metric(f"run.{name}", unit, meaning or read_meaning(compute), **traits)
        enter_run(compute_on_periods)
        return compute

    return enter


def _get_periods(context: RunContext, rows: Rows) -> Values | Missing:
    if rows == "pose":
        return context.pose_period_s
    return context.sample_period_s if len(context.sample_time_s) else _NO_ROWS


@_period_metric(
    "sample", "sample_rate", "Hz", "Samples per second, from the first to the last.", better=None
)
def compute_rate(periods_s: Values) -> float | None:
    """Return the number of rows per second over the whole length [Hz]; None if no time passes."""
    length_s = float(periods_s.sum())
    return len(periods_s) / length_s if length_s > 0.0 else None


@_period_metric(
    "sample", "sample_period_mean", "s", "Mean time from one sample to the next.", better=None
)
def _compute_mean(periods_s: Values) -> float:
    return float(periods_s.mean())


@_period_metric(
    "sample",
    "sample_period_std",
    "s",
    "Standard deviation of the time from one sample to the next.",
)
def compute_spread(periods_s: Values) -> float:
    """Return the standard deviation of the periods around their mean [s]."""
    # From the first period on, so that equal periods give exactly 0.
    return float((periods_s - periods_s[0]).std())


def find_percentile(ordered_s: Values, percent: int) -> float:
    """Return the shortest period that at least `percent` % of the periods do not exceed [s]."""
    if percent == 50:
        return compute_median(ordered_s)
    return float(ordered_s[-(-len(ordered_s) * percent // 100) - 1])


def _pick(percent: int) -> Callable[[RunContext], Result]:
    """Return the metric of one percentile; the periods are sorted once for all percentiles."""

    def compute(context: RunContext) -> Result:
        periods_s = _get_periods(context, "sample")
        if isinstance(periods_s, Missing):
            return periods_s
        if not len(periods_s):
            return REASONS[_ONE_SAMPLE]
        ordered_s = context.recall("ordered periods", lambda: np.sort(periods_s))
        return Found(find_percentile(ordered_s, percent))

    return compute


for _percent in (50, 95, 99):
    run_metric(
        f"run.sample_period_p{_percent}",
        "s",
        f"{_percent}th percentile of the time from one sample to the next.",
        better=None if _percent == 50 else "lower",
        needs_poses=False,
    )(_pick(_percent))


@_period_metric("sample", "sample_jitter", "s", fewest=2)
def compute_jitter(periods_s: Values) -> float | None:
    """Root of the mean square of the change from one time between samples to the next.

    This is the RMS cycle-to-cycle jitter [s] (JEDEC JESD65B). Unlike the standard deviation, it
    ignores a slow drift of the rate. The result is None for fewer than two periods.
    """
    changes = subtract_neighbours(periods_s)
    return float(np.sqrt(np.mean(changes * changes))) if len(changes) else None


def _list_periods(course: Any) -> Values:
    samples, periods_s = course.samples, course.memory.numbers[PIECES]
    for row in range(len(samples) - 1):
        periods_s[row] = (samples[row + 1].time_ns - samples[row].time_ns) / 1e9
    return periods_s[: len(samples) - 1]  # type: ignore[no-any-return]


@compiled_as(_list_periods)
def _get_sample_periods(course: RunContext) -> Values:
    return course.sample_period_s


def _tell_row(course: Any, row: int) -> float:
    return (course.samples[row].time_ns - course.start_ns) / 1e9  # type: ignore[no-any-return]


@compiled_as(_tell_row)
def _tell_sample(course: RunContext, row: int) -> float:
    return float(course.sample_time_s[row])


@course_metric("run.largest_gap", "s", grows=True, needs_poses=False)
def _measure_largest_gap(course: RunContext) -> Outcome:
    """Longest time without a sample."""
    # The time of the metric is the beginning of the period.
    if course.sample_count == 0:
        return math.nan, math.nan, _ROWS_UNKNOWN
    periods_s = _get_sample_periods(course)
    if len(periods_s) == 0:
        return math.nan, math.nan, _ONE_SAMPLE
    row = find_furthest_row(periods_s, 1.0)
    return periods_s[row], _tell_sample(course, row), FOUND


@_period_metric("sample", "burst_samples", "1", fewest=0, nature="count", grows=True)
def count_burst_rows(periods_s: Values) -> int:
    """Number of samples that have the same time as the sample before."""
    return int(np.count_nonzero(periods_s == 0.0))


def count_missing(sequence: NDArray[np.int64]) -> int:
    """Return how many numbers are missing between the first and the last; numbers increase by 1."""
    return int(sequence[-1] - sequence[0]) + 1 - len(sequence) if len(sequence) else 0


@run_metric("run.dropped_samples", "1", nature="count", grows=True)
def _count_missing(context: RunContext) -> Result:
    """Number of missing sequence numbers between the first and the last sample."""
    sequence = context.run.samples.sequence
    return Found(float(count_missing(sequence))) if len(sequence) else _NO_SAMPLES


_period_metric(
    "pose", "pose_rate", "Hz", "Poses per second, from the first to the last.", better=None
)(compute_rate)
_period_metric(
    "pose", "pose_period_std", "s", "Standard deviation of the time from one pose to the next."
)(compute_spread)


@run_metric(
    "run.largest_pose_gap", "s", "Longest time without a pose, also after the last.", grows=True
)
def _find_largest_pose_gap(context: RunContext) -> Result:
    if not len(context.pose_period_s):
        return ONE_POSE
    periods_s = np.append(context.pose_period_s, context.duration_s - context.last_pose_s)
    row = int(periods_s.argmax())
    return Found(float(periods_s[row]), float(context.pose_time_s[row]))


@run_metric("run.pose_jumps", "1", nature="count")
def _count_jumps(context: RunContext) -> Result:
    """Number of steps from pose to pose that the robot cannot have driven."""
    if not len(context.pose_period_s):
        return ONE_POSE
    return Found(float(len(find_jumps(context.run))))


@run_metric(
    "run.duplicates",
    "1",
    "Number of duplicate rows of the imported file, which were dropped.",
    nature="count",
    grows=True,
    needs_poses=False,
)
def _count_duplicates(context: RunContext) -> Result:
    return Found(float(context.run.origin.dropped_duplicates))


@run_metric(
    "run.disorder",
    "1",
    "Number of rows of the imported file that were out of order, and were sorted.",
    nature="count",
    grows=True,
    needs_poses=False,
)
def _count_disorder(context: RunContext) -> Result:
    return Found(float(context.run.origin.sorted_rows))
