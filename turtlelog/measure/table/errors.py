"""Error metrics of a phase: from its response to a value or the reason for none."""

from turtlelog.measure import integrals
from turtlelog.measure.deviation import find_largest
from turtlelog.measure.metric import Found, Result
from turtlelog.measure.phases import Response


def compute_final_error(response: Response) -> Result:
    """Magnitude of the error in the last row."""
    return Found(abs(float(response.error[-1])), _tell_end(response))


def compute_steady_state_error(response: Response) -> Result:
    """The last row's error, positive where the response has stayed short of its reference."""
    direction = 1.0 if response.reference >= response.initial else -1.0
    return Found(float(response.error[-1]) * direction, _tell_end(response))


def compute_largest_error(response: Response) -> Result:
    """The largest magnitude; at the start where nothing overshoots by more than the step."""
    largest, row = find_largest(response.error)
    return Found(largest, response.start_s + float(response.time_s[row]))


def compute_rms_error(response: Response) -> Result:
    """See `integrals.compute_rms`."""
    return Found(integrals.compute_rms(response.step_s, response.error))


def compute_iae(response: Response) -> Result:
    """See `integrals.integrate`."""
    return Found(integrals.integrate(*response.folded_error[1:]))


def compute_ise(response: Response) -> Result:
    """See `integrals.integrate_square`."""
    return Found(integrals.integrate_square(response.step_s, response.error))


def compute_itae(response: Response) -> Result:
    """See `integrals.integrate_time_weighted`."""
    return Found(integrals.integrate_time_weighted(*response.folded_error))


def _tell_end(response: Response) -> float:
    return response.start_s + float(response.time_s[-1])
