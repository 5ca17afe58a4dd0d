"""Step and error metrics of a loop: from its response to a value or the reason for none."""

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from turtlelog.measure import step_response
from turtlelog.measure.context import RunContext
from turtlelog.measure.metric import Found, Missing, Result, Status
from turtlelog.measure.registry import has_sides, has_step, loop_metric
from turtlelog.measure.response import Response, Values, find_loop_samples
from turtlelog.measure.step_response import find_largest

SMALLEST_STEP: Final = 1e-6
"""What counts as a step [rad or m]: poses are published with 32 bits, so less is their rounding."""

_NO_STEP: Final = Missing(status=Status.NO_STEP, reason="the phase begins at its reference")


OfStep = Callable[[Response], Result]


def _step_metric(name: str, unit: str, meaning: str, **more: Any) -> Callable[[OfStep], OfStep]:
    """Enter a function of a response in the registry: a metric of the loops that answer a step."""

    def enter(compute: OfStep) -> OfStep:
        def compute_of_loop(_: RunContext, response: Response) -> Result:
            if abs(response.reference - response.initial) <= SMALLEST_STEP:
                return _NO_STEP
            return compute(response)

        loop_metric(name, unit, meaning, **{"applies": has_step, **more})(compute_of_loop)
        return compute

    return enter


@loop_metric("duration", "s", "Length of the stretch in which the loop acts.", is_awaited=True)
def _compute_duration(_: RunContext, response: Response) -> Result:
    return Found(float(response.time_s[-1]))


@_step_metric(
    "delay_time",
    "s",
    "Time until the {signal} reaches 50 % of the step.",
    is_awaited=True,
    needs_whole=False,
)
def _compute_delay_time(response: Response) -> Result:
    half_s = step_response.find_level_time(
        response.time_s, response.values, level=0.5, **response.step_ends
    )
    return _miss("50 %") if half_s is None else Found(half_s, response.start_s + half_s)


@_step_metric(
    "rise_time",
    "s",
    "Time from 10 % to 90 % of the step, each first reached.",
    is_awaited=True,
    needs_whole=False,
)
def _compute_rise_time(response: Response) -> Result:
    step_size = response.reference - response.initial
    if (float(response.values[0]) - response.initial) / step_size > 0.1:
        reason = "the response begins beyond 10 % of the step"
        return Missing(status=Status.NOT_REACHED, reason=reason)
    rise = step_response.find_rise(response.time_s, response.values, **response.step_ends)
    if rise is None:
        return _miss("90 %")
    return Found(rise[1] - rise[0], response.start_s + rise[1])


@_step_metric(
    "peak",
    "{value}",
    "The {signal} where it is furthest in the direction of the step.",
    better=None,
)
def _compute_peak(response: Response) -> Result:
    row = _find_peak_row(response)
    return Found(float(response.values[row]), _tell_time(response, row))


@_step_metric(
    "peak_time", "s", "Time until the {signal} is at its peak.", better=None, is_awaited=True
)
def _compute_peak_time(response: Response) -> Result:
    row = _find_peak_row(response)
    return Found(float(response.time_s[row]), _tell_time(response, row))


@_step_metric(
    "overshoot",
    "%",
    "Furthest {signal} beyond the {goal}, of the step; negative where it stays short.",
    floor=0.0,
    grows=True,
    applies=has_sides,
)
def _compute_overshoot(response: Response) -> Result:
    share = step_response.find_overshoot(response.values, **response.step_ends)
    return Found(100.0 * share, _tell_time(response, _find_peak_row(response)))


@_step_metric(
    "undershoot",
    "%",
    "Furthest {signal} behind its initial value, of the step; negative where it is never.",
    floor=0.0,
    grows=True,
)
def _compute_undershoot(response: Response) -> Result:
    share, row = step_response.find_undershoot(response.values, **response.step_ends)
    return Found(100.0 * share, _tell_time(response, row))


@_step_metric(
    "settling_time",
    "s",
    "Time after which the {signal} stays within 2 % (or `band`) of the step around the {goal}.",
    is_awaited=True,
    needs_whole=False,
)
def _compute_settling_time(response: Response) -> Result:
    time_s, values, band = response.time_s, response.values, response.band
    settled_s = step_response.find_settling_time(time_s, values, band=band, **response.step_ends)
    if settled_s is None:
        reason = f"the phase ends outside the {100.0 * band:g} % band"
        return Missing(status=Status.NOT_REACHED, reason=reason)
    if not response.ended_itself:
        reference, half_width = (
            response.reference,
            band * abs(response.reference - response.initial),
        )
        missing = require_hold(
            time_s, values, settled_s, reference=reference, half_width=half_width
        )
        if missing is not None:
            return missing
    return Found(settled_s, response.start_s + settled_s)


def require_hold(
    time_s: Values, values: Values, settled_s: float, *, reference: float, half_width: float
) -> Missing | None:
    """Return why a response that entered the band may leave it again, None where it has settled.

    Somebody else ended it: it has settled where it stayed in the band for at least
    `step_response.SHORTEST_HOLD_S`, and for a period of the oscillation that remains.
    """
    period_s = step_response.find_swing_period(
        time_s, values, reference=reference, half_width=half_width
    )
    held_s, needed_s = float(time_s[-1]) - settled_s, max(step_response.SHORTEST_HOLD_S, period_s)
    if held_s >= needed_s:
        return None
    reason = (
        f"the run was stopped {held_s:.3g} s after the response came into the band: it settles"
        f" where it stays for {needed_s:.3g} s"
    )
    return Missing(status=Status.NOT_REACHED, reason=reason)


@loop_metric(
    "crossings", "1", "How often the {signal} passes the {goal}.", grows=True, applies=has_sides
)
def _compute_crossings(_: RunContext, response: Response) -> Result:
    rows = step_response.find_crossing_rows(response.values, response.reference)
    return Found(float(len(rows)), _tell_time(response, int(rows[0])) if len(rows) else None)


@_step_metric(
    "decay_ratio",
    "1",
    "Second overshoot of the {goal} as a share of the first.",
    needs_whole=False,
    applies=has_sides,
)
def _compute_decay_ratio(response: Response) -> Result:
    found = step_response.find_decay_ratio(response.values, **response.step_ends)
    if found is None:
        reason = "the response does not overshoot twice"
        return Missing(status=Status.NOT_REACHED, reason=reason)
    return Found(found[0], _tell_time(response, found[1]))


@loop_metric(
    "stable",
    "1",
    "1 where swings of the {signal} around the {goal} die out, 0 where they go on or grow.",
    better="higher",
    needs_whole=False,
    applies=has_sides,
)
def _compute_stable(context: RunContext, response: Response) -> Result:
    from turtlelog.measure.swings import TURN_RAD, judge_swings  # not among those shown first

    error, clipped = _take_answered(context, response)
    if abs(response.reference - response.initial) <= SMALLEST_STEP:
        return _NO_STEP
    if len(error) < 2:
        return Missing(status=Status.TOO_SHORT, reason="one pose was answered in this phase")
    crossings = step_response.find_crossing_rows(error, 0.0)
    most = TURN_RAD if response.loop.signal == "heading" else math.inf
    verdict = judge_swings(error, crossings, clipped, most=most)
    if verdict in _UNTOLD:
        return _UNTOLD[verdict]
    return Found(float(verdict == "rests"), _tell_time(response))


_UNTOLD: Final = {
    "passing": Missing(
        status=Status.UNDETERMINED, reason="the phase ends as the response passes its reference"
    ),
    "slow": Missing(
        status=Status.NOT_REACHED, reason="the phase ends before the response is near its reference"
    ),
    "unknown": Missing(
        status=Status.UNDETERMINED,
        reason="the swings are too few, or change too little, to say whether they die out",
    ),
}


def _take_answered(context: RunContext, response: Response) -> tuple[Values, int | None]:
    """Return the error at the poses up to the last that was answered, and where it was clipped.

    That is the last row, from which on no command was at its limit; -1 where none was, None where
    the limit is not known. The way that a robot rolls on in a pause is not the loop's doing.
    """
    run = context.run
    rows = find_loop_samples(run, response.loop)
    answered_ns = run.samples.time_ns[rows]
    poses_ns = run.poses.time_ns[response.rows]
    error = response.error[: int(np.searchsorted(poses_ns, answered_ns[-1], side="right"))]
    saturated = response.commands.is_saturated
    if saturated is None:
        return error, None
    if not saturated.any():
        return error, -1
    last_ns = answered_ns[len(saturated) - 1 - int(saturated[::-1].argmax())]
    return error, int(np.searchsorted(poses_ns, last_ns, side="right")) - 1


def _find_peak_row(response: Response) -> int:
    return step_response.find_peak_row(response.values, **response.step_ends)


def _tell_time(response: Response, row: int = -1) -> float:
    return response.start_s + float(response.time_s[row])


def _miss(share: str) -> Missing:
    reason = f"the response never reaches {share} of the step"
    return Missing(status=Status.NOT_REACHED, reason=reason)


@loop_metric("final_error", "{value}", "Magnitude of the error of the {signal} at the end.")
def _compute_final_error(_: RunContext, response: Response) -> Result:
    return Found(abs(float(response.error[-1])), _tell_time(response))


@loop_metric(
    "steady_state_error",
    "{value}",
    "Reference minus final {signal}: positive if short of it, negative if past it.",
    better=None,
    applies=has_step,
)
def _compute_steady_state_error(_: RunContext, response: Response) -> Result:
    direction = 1.0 if response.reference >= response.initial else -1.0
    return Found(float(response.error[-1]) * direction, _tell_time(response))


@loop_metric("largest_error", "{value}", "Largest magnitude of {goal} minus {signal}.", grows=True)
def _compute_largest_error(_: RunContext, response: Response) -> Result:
    largest, row = find_largest(response.error)
    return Found(largest, _tell_time(response, row))


@loop_metric("rms_error", "{value}", "Root of the mean square over time of that error.")
def _compute_rms_error(_: RunContext, response: Response) -> Result:
    return Found(step_response.compute_rms(response.step_s, response.error))


@loop_metric("iae", "{signal} s", "Integral of the magnitude of the error.", grows=True)
def _compute_iae(_: RunContext, response: Response) -> Result:
    return Found(step_response.integrate(*response.folded_error[1:]))


@loop_metric("ise", "{signal}^2 s", "Integral of the square of the error.", grows=True)
def _compute_ise(_: RunContext, response: Response) -> Result:
    return Found(step_response.integrate_square(response.step_s, response.error))


@loop_metric(
    "itae",
    "{signal} s^2",
    "Integral of time in the stretch times the magnitude of the error.",
    grows=True,
)
def _compute_itae(_: RunContext, response: Response) -> Result:
    return Found(step_response.integrate_time_weighted(*response.folded_error))
