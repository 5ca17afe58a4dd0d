"""Structures beyond one time constant: a second one, limits of acceleration or speed, a drift.

More parameters always reduce the residual. Therefore another structure must reduce the residual
clearly, and change the robot's response noticeably. After a fit to only a part of the log, it must
also predict the rest better. Structures that the log cannot distinguish are called rivals.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Final, get_args

import numpy as np

from turtlelog.arithmetic import SETTLING_BAND
from turtlelog.identify import axis_fit
from turtlelog.identify.axis_fit import EXTRA, GAIN, LAG, AxisFit
from turtlelog.identify.axis_model import LEAST_BELOW
from turtlelog.identify.axis_motion import RESTED_S, AxisMotion, Parts, find_rests, split_motions
from turtlelog.identify.held_response import COUPLED, LIMITED_WHEELS, Order, Structure, Values
from turtlelog.identify.robot_noise import LEAST_STEP, Whitening

_ASKS: Final = 8.0
"""Possible decrease of the sum of squares from which a further parameter is tried, in variances;
chance reaches it in 0.5 % of robots."""

_CLEARLY: Final = 15.0
"""Required decrease of twice the negative log-likelihood; chance reaches it in 1 of 10,000
robots."""

_MATTERS: Final = SETTLING_BAND
"""Required change of some step between poses, as a share of the largest rate."""

_DRIFTS: Final = 0.002
"""The same share for a drift. A drift also acts at rest: in ten seconds it moves a robot as far as
a change of 2 % does in one second."""

_AT_REST: Final = 0.5
"""Smallest share of a drift that the mean rate at rest must have, to be nearer to it than to rest.
A robot that only veers while it drives does not drift."""

_SURELY: Final = 4.0
"""Standard deviations from which steps without the other axis show a drift: by chance in 1 of
30,000 robots, and each robot has several such fits."""

_PREDICTED: Final = 1.0
"""Required decrease of twice the negative log-likelihood for the predicted steps, with the
uncertainty of the fitted ones. Noise alone decreases it by 1 in 1 of 27 robots. With 2.0, which
noise never reached, limits are missed that a log just shows."""

# Values at which the searches for further parameters start.
_LEAST_LAG_S: Final = 0.02  # time constant for a second one, if the first is nearly 0 [s]
_STARTS_S: Final = (0.1, 0.5)  # durations of the largest change of a limited command [s]
_JERK_TIMES_S: Final = (0.05, 0.2)  # times in which a slope builds up [s]
_TRACKS: Final = (0.2, 0.6, 1.5)
"""Largest change of a wheel by commands of the other axis, as a share of that by its own."""
_FRICTIONS: Final = (0.05, 0.15)  # shares of the largest command
_BOUNDS: Final = (0.2, 0.4, 0.6, 0.75, 0.9)  # shares of the largest command
_ALONE: Final = (0.3, 0.6, 0.9, 1.5, 3.0)
_BESIDE: Final = (0.25, 0.4, 0.6, 0.8, 0.95)
"""The same shares for a limit of the wheels, and those of the largest command of the other axis.
Commands may reach this limit only together."""


_DEADBANDS: Final = 12
"""Number of magnitudes up to half of the largest command that are tried as deadband, and then
between the neighbours of the best one, until they are adjacent."""

_RIVAL: Final = 10.0
"""Difference of twice the negative log-likelihood up to which a log cannot decide between two
structures with equally many parameters: odds of 150 to 1."""

_DOUBTFUL: Final = 6.0
"""Decrease from which a rejected structure with a further parameter is still a rival; chance
reaches it in 1.5 % of robots."""

_SOFTENS: Final = 2.0
"""The same decrease for a limit of the jerk, which moves the dead time by half the time in which
the slope builds up: by chance, 7 % of robots with a limit of the acceleration before the time
constant have this rival. Of 160 with such a jerk, one was missed; with 4.0, three of 60 were."""

_MOST_CHANGES: Final = 20_000  # commands for the search of a limit, which takes them one by one

Starts = list[tuple[float, ...]]
"""Start values of further parameters."""

_Tried = dict[Structure, AxisFit]
_Neighbours = Iterable[tuple[Structure, Starts]]


def choose_structure(fit: AxisFit, *, tries_wheels: bool = True) -> tuple[AxisFit, list[AxisFit]]:
    """Return the fit of the best structure for the motion, and the fits of its rivals.

    Friction with a steep gain looks like a deadband if few commands are small, and a search that
    begins with friction never leaves it. Therefore such a search is repeated without friction.
    """
    splits = split_motions(fit.model.motions)
    if not all(known for known, _ in splits):
        return fit, []
    tried: _Tried = {}
    found = _search(fit, tried, splits, _list_neighbours)
    if found.model.structure.has_friction:
        smooth = {one: other for one, other in tried.items() if not one.has_friction}
        other = _search(fit, smooth, splits, partial(_list_neighbours, frictions=()))
        tried |= smooth
        if measure_score(other) < measure_score(found) and _is_better(found, other, splits):
            found = other
    # A limit of the wheels' acceleration has no further parts: a search ends there.
    if tries_wheels:
        found = _search(found, tried, splits, _list_wheels)
    return found, [rival for rival in tried.values() if is_rival(found, rival)]


def _search(
    fit: AxisFit, tried: _Tried, splits: Sequence[Parts], find: Callable[[AxisFit], _Neighbours]
) -> AxisFit:
    while True:
        fit = _try_neighbours(fit, tried, find(fit))
        for other in sorted(tried.values(), key=measure_score):
            if other is fit:
                return fit
            if _is_better(fit, other, splits):
                fit = other
                break


def _try_neighbours(fit: AxisFit, tried: _Tried, neighbours: _Neighbours) -> AxisFit:
    """Fit the neighbouring structures of a structure; return its own fit, possibly improved."""
    tried[fit.model.structure] = fit
    for structure, starts in neighbours:
        if structure not in tried and (chosen := _choose_starts(fit, structure, starts)):
            other = axis_fit.refit_axis(fit, structure, chosen)
            if shows_gain(other) and shows_drift(other) and shows_friction(other):
                tried[structure] = other
    near = min(tried.values(), key=lambda one: one.badness)
    if near is not fit:
        # If another structure has left a local minimum, this one may follow.
        fit = min(fit, axis_fit.restart_axis(fit, near.parameters), key=lambda one: one.badness)
        tried[fit.model.structure] = fit
    return fit


def _is_better(fit: AxisFit, other: AxisFit, splits: Sequence[Parts]) -> bool:
    if other.model.structure.size <= fit.model.structure.size:
        return True
    gains = (compare_predictions(fit, other, *parts) for parts in splits)
    return is_distinct(fit, other) and sum(gains) > _PREDICTED


def measure_score(fit: AxisFit) -> float:
    """Return a measure of a fit's misfit and number of parameters."""
    return fit.badness + _CLEARLY * fit.model.structure.size


def is_rival(fit: AxisFit, other: AxisFit) -> bool:
    """Return whether the log cannot exclude another structure."""
    more = other.model.structure.size - fit.model.structure.size
    if other is fit or more < 0:
        return False
    least = _SOFTENS if is_soft(fit.model.structure, other.model.structure) else _DOUBTFUL
    return other.badness - fit.badness <= (-least if more else _RIVAL)


def is_distinct(fit: AxisFit, other: AxisFit) -> bool:
    """Return whether another structure has a clearly smaller residual and a different response."""
    errors = np.sqrt(np.maximum(np.diag(other.covariance)[EXTRA:], 0.0)).tolist()
    for (name, value), error in zip(other.extras.items(), errors, strict=True):
        off = abs(value - (1.0 if name == "reverse" else 0.0))
        if name not in fit.extras and off <= axis_fit.NORMAL_95 * error:
            return False
    if fit.badness - other.badness < _CLEARLY or other.parameters[GAIN] <= 0.0:
        return False
    if is_soft(fit.model.structure, other.model.structure):
        return True
    has_drift = [one.model.structure.has_drift for one in (fit, other)]
    return measure_effect(fit, other) >= (_DRIFTS if has_drift == [False, True] else _MATTERS)


def is_soft(structure: Structure, other: Structure) -> bool:
    """Return whether another structure only adds a limit of the jerk, which moves the dead time."""
    return {*other.names} - {*structure.names} == {"jerk_time"}


def shows_gain(fit: AxisFit) -> bool:
    """Return whether enough commands stay below the bound of a fit to determine its gain."""
    tightness = fit.extras.get("tightness")
    if tightness is None:
        return True
    below_s = moving_s = 0.0
    for motion in fit.model.motions:
        held_s = np.diff(motion.commands.time_s, append=motion.time_s[-1])
        size = np.abs(motion.commands.value)
        moves = size > fit.model.structure.deadband
        moving_s += float(held_s[moves].sum())
        below_s += float(held_s[moves & (tightness * size < 1.0)].sum())
    return below_s >= LEAST_BELOW * moving_s


def shows_drift(fit: AxisFit) -> bool:
    """Return whether the rests of a log show the drift of a fit, if it has one.

    In a log without rests, the steps while the other axis rests must show it, because turning may
    look like a drift. If the other axis never rests, all steps must show it beside a motion that is
    proportional to its commands.
    """
    drift = fit.extras.get("drift")
    if drift is None:
        return True
    gain, dead_time_s, lag_s = fit.parameters[: LAG + 1].tolist()
    at_rest = find_rests(fit.model.motions, dead_time_s, lag_s) & ~fit.is_outlier
    before_s, before = np.sum([one.rested for one in fit.model.motions], axis=0).tolist()
    rested_s = before_s + float(fit.model.duration_s[at_rest].sum())
    if rested_s >= RESTED_S:
        off = float(fit.residual[at_rest].sum()) + before - gain * drift * before_s
        off = off / rested_s / gain if gain > 0.0 else 0.0
        return bool((drift + off) * drift > _AT_REST * drift**2)
    alone = np.concatenate([one.is_alone(dead_time_s) for one in fit.model.motions])
    alone &= ~fit.is_outlier
    beside = []
    if np.count_nonzero(alone) <= len(fit.parameters):
        alone, beside = ~fit.is_outlier, [fit.model.predict_beside(dead_time_s)]
    moves, covariance = axis_fit.solve_part(fit, alone, *beside)
    row = len(fit.parameters) - 1  # a drift is the last further parameter
    surely = _SURELY * float(np.sqrt(max(covariance[row, row], 0.0)))
    return bool((drift + moves[row]) * np.sign(drift) > surely)


def shows_friction(fit: AxisFit) -> bool:
    """Return whether a robot rests before its first command, if a fit has friction.

    A drift against the commands takes as much off each, but moves the robot before them, too.
    """
    taken = fit.extras.get("friction", 0.0) * float(fit.parameters[GAIN])
    waited_s, moved = np.sum([one.waited for one in fit.model.motions], axis=0).tolist()
    return bool(waited_s < RESTED_S or abs(moved) <= _AT_REST * taken * waited_s or not taken)


def measure_effect(fit: AxisFit, other: AxisFit) -> float:
    """Return the largest difference of two models in a step, as a fraction of the largest rate."""
    rates = [
        (one.model.linearise(one.parameters)[0] / one.model.duration_s)[~other.is_outlier]
        for one in (fit, other)
    ]
    return float(np.abs(rates[0] - rates[1]).max() / max(np.abs(rates[0]).max(), LEAST_STEP))


def _list_neighbours(fit: AxisFit, frictions: Sequence[float] = _FRICTIONS) -> _Neighbours:
    """Yield structures with one difference, with start values of their further parameters."""
    structure, known, commands = fit.model.structure, fit.extras, fit.model.commands
    levels = np.unique(np.abs(commands))

    def start(other: Structure, **value: float) -> tuple[float, ...]:
        return tuple((known | value)[name] for name in other.names)

    yield from _list_orders(fit)
    largest, turns_back = float(levels[-1]), commands.min() < 0.0 < commands.max()
    bounds = [known["tightness"]] if "tightness" in known else []
    bounds += [1.0 / (share * largest) for share in _BOUNDS]
    for other, name, values in (
        (replace(structure, bound="command"), "tightness", bounds),
        (replace(structure, bound="rate"), "tightness", bounds),
        (replace(structure, has_reverse=True), "reverse", [1.0] if turns_back else []),
        (
            replace(structure, has_friction=True),
            "friction",
            [share * largest for share in frictions],
        ),
        (replace(structure, has_drift=True), "drift", [_find_drift(fit)]),
    ):
        if values and other != structure and _is_open(other, commands):
            yield other, [start(other, **{name: value}) for value in values]
    yield from _list_coupled(fit, largest)
    small = levels[(levels > 0.0) & (levels <= 0.5 * levels[-1])]
    for deadband in _find_deadbands(fit, small) if len(small) else []:
        other = replace(structure, deadband=deadband)
        yield other, [start(other)]


def _list_orders(fit: AxisFit) -> _Neighbours:
    structure, known, commands = fit.model.structure, fit.extras, fit.model.commands
    lag_s = max(float(fit.parameters[LAG]), _LEAST_LAG_S)
    span = max(float(np.ptp(commands)), LEAST_STEP)
    if known.get("tightness", 0.0) > 0.0:  # commands beyond the bound change no more than it
        span = min(span, 2.0 / known["tightness"])
    slowness = [known["slowness"]] if "slowness" in known else []
    tries = {
        "product": [share * lag_s**2 for share in (0.1, 0.25, 1.0)],
        "slowness": [*slowness, *(start_s / span for start_s in _STARTS_S)],
        "jerk_time": [*_JERK_TIMES_S],
    }
    for order in get_args(Order):
        other = replace(structure, order=order)
        if other == structure or order == "limited_wheels" or not _is_open(other, commands):
            continue
        if order == "limited_softly" and structure.order != "limited_before":
            continue
        name = next((name for name in reversed(other.names) if name in tries), "")
        values = [known | {name: value} for value in tries.get(name, [0.0])]
        yield other, [tuple(one[name] for name in other.names) for one in values]


def _list_wheels(fit: AxisFit) -> _Neighbours:
    """Yield a limit of the wheels' acceleration; nothing if the other axis rests."""
    known, commands = fit.extras, fit.model.commands
    span = max(float(np.ptp(commands)), LEAST_STEP)
    ranges = [float(np.ptp(one.beside.value)) for one in fit.model.motions if one.beside]
    beside = max(ranges, default=0.0)
    if beside and _is_open(LIMITED_WHEELS, commands):
        slow = [known["slowness"]] if "slowness" in known else [one / span for one in _STARTS_S]
        yield LIMITED_WHEELS, [(one, one * by * span / beside) for one in slow for by in _TRACKS]


def _list_coupled(fit: AxisFit, largest: float) -> _Neighbours:
    """Yield limits of the wheels; none if the other axis rests, or the first is not promising."""
    others = [motion.beside.value for motion in fit.model.motions if motion.beside is not None]
    beside = float(np.abs(np.concatenate([np.zeros(1), *others])).max())
    if not beside:
        return
    known = fit.extras
    alone = [known["tightness"]] if "tightness" in known else []
    alone += [1.0 / (share * largest) for share in _ALONE]
    couplings = [known["coupling"]] if "coupling" in known else []
    couplings += [1.0 / (share * beside) for share in _BESIDE]
    for bound in COUPLED:
        other = replace(fit.model.structure, bound=bound)
        starts: Starts = [
            tuple((known | {"tightness": one, "coupling": two})[name] for name in other.names)
            for one, two in product(alone if "tightness" in other.names else [0.0], couplings)
        ]
        if bound == COUPLED[0] and not _choose_starts(fit, other, starts):
            return
        if other != fit.model.structure:
            yield other, starts


def _find_drift(fit: AxisFit) -> float:
    """Return the drift by plain least squares for the delays of a fit; 0 for a negative gain.

    A law that holds a drifting robot leaves most steps without motion, which no gain explains well.
    """
    _, dead_time_s, lag_s, *extras = fit.parameters.tolist()
    way = fit.model.predict(dead_time_s, fit.model.prepare(lag_s, *extras))[0][0]
    terms = fit.whitening.apply(np.column_stack([way, fit.model.duration_s, fit.model.moved]))
    gain, rate = np.linalg.lstsq(terms[:, :2], terms[:, 2])[0].tolist()
    return float(rate / gain) if gain > 0.0 else 0.0


def _find_deadbands(fit: AxisFit, levels: Values) -> list[float]:
    """Return the most likely magnitude up to which commands cause no motion, and its neighbours."""
    structure, extras = fit.model.structure, fit.parameters[EXTRA:].tolist()
    left: dict[int, float] = {}
    low, high = 0, len(levels) - 1
    while True:
        rows = np.unique(np.linspace(low, high, _DEADBANDS).astype(int)).tolist()
        for row in rows:
            if row not in left:
                other = replace(structure, deadband=float(levels[row]))
                left[row] = _measure_near(fit, other, extras)
        best = min(left, key=lambda row: left[row])
        near = sorted(left)
        place = near.index(best)
        low, high = near[max(place - 1, 0)], near[min(place + 1, len(near) - 1)]
        if high - low <= (low < best) + (best < high):
            return [float(levels[row]) for row in sorted({low, best, high})]


def _is_open(structure: Structure, commands: Values) -> bool:
    """Return whether a structure may be tried; if it needs each command, commands must be few."""
    return structure.is_possible and (not structure.is_slow or len(commands) <= _MOST_CHANGES)


def _choose_starts(fit: AxisFit, structure: Structure, starts: Starts) -> Starts:
    """Return the most promising start values; empty if no further parameter is worth trying."""
    if structure.size <= fit.model.structure.size or is_soft(fit.model.structure, structure):
        return starts
    asks = {("reverse", 1.0): 1.1, ("drift", 0.0): 0.1}
    moved = [
        tuple(asks.get(pair, pair[1]) for pair in zip(structure.names, extras, strict=True))
        for extras in starts
    ]
    gains = _measure_reductions(fit, structure, moved)
    rows = {max(range(len(gains)), key=lambda row: gains[row][by]) for by in (0, 1)}
    return [starts[row] for row in sorted(rows) if gains[row][0] >= _ASKS]


def _measure_reductions(
    fit: AxisFit, structure: Structure, starts: Sequence[Sequence[float]]
) -> list[tuple[float, float]]:
    """Return by how much further parameters could reduce the sum of squares, to first order."""
    # The second number is the reduction by the start values themselves.
    modelled, slopes = fit.model.linearise(fit.parameters)
    gain, dead_time_s, lag_s = fit.parameters[: LAG + 1].tolist()
    other = axis_fit.StepModel(fit.model.motions, structure)
    bent = [
        gain * other.predict(dead_time_s, other.prepare(lag_s, *extras))[0][0] - modelled
        for extras in starts
    ]
    slopes = fit.whitening.apply(slopes)
    white = np.clip(fit.white, -axis_fit.SOFT, axis_fit.SOFT)
    columns = np.column_stack([white, fit.whitening.apply(np.column_stack(bent))])
    white, *bent = (columns - slopes @ np.linalg.lstsq(slopes, columns)[0]).T
    sums = [(float(white @ one), max(float(one @ one), LEAST_STEP)) for one in bent]
    return [(along**2 / size, 2.0 * along - size) for along, size in sums]


def _measure_near(fit: AxisFit, structure: Structure, extras: Sequence[float]) -> float:
    """Return the cost of another structure near the parameters of a fit, after one linear step."""
    other = axis_fit.StepModel(fit.model.motions, structure)
    near = np.append(fit.parameters[: LAG + 1], extras)
    modelled, slopes = other.linearise(near)
    white, slopes = (fit.whitening.apply(one) for one in (other.moved - modelled, slopes))
    return axis_fit.sum_softly(white - slopes @ np.linalg.lstsq(slopes, white)[0])


def compare_predictions(
    fit: AxisFit, other: AxisFit, first: Sequence[AxisMotion], rest: Sequence[AxisMotion]
) -> float:
    """Return by how much another structure predicts the rest of the steps better than a fit.

    Both are fitted to the first part. The difference is that of twice the negative log-likelihoods,
    both by the noise that the rest has for the other one.
    """
    predicted = []
    for one in (fit, other):
        known = axis_fit.finish_fit(axis_fit.StepModel(first, one.model.structure), one.parameters)
        ahead = axis_fit.StepModel(rest, one.model.structure)
        modelled, slopes = ahead.linearise(known.parameters)
        predicted.append((known, ahead.moved - modelled, slopes))
    whitening = ahead.fit_noise(predicted[1][1])[1]
    badness, other_badness = (_measure_ahead(*one, whitening) for one in predicted)
    return badness - other_badness


def _measure_ahead(known: AxisFit, residual: Values, slopes: Values, whitening: Whitening) -> float:
    """Return the misfit of a prediction with the uncertainty of the first part."""
    # If that part shows no delay, no structure is to blame for a wrong one. A parameter that it
    # does not show at all is as uncertain as one step leaves it.
    white, slopes = whitening.apply(residual), whitening.apply(slopes)
    earlier = known.whitening.apply(known.model.linearise(known.parameters)[1])
    before, after = earlier.T @ earlier, slopes.T @ slopes
    before = before + (before + after) / (len(earlier) + len(slopes))
    size = np.maximum(np.sqrt(np.diag(before + after)), axis_fit.UNSEEN)
    scale, rounded = np.outer(size, size), axis_fit.ROUNDED * np.eye(len(size))
    before, after = before / scale + rounded, after / scale + rounded
    slopes = slopes / size
    step = np.linalg.solve(before + after, slopes.T @ np.clip(white, -axis_fit.SOFT, axis_fit.SOFT))
    spread = np.linalg.slogdet(before + after)[1] - np.linalg.slogdet(before)[1]
    return axis_fit.sum_softly(white - slopes @ step) + float(step @ before @ step + spread)
