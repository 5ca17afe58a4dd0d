"""Rest of a robot, found in its poses, whose noise does not count as motion.

The time between two poses counts as rest if the robot moves by less than a threshold in the half
second before or after it. A rest therefore includes its beginning and end. If poses are noisy,
means of several poses are compared, over as much time as the noise needs.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.measure.metric import Missing, Status
from turtlelog.measure.rates import SpacedPoses
from turtlelog.measure.reductions import compute_median, subtract_neighbours

if TYPE_CHECKING:
    from turtlelog.measure.pose_noise import WhiteNoise

Values = NDArray[np.float64]

AT_REST_M_S: Final = 0.01
AT_REST_RAD_S: Final = 0.02
"""Rates below which a robot is at rest [m/s, rad/s]: a tenth of the 0.1 m/s and 0.2 rad/s of slow
small robots. Noise of poses of 1 mm and 2 mrad gives a third of these rates."""

_REST_S: Final = 0.5
"""Time over which rest is judged [s]. In this time the rates above give 5 mm and 0.6 deg, so that
noise of poses does not count as motion."""

_LONGEST_REST_S: Final = 5.0
"""Longest time over which rest of noisy poses is judged [s]; shorter rests are not seen then.
Beyond it, as for a receiver that scatters by 4 cm at 10 Hz, noise hides rest."""

_NOISES: Final = 3.0
"""Noise of a mean rate that must be below the threshold of rest, in standard deviations."""

_STEPS_AT_ONCE: Final = 65_536


_ENDS: Final = 5.0
"""Distance between two noisy poses that is motion, in standard deviations of their coordinates."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rest:
    """Rest of a robot.

    Attributes:
        time_s: Time at rest [s].
        seen_s: Time with poses [s].
        way_m: Distance that the robot creeps while it counts as at rest [m].
    """

    time_s: float
    seen_s: float
    way_m: float


def judge_rest(xy_m: Values, spaced: SpacedPoses, noise: "WhiteNoise | None") -> Rest | Missing:
    """Return the rest of a robot, or why it is unknown.

    `xy_m` are the positions of the spaced poses [m], shape (n, 2).
    """
    time_s, columns = spaced.time_s, (*xy_m.T, spaced.heading_rad)
    window_s = 0.0 if noise is None else _choose_window(time_s, noise)
    if noise is None or not window_s:
        is_at_rest = _find_slow_steps(time_s, columns)
    elif window_s <= _LONGEST_REST_S:
        is_at_rest = _find_slow_means(time_s, columns, max(window_s, _REST_S))
    else:
        is_at_rest = _find_slow_means(time_s, columns, _LONGEST_REST_S, noise)
        if is_at_rest.any():
            return _HIDDEN
    steps_s = subtract_neighbours(time_s)
    seen_s = float(time_s[-1] - time_s[0]) - float(steps_s[~spaced.is_seen].sum())
    is_at_rest &= spaced.is_seen
    # From where to where it moves meanwhile, without the noise of each end.
    ends = np.flatnonzero(np.diff(is_at_rest, prepend=False, append=False))
    crept_m = np.hypot(*(xy_m[ends[1::2]] - xy_m[ends[::2]]).T)
    crept_m = crept_m[crept_m > _ENDS * (0.0 if noise is None else noise.position_m)]
    return Rest(time_s=float(steps_s[is_at_rest].sum()), seen_s=seen_s, way_m=float(crept_m.sum()))


_HIDDEN: Final = Missing(Status.UNDETERMINED, "noise of the poses hides whether the robot rests")


def _estimate_rate_noise(time_s: Values, size: float, window_s: float) -> float:
    """Return the noise of a rate from means of poses in a window, in multiples of `_NOISES`."""
    # Between the means of the first and the last third of a window of n poses is a time of two
    # thirds of it, and the noise of their difference is sqrt(6 / n) times that of one pose.
    count = window_s / compute_median(subtract_neighbours(time_s))
    return float(_NOISES * np.sqrt(6.0 / count) * size / (window_s * 2.0 / 3.0))


def _choose_window(time_s: Values, noise: "WhiteNoise") -> float:
    """Return the time over which means of noisy poses show rest [s]; 0 if single poses do."""
    windows_s = [0.0]
    for size, rate in ((noise.position_m, AT_REST_M_S), (noise.heading_rad, AT_REST_RAD_S)):
        if _NOISES * np.sqrt(2.0) * size > rate * _REST_S:
            # The noise of a rate falls with the power 3/2 of the window.
            windows_s.append((_estimate_rate_noise(time_s, size, 1.0) / rate) ** (2.0 / 3.0))
    return max(windows_s)


def _find_slow_means(
    time_s: Values, columns: Sequence[Values], window_s: float, noise: "WhiteNoise | None" = None
) -> NDArray[np.bool_]:
    """Return in which steps means of the poses move by less than the threshold of rest.

    The means are those of the first and the last third of a window before or after each step. If
    noise is given, steps that it may move beyond the threshold are found, too.
    """
    most_m_s, most_rad_s = AT_REST_M_S, AT_REST_RAD_S
    if noise is not None:
        most_m_s += _estimate_rate_noise(time_s, noise.position_m, window_s)
        most_rad_s += _estimate_rate_noise(time_s, noise.heading_rad, window_s)
    sums = [np.append(0.0, np.cumsum(at - at[0])) for at in (time_s, *columns)]

    def average(begin_s: Values, end_s: Values) -> list[Values]:
        first, last = np.searchsorted(time_s, begin_s), np.searchsorted(time_s, end_s, side="right")
        count = np.maximum(last - first, 1)
        return [(total[last] - total[first]) / count for total in sums]

    found = np.zeros(len(time_s) - 1, dtype=bool)
    for first_s in (time_s[1:] - window_s, time_s[:-1]):
        begin_s = np.clip(first_s, time_s[0], max(time_s[-1] - window_s, time_s[0]))
        third_s = window_s / 3.0
        early = average(begin_s, begin_s + third_s)
        late = average(begin_s + 2.0 * third_s, begin_s + window_s)
        lasted_s, *moved = (after - before for before, after in zip(early, late, strict=True))
        is_slow = np.hypot(moved[0], moved[1]) <= most_m_s * lasted_s
        found |= is_slow & (np.abs(moved[2]) <= most_rad_s * lasted_s)
    return found


def _find_slow_steps(time_s: Values, every: Sequence[Values]) -> NDArray[np.bool_]:
    """Return in which steps the robot moves by less than the threshold of rest."""
    is_at_rest = np.zeros(len(time_s) - 1, dtype=bool)
    for first in range(0, len(is_at_rest), _STEPS_AT_ONCE):
        steps = slice(first, min(first + _STEPS_AT_ONCE, len(is_at_rest)))
        begin, end = time_s[steps.start] - _REST_S, time_s[steps.stop] + _REST_S
        low, high = np.searchsorted(time_s, (begin, end)).tolist()
        near = slice(max(low - 1, 0), high + 1)
        columns = [at[near] for at in every]
        starts_s, ends_s = time_s[:-1][steps], time_s[1:][steps]
        is_at_rest[steps] = _find_slow(starts_s, ends_s, time_s, near, columns)
    # A robot that swings is back at its place after half a second, and did not rest.
    x_m, y_m, turned_rad = (np.abs(subtract_neighbours(at)) for at in every)
    longest_s = np.maximum(subtract_neighbours(time_s), _REST_S)
    is_small = np.hypot(x_m, y_m) <= AT_REST_M_S * longest_s
    return np.asarray(is_at_rest & is_small & (turned_rad <= AT_REST_RAD_S * longest_s))


def _find_slow(
    starts_s: Values, ends_s: Values, time_s: Values, near: slice, columns: Sequence[Values]
) -> NDArray[np.bool_]:
    """Return in which steps from start to end the robot moves by less than the threshold of rest.

    `near` are the rows of the poses within half a second of the steps, plus one row on either side;
    `columns` are x, y [m] and heading [rad] of these rows.
    """
    found = np.zeros(len(starts_s), dtype=bool)
    for first_s, last_s in (
        (np.minimum(starts_s, ends_s - _REST_S), ends_s),
        (starts_s, np.maximum(ends_s, starts_s + _REST_S)),
    ):
        first_s, last_s = np.maximum(first_s, time_s[0]), np.minimum(last_s, time_s[-1])
        near_s = time_s[near]
        moved = [np.interp(last_s, near_s, at) - np.interp(first_s, near_s, at) for at in columns]
        length_s = last_s - first_s
        is_slow = np.hypot(moved[0], moved[1]) <= AT_REST_M_S * length_s
        found |= is_slow & (np.abs(moved[2]) <= AT_REST_RAD_S * length_s)
    return found
