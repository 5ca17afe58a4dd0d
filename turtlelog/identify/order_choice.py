"""Whether a robot needs more than one lag: a second one, or a limit of its acceleration.

More parameters always leave less. So another model must leave clearly less, and, fitted to the
first part of the log only, predict the rest better than the simple one does.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from turtlelog.identify.axis_fit import (
    GAIN,
    LAG,
    AxisFit,
    Kind,
    descend_again,
    refit_axis,
    sum_costs,
)
from turtlelog.identify.axis_motion import AxisMotion
from turtlelog.identify.held_response import Values

_FITTED: Final = 2 / 3
"""Share of each log that is fitted; the rest is predicted."""

_CLEARLY: Final = 15.0
"""By how much another model must lower the sum of squares, in variances: by chance in 1 of 10,000
robots."""

_PREDICTED: Final = 2.0
"""By how much it must lower that of the rest, likewise: noise alone makes it worse on average."""

_RUNS: Final = 20
"""Over how many steps the residual is looked at."""

_ASKS: Final = 45.3
"""Sum of squared correlations over that many steps, times their number, from which the residual is
no noise: 0.1 % of noise exceeds it (chi-square of 20)."""

_STARTS_S: Final = (0.1, 0.5)
"""Durations of the largest change of the command that a limit is looked for from [s]."""

_MOST_CHANGES: Final = 20_000
"""Changes of the command up to which a limit is looked for: it follows them one by one."""


def choose_order(fit: AxisFit) -> AxisFit:
    """Return a fit of another model where the residual asks for it and it predicts better."""
    if not asks_for_more(fit):
        return fit
    lag_s = max(float(fit.parameters[LAG]), 0.02)
    candidates: list[tuple[Kind, list[float]]] = [
        ("second_order", [0.1 * lag_s**2, 0.25 * lag_s**2, lag_s**2])
    ]
    largest = max(float(np.ptp(motion.commands.value)) for motion in fit.model.motions)
    changes = sum(len(motion.commands.value) for motion in fit.model.motions)
    if changes <= _MOST_CHANGES:
        candidates.append(("limited", [start_s / largest for start_s in _STARTS_S]))
    first, rest = _split(fit.model.motions)
    if not first or not rest:
        return fit
    simple = descend_again(fit, first)
    left = sum_costs(fit, rest, simple, fit)
    best, gained = fit, _PREDICTED
    for kind, starts in candidates:
        other = refit_axis(fit, kind, starts)
        lowered = _compare(fit, other)
        if lowered < _CLEARLY or not other.parameters[GAIN] > 0.0:
            continue
        found = left - sum_costs(other, rest, descend_again(other, first), fit)
        if found > gained:
            best, gained = other, found
    return best


def asks_for_more(fit: AxisFit) -> bool:
    """Return whether what a fit leaves is no noise."""
    white = fit.white[~fit.is_outlier]
    if len(white) <= 2 * _RUNS:
        return False
    # Far values must not decide.
    white = np.clip(white, -3.0, 3.0)
    squares = float(white @ white)
    if squares <= 0.0:
        return False
    correlations = [float(white[lag:] @ white[:-lag]) / squares for lag in range(1, _RUNS + 1)]
    return len(white) * float(np.sum(np.square(correlations))) > _ASKS


def _compare(fit: AxisFit, other: AxisFit) -> float:
    """Return by how much another fit lowers the cost, with the noise of the first."""
    motions = fit.model.motions
    return fit_cost(fit, motions, fit.parameters) - sum_costs(other, motions, other.parameters, fit)


def fit_cost(fit: AxisFit, motions: Sequence[AxisMotion], parameters: Values) -> float:
    """Return what a fit leaves of some steps."""
    return sum_costs(fit, motions, parameters, fit)


def _split(motions: Sequence[AxisMotion]) -> tuple[list[AxisMotion], list[AxisMotion]]:
    """Return the first part of the steps of each run, and the rest."""
    cuts = [int(_FITTED * len(motion.moved)) for motion in motions]
    parts = [
        (motion.take(slice(cut)), motion.take(slice(cut, None)))
        for motion, cut in zip(motions, cuts, strict=True)
    ]
    kept = [(first, rest) for first, rest in parts if len(first.moved) and len(rest.moved)]
    return [first for first, _ in kept], [rest for _, rest in kept]
