"""Whether the swings of a response around its reference die out, or go on.

Swings are told by their size alone: no model of the loop, no dead time and no gain is needed. Of a
linear loop they grow or decay by one factor each. A limit of the command keeps those of an unstable
loop at one size, that of its limit cycle (the describing function of saturation; K. J. Astrom and
R. M. Murray, Feedback Systems, 2nd ed., section 10.5), which may be small beside the step.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.arithmetic import least
from turtlelog.measure.reductions import find_largest, find_largest_change, find_rise_behind_peak

Values = NDArray[np.float64]

VERDICTS: Final = ("rests", "swings", "away", "passing", "slow", "unknown")
"""By number."""
RESTS, SWINGS, AWAY, PASSING, SLOW, UNKNOWN = range(6)

NEVER, NOBODY_KNOWS = -1, -2
"""Instead of the last row at which a command was at its limit."""

FEWEST: Final = 6
"""Whole swings from which thirds are compared: two in each, as a loop may swing further to one side
than to the other."""

DYING: Final = 0.9
"""Swings die out where the largest of the last third is below this share of the largest of the
middle third. Those of a loop at 99.5 % of its stability gain, with a dead time of 10 ticks, decay
to 0.86 in the 30 s that the sequential laws drive for; those of limit cycles are between 0.97 and
1.01, as their peaks fall between samples."""

GOING_ON: Final = 0.98
"""Swings go on from this share on. Between the two nobody can tell: a limit cycle that is reached
from above, or a loop that decays slowly."""

FALLING: Final = 0.95
"""Swings that decay begin with their largest, but for the part of a peak that falls between
samples. Those of a heading that is turned by more than half a turn, where its error wraps, are of
any size in any order."""

HALVED: Final = 0.5
"""Fewer swings die out where the last is below this share of the first: the first swing of an
unstable loop, left over from a step that was clipped, shrinks by a few percent to its limit
cycle."""

GROWN: Final = 1.05
"""Fewer swings grow where the last is beyond this share of the first: more than peaks between
samples explain of loops with 3 samples to a swing or more: 1 - cos(pi / 6) is 0.13, but it hits
both."""

LARGE: Final = 0.1
"""Share of the largest error from which swings are large, without a limit that they run into: those
that noise leaves of a loop at rest are smaller, or the noise is what the log shows most."""

NEAR: Final = 0.02
"""A response that does not swing is near where it ends within this share of the largest error: the
usual settling band. An error that grows again by more, without coming to the other side, swings
about something else."""

SLOWED: Final = 0.5
"""It came to rest where its last step is below this share of its largest. An unstable loop passes
its reference at full speed, for it turns back too late; a tolerance may end it right there."""


BEYOND: Final = 1.2
"""Share of the error at the start up to which a response may swing to count as one that decays: a
step overshoots by 1.11 steps at most where a loop with dead time is just stable."""

TURN_RAD: Final = 2.0 * math.pi
"""Error of a heading from which nothing counts as decaying: laws wrap it at half a turn, or at the
most after one, and beyond they steer to the goal from the other side."""


def judge_swings(error: Values, rows: NDArray[np.int64], clipped: int, most: float) -> int:
    """Return what a response does around its reference, as a number of `VERDICTS`.

    `rests`: its swings die out, or are small and do not grow. `swings`: they go on at their size,
    large or into the limit, or they grow. `away`: it ends further from the reference than it began.
    Nobody can tell where it is `passing`, and ends as it passes the reference; `slow`, and has not
    come near; `unknown`: there are too few swings, or they change too little.

    Args:
        error: Reference minus value, shape (n,), n >= 2.
        rows: Those by which it has come to the other side, as `find_crossing_rows` tells them.
        clipped: The last row at whose time the command was at its limit; or `NEVER`, or
            `NOBODY_KNOWS`.
        most: Magnitude of an error beyond which no response counts as one that decays.
    """
    count, largest = len(rows) - 1, find_largest(error)[0]
    decays = largest <= least(BEYOND * abs(error[0]), most)
    rest = error[rows[count] if count >= 0 else 0 :]
    is_elsewhere = find_rise_behind_peak(rest) > NEAR * largest
    if count < 2:
        return _judge_approach(error, largest, decays, is_elsewhere)
    is_long = count >= FEWEST
    third = count // 3 if is_long else 1
    begun = count - 2 * third if is_long else 0
    last = count - third
    before, after = _find_peak(error, rows, begun, third), _find_peak(error, rows, last, third)
    share = after / before
    is_larger = find_largest(rest)[0] > max(after, NEAR * largest)
    decays = decays and not is_elsewhere and not is_larger
    # Swings begin with their largest, on either side, as those do that decay.
    falls = _find_peak(error, rows, begun, min(third, 2)) >= FALLING * before
    falls = falls and _find_peak(error, rows, last, min(third, 2)) >= FALLING * after
    if decays and falls and share < (DYING if is_long else HALVED):
        return RESTS
    if clipped >= rows[begun] or after >= LARGE * largest:
        return SWINGS if share >= (GOING_ON if is_long else GROWN) else UNKNOWN
    # What noise leaves grows now and then; what grows by itself goes on growing.
    grew = not is_long or before > _find_peak(error, rows, 0, third)
    is_growing = grew and share > 1.0 / (DYING if is_long else HALVED)
    return RESTS if decays and clipped != NOBODY_KNOWS and not is_growing else UNKNOWN


def _find_peak(error: Values, rows: NDArray[np.int64], first: int, count: int) -> float:
    """Return the largest magnitude of so many whole swings from one on."""
    return find_largest(error[rows[first] : rows[first + count]])[0]


def _judge_approach(error: Values, largest: float, decays: bool, is_elsewhere: bool) -> int:  # noqa: FBT001
    """Judge a response that swings less than twice."""
    end = abs(error[-1])
    if end > NEAR * largest:
        return AWAY if end == largest and end > abs(error[0]) else SLOW
    if is_elsewhere:
        return UNKNOWN
    last_step = abs(end - abs(error[-2]))
    return RESTS if decays and last_step <= SLOWED * find_largest_change(error) else PASSING
