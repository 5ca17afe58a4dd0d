"""The delay at which commands and motion correlate best: a second opinion that fits nothing.

A flat correlation names no one delay. So the answer is a range: the delays at which the motion
follows from the commands as well as at the best, as far as the parts of the log agree on that.
"""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
import scipy

from turtlelog.identify.axis_motion import AxisMotion
from turtlelog.identify.held_response import Values
from turtlelog.identify.repeated_commands import find_repetition
from turtlelog.identify.robot_model import Estimate

_LARGEST_S: Final = 3.0
"""The largest delay that is looked for [s]: the largest dead time and as much lag."""

_COARSE_S, _FINE_S = 0.05, 0.005
"""Between the delays that are tried [s]: first all, then those beside the best and the ends."""

_MOST_STEPS: Final = 20_000

_PART_S: Final = 1.0
"""Parts of the log so long are taken as independent of one another [s]: a usual lag has faded."""

_FEWEST_PARTS: Final = 8
"""Fewer do not tell how far they differ by chance."""

_CHANCE: Final = 0.05
"""Probability with which the range lacks the delay that is best in the long run."""

_NEAR: Final = 0.6
"""Share of Student's t from which a delay is worse than the best. What a delay leaves more grows
with the square of its distance, and how far that varies with the distance: half of t holds the best
delay in the long run. The rest is for delays far away: of 391 ranges 96.9 % held."""


def find_correlation_delay(motions: Sequence[AxisMotion]) -> tuple[Estimate | None, str]:
    """Return the delay of the motion behind the commands, as the best and a range [s].

    Commands are averaged over each step between poses, so that nothing is resampled.

    Returns:
        None, and a sentence that says why, where the correlation says nothing of a delay.
    """
    motions = [motion for motion in motions if len(motion.moved)]
    most = _MOST_STEPS // max(len(motions), 1)
    misfit = _Misfit([motion.take(slice(most)) for motion in motions])
    if misfit.parts < _FEWEST_PARTS:
        return None, (
            "the log is too short for a correlation of commands and motion, which needs"
            f" {_FEWEST_PARTS * _PART_S:g} s of motion"
        )
    if repetition := find_repetition(motions):
        shift_s, sign = repetition
        # Commands that repeat with the other sign repeat as they are after twice that time.
        period_s = shift_s if sign > 0 else 2.0 * shift_s
        return None, (
            f"the correlation of commands and motion says nothing: the commands repeat every"
            f" {period_s:.3g} s, and delays so far apart correlate alike"
        )
    coarse = np.arange(0.0, _LARGEST_S, _COARSE_S)
    near_s = float(coarse[np.argmin([misfit.measure(delay_s) for delay_s in coarse.tolist()])])
    fine = np.arange(max(near_s - _COARSE_S, 0.0), near_s + _COARSE_S, _FINE_S)
    best_s = float(fine[np.argmin([misfit.measure(delay_s) for delay_s in fine.tolist()])])
    if not misfit.is_worse(None, best_s):
        return None, "commands and motion do not clearly correlate"
    alike = [
        delay_s for delay_s in (*coarse.tolist(), best_s) if not misfit.is_worse(delay_s, best_s)
    ]
    low_s, high_s = (
        _find_end(lambda delay_s: misfit.is_worse(delay_s, best_s), end_s, step_s)
        for end_s, step_s in ((min(alike), -_FINE_S), (max(alike), _FINE_S))
    )
    usual_s = float(np.median(misfit.duration_s))
    if high_s - low_s > max(best_s, usual_s):
        return None, (
            "the correlation of commands and motion says nothing: it does not tell delays from"
            f" {1e3 * low_s:.0f} to {1e3 * high_s:.0f} ms apart"
        )
    return Estimate(value=best_s, low=low_s, high=high_s), ""


def _find_end(is_worse: Callable[[float], bool], begin_s: float, step_s: float) -> float:
    """Return the first delay from a begin on, in steps, that is worse, or the end of what is."""
    end_s = begin_s
    while 0.0 < end_s < _LARGEST_S and abs(end_s - begin_s) < _COARSE_S:
        end_s += step_s
        if is_worse(end_s):
            break
    return max(end_s, 0.0)


class _Misfit:
    """What delayed commands leave of the rates of some steps, each with the best gain and offset.

    The largest correlation leaves the least.
    """

    def __init__(self, motions: Sequence[AxisMotion]) -> None:
        self._motions = motions
        self.duration_s = np.concatenate([motion.duration_s for motion in motions])
        rate = np.concatenate([motion.moved for motion in motions]) / self.duration_s
        # A single jump must not decide.
        rate = np.clip(rate, *np.quantile(rate, [0.01, 0.99]))
        self._rate = rate - rate.mean()
        counts = [int(motion.duration_s.sum() / _PART_S) for motion in motions]
        first = np.cumsum([0, *counts])
        # What is left of a run at its end belongs to its last part.
        parts = [
            begin + np.minimum(np.cumsum(motion.duration_s) // _PART_S, max(count, 1) - 1)
            for begin, count, motion in zip(first.tolist(), counts, motions, strict=False)
        ]
        self._part = np.unique(np.concatenate(parts), return_inverse=True)[1]
        self.parts = sum(counts)
        self._squares: dict[float, Values] = {}

    def measure(self, delay_s: float) -> float:
        """Return the sum of squares that a delay leaves."""
        return float(self._list_squares(delay_s).sum())

    def is_worse(self, delay_s: float | None, best_s: float) -> bool:
        """Return whether a delay, or None without commands, leaves more but for chance.

        What it leaves more is summed up over parts of the log, which tell how far it varies.
        """
        more = self._list_squares(delay_s) - self._list_squares(best_s)
        sums = np.bincount(self._part, weights=more)
        error = float(np.std(sums, ddof=1)) * float(np.sqrt(len(sums)))
        most = float(scipy.special.stdtrit(len(sums) - 1, 1.0 - 0.5 * _CHANCE))
        return float(sums.sum()) > _NEAR * most * error

    def _list_squares(self, delay_s: float | None) -> Values:
        if delay_s is None:
            return np.asarray(self._rate**2)
        if delay_s not in self._squares:
            self._squares[delay_s] = self._leave(delay_s)
        return self._squares[delay_s]

    def _leave(self, delay_s: float) -> Values:
        asked = np.concatenate([_command_steps(motion, delay_s) for motion in self._motions])
        asked = asked / self.duration_s
        asked -= asked.mean()
        size, along = float(asked @ asked), float(asked @ self._rate)
        # A motion against the commands is no correlation.
        gain = along / size if size > 0.0 and along > 0.0 else 0.0
        return np.asarray((self._rate - gain * asked) ** 2)


def _command_steps(motion: AxisMotion, delay_s: float) -> Values:
    way = motion.commands.place(motion.time_s - delay_s).way
    return np.asarray(way[motion.first + 1] - way[motion.first])
