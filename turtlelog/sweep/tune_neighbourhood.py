"""The neighbourhood of the best values: how far each key alone can change, and jumps on the way.

A walk from the best value to each bound ends where the objective is worse or a constraint breaks.
Scans of the range then look for such places inside, because a metric that depends on the sampling
instants may be good on both sides of a narrow place that is not.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from statistics import median
from typing import Final, Literal

from turtlelog.sweep.tune_candidates import Candidate, Candidates, Point
from turtlelog.sweep.tune_search import SearchedKey, Tuned, find_largest_step, sum_up

_WORSE: Final = 0.1
"""Largest loss of the objective, as a share of the best value: the rounding of a gain."""

_OF_SPREAD: Final = 0.01
"""The same loss as a share of the distance from the best to the median candidate, if that is
larger. A share of a best value of 0 would always be 0."""

_POINTS: Final = 16
"""Number of candidates between the best value and each bound, denser near the best."""

_ROUNDS: Final = 5
"""Largest number of neighbourhoods. If a metric depends on single samples, each may contain a
better value."""

_HALVINGS: Final = 8
"""Number of halvings of the step, down to 1/256."""

_SCAN: Final = 32
"""Number of candidates between the best value and each end of its range, at equal distances: a part
of 1/32 of either side that is worse ends the range."""

_SCANS: Final = 8
"""Largest number of scans. A scan follows each one that makes the range smaller."""

NEIGHBOURS: Final = 2 * (_POINTS + _HALVINGS + _SCAN)
"""Usual number of candidates of a neighbourhood for each key."""

_JUMP_WIDTH: Final = 1e-3
"""Largest distance of the two sides of a jump, as a share of the search range. Around a best value,
a smooth objective changes by far less than the accepted loss over so short a distance."""

End = Literal["objective", "constraint", "no value", "bound"]


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyRange:
    """Range of a key around its best value, with all other keys at their best values.

    Attributes:
        key: Dotted scenario key.
        low: Smallest value that is still good.
        high: Largest value that is still good.
        low_end: Reason for the lower end: the objective becomes worse, a constraint is violated, a
            value is missing, or the given bound is reached.
        high_end: Reason for the upper end, with the same values.
        low_constraint: Constraint that is violated below the range; empty if no constraint is.
        high_constraint: Constraint that is violated above the range; empty if no constraint is.
        largest_step: Largest distance between two neighbouring values that were tried in the range;
            0 if the range is a single value.
    """

    key: str
    low: float
    high: float
    low_end: End
    high_end: End
    low_constraint: str = ""
    high_constraint: str = ""
    largest_step: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Jump:
    """A change of the objective by more than the accepted loss between two close values of a key.

    Attributes:
        key: Dotted scenario key.
        low: Value of the key below the jump.
        high: Value of the key above the jump.
        change: Magnitude of the change of the objective.
    """

    key: str
    low: float
    high: float
    change: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Neighbourhood:
    """The range in which each key can change while the other keys stay fixed.

    Attributes:
        slack: Largest accepted loss of the objective.
        ranges: Range of each key.
        jump: Largest jump of the objective along a key; None if there is no jump.
    """

    slack: float
    ranges: tuple[KeyRange, ...]
    jump: Jump | None = None


@dataclass(slots=True)
class _Walk:
    """A walk from the best value to a bound: the last good fraction and the first bad fraction.

    A walk begins with the whole way as good, and each probe of it may end it earlier.
    """

    place: int
    bound: float
    good: float = 1.0
    bad: float | None = None
    end: End = "bound"
    constraint: str = ""


def explore_best(
    candidates: Candidates, keys: Sequence[SearchedKey], found: Tuned
) -> tuple[Tuned, Neighbourhood]:
    """Return the best candidate and its neighbourhood. A better candidate found there replaces it.

    Args:
        candidates: Evaluator of candidates.
        keys: Varied keys.
        found: Best candidate so far, which satisfies the constraints.
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
    pairs = [*zip(lines, keys, strict=True)]
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
                _enter(walk, share, fault)
        for _ in range(_HALVINGS):
            halved = [(one, (one.good + one.bad) / 2.0) for one in walks if one.bad is not None]
            for (walk, share), fault in zip(halved, self._look(halved), strict=True):
                _enter(walk, share, fault)
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
) -> Iterator[Jump]:
    """Yield larger changes of the objective between neighbouring values that are close together."""
    most = _JUMP_WIDTH * (key.high - key.low)
    for (low, before), (high, after) in pairwise(line):
        change = 0.0 if before is None or after is None else abs(after - before)
        if change > least and high - low <= most:
            yield Jump(key=key.key, low=low, high=high, change=change)


def _enter(walk: _Walk, share: float, fault: tuple[End, str] | None) -> None:
    if fault is None:
        walk.good = share
    else:
        walk.bad, (walk.end, walk.constraint) = share, fault


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
