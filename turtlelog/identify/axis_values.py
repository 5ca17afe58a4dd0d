"""The values of an axis with their intervals, from a fit."""

from collections.abc import Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Final, Literal

import numpy as np

from turtlelog.identify.axis_fit import (
    DEAD_TIME,
    EXTRA,
    GAIN,
    LAG,
    NORMAL_95,
    TOTAL,
    AxisFit,
    fit_without_lag,
)
from turtlelog.identify.axis_motion import UNITS, Axis
from turtlelog.identify.held_response import Values
from turtlelog.identify.robot_model import AxisModel, Estimate
from turtlelog.identify.robot_structure import FIRST_ORDER

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
