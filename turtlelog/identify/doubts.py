"""Doubts about a fit: structures that the log cannot distinguish, and a second estimate.

Doubts widen the intervals until they cover the alternatives, and are reported.

The second estimate uses no model: it is the delay with the largest correlation of commands and
motion. A flat correlation gives no single delay. Therefore the result is a range: the delays that
explain the motion as well as the best delay, within the differences between parts of the log.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
import scipy
from numpy.typing import NDArray

from turtlelog.display import join_words
from turtlelog.identify.axis_fit import DEAD_TIME, GAIN, LAG, TOTAL, AxisFit, solve_part
from turtlelog.identify.axis_motion import NAMES, Axis, AxisMotion
from turtlelog.identify.held_response import Values
from turtlelog.identify.refused_axes import find_repetition
from turtlelog.identify.robot_model import AxisModel, Estimate
from turtlelog.identify.robot_noise import LEAST_STEP
from turtlelog.identify.robot_structure import Structure

_FIELDS: Final = ("gain", "dead_time_s", "lag_s", "total_delay_s")
_LIMITS: Final = (
    *("rate_limit", "rate_limit_beside", "jerk_time_s", "bound", "bound_beside"),
    *("deadband", "reverse_gain", "friction"),
)
"""Further parameters of structures; their values may differ between two structures."""

_FEWEST: Final = 50
"""Smallest number of steps of a part of the motion with values of its own."""

_APART: Final = 4.0
"""Smallest unexplained difference between two parts of the motion, in standard deviations. By
chance, such a difference occurs in 1 of 800 robots with 20 differences each."""

_LIKELY: Final = 2.0
"""The same limit if the residual is a curve, so that some difference is likely."""

_CURVE: Final = 4.0
"""Correlation of neighbouring residuals from which they form a curve, in standard deviations. Of
240 robots that the model explains, one exceeds 3; most other robots exceed 10."""

_IN_TURNS: Final = 0.1
"""Smallest negative correlation of the nearest residuals that matters. The lower bound of the
assumed slip alone causes 0.01 or 0.02: significant in a long log, but harmless."""

_NEIGHBOURS_S: Final = 0.5
"""Largest time between neighbours [s]: the duration of a usual robot's step response."""

_MOST: Final = 3.0
"""Limit of residuals in this comparison, in standard deviations."""

_TELLS: Final = 1.05
"""Growth factor of an interval from which the growth is reported."""

_MATTERS: Final = 0.01
"""Half-width of an interval from which a doubt is reported, as a share of the gain or of the total
delay. Below this share, no recommended gain changes by more than 1 %. A simulated log without noise
has a curve in the eighth digit."""


def cover_rivals(
    found: AxisModel, structure: Structure, others: Sequence[tuple[Structure, AxisModel]]
) -> AxisModel:
    """Return an axis with intervals that cover those of equally good structures."""
    covered = found
    for _, other in others:
        for field in (*_FIELDS, *_LIMITS):
            covered = _widen(covered, field, getattr(other, field))
    if not (_is_wider(found, covered) and _matters(covered)):
        return covered
    rivals = describe_rivals([structure, *(one for one, _ in others)])
    doubt = (
        f"The log does not show what limits the {NAMES[found.axis]}: {rivals}."
        " The intervals cover both cases, and advice uses the longer delay."
    )
    return replace(covered, doubts=(*found.doubts, doubt))


def cover_waiting(found: AxisModel, other: AxisModel) -> AxisModel:
    """Return an axis in doubt that may wait for the other axis, whose delays it then has, too."""
    covered = found
    for field in ("dead_time_s", "total_delay_s"):
        covered = _widen(covered, field, getattr(other, field))
    name, beside = NAMES[found.axis], NAMES[other.axis]
    doubt = (
        f"Nearly all changes of the {name} come together with changes of the {beside}. The log does"
        f" not show whether the {name} only waits for the {beside}, and advice uses the longer"
        " delay."
    )
    return replace(covered, doubts=(*found.doubts, doubt))


def describe_rivals(structures: Sequence[Structure]) -> str:
    """Return the further parameters of structures; parameters common to all appear once."""
    parts = [_list_parts(one) for one in structures]
    shared = [part for part in parts[0] if all(part in other for other in parts)]
    own = [[part for part in one if part not in shared] for one in parts]
    if not shared:
        return join_words([join_words(one) or "one time constant alone" for one in own], "or")
    ways = [f"with {join_words(one)}" if one else "alone" for one in own]
    return f"{join_words(shared)}, {join_words(sorted(ways, key='alone'.__ne__), 'or')}"


def _list_parts(structure: Structure) -> list[str]:
    parts = {
        "second_order": "a second time constant",
        "limited_before": "a limit of the acceleration before the time constant",
        "limited_softly": "limits of the acceleration and the jerk before the time constant",
        "limited_within": "a limit of the acceleration within the velocity loop",
        "limited_wheels": "a limit of the acceleration of each wheel",
    }
    said = [parts[structure.order]] if structure.order in parts else []
    bounds = {
        "command": "a bound of the command",
        "rate": "a bound of the rate",
        "scaled": "a bound of the wheels that scales both axes",
        "clipped": "a bound of each wheel",
        "yielding": "a bound of the wheels that the other axis uses first",
        "reduced": "a reduction by the other axis",
    }
    said += [bounds[structure.bound]] if structure.bound else []
    said += ["another gain backwards"] if structure.has_reverse else []
    said += ["friction"] if structure.has_friction else []
    said += ["a deadband"] if structure.deadband else []
    return said


def cover_parts(found: AxisModel, fit: AxisFit) -> AxisModel:
    """Return an axis with intervals that cover the differing values of parts of the motion.

    If the model explains the motion, all parts give the same values: small and large commands,
    positive and negative, rising and falling ones, both halves of the log, and commands with and
    without the other axis. If the residual is a curve, smaller differences count, and all intervals
    grow by the correlation of neighbours.
    """
    excess = _measure_curve(fit)
    is_curve = excess > _CURVE
    covered, said = found, []
    if is_curve:
        for field in (*_FIELDS, *_LIMITS):
            covered = _stretch(covered, field, _measure_sharing(fit))
    for pair, is_first in _split_steps(found.axis, fit):
        differing = [*_compare_parts(fit, is_first, _LIKELY if is_curve else _APART)]
        for field, values in differing:
            for value in values:
                covered = _widen(covered, field, value)
        if differing:
            said.append(pair)
    if not (said or is_curve) or not _matters(covered):
        return covered
    told = ", and between ".join(said)
    what = f" The response differs between {told}." if said else ""
    doubt = (
        f"No model explains the {NAMES[found.axis]} completely.{what} The intervals are wider for"
        " that, and advice uses the longer delay."
    )
    return replace(covered, doubts=(*found.doubts, doubt))


def _measure_curve(fit: AxisFit) -> float:
    """Return the correlation of neighbouring residuals, in standard deviations.

    Three groups are tested separately: the nearest residuals, those within a few steps, and those
    within a short time. If a curve is taken for noise, the nearest residuals differ and the others
    agree.
    """
    sums = [(float(one.sum()), float(one @ one)) for one in _multiply_neighbours(fit)]
    along, squares = np.cumsum(sums, axis=0).T
    excess = along / np.sqrt(np.maximum(squares, LEAST_STEP))
    white = _clip(fit)
    in_turns = -float(along[0]) / max(float(white @ white), LEAST_STEP)
    return float(max(-excess[0] if in_turns > _IN_TURNS else 0.0, *excess))


def _measure_sharing(fit: AxisFit) -> float:
    """Return the factor by which correlated neighbours increase the errors."""
    along = sum(float(one.sum()) for one in _multiply_neighbours(fit))
    white = _clip(fit)
    return float(np.sqrt(max(1.0 + 2.0 * along / max(float(white @ white), LEAST_STEP), 1.0)))


def _multiply_neighbours(fit: AxisFit) -> Iterator[Values]:
    """Yield the products of residuals of steps and later ones, within a short time."""
    white = _clip(fit)
    reach = int(_NEIGHBOURS_S / float(np.median(fit.model.duration_s)))
    for lag in range(1, min(max(reach, 2), len(white) - 1) + 1):
        yield white[lag:] * white[:-lag]


def _clip(fit: AxisFit) -> Values:
    """Return residuals, limited so that no outlier dominates."""
    return np.where(fit.is_outlier, 0.0, np.clip(fit.white, -_MOST, _MOST))


def _split_steps(axis: Axis, fit: AxisFit) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Yield divisions of the steps by one criterion: whether the first of two commands acts."""
    dead_time_s = float(fit.parameters[DEAD_TIME])
    acting, before, beside = [], [], []
    for motion in fit.model.motions:
        end_s = motion.time_s[motion.first + 1] - dead_time_s
        held = motion.commands.place(end_s).held
        acting.append(motion.commands.value[held])
        before.append(motion.commands.value[np.maximum(held - 1, 0)])
        other = motion.beside
        beside.append(0.0 * end_s if other is None else other.value[other.place(end_s).held])
    value, earlier = np.concatenate(acting), np.concatenate(before)
    change = np.abs(value - earlier)
    yield "small and large commands", change <= float(np.median(change))
    yield "positive and negative commands", value + earlier > 0.0
    yield "rising and falling commands", np.abs(value) > np.abs(earlier)
    yield "earlier and later commands", np.arange(len(value)) < len(value) // 2
    other_name = NAMES["turn_rate" if axis == "speed" else "speed"]
    yield f"commands with and without a {other_name}", np.concatenate(beside) != 0.0


def _compare_parts(
    fit: AxisFit, is_first: NDArray[np.bool_], apart: float
) -> Iterator[tuple[str, list[Estimate]]]:
    """Yield the values that differ between two parts of the motion."""
    counted = ~fit.is_outlier
    parts = [counted & is_first, counted & ~is_first]
    if min(int(np.count_nonzero(part)) for part in parts) < _FEWEST:
        return
    solved = [solve_part(fit, part) for part in parts]
    for field, weights in _list_contrasts(len(fit.parameters)).items():
        moves = [float(weights @ moved) for moved, _ in solved]
        variances = [float(weights @ covariance @ weights) for _, covariance in solved]
        if min(variances) <= 0.0:  # a part without information on the value, up to rounding
            continue
        error = float(np.sqrt(sum(variances)))
        if abs(moves[0] - moves[1]) > apart * error:
            value = _evaluate(fit, field)
            yield (
                field,
                [
                    Estimate(value=value + moved, low=value + moved, high=value + moved)
                    for moved in moves
                ],
            )


def _list_contrasts(count: int) -> dict[str, Values]:
    """Return the combination of the fit's parameters for each field."""
    units = np.eye(count)
    return {
        "gain": units[GAIN],
        "dead_time_s": units[TOTAL] - units[LAG],
        "lag_s": units[LAG],
        "total_delay_s": units[TOTAL],
    }


def _evaluate(fit: AxisFit, field: str) -> float:
    gain, dead_time_s, lag_s = fit.parameters[: LAG + 1].tolist()
    values = {
        "gain": gain,
        "dead_time_s": dead_time_s,
        "lag_s": lag_s,
        "total_delay_s": dead_time_s + lag_s,
    }
    return float(values[field])


def _stretch(axis: AxisModel, field: str, factor: float) -> AxisModel:
    """Return an axis with the interval of a field widened by a factor, but not below 0."""
    own = getattr(axis, field)
    if own is None:
        return axis
    low, high = (own.value + factor * (end - own.value) for end in (own.low, own.high))
    return replace(axis, **{field: replace(own, low=max(low, 0.0), high=high)})


def _widen(axis: AxisModel, field: str, other: Estimate | None) -> AxisModel:
    """Return an axis with the interval of a field extended to another interval, but not below 0."""
    own = getattr(axis, field)
    if own is None or other is None:
        return axis
    low, high = min(own.low, max(other.low, 0.0)), max(own.high, other.high)
    return replace(axis, **{field: replace(own, low=low, high=high)})


def _matters(covered: AxisModel) -> bool:
    """Return whether an interval of an axis is wide enough to change the advice."""
    total = covered.total_delay_s
    for field in _FIELDS:
        own = getattr(covered, field)
        whole = own if field == "gain" or total is None else total
        if max(own.high - own.value, own.value - own.low) >= _MATTERS * whole.value:
            return True
    return False


def _is_wider(found: AxisModel, covered: AxisModel) -> bool:
    for field in _FIELDS:
        own, wide = getattr(found, field), getattr(covered, field)
        if wide.high - wide.low > _TELLS * (own.high - own.low):
            return True
    return False


_LARGEST_S: Final = 3.0
"""Largest delay that is searched [s]: the largest dead time and an equal time constant."""

_COARSE_S, _FINE_S = 0.05, 0.005
"""Distances of tried delays [s]: first over the whole range, then near the best delay and the
ends."""

_MOST_STEPS: Final = 20_000

_PART_S: Final = 1.0
"""Length of parts of the log that count as independent [s]: a usual time constant has faded."""

_FEWEST_PARTS: Final = 8
"""Smallest number of parts whose scatter is meaningful."""

_CHANCE: Final = 0.05
"""Probability that the range does not contain the true best delay."""

_NEAR: Final = 0.6
"""Factor of Student's t from which a delay is worse than the best. The excess residual grows with
the square of the distance, its scatter with the distance. Therefore half of t is sufficient near
the best delay. The rest is for distant delays: 96.9 % of 391 ranges contained the truth."""


def find_correlation_delay(motions: Sequence[AxisMotion]) -> tuple[Estimate | None, str]:
    """Return the delay of the motion after the commands, as the best value and a range [s].

    Commands are averaged over each step between poses, so that nothing is resampled.

    Returns:
        The delay and an empty text. If the correlation shows no delay, None and a sentence with the
        reason.
    """
    motions = [motion for motion in motions if len(motion.moved)]
    most = _MOST_STEPS // max(len(motions), 1)
    misfit = _Misfit([motion.take(slice(most)) for motion in motions])
    if misfit.parts < _FEWEST_PARTS:
        return None, (
            "the log is too short for a correlation of commands and motion, which needs"
            f" {_FEWEST_PARTS * _PART_S:g} s of motion"
        )
    if repetition := find_repetition(motions):
        shift_s, sign = repetition
        # Commands that repeat with opposite sign repeat equally after twice that time.
        period_s = shift_s if sign > 0 else 2.0 * shift_s
        return None, (
            f"the correlation of commands and motion says nothing: the commands repeat every"
            f" {period_s:.3g} s, and delays so far apart correlate alike"
        )
    coarse = np.arange(0.0, _LARGEST_S, _COARSE_S)
    near_s = float(coarse[np.argmin([misfit.measure(delay_s) for delay_s in coarse.tolist()])])
    fine = np.arange(max(near_s - _COARSE_S, 0.0), near_s + _COARSE_S, _FINE_S)
    best_s = float(fine[np.argmin([misfit.measure(delay_s) for delay_s in fine.tolist()])])
    if not misfit.is_worse(None, best_s):
        return None, "commands and motion do not clearly correlate"
    alike = [
        delay_s for delay_s in (*coarse.tolist(), best_s) if not misfit.is_worse(delay_s, best_s)
    ]
    low_s, high_s = (
        _find_end(lambda delay_s: misfit.is_worse(delay_s, best_s), end_s, step_s)
        for end_s, step_s in ((min(alike), -_FINE_S), (max(alike), _FINE_S))
    )
    usual_s = float(np.median(misfit.duration_s))
    if high_s - low_s > max(best_s, usual_s):
        return None, (
            "the correlation of commands and motion says nothing: it does not tell delays from"
            f" {1e3 * low_s:.0f} to {1e3 * high_s:.0f} ms apart"
        )
    return Estimate(value=best_s, low=low_s, high=high_s), ""


def _find_end(is_worse: Callable[[float], bool], begin_s: float, step_s: float) -> float:
    """Return the first worse delay from a start on, in steps, or the end of the range."""
    end_s = begin_s
    while 0.0 < end_s < _LARGEST_S and abs(end_s - begin_s) < _COARSE_S:
        end_s += step_s
        if is_worse(end_s):
            break
    return max(end_s, 0.0)


class _Misfit:
    """Residual of the steps' rates for delayed commands, each with the best gain and offset.

    The residual is smallest at the delay with the largest correlation.
    """

    def __init__(self, motions: Sequence[AxisMotion]) -> None:
        self._motions = motions
        self.duration_s = np.concatenate([motion.duration_s for motion in motions])
        rate = np.concatenate([motion.moved for motion in motions]) / self.duration_s
        # Clipped, so that a single jump does not decide.
        rate = np.clip(rate, *np.quantile(rate, [0.01, 0.99]))
        self._rate = rate - rate.mean()
        counts = [int(motion.duration_s.sum() / _PART_S) for motion in motions]
        first = np.cumsum([0, *counts])
        # The rest at the end of a run belongs to its last part.
        parts = [
            begin + np.minimum(np.cumsum(motion.duration_s) // _PART_S, max(count, 1) - 1)
            for begin, count, motion in zip(first.tolist(), counts, motions, strict=False)
        ]
        self._part = np.unique(np.concatenate(parts), return_inverse=True)[1]
        self.parts = sum(counts)
        self._squares: dict[float, Values] = {}

    def measure(self, delay_s: float) -> float:
        """Return the residual sum of squares for a delay."""
        return float(self._list_squares(delay_s).sum())

    def is_worse(self, delay_s: float | None, best_s: float) -> bool:
        """Return whether a delay is significantly worse; None stands for no commands.

        The excess is summed over parts of the log, whose scatter shows its uncertainty.
        """
        more = self._list_squares(delay_s) - self._list_squares(best_s)
        sums = np.bincount(self._part, weights=more)
        error = float(np.std(sums, ddof=1)) * float(np.sqrt(len(sums)))
        most = float(scipy.special.stdtrit(len(sums) - 1, 1.0 - 0.5 * _CHANCE))
        return float(sums.sum()) > _NEAR * most * error

    def _list_squares(self, delay_s: float | None) -> Values:
        if delay_s is None:
            return np.asarray(self._rate**2)
        if delay_s not in self._squares:
            self._squares[delay_s] = self._leave(delay_s)
        return self._squares[delay_s]

    def _leave(self, delay_s: float) -> Values:
        asked = np.concatenate([_command_steps(motion, delay_s) for motion in self._motions])
        asked = asked / self.duration_s
        asked -= asked.mean()
        size, along = float(asked @ asked), float(asked @ self._rate)
        # A motion against the commands is not a correlation.
        gain = along / size if size > 0.0 and along > 0.0 else 0.0
        return np.asarray((self._rate - gain * asked) ** 2)


def _command_steps(motion: AxisMotion, delay_s: float) -> Values:
    way = motion.commands.place(motion.time_s - delay_s).way
    return np.asarray(way[motion.first + 1] - way[motion.first])
