"""The numbers of a curve: of a step response, and integrals of an error over time.

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

from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.measure.sums import sum_products

Values = NDArray[np.float64]

SHORTEST_HOLD_S: Final = 1.0
"""How long a response whose recording was cut must have stayed in the band to count as settled [s].

It is the time constant of the slowest gain of the paper, 1 / s, and some 60 samples."""

SWING: Final = 0.5
"""What counts as a swing around the reference, as a share of the settling band's half-width.

Half of it, so that noise and rounding deep in the band are no oscillation."""


def find_level_time(
    time_s: Values, values: Values, *, level: float, initial: float, reference: float
) -> float | None:
    """Return the first time at which the response has come `level` of the step [s].

    `level` 0.5 is the delay time. The first row's time where it begins beyond; None where it never
    comes so far. The step is not 0.
    """
    step = reference - initial
    threshold = initial + level * step
    reached = values >= threshold if step > 0.0 else values <= threshold
    row = int(reached.argmax())
    if not reached[row]:
        return None
    return float(time_s[0]) if row == 0 else _interpolate(time_s, values, row - 1, threshold)


def find_rise(
    time_s: Values, values: Values, *, initial: float, reference: float
) -> tuple[float, float] | None:
    """Return the first times at which the response has come 10 % and 90 % of the step [s].

    Their difference is the rise time: ln 9 tau of an exponential. None where 90 % is never reached.
    The step is not 0, and the response does not begin beyond 10 % of it.
    """
    start_s, end_s = (
        find_level_time(time_s, values, level=level, initial=initial, reference=reference)
        for level in (0.1, 0.9)
    )
    return None if start_s is None or end_s is None else (start_s, end_s)


def find_peak_row(values: Values, *, initial: float, reference: float) -> int:
    """Return the first row at which the response is furthest in the direction of the step."""
    return int(values.argmax() if reference >= initial else values.argmin())


def find_overshoot(values: Values, *, initial: float, reference: float) -> float:
    """Return how far the response goes beyond the reference, as a share of the step [1].

    Signed in the direction of the step: negative where the response stays short of the reference.
    The step is not 0.
    """
    row = find_peak_row(values, initial=initial, reference=reference)
    return float((values[row] - reference) / (reference - initial))


def find_undershoot(values: Values, *, initial: float, reference: float) -> tuple[float, int]:
    """Return how far the response goes against the step, as a share of it [1], and in which row.

    Counted from the initial value: 0 where it never goes back behind it, negative where every value
    is already on the way. The step is not 0.
    """
    row = int(values.argmin() if reference >= initial else values.argmax())
    return float((initial - values[row]) / (reference - initial)), row


def find_settling_time(
    time_s: Values, values: Values, *, initial: float, reference: float, band: float
) -> float | None:
    """Return the last time at which the response enters the band for good [s].

    The band is `reference` +- `band` times the step's magnitude; the crossing is interpolated
    between the rows around it. None where the last row is outside. Of an exponential: ln(1 / band)
    tau, so ln 50 tau for 2 %.
    """
    half_width = band * abs(reference - initial)
    outside = (values > reference + half_width) | (values < reference - half_width)
    last = len(values) - 1 - int(outside[::-1].argmax())
    if not outside[last]:
        return float(time_s[0])
    if last == len(values) - 1:
        return None
    edge = reference + np.copysign(half_width, values[last] - reference)
    return _interpolate(time_s, values, last, float(edge))


def find_swing_period(
    time_s: Values, values: Values, *, reference: float, half_width: float
) -> float:
    """Return the period of the oscillation around the reference, as its last two swings tell [s].

    A swing is a stretch of rows further than `SWING` times the band's half-width from the
    reference, on one side; stretches less than `SHORTEST_HOLD_S` apart are one. From the end of a
    swing to the end of the next is half a period where they are on opposite sides, a whole one
    where they are on one. 0 where less than two swings are over.
    """
    error = values - reference
    rows = np.flatnonzero(np.abs(error) > SWING * half_width)
    side = error[rows] > 0.0
    is_away = (np.diff(rows) > 1) & (np.diff(time_s[rows]) >= SHORTEST_HOLD_S)
    is_last = np.append(is_away | (side[1:] != side[:-1]), True)[: len(rows)]
    # One that the recording ends in is not over.
    over = np.flatnonzero(is_last & (rows < len(values) - 1))
    if len(over) < 2:
        return 0.0
    before, last = over[-2:]
    between_s = float(time_s[rows[last]] - time_s[rows[before]])
    return between_s if side[last] == side[before] else 2.0 * between_s


def find_crossing_rows(values: Values, reference: float) -> NDArray[np.int64]:
    """Return the rows by which the response has come to the other side of the reference.

    Touching the reference is no crossing, standing on it for a while and going on is one.
    """
    beyond, short = values > reference, values < reference
    rows = np.flatnonzero(beyond | short)
    side = beyond[rows]
    return np.asarray(rows[1:][side[1:] != side[:-1]])


def find_decay_ratio(
    values: Values, *, initial: float, reference: float
) -> tuple[float, int] | None:
    """Return the second overshoot as a share of the first [1], and the row of its peak.

    exp(-2 pi zeta / sqrt(1 - zeta^2)) of a second-order response: a quarter is the classical aim of
    tuning by Ziegler and Nichols. None where the response does not go beyond the reference twice,
    or the recording ends on the way to the second peak.
    """
    rows = find_crossing_rows(values, reference)
    direction = 1.0 if reference >= initial else -1.0
    ahead = (values[rows] - reference) * direction > 0.0
    rows = rows[int(not ahead[0]) :] if len(rows) else rows
    if len(rows) < 3:
        return None
    ends = [*rows.tolist(), len(values)]
    first, second = ((values[ends[i] : ends[i + 1]] - reference) * direction for i in (0, 2))
    peak = int(second.argmax())
    if ends[2] + peak == len(values) - 1:
        return None
    return float(second[peak] / first.max()), ends[2] + peak


def _interpolate(time_s: Values, values: Values, row: int, threshold: float) -> float:
    """Return when the line from a row to the next comes to a threshold that lies between them."""
    before, after = float(values[row]), float(values[row + 1])
    share = (threshold - before) / (after - before)
    return float(time_s[row] + share * (time_s[row + 1] - time_s[row]))


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
    # By `sum`, whose order of adding up the compiled batch of `sweep` follows.
    return float((step_s * (values[:-1] + values[1:])).sum()) / 2.0


def integrate_square(step_s: Values, values: Values) -> float:
    """Return the integral of the signal's square [unit^2 s]: ISE of an error.

    Of a line from a to b over T: T (a^2 + a b + b^2) / 3.
    """
    before, after = values[:-1], values[1:]
    squares = sum_products(step_s, before, before)
    mixed, last = sum_products(step_s, before, after), sum_products(step_s, after, after)
    # Not by `sum`, which rounds otherwise from Python 3.12 on.
    return (squares + mixed + last) / 3.0


def integrate_time_weighted(time_s: Values, step_s: Values, values: Values) -> float:
    """Return the integral of time times signal [unit s^2]; ITAE where it is a folded error.

    Time counts from 0 of `time_s`. Of lines from t to u and from a to b: (u - t) (2 t a + t b +
    u a + 2 u b) / 6.
    """
    begin_s, end_s, before, after = time_s[:-1], time_s[1:], values[:-1], values[1:]
    same = sum_products(step_s, begin_s, before) + sum_products(step_s, end_s, after)
    mixed = sum_products(step_s, begin_s, after) + sum_products(step_s, end_s, before)
    return (2.0 * same + mixed) / 6.0


def compute_rms(step_s: Values, values: Values) -> float:
    """Return the root of the mean square over time [unit]; of one moment its magnitude."""
    length_s = float(step_s.sum())
    if length_s <= 0.0:
        return float(np.abs(values[-1]))
    return float(np.sqrt(integrate_square(step_s, values) / length_s))


def find_largest(deviation: Values) -> tuple[float, int]:
    """Return the largest magnitude [unit], and its row."""
    low, high = int(deviation.argmin()), int(deviation.argmax())
    row = low if -deviation[low] > deviation[high] else high
    return abs(float(deviation[row])), row
