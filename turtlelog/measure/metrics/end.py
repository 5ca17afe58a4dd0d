"""The metrics of the end of a run."""

import math
from typing import Any, Final

import numpy as np
from numpy import hypot
from numpy.typing import NDArray

from turtlelog.arithmetic import compiled_as
from turtlelog.measure.context import RunContext
from turtlelog.measure.metric import (
    FOUND,
    GOAL_UNKNOWN,
    NO_GOAL,
    REASONS,
    Found,
    Missing,
    Outcome,
    Result,
    Status,
    add_reason,
)
from turtlelog.measure.metric_kinds import course_metric, run_metric
from turtlelog.run.angles import subtract_headings, wrap_angle

PAPER_WINDOW_S: Final = 15.0
"""Time after the first sample at which the paper's Table 1 reads its errors [s]."""

Values = NDArray[np.float64]


_NO_BEARING: Final = add_reason(Status.ABSENT, "the goal bearing is not known")
_NO_HEADING: Final = add_reason(Status.ABSENT, "the goal has no heading")
_NO_WANTED_HEADING: Final = add_reason(Status.ABSENT, "the goal asks for no heading")


def _get_heading_error(course: Any) -> float:
    return course.heading_error_rad  # type: ignore[no-any-return]


@compiled_as(_get_heading_error)
def get_heading_error(course: RunContext) -> float:
    """Return the reference heading minus the final heading [rad]; NaN if unknown."""
    error_rad = _find_heading_error(course, None)
    return math.nan if error_rad is None else error_rad


@course_metric(
    "final.heading_error",
    "deg",
    "Magnitude of the reference heading minus the heading at the end.",
)
def measure_heading_error(course: RunContext) -> Outcome:
    """Return the magnitude of the heading error."""
    error_rad = get_heading_error(course)
    if math.isnan(error_rad):
        return math.nan, math.nan, _NO_HEADING if course.is_robot else _NO_BEARING
    return math.degrees(abs(error_rad)), course.last_pose_s, FOUND


@course_metric("final.position_error", "m", "Distance to the goal at the end.")
def measure_position_error(course: RunContext) -> Outcome:
    """Return the distance of the last pose to the goal."""
    x_m, y_m, _ = course.goal
    if math.isnan(x_m):
        return math.nan, math.nan, GOAL_UNKNOWN
    return hypot(x_m - course.x_m[-1], y_m - course.y_m[-1]), course.last_pose_s, FOUND


@course_metric(
    "final.cross_track",
    "m",
    "Distance of the last pose from the line from start to goal, positive to the left.",
    better=None,
)
def measure_last_cross_track(course: RunContext) -> Outcome:
    """Return the signed cross-track distance of the last pose."""
    offset_m = course.last_cross_track_m
    if math.isnan(offset_m):
        return math.nan, math.nan, _NO_BEARING
    return offset_m, course.last_pose_s, FOUND


@course_metric(
    "final.goal_heading_error",
    "deg",
    "Magnitude of the goal's heading minus the heading at the end.",
)
def measure_goal_heading_error(course: RunContext) -> Outcome:
    """Return the magnitude of the heading error relative to the goal's heading."""
    wanted_rad = course.goal[2]
    if math.isnan(wanted_rad):
        return math.nan, math.nan, _NO_WANTED_HEADING
    error_rad = abs(wrap_angle(wanted_rad - course.last_heading_rad))
    return math.degrees(error_rad), course.last_pose_s, FOUND


@run_metric(
    "final.heading_error_at_15s",
    "deg",
    "Heading error 15 s after the first sample, or at the end: the paper's definition.",
)
def _compute_heading_error_at_15s(context: RunContext) -> Result:
    error_rad = _find_heading_error(context, PAPER_WINDOW_S)
    if error_rad is None:
        return REASONS[_NO_HEADING if context.is_robot else _NO_BEARING]
    return _find_cut(context) or Found(math.degrees(abs(error_rad)), _tell_time(context))


@run_metric(
    "final.position_error_at_15s",
    "m",
    "Distance to the goal 15 s after the first sample, or at the end: the paper's definition.",
)
def _compute_position_error_at_15s(context: RunContext) -> Result:
    goal_xy_m, time_s = context.run.goal_xy_m, context.pose_time_s
    if goal_xy_m is None:
        return NO_GOAL
    x_m, y_m = (float(np.interp(PAPER_WINDOW_S, time_s, at)) for at in context.run.poses.xy_m.T)
    error_m = float(np.hypot(goal_xy_m[0] - x_m, goal_xy_m[1] - y_m))
    return _find_cut(context) or Found(error_m, _tell_time(context))


def _find_heading_error(context: RunContext, at_s: float | None) -> float | None:
    """Return the reference heading minus the heading [rad], in [-pi, pi)."""
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
    """Return a reference heading, linearly interpolated between rows along the shorter turn."""
    if not isinstance(reference, np.ndarray):
        return reference
    row = _find_row(time_s, at_s)
    if at_s is None or row == len(time_s) - 1:
        return float(reference[row])
    share = max((at_s - time_s[row]) / (time_s[row + 1] - time_s[row]), 0.0)
    turn_rad = subtract_headings(float(reference[row + 1]), float(reference[row]))
    return float(reference[row] + share * turn_rad)


def _find_row(time_s: Values, at_s: float | None) -> int:
    """Return the last row at or before a time; without a time, the last row of all."""
    if at_s is None:
        return len(time_s) - 1
    return max(int(np.searchsorted(time_s, at_s, side="right")) - 1, 0)


def _read_at(time_s: Values, values: Values, at_s: float | None) -> float:
    """Return a linearly interpolated value; after the end or without a time, the last value."""
    return float(values[-1]) if at_s is None else float(np.interp(at_s, time_s, values))


def _tell_time(context: RunContext) -> float:
    return min(PAPER_WINDOW_S, float(context.pose_time_s[-1]))


def _find_cut(context: RunContext) -> Missing | None:
    """Return why a run was cut off; None if it ended by itself and keeps its last value."""
    run = context.run
    length_s = (run.end_ns - run.start_ns) / 1e9
    if run.is_complete or length_s >= PAPER_WINDOW_S:
        return None
    return Missing(status=Status.TOO_SHORT, reason=f"the run was cut at {length_s:.2f} s")
