"""Step and error metrics of a loop: from its response to a value or the reason for none."""

from typing import Final

from turtlelog.measure import curves
from turtlelog.measure.context import RunContext
from turtlelog.measure.curves import find_largest
from turtlelog.measure.metric import Found, Missing, Result, Status
from turtlelog.measure.registry import has_sides, has_step, loop_metric
from turtlelog.measure.response import Response, Values

SMALLEST_STEP: Final = 1e-6
"""What counts as a step [rad or m]: poses are published with 32 bits, so less is their rounding."""

_NO_STEP: Final = Missing(status=Status.NO_STEP, reason="the phase begins at its reference")


@loop_metric("duration", "s", "Length of the stretch in which the loop acts.", is_awaited=True)
def compute_duration(_: RunContext, response: Response) -> Result:
    """From the start of the phase to its last pose."""
    return Found(float(response.time_s[-1]))


@loop_metric(
    "delay_time",
    "s",
    "Time until the {signal} has come half of the step.",
    is_awaited=True,
    needs_whole=False,
    applies=has_step,
)
def compute_delay_time(_: RunContext, response: Response) -> Result:
    """See `curves.find_level_time`, at 50 %."""
    if _has_no_step(response):
        return _NO_STEP
    half_s = curves.find_level_time(
        response.time_s,
        response.values,
        level=0.5,
        initial=response.initial,
        reference=response.reference,
    )
    return _miss("half") if half_s is None else Found(half_s, response.start_s + half_s)


@loop_metric(
    "rise_time",
    "s",
    "Time from 10 % to 90 % of the step, each first reached.",
    is_awaited=True,
    needs_whole=False,
    applies=has_step,
)
def compute_rise_time(_: RunContext, response: Response) -> Result:
    """See `curves.find_rise`; taken at its end."""
    if _has_no_step(response):
        return _NO_STEP
    if _begins_beyond(response, 0.1):
        return Missing(
            status=Status.NOT_REACHED, reason="the response begins beyond 10 % of the step"
        )
    rise = curves.find_rise(
        response.time_s, response.values, initial=response.initial, reference=response.reference
    )
    if rise is None:
        return _miss("90 %")
    return Found(rise[1] - rise[0], response.start_s + rise[1])


@loop_metric(
    "peak",
    "{value}",
    "The {signal} where it is furthest in the direction of the step.",
    better=None,
    applies=has_step,
)
def compute_peak(_: RunContext, response: Response) -> Result:
    """See `curves.find_peak_row`."""
    if _has_no_step(response):
        return _NO_STEP
    row = _find_peak_row(response)
    return Found(float(response.values[row]), _tell_time(response, row))


@loop_metric(
    "peak_time",
    "s",
    "Time until the {signal} is at its peak.",
    better=None,
    is_awaited=True,
    applies=has_step,
)
def compute_peak_time(_: RunContext, response: Response) -> Result:
    """See `curves.find_peak_row`."""
    if _has_no_step(response):
        return _NO_STEP
    row = _find_peak_row(response)
    return Found(float(response.time_s[row]), _tell_time(response, row))


@loop_metric(
    "overshoot",
    "%",
    "Furthest {signal} beyond the {goal}, of the step; negative where it stays short.",
    floor=0.0,
    grows=True,
    applies=has_sides,
)
def compute_overshoot(_: RunContext, response: Response) -> Result:
    """See `curves.find_overshoot`."""
    if _has_no_step(response):
        return _NO_STEP
    share = curves.find_overshoot(
        response.values, initial=response.initial, reference=response.reference
    )
    return Found(100.0 * share, _tell_time(response, _find_peak_row(response)))


@loop_metric(
    "undershoot",
    "%",
    "Furthest {signal} back behind the initial value, of the step; negative where it is never.",
    floor=0.0,
    grows=True,
    applies=has_step,
)
def compute_undershoot(_: RunContext, response: Response) -> Result:
    """See `curves.find_undershoot`."""
    if _has_no_step(response):
        return _NO_STEP
    share, row = curves.find_undershoot(
        response.values, initial=response.initial, reference=response.reference
    )
    return Found(100.0 * share, _tell_time(response, row))


@loop_metric(
    "settling_time",
    "s",
    "Last time the {signal} enters the band around the {goal}: 2 % of the step, or as asked.",
    is_awaited=True,
    needs_whole=False,
    applies=has_step,
)
def compute_settling_time(_: RunContext, response: Response) -> Result:
    """See `curves.find_settling_time`; where the law did not end the phase, `require_hold`."""
    if _has_no_step(response):
        return _NO_STEP
    settled_s = curves.find_settling_time(
        response.time_s,
        response.values,
        initial=response.initial,
        reference=response.reference,
        band=response.band,
    )
    if settled_s is None:
        reason = f"the phase ends outside the {100.0 * response.band:g} % band"
        return Missing(status=Status.NOT_REACHED, reason=reason)
    if not response.ended_itself:
        half_width = response.band * abs(response.reference - response.initial)
        missing = require_hold(
            response.time_s,
            response.values,
            settled_s,
            reference=response.reference,
            half_width=half_width,
        )
        if missing is not None:
            return missing
    return Found(settled_s, response.start_s + settled_s)


def require_hold(
    time_s: Values, values: Values, settled_s: float, *, reference: float, half_width: float
) -> Missing | None:
    """Return why a response that entered the band may leave it again, None where it has settled.

    Somebody else ended it: it has settled where it stayed in the band for at least
    `curves.SHORTEST_HOLD_S`, and for a period of the oscillation that remains.
    """
    period_s = curves.find_swing_period(time_s, values, reference=reference, half_width=half_width)
    held_s, needed_s = float(time_s[-1]) - settled_s, max(curves.SHORTEST_HOLD_S, period_s)
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
def compute_crossings(_: RunContext, response: Response) -> Result:
    """See `curves.find_crossing_rows`; taken at the first."""
    rows = curves.find_crossing_rows(response.values, response.reference)
    return Found(float(len(rows)), _tell_time(response, int(rows[0])) if len(rows) else None)


@loop_metric(
    "decay_ratio",
    "1",
    "Second overshoot of the {goal} as a share of the first.",
    needs_whole=False,
    applies=has_sides,
)
def compute_decay_ratio(_: RunContext, response: Response) -> Result:
    """See `curves.find_decay_ratio`; taken at the second peak."""
    if _has_no_step(response):
        return _NO_STEP
    found = curves.find_decay_ratio(
        response.values, initial=response.initial, reference=response.reference
    )
    if found is None:
        reason = "the response does not overshoot twice"
        return Missing(status=Status.NOT_REACHED, reason=reason)
    return Found(found[0], _tell_time(response, found[1]))


def _has_no_step(response: Response) -> bool:
    return abs(response.reference - response.initial) <= SMALLEST_STEP


def _begins_beyond(response: Response, level: float) -> bool:
    step_size = response.reference - response.initial
    return (float(response.values[0]) - response.initial) / step_size > level


def _find_peak_row(response: Response) -> int:
    return curves.find_peak_row(
        response.values, initial=response.initial, reference=response.reference
    )


def _tell_time(response: Response, row: int) -> float:
    return response.start_s + float(response.time_s[row])


def _miss(share: str) -> Missing:
    return Missing(
        status=Status.NOT_REACHED, reason=f"the response does not come {share} of the step"
    )


@loop_metric("final_error", "{value}", "Magnitude of the error of the {signal} at the end.")
def compute_final_error(_: RunContext, response: Response) -> Result:
    """Magnitude of the error in the last row."""
    return Found(abs(float(response.error[-1])), _tell_end(response))


@loop_metric(
    "steady_state_error",
    "{value}",
    "What the {signal} lacks of the {goal} at the end, in the direction of the step; negative"
    " beyond.",
    better=None,
    applies=has_step,
)
def compute_steady_state_error(_: RunContext, response: Response) -> Result:
    """The last row's error, positive where the response has stayed short of its reference."""
    direction = 1.0 if response.reference >= response.initial else -1.0
    return Found(float(response.error[-1]) * direction, _tell_end(response))


@loop_metric("largest_error", "{value}", "Largest magnitude of {goal} minus {signal}.", grows=True)
def compute_largest_error(_: RunContext, response: Response) -> Result:
    """The largest magnitude; at the start where nothing overshoots by more than the step."""
    largest, row = find_largest(response.error)
    return Found(largest, response.start_s + float(response.time_s[row]))


@loop_metric("rms_error", "{value}", "Root of the mean square over time of that error.")
def compute_rms_error(_: RunContext, response: Response) -> Result:
    """See `curves.compute_rms`."""
    return Found(curves.compute_rms(response.step_s, response.error))


@loop_metric("iae", "{signal} s", "Integral of the magnitude of the error.", grows=True)
def compute_iae(_: RunContext, response: Response) -> Result:
    """See `curves.integrate`."""
    return Found(curves.integrate(*response.folded_error[1:]))


@loop_metric("ise", "{signal}^2 s", "Integral of the square of the error.", grows=True)
def compute_ise(_: RunContext, response: Response) -> Result:
    """See `curves.integrate_square`."""
    return Found(curves.integrate_square(response.step_s, response.error))


@loop_metric(
    "itae",
    "{signal} s^2",
    "Integral of time in the stretch times the magnitude of the error.",
    grows=True,
)
def compute_itae(_: RunContext, response: Response) -> Result:
    """See `curves.integrate_time_weighted`."""
    return Found(curves.integrate_time_weighted(*response.folded_error))


def _tell_end(response: Response) -> float:
    return response.start_s + float(response.time_s[-1])
