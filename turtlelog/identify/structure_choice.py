"""Whether a robot needs more than one lag: a second one, or a limit of its acceleration.

More parameters always leave less. So another model must leave clearly less, change what the robot
does by more than can be neglected, and, fitted to the first part of the log only, predict the rest
better than the simple one does.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from turtlelog.identify.axis_fit import (
    EXTRA,
    GAIN,
    LAG,
    AxisFit,
    Kind,
    measure_badness,
    measure_gain,
    predict_badness,
    refit_axis,
    restart_axis,
)
from turtlelog.identify.axis_motion import AxisMotion
from turtlelog.identify.step_noise import LEAST_STEP

_FITTED: Final = 2 / 3
"""Share of each log that is fitted; the rest is predicted."""

_ASKS: Final = 8.0
"""By how much a further parameter must be able to lower the sum of squares, in variances, for it to
be tried: by chance it could in 0.5 % of robots."""

_CLEARLY: Final = 15.0
"""By how much it must lower twice the negative log-likelihood: by chance in 1 of 10,000 robots."""

_MATTERS: Final = 0.02
"""By how much of the largest rate another model must change some step between poses to be told: 2 %
is what counts as settled. What changes less is not seen, though a log without noise would show it.
"""

_SEEN: Final = 1.96
"""Standard deviations by which a further parameter must differ from 0: its interval of 95 % begins
above."""

_PREDICTED: Final = 2.0
"""By how much it must lower that of the rest: noise alone makes it larger on average."""

_STARTS_S: Final = (0.1, 0.5)
"""Durations of the largest change of the command that a limit is looked for from [s]."""

_MOST_CHANGES: Final = 20_000
"""Changes of the command up to which a limit is looked for: it follows them one by one."""

_LEAST_LAG_S: Final = 0.02
"""The lag that a second one is looked for beside, where the first is next to nothing [s]."""


def choose_order(fit: AxisFit) -> AxisFit:
    """Return a fit of another model where the residual asks for it and it predicts better."""
    first, rest = _split(fit.model.motions)
    if not first or not rest:
        return fit
    best, gained = None, _PREDICTED
    for kind, starts in _list_candidates(fit):
        if max(measure_gain(fit, kind, start) for start in starts) < _ASKS:
            continue
        other = refit_axis(fit, kind, starts)
        # Where it has escaped from a local minimum, the simple model may follow.
        fit = min(fit, restart_axis(fit, other.parameters), key=measure_badness)
        if not is_distinct(fit, other):
            continue
        found = predict_badness(fit, first, rest) - predict_badness(other, first, rest)
        if found > gained:
            best, gained = other, found
    return best or fit


def is_distinct(fit: AxisFit, other: AxisFit) -> bool:
    """Return whether another model leaves clearly less, and does something else."""
    gain, extra = other.parameters[[GAIN, EXTRA]].tolist()
    if gain <= 0.0 or extra <= _SEEN * float(np.sqrt(other.covariance[EXTRA, EXTRA])):
        return False
    is_clear = measure_badness(fit) - measure_badness(other) >= _CLEARLY
    return is_clear and measure_effect(fit, other) >= _MATTERS


def measure_effect(fit: AxisFit, other: AxisFit) -> float:
    """Return by how much two models differ at most in a step, as a share of the largest rate."""
    rates = [
        one.model.linearise(one.parameters)[0][~other.is_outlier]
        / one.model.duration_s[~other.is_outlier]
        for one in (fit, other)
    ]
    return float(np.abs(rates[0] - rates[1]).max() / max(np.abs(rates[0]).max(), LEAST_STEP))


def _list_candidates(fit: AxisFit) -> list[tuple[Kind, list[float]]]:
    """Return the models that may be better, with values of their further parameter."""
    lag_s = max(float(fit.parameters[LAG]), _LEAST_LAG_S)
    found: list[tuple[Kind, list[float]]] = [
        ("second_order", [0.1 * lag_s**2, 0.25 * lag_s**2, lag_s**2])
    ]
    largest = max(float(np.ptp(motion.commands.value)) for motion in fit.model.motions)
    if sum(len(motion.commands.value) for motion in fit.model.motions) <= _MOST_CHANGES:
        found.append(("limited", [start_s / largest for start_s in _STARTS_S]))
    return found


def _split(motions: Sequence[AxisMotion]) -> tuple[list[AxisMotion], list[AxisMotion]]:
    """Return the first part of the steps of each run, and the rest."""
    cuts = [int(_FITTED * len(motion.moved)) for motion in motions]
    parts = [
        (motion.take(slice(cut)), motion.take(slice(cut, None)))
        for motion, cut in zip(motions, cuts, strict=True)
    ]
    kept = [(first, rest) for first, rest in parts if len(first.moved) and len(rest.moved)]
    return [first for first, _ in kept], [rest for _, rest in kept]
