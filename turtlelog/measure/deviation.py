"""How far a response is from theory: the ideal loop, the sampled one, the sampled one with delay.

All three are the loop of an integrator under proportional feedback with the gain of the run, from
the response's own initial value to its reference, with no limit on the command:

- ideal: dy/dt = Kp (r - y), so y = r + (y0 - r) exp(-Kp t);
- sampled: the command holds for a period T: y[k+1] = y[k] + Kp T (r - y[k]);
- delayed: it is answered d samples late: y[k+1] = y[k] + Kp T (r - y[k-d]), at rest before.

Between samples a sampled loop moves along a line, for the command holds. The deviation is measured
minus theory, and the line through its values at the response's own times.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.theory import compute_sampled_step_response, compute_step_response
from turtlelog.theory.responses import LARGEST_DEVIATION

Values = NDArray[np.float64]

_ROUNDING: Final = 1e-9
"""More than adding the reference to a response can change, as a share of it."""


def compute_ideal_response(
    time_s: Values, *, kp: float, initial: float, reference: float
) -> Values:
    """Return the ideal loop at times from the start of the phase, shape (n,)."""
    return compute_step_response(kp, time_s, initial=initial, reference=reference)


def compute_sampled_response(
    time_s: Values,
    *,
    kp: float,
    period_s: float,
    dead_time_ticks: int,
    initial: float,
    reference: float,
) -> Values | None:
    """Return the sampled loop at times from the start of the phase, shape (n,).

    Its samples are at 0, T, 2 T ... from there; `dead_time_ticks` counts in them. None where the
    loop is unstable, and goes beyond `LARGEST_DEVIATION` before the last of the times.
    """
    count = int(np.ceil(time_s[-1] / period_s)) + 2
    values = compute_sampled_step_response(
        kp,
        count,
        period_s=period_s,
        dead_time_ticks=dead_time_ticks,
        initial=initial,
        reference=reference,
    )
    # Where theory stops an unstable loop, what follows is no response of that loop.
    furthest = np.abs(values[:-1] - reference).max()
    if furthest > (1.0 - _ROUNDING) * LARGEST_DEVIATION * abs(reference - initial) > 0.0:
        return None
    return np.interp(time_s, np.arange(count) * period_s, values)


def find_largest(deviation: Values) -> tuple[float, int]:
    """Return the largest magnitude [unit], and its row."""
    low, high = int(deviation.argmin()), int(deviation.argmax())
    row = low if -deviation[low] > deviation[high] else high
    return abs(float(deviation[row])), row
