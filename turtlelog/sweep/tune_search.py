"""The search for the best values of keys, in three steps, and how far each can change around them.

First, a scrambled Sobol sequence covers the range evenly. Second, differential evolution (R. Storn
and K. Price, J. Global Optimization 11, 1997; as in scipy) continues from the best points, whole
generations at a time. Third, a compass search (T. G. Kolda, R. M. Lewis and V. Torczon, SIAM Review
45, 2003) halves its steps around the best point. A candidate that satisfies the constraints is
better than a candidate that does not. If both candidates do, the better objective decides; if
neither does, the smaller violation decides (K. Deb, "An efficient constraint handling method for
genetic algorithms", Computer Methods in Applied Mechanics and Engineering 186, 2000).
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise, product
from operator import sub
from statistics import median
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import TuneError
from turtlelog.sweep.tune_candidates import Candidate, Candidates, Point, SearchedKey, TuningGoal

_SPREAD: Final = 32
"""Points per key of the first cover, a power of two for Sobol: one key has steps of 3 %."""

_SPREAD_ALONE: Final = 128
"""The same number if one key varies alone, with steps of 1 % of its range: a metric that depends on
the sampling instants has narrow minima, and the evolution of one key needs few candidates."""

_POPULATION: Final = 12
"""Population of the evolution per key: the authors of the method advise 10, scipy uses 15."""

_FEWEST: Final = 16  # smallest population of the evolution

_FIRST_STEP: Final = 1.0 / 16.0
_LAST_STEP: Final = 1e-5
"""Steps of the compass search, from two points of the cover to less than a typed value."""

_CORNERS: Final = 6
"""Largest number of keys for which the corners of the range are candidates, at most 64 corners."""

_FAR: Final = 1e100
"""Amount added to a score if constraints are violated, so that it comes after all others."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tuned:
    """Result of a search."""

    best: Candidate  # best candidate; `is_feasible` shows whether it satisfies the constraints
    evaluations: int  # number of simulated candidates
    failed: int  # number of candidates that failed
    feasible: int  # number of candidates that satisfy the constraints
    at_bounds: tuple[str, ...]  # keys whose best value is at a bound of their range
    is_flat: bool = False  # whether all satisfying candidates, at least two, are equally good
    failure: str = ""  # reason of the first failure; empty if no candidate failed
    largest_step: float | None = None  # between neighbouring tried values; None for several keys


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
    """Return the best known candidate, of at least one; of equal candidates, the first."""
    return min(candidates.list_known(), key=partial(_order, candidates.goal))


def _order(goal: TuningGoal, candidate: Candidate) -> tuple[int, float]:
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


# The neighbourhood: a walk from the best value of a key to each bound ends where the objective is
# worse or a constraint breaks. Scans then look for such places inside, because a metric that
# depends on the sampling instants may be good on both sides of a narrow place that is not.

_WORSE: Final = 0.1
"""Largest loss of the objective, as a share of the best value: the rounding of a gain."""

_OF_SPREAD: Final = 0.01
"""The same share of the way from best to median, if larger: a best value of 0 has none."""

_POINTS: Final = 16
"""Number of candidates between the best value and each bound, denser near the best."""

_ROUNDS: Final = 5  # largest number of neighbourhoods, each of which may contain a better value
_HALVINGS: Final = 8  # number of halvings of the step, down to 1/256

_SCAN: Final = 32
"""Candidates from the best value to each end: a worse part of 1/32 of a side ends the range."""

_SCANS: Final = 8  # largest number of scans. A scan follows each one that makes the range smaller

NEIGHBOURS: Final = 2 * (_POINTS + _HALVINGS + _SCAN)
"""Usual number of candidates of a neighbourhood for each key."""

_JUMP_WIDTH: Final = 1e-3
"""Largest distance of the two sides of a jump, as a share of the search range. Around a best value,
a smooth objective changes by far less than the accepted loss over so short a distance."""

End = Literal["objective", "constraint", "no value", "bound"]


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyRange:
    """Range of a key around its best value, with all other keys at their best values.

    An end is where the objective becomes worse, a constraint is violated, a value is missing, or
    the given bound is reached.
    """

    key: str  # dotted scenario key
    low: float  # smallest value that is still good
    high: float  # largest value that is still good
    low_end: End  # reason for the lower end
    high_end: End  # reason for the upper end
    low_constraint: str = ""  # constraint that is violated below the range, if any
    high_constraint: str = ""  # constraint that is violated above the range, if any
    largest_step: float = 0.0  # between neighbouring tried values; 0 for a single value


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectiveJump:
    """Change of the objective by more than the accepted loss between close values of a key."""

    key: str  # dotted scenario key
    low: float  # value of the key below the jump
    high: float  # value of the key above the jump
    change: float  # magnitude of the change of the objective


@dataclass(frozen=True, slots=True, kw_only=True)
class Neighbourhood:
    """The range in which each key can change while the other keys stay fixed."""

    slack: float  # largest accepted loss of the objective
    ranges: tuple[KeyRange, ...]  # range of each key
    jump: ObjectiveJump | None = None  # largest jump along a key; None if there is no jump


@dataclass(slots=True)
class _Walk:
    """A walk from the best value to a bound; each probe of it may end its good part earlier."""

    place: int
    bound: float
    good: float = 1.0  # last good fraction
    bad: float | None = None  # first bad fraction
    end: End = "bound"
    constraint: str = ""

    def enter(self, share: float, fault: tuple[End, str] | None) -> None:
        if fault is None:
            self.good = share
        else:
            self.bad, (self.end, self.constraint) = share, fault


def explore_best(
    candidates: Candidates, keys: Sequence[SearchedKey], found: Tuned
) -> tuple[Tuned, Neighbourhood]:
    """Return the best candidate and its neighbourhood. A better candidate found there replaces it.

    The best candidate so far in `found` satisfies the constraints.
    """
    for _ in range(_ROUNDS):
        around = explore_neighbourhood(candidates, keys, found.best)
        before, found = found, sum_up(candidates, keys)
        if found.best is before.best:
            break
    return replace(found, best=before.best, at_bounds=before.at_bounds), around


def explore_neighbourhood(
    candidates: Candidates, keys: Sequence[SearchedKey], best: Candidate
) -> Neighbourhood:
    """Return the range of each key, found by walks from the best value to both bounds.

    The best candidate satisfies the constraints. In each range, every candidate tried is good: the
    range is scanned at equal distances, and ends before the first candidate that is not.
    """
    walks = _Walks(candidates, keys, best)
    walks.walk_out()
    walks.scan()
    lines = [_list_line(candidates, best, place) for place in range(len(keys))]
    pairs = zip(lines, keys, strict=True)
    jumps = [jump for line, key in pairs for jump in _list_jumps(line, key, walks.slack)]
    return Neighbourhood(
        slack=walks.slack,
        ranges=tuple(
            walks.build_range(place, [value for value, _ in line])
            for place, line in enumerate(lines)
        ),
        jump=max(jumps, key=lambda jump: jump.change, default=None),
    )


class _Walks:
    """Walks along all keys, in both directions."""

    def __init__(
        self, candidates: Candidates, keys: Sequence[SearchedKey], best: Candidate
    ) -> None:
        assert best.objective is not None
        self._candidates, self._keys, self._point = candidates, keys, best.point
        self.slack = _find_slack(candidates, best.objective)
        self._sign = candidates.goal.sign
        self._limit = self._sign * best.objective + self.slack
        self._pairs = [
            (_Walk(place, key.low), _Walk(place, key.high)) for place, key in enumerate(keys)
        ]

    def walk_out(self) -> None:
        """Walk from the best value to the bounds, in steps that grow."""
        every = [walk for pair in self._pairs for walk in pair]
        self._probe(every, [(step / _POINTS) ** 2 for step in range(1, _POINTS + 1)])

    def scan(self) -> None:
        """Look at equal distances on the good part of each walk, until no scan ends it earlier."""
        ended = [walk for pair in self._pairs for walk in pair]
        for _ in range(_SCANS):
            ended = self._probe(ended, [step / _SCAN for step in range(1, _SCAN + 1)])
            if not ended:
                break

    def _probe(self, walks: Sequence[_Walk], shares: Sequence[float]) -> list[_Walk]:
        """Look at shares of the good part of walks, ascending to 1; return the walks that end."""
        asked = [(walk, walk.good * share) for walk in walks for share in shares]
        for walk in walks:
            walk.good, walk.bad = 0.0, None
        for (walk, share), fault in zip(asked, self._look(asked), strict=True):
            if walk.bad is None:
                walk.enter(share, fault)
        for _ in range(_HALVINGS):
            halved = [(one, (one.good + one.bad) / 2.0) for one in walks if one.bad is not None]
            for (walk, share), fault in zip(halved, self._look(halved), strict=True):
                walk.enter(share, fault)
        return [walk for walk in walks if walk.bad is not None]

    def _look(self, asked: Sequence[tuple[_Walk, float]]) -> list[tuple[End, str] | None]:
        found = self._candidates.evaluate([self._move(walk, share) for walk, share in asked])
        return [_find_fault(one, self._limit, self._sign) for one in found]

    def _move(self, walk: _Walk, share: float) -> Point:
        point = [*self._point]
        here = point[walk.place]
        point[walk.place] = self._keys[walk.place].round(here + share * (walk.bound - here))
        return tuple(point)

    def build_range(self, place: int, tried: Sequence[float]) -> KeyRange:
        """Return the range of a key, of which these values were tried."""
        below, above = self._pairs[place]
        low, high = (self._move(walk, walk.good)[place] for walk in (below, above))
        return KeyRange(
            key=self._keys[place].key,
            low=low,
            high=high,
            low_end=below.end,
            high_end=above.end,
            low_constraint=below.constraint,
            high_constraint=above.constraint,
            largest_step=find_largest_step(tried, low, high),
        )


def _list_line(
    candidates: Candidates, best: Candidate, place: int
) -> list[tuple[float, float | None]]:
    """Return all tried values of a key, ascending, with the other keys at their best values.

    Their objectives are None if a constraint does not hold.
    """
    others = best.point[:place], best.point[place + 1 :]
    return sorted(
        (one.point[place], one.objective if one.is_feasible else None)
        for one in candidates.list_known()
        if (one.point[:place], one.point[place + 1 :]) == others
    )


def _list_jumps(
    line: Sequence[tuple[float, float | None]], key: SearchedKey, least: float
) -> Iterator[ObjectiveJump]:
    """Yield larger changes of the objective between neighbouring values that are close together."""
    most = _JUMP_WIDTH * (key.high - key.low)
    for (low, before), (high, after) in pairwise(line):
        change = 0.0 if before is None or after is None else abs(after - before)
        if change > least and high - low <= most:
            yield ObjectiveJump(key=key.key, low=low, high=high, change=change)


def _find_slack(candidates: Candidates, best: float) -> float:
    known = candidates.list_known()
    values = [one.objective for one in known if one.is_feasible and one.objective is not None]
    return max(_WORSE * abs(best), _OF_SPREAD * abs(median(values) - best))


def _find_fault(one: Candidate, limit: float, sign: float) -> tuple[End, str] | None:
    broken = [found for found in one.constraints if not found.holds]
    if broken:
        return "constraint", broken[0].expression
    if one.objective is None:
        return "no value", ""
    return ("objective", "") if sign * one.objective > limit else None
