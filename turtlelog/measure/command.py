"""Figures of a command that holds from one row to the next.

`time_s` and `values` have shape (n,), n >= 1, times not decreasing; the last value holds until
`end_s`. Commands of a burst share one time: all but the last of them hold for no time. They count
where commands are counted (variation, jumps, reversals) and not where time is (effort, saturation,
slew rate).
"""

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]
Mask = NDArray[np.bool_]


def compute_hold_times(time_s: Values, end_s: float) -> Values:
    """Return how long each value holds [s], shape (n,)."""
    return np.diff(time_s, append=max(end_s, float(time_s[-1])))


def compute_effort(held_s: Values, values: Values) -> float:
    """Return the integral of the squared command [unit^2 s]: the energy of the input signal.

    The input's term of the linear-quadratic cost (B. D. O. Anderson and J. B. Moore, Optimal
    Control). `held_s`: how long each value holds [s].
    """
    return float(np.einsum("i,i,i->", held_s, values, values))


def compute_total_variation(values: Values) -> float:
    """Return the sum of all changes' magnitudes [unit]: how much the command moves.

    TV of S. Skogestad, "Simple analytic rules for model reduction and PID controller tuning",
    J. Process Control 13 (2003).
    """
    return float(np.abs(np.diff(values)).sum())


def find_largest_jump(values: Values) -> tuple[float, int]:
    """Return the largest magnitude of a change [unit], and the row that it leads to."""
    if len(values) < 2:
        return 0.0, 0
    changes = np.abs(np.diff(values))
    row = int(changes.argmax())
    return float(changes[row]), row + 1


def find_largest_slew_rate(time_s: Values, values: Values) -> tuple[float, int] | None:
    """Return the largest change per time between held values [unit/s], and the row it leads to.

    A change counts over the time from the row before. None where no two rows differ in time.
    """
    step_s, rows = np.diff(time_s), np.arange(len(time_s))
    if not step_s.all():
        rows = np.append(np.flatnonzero(step_s), len(values) - 1)
        values, step_s = values[rows], np.diff(time_s[rows])
    if not len(step_s):
        return None
    rates = np.abs(np.diff(values)) / step_s
    row = int(rates.argmax())
    return float(rates[row]), int(rows[row + 1])


def find_longest_held(held_s: Values, mask: Mask) -> tuple[float, int] | None:
    """Return the longest time for which `mask` holds without a break [s], and its first row."""
    edges = np.flatnonzero(np.diff(mask, prepend=False, append=False))
    starts, ends = edges[::2], edges[1::2]
    if not len(starts):
        return None
    until_s = np.concatenate([[0.0], np.cumsum(held_s)])
    lengths_s = until_s[ends] - until_s[starts]
    longest = int(lengths_s.argmax())
    return float(lengths_s[longest]), int(starts[longest])


def count_reversals(values: Values) -> int:
    """Return how often the command changes its sign; zeros in between do not count."""
    turning = values[values != 0.0] > 0.0
    return int(np.count_nonzero(turning[1:] != turning[:-1]))
