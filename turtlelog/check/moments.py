"""When a metric first goes beyond its limit."""

from dataclasses import replace
from typing import Final

import numpy as np

from turtlelog.check.cut import cut_run
from turtlelog.check.operators import OPERATORS
from turtlelog.measure import MeasureSettings, Metric, measure_run
from turtlelog.run import Phase, Run

_GROWING: Final = frozenset(
    {
        *("overshoot", "undershoot", "crossings", "largest_error", "cross_track_max"),
        *("iae", "ise", "itae", "effort", "total_variation", "largest_jump", "largest_slew_rate"),
        *("reversals", "largest_wanted", "longest_saturation", "path_length", "largest_gap"),
        *("largest_pose_gap", "burst_samples", "dropped_samples", "duplicates", "disorder"),
        *("ideal_deviation_max", "sampled_deviation_max"),
    }
)
"""Metrics that only grow while a run goes on: counts, sums of magnitudes and the largest so far.

What comes later takes nothing away from these, so that the first violation can be searched for by
halving. Shares, means, percentiles, what is taken at the end, and what rests on a dead time that is
estimated from all rows may fall again."""

_WAITED_FOR: Final = frozenset(
    {"duration", "settling_time", "rise_time", "delay_time", "peak_time", "time_to_goal"}
)
"""Metrics that are a time since the beginning of their phase, or of the run."""


def find_metric_violation(
    run: Run, metric: Metric, operator: str, limit: float, settings: MeasureSettings | None = None
) -> float | None:
    """Return when a metric first violates a limit, from the first sample [s].

    What only grows (an error integral, a largest deviation) violates an upper limit at the first
    pose at which the run, had it ended there, would; what is waited for (a settling time), when
    the time allowed is over; what is taken at the end, at the end. Otherwise it is the moment at
    which the metric is taken; None where it belongs to no moment.
    """
    phase, name = metric.id.split(".", 1)
    if operator in {"<", "<="} and is_growing(metric.id) and metric.value is not None:
        return _find_growth(run, metric.id, operator, limit, settings)
    if operator in {"<", "<="} and name in _WAITED_FOR and metric.unit == "s":
        return _find_start_s(run, phase) + max(limit, 0.0)
    if metric.at_s is None and phase == "final":
        return (run.end_ns - run.start_ns) / 1e9
    return metric.at_s


def is_growing(name: str) -> bool:
    """Whether the metric of this id only grows while a run goes on."""
    plain = name.split(".", 1)[1].removeprefix("speed_").removeprefix("turn_rate_")
    return plain in _GROWING


def _find_growth(
    run: Run, name: str, operator: str, limit: float, settings: MeasureSettings | None
) -> float:
    first = int(np.searchsorted(run.poses.time_ns, run.start_ns, side="left"))
    last = len(run.poses) - 1
    while first < last:
        middle = (first + last) // 2
        part = cut_run(run, end_ns=int(run.poses.time_ns[middle]))
        part = replace(part, stop_reason=run.stop_reason)  # had it ended there
        value = measure_run(part, settings, only=(name,))[name].value
        if value is not None and not OPERATORS[operator](value, limit):
            last = middle
        else:
            first = middle + 1
    return float(run.poses.time_ns[last] - run.start_ns) / 1e9


def _find_start_s(run: Run, phase: str) -> float:
    for span in run.find_phase_spans():
        if span.phase is not Phase.PAUSE and span.phase.label == phase:
            return (span.start_ns - run.start_ns) / 1e9
    return 0.0
