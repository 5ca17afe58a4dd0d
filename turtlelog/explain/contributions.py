"""The value of a game divided among its players: exactly, over sampled orders, seeds and starts.

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

import numpy as np
from numpy.typing import NDArray

from turtlelog.explain.attribution import (
    Attribution,
    CausePart,
    Contribution,
    SeedRange,
    StartRange,
    Together,
    find_sample_period_s,
)
from turtlelog.explain.game import SEEDS, Coalition, Game, Outcome, ScenarioGame, list_coalitions
from turtlelog.run import Run
from turtlelog.scenario import Scenario
from turtlelog.simulate import simulate_run

Worth = Mapping[Coalition, float]
"""Value of every coalition."""


def compute_contributions(worth: Worth, causes: Sequence[str]) -> dict[str, float]:
    """Return the contribution of each cause.

    The `math.fsum` of the contributions is the float `worth` of all causes minus that of none, to
    the last bit. If contributions cancel, it may differ by a float step of the smallest
    contribution.
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

    The smallest nonzero contribution, whose float steps are finest, absorbs the rounding of the
    others; in a tie between two floats, the next smallest does.
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
                standard_error=_find_order_error(sizes, len(seeds)),
            )
            for name, sizes in added.items()
        ),
    )


def _list_orders(names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the orders, the same ones at each call; each order is followed by its reverse."""
    draw = random.Random(0)
    drawn = (tuple(draw.sample(names, len(names))) for _ in range(_PAIRS))
    return [order for one in drawn for order in (one, one[::-1])]


def _find_order_error(sizes: Sequence[float], seeds: int) -> float:
    parts = [fmean(pair) for pair in zip(sizes[::2], sizes[1::2], strict=True)]
    if seeds > 1:  # all pairs of a seed contain its effect
        parts = [fmean(parts[seed::seeds]) for seed in range(seeds)]
    return _find_error(parts)


_COUNT: Final = 17
"""Number of starts, a sixteenth of one sample's turn apart. Each start reaches the tolerance at
another point of a sample's motion."""

_WIDE: Final = 0.5
"""Largest range that is not wide, as a share of the effects' total. Over a wider range,
contributions change order between starts. If the total is small by chance, the largest value is
used instead."""

_MOST_TICKS: Final = 200_000
"""Largest number of simulated ticks for dividing the value again at every start: two to three
seconds."""


def spread_starts(scenario: Scenario, built: Run, count: int = _COUNT) -> NDArray[np.float64]:
    """Return angles of equally spaced starts, relative to the scenario's start [rad], shape (n,).

    The angles span the largest turn from one sample to the next, with the scenario's own start in
    the middle; `count` is odd. Empty if the robot does not turn in `built`, the scenario's run.
    """
    turn_rate = float(np.abs(built.samples.turn_rate_rad_s).max(initial=0.0))
    within_rad = 0.5 * turn_rate * find_sample_period_s(scenario)
    return np.linspace(-within_rad, within_rad, count) if within_rad else np.zeros(0)


def turn_start(scenario: Scenario, offset_rad: float) -> Scenario:
    """Return a scenario with its start turned by an angle."""
    heading_rad = scenario.start.heading_rad + offset_rad
    return replace(scenario, start=replace(scenario.start, heading_rad=heading_rad))


def find_steady_span(values: Sequence[float | None], added: float, resolution: float) -> float:
    """Return the largest range of values that counts as steady, for a total of the causes."""
    if abs(added) > resolution:
        return _WIDE * abs(added)
    greatest = max((abs(value) for value in values if value is not None), default=0.0)
    return max(resolution, _WIDE * greatest)


def ranges_over(values: Sequence[float | None], span: float) -> bool:
    """Return whether the range of the existing values exceeds a span."""
    known = [value for value in values if value is not None]
    return bool(known) and max(known) - min(known) > span


def subtract_values(
    values: Sequence[float | None], without: Sequence[float | None]
) -> list[float | None]:
    """Return the total of the causes at each start; None if a value is missing.

    A value that only follows the start, such as the length of a turn, follows the start also
    without the causes. The total of the causes is then steady.
    """
    return [
        None if value is None or rest is None else value - rest
        for value, rest in zip(values, without, strict=True)
    ]


def vary_start(
    scenario: Scenario, metric: str, *, added: float, resolution: float, acting: Sequence[str]
) -> StartRange | None:
    """Return the range of the value over starts within one sample's turn; None without a turn.

    The metric has a value, to which the `acting` causes contribute `added` in total. A change
    within `resolution` is negligible.
    """
    built = simulate_run(scenario)
    offsets_rad = spread_starts(scenario, built).tolist()
    if not offsets_rad:
        return None
    games = [ScenarioGame(turn_start(scenario, offset_rad), metric) for offset_rad in offsets_rad]
    found = [game.take_out().value for game in games]
    values = [value for value in found if value is not None]
    span = find_steady_span(values, added, resolution)
    is_far = ranges_over(values, span)
    without = [game.take_out(acting).value for game in games] if is_far else []
    is_wide = is_far and ranges_over(subtract_values(found, without), span)
    rest = [value for value in without if value is not None]
    ticks = len(built.poses) * len(games) * 2 ** len(acting)
    return StartRange(
        count=len(games),
        within_rad=offsets_rad[-1],
        low=min(values),
        high=max(values),
        without_value=len(found) - len(values),
        is_wide=is_wide,
        parts=_divide_again(games, acting) if is_wide and ticks <= _MOST_TICKS else (),
        without_all=(min(rest), max(rest)) if is_wide and len(rest) == len(games) else None,
    )


def _divide_again(games: Sequence[ScenarioGame], causes: Sequence[str]) -> tuple[CausePart, ...]:
    """Return the lowest and highest part of each cause; empty unless all parts are positive."""
    parts = []
    for game in games:
        every = {*causes}
        found = {one: game.take_out(every - one).value for one in list_coalitions(causes)}
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
        CausePart(cause=name, low=low, high=high)
        for name, low, high in zip(causes, lows, highs, strict=True)
    )


_FEWEST: Final = 0.5
"""Smallest share of seeds with a value. With fewer seeds, those without a value would be the
majority."""

_CENTRAL: Final = (0.025, 0.975)
"""Quantiles that bound the central 95 %."""


def divide_over_seeds(found: Attribution, game: Game) -> Attribution:
    """Return the attribution divided over the seeds with which every combination has a value."""
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
    """Return the value without a cause alone."""
    return Contribution(
        cause=name,
        contribution=contribution,
        alone=game.take_out([name]).value,
        ending=game.describe_ending(name) or None,
        meaning=game.causes[name].meaning,
    )


def _list_worths(played: Mapping[Coalition, Sequence[Outcome]], count: int) -> list[Worth | None]:
    """Return the values of all combinations by seed; None if a value is missing."""
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
    """Return a property with the standard error of the change by removing the cause, over seeds."""
    built, without = game.take_out_each(), game.take_out_each([other.cause])
    pairs = [
        (one.value, without[min(number, len(without) - 1)].value)
        for number, one in enumerate(built)
    ]
    changes = [right - left for left, right in pairs if left is not None and right is not None]
    return replace(other, standard_error=_find_error(changes)) if len(changes) > 1 else other


def _find_error(values: Sequence[float]) -> float:
    return stdev(values) / math.sqrt(len(values))
