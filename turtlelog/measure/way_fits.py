"""What errors of single steps leave of a whole way; whether coarse poses or a lag leave as much."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.measure.motion import LoopMotion, Values

CERTAIN: Final = 10.0
"""Difference of log-likelihoods from which the better of two fits counts as found: the other is
20,000 times less likely. Where rows are not quite independent, 5 would still be 150 times."""

_LAG_APART: Final = 0.25
_LAG_OFFSETS: Final = np.arange(-0.5, 1.01, _LAG_APART)
"""Dead time and lag together are tried up to so many ticks off the best dead time alone [ticks]."""

_LAG_ROUNDS: Final = 6
"""Halvings of the distance between the lags that are tried: down to a 256th of a tick."""

_LEAST_LAG: Final = 0.01
"""A shorter lag is none [ticks]: after one tick nothing of it is left in a double."""

COARSE: Final = 1.25
"""Steps of rounding that the right fit leaves at most: one, and what its offset is off."""

LIKE_THE_BEST: Final = 1.1
"""Where noise comes on top, by how much more than the best the right fit leaves at most."""

_TINY: Final = 1e-300


def is_within_steps(spans: Values, best: int, grain: float) -> NDArray[np.bool_]:
    """Return which fits leave no more than the coarse steps of poses make, or than the best does.

    What rounding leaves is no noise: neighbours share it, and its squares tell nothing.

    Args:
        spans: From the least to the largest that each fit leaves [rad or m].
        best: Row of the best.
        grain: Coarse step [rad or m]; 0: there is none, and the best stands alone.
    """
    if not grain:
        return np.asarray(np.arange(len(spans)) == best)
    most = max(COARSE * grain, LIKE_THE_BEST * float(spans[best]))
    return np.asarray(spans <= most)


def fit_way(motion: LoopMotion, errors: Values, rows: NDArray[np.int64]) -> tuple[Values, Values]:
    """Return what errors of steps leave of the way, and its root mean square, one row for each."""
    with np.errstate(over="ignore", invalid="ignore"):
        drift = np.cumsum(errors, axis=1)[:, rows]
        left = _remove_offsets(drift, motion.tick[rows], motion.step_ticks)
        return left, np.nan_to_num(np.sqrt(np.mean(left**2, axis=1)), nan=np.inf)


@dataclass(frozen=True, slots=True, kw_only=True)
class LagFits:
    """Whether a dead time with a lag explains a motion that a longer dead time alone fits best.

    Attributes:
        least_ticks: The smallest dead time that fits as well, with some lag.
        is_better: Whether one of them clearly fits better.
    """

    least_ticks: int
    is_better: bool


def find_lags(
    motion: LoopMotion, errors: Values, rows: NDArray[np.int64], best: int, size: float
) -> LagFits:
    """Return which shorter dead times explain a motion with a lag.

    Args:
        motion: Of a loop.
        errors: What each dead time leaves of each step, shape (dead times, steps).
        rows: Steps that count.
        best: The dead time that fits best alone [ticks].
        size: What that leaves [rad or m].
    """
    predicted = motion.moved - errors
    gained = np.empty(best + 1)
    is_alike = np.zeros(best + 1, dtype=bool)
    for ticks in range(best + 1):
        left = _fit_lag(motion, predicted[ticks], rows, best - ticks)
        its_size = max(float(np.sqrt(np.mean(left**2))), _TINY)
        gained[ticks] = len(rows) * np.log(max(size, _TINY) / its_size)
        is_alike[ticks] = np.ptp(left) <= COARSE * motion.grain
    is_alike |= gained > -CERTAIN
    is_alike[best] = True
    return LagFits(least_ticks=int(np.argmax(is_alike)), is_better=bool(gained.max() > CERTAIN))


def _fit_lag(
    motion: LoopMotion, predicted: Values, rows: NDArray[np.int64], near_ticks: int
) -> Values:
    """Return what predicted steps leave of the way with the best lag near one [ticks]."""
    tried: dict[float, Values] = {}

    def measure(lag_ticks: float) -> float:
        if lag_ticks not in tried:
            steps = _lag_steps(motion, predicted, lag_ticks)
            tried[lag_ticks] = fit_way(motion, (motion.moved - steps)[None], rows)[0][0]
        return float(np.mean(tried[lag_ticks] ** 2))

    offsets = near_ticks + _LAG_OFFSETS
    best = min(offsets[offsets > 0.0].tolist(), key=measure)
    apart = _LAG_APART
    for _ in range(_LAG_ROUNDS):
        apart *= 0.5
        best = min((max(best + apart * way, _LEAST_LAG) for way in (-1.0, 0.0, 1.0)), key=measure)
    return tried[best]


def _lag_steps(motion: LoopMotion, predicted: Values, lag_ticks: float) -> Values:
    """Return predicted steps as a first-order lag makes them, in closed form for held commands."""
    from scipy.signal import lfilter

    lag = lag_ticks / motion.step_ticks
    kept = float(np.exp(-1.0 / lag))
    now, before = 1.0 - lag * (1.0 - kept), lag * (1.0 - kept) - kept
    bounds = np.flatnonzero(np.diff(motion.tick) > motion.step_ticks) + 1
    parts = np.split(predicted, bounds)
    return np.concatenate([lfilter([now, before], [1.0, -kept], part) for part in parts])


def _remove_offsets(drift: Values, tick: NDArray[np.int64], step_ticks: int) -> Values:
    """Subtract the mean of each stretch without a gap; where it begins is not known exactly."""
    bounds = np.flatnonzero(np.diff(tick) > step_ticks) + 1
    parts = np.split(drift, bounds, axis=1)
    return np.concatenate([part - part.mean(axis=1, keepdims=True) for part in parts], axis=1)
