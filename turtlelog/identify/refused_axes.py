"""Reasons why commands and motion do not identify an axis, advice, and a second estimate.

The second estimate uses no model: it is the delay with the largest correlation of commands and
motion. A flat correlation gives no single delay. Therefore the result is a range: the delays that
explain the motion as well as the best delay, within the differences between parts of the log.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import scipy

from turtlelog.display import describe_count
from turtlelog.identify.axis_fit import DEAD_TIME, LAG, AxisFit, NoGainError, fit_axis
from turtlelog.identify.axis_motion import (
    LARGEST_DEAD_TIME_S,
    NAMES,
    OTHER,
    STANDING,
    UNITS,
    Axis,
    AxisMotion,
    get_commands,
)
from turtlelog.identify.fit_values import describe_fit
from turtlelog.identify.held_response import COUPLED, Values
from turtlelog.identify.robot_model import AxisModel, Estimate
from turtlelog.run import Run

_OPPOSITE_EXPLAINS: Final = 0.5
"""Smallest explained share of the variance for which a negative gain is reported; below it, a
positive gain may be wrong. A robot that turns the wrong way explains nearly all; another robot's
commands, or an echo of a period, explain little."""

_OPPOSITE_CLEARLY: Final = 30.0
"""Smallest advantage of the negative gain in twice the negative log-likelihood. If both signs were
equally likely, chance would reach it in 1 of a million robots."""

_SUDDEN_S: Final = 0.1
"""Time within which a change of the command counts as one step [s]: a usual robot's delay."""

_SUDDEN_SHARE: Final = 0.05
"""Share of the range of commands that must change within this time; slower changes are ramps. A
ramp over the range then takes more than 2 s, and shows no start."""

_FEWEST_MOVING: Final = 6
"""Smallest number of steps in which commands move the robot: up to five may be one jump, which
follows any command with some gain."""

_ENDLESS: Final = 10.0
"""Multiple of a value above which the end of its interval is not printed: it is as good as none,
and its digits are rounding."""

_ABSURD: Final = 1e9
"""Largest plausible command or step of a robot [m/s], [rad/s], [m] or [rad]: light needs 3 s for
it. Larger values come from bytes that are not numbers."""

_NEGLIGIBLE: Final = 1e-9
"""Value below which commands do not move a robot [m/s] or [rad/s]: a millimetre in twelve days."""

_OPPOSITE_WHY: Final[Mapping[Axis, str]] = {
    "speed": "its front and its back may be swapped",
    "turn_rate": "its left and its right motor may be swapped",
}


def find_no_excitation(runs: Sequence[Run], axis: Axis) -> str:
    """Return the reason why the commands of runs cannot identify an axis; empty if they can."""
    name = NAMES[axis]
    commands = [get_commands(run, axis) for run in runs]
    if not any(len(command) for command in commands):
        return "no commands were recorded"
    if not any(command.any() for command in commands):
        return f"the {name} is never commanded"
    fastest = max(float(np.abs(command).max(initial=0.0)) for command in commands)
    if fastest < _NEGLIGIBLE:
        return f"the commanded {name} is at most {fastest:.2g} {UNITS[axis]}, which moves nothing"
    if not any(np.diff(command).any() for command in commands):
        return f"the commanded {name} never changes"
    largest = max(_find_sudden(run, axis) for run in runs)
    both = np.concatenate([*commands, np.zeros(1)])
    span = float(np.ptp(both))
    if largest < _SUDDEN_SHARE * span:
        return (
            f"the {name} is commanded in ramps: within {_SUDDEN_S:g} s it changes by at most"
            f" {largest:.2g} of {span:.2g} {UNITS[axis]}"
        )
    return ""


def find_absurd(runs: Sequence[Run], motions: Sequence[AxisMotion], axis: Axis) -> str:
    """Return the implausible value of an axis as text; empty if there is none."""
    unit = UNITS[axis]
    columns = (
        ("commands", unit, [get_commands(run, axis) for run in runs]),
        ("steps between poses", unit.removesuffix("/s"), [motion.moved for motion in motions]),
    )
    for what, its_unit, values in columns:
        largest = max((float(np.abs(value).max()) for value in values if len(value)), default=0.0)
        if largest > _ABSURD:
            return f"the {what} reach {largest:.3g} {its_unit}, more than any robot does"
    return ""


def _find_sudden(run: Run, axis: Axis) -> float:
    command, time_ns = get_commands(run, axis), run.commands.time_ns
    if not len(command):
        return 0.0
    held = np.searchsorted(time_ns, time_ns - round(_SUDDEN_S * 1e9), side="right") - 1
    return float(np.abs(command - command[np.maximum(held, 0)]).max())


def refuse_axis(axis: Axis, reason: str) -> AxisModel:
    """Return an axis without values."""
    advice = f"step the {NAMES[axis]} ten times for 2 s"
    if reason.startswith("no commands"):
        advice = f"record the topic of the commands beside the poses, and {advice}"
    return AxisModel(axis=axis, status="not_identifiable", reason=reason, advice=advice)


def refuse_fit(
    axis: Axis, motions: Sequence[AxisMotion], fit: AxisFit, found: AxisModel
) -> AxisModel | None:
    """Return an axis without values if a fit does not identify it, with the reason; else None."""
    opposite = None
    reason = _find_doubt(found, fit)
    if reason or found.explained is None or found.explained < _OPPOSITE_EXPLAINS:
        opposite = find_opposite(axis, motions, fit)
    repetition = None if reason or opposite else find_repetition(motions)
    if repetition is not None:
        reason, is_opposite = _tell_twin(fit, *repetition)
        opposite = find_opposite(axis, motions, None) if is_opposite else None
    if opposite or not reason:
        return opposite
    refused = refuse_axis(axis, reason)
    if found.gain is None or found.bound is None or not _is_wide(found.gain):
        return refused
    # Commands at the bound show no gain: any larger one leads there, too.
    most = found.bound.value / found.gain.value
    how = f"also to less than {most:.2g} {UNITS[axis]}"
    if found.bound_acts in COUPLED:
        how = f"while the {NAMES[OTHER[axis]]} rests"
    return replace(refused, advice=f"{refused.advice}, {how}")


def find_opposite(
    axis: Axis, motions: Sequence[AxisMotion], fit: AxisFit | None
) -> AxisModel | None:
    """Return an axis without values if the robot moves in the opposite direction; else None."""
    try:
        other = fit_axis([replace(motion, moved=-motion.moved) for motion in motions])
    except NoGainError:
        return None
    found = describe_fit(axis, other, 0)
    explains = found.explained is not None and found.explained >= _OPPOSITE_EXPLAINS
    if not explains or _find_doubt(found, other):
        return None
    if fit is not None and fit.badness - other.badness < _OPPOSITE_CLEARLY:
        return None
    gain = found.gain
    told = "" if gain is None else f"{-gain.value:.3f} ({-gain.high:.3f} to {-gain.low:.3f})"
    dead_time_s, lag_s = other.parameters[[DEAD_TIME, LAG]].tolist()
    name, why = NAMES[axis], _OPPOSITE_WHY[axis]
    return AxisModel(
        axis=axis,
        status="not_identifiable",
        reason=(
            f"the {name} follows its commands with the opposite sign: gain {told}, dead time"
            f" {dead_time_s:.3f} s, lag {lag_s:.3f} s"
        ),
        advice=f"reverse the sign of the {name}, in the robot's driver or in the commands: {why}",
    )


def _find_doubt(found: AxisModel, fit: AxisFit) -> str:
    """Return why fitted values are invalid. A delay within one step is well known."""
    if fit.parameters[DEAD_TIME] >= LARGEST_DEAD_TIME_S:
        return (
            f"the best dead time is the largest that is tried, {LARGEST_DEAD_TIME_S:g} s:"
            " commands and poses may have different clocks, or the commands change too slowly"
        )
    if found.explained is None or found.explained <= 0.0:
        return (
            "the commands explain nothing of how the motion changes: are they this robot's, and of"
            " the clock of its poses?"
        )
    size = np.abs(fit.model.moved - fit.residual) / fit.model.duration_s
    moving = int(np.count_nonzero(size > STANDING * size.max()))
    if moving < _FEWEST_MOVING:
        count = describe_count(moving, "step")
        return f"commands act in only {count} of {len(size)} between poses, which may be a jump"
    return _find_wide(found, float(np.median(fit.model.duration_s)))


def refuse_wide(found: AxisModel, how: str) -> AxisModel | None:
    """Return an axis without values if an interval is wider than its value; else None.

    `how` says how else to drive, to know it.
    """
    reason = _find_wide(found, 0.0)
    if not reason:
        return None
    refused = refuse_axis(found.axis, reason)
    return replace(refused, advice=f"{refused.advice}, {how}")


def _find_wide(found: AxisModel, fine_s: float) -> str:
    """Return which interval of an axis is wider than its value; empty if none is."""
    for name, value, fine in (
        ("gain", found.gain, 0.0),
        ("total delay", found.total_delay_s, fine_s),
    ):
        if value is not None and _is_wide(value, fine):
            unit = "" if value.unit == "1" else f" {value.unit}"
            most = _ENDLESS * value.value
            high = f"more than {most:.3g}" if value.high > most else f"{value.high:.3g}"
            return (
                f"the interval of the {name}, {value.low:.3g} to {high}{unit}, is wider than its"
                f" value of {value.value:.3g}{unit}"
            )
    return ""


def _is_wide(value: Estimate, fine: float = 0.0) -> bool:
    return value.high - value.low > max(value.value, fine)


_SAMPLE_S: Final = 0.01  # sampling time for the comparison of commands with earlier ones [s]
_MOST_S: Final = 120.0  # length of each run that is compared [s]

_ALIKE: Final = 0.8
"""Correlation from which commands repeat: a switch that is 5 % of a period early or late reduces
the correlation to this value. The motion decides whether another delay explains as much."""

_DIPS: Final = 0.5
"""Correlation below which commands must fall before they count as repeated, because slow commands
resemble the commands shortly before."""

_DIFFERS: Final = 0.25
"""Smallest difference of two models in a decisive step, as a share of the largest step."""

_FEWEST: Final = 3  # smallest number of decisive steps; fewer steps may be jumps

_BETTER: Final = 0.5
"""Largest error of the right model in these steps, as a share of the other model's error."""


def find_repetition(motions: Sequence[AxisMotion]) -> tuple[float, int] | None:
    """Return the time after which commands repeat [s], and their sign; None if they do not repeat.

    Only times up to the largest dead time count, because a later repetition causes no ambiguity.
    """
    moving = [motion for motion in motions if len(motion.moved) and motion.commands.value.any()]
    commands = [_sample(motion) for motion in moving]
    if not any(map(len, commands)):
        return None
    mean = float(np.concatenate(commands).mean())
    lags = np.arange(1, round(LARGEST_DEAD_TIME_S / _SAMPLE_S) + 1)
    plain = np.array([_correlate(commands, 0.0, lag) for lag in lags.tolist()])
    centred = np.array([_correlate(commands, mean, lag) for lag in lags.tolist()])
    has_dipped = np.maximum.accumulate(centred < _DIPS)
    # Mean values of opposite sign go the other way.
    for alike, sign in ((-plain, -1), (np.where(has_dipped, centred, 0.0), 1)):
        if alike.max() >= _ALIKE:
            begin = int(np.argmax(alike >= _ALIKE))
            length = int(np.argmin(np.append(alike[begin:], -1.0) >= _ALIKE))
            best = begin + int(np.argmax(alike[begin : begin + length]))
            return float(lags[best]) * _SAMPLE_S, sign
    return None


def _tell_twin(fit: AxisFit, shift_s: float, sign: int) -> tuple[str, bool]:
    """Return why a dead time is ambiguous, and whether the other sign explains the motion better.

    The reason is empty if the motion resolves the ambiguity.
    """
    gain, dead_time_s, lag_s, *extra = fit.parameters.tolist()
    count = int(LARGEST_DEAD_TIME_S / shift_s) + 1
    for number in range(-count, count + 1):
        other_s, its_sign = dead_time_s + number * shift_s, sign**number
        if not number or not 0.0 <= other_s < LARGEST_DEAD_TIME_S:
            continue
        ratio = _compare(fit, np.array([its_sign * gain, other_s, lag_s, *extra]))
        if ratio is not None and ratio <= _BETTER:
            continue
        how = f"repeat every {shift_s:.3g} s" + (" with the other sign" if sign < 0 else "")
        reason = (
            f"the commands {how}, so gains of {gain:.3g} with a dead time of {dead_time_s:.3g} s"
            f" and {its_sign * gain:.3g} with {other_s:.3g} s explain the motion alike"
        )
        return reason, its_sign < 0 and ratio is not None and ratio >= 1.0 / _BETTER
    return "", False


def _sample(motion: AxisMotion) -> Values:
    """Return held commands at equal times, from the first nonzero one to the end of the last."""
    time_s, value = motion.commands.time_s, motion.commands.value
    moving = np.flatnonzero(value)
    ends_s = np.append(time_s[1:], motion.time_s[-1])
    begin_s, end_s = float(time_s[moving[0]]), float(ends_s[moving[-1]])
    at_s = np.arange(begin_s, min(end_s, begin_s + _MOST_S), _SAMPLE_S)
    return np.asarray(value[np.searchsorted(time_s, at_s, side="right") - 1])


def _correlate(commands: Sequence[Values], mean: float, lag: int) -> float:
    pairs = [(one[lag:] - mean, one[:-lag] - mean) for one in commands if len(one) > lag]
    along = sum(float(one @ other) for one, other in pairs)
    sizes = [sum(float(pair[row] @ pair[row]) for pair in pairs) for row in (0, 1)]
    size = float(np.sqrt(sizes[0] * sizes[1]))
    return along / size if size > 0.0 else 0.0


def _compare(fit: AxisFit, twin: Values) -> float | None:
    """Return the ratio of the residuals of a fit and its twin; None if they hardly differ."""
    moved = fit.model.moved
    one, other = (fit.model.linearise(parameters)[0] for parameters in (fit.parameters, twin))
    decide = np.abs(one - other) > _DIFFERS * float(np.abs(one).max())
    if np.count_nonzero(decide) < _FEWEST:
        return None
    left = [float(np.abs(moved - model)[decide].sum()) for model in (one, other)]
    return left[0] / max(left[1], np.finfo(float).tiny)


_LARGEST_S: Final = 3.0
"""Largest delay that is searched [s]: the largest dead time and an equal time constant."""

_COARSE_S, _FINE_S = 0.05, 0.005
"""Distances of tried delays [s]: first over the whole range, then near the best delay and the
ends."""

_MOST_STEPS: Final = 20_000

_PART_S: Final = 1.0
"""Length of parts of the log that count as independent [s]: a usual time constant has faded."""

_FEWEST_PARTS: Final = 8  # smallest number of parts whose scatter is meaningful
_CHANCE: Final = 0.05  # probability that the range does not contain the true best delay

_NEAR: Final = 0.6
"""Factor of Student's t from which a delay is worse than the best. The excess residual grows with
the square of the distance, its scatter with the distance. Therefore half of t is sufficient near
the best delay. The rest is for distant delays: 96.9 % of 391 ranges contained the truth."""


def find_correlation_delay(motions: Sequence[AxisMotion]) -> tuple[Estimate | None, str]:
    """Return the delay of the motion after the commands, as the best value and a range [s].

    Commands are averaged over each step between poses, so that nothing is resampled.

    Returns:
        The delay and an empty text. If the correlation shows no delay, None and a sentence with the
        reason.
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
        # Commands that repeat with opposite sign repeat equally after twice that time.
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
    end_s = begin_s
    while 0.0 < end_s < _LARGEST_S and abs(end_s - begin_s) < _COARSE_S:
        end_s += step_s
        if is_worse(end_s):
            break
    return max(end_s, 0.0)


class _Misfit:
    """Residual of the steps' rates for delayed commands, each with the best gain and offset.

    The residual is smallest at the delay with the largest correlation.
    """

    def __init__(self, motions: Sequence[AxisMotion]) -> None:
        self._motions = motions
        self.duration_s = np.concatenate([motion.duration_s for motion in motions])
        rate = np.concatenate([motion.moved for motion in motions]) / self.duration_s
        # Clipped, so that a single jump does not decide.
        rate = np.clip(rate, *np.quantile(rate, [0.01, 0.99]))
        self._rate = rate - rate.mean()
        counts = [int(motion.duration_s.sum() / _PART_S) for motion in motions]
        first = np.cumsum([0, *counts])
        # The rest at the end of a run belongs to its last part.
        parts = [
            begin + np.minimum(np.cumsum(motion.duration_s) // _PART_S, max(count, 1) - 1)
            for begin, count, motion in zip(first.tolist(), counts, motions, strict=False)
        ]
        self._part = np.unique(np.concatenate(parts), return_inverse=True)[1]
        self.parts = sum(counts)
        self._squares: dict[float, Values] = {}

    def measure(self, delay_s: float) -> float:
        """Return the residual sum of squares for a delay."""
        return float(self._list_squares(delay_s).sum())

    def is_worse(self, delay_s: float | None, best_s: float) -> bool:
        """Return whether a delay is significantly worse; None stands for no commands.

        The excess is summed over parts of the log, whose scatter shows its uncertainty.
        """
        more = self._list_squares(delay_s) - self._list_squares(best_s)
        sums = np.bincount(self._part, weights=more)
        error = float(np.std(sums, ddof=1)) * float(np.sqrt(len(sums)))
        most = float(scipy.special.stdtrit(len(sums) - 1, 1.0 - 0.5 * _CHANCE))
        return float(sums.sum()) > _NEAR * most * error

    def _list_squares(self, delay_s: float | None) -> Values:
        if delay_s is None:
            return np.asarray(self._rate**2)
        if delay_s in self._squares:
            return self._squares[delay_s]
        ways = []
        for motion in self._motions:
            way = motion.commands.place(motion.time_s - delay_s).way
            ways.append(way[motion.first + 1] - way[motion.first])
        asked = np.concatenate(ways) / self.duration_s
        asked -= asked.mean()
        size, along = float(asked @ asked), float(asked @ self._rate)
        # A motion against the commands is not a correlation.
        gain = along / size if size > 0.0 and along > 0.0 else 0.0
        self._squares[delay_s] = (self._rate - gain * asked) ** 2
        return self._squares[delay_s]
