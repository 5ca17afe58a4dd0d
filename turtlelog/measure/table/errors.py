"""Error metrics of a loop: from its response to a value or the reason for none."""

from turtlelog.measure import curves
from turtlelog.measure.context import RunContext
from turtlelog.measure.integrals import find_largest
from turtlelog.measure.metric import Found, Result
from turtlelog.measure.registry import has_step, loop_metric
from turtlelog.measure.response import Response


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
