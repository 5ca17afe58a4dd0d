"""How well a fit explains its motion, and how well other structures would."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from turtlelog.identify.axis_fit import (
    LAG,
    ROUNDED,
    SOFT,
    UNSEEN,
    AxisFit,
    StepModel,
    find_outlying_steps,
    finish_fit,
    sum_softly,
)
from turtlelog.identify.axis_motion import AxisMotion
from turtlelog.identify.held_response import Values
from turtlelog.identify.robot_noise import LEAST_STEP, Whitening, fit_noise
from turtlelog.identify.robot_structure import Structure


def measure_reductions(
    fit: AxisFit, structure: Structure, starts: Sequence[Sequence[float]]
) -> list[tuple[float, float]]:
    """Return by how much further parameters could reduce the sum of squares, to first order.

    The second number is the reduction by the start values themselves: of starts whose effects
    differ in size alone, one is nearest.
    """
    modelled, slopes = fit.model.linearise(fit.parameters)
    gain, dead_time_s, lag_s = fit.parameters[: LAG + 1].tolist()
    other = StepModel(fit.model.motions, structure)
    bent = [
        gain * other.predict(dead_time_s, other.prepare(lag_s, *extras))[0][0] - modelled
        for extras in starts
    ]
    slopes = fit.whitening.apply(slopes)
    white = np.clip(fit.white, -SOFT, SOFT)
    columns = np.column_stack([white, fit.whitening.apply(np.column_stack(bent))])
    white, *bent = (columns - slopes @ np.linalg.lstsq(slopes, columns)[0]).T
    sums = [(float(white @ one), max(float(one @ one), LEAST_STEP)) for one in bent]
    return [(along**2 / size, 2.0 * along - size) for along, size in sums]


def measure_near(fit: AxisFit, structure: Structure, extras: Sequence[float]) -> float:
    """Return the cost of another structure near the parameters of a fit, after one linear step."""
    other = StepModel(fit.model.motions, structure)
    near = np.append(fit.parameters[: LAG + 1], extras)
    modelled, slopes = other.linearise(near)
    white, slopes = (fit.whitening.apply(one) for one in (other.moved - modelled, slopes))
    return sum_softly(white - slopes @ np.linalg.lstsq(slopes, white)[0])


def compare_predictions(
    fit: AxisFit, other: AxisFit, first: Sequence[AxisMotion], rest: Sequence[AxisMotion]
) -> float:
    """Return by how much another structure predicts the rest of the steps better than a fit.

    Both are fitted to the first part. The difference is that of twice the negative log-likelihoods,
    by the noise of the rest for the other one: if neither explains the rest, the one with less
    noise before is not the worse.
    """
    ahead = [_predict(one, first, rest) for one in (fit, other)]
    residual, motion = ahead[1].residual, ahead[1].ahead
    outlier = find_outlying_steps(residual)
    whitening = fit_noise(residual, motion.duration_s, motion.shared, outlier)
    badness, other_badness = (_measure_ahead(one, whitening) for one in ahead)
    return badness - other_badness


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Prediction:
    """A fit to the first part of a log, and its residual in the rest with its slopes."""

    known: AxisFit
    ahead: StepModel
    residual: Values
    slopes: Values


def _predict(fit: AxisFit, first: Sequence[AxisMotion], rest: Sequence[AxisMotion]) -> _Prediction:
    known = finish_fit(StepModel(first, fit.model.structure), fit.parameters)
    ahead = StepModel(rest, fit.model.structure)
    modelled, slopes = ahead.linearise(known.parameters)
    return _Prediction(known=known, ahead=ahead, residual=ahead.moved - modelled, slopes=slopes)


def _measure_ahead(one: _Prediction, whitening: Whitening) -> float:
    """Return the misfit of a prediction with the uncertainty of the first part.

    If that part shows no delay, no structure is to blame for a wrong one. A parameter that it does
    not show at all is as uncertain as one step leaves it.
    """
    white, slopes = whitening.apply(one.residual), whitening.apply(one.slopes)
    known = one.known
    earlier = known.whitening.apply(known.model.linearise(known.parameters)[1])
    before, after = earlier.T @ earlier, slopes.T @ slopes
    before = before + (before + after) / (len(earlier) + len(slopes))
    size = np.maximum(np.sqrt(np.diag(before + after)), UNSEEN)
    before, after = (
        matrix / np.outer(size, size) + ROUNDED * np.eye(len(size)) for matrix in (before, after)
    )
    slopes = slopes / size
    step = np.linalg.solve(before + after, slopes.T @ np.clip(white, -SOFT, SOFT))
    spread = np.linalg.slogdet(before + after)[1] - np.linalg.slogdet(before)[1]
    return sum_softly(white - slopes @ step) + float(step @ before @ step + spread)
