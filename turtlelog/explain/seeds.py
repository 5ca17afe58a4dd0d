"""The contributions of random effects: means over seeds, with standard errors."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from statistics import fmean, stdev
from typing import Final

import numpy as np

from turtlelog.explain.attribution import Attribution, Contribution, SeedRange, Together
from turtlelog.explain.game import Coalition, Game, Outcome, list_coalitions
from turtlelog.explain.shapley import Worth, compute_contributions, compute_dividends

_FEWEST: Final = 0.5
"""Of the seeds: fewer are a minority of runs, whatever the others do."""

_CENTRAL: Final = (0.025, 0.975)
"""Between these quantiles lie the central 95 %."""


def divide_over_seeds(found: Attribution, game: Game) -> Attribution:
    """Return the attribution with its contributions, or why there are none.

    A seed counts where every combination has a value with it: combinations are compared by seed.
    """
    names = found.causes
    coalitions = list_coalitions(names)
    played = {inside: game.take_out_each(set(names) - inside) for inside in coalitions}
    count = max(map(len, played.values()))
    worths = _list_worths(played, count)
    known = [worth for worth in worths if worth is not None]
    if len(known) <= _FEWEST * count:
        reason = f"only with {len(known)} of {count} seeds every combination has a value"
        return replace(found, withheld=reason)
    worth = {inside: fmean(one[inside] for one in known) for inside in coalitions}
    contributions = [compute_contributions(one, names) for one in known]
    dividends = [compute_dividends(one, names) for one in known]
    means = compute_contributions(worth, names)
    together = compute_dividends(worth, names)
    return replace(
        found,
        without_all=worth[frozenset()],
        seeds=_describe_seeds([one[frozenset(names)] for one in known], count),
        contributions=tuple(
            replace(
                describe_alone(game, name, contribution),
                standard_error=_find_error([one[name] for one in contributions]),
            )
            for name, contribution in means.items()
        ),
        others=tuple(_add_error(game, other) for other in found.others),
        together=tuple(
            Together(
                causes=case,
                value=value,
                standard_error=_find_error([one[case] for one in dividends]),
            )
            for case, value in together.items()
        ),
    )


def describe_alone(game: Game, name: str, contribution: float | None = None) -> Contribution:
    """Return what a value is without a cause alone."""
    return Contribution(
        cause=name,
        contribution=contribution,
        alone=game.take_out([name]).value,
        ending=game.describe_ending(name) or None,
        meaning=game.causes[name].meaning,
    )


def _list_worths(played: Mapping[Coalition, Sequence[Outcome]], count: int) -> list[Worth | None]:
    """Return the values of all combinations by seed; None where one has none."""
    found: list[Worth | None] = []
    for number in range(count):
        row = {
            inside: outcomes[min(number, len(outcomes) - 1)].value
            for inside, outcomes in played.items()
        }
        worth = {inside: value for inside, value in row.items() if value is not None}
        found.append(worth if len(worth) == len(row) else None)
    return found


def _describe_seeds(values: Sequence[float], count: int) -> SeedRange:
    low, high = np.quantile(values, _CENTRAL).tolist()
    return SeedRange(
        count=count,
        used=len(values),
        mean=fmean(values),
        standard_error=_find_error(values),
        low=low,
        high=high,
    )


def _add_error(game: Game, other: Contribution) -> Contribution:
    """Return a property with the standard error of the change without it, by seed."""
    built, without = game.take_out_each(), game.take_out_each([other.cause])
    pairs = [
        (one.value, without[min(number, len(without) - 1)].value)
        for number, one in enumerate(built)
    ]
    changes = [right - left for left, right in pairs if left is not None and right is not None]
    return replace(other, standard_error=_find_error(changes)) if len(changes) > 1 else other


def _find_error(values: Sequence[float]) -> float:
    return stdev(values) / math.sqrt(len(values))
