"""Whether the swings of a response around its reference die out, or go on.

Swings are told by their size alone: no model of the loop, no dead time and no gain is needed. Of a
linear loop they grow or decay by one factor each. A limit of the command keeps those of an unstable
loop at one size, that of its limit cycle (the describing function of saturation; K. J. Astrom and
R. M. Murray, Feedback Systems, 2nd ed., section 10.5), which may be small beside the step.
"""

import math
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

Values = NDArray[np.float64]

Verdict = Literal["rests", "swings", "away", "passing", "slow", "unknown"]

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


def judge_swings(
    error: Values, rows: NDArray[np.int64], clipped: int | None, *, most: float = math.inf
) -> Verdict:
    """Return what a response does around its reference.

    `rests`: its swings die out, or are small and do not grow. `swings`: they go on at their size,
    large or into the limit, or they grow. `away`: it ends further from the reference than it began.
    Nobody can tell where it is `passing`, and ends as it passes the reference; `slow`, and has not
    come near; `unknown`: there are too few swings, or they change too little.

    Args:
        error: Reference minus value, shape (n,), n >= 2.
        rows: Those by which it has come to the other side, as `find_crossing_rows` tells them.
        clipped: The last row at whose time the command was at its limit, -1 where it never was;
            None where nobody knows.
        most: Magnitude of an error beyond which no response counts as one that decays.
    """
    size = np.abs(error)
    largest, count = float(size.max()), len(rows) - 1
    decays = largest <= min(BEYOND * float(size[0]), most)
    rest = size[rows[-1] if len(rows) else 0 :]
    is_elsewhere = _find_rise(rest) > NEAR * largest
    if count < 2:
        return _judge_approach(size, largest, decays=decays, is_elsewhere=is_elsewhere)
    peaks = np.maximum.reduceat(size[: rows[-1]], rows[:-1])
    third = count // 3 if count >= FEWEST else 1
    begun = count - 2 * third if count >= FEWEST else 0
    before, after = peaks[begun : begun + third], peaks[count - third :]
    dying, going_on = (DYING, GOING_ON) if count >= FEWEST else (HALVED, GROWN)
    share = float(after.max() / before.max())
    is_larger = float(rest.max()) > max(float(after.max()), NEAR * largest)
    decays = decays and not is_elsewhere and not is_larger
    if decays and share < dying and _falls(before) and _falls(after):
        return "rests"
    if (clipped is not None and clipped >= rows[begun]) or after.max() >= LARGE * largest:
        return "swings" if share >= going_on else "unknown"
    # What noise leaves grows now and then; what grows by itself goes on growing.
    grew = count < FEWEST or before.max() > peaks[:third].max()
    is_small = decays and clipped is not None and not (grew and share > 1.0 / dying)
    return "rests" if is_small else "unknown"


def _falls(peaks: Values) -> bool:
    """Whether swings begin with their largest, on either side, as those do that decay."""
    return bool(peaks[:2].max() >= FALLING * peaks.max())


def _find_rise(rest: Values) -> float:
    """Return how far an error grows again behind its peak, without coming to the other side.

    What decays after its last crossing does not; what swings about something else than its
    reference does.
    """
    falling = rest[int(rest.argmax()) :]
    return float((falling - np.minimum.accumulate(falling)).max())


def _judge_approach(size: Values, largest: float, *, decays: bool, is_elsewhere: bool) -> Verdict:
    """Judge a response that swings less than twice."""
    end = float(size[-1])
    if end > NEAR * largest:
        return "away" if end == largest and end > float(size[0]) else "slow"
    if is_elsewhere:
        return "unknown"
    steps = np.abs(np.diff(size))
    return "rests" if decays and steps[-1] <= SLOWED * float(steps.max()) else "passing"
