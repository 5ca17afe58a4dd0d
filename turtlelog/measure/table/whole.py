"""The metrics of a whole run: its length, its way, its distance to the goal, its commands."""

from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.loops import ControlLoop
from turtlelog.measure import path, step_response
from turtlelog.measure.context import RunContext
from turtlelog.measure.metric import NO_COMMANDS, NO_GOAL, Found, Missing, Result, Status
from turtlelog.measure.registry import loop_metric, run_metric
from turtlelog.measure.response import CommandStretch, Response, came_to_rest
from turtlelog.measure.step_response import find_largest
from turtlelog.measure.table.commands import (
    measure_effort,
    measure_largest_jump,
    measure_largest_slew_rate,
    measure_reversals,
    measure_total_variation,
)
from turtlelog.measure.table.loop_metrics import require_hold

Values = NDArray[np.float64]

NO_LINE: Final = Missing(status=Status.ABSENT, reason="the line from start to goal is not known")


@run_metric(
    "run.duration",
    "s",
    "From the first sample, or without samples the first pose, to the last row of the run.",
    is_awaited=True,
)
def _compute_duration(context: RunContext) -> Result:
    return Found(context.run.duration_s)


def _on_distance(
    compute: Callable[[RunContext, Values, Values], Result],
) -> Callable[[RunContext], Result]:
    """Compute on the distance to the goal from the first sample on."""

    def compute_on_distance(context: RunContext) -> Result:
        signal = context.get_signal("distance")
        if signal is None:
            return NO_GOAL
        first = int(np.searchsorted(signal.time_ns, context.run.start_ns))
        first = min(first, len(signal.values) - 1)
        return compute(context, context.pose_time_s[first:], signal.values[first:])

    return compute_on_distance


@run_metric(
    "run.time_to_goal",
    "s",
    "Time after which the distance stays within 2 % (or `band`) of its initial value, or within"
    " `goal_tolerance_m`.",
    is_awaited=True,
)
@_on_distance
def _compute_time_to_goal(context: RunContext, time_s: Values, distance_m: Values) -> Result:
    first_m, band = float(distance_m[0]), context.settings.band
    near_m = context.settings.goal_tolerance_m
    arrived_s = step_response.find_settling_time(
        time_s,
        distance_m,
        initial=first_m if near_m is None else 1.0,
        reference=0.0,
        band=band if near_m is None else near_m,
    )
    if arrived_s is None:
        far = f"{100.0 * band:g} % of its first distance" if near_m is None else f"{near_m:g} m"
        reason = f"the run ends further from the goal than {far}"
        return Missing(status=Status.NOT_REACHED, reason=reason)
    if not came_to_rest(context.run):
        half_width = band * first_m if near_m is None else near_m
        missing = require_hold(time_s, distance_m, arrived_s, reference=0.0, half_width=half_width)
        if missing is not None:
            return missing
    return Found(arrived_s, arrived_s)


@run_metric("run.path_length", "m", "Length of the line through all poses.", grows=True)
def _compute_length(context: RunContext) -> Result:
    return Found(context.path_length_m)


@run_metric(
    "run.straightness",
    "1",
    "Path length over the distance from first to last pose: 1 is a straight line.",
    floor=1.0,
)
def _compute_straightness(context: RunContext) -> Result:
    straightness = path.compute_straightness(context.run.poses.xy_m, context.path_length_m)
    if straightness is None:
        return Missing(status=Status.NO_MOTION, reason="the turtle ends where it began")
    return Found(straightness)


def find_largest_cross_track(context: RunContext, rows: slice) -> Result:
    """Return the largest magnitude among rows of the poses."""
    cross_track_m = context.cross_track_m
    if cross_track_m is None:
        return NO_LINE
    largest_m, row = find_largest(cross_track_m[rows])
    return Found(largest_m, float(context.pose_time_s[rows][row]))


def compute_rms_cross_track(context: RunContext, rows: slice) -> Result:
    """Return the root of the mean square over time among rows of the poses."""
    cross_track_m = context.cross_track_m
    if cross_track_m is None:
        return NO_LINE
    return Found(step_response.compute_rms(np.diff(context.pose_time_s[rows]), cross_track_m[rows]))


def _from_first_sample(
    compute: Callable[[RunContext, slice], Result],
) -> Callable[[RunContext], Result]:
    """Compute on the poses from the first sample on: time zero of the run."""

    def compute_from_first_sample(context: RunContext) -> Result:
        run = context.run
        first = int(np.searchsorted(run.poses.time_ns, run.start_ns))
        return compute(context, slice(min(first, len(run.poses) - 1), None))

    return compute_from_first_sample


run_metric(
    "run.cross_track_max",
    "m",
    "Largest distance from the line from start to goal, or from the path given.",
    grows=True,
)(_from_first_sample(find_largest_cross_track))

run_metric("run.cross_track_rms", "m", "Root of the mean square of that distance over time.")(
    _from_first_sample(compute_rms_cross_track)
)


@run_metric("run.iae", "m s", "Integral of the distance to the goal.", grows=True)
@_on_distance
def _compute_iae(_: RunContext, time_s: Values, distance_m: Values) -> Result:
    return Found(step_response.integrate(np.diff(time_s), distance_m))


@run_metric("run.ise", "m^2 s", "Integral of the square of the distance to the goal.", grows=True)
@_on_distance
def _compute_ise(_: RunContext, time_s: Values, distance_m: Values) -> Result:
    return Found(step_response.integrate_square(np.diff(time_s), distance_m))


@run_metric("run.itae", "m s^2", "Integral of time times the distance to the goal.", grows=True)
@_on_distance
def _compute_itae(_: RunContext, time_s: Values, distance_m: Values) -> Result:
    return Found(step_response.integrate_time_weighted(time_s, np.diff(time_s), distance_m))


def _on_commands(
    column: str, compute: Callable[[CommandStretch], Result]
) -> Callable[[RunContext], Result]:
    """Compute on one column of the commands as published, until the end of the run."""

    def compute_on_commands(context: RunContext) -> Result:
        if not len(context.run.commands):
            return NO_COMMANDS
        return compute(context.recall(column, lambda: _take_commands(context, column)))

    return compute_on_commands


def _take_commands(context: RunContext, column: str) -> CommandStretch:
    return CommandStretch(
        time_s=context.command_time_s,
        values=getattr(context.run.commands, column),
        wanted=None,
        limit=None,
        end_s=(context.run.end_ns - context.run.start_ns) / 1e9,
    )


def _enter_command_metrics(name: str, column: str, unit: str, square: str) -> None:
    words = name.replace("_", " ")
    for figure, of_what, compute, meaning in (
        (
            "effort",
            square,
            measure_effort,
            "Integral of the square of the published {} as it holds.",
        ),
        (
            "total_variation",
            unit,
            measure_total_variation,
            "Sum of the magnitudes of all changes of the published {}.",
        ),
        (
            "largest_jump",
            unit,
            measure_largest_jump,
            "Largest change from one published {} to the next.",
        ),
        (
            "largest_slew_rate",
            f"{unit}^2",
            measure_largest_slew_rate,
            "Largest change of the published {} over the time that it took.",
        ),
        ("reversals", "1", measure_reversals, "How often the published {} changes its sign."),
    ):
        run_metric(f"run.{name}_{figure}", of_what, meaning.format(words), grows=True)(
            _on_commands(column, compute)
        )


_enter_command_metrics("speed", "speed_m_s", "m/s", "m^2/s")
_enter_command_metrics("turn_rate", "turn_rate_rad_s", "rad/s", "rad^2/s")


def _moves_along(loop: ControlLoop) -> bool:
    """A loop that turns the turtle leaves it where it is; one that drives it may leave the line."""
    return loop.command == "speed"


@loop_metric(
    "cross_track_max",
    "m",
    "Largest distance from the line from start to goal, or from the path given.",
    grows=True,
    applies=_moves_along,
)
def _compute_cross_track_max(context: RunContext, response: Response) -> Result:
    return find_largest_cross_track(context, response.rows)


@loop_metric(
    "cross_track_rms",
    "m",
    "Root of the mean square of that distance over time.",
    applies=_moves_along,
)
def _compute_cross_track_rms(context: RunContext, response: Response) -> Result:
    return compute_rms_cross_track(context, response.rows)
