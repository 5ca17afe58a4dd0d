"""Whether commands repeat, so that another dead time or the other sign explains a motion alike."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from turtlelog.identify.axis_fit import DEAD_TIME, AxisFit
from turtlelog.identify.axis_motion import LARGEST_DEAD_TIME_S, AxisMotion
from turtlelog.identify.held_response import Values

_SAMPLE_S: Final = 0.01
"""Between the times at which commands are compared with earlier ones [s]."""

_MOST_S: Final = 120.0
"""How much of each run is compared [s]."""

_ALIKE: Final = 0.8
"""Correlation from which commands repeat: a switch that comes 5 % of a period early or late leaves
so much. Whether another delay really explains as much, the motion decides."""

_DIPS: Final = 0.5
"""Correlation that is fallen below before they repeat: of slow commands near times look alike."""

_DIFFERS: Final = 0.25
"""Share of the largest step by which two models must differ in a step for it to decide."""

_FEWEST: Final = 3
"""Steps that decide, at least: fewer may be jumps."""

_BETTER: Final = 0.5
"""Share of the other's error that a model leaves in those steps if it is the right one."""


def find_repetition(motions: Sequence[AxisMotion]) -> tuple[float, int] | None:
    """Return after which time [s] commands repeat, and with which sign; None where they do not.

    Only times up to the largest dead time count: a later repetition explains nothing.
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
    # With a mean, the other sign goes the other way.
    for alike, sign in ((-plain, -1), (np.where(has_dipped, centred, 0.0), 1)):
        if alike.max() >= _ALIKE:
            begin = int(np.argmax(alike >= _ALIKE))
            length = int(np.argmin(np.append(alike[begin:], -1.0) >= _ALIKE))
            best = begin + int(np.argmax(alike[begin : begin + length]))
            return float(lags[best]) * _SAMPLE_S, sign
    return None


def list_twins(fit: AxisFit, shift_s: float, sign: int) -> list[tuple[float, int, float | None]]:
    """Return the other dead times [s] of commands that repeat, each with the sign of its gain.

    The last of each is what the fit leaves by what that twin leaves, where both differ; None where
    they hardly do.
    """
    gain, dead_time_s, lag_s, *extra = fit.parameters.tolist()
    twins = []
    count = int(LARGEST_DEAD_TIME_S / shift_s) + 1
    for number in range(-count, count + 1):
        other_s = dead_time_s + number * shift_s
        if number and 0.0 <= other_s < LARGEST_DEAD_TIME_S:
            parameters = np.array([sign**number * gain, other_s, lag_s, *extra])
            twins.append((other_s, sign**number, _compare(fit, parameters)))
    return twins


def tell_twin(fit: AxisFit, shift_s: float, sign: int) -> tuple[str, bool]:
    """Return why a dead time is not known, and whether the other sign explains more.

    The reason is empty where the motion tells which it is.
    """
    gain, dead_time_s = fit.parameters[: DEAD_TIME + 1].tolist()
    for other_s, its_sign, ratio in list_twins(fit, shift_s, sign):
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
    """Return the held commands at equal times, from the first other than 0 to the last's end."""
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
    moved = fit.model.moved
    one, other = (fit.model.linearise(parameters)[0] for parameters in (fit.parameters, twin))
    decide = np.abs(one - other) > _DIFFERS * float(np.abs(one).max())
    if np.count_nonzero(decide) < _FEWEST:
        return None
    left = [float(np.abs(moved - model)[decide].sum()) for model in (one, other)]
    return left[0] / max(left[1], np.finfo(float).tiny)
