"""The values of an axis from its fit, with intervals, and doubts that widen the intervals.

Doubts are structures that the log cannot distinguish, and parts of the motion that differ. They
widen the intervals until they cover the alternatives, and are reported.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import join_words
from turtlelog.identify import axis_fit, axis_motion
from turtlelog.identify.axis_fit import DEAD_TIME, EXTRA, GAIN, LAG, NORMAL_95, TOTAL, AxisFit
from turtlelog.identify.axis_model import FURTHER, ORDERS, AxisModel, Estimate
from turtlelog.identify.axis_motion import NAMES, OTHER, UNITS, Axis, AxisMotion
from turtlelog.identify.held_response import Structure
from turtlelog.identify.robot_noise import LEAST_STEP
from turtlelog.measure.motion import measure_whiteness
from turtlelog.run import Run

_SHORT_LAG: Final = 2.0  # time constant in steps between poses up to which it may be 0

_FINEST: Final = 1e-4
"""Smallest standard error of a limit, as a share of the limit: the change over which its effect on
the motion is measured. For smaller changes the effect may be different."""


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
    acts = {order: place for place, order in ORDERS.items()} | {"limited_softly": "before_lag"}
    further: dict[str, Any] = {"limit_acts": acts.get(structure.order, "")}
    for name in structure.names:
        field, _, unit = FURTHER[name]
        unit = unit.format(own=UNITS[axis], other=UNITS[OTHER[axis]])
        further[field] = _estimate_further(fit, name, unit)
    total = _estimate_delay(fit, float(parameters[DEAD_TIME] + parameters[LAG]), (1.0, 0.0))
    dead_time, lag = _allow_no_lag(
        fit,
        _estimate_delay(fit, float(parameters[DEAD_TIME]), (1.0, -1.0)),
        _estimate_delay(fit, float(parameters[LAG]), (0.0, 1.0)),
    )
    found = AxisModel(
        axis=axis,
        status="ok",
        model="second_order" if structure.order == "second_order" else "first_order",
        gain=_estimate(float(parameters[GAIN]), float(errors[GAIN]), "1"),
        dead_time_s=dead_time,
        lag_s=lag,
        total_delay_s=total,
        bound_acts=structure.bound,
        deadband=_estimate_deadband(fit, UNITS[axis]),
        **further,
        explained=1.0 - left / spread if spread > 0.0 else None,
        whiteness=float(measure_whiteness(white)) if white.any() else None,
        outliers=int(np.count_nonzero(fit.is_outlier)),
        steps=len(fit.residual),
        changes=changes,
    )
    return _cap_parts(found)


_ROUNDING: Final = 1e-18
"""Share of the squares of the steps below which differences are rounding alone [1]."""


def _estimate_delay(fit: AxisFit, value: float, weights: Sequence[float]) -> Estimate:
    """Return a delay [s] with its interval; `weights` are its shares of total delay and lag."""
    # A time constant that only rounds the ends of ramps may be 0, but not less. So what depends on
    # it has an interval with two unequal sides.
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
    if (
        fit.model.structure.bends
        or fit.model.structure.order != "first_order"
        or lag.low <= 0.0
        or lag.value > short_s
    ):
        return dead_time, lag
    without = axis_fit.fit_without_lag(fit)
    if without.cost - fit.cost > NORMAL_95**2 * fit.dispersion:
        return dead_time, lag
    error = float(np.sqrt(without.covariance[TOTAL, TOTAL]))
    high = float(without.parameters[DEAD_TIME]) + NORMAL_95 * error
    return replace(dead_time, high=max(dead_time.high, high)), replace(lag, low=0.0)


def _estimate(value: float, error: float, unit: str = "s", least: float = 0.0) -> Estimate:
    half = NORMAL_95 * error
    return Estimate(value=value, low=max(value - half, least), high=value + half, unit=unit)


def _estimate_further(fit: AxisFit, name: str, unit: str) -> Estimate | None:
    """Return the value of an axis that a further parameter gives; None where it is infinite."""
    place, relation = EXTRA + fit.model.structure.names.index(name), FURTHER[name][1]
    gain, by = fit.parameters[[GAIN, place]].tolist()
    own_error = float(np.sqrt(max(fit.covariance[place, place], 0.0)))
    if relation == "itself":
        return _estimate(by, own_error, unit)
    if relation == "product":
        error = _find_error(fit, place, [by, gain])
        return _estimate(gain * by, error, unit, -np.inf if name == "drift" else 0.0)
    if by <= 0.0:
        return None
    if relation == "quotient":
        error = _find_error(fit, place, [1.0 / by, -gain / by**2])
        return _estimate(gain / by, max(error, _FINEST * gain / by), unit)
    high = by + NORMAL_95 * own_error
    error = max((high - by) / NORMAL_95, _FINEST * by)
    return _estimate(1.0 / by, error / by**2, unit)


def _find_error(fit: AxisFit, place: int, slope: list[float]) -> float:
    rows = np.ix_([GAIN, place], [GAIN, place])
    return float(np.sqrt(max(float(slope @ fit.covariance[rows] @ slope), 0.0)))


def _estimate_deadband(fit: AxisFit, unit: str) -> Estimate | None:
    """Return the deadband, between the commands without motion and those with motion."""
    low = fit.model.structure.deadband
    if not low:
        return None
    sizes = np.abs(fit.model.commands)
    high = float(sizes[sizes > low].min())
    return Estimate(value=0.5 * (low + high), low=low, high=high, unit=unit)


_FIELDS: Final = ("gain", "dead_time_s", "lag_s", "total_delay_s")
_LIMITS: Final = (
    *("rate_limit", "rate_limit_beside", "jerk_time_s", "bound", "bound_beside"),
    *("deadband", "reverse_gain", "friction", "drift"),
)
"""Further parameters of structures; their values may differ between two structures."""

_FEWEST: Final = 50  # smallest number of steps of a part of the motion with values of its own

_APART: Final = 4.0
"""Smallest unexplained difference between two parts of the motion, in standard deviations. By
chance, such a difference occurs in 1 of 800 robots with 20 differences each."""

_LIKELY: Final = 2.0  # same limit if the residual is a curve, so that some difference is likely

_CURVE: Final = 4.0
"""Correlation of neighbouring residuals from which they form a curve, in standard deviations. Of
240 robots that the model explains, one exceeds 3; most other robots exceed 10."""

_IN_TURNS: Final = 0.1
"""Smallest negative correlation of the nearest residuals that matters. The lower bound of the
assumed slip alone causes 0.01 or 0.02: significant in a long log, but harmless."""

_NEIGHBOURS_S: Final = 0.5
"""Largest time between neighbours [s]: the duration of a usual robot's step response."""

_MOST: Final = 3.0  # limit of residuals in this comparison, in standard deviations
_TELLS: Final = 1.05  # growth factor of an interval from which the growth is reported

_MATTERS: Final = 0.01
"""Half-width of an interval from which a doubt is reported, as a share of the gain or of the total
delay. Below this share, no recommended gain changes by more than 1 %. A simulated log without noise
has a curve in the eighth digit."""


_ROUNDED: Final = 0.5
"""Share of rounding in the variance of steps from which no difference between parts is meaningful:
the model then lacks less than the poses show. Rounding repeats itself, as noise does not."""


def cover_rivals(
    found: AxisModel, structure: Structure, others: Sequence[tuple[Structure, AxisModel]]
) -> AxisModel:
    """Return an axis with intervals that cover those of equally good structures."""
    covered = found
    for _, other in others:
        none = {"reverse_gain": other.gain, "drift": Estimate(value=0.0, low=0.0, high=0.0)}
        for field in (*_FIELDS, *_LIMITS):
            value = getattr(other, field)
            covered = _widen(covered, field, none.get(field) if value is None else value)
    pairs = [(getattr(found, field), getattr(covered, field)) for field in _FIELDS]
    is_wider = any(wide.high - wide.low > _TELLS * (own.high - own.low) for own, wide in pairs)
    if not (is_wider and _matters(covered)):
        return covered
    structures = [structure, *(one for one, _ in others)]
    may_drift = len({one.has_drift for one in structures}) > 1
    rest = " A rest of some seconds between commands would show a drift."
    which = "what acts on" if may_drift else "what limits"
    doubt = (
        f"The log does not show {which} the {NAMES[found.axis]}: {describe_rivals(structures)}. The"
        " intervals cover both cases, and advice uses the longer delay."
        f"{rest if may_drift else ''}"
    )
    return replace(covered, doubts=(*found.doubts, doubt))


_JOINTLY: Final = 0.9
"""Share of the changes of an axis together with the other axis, above which its delay alone is
unknown: one change in ten does not outweigh the others."""

_UNCOVERED: Final = " The delay of the {} is unknown, so the intervals do not cover that case."


def cover_waiting(runs: Sequence[Run], found: AxisModel, other: AxisModel) -> AxisModel:
    """Return an axis in doubt, with the other axis's delays, too, if it may wait for that axis.

    Then it is slower than the other axis and hardly changes without it.
    """
    # Wheels whose acceleration is limited turn only after they have braked. Both axes share wheels,
    # motors and odometry, so nothing else delays one of them alone.
    delay, other_delay = found.total_delay_s, other.total_delay_s
    is_slower = delay is not None and (other_delay is None or delay.low > other_delay.high)
    if not is_slower or found.limit_acts == "at_wheels":
        return found
    motions = [axis_motion.read_axis_motion(run, found.axis) for run in runs]
    joint = np.concatenate([find_joint_changes(motion) for motion in motions])
    if np.mean(joint) < _JOINTLY:
        return found
    covered = found
    for field in ("dead_time_s", "total_delay_s"):
        covered = _widen(covered, field, getattr(other, field))
    name, beside = NAMES[found.axis], NAMES[other.axis]
    doubt = (
        f"Nearly all changes of the {name} come together with changes of the {beside}. The log does"
        f" not show whether the {name} only waits for the {beside}, and advice uses the longer"
        f" delay.{'' if other.is_known else _UNCOVERED.format(beside)}"
    )
    return replace(covered, doubts=(*found.doubts, doubt))


def find_joint_changes(motion: AxisMotion) -> NDArray[np.bool_]:
    """Return whether each change of the command comes together with one of the other axis."""
    changes_s = motion.commands.time_s[1:]
    others_s = np.empty(0) if motion.beside is None else motion.beside.time_s[1:]
    first = np.searchsorted(others_s, changes_s - axis_motion.AT_ONCE_S)
    return np.asarray(
        first < np.searchsorted(others_s, changes_s + axis_motion.AT_ONCE_S, side="right")
    )


def describe_rivals(structures: Sequence[Structure]) -> str:
    """Return the further parameters of structures; parameters common to all appear once."""
    parts = [_list_parts(one) for one in structures]
    shared = [part for part in parts[0] if all(part in other for other in parts)]
    own = [[part for part in one if part not in shared] for one in parts]
    if not shared:
        return join_words([join_words(one) or "one time constant alone" for one in own], "or")
    ways = [f"with {join_words(one)}" if one else "alone" for one in own]
    return f"{join_words(shared)}, {join_words(sorted(ways, key='alone'.__ne__), 'or')}"


_PARTS: Final = {
    "second_order": "a second time constant",
    "limited_before": "a limit of the acceleration before the time constant",
    "limited_softly": "limits of the acceleration and the jerk before the time constant",
    "limited_within": "a limit of the acceleration within the velocity loop",
    "limited_wheels": "a limit of the acceleration of each wheel",
    "command": "a bound of the command",
    "rate": "a bound of the rate",
    "scaled": "a bound of the wheels that scales both axes",
    "clipped": "a bound of each wheel",
    "yielding": "a bound of the wheels that the other axis uses first",
    "reduced": "a reduction by the other axis",
    "has_reverse": "another gain backwards",
    "has_friction": "friction",
    "has_drift": "a drift",
    "deadband": "a deadband",
}
"""Words for the further parameters: by order, by bound, and by field of a structure."""


def _list_parts(structure: Structure) -> list[str]:
    names = "has_reverse", "has_friction", "deadband", "has_drift"
    fields = [one for one in names if getattr(structure, one)]
    return [_PARTS[one] for one in (structure.order, structure.bound, *fields) if one in _PARTS]


def cover_parts(found: AxisModel, fit: AxisFit) -> AxisModel:
    """Return an axis with intervals that cover the differing values of parts of the motion.

    If the model explains the motion, all parts give the same values: small and large commands,
    positive and negative, rising and falling ones, both halves of the log, and commands with and
    without the other axis. If the residual is a curve, smaller differences count, and all intervals
    grow by the correlation of neighbours.
    """
    if fit.whitening.noise.rounded > _ROUNDED:
        return found
    excess, factor = _measure_curve(fit)
    covered, differing = found, find_differing_parts(found.axis, fit)
    if excess > _CURVE:
        for field in (*_FIELDS, *_LIMITS):
            covered = _stretch(covered, field, factor)
    for values in differing.values():
        for field, value in values:
            covered = _widen(covered, field, value)
    covered = _cap_parts(covered)
    if not (differing or excess > _CURVE) or not _matters(covered):
        return covered
    told = ", and between ".join(differing)
    what = f" The response differs between {told}." if differing else ""
    doubt = (
        f"No model explains the {NAMES[found.axis]} completely.{what} The intervals are wider for"
        " that, and advice uses the longer delay."
    )
    return replace(covered, doubts=(*found.doubts, doubt))


def find_differing_parts(axis: Axis, fit: AxisFit) -> dict[str, list[tuple[str, Estimate]]]:
    """Return the parts of the motion whose values differ, by name, with these fields and values."""
    if fit.whitening.noise.rounded > _ROUNDED:
        return {}
    apart = _LIKELY if _measure_curve(fit)[0] > _CURVE else _APART
    pairs = axis_motion.divide_steps(fit.model.motions, axis, float(fit.parameters[DEAD_TIME]))
    found = {pair: [*_compare_parts(fit, part, apart)] for pair, part in pairs}
    return {pair: values for pair, values in found.items() if values}


def _measure_curve(fit: AxisFit) -> tuple[float, float]:
    """Return the correlation of neighbouring residuals, in standard deviations.

    The second number is the factor by which correlated neighbours increase the errors.

    Three groups are tested separately: the nearest residuals, those within a few steps, and those
    within a short time. If a curve is taken for noise, the nearest residuals differ and the others
    agree.
    """
    # Limited, so that no outlier dominates.
    white = np.where(fit.is_outlier, 0.0, np.clip(fit.white, -_MOST, _MOST))
    reach = int(_NEIGHBOURS_S / float(np.median(fit.model.duration_s)))
    lags = range(1, min(max(reach, 2), len(white) - 1) + 1)
    products = [white[lag:] * white[:-lag] for lag in lags]
    sums = [(float(one.sum()), float(one @ one)) for one in products]
    along, squares = np.cumsum(sums, axis=0).T
    excess = along / np.sqrt(np.maximum(squares, LEAST_STEP))
    size = max(float(white @ white), LEAST_STEP)
    turns = -excess[0] if -float(along[0]) / size > _IN_TURNS else 0.0
    total = sum(one for one, _ in sums)
    return float(max(turns, *excess)), float(np.sqrt(max(1.0 + 2.0 * total / size, 1.0)))


def _compare_parts(
    fit: AxisFit, is_first: NDArray[np.bool_], apart: float
) -> Iterator[tuple[str, Estimate]]:
    """Yield the values that differ between two parts of the motion, from the one to the other."""
    counted = ~fit.is_outlier
    parts = [counted & is_first, counted & ~is_first]
    if min(int(np.count_nonzero(part)) for part in parts) < _FEWEST:
        return
    solved = [axis_fit.solve_part(fit, part) for part in parts]
    gain, dead_time_s, lag_s = fit.parameters[: LAG + 1].tolist()
    units = np.eye(len(fit.parameters))
    for field, weights, value in (
        ("gain", units[GAIN], gain),
        ("dead_time_s", units[TOTAL] - units[LAG], dead_time_s),
        ("lag_s", units[LAG], lag_s),
        ("total_delay_s", units[TOTAL], dead_time_s + lag_s),
        *zip(
            fit.model.structure.names, units[EXTRA:], fit.parameters[EXTRA:].tolist(), strict=True
        ),
    ):
        moves = [float(weights @ moved) for moved, _ in solved]
        variances = [float(weights @ covariance @ weights) for _, covariance in solved]
        if min(variances) <= 0.0:  # a part without information on the value, up to rounding
            continue
        error = float(np.sqrt(sum(variances)))
        if abs(moves[0] - moves[1]) > apart * error:
            ends = [value + move for move in moves]
            if field in FURTHER:
                ends = [_evaluate_further(fit, field, end) for end in ends]
                field = FURTHER[field][0]
            yield field, Estimate(value=value, low=min(ends), high=max(ends))


def _evaluate_further(fit: AxisFit, name: str, by: float) -> float:
    """Return the value of an axis for a further parameter; infinite where there is no limit."""
    relation = FURTHER[name][1]
    gain = float(fit.parameters[GAIN]) if relation in {"product", "quotient"} else 1.0
    if relation in {"itself", "product"}:
        return gain * by
    return gain / by if by > 0.0 else np.inf


def _stretch(axis: AxisModel, field: str, factor: float) -> AxisModel:
    own = getattr(axis, field)
    if own is None:
        return axis
    low, high = (own.value + factor * (end - own.value) for end in (own.low, own.high))
    return replace(axis, **{field: replace(own, low=max(low, _find_least(field)), high=high)})


def _widen(axis: AxisModel, field: str, other: Estimate | None) -> AxisModel:
    """Return an axis with the interval of a field extended; only a drift may be below 0."""
    own = getattr(axis, field)
    if own is None or other is None:
        return axis
    low, high = min(own.low, max(other.low, _find_least(field))), max(own.high, other.high)
    return replace(axis, **{field: replace(own, low=low, high=high)})


def _cap_parts(axis: AxisModel) -> AxisModel:
    """Return an axis whose dead time and time constant, as both are positive, are below the sum."""
    dead_time, lag, total = axis.dead_time_s, axis.lag_s, axis.total_delay_s
    if dead_time is None or lag is None or total is None:
        return axis
    dead_time, lag = (replace(one, high=min(one.high, total.high)) for one in (dead_time, lag))
    return replace(axis, dead_time_s=dead_time, lag_s=lag)


def _find_least(field: str) -> float:
    return -np.inf if field == "drift" else 0.0


def _matters(covered: AxisModel) -> bool:
    """Return whether an interval of an axis is wide enough to change the advice."""
    total = covered.total_delay_s
    for field in _FIELDS:
        own = getattr(covered, field)
        whole = own if field == "gain" or total is None else total
        if max(own.high - own.value, own.value - own.low) >= _MATTERS * whole.value:
            return True
    return False
