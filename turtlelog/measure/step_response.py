"""The numbers of a curve: of a step response, and integrals of an error over time.

The functions run plain and compiled, over the reductions that have a face for each. What never
happens is NaN.

A step leads from an initial value to a reference. The response is the line through its samples:
crossings are interpolated between the samples around them, and the largest value of such a line
stands at a sample. On a sampled smooth signal that leaves a crossing wrong by at most
T^2 |y''| / (8 |y'|), with T the period: nothing on a ramp, and nothing where a sample falls on the
crossing.

The definitions are those of step-response analysis (K. Ogata, Modern Control Engineering, 5th ed.,
section 5-3; D. E. Seborg et al., Process Dynamics and Control, 3rd ed., section 5.3.1), with the
step leading from any initial value to any reference. All take `values` of shape (n,), n >= 1, and
`time_s` of the same shape, not decreasing. A step downwards gives what its mirror image gives.

Integrals are exact for the line through the samples; where that changes its sign, the time of the
zero is interpolated. IAE, ISE and ITAE are those of D. Graham and R. C. Lathrop, "The synthesis of
'optimum' transient response", Trans. AIEE 72 (1953). `step_s` is the time from each row to the
next, shape (n - 1,). On a sampled smooth signal the error falls with the square of the period.
"""

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.measure.reductions import (
    add_triples,
    add_values,
    find_crossing_rows,
    find_first_beyond,
    find_furthest_row,
    find_last_outside,
    find_swing_ends,
)

Values = NDArray[np.float64]

SHORTEST_HOLD_S: Final = 1.0
"""How long a response whose recording was cut must have stayed in the band to count as settled [s].

It is the time constant of the slowest gain of the paper, 1 / s, and some 60 samples."""

SWING: Final = 0.5
"""What counts as a swing around the reference, as a share of the settling band's half-width.

Half of it, so that noise and rounding deep in the band are no oscillation."""


def find_level_time(
    time_s: Values, values: Values, level: float, initial: float, reference: float
) -> float:
    """Return the first time at which the response has come `level` of the step [s].

    `level` 0.5 is the delay time. The first row's time where it begins beyond; NaN if it never
    comes so far. The step is not 0.
    """
    step = reference - initial
    threshold = initial + level * step
    row = find_first_beyond(values, threshold, step)
    if row < 0:
        return math.nan
    return time_s[0] if row == 0 else _interpolate(time_s, values, row - 1, threshold)


def find_rise(
    time_s: Values, values: Values, initial: float, reference: float
) -> tuple[float, float]:
    """Return the first times at which the response has come 10 % and 90 % of the step [s].

    Their difference is the rise time: ln 9 tau of an exponential. NaN if it is never reached. The
    step is not 0, and the response does not begin beyond 10 % of it.
    """
    start_s = find_level_time(time_s, values, 0.1, initial, reference)
    return start_s, find_level_time(time_s, values, 0.9, initial, reference)


def find_peak_row(values: Values, initial: float, reference: float) -> int:
    """Return the first row at which the response is furthest in the direction of the step."""
    return find_furthest_row(values, 1.0 if reference >= initial else -1.0)


def find_overshoot(values: Values, initial: float, reference: float) -> float:
    """Return how far the response goes beyond the reference, as a fraction of the step [1].

    Signed in the direction of the step: negative where the response stays short of the reference.
    The step is not 0.
    """
    peak: float = values[find_peak_row(values, initial, reference)]
    return (peak - reference) / (reference - initial)


def find_undershoot(values: Values, initial: float, reference: float) -> tuple[float, int]:
    """Return how far the response goes against the step, as a share of it [1], and in which row.

    Counted from the initial value: 0 where it never goes back behind it, negative where every value
    is already on the way. The step is not 0.
    """
    row = find_furthest_row(values, -1.0 if reference >= initial else 1.0)
    return (initial - values[row]) / (reference - initial), row


def find_settling_time(
    time_s: Values, values: Values, initial: float, reference: float, band: float
) -> float:
    """Return the last time at which the response enters the band and stays in it [s].

    The band is `reference` +- `band` times the step's magnitude; the crossing is interpolated
    between the rows around it. NaN if the last row is outside. For an exponential it is ln(1 /
    band) tau, so ln 50 tau for 2 %.
    """
    half_width = band * abs(reference - initial)
    last = find_last_outside(values, reference - half_width, reference + half_width)
    if last == len(values) - 1:
        return math.nan
    if last < 0:
        return time_s[0]  # type: ignore[no-any-return]
    edge = reference + math.copysign(half_width, values[last] - reference)
    return _interpolate(time_s, values, last, edge)


def find_swing_period(time_s: Values, values: Values, reference: float, half_width: float) -> float:
    """Return the period of the oscillation around the reference, as its last two swings tell [s].

    A swing is a segment of rows further than `SWING` times the band's half-width from the
    reference, on one side; segments less than `SHORTEST_HOLD_S` apart are one. From the end of a
    swing to the end of the next is half a period where they are on opposite sides, a whole one
    where they are on one. 0 where less than two swings are over.
    """
    width = SWING * half_width
    before, last = find_swing_ends(time_s, values, reference, width, SHORTEST_HOLD_S)
    if before < 0:
        return 0.0
    between_s: float = time_s[last] - time_s[before]
    is_half = (values[before] > reference) != (values[last] > reference)
    return 2.0 * between_s if is_half else between_s


def find_decay_ratio(
    error: Values, initial: float, reference: float, memory: Any
) -> tuple[float, int]:
    """Return the second overshoot as a share of the first [1], and the row of its peak.

    exp(-2 pi zeta / sqrt(1 - zeta^2)) of a second-order response: a quarter is the classical aim of
    tuning by Ziegler and Nichols. NaN if the response does not go beyond the reference twice, or
    the recording ends on the way to the second peak.
    """
    rows = find_crossing_rows(error, 0.0, memory)
    # The error that is beyond the reference.
    direction = -1.0 if reference >= initial else 1.0
    skipped = 1 if len(rows) > 0 and error[rows[0]] * direction < 0.0 else 0
    if len(rows) < skipped + 3:
        return math.nan, -1
    begin, after, again = rows[skipped], rows[skipped + 1], rows[skipped + 2]
    end = rows[skipped + 3] if len(rows) > skipped + 3 else len(error)
    first = begin + find_furthest_row(error[begin:after], direction)
    second = again + find_furthest_row(error[again:end], direction)
    if second == len(error) - 1:
        return math.nan, -1
    return error[second] / error[first], second


def _interpolate(time_s: Values, values: Values, row: int, threshold: float) -> float:
    """Return when the line from a row to the next comes to a threshold that lies between them."""
    before, after = values[row], values[row + 1]
    share = (threshold - before) / (after - before)
    return time_s[row] + share * (time_s[row + 1] - time_s[row])  # type: ignore[no-any-return]


def integrate_square(step_s: Values, values: Values) -> float:
    """Return the integral of the signal's square [unit^2 s]: ISE of an error.

    Of a line from a to b over T: T (a^2 + a b + b^2) / 3.
    """
    before, after = values[:-1], values[1:]
    squares = add_triples(step_s, before, before)
    mixed, last = add_triples(step_s, before, after), add_triples(step_s, after, after)
    # Not by `sum`, which rounds otherwise from Python 3.12 on.
    return (squares + mixed + last) / 3.0


def integrate_time_weighted(time_s: Values, step_s: Values, values: Values) -> float:
    """Return the integral of time times signal [unit s^2]; ITAE where it is a folded error.

    Time counts from 0 of `time_s`. Of lines from t to u and from a to b: (u - t) (2 t a + t b +
    u a + 2 u b) / 6.
    """
    begin_s, end_s, before, after = time_s[:-1], time_s[1:], values[:-1], values[1:]
    same = add_triples(step_s, begin_s, before) + add_triples(step_s, end_s, after)
    mixed = add_triples(step_s, begin_s, after) + add_triples(step_s, end_s, before)
    return (2.0 * same + mixed) / 6.0


def compute_rms(step_s: Values, values: Values, memory: Any) -> float:
    """Return the root of the mean square over time [unit]; of one moment its magnitude."""
    length_s = add_values(step_s, memory)
    if length_s <= 0.0:
        return abs(values[-1])  # type: ignore[no-any-return]
    return math.sqrt(integrate_square(step_s, values) / length_s)
