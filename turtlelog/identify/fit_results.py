"""What a fit shows: values with intervals, and how well it and other structures explain motion."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final, Literal

import numpy as np

from turtlelog.identify.axis_fit import (
    DEAD_TIME,
    EXTRA,
    GAIN,
    LAG,
    NORMAL_95,
    ROUNDED,
    SOFT,
    TOTAL,
    UNSEEN,
    AxisFit,
    StepModel,
    find_outlying_steps,
    finish_fit,
    fit_without_lag,
    sum_softly,
)
from turtlelog.identify.axis_motion import UNITS, Axis, AxisMotion
from turtlelog.identify.held_response import Values
from turtlelog.identify.robot_model import AxisModel, Estimate
from turtlelog.identify.robot_noise import LEAST_STEP, Whitening, fit_noise
from turtlelog.identify.robot_structure import FIRST_ORDER, Structure

_SHORT_LAG: Final = 2.0
"""Time constant in steps between poses up to which it may be 0."""

_FINEST: Final = 1e-4
"""Smallest standard error of a limit, as a share of the limit: the change over which its effect on
the motion is measured. For smaller changes the effect may be different."""

_ACTS: Final = MappingProxyType[str, Literal["before_lag", "within_lag", "at_wheels"]](
    {
        "limited_before": "before_lag",
        "limited_softly": "before_lag",
        "limited_within": "within_lag",
        "limited_wheels": "at_wheels",
    }
)


def describe_fit(axis: Axis, fit: AxisFit, changes: int) -> AxisModel:
    """Return the values of an axis; `changes` is the number of changes of its command."""
    parameters, covariance = fit.parameters, fit.covariance
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    counted = ~fit.is_outlier
    moved, white = fit.model.moved[counted], fit.white[counted]
    took_s = fit.model.duration_s[counted]
    left = float(np.sum(fit.residual[counted] ** 2))
    # Steps over lost poses are longer at any speed, and a model must do better than one speed.
    spread = float(np.sum((moved - moved.sum() / took_s.sum() * took_s) ** 2))
    spread = spread if spread > _ROUNDING * float(np.sum(moved**2)) else 0.0
    structure = fit.model.structure
    names = {name: place for place, name in enumerate(structure.names, EXTRA)}
    total = _estimate_delay(fit, float(parameters[DEAD_TIME] + parameters[LAG]), (1.0, 0.0))
    dead_time, lag = _allow_no_lag(
        fit,
        _estimate_delay(fit, float(parameters[DEAD_TIME]), (1.0, -1.0)),
        _estimate_delay(fit, float(parameters[LAG]), (0.0, 1.0)),
    )
    # Dead time and time constant are not negative, so neither exceeds their sum.
    return AxisModel(
        axis=axis,
        status="ok",
        model="second_order" if structure.order == "second_order" else "first_order",
        gain=_estimate(float(parameters[GAIN]), float(errors[GAIN]), "1"),
        dead_time_s=replace(dead_time, high=min(dead_time.high, total.high)),
        lag_s=replace(lag, high=min(lag.high, total.high)),
        total_delay_s=total,
        lag_product_s2=_take(fit, names.get("product"), "s^2"),
        limit_acts=_ACTS.get(structure.order, ""),
        rate_limit=_divide(fit, names.get("slowness"), f"{UNITS[axis]}^2"),
        rate_limit_beside=_invert_parameter(
            fit,
            names.get("slowness_beside"),
            f"{UNITS['turn_rate' if axis == 'speed' else 'speed']}^2",
        ),
        jerk_time_s=_take(fit, names.get("jerk_time"), "s"),
        bound=_divide(fit, names.get("tightness"), UNITS[axis]),
        bound_acts=structure.bound,
        bound_beside=_invert_parameter(
            fit, names.get("coupling"), UNITS["turn_rate" if axis == "speed" else "speed"]
        ),
        reverse_gain=_multiply(fit, names.get("reverse")),
        friction=_take(fit, names.get("friction"), UNITS[axis]),
        deadband=_estimate_deadband(fit, UNITS[axis]),
        explained=1.0 - left / spread if spread > 0.0 else None,
        whiteness=_measure_whiteness(white),
        outliers=int(np.count_nonzero(fit.is_outlier)),
        steps=len(fit.residual),
        changes=changes,
    )


_ROUNDING: Final = 1e-18
"""Share of the squares of the steps below which differences are rounding alone [1]."""


def _estimate_delay(fit: AxisFit, value: float, weights: Sequence[float]) -> Estimate:
    """Return a delay with its interval.

    A time constant that only rounds the ends of ramps may be 0, but not less. So what depends on it
    has an interval with two unequal sides.

    Args:
        fit: Fit of the axis.
        value: Value of the delay [s].
        weights: Shares of total delay and time constant in it.
    """
    of_delays, shares = fit.covariance[np.ix_([TOTAL, LAG], [TOTAL, LAG])], np.array(weights)
    variance, error = float(shares @ of_delays @ shares), float(np.sqrt(max(of_delays[1, 1], 0.0)))
    if not fit.model.structure.rounds_by_lag or error <= 0.0:
        return _estimate(value, float(np.sqrt(max(variance, 0.0))))
    by_lag = float(shares @ of_delays[1]) / error
    rest = NORMAL_95**2 * max(variance - by_lag**2, 0.0)
    shorter = min(float(fit.parameters[LAG]) / error, NORMAL_95)
    moves = (NORMAL_95 * by_lag, -shorter * by_lag)
    low = value - float(np.sqrt(rest + min(*moves, 0.0) ** 2))
    high = value + float(np.sqrt(rest + max(*moves, 0.0) ** 2))
    return Estimate(value=value, low=max(low, 0.0), high=high, unit="s")


def _allow_no_lag(fit: AxisFit, dead_time: Estimate, lag: Estimate) -> tuple[Estimate, Estimate]:
    """Widen intervals to a time constant of 0 if no time constant fits as well.

    A time constant much shorter than the steps is visible only in steps in which the command
    changes. The errors of such a time constant are not normal, so the cost is more reliable than
    its curvature.
    """
    short_s = _SHORT_LAG * float(np.median(fit.model.duration_s))
    if fit.model.structure != FIRST_ORDER or lag.low <= 0.0 or lag.value > short_s:
        return dead_time, lag
    without = fit_without_lag(fit)
    if without.cost - fit.cost > NORMAL_95**2 * fit.dispersion:
        return dead_time, lag
    error = float(np.sqrt(without.covariance[TOTAL, TOTAL]))
    high = float(without.parameters[DEAD_TIME]) + NORMAL_95 * error
    return replace(dead_time, high=max(dead_time.high, high)), replace(lag, low=0.0)


def _estimate(value: float, error: float, unit: str = "s") -> Estimate:
    """Return a non-negative value with its interval."""
    half = NORMAL_95 * error
    return Estimate(value=value, low=max(value - half, 0.0), high=value + half, unit=unit)


def _take(fit: AxisFit, place: int | None, unit: str) -> Estimate | None:
    """Return an estimate of a further parameter; None if the structure does not have it."""
    if place is None:
        return None
    error = float(np.sqrt(max(fit.covariance[place, place], 0.0)))
    return _estimate(float(fit.parameters[place]), error, unit)


def _divide(fit: AxisFit, place: int | None, unit: str) -> Estimate | None:
    """Return the gain divided by a further parameter, such as a limit of the rate."""
    if place is None:
        return None
    gain, by = fit.parameters[[GAIN, place]].tolist()
    if by <= 0.0:
        return None
    error = _find_error(fit, place, [1.0 / by, -gain / by**2])
    return _estimate(gain / by, max(error, _FINEST * gain / by), unit)


def _invert_parameter(fit: AxisFit, place: int | None, unit: str) -> Estimate | None:
    """Return the reciprocal of a further parameter."""
    found = _take(fit, place, unit)
    if found is None or found.value <= 0.0:
        return None
    error = max((found.high - found.value) / NORMAL_95, _FINEST * found.value)
    return _estimate(1.0 / found.value, error / found.value**2, unit)


def _multiply(fit: AxisFit, place: int | None) -> Estimate | None:
    """Return the gain times a further parameter."""
    if place is None:
        return None
    gain, by = fit.parameters[[GAIN, place]].tolist()
    return _estimate(gain * by, _find_error(fit, place, [by, gain]), "1")


def _find_error(fit: AxisFit, place: int, slope: list[float]) -> float:
    """Return the standard error of a function of the gain and a further parameter."""
    rows = np.ix_([GAIN, place], [GAIN, place])
    return float(np.sqrt(max(float(slope @ fit.covariance[rows] @ slope), 0.0)))


def _estimate_deadband(fit: AxisFit, unit: str) -> Estimate | None:
    """Return the deadband, between the commands without motion and those with motion."""
    low = fit.model.structure.deadband
    if not low:
        return None
    sizes = np.abs(np.concatenate([motion.commands.value for motion in fit.model.motions]))
    high = float(sizes[sizes > low].min())
    return Estimate(value=0.5 * (low + high), low=low, high=high, unit=unit)


def _measure_whiteness(white: Values) -> float | None:
    """Return the mean square of the changes divided by twice the mean square; noise has 1."""
    squares = float(np.mean(white**2))
    return float(np.mean(np.diff(white) ** 2)) / (2.0 * squares) if squares > 0.0 else None


# How well a fit explains its motion, and how well other structures would.


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
