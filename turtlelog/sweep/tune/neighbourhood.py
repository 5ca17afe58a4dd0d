"""How far each key alone can go from the best: until it is worse, or a constraint breaks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import Final, Literal

from turtlelog.sweep.tune.candidates import Candidate, Candidates, Point
from turtlelog.sweep.tune.search import SearchedKey, Tuned, sum_up

WORSE: Final = 0.1
"""Share of the best objective by which it may become worse: what one rounds a gain for."""

_OF_SPREAD: Final = 0.01
"""Share of the way from the best to the middle candidate by which it may, where that is more: of a
best of 0 every share is 0."""

_POINTS: Final = 16
"""Looked at between the best and each bound, closer to the best at first."""

_ROUNDS: Final = 5
"""Neighbourhoods that are looked at: of a metric that hangs on single samples each may hold a
better one."""

_HALVINGS: Final = 8
"""Of the step in which it ends: to 1/256 of it."""

NEIGHBOURS: Final = 2 * (_POINTS + _HALVINGS)
"""Candidates that a neighbourhood takes for each key, at most."""

End = Literal["objective", "constraint", "no value", "bound"]


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyRange:
    """How far a key can go from its best value, with all others at theirs.

    Attributes:
        key: Dotted.
        low: Least value that is still good.
        high: Largest.
        low_end: What ends it below: the objective is worse, a constraint breaks, there is no value,
            or the bound that was given.
        high_end: Likewise above.
        low_constraint: The constraint that breaks below; empty where none does.
        high_constraint: Likewise above.
    """

    key: str
    low: float
    high: float
    low_end: End
    high_end: End
    low_constraint: str = ""
    high_constraint: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Neighbourhood:
    """How far the keys can go, each alone.

    Attributes:
        slack: By how much the objective may become worse.
        ranges: Of each key.
    """

    slack: float
    ranges: tuple[KeyRange, ...]


@dataclass(slots=True)
class _Walk:
    """From the best to a bound: the last good share of the way, and the first that is not."""

    place: int
    bound: float
    good: float = 0.0
    bad: float | None = None
    end: End = "bound"
    constraint: str = ""


def explore_best(
    candidates: Candidates, keys: Sequence[SearchedKey], found: Tuned, *, is_maximised: bool = False
) -> tuple[Tuned, Neighbourhood]:
    """Return the best with its neighbourhood: where that holds a better one, this one's.

    Args:
        candidates: Simulates and judges.
        keys: That vary.
        found: The best so far, which fulfils the constraints.
        is_maximised: Whether the objective should be large.
    """
    sign = -1.0 if is_maximised else 1.0
    for _ in range(_ROUNDS):
        around = explore_neighbourhood(candidates, keys, found.best, sign=sign)
        before, found = found, sum_up(candidates, keys, is_maximised=is_maximised)
        if found.best is before.best:
            break
    return replace(found, best=before.best, at_bounds=before.at_bounds), around


def explore_neighbourhood(
    candidates: Candidates, keys: Sequence[SearchedKey], best: Candidate, *, sign: float = 1.0
) -> Neighbourhood:
    """Return how far each key can go alone, on the points of a walk to each bound.

    Args:
        candidates: Simulates and judges.
        keys: That vary.
        best: Whose neighbourhood it is; it fulfils the constraints.
        sign: 1 where the objective should be small, -1 where it should be large.
    """
    assert best.objective is not None
    slack = _find_slack(candidates, best.objective)
    limit = sign * best.objective + slack
    walks = [_Walk(place, bound) for place, key in enumerate(keys) for bound in (key.low, key.high)]

    def move(walk: _Walk, share: float) -> Point:
        point = [*best.point]
        here, key = point[walk.place], keys[walk.place]
        point[walk.place] = key.round(here + share * (walk.bound - here))
        return tuple(point)

    def look(asked: Sequence[tuple[_Walk, float]]) -> list[tuple[End, str] | None]:
        found = candidates.evaluate([move(walk, share) for walk, share in asked])
        return [_find_fault(one, limit, sign) for one in found]

    shares = [(step / _POINTS) ** 2 for step in range(1, _POINTS + 1)]
    asked = [(walk, share) for walk in walks for share in shares]
    for (walk, share), fault in zip(asked, look(asked), strict=True):
        if walk.bad is None:
            _enter(walk, share, fault)
    for _ in range(_HALVINGS):
        halved = [(one, (one.good + one.bad) / 2.0) for one in walks if one.bad is not None]
        for (walk, share), fault in zip(halved, look(halved), strict=True):
            _enter(walk, share, fault)
    ranges = (
        _describe(key.key, below, above, move)
        for key, below, above in zip(keys, walks[::2], walks[1::2], strict=True)
    )
    return Neighbourhood(slack=slack, ranges=tuple(ranges))


def _enter(walk: _Walk, share: float, fault: tuple[End, str] | None) -> None:
    if fault is None:
        walk.good = share
    else:
        walk.bad, (walk.end, walk.constraint) = share, fault


def _describe(
    key: str, below: _Walk, above: _Walk, move: Callable[[_Walk, float], Point]
) -> KeyRange:
    return KeyRange(
        key=key,
        low=move(below, below.good)[below.place],
        high=move(above, above.good)[above.place],
        low_end=below.end,
        high_end=above.end,
        low_constraint=below.constraint,
        high_constraint=above.constraint,
    )


def _find_slack(candidates: Candidates, best: float) -> float:
    """Return by how much the objective may become worse than the best."""
    values = [
        one.objective
        for one in candidates.list_known()
        if one.is_feasible and one.objective is not None
    ]
    return max(WORSE * abs(best), _OF_SPREAD * abs(median(values) - best))


def _find_fault(one: Candidate, limit: float, sign: float) -> tuple[End, str] | None:
    """Return why a candidate is no longer good, None where it is."""
    broken = [found for found in one.constraints if not found.holds]
    if broken:
        return "constraint", broken[0].expression
    if one.objective is None:
        return "no value", ""
    return ("objective", "") if sign * one.objective > limit else None
