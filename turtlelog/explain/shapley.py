"""A value as a game: simulated without any set of mechanisms, and divided in exact arithmetic.

A share is a Shapley value (Shapley, "A value for n-person games", 1953): what a player adds to the
value, averaged over all orders in which the players can be put in. What a set of players makes
only together is its dividend (Harsanyi, 1963).
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations
from typing import Final

from turtlelog.explain.law_identification import describe_phase
from turtlelog.explain.mechanisms import SAMPLING, find_mechanisms, simulate_without
from turtlelog.measure import measure_run
from turtlelog.run import Run
from turtlelog.scenario import Scenario

_OF_DEAD_TIME: Final = ("dead_time", "delayed_deviation_max", "delayed_deviation_rms")
"""Dead times are looked for up to 40 poses, which a finer clock passes in a few ticks."""

Coalition = frozenset[str]
"""The players that are in."""

Worth = Mapping[Coalition, float]
"""The value of every coalition."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What a simulation came to.

    Attributes:
        value: Of the metric, None where it has none.
        reason: Why it has none, else empty.
        ended: Names of the phases that came to their end, in order.
    """

    value: float | None
    reason: str
    ended: tuple[str, ...]


class Game:
    """Plays a scenario with some of its mechanisms out, and remembers the outcomes.

    Attributes:
        mechanisms: All that may be taken out, by name.
    """

    def __init__(self, scenario: Scenario, metric: str) -> None:
        """Take the scenario with all mechanisms in."""
        self._scenario, self._metric = scenario, metric
        self.mechanisms = find_mechanisms(scenario)
        self._outcomes: dict[frozenset[str], Outcome] = {}

    def play(self, inside: Coalition, players: Sequence[str]) -> Outcome:
        """Return the outcome with these players in, and all others out."""
        return self.take_out(name for name in players if name not in inside)

    def take_out(self, names: Iterable[str] = ()) -> Outcome:
        """Return the outcome without these mechanisms."""
        out = frozenset(names)
        if out not in self._outcomes:
            run = simulate_without(self._scenario, out)
            found = measure_run(run, only=[self._metric])[self._metric]
            value, reason = found.value, found.reason
            if SAMPLING in out and self._metric.endswith(_OF_DEAD_TIME):
                value, reason = None, "dead times are not measured on a finer clock"
            self._outcomes[out] = Outcome(value=value, reason=reason, ended=_find_ended(run))
        return self._outcomes[out]

    def describe_ending(self, name: str) -> str:
        """Return what differs in kind without a mechanism, in one clause; empty: nothing does."""
        built, without = self.take_out(), self.take_out([name])
        longer = [phase for phase in built.ended if phase not in without.ended]
        sooner = [phase for phase in without.ended if phase not in built.ended]
        within = f"within {self._scenario.max_duration_s:g} s"
        kind = self._scenario.law.kind
        if longer:
            return f"{describe_phase(kind, longer[0])} no longer ends {within}"
        if sooner:
            return f"{describe_phase(kind, sooner[0])} ends {within}"
        return without.reason


def _find_ended(run: Run) -> tuple[str, ...]:
    spans = run.find_phase_spans()
    ended = (span.phase for span in (spans if run.is_complete else spans[:-1]))
    return tuple(dict.fromkeys(ended))


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
