"""The metrics of the end of a run."""

from math import degrees
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.angles import subtract_headings, wrap_angle
from turtlelog.measure.context import RunContext
from turtlelog.measure.metric import NO_GOAL, Found, Missing, Result, Status
from turtlelog.measure.registry import run_metric

PAPER_WINDOW_S: Final = 15.0
"""The paper's Table 1 reads its errors at this time after the first sample [s]."""

Values = NDArray[np.float64]


_NO_BEARING: Final = Missing(status=Status.ABSENT, reason="the goal bearing is not known")
_NO_HEADING: Final = Missing(status=Status.ABSENT, reason="the goal has no heading")


@run_metric(
    "final.heading_error",
    "deg",
    "Magnitude of reference heading minus heading at the end.",
)
def _compute_heading_error(context: RunContext, at_s: float | None = None) -> Result:
    error_rad = _find_heading_error(context, at_s)
    if error_rad is None:
        run = context.run
        is_robot = run.goal_xy_m is not None and not run.declaration.loops and not len(run.samples)
        return _NO_HEADING if is_robot else _NO_BEARING
    return _find_cut(context, at_s) or Found(degrees(abs(error_rad)), _tell_time(context, at_s))


@run_metric("final.position_error", "m", "Distance to the goal at the end.")
def _compute_position_error(context: RunContext, at_s: float | None = None) -> Result:
    goal_xy_m = context.run.goal_xy_m
    if goal_xy_m is None:
        return NO_GOAL
    x_m, y_m = (_read_at(context.pose_time_s, column, at_s) for column in context.run.poses.xy_m.T)
    error_m = float(np.hypot(goal_xy_m[0] - x_m, goal_xy_m[1] - y_m))
    return _find_cut(context, at_s) or Found(error_m, _tell_time(context, at_s))


@run_metric(
    "final.cross_track",
    "m",
    "Where the turtle ends, to the left of the line from start to goal.",
    better=None,
)
def _compute_cross_track(context: RunContext) -> Result:
    signal = context.get_signal("cross_track")
    return (
        _NO_BEARING
        if signal is None
        else Found(float(signal.values[-1]), _tell_time(context, None))
    )


@run_metric(
    "final.goal_heading_error",
    "deg",
    "Magnitude of the goal's heading minus heading at the end.",
)
def _compute_goal_heading_error(context: RunContext) -> Result:
    goal_rad = context.run.goal_heading_rad
    if goal_rad is None:
        return Missing(status=Status.ABSENT, reason="the goal asks for no heading")
    error_rad = abs(wrap_angle(goal_rad - float(context.run.poses.heading_rad[-1])))
    return Found(degrees(error_rad), _tell_time(context, None))


@run_metric(
    "final.heading_error_at_15s",
    "deg",
    "Heading error 15 s after the first sample, or at the end: the paper's definition.",
)
def _compute_heading_error_at_15s(context: RunContext) -> Result:
    return _compute_heading_error(context, PAPER_WINDOW_S)


@run_metric(
    "final.position_error_at_15s",
    "m",
    "Distance to the goal 15 s after the first sample, or at the end: the paper's.",
)
def _compute_position_error_at_15s(context: RunContext) -> Result:
    return _compute_position_error(context, PAPER_WINDOW_S)


def _find_heading_error(context: RunContext, at_s: float | None) -> float | None:
    """Return what the heading should be minus the heading [rad], in [-pi, pi)."""
    run, time_s = context.run, context.pose_time_s
    reference = context.heading_reference_rad
    if reference is None:
        recorded = context.get_signal("heading_error")
        if recorded is None:
            return None
        return float(recorded.values[_find_row(time_s, at_s)])
    signal = context.get_signal("heading")
    if signal is None or (run.declaration.loops and not len(run.samples)):
        return None
    heading_rad = _read_at(time_s, signal.values, at_s)
    return wrap_angle(_read_reference_at(time_s, reference, at_s) - heading_rad)


def _read_reference_at(time_s: Values, reference: float | Values, at_s: float | None) -> float:
    """Return a reference by line between rows, the short way round."""
    if not isinstance(reference, np.ndarray):
        return reference
    row = _find_row(time_s, at_s)
    if at_s is None or row == len(time_s) - 1:
        return float(reference[row])
    share = max((at_s - time_s[row]) / (time_s[row + 1] - time_s[row]), 0.0)
    turn_rad = subtract_headings(float(reference[row + 1]), float(reference[row]))
    return float(reference[row] + share * turn_rad)


def _find_row(time_s: Values, at_s: float | None) -> int:
    """Return the last row at a time or before, the last of all where it is None."""
    if at_s is None:
        return len(time_s) - 1
    return max(int(np.searchsorted(time_s, at_s, side="right")) - 1, 0)


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
