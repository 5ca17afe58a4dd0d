"""The noise of steps between poses: what each pose is off, and what slips on the way.

A pose that is off makes one step too long and the next too short; slip stays. So the variance of a
step is `slip` + 2 `sensing`, and the covariance of neighbours is -`sensing`.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlelog.identify.held_response import Values

_LEAST_SLIP: Final = 1e-5
"""Slip, as a share of what poses are off, that always counts: what lies further apart than 30 poses
is not compared. No odometry keeps its place for good."""

_LONGEST: Final = 32
"""Most steps over which slip is told from the noise of poses."""

LEAST_STEP: Final = 1e-12
"""Least deviation of a step [m] or [rad]: doubles do not resolve less in poses some kilometres from
their origin. A robot without noise may leave exactly 0, which no weight can be made from."""

_EXCLUDED: Final = 1e6
"""By how much the variance of an outlier is larger: it counts no more."""

NORMAL_MAD: Final = 1.4826
"""Standard deviation of normal noise by the median of its magnitude."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StepNoise:
    """Variances.

    Attributes:
        slip: Of a step of usual duration [m^2] or [rad^2].
        sensing: Of a pose, likewise.
    """

    slip: float
    sensing: float


def estimate_noise(
    residual: Values, follows: NDArray[np.bool_], is_outlier: NDArray[np.bool_]
) -> StepNoise:
    """Return the noise that a residual shows.

    What the noise of poses adds to a way does not grow with its length; what slip adds does.
    """
    kept = np.where(is_outlier, 0.0, residual)
    total = np.concatenate([[0.0], np.cumsum(kept)])
    stretch = np.cumsum(~follows)
    lengths, variances = [], []
    length = 1
    while length <= min(_LONGEST, len(kept) // 4):
        whole = stretch[length - 1 :] == stretch[: len(stretch) - length + 1]
        ways = (total[length:] - total[:-length])[whole]
        if len(ways) > 1:
            lengths.append(length)
            variances.append(float(np.mean(ways**2)))
        length *= 2
    measured = np.maximum(variances, LEAST_STEP**2)
    terms = np.column_stack([lengths, np.full(len(lengths), 2.0)]) / measured[:, None]
    slip, sensing = scipy.optimize.nnls(terms, np.ones(len(lengths)))[0].tolist()
    return StepNoise(slip=max(slip, _LEAST_SLIP * sensing), sensing=sensing)


class Whitening:
    """Makes what a step is off independent of what its neighbours are, with a variance of 1.

    Attributes:
        noise: What it is made from.
        log_size: Logarithm of the determinant of the covariance that it takes out.
    """

    def __init__(
        self,
        noise: StepNoise,
        duration_s: Values,
        follows: NDArray[np.bool_],
        is_outlier: NDArray[np.bool_],
    ) -> None:
        """Prepare it for steps of some durations [s]."""
        self.noise = noise
        usual_s = float(np.median(duration_s))
        variance = noise.slip * duration_s / usual_s + 2.0 * noise.sensing
        variance = variance * np.where(is_outlier, _EXCLUDED, 1.0)
        beside = np.where(follows[1:], -noise.sensing, 0.0)
        bands = np.stack([variance, np.append(beside, 0.0)])
        self._factor = scipy.linalg.cholesky_banded(bands, lower=True, check_finite=False)
        self.log_size = 2.0 * float(np.log(self._factor[0]).sum())

    def apply(self, values: Values) -> Values:
        """Return values of each step, shape (n,) or (n, k), whitened."""
        solve = scipy.linalg.solve_banded
        return np.asarray(solve((1, 0), self._factor, values, check_finite=False))
