"""The search for the best values of keys, in three steps.

First, a scrambled Sobol sequence covers the range evenly. Second, differential evolution (R. Storn
and K. Price, J. Global Optimization 11, 1997; as in scipy) continues from the best points, whole
generations at a time. Third, a compass search (T. G. Kolda, R. M. Lewis and V. Torczon, SIAM Review
45, 2003) halves its steps around the best point. A candidate that satisfies the constraints is
better than a candidate that does not. If both candidates do, the better objective decides; if
neither does, the smaller violation decides (K. Deb, "An efficient constraint handling method for
genetic algorithms", Computer Methods in Applied Mechanics and Engineering 186, 2000).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from operator import sub
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import TuneError
from turtlelog.sweep.sweep_plan import EqualSteps, parse_key_values
from turtlelog.sweep.tune_candidates import Candidate, Candidates, Point, TuningGoal

_SPREAD: Final = 32
"""Number of points per key of the first cover: one key has steps of 3 % of its range. The number is
a power of two, as the Sobol sequence requires."""

_SPREAD_ALONE: Final = 128
"""The same number if one key varies alone, with steps of 1 % of its range: a metric that depends on
the sampling instants has narrow minima, and the evolution of one key needs few candidates."""

_POPULATION: Final = 12
"""Population of the evolution per key: the authors of the method advise 10, scipy uses 15."""

_FEWEST: Final = 16
"""Smallest population of the evolution."""

_FIRST_STEP: Final = 1.0 / 16.0
_LAST_STEP: Final = 1e-5
"""Last step of the compass search as a share of the range, finer than typed values. The first step
is the distance between two points of the cover."""

_CORNERS: Final = 6
"""Largest number of keys for which the corners of the range are candidates, at most 64 corners."""

_FAR: Final = 1e100
"""Amount added to the score of a candidate that violates constraints, so that it comes after all
others."""

Order = tuple[int, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Tuned:
    """Result of a search.

    Attributes:
        best: Best candidate; `is_feasible` shows whether it satisfies the constraints.
        evaluations: Number of simulated candidates.
        failed: Number of candidates that failed.
        failure: Reason of the first failure; empty if no candidate failed.
        feasible: Number of candidates that satisfy the constraints.
        at_bounds: Keys whose best value is at a bound of their range.
        is_flat: Whether all candidates that satisfy the constraints, at least two, have the same
            objective.
        largest_step: Largest distance between neighbouring tried values of the key in its range;
            None if several keys vary.
    """

    best: Candidate
    evaluations: int
    failed: int
    feasible: int
    at_bounds: tuple[str, ...]
    is_flat: bool = False
    failure: str = ""
    largest_step: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchedKey:
    """A key and its search range.

    Attributes:
        key: Dotted scenario key.
        low: Smallest value.
        high: Largest value.
        is_whole: Whether only whole numbers are allowed.
        steps: Allowed values; empty if any value is allowed.
    """

    key: str
    low: float
    high: float
    is_whole: bool = False
    steps: Sequence[float] = ()

    def round(self, value: float) -> float | int:
        """Return the nearest allowed value."""
        value = min(max(value, self.low), self.high)
        if self.steps:
            return min(self.steps, key=lambda step: abs(step - value))
        return round(value) if self.is_whole else float(value)


def search_best(
    candidates: Candidates, keys: Sequence[SearchedKey], *, evaluations: int, seed: int = 0
) -> Tuned:
    """Return the best values of keys.

    Args:
        candidates: Evaluator of candidates.
        keys: Keys with their search ranges.
        evaluations: Approximate largest number of candidates.
        seed: Seed of the search; the same seed gives the same result.

    Raises:
        TuneError: If the objective has no value for any candidate.
    """
    search = _Search(candidates, keys, evaluations)
    search.spread(seed)
    search.evolve(seed)
    search.refine()
    found = sum_up(candidates, keys)
    if found.best.objective is None:
        reason = found.best.failed or found.best.missing
        raise TuneError(f"no candidate has a value to compare: {reason}")
    return found


def sum_up(candidates: Candidates, keys: Sequence[SearchedKey]) -> Tuned:
    """Return the result of the candidates so far, at least one."""
    known, best = candidates.list_known(), find_best(candidates)
    feasible = [one.objective for one in known if one.is_feasible]
    values = zip(keys, best.point, strict=True)
    return Tuned(
        best=best,
        evaluations=candidates.evaluations,
        failed=sum(bool(one.failed) for one in known),
        failure=next((one.failed for one in known if one.failed), ""),
        feasible=len(feasible),
        is_flat=len(feasible) > 1 and len(set(feasible)) == 1,
        at_bounds=tuple(key.key for key, value in values if value in {key.low, key.high}),
        largest_step=find_largest_step([one.point[0] for one in known], keys[0].low, keys[0].high)
        if len(keys) == 1
        else None,
    )


def find_largest_step(values: Sequence[float], low: float, high: float) -> float:
    """Return the largest distance between neighbouring values in a range; 0 if there is one."""
    inside = sorted(value for value in values if low <= value <= high)
    return max(map(sub, inside[1:], inside), default=0.0)


def find_best(candidates: Candidates) -> Candidate:
    """Return the best known candidate; of equal candidates, the first.

    Raises:
        ValueError: If no candidate is known.
    """
    return min(candidates.list_known(), key=partial(_order, candidates.goal))


def _order(goal: TuningGoal, candidate: Candidate) -> Order:
    """Return the sort key of a candidate; the best candidate is first."""
    if candidate.is_feasible and candidate.objective is not None:
        return 0, goal.sign * candidate.objective
    return (2, 0.0) if candidate.objective is None else (1, candidate.violation)


class _Search:
    def __init__(self, candidates: Candidates, keys: Sequence[SearchedKey], most: int) -> None:
        self._candidates, self._keys, self._most = candidates, keys, most
        self._order = partial(_order, candidates.goal)
        self._low = np.array([key.low for key in keys], float)
        self._width = np.array([key.high - key.low for key in keys], float)

    @property
    def _left(self) -> int:
        return self._most - self._candidates.evaluations

    def _place(self, shares: NDArray[np.float64]) -> list[Point]:
        """Return the points at fractions of the range, shape (n, number of keys)."""
        values = self._low + shares * self._width
        # Rounding errors of sums may miss a bound by the last digit.
        values = np.where(shares >= 1.0, [key.high for key in self._keys], values)
        return [
            tuple(key.round(value) for key, value in zip(self._keys, row, strict=True))
            for row in values.tolist()
        ]

    def _score(self, points: Sequence[Point]) -> NDArray[np.float64]:
        """Return a score for each point with the order of the candidates."""
        scores = []
        for group, value in map(self._order, self._candidates.evaluate(points)):
            far = _FAR + _FAR * min(value, 1e100) if group == 1 else math.inf
            scores.append(far if group else value)
        return np.array(scores)

    def spread(self, seed: int) -> None:
        """Cover the range evenly."""
        from scipy.stats import qmc

        count = len(self._keys)
        points = self._place(np.full((1, count), 0.5))
        if count <= _CORNERS:
            points += self._place(np.array([*product((0.0, 1.0), repeat=count)]))
        most = _SPREAD_ALONE if count == 1 else _SPREAD * count
        wanted = max(min(most, self._most // 2), 2)
        generator = np.random.default_rng(seed)
        sequence: Any = qmc.Sobol(count, rng=generator)
        points += self._place(sequence.random_base2(max(math.floor(math.log2(wanted)), 1)))
        self._candidates.evaluate(points[: max(self._most, 1)])

    def evolve(self, seed: int) -> None:
        """Evolve the best points, whole generations at a time."""
        from scipy.optimize import differential_evolution

        count = len(self._keys)
        size = max(_FEWEST, _POPULATION * count)
        known = sorted(self._candidates.list_known(), key=self._order)[:size]
        generations = int(0.75 * self._left) // size
        if generations < 1 or len(known) < 5:  # scipy requires five
            return
        shares = (np.array([one.point for one in known], float) - self._low) / self._width
        with np.errstate(over="ignore"):  # scipy squares the sizes of violations
            differential_evolution(
                lambda columns: self._score(self._place(columns.T)),
                [(0.0, 1.0)] * count,
                init=np.clip(shares, 0.0, 1.0),
                maxiter=generations,
                rng=np.random.default_rng(seed + 1),
                polish=False,
                vectorized=True,
                updating="deferred",
                tol=1e-6,
            )

    def refine(self) -> None:
        """Search around the best point along keys and diagonals, with steps that halve."""
        count = len(self._keys)
        directions = [*np.eye(count), *-np.eye(count)]
        if 1 < count <= _CORNERS:
            directions += [np.array(one) for one in product((-1.0, 1.0), repeat=count)]
        step, best = _FIRST_STEP, find_best(self._candidates)
        while step >= _LAST_STEP and self._left >= len(directions):
            here = (np.array(best.point, float) - self._low) / self._width
            around = np.clip(here + step * np.array(directions), 0.0, 1.0)
            self._candidates.evaluate(self._place(around))
            found = find_best(self._candidates)
            if found is best:
                step /= 2.0
            best = found


_MOST_STEPS: Final = 10_000
"""Largest number of values of a key with a step; from each candidate, the nearest of them are
searched."""


def parse_searched_keys(
    texts: Sequence[str], parameters: Mapping[str, Any], *, source: str = "--grid"
) -> tuple[SearchedKey, ...]:
    """Parse texts such as `law.kp_linear=0.5:12`.

    Args:
        texts: Texts, each with a key, an equals sign and bounds.
        parameters: Parameters of the scenario by key; they show which keys need whole numbers.
        source: Prefix of error messages.

    Raises:
        SweepError: If a text cannot be parsed.
        TuneError: If there is no text, or a key occurs twice or has no range.
    """
    if not texts:
        raise TuneError(f"{source}: expected a key and its bounds, as in law.kp_linear=0.5:12")
    found: dict[str, SearchedKey] = {}
    for text in texts:
        one = parse_key_values(text, source=source, is_sampled=True)
        steps = one.values
        if not isinstance(steps, EqualSteps) or (not one.is_open and len(steps) > _MOST_STEPS):
            expected = "two bounds and perhaps a step, as in 0.5:12 or 0.5:12:0.5"
            raise TuneError(f"{source}: {one.key}: expected {expected}, found {one.text[:60]!r}")
        if one.key in found:
            raise TuneError(f"{source}: {one.key}: expected each key once, found it twice")
        low, high = steps[0], steps[-1]
        if not low < high:
            raise TuneError(f"{source}: {one.key}: expected a range, found {one.text[:60]!r}")
        known = parameters.get(one.key)
        if isinstance(known, bool) or not isinstance(known, int | float | None):
            expected = "a key whose values are numbers"
            raise TuneError(f"{source}: {one.key}: expected {expected}, found {known!r}")
        is_whole = isinstance(known, int) and not isinstance(known, bool)
        if is_whole and not (float(low).is_integer() and float(high).is_integer()):
            expected = "whole bounds of a key that counts"
            raise TuneError(f"{source}: {one.key}: expected {expected}, found {one.text[:60]!r}")
        found[one.key] = SearchedKey(
            key=one.key,
            low=low,
            high=high,
            is_whole=is_whole,
            steps=() if one.is_open else tuple(steps),
        )
    return tuple(found.values())
