"""How a value is divided among those that make it together, in exact arithmetic.

A share is a Shapley value (Shapley, "A value for n-person games", 1953): what a player adds to the
value, averaged over all orders in which the players can be put in. What a set of players makes
only together is its dividend (Harsanyi, 1963).
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from itertools import combinations

Coalition = frozenset[str]
"""The players that are in."""

Worth = Mapping[Coalition, float]
"""The value of every coalition."""


def list_coalitions(players: Sequence[str]) -> list[Coalition]:
    """Return all sets of players, the smaller first."""
    return [
        frozenset(inside)
        for size in range(len(players) + 1)
        for inside in combinations(players, size)
    ]


def compute_shares(worth: Worth, players: Sequence[str]) -> dict[str, float]:
    """Return the share of each player.

    `math.fsum` of them is the float `worth` of all less that of none, to the last bit, except where
    the shares cancel: it then misses by at most one step of the smallest share's own floats.
    """
    exact = [_compute_share(worth, player, players) for player in players]
    total = worth[frozenset(players)] - worth[frozenset()]
    return dict(zip(players, _round_shares(exact, total), strict=True))


def compute_dividends(worth: Worth, players: Sequence[str]) -> dict[tuple[str, ...], float]:
    """Return what each set of two players or more adds beyond all that its subsets add."""
    exact: dict[Coalition, Fraction] = {}
    for inside in list_coalitions(players):
        subsets = sum((exact[part] for part in exact if part < inside), Fraction())
        exact[inside] = Fraction(worth[inside]) - subsets
    return {
        tuple(player for player in players if player in inside): float(dividend)
        for inside, dividend in exact.items()
        if len(inside) > 1
    }


def find_smallest(coalitions: Iterable[Coalition]) -> list[Coalition]:
    """Return those of which no other one is a part."""
    found = list(coalitions)
    return [inside for inside in found if not any(other < inside for other in found)]


def _compute_share(worth: Worth, player: str, players: Sequence[str]) -> Fraction:
    count = len(players)
    share = Fraction(0)
    for others in list_coalitions([other for other in players if other != player]):
        orders = math.factorial(len(others)) * math.factorial(count - len(others) - 1)
        adds = Fraction(worth[others | {player}]) - Fraction(worth[others])
        share += Fraction(orders, math.factorial(count)) * adds
    return share


def _round_shares(exact: list[Fraction], total: float) -> list[float]:
    """Return the shares as floats whose sum rounds to the total.

    The smallest that is not 0 takes up what rounding the others leaves: its own steps are finest.
    Where that is a tie between two floats, the next smallest does.
    """
    rounded = [float(share) for share in exact]
    rows = sorted((row for row, share in enumerate(rounded) if share), key=lambda r: abs(exact[r]))
    tried = [_absorb(rounded, row, total) for row in rows] or [rounded]
    return next((shares for shares in tried if math.fsum(shares) == total), tried[0])


def _absorb(shares: list[float], row: int, total: float) -> list[float]:
    others = sum((Fraction(share) for at, share in enumerate(shares) if at != row), Fraction())
    return [float(Fraction(total) - others) if at == row else s for at, s in enumerate(shares)]
