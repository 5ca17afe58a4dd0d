"""The value of a game divided among its players, exactly or from a sample of orders.

A contribution is a Shapley value (Shapley, "A value for n-person games", 1953): the amount that a
cause adds to the value, averaged over all orders of the causes. The amount that a set of causes
adds only together is called its dividend (Harsanyi, 1963).
"""

import math
import random
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from statistics import fmean, stdev
from typing import Final

from turtlelog.explain.attribution import Attribution, Contribution
from turtlelog.explain.game import SEEDS, Coalition, Game, list_coalitions

Worth = Mapping[Coalition, float]
"""Value of every coalition."""


def compute_contributions(worth: Worth, causes: Sequence[str]) -> dict[str, float]:
    """Return the contribution of each cause.

    The `math.fsum` of the contributions is the float `worth` of all causes minus the `worth` of
    none, to the last bit. If contributions cancel, the sum may differ by at most one float step of
    the smallest contribution.
    """
    exact = [_compute_share(worth, cause, causes) for cause in causes]
    total = worth[frozenset(causes)] - worth[frozenset()]
    return dict(zip(causes, _round_contributions(exact, total), strict=True))


def compute_dividends(worth: Worth, causes: Sequence[str]) -> dict[tuple[str, ...], float]:
    """Return the amount that each set of at least two causes adds beyond its subsets."""
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
    """Return the sets that contain no other set."""
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
    """Return the contributions as floats whose exact sum rounds to the total.

    The smallest nonzero contribution absorbs the rounding of the others, because its float steps
    are finest. In a tie between two floats, the next smallest contribution absorbs the rounding.
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


_PAIRS: Final = 4 * len(SEEDS)
"""Number of sampled orders, each used together with its reverse: about 6 s for the paper's runs
with fourteen groups."""

ORDERS: Final = 2 * _PAIRS
"""Number of sampled orders."""


def sample_game(found: Attribution, game: Game) -> Attribution:
    """Return an attribution whose contributions are means over sampled orders of its causes.

    Each order is paired with its reverse, which cancels the effect of the position in an order. If
    the game is random, every seed has the same number of pairs, and the errors are over seeds.
    """
    orders = _list_orders(found.causes)
    seeds = SEEDS if game.is_random else (None,)
    added: dict[str, list[float]] = {name: [] for name in found.causes}
    plays = [
        (frozenset(order[place:]), seeds[row // 2 % len(seeds)])
        for row, order in enumerate(orders)
        for place in range(len(order) + 1)
    ]
    outcomes = game.play_each(plays)
    if any(one.value is None for one in outcomes):
        return replace(found, withheld="with some of the changes it has no value")
    values = [one.value or 0.0 for one in outcomes]
    width = len(found.causes) + 1
    for row, order in enumerate(orders):
        steps = pairwise(values[row * width : (row + 1) * width])
        for name, (before, after) in zip(order, steps, strict=True):
            added[name].append(after - before)
    return replace(
        found,
        contributions=tuple(
            Contribution(
                cause=name,
                contribution=fmean(sizes),
                alone=game.take_out([name]).value,
                meaning=game.causes[name].meaning,
                standard_error=_find_error(sizes, len(seeds)),
            )
            for name, sizes in added.items()
        ),
    )


def _list_orders(names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the orders, the same ones at each call; each order is followed by its reverse."""
    draw = random.Random(0)
    drawn = (tuple(draw.sample(names, len(names))) for _ in range(_PAIRS))
    return [order for one in drawn for order in (one, one[::-1])]


def _find_error(sizes: Sequence[float], seeds: int) -> float:
    parts = [fmean(pair) for pair in zip(sizes[::2], sizes[1::2], strict=True)]
    if seeds > 1:  # all pairs of a seed contain its effect
        parts = [fmean(parts[seed::seeds]) for seed in range(seeds)]
    return stdev(parts) / math.sqrt(len(parts))
