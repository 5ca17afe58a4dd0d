"""The metrics of the end of a run."""

from collections.abc import Mapping
from math import degrees
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.angles import wrap_angle
from turtlelog.measure.context import RunContext
from turtlelog.measure.metric import Found, Missing, Result, Status
from turtlelog.measure.table.kinds import MetricKind

PAPER_WINDOW_S: Final = 15.0
"""The paper's Table 1 reads its errors at this time after the first sample [s]."""

Values = NDArray[np.float64]


def _compute_heading_error(context: RunContext, at_s: float | None = None) -> Result:
    run = context.run
    signal = context.get_signal("heading")
    if signal is None or not len(run.samples):
        return Missing(status=Status.ABSENT, reason="the goal bearing is not known")
    heading_rad = _read_at(context.pose_time_s, signal.values, at_s)
    error_rad = abs(wrap_angle(float(run.samples.bearing_rad[0]) - heading_rad))
    return _find_cut(context, at_s) or Found(degrees(error_rad), _tell_time(context, at_s))


def _compute_position_error(context: RunContext, at_s: float | None = None) -> Result:
    goal_xy_m = context.run.goal_xy_m
    if goal_xy_m is None:
        return _NO_GOAL
    x_m, y_m = (_read_at(context.pose_time_s, column, at_s) for column in context.run.poses.xy_m.T)
    error_m = float(np.hypot(goal_xy_m[0] - x_m, goal_xy_m[1] - y_m))
    return _find_cut(context, at_s) or Found(error_m, _tell_time(context, at_s))


def _compute_goal_heading_error(context: RunContext) -> Result:
    goal_rad = context.run.goal_heading_rad
    if goal_rad is None:
        return Missing(status=Status.ABSENT, reason="the goal asks for no heading")
    error_rad = abs(wrap_angle(goal_rad - float(context.run.poses.heading_rad[-1])))
    return Found(degrees(error_rad), _tell_time(context, None))


def _compute_cross_track(context: RunContext) -> Result:
    signal = context.get_signal("cross_track")
    if signal is None:
        return Missing(status=Status.ABSENT, reason="the goal bearing is not known")
    return Found(float(signal.values[-1]), _tell_time(context, None))


def _read_at(time_s: Values, values: Values, at_s: float | None) -> float:
    """Return a value by line between rows, the last row's after the end or where at_s is None."""
    return float(values[-1]) if at_s is None else float(np.interp(at_s, time_s, values))


def _tell_time(context: RunContext, at_s: float | None) -> float:
    end_s = float(context.pose_time_s[-1])
    return end_s if at_s is None else min(at_s, end_s)


def _find_cut(context: RunContext, at_s: float | None) -> Missing | None:
    """A run that has come to its own end holds its last value; one that was cut does not."""
    run = context.run
    length_s = (run.end_ns - run.start_ns) / 1e9
    if at_s is None or run.is_complete or length_s >= at_s:
        return None
    return Missing(status=Status.TOO_SHORT, reason=f"the run was cut at {length_s:.2f} s")


_NO_GOAL: Final = Missing(status=Status.ABSENT, reason="the goal is not known")

FINAL_METRICS: Final[Mapping[str, MetricKind]] = MappingProxyType(
    {
        "final.heading_error": MetricKind(
            unit="deg",
            compute=_compute_heading_error,
            meaning="Magnitude of goal bearing minus heading at the end.",
        ),
        "final.position_error": MetricKind(
            unit="m", compute=_compute_position_error, meaning="Distance to the goal at the end."
        ),
        "final.cross_track": MetricKind(
            unit="m",
            compute=_compute_cross_track,
            meaning="Where the turtle ends, to the left of the line from start to goal.",
            better=None,
        ),
        "final.goal_heading_error": MetricKind(
            unit="deg",
            compute=_compute_goal_heading_error,
            meaning="Magnitude of the heading that the goal asks for minus heading at the end.",
        ),
        "final.heading_error_at_15s": MetricKind(
            unit="deg",
            compute=lambda context: _compute_heading_error(context, PAPER_WINDOW_S),
            meaning=(
                "Heading error 15 s after the first sample, or at the end: the paper's definition."
            ),
        ),
        "final.position_error_at_15s": MetricKind(
            unit="m",
            compute=lambda context: _compute_position_error(context, PAPER_WINDOW_S),
            meaning="Distance to the goal 15 s after the first sample, or at the end: the paper's.",
        ),
    }
)
"""The metrics of the end of a run by id."""
