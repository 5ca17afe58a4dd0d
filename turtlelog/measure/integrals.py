"""Integrals of a signal over time, exact for the line through its samples.

IAE, ISE and ITAE are those of D. Graham and R. C. Lathrop, "The synthesis of 'optimum' transient
response", Trans. AIEE 72 (1953). Between samples the signal is a line; where it changes its sign,
so does the line, at a time that is interpolated. `time_s` and `values` have shape (n,), n >= 1,
times not decreasing; `step_s` is the time from each row to the next, shape (n - 1,). On a sampled
smooth signal the error falls with the square of the period.
"""

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]


def fold_at_zero(time_s: Values, values: Values) -> tuple[Values, Values]:
    """Return times and magnitudes of the signal, a row added wherever it passes through 0."""
    changes = np.flatnonzero((values[:-1] < 0.0) != (values[1:] < 0.0))
    changes = changes[(values[changes] != 0.0) & (values[changes + 1] != 0.0)]
    magnitude = np.abs(values)
    if not len(changes):
        return time_s, magnitude
    before, after = magnitude[changes], magnitude[changes + 1]
    share = before / (before + after)
    zero_s = time_s[changes] + share * (time_s[changes + 1] - time_s[changes])
    return np.insert(time_s, changes + 1, zero_s), np.insert(magnitude, changes + 1, 0.0)


def integrate(step_s: Values, values: Values) -> float:
    """Return the integral of the signal [unit s]; IAE where it is a folded error."""
    return float(np.dot(step_s, values[:-1]) + np.dot(step_s, values[1:])) / 2.0


def integrate_square(step_s: Values, values: Values) -> float:
    """Return the integral of the signal's square [unit^2 s]: ISE of an error.

    Of a line from a to b over T: T (a^2 + a b + b^2) / 3.
    """
    before, after = values[:-1], values[1:]
    pairs = ((before, before), (before, after), (after, after))
    return sum(_sum_products(step_s, *pair) for pair in pairs) / 3.0


def integrate_time_weighted(time_s: Values, step_s: Values, values: Values) -> float:
    """Return the integral of time times signal [unit s^2]; ITAE where it is a folded error.

    Time counts from 0 of `time_s`. Of lines from t to u and from a to b: (u - t) (2 t a + t b +
    u a + 2 u b) / 6.
    """
    begin_s, end_s, before, after = time_s[:-1], time_s[1:], values[:-1], values[1:]
    same = _sum_products(step_s, begin_s, before) + _sum_products(step_s, end_s, after)
    mixed = _sum_products(step_s, begin_s, after) + _sum_products(step_s, end_s, before)
    return (2.0 * same + mixed) / 6.0


def compute_rms(step_s: Values, values: Values) -> float:
    """Return the root of the mean square over time [unit]; of one moment its magnitude."""
    length_s = float(step_s.sum())
    if length_s <= 0.0:
        return float(np.abs(values[-1]))
    return float(np.sqrt(integrate_square(step_s, values) / length_s))


def _sum_products(step_s: Values, first: Values, second: Values) -> float:
    # Nothing is laid out in memory on the way: long signals are measured at the speed of reading.
    return float(np.einsum("i,i,i->", step_s, first, second))


def find_largest(deviation: Values) -> tuple[float, int]:
    """Return the largest magnitude [unit], and its row."""
    low, high = int(deviation.argmin()), int(deviation.argmax())
    row = low if -deviation[low] > deviation[high] else high
    return abs(float(deviation[row])), row
