"""How well a fit explains its motion, and how well other structures would."""

from collections.abc import Sequence

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
from turtlelog.identify.robot_noise import LEAST_STEP, fit_noise
from turtlelog.identify.robot_structure import Structure


def measure_badness(fit: AxisFit) -> float:
    """Return the misfit of a fit to its own steps: twice the negative log-likelihood."""
    return fit.cost + fit.whitening.log_size


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


def predict_badness(fit: AxisFit, first: Sequence[AxisMotion], rest: Sequence[AxisMotion]) -> float:
    """Return the misfit of a prediction of the rest of the steps by a fit to the first part.

    The misfit is twice the negative log-likelihood, with the uncertainty of the first part: if it
    shows no delay, no structure is to blame for a wrong one. A parameter that it does not show at
    all is as uncertain as one step leaves it. The noise is that of the rest: if neither of two
    structures explains it, the one with less noise before is not the worse.
    """
    known = finish_fit(StepModel(first, fit.model.structure), fit.parameters)
    ahead = StepModel(rest, fit.model.structure)
    modelled, slopes = ahead.linearise(known.parameters)
    residual = ahead.moved - modelled
    outlier = find_outlying_steps(residual)
    whitening = fit_noise(residual, ahead.duration_s, ahead.shared, outlier)
    white, slopes = whitening.apply(residual), whitening.apply(slopes)
    earlier = known.whitening.apply(known.model.linearise(known.parameters)[1])
    before, after = earlier.T @ earlier, slopes.T @ slopes
    before = before + (before + after) / len(fit.residual)
    size = np.maximum(np.sqrt(np.diag(before + after)), UNSEEN)
    before, after = (
        one / np.outer(size, size) + ROUNDED * np.eye(len(size)) for one in (before, after)
    )
    pull = slopes.T @ np.clip(white, -SOFT, SOFT) / size
    learnt = float(pull @ np.linalg.solve(before + after, pull))
    spread = np.linalg.slogdet(before + after)[1] - np.linalg.slogdet(before)[1]
    return sum_softly(white) + whitening.log_size - learnt + float(spread)
