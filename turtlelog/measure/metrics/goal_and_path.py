"""Metrics of a whole run: its goal and its end, duration, path, cross-track and commands."""

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy import hypot

from turtlelog.arithmetic import compiled_as
from turtlelog.measure.loop_segment import number_loop, project
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
    read_outcome,
)
from turtlelog.measure.metric_kinds import LOOP_METRICS, course_metric, loop_metric, run_metric
from turtlelog.measure.metrics.commands_and_theory import COMMAND_METRICS
from turtlelog.measure.metrics.loop_metrics import LEFT_SOON, find_needed_hold
from turtlelog.measure.reductions import (
    PIECES,
    Values,
    find_largest,
    integrate,
    measure_way,
    subtract_neighbours,
)
from turtlelog.measure.references import compute_straightness, find_last_heading_error
from turtlelog.measure.response import CommandStretch, Response, came_to_rest
from turtlelog.measure.run_context import RunContext
from turtlelog.measure.signals import find_no_commands
from turtlelog.measure.step_response import (
    compute_rms,
    find_settling_time,
    integrate_square,
    integrate_time_weighted,
)
from turtlelog.run.angles import subtract_headings, wrap_angle
from turtlelog.run.loops import ControlLoop

PAPER_WINDOW_S: Final = 15.0
"""Time after the first sample at which the paper's Table 1 reads its errors [s]."""


_NO_BEARING: Final = add_reason(Status.ABSENT, "the goal bearing is not known")
_AT_GOAL: Final = add_reason(
    Status.ABSENT,
    "the goal is where the robot starts, so no line leads to it",
)
_NO_HEADING: Final = add_reason(Status.ABSENT, "the goal has no heading")
_NO_WANTED_HEADING: Final = add_reason(Status.ABSENT, "the goal asks for no heading")


def _get_heading_error(course: Any) -> float:
    return course.heading_error_rad  # type: ignore[no-any-return]


@compiled_as(_get_heading_error)
def get_heading_error(course: RunContext) -> float:
    """Return the reference heading minus the final heading [rad]; NaN if unknown.

    Without a known reference, this is the error that the controller recorded.
    """
    run, declaration = course.run, course.run.declaration
    loops = [number_loop(declaration, loop) for loop in declaration.loops]
    error_rad = find_last_heading_error(run.samples.phase, loops, course.aim, course.last_pose)
    if not math.isnan(error_rad) or not len(run.samples):
        return error_rad
    recorded = course.get_signal("heading_error")
    return math.nan if recorded is None else float(recorded.values[-1])


@course_metric("final.heading_error", "deg", nature="error", axis="turn_rate")
def _measure_heading_error(course: RunContext) -> Outcome:
    """Magnitude of the reference heading, or the goal's for a moving bearing, minus the heading."""
    error_rad = get_heading_error(course)
    if math.isnan(error_rad):
        return math.nan, math.nan, _NO_HEADING if course.is_lawless_with_goal else _NO_BEARING
    return math.degrees(abs(error_rad)), course.last_pose_s, FOUND


@course_metric("final.position_error", "m", "Distance to the goal at the end.", nature="error")
def _measure_position_error(course: RunContext) -> Outcome:
    x_m, y_m, _ = course.goal
    if math.isnan(x_m):
        return math.nan, math.nan, GOAL_UNKNOWN
    return hypot(x_m - course.x_m[-1], y_m - course.y_m[-1]), course.last_pose_s, FOUND


@course_metric("final.cross_track", "m", better=None)
def _measure_last_cross_track(course: RunContext) -> Outcome:
    """Distance of the last pose from the line from start to goal, positive to the left."""
    offset_m = course.last_cross_track_m
    if math.isnan(offset_m):
        return math.nan, math.nan, _AT_GOAL if course.is_lawless_with_goal else _NO_BEARING
    return offset_m, course.last_pose_s, FOUND


@course_metric("final.goal_heading_error", "deg", nature="error", axis="turn_rate")
def _measure_goal_heading_error(course: RunContext) -> Outcome:
    """Magnitude of the goal's heading minus the heading at the end."""
    wanted_rad = course.goal[2]
    if math.isnan(wanted_rad):
        return math.nan, math.nan, _NO_WANTED_HEADING
    error_rad = abs(wrap_angle(wanted_rad - course.last_heading_rad))
    return math.degrees(error_rad), course.last_pose_s, FOUND


@run_metric("final.heading_error_at_15s", "deg", nature="error", axis="turn_rate")
def _compute_heading_error_at_15s(context: RunContext) -> Result:
    """Heading error 15 s after the first sample, or at the end: the paper's definition."""
    error_rad = _find_heading_error(context, PAPER_WINDOW_S)
    if error_rad is None:
        return REASONS[_NO_HEADING if context.is_lawless_with_goal else _NO_BEARING]
    return _find_cut(context) or Found(math.degrees(abs(error_rad)), _tell_time(context))


@run_metric("final.position_error_at_15s", "m", nature="error")
def _compute_position_error_at_15s(context: RunContext) -> Result:
    """Distance to the goal 15 s after the first sample, or at the end: the paper's definition."""
    goal_xy_m, time_s = context.run.goal_xy_m, context.pose_time_s
    if goal_xy_m is None:
        return NO_GOAL
    x_m, y_m = (float(np.interp(PAPER_WINDOW_S, time_s, at)) for at in context.run.poses.xy_m.T)
    error_m = float(np.hypot(goal_xy_m[0] - x_m, goal_xy_m[1] - y_m))
    return _find_cut(context) or Found(error_m, _tell_time(context))


def _find_heading_error(context: RunContext, at_s: float) -> float | None:
    """Return reference heading minus heading at a time [rad], in [-pi, pi)."""
    run, time_s, reference = context.run, context.pose_time_s, context.heading_reference_rad
    row = max(int(np.searchsorted(time_s, at_s, side="right")) - 1, 0)
    if reference is None:
        recorded = context.get_signal("heading_error")
        return None if recorded is None else float(recorded.values[row])
    signal = context.get_signal("heading")
    if signal is None or (run.declaration.loops and not len(run.samples)):
        return None
    if isinstance(reference, np.ndarray) and row == len(time_s) - 1:
        reference = float(reference[row])
    elif isinstance(reference, np.ndarray):  # between rows, along the shorter turn
        share = max((at_s - time_s[row]) / (time_s[row + 1] - time_s[row]), 0.0)
        turn_rad = subtract_headings(float(reference[row + 1]), float(reference[row]))
        reference = float(reference[row] + share * turn_rad)
    return wrap_angle(reference - float(np.interp(at_s, time_s, signal.values)))


def _tell_time(context: RunContext) -> float:
    return min(PAPER_WINDOW_S, float(context.pose_time_s[-1]))


def _find_cut(context: RunContext) -> Missing | None:
    """Return why a run was cut off; None if it ended by itself and keeps its last value."""
    run = context.run
    length_s = run.duration_s
    if run.is_complete or length_s >= PAPER_WINDOW_S:
        return None
    return Missing(Status.TOO_SHORT, f"the run was cut at {length_s:.2f} s")


_LINE_UNKNOWN: Final = add_reason(Status.ABSENT, "the line from start to goal is not known")


@course_metric("run.duration", "s", is_awaited=True, needs_poses=False)
def _measure_duration(course: RunContext) -> Outcome:
    """Time from the first sample (without samples: the first pose) to the last row."""
    return course.duration_s, math.nan, FOUND


def _on_distance(
    compute: Callable[[RunContext, Values, Values], Result],
) -> Callable[[RunContext], Result]:
    def compute_on_distance(context: RunContext) -> Result:
        signal = context.get_signal("distance")
        if signal is None:
            return NO_GOAL
        first = context.goal_row
        return compute(context, context.pose_time_s[first:], signal.values[first:])

    return compute_on_distance


@run_metric(
    "run.time_to_goal",
    "s",
    "Time after which the distance stays within 2 % (or `band`) of its initial value, or within"
    " `goal_tolerance_m`; counted from when the goal was given, if a bag shows this.",
    is_awaited=True,
)
@_on_distance
def _compute_time_to_goal(context: RunContext, time_s: Values, distance_m: Values) -> Result:
    first_m, band = float(distance_m[0]), context.settings.band
    near_m = context.settings.goal_tolerance_m
    initial_m, half_width = (first_m, band) if near_m is None else (1.0, near_m)
    arrived_s = float(find_settling_time(time_s, distance_m, initial_m, 0.0, half_width))
    if math.isnan(arrived_s):
        far = f"{100.0 * band:g} % of its first distance" if near_m is None else f"{near_m:g} m"
        return Missing(Status.NOT_REACHED, f"the run ends further from the goal than {far}")
    if not came_to_rest(context.run):
        half_width = band * first_m if near_m is None else near_m
        needed_s = find_needed_hold(time_s, distance_m, 0.0, half_width)
        held_s = float(time_s[-1]) - arrived_s
        if held_s < needed_s:
            return read_outcome((held_s, needed_s, LEFT_SOON))
    given_s = float(time_s[0]) if context.goal_row > context.first_row else 0.0
    return Found(arrived_s - given_s, arrived_s)


@course_metric("run.path_length", "m", "Length of the line through all poses.", grows=True)
def _measure_path_length(course: RunContext) -> Outcome:
    return measure_way(course.x_m, course.y_m, course.memory), math.nan, FOUND


@run_metric("run.straightness", "1", floor=1.0)
def _compute_straightness(context: RunContext) -> Result:
    """Path length divided by the distance from first to last pose: 1 for a straight line."""
    straightness = compute_straightness(context.run.poses.xy_m)
    if straightness is None:
        return Missing(Status.NO_MOTION, "the turtle ends where it began")
    return Found(straightness)


def _explain_no_line(context: RunContext) -> Missing:
    return REASONS[_AT_GOAL if context.is_lawless_with_goal else _LINE_UNKNOWN]


def _find_largest_cross_track(context: RunContext, rows: slice) -> Result:
    if not len(context.cross_track_m):
        return _explain_no_line(context)
    largest_m, row = find_largest(context.cross_track_m[rows])
    return Found(largest_m, float(context.pose_time_s[rows][row]))


def _compute_rms_cross_track(context: RunContext, rows: slice) -> Result:
    if not len(context.cross_track_m):
        return _explain_no_line(context)
    step_s = subtract_neighbours(context.pose_time_s[rows])
    return Found(float(compute_rms(step_s, context.cross_track_m[rows], None)))


def _project(course: Any) -> Values:
    if len(course.offset_m) > 0:
        return course.offset_m  # type: ignore[no-any-return]
    offset_m = course.memory.numbers[PIECES]
    for row in range(len(course.x_m)):
        offset_m[row] = project(course.x_m[row], course.y_m[row], course.aim, False)  # noqa: FBT003
    return offset_m[: len(course.x_m)]  # type: ignore[no-any-return]


@compiled_as(_project)
def _get_cross_track(course: RunContext) -> Values:
    return course.cross_track_m


def _tell_row(course: Any, row: int) -> float:
    return (row * course.period_ns - course.start_ns) / 1e9  # type: ignore[no-any-return]


@compiled_as(_tell_row)
def _tell_pose(course: RunContext, row: int) -> float:
    return float(course.pose_time_s[row])


def _get_first_row(course: Any) -> int:
    return course.first_row  # type: ignore[no-any-return]


@compiled_as(_get_first_row)
def _find_path_row(course: RunContext) -> int:
    return course.path_row


_LARGEST: Final = "Largest distance from the line from start to goal, or from the path given."
_RMS: Final = "RMS distance from the line from start to goal, or from the path given."


@course_metric("run.cross_track_max", "m", _LARGEST, grows=True)
def _measure_largest_cross_track(course: RunContext) -> Outcome:
    """Return the largest magnitude from the first sample (time zero of the run) on."""
    offset_m, first = _get_cross_track(course), _find_path_row(course)
    if len(offset_m) == 0:
        return math.nan, math.nan, _AT_GOAL if course.is_lawless_with_goal else _LINE_UNKNOWN
    largest_m, row = find_largest(offset_m[first:])
    return largest_m, _tell_pose(course, first + row), FOUND


@run_metric("run.cross_track_rms", "m", _RMS)
def _compute_rms_of_run(context: RunContext) -> Result:
    return _compute_rms_cross_track(context, slice(context.path_row, None))


@run_metric("run.iae", "m s", "Integral of the distance to the goal.", grows=True)
@_on_distance
def _compute_iae(_: RunContext, time_s: Values, distance_m: Values) -> Result:
    return Found(integrate(subtract_neighbours(time_s), distance_m, None))


@run_metric("run.ise", "m^2 s", "Integral of the square of the distance to the goal.", grows=True)
@_on_distance
def _compute_ise(_: RunContext, time_s: Values, distance_m: Values) -> Result:
    return Found(integrate_square(subtract_neighbours(time_s), distance_m))


@run_metric("run.itae", "m s^2", "Integral of time times the distance to the goal.", grows=True)
@_on_distance
def _compute_itae(_: RunContext, time_s: Values, distance_m: Values) -> Result:
    return Found(integrate_time_weighted(time_s, subtract_neighbours(time_s), distance_m))


def _on_commands(
    axis: str, column: str, compute: Callable[[CommandStretch], Result]
) -> Callable[[RunContext], Result]:
    """Compute on one column of the published commands, until the end of the run."""

    def compute_on_commands(context: RunContext) -> Result:
        if missing := find_no_commands(context.run, axis):
            return missing
        commands = CommandStretch(
            time_s=context.command_time_s,
            values=getattr(context.run.commands, column),
            wanted=None,
            limit=None,
            end_s=context.run.duration_s,
            answered_ns=context.run.commands.time_ns,
        )
        return compute(context.recall(column, lambda: commands))

    return compute_on_commands


_OF_PUBLISHED: Final = {
    "effort": "Integral of the square of the published {} over time.",
    "total_variation": "Sum of the magnitudes of all changes of the published {}.",
    "largest_jump": "Largest change from one published {} to the next.",
    "largest_slew_rate": "Largest change of the published {} per time.",
    "reversals": "Number of times that the published {} changes its sign.",
}
for _name, _column, _unit in (("speed", "speed_m_s", "m"), ("turn_rate", "turn_rate_rad_s", "rad")):
    for _figure, _meaning in _OF_PUBLISHED.items():
        run_metric(
            f"run.{_name}_{_figure}",
            LOOP_METRICS[_figure].unit.format(command=_unit),
            _meaning.format(_name.replace("_", " ")),
            axis=_name,
            needs_poses=False,
            **LOOP_METRICS[_figure].traits,
        )(_on_commands(_name, _column, COMMAND_METRICS[_figure]))


@run_metric("run.net_displacement", "m", "Distance from the first pose to the last.", better=None)
def _compute_displacement(context: RunContext) -> Result:
    xy_m = context.run.poses.xy_m
    return Found(float(np.hypot(*(xy_m[-1] - xy_m[0]))))


def _moves_along(loop: ControlLoop) -> bool:
    return loop.command == "speed"


@loop_metric("cross_track_max", "m", _LARGEST, grows=True, applies=_moves_along)
def _compute_cross_track_max(context: RunContext, response: Response) -> Result:
    return _find_largest_cross_track(context, response.rows)


@loop_metric("cross_track_rms", "m", _RMS, applies=_moves_along)
def _compute_cross_track_rms(context: RunContext, response: Response) -> Result:
    return _compute_rms_cross_track(context, response.rows)
