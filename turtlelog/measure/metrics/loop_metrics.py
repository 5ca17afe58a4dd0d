"""Metrics of a loop's response, each a function of its curve that runs plain and compiled.

Of a step: times, overshoot, settling and stability; of any error: integrals and extremes; of a
moving reference: the delay, and the overshoot at corners.
"""

import math
from typing import Final

from turtlelog.measure.loop_segment import count_answered, find_clipped
from turtlelog.measure.metric import FOUND, Outcome, Status, add_reason
from turtlelog.measure.metric_kinds import curve_metric, has_sides, has_step, step_metric
from turtlelog.measure.reductions import (
    Values,
    find_bounds,
    find_crossing_rows,
    find_furthest_between,
    find_largest,
    fold_at_zero,
    integrate,
)
from turtlelog.measure.response import Response, Track
from turtlelog.measure.step_response import (
    IRREGULAR_SWINGS,
    RESTS,
    RISE_BEGIN,
    SHORTEST_HOLD_S,
    TURN_RAD,
    compute_rms,
    find_decay_ratio,
    find_level_time,
    find_overshoot,
    find_peak_row,
    find_rise,
    find_settling_time,
    find_shift,
    find_swing_period,
    find_undershoot,
    integrate_square,
    integrate_time_weighted,
    judge_swings,
)
from turtlelog.run.loops import ControlLoop

_NEVER_HALF: Final = add_reason(Status.NOT_REACHED, "the response never reaches 50 % of the step")
_NEVER_NEAR: Final = add_reason(Status.NOT_REACHED, "the response never reaches 90 % of the step")
_BEGINS_BEYOND: Final = add_reason(
    Status.NOT_REACHED, "the response begins beyond 10 % of the step"
)
_ENDS_OUTSIDE: Final = add_reason(Status.NOT_REACHED, "the phase ends outside the {0:g} % band")
LEFT_SOON: Final = add_reason(
    Status.NOT_REACHED,
    "the response was in the band for only the last {0:.3g} s, and settling takes at least {1:.3g}"
    " s in the band",
)
_NOT_TWICE: Final = add_reason(Status.NOT_REACHED, "the response does not overshoot twice")
_ONE_ANSWER: Final = add_reason(Status.TOO_SHORT, "one pose was answered in this phase")
_UNDECIDED: Final = (
    *(FOUND, FOUND, FOUND),
    add_reason(Status.UNDETERMINED, "the phase ends as the response passes its reference"),
    add_reason(Status.NOT_REACHED, "the phase ends before the response is near its reference"),
    add_reason(
        Status.UNDETERMINED,
        "the oscillation is too short, or changes too little, to say whether it dies out",
    ),
    add_reason(Status.UNDETERMINED, IRREGULAR_SWINGS),
)
"""Reasons of the verdicts of `judge_swings` that leave the stability open."""


@curve_metric("duration", "s", "Length of the loop's segment, with its pause.", is_awaited=True)
def _find_duration(curve: Response) -> Outcome:
    return curve.time_s[-1], math.nan, FOUND


@step_metric("delay_time", "s", is_awaited=True, needs_whole=False)
def _find_delay_time(curve: Response) -> Outcome:
    """Time until the {signal} reaches 50 % of the step."""
    half_s = find_level_time(curve.time_s, curve.values, 0.5, curve.initial, curve.reference)
    if math.isnan(half_s):
        return math.nan, math.nan, _NEVER_HALF
    return half_s, curve.start_s + half_s, FOUND


@step_metric("rise_time", "s", is_awaited=True, needs_whole=False)
def _find_rise_time(curve: Response) -> Outcome:
    """Time from first reaching 10 % of the step to first reaching 90 %."""
    # The time of the metric is the end.
    if (curve.values[0] - curve.initial) / (curve.reference - curve.initial) > RISE_BEGIN:
        return math.nan, math.nan, _BEGINS_BEYOND
    begin_s, end_s = find_rise(curve.time_s, curve.values, curve.initial, curve.reference)
    if math.isnan(end_s):
        return math.nan, math.nan, _NEVER_NEAR
    return end_s - begin_s, curve.start_s + end_s, FOUND


@step_metric("peak", "{value}", better=None)
def _find_peak(curve: Response) -> Outcome:
    """Furthest value of the {signal} in the direction of the step."""
    row = find_peak_row(curve.values, curve.initial, curve.reference)
    return curve.values[row], curve.start_s + curve.time_s[row], FOUND


@step_metric("peak_time", "s", better=None, is_awaited=True)
def _find_peak_time(curve: Response) -> Outcome:
    """Time until the {signal} is at its peak."""
    row = find_peak_row(curve.values, curve.initial, curve.reference)
    return curve.time_s[row], curve.start_s + curve.time_s[row], FOUND


@step_metric(
    "overshoot",
    "%",
    "Furthest {signal} beyond the {goal}, as a share of the step; negative if the {signal} stays"
    " short.",
    floor=0.0,
    grows=True,
    applies=has_sides,
)
def _measure_overshoot(curve: Response) -> Outcome:
    """See `find_overshoot`. The time of the metric is the peak."""
    share = find_overshoot(curve.values, curve.initial, curve.reference)
    row = find_peak_row(curve.values, curve.initial, curve.reference)
    return 100.0 * share, curve.start_s + curve.time_s[row], FOUND


@step_metric(
    "undershoot",
    "%",
    "Furthest {signal} behind its initial value, as a share of the step; negative if the {signal}"
    " is always beyond that value.",
    floor=0.0,
    grows=True,
)
def _measure_undershoot(curve: Response) -> Outcome:
    share, row = find_undershoot(curve.values, curve.initial, curve.reference)
    return 100.0 * share, curve.start_s + curve.time_s[row], FOUND


@step_metric("settling_time", "s", is_awaited=True, needs_whole=False)
def _measure_settling_time(curve: Response) -> Outcome:
    """Time after which the {signal} stays within 2 % (or `band`) of the step around the {goal}."""
    # A response ended from outside must have stayed in the band.
    time_s, values, reference = curve.time_s, curve.values, curve.reference
    settled_s = find_settling_time(time_s, values, curve.initial, reference, curve.band)
    if math.isnan(settled_s):
        return 100.0 * curve.band, math.nan, _ENDS_OUTSIDE
    if not curve.ended_itself:
        half_width = curve.band * abs(reference - curve.initial)
        needed_s = find_needed_hold(time_s, values, reference, half_width)
        if time_s[-1] - settled_s < needed_s:
            return time_s[-1] - settled_s, needed_s, LEFT_SOON
    return settled_s, curve.start_s + settled_s, FOUND


def find_needed_hold(time_s: Values, values: Values, reference: float, half_width: float) -> float:
    """Return the time that a response ended from outside must stay in the band to have settled [s].

    This is at least `step_response.SHORTEST_HOLD_S` and one period of the remaining oscillation.
    """
    return max(SHORTEST_HOLD_S, find_swing_period(time_s, values, reference, half_width))


@curve_metric("crossings", "1", nature="count", grows=True, applies=has_sides)
def _count_crossings(curve: Response) -> Outcome:
    """Number of times that the {signal} passes the {goal}."""
    # The time of the metric is the first crossing.
    rows = find_crossing_rows(curve.error, 0.0, curve.memory)
    at_s = curve.start_s + curve.time_s[rows[0]] if len(rows) > 0 else math.nan
    return float(len(rows)), at_s, FOUND


@step_metric("decay_ratio", "1", needs_whole=False, applies=has_sides)
def _measure_decay_ratio(curve: Response) -> Outcome:
    """Second overshoot of the {goal} as a share of the first."""
    ratio, row = find_decay_ratio(curve.error, curve.initial, curve.reference, curve.memory)
    if math.isnan(ratio):
        return math.nan, math.nan, _NOT_TWICE
    return ratio, curve.start_s + curve.time_s[row], FOUND


@step_metric(
    "stable",
    "1",
    "1 if the oscillation of the {signal} around the {goal} dies out, 0 if it continues or grows.",
    better="higher",
    nature="verdict",
    needs_whole=False,
    applies=has_sides,
)
def _judge_stability(curve: Response) -> Outcome:
    """See `judge_swings`; poses after the last answered one are ignored."""
    error = curve.error[: count_answered(curve)]
    if len(error) < 2:
        return math.nan, math.nan, _ONE_ANSWER
    rows = find_crossing_rows(error, 0.0, curve.memory)
    most = TURN_RAD if curve.is_angle else math.inf
    verdict = judge_swings(error, rows, find_clipped(curve), most)
    if _UNDECIDED[verdict] != FOUND:
        return math.nan, math.nan, _UNDECIDED[verdict]
    return 1.0 if verdict == RESTS else 0.0, curve.start_s + curve.time_s[-1], FOUND


@curve_metric(
    "final_error",
    "{value}",
    "Magnitude of the error of the {signal} at the end.",
    nature="error",
)
def _find_final_error(curve: Response) -> Outcome:
    return abs(curve.error[-1]), curve.start_s + curve.time_s[-1], FOUND


@curve_metric("steady_state_error", "{value}", better=None, nature="error", applies=has_step)
def _find_steady_state_error(curve: Response) -> Outcome:
    """Reference minus final {signal}: positive short of the reference, negative past it."""
    direction = 1.0 if curve.reference >= curve.initial else -1.0
    return curve.error[-1] * direction, curve.start_s + curve.time_s[-1], FOUND


@curve_metric(
    "largest_error",
    "{value}",
    "Largest magnitude of {goal} minus {signal}.",
    nature="error",
    grows=True,
)
def _find_largest_error(curve: Response) -> Outcome:
    largest, row = find_largest(curve.error)
    return largest, curve.start_s + curve.time_s[row], FOUND


@curve_metric(
    "rms_error", "{value}", "Root of the mean square of the error over time.", nature="error"
)
def _compute_rms_error(curve: Response) -> Outcome:
    return compute_rms(curve.step_s, curve.error, curve.memory), math.nan, FOUND


@curve_metric("iae", "{signal} s", "Integral of the magnitude of the error.", grows=True)
def _compute_iae(curve: Response) -> Outcome:
    _, step_s, sizes = fold_at_zero(curve.time_s, curve.error, curve.memory)
    return integrate(step_s, sizes, curve.memory), math.nan, FOUND


@curve_metric("ise", "{signal}^2 s", "Integral of the square of the error.", grows=True)
def _compute_ise(curve: Response) -> Outcome:
    return integrate_square(curve.step_s, curve.error), math.nan, FOUND


@curve_metric("itae", "{signal} s^2", grows=True)
def _compute_itae(curve: Response) -> Outcome:
    """Integral of time in the segment times the magnitude of the error."""
    time_s, step_s, sizes = fold_at_zero(curve.time_s, curve.error, curve.memory)
    return integrate_time_weighted(time_s, step_s, sizes), math.nan, FOUND


_STANDS_STILL: Final = add_reason(Status.NO_STEP, "the reference does not move")
_NO_CORNER: Final = add_reason(Status.NO_STEP, "the path has no corner")
_AT_BOUND: Final = add_reason(
    Status.UNDETERMINED, "the best shift is the largest that is tried, half of the duration"
)
_NOT_PASSED: Final = add_reason(Status.NOT_REACHED, "no corner of the path was passed")

_LEAST_MOVED: Final = 1e-6
"""Motion below which a reference is at rest [rad or m]; poses are rounded to 32 bits."""

_AT_MOST: Final = 0.999
"""Share of the largest tried shift from which the best one may be larger. The search ends within
5e-9 of this shift."""

_BEYOND_M: Final = 0.1
"""Distance beyond a corner of a later lap from which the corner counts [m]. A run that ends with
its lap goes one sample beyond the next lap's first corner: 16 mm at 1 m/s."""


def _has_lag(loop: ControlLoop) -> bool:
    """Return whether the reference depends on time. The reference of a distance does not."""
    return loop.moves and loop.signal != "distance" and not _has_corners(loop)


def _has_corners(loop: ControlLoop) -> bool:
    return (loop.signal, loop.reference) == ("cross_track", "path")


@curve_metric(
    "lag",
    "s",
    "Shift of the {goal} in time that fits the {signal} best: positive where the {signal} is late.",
    floor=0.0,
    applies=_has_lag,
)
def _compute_lag(curve: Response) -> Outcome:
    reference = curve.track.reference
    if len(reference) == 0:
        return math.nan, math.nan, _STANDS_STILL
    low, high = find_bounds(reference)
    if high - low <= _LEAST_MOVED:
        return math.nan, math.nan, _STANDS_STILL
    shift_s = find_shift(curve.time_s, reference, curve.error, curve.memory)
    if abs(shift_s) >= _AT_MOST * (curve.time_s[-1] - curve.time_s[0]) / 2.0:
        return math.nan, math.nan, _AT_BOUND
    return shift_s, math.nan, FOUND


@curve_metric(
    "corner_overshoot",
    "m",
    "Largest distance past a corner on its outer side, up to half way to the next corner; negative"
    " on the inner side.",
    floor=0.0,
    grows=True,
    applies=_has_corners,
)
def _measure_corner_overshoot(curve: Response) -> Outcome:
    track = curve.track
    if len(track.corners) == 0:
        return math.nan, math.nan, _NO_CORNER
    low_m, high_m = find_bounds(track.arcs_m)
    # With a time law, the path ends after its first lap.
    to_m = 0.0 if track.has_speed else high_m - _BEYOND_M
    is_lapped = track.is_closed and to_m >= track.length_m
    last_m = max(to_m, track.length_m)
    largest_m, at_s, number = -math.inf, math.nan, 0
    while is_lapped or number < len(track.corners):
        arc_m, turn_rad, leg_m = find_corner(track, number, is_lapped)
        if is_lapped and arc_m > last_m:
            break
        number += 1
        if arc_m < low_m:
            continue
        side = -1.0 if turn_rad > 0.0 else 1.0
        end_m = arc_m + leg_m / 2.0
        row = find_furthest_between(track.arcs_m, curve.error, arc_m, end_m, -side)
        if row < 0:
            continue
        outside_m, time_s = -curve.error[row] * side, curve.time_s[row]
        if outside_m > largest_m or (outside_m == largest_m and time_s > at_s):
            largest_m, at_s = outside_m, time_s
    if math.isnan(at_s):
        return math.nan, math.nan, _NOT_PASSED
    return largest_m, curve.start_s + at_s, FOUND


def find_corner(track: Track, number: int, is_lapped: bool) -> tuple[float, float, float]:  # noqa: FBT001
    """Return arc length [m], turn [rad] and leg [m] of a corner, as `Path.list_corners` does.

    The leg leads to the next corner, or to the end of the path. If a run has more than one lap, the
    point between two laps is a corner too where the direction jumps.
    """
    if not is_lapped:
        return track.corners[number, 0], track.corners[number, 1], track.corners[number, 2]
    arc_m, turn_rad = _find_lapped(track, number)
    after_m, _ = _find_lapped(track, number + 1)
    return arc_m, turn_rad, after_m - arc_m


def _find_lapped(track: Track, number: int) -> tuple[float, float]:
    """Return arc length [m] and turn [rad] of a corner of any lap."""
    lap, place, count = 0, number, len(track.corners)
    if number >= count:
        seam = 1 if track.seam_rad != 0.0 else 0
        lap = 1 + (number - count) // (count + seam)
        place = (number - count) % (count + seam) - seam
    if place < 0:
        return lap * track.length_m, track.seam_rad
    return track.corners[place, 0] + lap * track.length_m, track.corners[place, 1]
