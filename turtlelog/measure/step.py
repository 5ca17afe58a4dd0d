"""Figures of a step response: from an initial value to a reference."""

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]


def find_overshoot(values: Values, *, initial: float, reference: float) -> float:
    """Return how far the response goes beyond the reference, as a share of the step [1].

    Signed in the direction of the step: negative where the response stays short of the reference.
    `values` has shape (n,), n >= 1; the step is not 0.
    """
    step = reference - initial
    return float(np.max((values - reference) / step))


def find_settling_time(
    time_s: Values, values: Values, *, initial: float, reference: float, band: float
) -> float | None:
    """Return the last time at which the response enters the band for good [s].

    The band is `reference` +- `band` times the step's magnitude; the crossing is interpolated
    between the rows around it. None where the last row is outside. `time_s` and `values` have
    shape (n,), times not decreasing.
    """
    half_width = band * abs(reference - initial)
    deviation = np.abs(values - reference)
    outside = np.flatnonzero(deviation > half_width)
    if not len(outside):
        return float(time_s[0])
    last = int(outside[-1])
    if last == len(values) - 1:
        return None
    signed = (values[last : last + 2] - reference) * np.sign(values[last] - reference)
    share = (signed[0] - half_width) / (signed[0] - signed[1])
    return float(time_s[last] + share * (time_s[last + 1] - time_s[last]))
