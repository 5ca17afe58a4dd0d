"""The value of a game, divided in exact arithmetic among those that play it.

A contribution is a Shapley value (Shapley, "A value for n-person games", 1953): what a cause
adds to the value, averaged over all orders in which they can be put in. What a set of causes
makes only together is its dividend (Harsanyi, 1963). How steady all of it is, the same scenario
shows from starts that lie within one sample's turn.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Final

import numpy as np

from turtlelog.explain.attribution import Part, StartRange, find_sample_period_s
from turtlelog.explain.game import Coalition, Game, list_coalitions
from turtlelog.scenario import Scenario
from turtlelog.simulate import simulate_run

Worth = Mapping[Coalition, float]
"""The value of every coalition."""


def compute_contributions(worth: Worth, causes: Sequence[str]) -> dict[str, float]:
    """Return the contribution of each cause.

    `math.fsum` of them is the float `worth` of all less that of none, to the last bit, except where
    the contributions cancel: it then misses by at most one step of the floats of the smallest.
    """
    exact = [_compute_share(worth, cause, causes) for cause in causes]
    total = worth[frozenset(causes)] - worth[frozenset()]
    return dict(zip(causes, _round_contributions(exact, total), strict=True))


def compute_dividends(worth: Worth, causes: Sequence[str]) -> dict[tuple[str, ...], float]:
    """Return what each set of two causes or more adds beyond all that its subsets add."""
    exact: dict[Coalition, Fraction] = {}
    for inside in list_coalitions(causes):
        subsets = sum((exact[part] for part in exact if part < inside), Fraction())
        exact[inside] = Fraction(worth[inside]) - subsets
    return {
        tuple(cause for cause in causes if cause in inside): float(dividend)
        for inside, dividend in exact.items()
        if len(inside) > 1
    }


def find_smallest(coalitions: Iterable[Coalition]) -> list[Coalition]:
    """Return those of which no other one is a part."""
    found = list(coalitions)
    return [inside for inside in found if not any(other < inside for other in found)]


def _compute_share(worth: Worth, cause: str, causes: Sequence[str]) -> Fraction:
    count = len(causes)
    contribution = Fraction(0)
    for others in list_coalitions([other for other in causes if other != cause]):
        orders = math.factorial(len(others)) * math.factorial(count - len(others) - 1)
        adds = Fraction(worth[others | {cause}]) - Fraction(worth[others])
        contribution += Fraction(orders, math.factorial(count)) * adds
    return contribution


def _round_contributions(exact: list[Fraction], total: float) -> list[float]:
    """Return the contributions as floats whose sum rounds to the total.

    The smallest that is not 0 takes up what rounding the others leaves: its own steps are finest.
    Where that is a tie between two floats, the next smallest does.
    """
    rounded = [float(one) for one in exact]
    rows = sorted((row for row, one in enumerate(rounded) if one), key=lambda r: abs(exact[r]))
    tried = [_absorb(rounded, row, total) for row in rows] or [rounded]
    return next((found for found in tried if math.fsum(found) == total), tried[0])


def _absorb(contributions: list[float], row: int, total: float) -> list[float]:
    others = sum(
        (Fraction(contribution) for at, contribution in enumerate(contributions) if at != row),
        Fraction(),
    )
    return [
        float(Fraction(total) - others) if at == row else s for at, s in enumerate(contributions)
    ]


_COUNT: Final = 17
"""Starts: a sixteenth of one sample's turn apart, so that each of them meets the tolerance at
another point of a sample's way."""

_WIDE: Final = 0.5
"""Of what the effects add: over a wider range their parts change places from start to start."""

_MOST_TICKS: Final = 200_000
"""Simulated to divide the value again at every start: two to three seconds."""


def vary_start(
    scenario: Scenario,
    metric: str,
    *,
    added: float,
    resolution: float,
    causes: Sequence[str],
    acting: Sequence[str],
) -> StartRange | None:
    """Return the value over starts within one sample's turn, None where the robot does not turn.

    Args:
        scenario: With all causes in.
        metric: Has a value.
        added: What the causes add together.
        resolution: The largest change that is negligible.
        causes: Among whom the value is divided.
        acting: Those of them that change it.
    """
    built = simulate_run(scenario)
    turn_rate = float(np.abs(built.samples.turn_rate_rad_s).max())
    within_rad = 0.5 * turn_rate * find_sample_period_s(scenario)
    if within_rad == 0.0:
        return None
    games = [
        Game(_turn_start(scenario, offset), metric)
        for offset in np.linspace(-within_rad, within_rad, _COUNT).tolist()
    ]
    found = [game.take_out().value for game in games]
    values = [value for value in found if value is not None]
    is_far = abs(added) > resolution and max(values) - min(values) > _WIDE * abs(added)
    without = [game.take_out(causes).value for game in games] if is_far else []
    is_wide = is_far and _is_wide(found, without, added)
    rest = [value for value in without if value is not None]
    ticks = len(built.poses) * len(games) * 2 ** len(acting)
    return StartRange(
        count=len(games),
        within_rad=within_rad,
        low=min(values),
        high=max(values),
        without_value=len(found) - len(values),
        is_wide=is_wide,
        parts=_divide_again(games, acting) if is_wide and ticks <= _MOST_TICKS else (),
        without_all=(min(rest), max(rest)) if is_wide and len(rest) == len(games) else None,
    )


def _is_wide(values: Sequence[float | None], without: Sequence[float | None], added: float) -> bool:
    """Return whether what the causes add to the value ranges over too much.

    A value that only follows the start, as a turn's length does, follows it without them as well.
    """
    additions = [
        value - rest
        for value, rest in zip(values, without, strict=True)
        if value is not None and rest is not None
    ]
    return max(additions) - min(additions) > _WIDE * abs(added)


def _turn_start(scenario: Scenario, offset_rad: float) -> Scenario:
    heading_rad = scenario.start.heading_rad + offset_rad
    return replace(scenario, start=replace(scenario.start, heading_rad=heading_rad))


def _divide_again(games: Sequence[Game], causes: Sequence[str]) -> tuple[Part, ...]:
    """Return the lowest and highest part of each cause; none unless all add alike."""
    parts = []
    for game in games:
        found = {inside: game.play(inside, causes).value for inside in list_coalitions(causes)}
        worth = {inside: value for inside, value in found.items() if value is not None}
        if len(worth) < len(found):
            return ()
        total = worth[frozenset(causes)] - worth[frozenset()]
        contributions = compute_contributions(worth, causes)
        if any(contribution * total <= 0.0 for contribution in contributions.values()):
            return ()
        parts.append([contribution / total for contribution in contributions.values()])
    lows, highs = np.min(parts, axis=0).tolist(), np.max(parts, axis=0).tolist()
    return tuple(
        Part(cause=name, low=low, high=high)
        for name, low, high in zip(causes, lows, highs, strict=True)
    )
