"""Gain, dead time and time constant of one axis, by least squares on the steps between poses."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from turtlelog.errors import IdentifyError
from turtlelog.identify.axis_motion import LARGEST_DEAD_TIME_S, AxisMotion
from turtlelog.identify.held_response import FIRST_ORDER, HeldResponse, Structure, Values
from turtlelog.identify.robot_noise import LEAST_STEP, NORMAL_MAD, Whitening, learn_noise

_GRID_S: Final = 0.04
"""Distance of the dead times in the first search [s]: a quarter of a usual delay."""

_GRID_LAGS_S: Final = (0.0, 0.05, 0.15, 0.4, 1.0)

_GRID_STEPS: Final = 20_000
"""Largest number of steps in the first search; the final fit uses all steps."""

_SPIKE_STEPS: Final = 2
"""Number of steps on either side that show whether a step is a jump, in the first search: one wrong
heading gives two wrong steps, there and back."""

SOFT: Final = 3.0
"""Standard deviations from which a residual counts less than its square (soft L1)."""

_LAG_STEP_S: Final = 1e-4  # difference for derivatives with respect to the time constant [s]

_LAG_RESOLUTION: Final = 0.05
"""Share of the longest possible time constant to which it is searched, and of a step between poses
where the search begins: a twentieth of an interval changes no advice."""

NORMAL_95: Final = 1.96
"""Standard deviations on either side that contain 95 % of normal noise."""

_MOST_ROUNDS: Final = 40

_ROUND_ENDS: Final = 1e-9  # share of the cost that another round must save to continue

_SAME: Final = 1e-6
"""Share of the cost by which two searches that end in the same minimum may differ: a thousand times
what ends a search."""

_TIED: Final = 10.0
"""Difference of the cost, in the noise of another structure, up to which the own noise may change
the order of two minima: odds of 150 to 1."""

_MOST_LESSONS: Final = 6
"""Largest number of times that the noise is learnt from the residual of the fit with the noise
before; three or four are usual."""

_LEARNT: Final = 0.5
"""Decrease of twice the negative log-likelihood below which the noise is learnt: any further
parameter must decrease it by thirty times as much."""

_SCORE_LAGS: Final = 12
"""Number of steps over which the covariance includes correlations left by whitening."""

UNSEEN: Final = 1e-12
"""Smallest effect of a parameter's unit on all steps, in standard deviations of the noise."""

ROUNDED: Final = 1e-14
"""Share of joint changes of parameters that is only rounding."""

GAIN, DEAD_TIME, LAG, EXTRA = range(4)
"""Indices of the parameters."""

TOTAL: Final = DEAD_TIME
"""Index of the total delay in a covariance."""


class NoGainError(IdentifyError):
    """Error of a motion that no positive gain explains."""


class StepModel:
    """Model of the motion in each step, from the commands of one or several runs."""

    def __init__(self, motions: Sequence[AxisMotion], structure: Structure = FIRST_ORDER) -> None:
        self.structure = structure
        self.motions = [motion for motion in motions if len(motion.moved)]
        self.moved = np.concatenate([motion.moved for motion in self.motions])
        self.duration_s = np.concatenate([motion.duration_s for motion in self.motions])
        self.shared = np.concatenate([motion.shared for motion in self.motions])
        self.rounding = max((motion.rounding for motion in self.motions), default=0.0)
        self.commands = np.concatenate([motion.commands.value for motion in self.motions])

    def prepare(self, lag_s: float, *extras: float) -> list[HeldResponse]:
        """Return the response of each run's commands for a time constant and further parameters."""
        return [
            self.structure.respond(motion.commands, lag_s, extras, motion.beside)
            for motion in self.motions
        ]

    def predict(
        self, dead_time_s: float, *lags: Sequence[HeldResponse]
    ) -> list[tuple[Values, Values]]:
        """Return displacement and rate of each step for each response, with a gain of 1."""
        found: list[list[tuple[Values, Values]]] = [[] for _ in lags]
        for row, motion in enumerate(self.motions):
            time_s, after = motion.time_s - dead_time_s, motion.first + 1
            places = None
            for steps, responses in zip(found, lags, strict=True):
                if places is None or self.structure.bends:
                    places = responses[row].place(time_s)
                way, rate = responses[row].evaluate(places)
                steps.append((way[after] - way[motion.first], rate[after] - rate[motion.first]))
        return [
            (np.concatenate([way for way, _ in steps]), np.concatenate([rate for _, rate in steps]))
            for steps in found
        ]

    def fit_noise(self, residual: Values) -> tuple[NDArray[np.bool_], Whitening]:
        """Return which residuals are outliers, and the whitening by the noise of the others."""
        return learn_noise(residual, self.duration_s, self.shared, self.rounding)

    def predict_beside(self, dead_time_s: float) -> Values:
        """Return the displacement of each step by the commands of the other axis [m or rad]."""
        steps = []
        for motion in self.motions:
            other, rows = motion.beside, motion.first
            time_s = motion.time_s - dead_time_s
            way = 0.0 * time_s if other is None else other.place(time_s).way
            steps.append(way[rows + 1] - way[rows])
        return np.concatenate(steps)

    def linearise(self, parameters: Values) -> tuple[Values, Values]:
        """Return the modelled steps and their derivatives, shape (n, parameters)."""
        gain, dead_time_s, lag_s, *extras = parameters.tolist()
        asked, width = [self.prepare(lag_s, *extras)], [_LAG_STEP_S, *self.structure.steps]
        for row, step in enumerate(width):
            moved = [lag_s, *extras]
            moved[row] += step
            asked.append(self.prepare(*moved))
        (way, rate), *others = self.predict(dead_time_s, *asked)
        slopes = [
            gain * (other - way) / step for (other, _), step in zip(others, width, strict=True)
        ]
        return gain * way, np.column_stack([way, -gain * rate, *slopes])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AxisFit:
    """Best fit of a model.

    Attributes:
        model: Fitted model.
        parameters: Gain [1], dead time [s], time constant [s], and further parameters of the
            structure.
        covariance: Covariance of gain, total delay, time constant and the further parameters. Dead
            time and time constant are anticorrelated; their sum is known far better than either.
        dispersion: Ratio of the variance of the time constant to that for normal noise.
        cost: Sum of the robust squares, each in units of the noise's variance.
        residual: Measured minus modelled [m or rad], shape (n,).
        white: Whitened residual, shape (n,).
        is_outlier: Whether each step is left out as an outlier.
        whitening: Whitening that was used.
    """

    model: StepModel
    parameters: Values
    covariance: Values
    dispersion: float
    cost: float
    residual: Values
    white: Values
    is_outlier: NDArray[np.bool_]
    whitening: Whitening

    @property
    def extras(self) -> dict[str, float]:
        """Further parameters of the structure by name."""
        return dict(zip(self.model.structure.names, self.parameters[EXTRA:].tolist(), strict=True))

    @property
    def badness(self) -> float:
        """Misfit to the own steps: twice the negative log-likelihood."""
        return self.cost + self.whitening.log_size


def fit_axis(motions: Sequence[AxisMotion]) -> AxisFit:
    """Return the best first-order fit; NoGainError if no gain above 0 explains any motion."""
    model = StepModel(motions)
    return _measure_lag(finish_fit(model, _search_start(motions)))


def fit_without_lag(fit: AxisFit) -> AxisFit:
    """Return the best first-order fit without time constant, using the noise of another fit."""
    start = fit.parameters.copy()
    start[DEAD_TIME] += start[LAG]
    start[LAG] = 0.0
    parameters, cost = _descend(fit.model, start, fit.whitening.apply, LAG)
    return _conclude(fit.model, parameters, cost, (fit.is_outlier, fit.whitening))


def refit_axis(fit: AxisFit, structure: Structure, starts: Sequence[Sequence[float]]) -> AxisFit:
    """Return the best fit of another structure, with its own noise.

    `starts` are start values of its further parameters. The gain is the best for each: with that of
    the fit, a suitable bound would seem worse than no bound, and the search would leave it at once.
    """
    model = StepModel(fit.model.motions, structure)
    own_gain, dead_time_s, lag_s = fit.parameters[: LAG + 1].tolist()
    moved, tried = fit.whitening.apply(model.moved), []
    for extras in starts:
        way = model.predict(dead_time_s, model.prepare(lag_s, *extras))[0][0]
        way = fit.whitening.apply(way)
        size, along = float(way @ way), float(way @ moved)
        gain = along / size if along > 0.0 else own_gain
        near = np.array([gain, dead_time_s, lag_s, *extras])
        tried.append(_descend(model, near, fit.whitening.apply))
    ends = [finish_fit(model, one) for one in list_ends(tried)]
    return _measure_lag(min(ends, key=lambda end: end.badness))


def list_ends(tried: Sequence[tuple[Values, float]]) -> Iterator[Values]:
    """Yield the parameters with the smallest cost, and those that their own noise may prefer."""
    least = before = min(cost for _, cost in tried)
    for row, (parameters, cost) in enumerate(sorted(tried, key=lambda found: found[1])):
        if row == 0 or (cost - before > _SAME * cost and cost - least <= _TIED):
            yield parameters
        before = cost


def restart_axis(fit: AxisFit, start: Values) -> AxisFit:
    """Return the best fit of the same structure from other start parameters, with its own noise."""
    near = np.append(start[: LAG + 1], fit.parameters[EXTRA:])
    return _measure_lag(finish_fit(fit.model, _descend(fit.model, near, fit.whitening.apply)[0]))


def _measure_lag(fit: AxisFit) -> AxisFit:
    """Return a fit with the error of a time constant that may be 0, where its slope shows none.

    A time constant much shorter than the steps acts in few of them. Behind a limited acceleration
    it rounds the ends of ramps, and its effect grows with its square. Therefore the cost of longer
    time constants gives the error, and what these do to the other parameters.
    """
    lag_s, variance = float(fit.parameters[LAG]), float(fit.covariance[LAG, LAG])
    if lag_s**2 > NORMAL_95**2 * variance:
        return fit
    longest = _find_longest_lag(fit)
    if longest is None:
        return fit
    moved = longest - fit.parameters
    moved[TOTAL] += moved[LAG]
    # The interval is symmetrical, and contains 0.
    moved *= max(lag_s / float(moved[LAG]), 1.0) / NORMAL_95
    others = np.delete(np.arange(len(moved)), LAG)
    slopes = fit.whitening.apply(fit.model.linearise(fit.parameters)[1][:, others])
    covariance = np.outer(moved, moved)
    covariance[np.ix_(others, others)] += _estimate_covariance(
        fit.white, slopes, fit.whitening.noise.rounded
    )[0]
    if not fit.model.structure.rounds_by_lag:
        # Only the time constant has no slope; the errors of the others are those of the fit.
        errors = np.sqrt(np.diag(fit.covariance) / np.maximum(np.diag(covariance), 1e-100))
        errors[LAG] = 1.0
        covariance *= np.outer(errors, errors)
    return replace(fit, covariance=covariance)


def _find_longest_lag(fit: AxisFit) -> Values | None:
    """Return the parameters with the longest time constant that the motion allows; None if any."""
    most = fit.cost + NORMAL_95**2 * fit.dispersion
    inside, outside = fit.parameters, None
    step_s = _LAG_RESOLUTION * float(np.median(fit.model.duration_s))
    while outside is None or step_s > _LAG_RESOLUTION * float(inside[LAG]):
        start = inside.copy()
        start[LAG] += step_s
        if start[LAG] > LARGEST_DEAD_TIME_S:
            return None
        tried, cost = _descend(fit.model, start, fit.whitening.apply, LAG)
        if cost <= most:
            inside = tried
        else:
            outside = tried
        step_s *= 2.0 if outside is None else 0.5
    return inside


def finish_fit(model: StepModel, parameters: Values) -> AxisFit:
    """Return the best fit near the given parameters, with its own noise."""
    least = np.inf
    for _ in range(_MOST_LESSONS):
        is_outlier, whitening = model.fit_noise(model.moved - model.linearise(parameters)[0])
        parameters, cost = _descend(model, parameters, whitening.apply)
        gained, least = least - (cost + whitening.log_size), cost + whitening.log_size
        if gained < _LEARNT:
            break
    return _conclude(model, parameters, cost, (is_outlier, whitening))


def solve_part(fit: AxisFit, part: NDArray[np.bool_], *beside: Values) -> tuple[Values, Values]:
    """Return the change of the parameters from some of the steps, with its covariance.

    Parameters are ordered as in the fit's covariance; then come factors of `beside`, further
    displacements in each step.
    """
    _, slopes = fit.model.linearise(fit.parameters)
    slopes[:, LAG] -= slopes[:, DEAD_TIME]
    slopes = np.column_stack([slopes, *beside])
    white, slopes = fit.white[part], fit.whitening.apply(slopes)[part]
    covariance, _ = _estimate_covariance(white, slopes, fit.whitening.noise.rounded)
    bent = 1.0 + (white / SOFT) ** 2
    root = _find_root(slopes.T @ (slopes * (bent**-1.5)[:, None]))
    return root @ (root.T @ (slopes.T @ (white / np.sqrt(bent)))), covariance


def _conclude(
    model: StepModel, parameters: Values, cost: float, noise: tuple[NDArray[np.bool_], Whitening]
) -> AxisFit:
    is_outlier, whitening = noise
    modelled, slopes = model.linearise(parameters)
    residual = model.moved - modelled
    white = whitening.apply(residual)
    # At constant total delay, a longer time constant is a shorter dead time.
    slopes[:, LAG] -= slopes[:, DEAD_TIME]
    covariance, excess = _estimate_covariance(
        white, whitening.apply(slopes), whitening.noise.rounded
    )
    return AxisFit(
        model=model,
        parameters=parameters,
        covariance=covariance,
        dispersion=float(excess[LAG]),
        cost=cost,
        residual=residual,
        white=white,
        is_outlier=is_outlier,
        whitening=whitening,
    )


def count_steps(motions: Sequence[AxisMotion]) -> int:
    """Return the total number of steps of the runs."""
    return sum(len(motion.moved) for motion in motions)


def _search_start(motions: Sequence[AxisMotion]) -> Values:
    """Return the best parameters by plain least squares."""
    # For each time constant, the descent begins at the best point of a grid, because commands of a
    # controller leave local minima.
    share = min(1.0, _GRID_STEPS / count_steps(motions))
    model = StepModel([motion.take(slice(int(share * len(motion.moved)))) for motion in motions])
    # Limited in size, so that no jump or wrongly wrapped heading dominates.
    beside = np.pad(model.moved, _SPIKE_STEPS, mode="edge")
    middle = np.median(sliding_window_view(beside, 2 * _SPIKE_STEPS + 1), axis=-1)
    most = 3.0 * float(np.quantile(np.abs(middle), 0.99))
    moved = np.clip(model.moved, middle - most, middle + most) if most > 0.0 else model.moved
    responses = [model.prepare(lag_s) for lag_s in _GRID_LAGS_S]
    tried: dict[float, tuple[float, float, float]] = {}
    for dead_time_s in np.arange(0.0, LARGEST_DEAD_TIME_S, _GRID_S).tolist():
        steps = model.predict(dead_time_s, *responses)
        for lag_s, (way, _) in zip(_GRID_LAGS_S, steps, strict=True):
            size, along = float(way @ way), float(way @ moved)
            if size > 0.0 and along > 0.0:
                found = -along * along / size, along / size, dead_time_s
                tried[lag_s] = min(found, tried.get(lag_s, found))
    if not tried:
        where = " in their direction" if model.moved.any() else ""
        raise NoGainError(f"no motion follows the commands{where}")
    # A scale for which the residual of a robot at rest is about 1.
    scale = NORMAL_MAD * float(np.median(np.abs(model.moved))) or float(np.std(model.moved))
    scale = max(scale, LEAST_STEP)
    starts = [np.array([*found, lag_s]) for lag_s, (_, *found) in tried.items()]
    descents = [_descend(model, start, lambda values: values / scale) for start in starts]
    return min(descents, key=lambda found: found[1])[0]


def _descend(
    model: StepModel, parameters: Values, whiten: Callable[[Values], Values], *fixed: int
) -> tuple[Values, float]:
    """Return the parameters with the smallest cost (Levenberg-Marquardt), and the cost."""
    # Only a drift may be negative, and the dead time is not larger than the limit.
    lowest, highest = np.full(len(parameters), 0.0), np.full(len(parameters), np.inf)
    highest[DEAD_TIME] = LARGEST_DEAD_TIME_S
    lowest[EXTRA:] = [-np.inf if name == "drift" else 0.0 for name in model.structure.names]
    modelled, slopes = model.linearise(parameters)
    white, slopes = whiten(model.moved - modelled), whiten(slopes)
    cost, damping = sum_softly(white), 1e-3
    for _ in range(_MOST_ROUNDS):
        weights = 1.0 / np.sqrt(1.0 + (white / SOFT) ** 2)
        downhill = slopes.T @ (weights * white)
        curvature = slopes.T @ (weights[:, None] * slopes)
        stuck = (parameters <= lowest) & (downhill < 0.0)
        stuck |= (parameters >= highest) & (downhill > 0.0)
        stuck[[*fixed]] = True
        free = np.flatnonzero(~stuck)
        inner = curvature[np.ix_(free, free)]
        inner = inner + damping * np.diag(np.diag(inner)) + np.finfo(float).tiny * np.eye(len(free))
        tried = parameters.copy()
        tried[free] += np.linalg.lstsq(inner, downhill[free], rcond=None)[0]
        tried = np.clip(tried, lowest, highest)
        modelled, new_slopes = model.linearise(tried)
        new_white = whiten(model.moved - modelled)
        new_cost = sum_softly(new_white)
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


def sum_softly(white: Values) -> float:
    """Return the sum of robust squares: large residuals count less."""
    return float(2.0 * SOFT**2 * (np.sqrt(1.0 + (white / SOFT) ** 2) - 1.0).sum())


def _estimate_covariance(
    white: Values, slopes: Values, rounded: float = 0.0
) -> tuple[Values, Values]:
    """Return the covariance, and the ratio of each variance to that of normal noise.

    The covariance is the larger of two, for each combination of parameters: a robust ("sandwich")
    estimate from the residuals, which allows for correlated neighbours but is too small if a few
    steps carry all information, and the model covariance.
    """
    bent = 1.0 + (white / SOFT) ** 2
    scores = slopes * (white / np.sqrt(bent))[:, None]
    root = _find_root(slopes.T @ (slopes * (bent**-1.5)[:, None]))
    meat = scores.T @ scores
    for lag in range(1, min(_SCORE_LAGS, len(scores) - 1) + 1):
        beside = scores[lag:].T @ scores[:-lag]
        meat += (1.0 - lag / (_SCORE_LAGS + 1)) * (beside + beside.T)
    # Large residuals count less in both, so that normal noise has its own variance.
    variance = max(float(np.mean(white**2 / bent) / np.mean(bent**-1.5)), rounded)
    power, turn = np.linalg.eigh(root.T @ meat @ root)
    root = root @ turn
    covariance = (root * np.maximum(power, variance)) @ root.T
    return covariance, np.maximum(np.diag(covariance) / (root**2).sum(axis=1), 1.0)


def _find_root(matrix: Values) -> Values:
    """Return a root of the inverse of a matrix of squares, independent of the units of its rows."""
    # In a direction without information, the inverse is large instead of 0.
    size = np.maximum(np.sqrt(np.diag(matrix)), UNSEEN)
    power, direction = np.linalg.eigh(matrix / np.outer(size, size))
    return np.asarray(direction / np.sqrt(np.maximum(power, ROUNDED)) / size[:, None])
