"""Contributions of many causes, from a sample of the orders in which they can be put in."""

import math
import random
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from statistics import fmean, stdev
from typing import Final

from turtlelog.explain.attribution import Attribution, Contribution
from turtlelog.explain.game import SEEDS, Game

_PAIRS: Final = 4 * len(SEEDS)
"""Orders, each with its reverse: some 6 s of the paper's runs with fourteen groups."""

ORDERS: Final = 2 * _PAIRS
"""How many orders are sampled."""


def sample_game(found: Attribution, game: Game) -> Attribution:
    """Return an attribution whose contributions are means over sampled orders of its causes.

    Each order comes with its reverse, which takes out what the place in an order makes. If the game
    is random, every seed has as many pairs, and the errors are those over seeds.
    """
    orders = list_orders(found.causes)
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


def list_orders(names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the orders, the same ones each time: each is followed by its reverse."""
    draw = random.Random(0)
    drawn = (tuple(draw.sample(names, len(names))) for _ in range(_PAIRS))
    return [order for one in drawn for order in (one, one[::-1])]


def _find_error(sizes: Sequence[float], seeds: int) -> float:
    parts = [fmean(pair) for pair in zip(sizes[::2], sizes[1::2], strict=True)]
    if seeds > 1:  # what one seed makes is in all of its pairs
        parts = [fmean(parts[seed::seeds]) for seed in range(seeds)]
    return stdev(parts) / math.sqrt(len(parts))
