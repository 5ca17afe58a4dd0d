"""The delay at which commands and motion correlate best: a second opinion that fits nothing."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from turtlelog.identify.axis_motion import AxisMotion
from turtlelog.identify.held_response import Values

_LARGEST_S: Final = 3.0
"""The largest delay that is looked for [s]: the largest dead time and as much lag."""

_COARSE_S, _FINE_S = 0.05, 0.005
"""Between the delays that are tried [s]: first all, then those beside the best."""

_MOST_STEPS: Final = 20_000


def find_correlation_delay(motions: Sequence[AxisMotion]) -> float | None:
    """Return the delay of the motion behind the commands [s]; None where nothing correlates.

    Commands are averaged over each step between poses, so that nothing is resampled.
    """
    motions = [motion for motion in motions if len(motion.moved)]
    most = _MOST_STEPS // max(len(motions), 1)
    motions = [motion.take(slice(most)) for motion in motions]
    duration_s = np.concatenate([motion.duration_s for motion in motions])
    rate = np.concatenate([motion.moved for motion in motions]) / duration_s
    # A single jump must not decide.
    rate = np.clip(rate, *np.quantile(rate, [0.01, 0.99]))

    def correlate(delay_s: float) -> float:
        commanded = np.concatenate([_command_steps(motion, delay_s) for motion in motions])
        return _correlate(commanded / duration_s, rate)

    coarse = np.arange(0.0, _LARGEST_S, _COARSE_S)
    best_s = float(coarse[np.argmax([correlate(delay_s) for delay_s in coarse.tolist()])])
    fine = np.arange(max(best_s - _COARSE_S, 0.0), best_s + _COARSE_S, _FINE_S)
    found = np.array([correlate(delay_s) for delay_s in fine.tolist()])
    return float(fine[found.argmax()]) if found.max() > 0.0 else None


def _command_steps(motion: AxisMotion, delay_s: float) -> Values:
    way = motion.commands.place(motion.time_s - delay_s).way
    return np.asarray(way[motion.first + 1] - way[motion.first])


def _correlate(one: Values, other: Values) -> float:
    one, other = one - one.mean(), other - other.mean()
    size = float(np.sqrt((one @ one) * (other @ other)))
    return float(one @ other) / size if size > 0.0 else 0.0
