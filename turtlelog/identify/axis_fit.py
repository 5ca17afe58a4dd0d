"""Gain, dead time and lag of one axis, by least squares on the steps between poses."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.identify.axis_motion import LARGEST_DEAD_TIME_S, AxisMotion, count_steps
from turtlelog.identify.held_response import LaggedResponse, Values
from turtlelog.identify.step_noise import NORMAL_MAD, StepNoise, Whitening, estimate_noise

_GRID_S: Final = 0.04
"""Between the dead times that are tried first [s]: a quarter of a usual delay."""

_GRID_LAGS_S: Final = (0.0, 0.05, 0.15, 0.4, 1.0)

_GRID_STEPS: Final = 20_000
"""Most steps that choose among these; all of them decide in the end."""

_STARTS: Final = 3
"""How many of the best are refined."""

_SOFT: Final = 3.0
"""Standard deviations beyond which a residual counts less than its square (soft L1)."""

_OUTLIER: Final = 8.0
"""Robust standard deviations beyond which a step is an outlier and does not count: normal noise
makes one in 1e15, stamp jitter at the highest speed five times the usual residual."""

_LAG_STEP_S: Final = 1e-4
"""For differences with respect to the lag [s]; of the product of two lags its square root."""

_MOST_ROUNDS: Final = 40

_ROUND_ENDS: Final = 1e-9
"""Share by which another round must lower the cost."""

_SCORE_LAGS: Final = 12
"""Over how many steps the covariance allows for what whitening leaves."""

GAIN, DEAD_TIME, LAG, PRODUCT = range(4)
"""Places of the parameters."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AxisFit:
    """What fits best.

    Attributes:
        parameters: Gain [1], dead time [s], lag [s], and of second order the product of both lags
            [s^2].
        covariance: Of these.
        cost: Sum of the robust squares, each in units of the noise's variance.
        residual: Measured less modelled [m] or [rad], shape (n,).
        white: The same, whitened.
        is_outlier: Which steps do not count.
        moved: Measured, shape (n,).
        noise: Of the steps.
    """

    parameters: Values
    covariance: Values
    cost: float
    residual: Values
    white: Values
    is_outlier: NDArray[np.bool_]
    moved: Values
    noise: StepNoise


class StepModel:
    """What the commands of some runs lead to in each of their steps."""

    def __init__(self, motions: Sequence[AxisMotion]) -> None:
        self.motions = [motion for motion in motions if len(motion.moved)]
        self.moved = np.concatenate([motion.moved for motion in self.motions])
        self.duration_s = np.concatenate([motion.duration_s for motion in self.motions])
        self.follows = np.concatenate([motion.follows for motion in self.motions])

    def predict(self, dead_time_s: float, *lags: tuple[float, float]) -> list[list[Values]]:
        """Return way and rate of each step for each pair of lag and product, with a gain of 1."""
        found: list[list[list[Values]]] = [[] for _ in lags]
        for motion in self.motions:
            places = motion.commands.place(motion.time_s - dead_time_s)
            for number, (lag_s, product_s2) in enumerate(lags):
                response = LaggedResponse(motion.commands, lag_s, product_s2).evaluate(places)
                steps = [values[motion.first + 1] - values[motion.first] for values in response]
                found[number].append(steps)
        return [[np.concatenate(column) for column in zip(*runs, strict=True)] for runs in found]

    def linearise(self, parameters: Values) -> tuple[Values, Values]:
        """Return the modelled steps and their derivatives, shape (n, parameters)."""
        gain, dead_time_s, lag_s = parameters[:3].tolist()
        product_s2 = float(parameters[PRODUCT]) if len(parameters) > PRODUCT else 0.0
        asked = [(lag_s, product_s2), (lag_s + _LAG_STEP_S, product_s2)]
        if len(parameters) > PRODUCT:
            asked.append((lag_s, product_s2 + _LAG_STEP_S**2))
        (way, rate), *others = self.predict(dead_time_s, *asked)
        columns = [way, -gain * rate, gain * (others[0][0] - way) / _LAG_STEP_S]
        columns += [gain * (other[0] - way) / _LAG_STEP_S**2 for other in others[1:]]
        return gain * way, np.column_stack(columns)


def fit_axis(motions: Sequence[AxisMotion], start: Values | None = None) -> AxisFit:
    """Return the best fit of first order, or of the order of `start`.

    Raises:
        ValueError: Where no gain above 0 explains anything.
    """
    model = StepModel(motions)
    starts = _search_grid(motions) if start is None else [start]
    weigh = _weigh_plainly(model)
    tried = [_descend(model, start, weigh) for start in starts]
    parameters = min(tried, key=lambda found: found[1])[0]
    for _ in range(2):
        residual = model.moved - model.linearise(parameters)[0]
        is_outlier = find_outliers(residual)
        noise = estimate_noise(residual, model.follows, is_outlier)
        whitening = Whitening(noise, model.duration_s, model.follows, is_outlier)
        parameters, cost = _descend(model, parameters, whitening.apply)
    modelled, slopes = model.linearise(parameters)
    residual = model.moved - modelled
    white = whitening.apply(residual)
    return AxisFit(
        parameters=parameters,
        covariance=_estimate_covariance(white, whitening.apply(slopes)),
        cost=cost,
        residual=residual,
        white=white,
        is_outlier=is_outlier,
        moved=model.moved,
        noise=noise,
    )


def find_outliers(residual: Values) -> NDArray[np.bool_]:
    """Return which residuals are no noise."""
    size = np.abs(residual)
    scale = NORMAL_MAD * float(np.median(size))
    return np.asarray(size > _OUTLIER * scale) if scale > 0.0 else np.zeros(len(size), dtype=bool)


def _search_grid(motions: Sequence[AxisMotion]) -> list[Values]:
    """Return the best of a grid, the best first, each with its gain."""
    share = min(1.0, _GRID_STEPS / count_steps(motions))
    model = StepModel([motion.take(slice(int(share * len(motion.moved)))) for motion in motions])
    # A single jump must not decide.
    most = 3.0 * float(np.quantile(np.abs(model.moved), 0.99))
    moved = np.clip(model.moved, -most, most)
    tried = []
    for dead_time_s in np.arange(0.0, LARGEST_DEAD_TIME_S, _GRID_S).tolist():
        steps = model.predict(dead_time_s, *((lag_s, 0.0) for lag_s in _GRID_LAGS_S))
        for lag_s, (way, _) in zip(_GRID_LAGS_S, steps, strict=True):
            size, along = float(way @ way), float(way @ moved)
            if size > 0.0 and along > 0.0:
                tried.append((-along * along / size, along / size, dead_time_s, lag_s))
    if not tried:
        raise ValueError("no gain above 0")
    tried.sort()
    return [np.array(found) for _, *found in tried[:_STARTS]]


def _weigh_plainly(model: StepModel) -> Callable[[Values], Values]:
    """Return a scaling by which the residual of standing still is about 1."""
    scale = NORMAL_MAD * float(np.median(np.abs(model.moved))) or float(np.std(model.moved)) or 1.0
    return lambda values: values / scale


def _descend(
    model: StepModel, parameters: Values, whiten: Callable[[Values], Values]
) -> tuple[Values, float]:
    """Return the parameters that leave the least, by Levenberg and Marquardt, and the cost.

    Neither lags nor dead time go below 0, nor the dead time above the largest.
    """
    lowest, highest = np.full(len(parameters), 0.0), np.full(len(parameters), np.inf)
    highest[DEAD_TIME] = LARGEST_DEAD_TIME_S
    modelled, slopes = model.linearise(parameters)
    white, slopes = whiten(model.moved - modelled), whiten(slopes)
    cost, damping = _sum_softly(white), 1e-3
    for _ in range(_MOST_ROUNDS):
        weights = 1.0 / np.sqrt(1.0 + (white / _SOFT) ** 2)
        downhill = slopes.T @ (weights * white)
        curvature = slopes.T @ (weights[:, None] * slopes)
        stuck = ((parameters <= lowest) & (downhill < 0.0)) | (
            (parameters >= highest) & (downhill > 0.0)
        )
        free = np.flatnonzero(~stuck)
        inner = curvature[np.ix_(free, free)]
        inner = inner + damping * np.diag(np.diag(inner)) + np.finfo(float).tiny * np.eye(len(free))
        tried = parameters.copy()
        tried[free] += np.linalg.lstsq(inner, downhill[free], rcond=None)[0]
        tried = np.clip(tried, lowest, highest)
        modelled, new_slopes = model.linearise(tried)
        new_white = whiten(model.moved - modelled)
        new_cost = _sum_softly(new_white)
        if new_cost >= cost:
            damping *= 10.0
            if damping > 1e6:
                break
            continue
        is_done = cost - new_cost <= _ROUND_ENDS * cost
        parameters, white, slopes, cost = tried, new_white, whiten(new_slopes), new_cost
        damping = max(0.1 * damping, 1e-9)
        if is_done:
            break
    return parameters, cost


def _sum_softly(white: Values) -> float:
    return float(2.0 * _SOFT**2 * (np.sqrt(1.0 + (white / _SOFT) ** 2) - 1.0).sum())


def _estimate_covariance(white: Values, slopes: Values) -> Values:
    """Return the covariance: the larger of what noise as modelled makes, and of a sandwich.

    The sandwich allows for scores that depend on their neighbours; where few steps tell all, it is
    too small, and the other is not.
    """
    bent = 1.0 + (white / _SOFT) ** 2
    scores = slopes * (white / np.sqrt(bent))[:, None]
    inverse = np.linalg.pinv(slopes.T @ (slopes * (bent**-1.5)[:, None]), hermitian=True)
    meat = scores.T @ scores
    for lag in range(1, min(_SCORE_LAGS, len(scores) - 1) + 1):
        beside = scores[lag:].T @ scores[:-lag]
        meat += (1.0 - lag / (_SCORE_LAGS + 1)) * (beside + beside.T)
    sandwich = inverse @ meat @ inverse
    squares = float(np.mean(white**2 / bent))
    plain = inverse * squares
    ratio = np.sqrt(np.maximum(np.diag(plain) / np.maximum(np.diag(sandwich), 1e-300), 1.0))
    return np.asarray(sandwich * np.outer(ratio, ratio))
