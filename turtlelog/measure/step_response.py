"""Metrics of a curve: step response, oscillation, integrals of the error, and time shift.

The functions run in ordinary Python and compiled, on the reductions of `reductions.py`. An event
that never happens is NaN.

A step leads from an initial value to a reference. The response is the line through its samples:
crossings are linearly interpolated, and the largest value is at a sample. For a smooth signal
sampled with the period T, the error of a crossing time is at most T^2 |y''| / (8 |y'|). The error
is 0 on a ramp, or if a sample is at the crossing.

The definitions are those of step-response analysis (K. Ogata, Modern Control Engineering, 5th ed.,
section 5-3; D. E. Seborg et al., Process Dynamics and Control, 3rd ed., section 5.3.1), with the
step leading from any initial value to any reference. All functions take `values` of shape (n,), n
>= 1, and `time_s` of the same shape, not decreasing. A downward step gives the same results as its
mirror image.

Integrals are exact for the line through the samples; the time of a change of sign is interpolated.
IAE, ISE and ITAE are defined as in D. Graham and R. C. Lathrop, "The synthesis of 'optimum'
transient response", Trans. AIEE 72 (1953). `step_s` is the time from each row to the next, shape (n
- 1,). On a sampled smooth signal the error falls with the square of the period.

The verdict on stability uses only the size of swings (half-oscillations), without a model, a dead
time or a gain. In a linear loop, swings grow or decay by a constant factor. A limit of the command
keeps the swings of an unstable loop at the size of its limit cycle (the describing function of
saturation; K. J. Astrom and R. M. Murray, Feedback Systems, 2nd ed., section 10.5), which may be
small compared with the step.
"""

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.arithmetic import SETTLING_BAND, compiled_as, least
from turtlelog.measure.reductions import (
    PIECES,
    Values,
    add_triples,
    add_up,
    add_values,
    compare_durations,
    find_crossing_rows,
    find_first_beyond,
    find_furthest_row,
    find_largest,
    find_largest_change,
    find_last_outside,
    find_rise_behind_peak,
    find_swing_ends,
)

RISE_BEGIN: Final = 0.1
RISE_END: Final = 0.9
"""Levels at which the rise of a response begins and ends, as fractions of the step."""

SHORTEST_HOLD_S: Final = 1.0
"""Time that a cut response must have stayed in the band to count as settled [s].

This is the time constant of the paper's smallest gain, 1 / s, and about 60 samples."""

_SWING: Final = 0.5
"""Smallest distance of a swing from the reference, as a share of the band's half-width.

Because of this distance, noise and rounding deep in the band do not count as an oscillation."""


def find_level_time(
    time_s: Values, values: Values, level: float, initial: float, reference: float
) -> float:
    """Return the first time at which the response has covered the fraction `level` of the step [s].

    A `level` of 0.5 gives the delay time. If the response starts beyond the level, the result is
    the time of the first row. The result is NaN if the level is never reached. Precondition: the
    step is not 0.
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
    """Return the first times at which the response has covered 10 % and 90 % of the step [s].

    The difference is the rise time: ln 9 tau for an exponential. A level that is never reached
    gives NaN. Precondition: the step is not 0, and the response begins below 10 % of the step.
    """
    start_s = find_level_time(time_s, values, RISE_BEGIN, initial, reference)
    return start_s, find_level_time(time_s, values, RISE_END, initial, reference)


def find_peak_row(values: Values, initial: float, reference: float) -> int:
    """Return the first row at which the response is furthest in the direction of the step."""
    return find_furthest_row(values, 1.0 if reference >= initial else -1.0)


def find_overshoot(values: Values, initial: float, reference: float) -> float:
    """Return how far the response goes beyond the reference, as a fraction of the step [1].

    The overshoot is signed in the direction of the step: negative if the response stays short of
    the reference. Precondition: the step is not 0.
    """
    peak: float = values[find_peak_row(values, initial, reference)]
    return (peak - reference) / (reference - initial)


def find_undershoot(values: Values, initial: float, reference: float) -> tuple[float, int]:
    """Return how far the response goes against the step, as a fraction of it [1], and the row.

    The undershoot is measured from the initial value. The undershoot is 0 if the response never
    goes below the initial value. It is negative if every value is beyond the initial value in the
    direction of the step. Precondition: the step is not 0.
    """
    row = find_furthest_row(values, -1.0 if reference >= initial else 1.0)
    return (initial - values[row]) / (reference - initial), row


def find_settling_time(
    time_s: Values, values: Values, initial: float, reference: float, band: float
) -> float:
    """Return the last time at which the response enters the band and stays in it [s].

    The band is `reference` +- `band` times the step's magnitude; the crossing is interpolated
    between the rows around it. The result is NaN if the last row is outside the band. For an
    exponential, the settling time is ln(1 / band) tau, or ln 50 tau for 2 %.
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
    """Return the period of the oscillation around the reference, from its last two swings [s].

    A swing is a segment of rows on one side of the reference, further away than `_SWING` times the
    band's half-width. Segments separated by less than `SHORTEST_HOLD_S` form one swing. The ends of
    two successive swings are half a period apart on opposite sides, and one period on the same
    side. The result is 0 if fewer than two swings are completed.
    """
    width = _SWING * half_width
    before, last = find_swing_ends(time_s, values, reference, width, SHORTEST_HOLD_S)
    if before < 0:
        return 0.0
    between_s: float = time_s[last] - time_s[before]
    is_half = (values[before] > reference) != (values[last] > reference)
    return 2.0 * between_s if is_half else between_s


def find_decay_ratio(
    error: Values, initial: float, reference: float, memory: Any
) -> tuple[float, int]:
    """Return the second overshoot as a fraction of the first [1], and the row of its peak.

    For a second-order response, the ratio is exp(-2 pi zeta / sqrt(1 - zeta^2)); a quarter is the
    classical target of Ziegler-Nichols tuning. The ratio is NaN if the response passes the
    reference fewer than two times, or the recording ends before the second peak.
    """
    rows = find_crossing_rows(error, 0.0, memory)
    # Sign of an error beyond the reference.
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
    """Return the time at which the line between two rows reaches a threshold."""
    before, after = values[row], values[row + 1]
    share = (threshold - before) / (after - before)
    return time_s[row] + share * (time_s[row + 1] - time_s[row])  # type: ignore[no-any-return]


def integrate_square(step_s: Values, values: Values) -> float:
    """Return the integral of the signal's square [unit^2 s]: ISE of an error.

    For a line from a to b over T: T (a^2 + a b + b^2) / 3.
    """
    before, after = values[:-1], values[1:]
    squares = add_triples(step_s, before, before)
    mixed, last = add_triples(step_s, before, after), add_triples(step_s, after, after)
    # Not `sum`, which rounds differently from Python 3.12 on.
    return (squares + mixed + last) / 3.0


def integrate_time_weighted(time_s: Values, step_s: Values, values: Values) -> float:
    """Return the integral of time times signal [unit s^2]; for a folded error this is the ITAE.

    Time counts from 0 of `time_s`. For lines from t to u and from a to b: (u - t) (2 t a + t b + u
    a + 2 u b) / 6.
    """
    begin_s, end_s, before, after = time_s[:-1], time_s[1:], values[:-1], values[1:]
    same = add_triples(step_s, begin_s, before) + add_triples(step_s, end_s, after)
    mixed = add_triples(step_s, begin_s, after) + add_triples(step_s, end_s, before)
    return (2.0 * same + mixed) / 6.0


def compute_rms(step_s: Values, values: Values, memory: Any) -> float:
    """Return the root of the mean square over time [unit]; for a single row, its magnitude."""
    length_s = add_values(step_s, memory)
    if length_s <= 0.0:
        return abs(values[-1])  # type: ignore[no-any-return]
    return math.sqrt(integrate_square(step_s, values) / length_s)


_COARSE_ROWS: Final = 400
"""Largest number of rows in the first search of a lag. Of more rows, every n-th is used: a tenth of
a second of a path of 40 s, in which a path hardly bends."""

_FINE_STEPS: Final = 40
"""Number of steps of the golden-section search for the lag. Each step leaves 0.62 of the interval,
all steps together 5e-9."""

_GOLDEN: Final = (5.0**0.5 - 1.0) / 2.0


def find_shift(time_s: Values, reference: Values, error: Values, memory: Any) -> float:
    """Return the time shift of the reference that fits the signal best in the mean square [s].

    The signal is the reference minus the error. The shift is at most half of the duration in either
    direction. The reference is constant before its beginning and after its end, so that every shift
    is judged on all rows. A periodic reference that is off by one period therefore fits worse.
    """
    every = -(-len(time_s) // _COARSE_ROWS)
    count = ((len(time_s) - 1) // every + 1) | 1
    most_s = float(time_s[-1] - time_s[0]) / 2.0
    apart_s = (most_s + most_s) / (count - 1)
    best, least = 0, math.inf
    for number in range(count):
        shift_s = _tell_shift(number, count, apart_s, most_s)
        misfit = compute_misfit(time_s, reference, error, shift_s, every, memory)
        if misfit < least:
            best, least = number, misfit
    low_s = _tell_shift(max(best - 1, 0), count, apart_s, most_s)
    high_s = _tell_shift(min(best + 1, count - 1), count, apart_s, most_s)
    # The only minimum in this interval, by golden-section search.
    first_s, second_s = high_s - _GOLDEN * (high_s - low_s), low_s + _GOLDEN * (high_s - low_s)
    first = compute_misfit(time_s, reference, error, first_s, 1, memory)
    second = compute_misfit(time_s, reference, error, second_s, 1, memory)
    for _ in range(_FINE_STEPS):
        if first <= second:
            high_s, second_s, second = second_s, first_s, first
            first_s = high_s - _GOLDEN * (high_s - low_s)
            first = compute_misfit(time_s, reference, error, first_s, 1, memory)
        else:
            low_s, first_s, first = first_s, second_s, second
            second_s = low_s + _GOLDEN * (high_s - low_s)
            second = compute_misfit(time_s, reference, error, second_s, 1, memory)
    return (low_s + high_s) / 2.0


def _tell_shift(number: int, count: int, apart_s: float, most_s: float) -> float:
    """Return one of `count` equally spaced shifts, from -`most_s` to `most_s` [s]."""
    return most_s if number == count - 1 else number * apart_s - most_s


VERDICTS: Final = ("rests", "swings", "away", "passing", "slow", "unknown", "irregular")
"""Verdicts by number."""

RESTS, SWINGS, AWAY, PASSING, SLOW, UNKNOWN, IRREGULAR = range(7)

NEVER, NOBODY_KNOWS = -1, -2
"""Values that replace the last row with a command at its limit: no such row, and unknown."""

_FEWEST: Final = 6
"""Number of whole swings from which thirds are compared: two swings per third, because a loop may
swing further to one side."""

_DYING: Final = 0.9
"""Ratio of the largest swings of the last and the middle third below which swings decay. At 99.5 %
of the stability gain and a dead time of 10 ticks, swings decay to 0.86 in the 30 s of the
sequential laws. For limit cycles the ratio is 0.97 to 1.01, because peaks fall between samples."""

_GOING_ON: Final = 0.98
"""Ratio from which swings persist. Between the two ratios the verdict is undecided: a limit cycle
reached from above, or a slow decay."""

_FALLING: Final = 0.95
"""Ratio of the first swing to the largest from which swings decay; peaks may fall between samples.
If a heading turns by more than half a turn, its error wraps, and the swings have any size in any
order."""

_HALVED: Final = 0.5
"""Ratio of the last to the first of few swings below which the swings decay. In an unstable loop
after a clipped step, the first swing shrinks only by a few percent to the limit cycle."""

_GROWN: Final = 1.05
"""Ratio of the last to the first of few swings above which the swings grow. With at least 3 samples
per swing, peaks between samples explain less: 1 - cos(pi / 6) is 0.13, but it affects both
swings."""

IRREGULAR_SWINGS: Final = (
    "the swings go on irregularly, as by noise or random disturbances, which hide whether the loop"
    " is stable"
)
"""Reason of the verdict `irregular`."""

_REGULAR: Final = 0.8
"""Ratio of the durations of successive swings to one side, the shorter by the longer, from which
swings are an oscillation of the loop. It is 0.9 to 1 for simulated limit cycles and growing swings,
and at most 0.75 for stable loops that outliers, sensor noise or disturbances move. Unstable loops
with a heading noise of 0.02 to 0.1 rad have smaller ratios, too: such swings prove nothing."""

_LARGE: Final = 0.1
"""Share of the largest error from which swings are large, if no limit is known. Noise of a loop at
rest is smaller, unless the log is mostly noise."""

_NEAR: Final = SETTLING_BAND
"""Share of the largest error within which a response without swings is near its end. If the
error grows by more without a crossing, the response oscillates around another value."""

_SLOWED: Final = 0.5
"""Ratio of the last to the largest step below which a response came to rest. An unstable loop
passes its reference at full speed, because it reverses too late; a tolerance may end it exactly
there."""

_BEYOND: Final = 1.2
"""Ratio of a swing to the initial error up to which a response may decay: at the stability limit of
a loop with dead time, a step overshoots by at most 1.11 steps."""

TURN_RAD: Final = 2.0 * math.pi
"""Heading error from which no response counts as decaying [rad]. Laws wrap the error at half a
turn, or at the latest after one turn, and then steer to the goal from the other side."""


def judge_swings(error: Values, rows: NDArray[np.int64], clipped: int, most: float) -> int:
    """Return the verdict on a response around its reference, as an index into `VERDICTS`.

    `rests`: the swings die out, or are small and do not grow. `swings`: the oscillation grows, or
    keeps an amplitude that is large or reaches the limit. `away`: the response ends further from
    the reference than it began. Four verdicts are undecided. `passing`: the response ends while it
    passes the reference. `slow`: the response has not come near the reference. `unknown`: the
    swings are too few or change too little. `irregular`: the swings go on, but their durations
    differ as by noise or random disturbances, in a stable or an unstable loop. The durations of a
    heading that turned by more than `most` differ anyway, because its error wraps.

    Args:
        error: Reference minus value, shape (n,), n >= 2.
        rows: Rows of the crossings, as from `find_crossing_rows`.
        clipped: Last row at whose time the command was at its limit, or `NEVER`, or `NOBODY_KNOWS`.
        most: Magnitude of an error above which no response counts as decaying.
    """
    count, largest = len(rows) - 1, find_largest(error)[0]
    decays = largest <= least(_BEYOND * abs(error[0]), most)
    rest = error[rows[count] if count >= 0 else 0 :]
    is_elsewhere = find_rise_behind_peak(rest) > _NEAR * largest
    if count < 2:
        return _judge_approach(error, largest, decays, is_elsewhere)
    is_long = count >= _FEWEST
    third = count // 3 if is_long else 1
    begun = count - 2 * third if is_long else 0
    last = count - third
    before, after = _find_peak(error, rows, begun, third), _find_peak(error, rows, last, third)
    share = after / before
    is_larger = find_largest(rest)[0] > max(after, _NEAR * largest)
    decays = decays and not is_elsewhere and not is_larger
    # Decaying swings begin with the largest, on either side.
    falls = _find_peak(error, rows, begun, min(third, 2)) >= _FALLING * before
    falls = falls and _find_peak(error, rows, last, min(third, 2)) >= _FALLING * after
    if decays and falls and share < (_DYING if is_long else _HALVED):
        return RESTS
    if clipped >= rows[begun] or after >= _LARGE * largest:
        if share < (_GOING_ON if is_long else _GROWN):
            return UNKNOWN
        is_regular = compare_durations(rows, begun) >= _REGULAR
        return SWINGS if is_regular or largest > most else IRREGULAR
    # Noise grows occasionally; an unstable oscillation grows continuously.
    grew = not is_long or before > _find_peak(error, rows, 0, third)
    is_growing = grew and share > 1.0 / (_DYING if is_long else _HALVED)
    return RESTS if decays and clipped != NOBODY_KNOWS and not is_growing else UNKNOWN


def _find_peak(error: Values, rows: NDArray[np.int64], first: int, count: int) -> float:
    """Return the largest magnitude in a given number of whole swings, from a given swing on."""
    return find_largest(error[rows[first] : rows[first + count]])[0]


def _judge_approach(error: Values, largest: float, decays: bool, is_elsewhere: bool) -> int:  # noqa: FBT001
    """Return the verdict on a response with fewer than two swings."""
    end = abs(error[-1])
    if end > _NEAR * largest:
        return AWAY if end == largest and end > abs(error[0]) else SLOW
    if is_elsewhere:
        return UNKNOWN
    last_step = abs(end - abs(error[-2]))
    return RESTS if decays and last_step <= _SLOWED * find_largest_change(error) else PASSING


def _compute_misfit(
    time_s: Any, reference: Any, error: Any, shift_s: float, every: int, memory: Any
) -> float:
    pieces, count = memory.numbers[PIECES], (len(time_s) - 1) // every + 1
    after = 0
    for place in range(count):
        row = place * every
        at_s = time_s[row] - shift_s
        while after < count and time_s[after * every] <= at_s:
            after += 1
        end, begin = after * every, (after - 1) * every
        if after == 0:
            fitted = reference[0]
        elif after == count or time_s[begin] == at_s:
            fitted = reference[begin]
        else:
            slope = (reference[end] - reference[begin]) / (time_s[end] - time_s[begin])
            fitted = slope * (at_s - time_s[begin]) + reference[begin]
        off = reference[row] - error[row] - fitted
        pieces[place] = off * off
    return add_up(pieces, count) / count


@compiled_as(_compute_misfit)
def compute_misfit(
    time_s: Values,
    reference: Values,
    error: Values,
    shift_s: float,
    every: int,
    memory: Any,  # noqa: ARG001
) -> float:
    """Return the mean square of the signal minus the shifted reference, on every n-th row.

    The signal is the reference minus the error; between rows the reference is a line.
    """
    time_s, reference, error = time_s[::every], reference[::every], error[::every]
    fitted = np.interp(time_s - shift_s, time_s, reference)
    return float(np.mean((reference - error - fitted) ** 2))
