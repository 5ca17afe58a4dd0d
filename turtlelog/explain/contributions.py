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
from functools import partial
from itertools import pairwise
from statistics import fmean, stdev
from typing import Final, TypeVar

import numpy as np

from turtlelog.explain import answers
from turtlelog.explain.answers import (
    AttributedValue,
    CausePart,
    Contribution,
    StartRange,
    Together,
    is_clear,
)
from turtlelog.explain.causes import NAMED
from turtlelog.explain.game import (
    SEEDS,
    Coalition,
    Game,
    Outcome,
    Play,
    ScenarioGame,
    iterate_outcomes,
    list_coalitions,
    spread_starts,
    turn_start,
)
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
    count, exact = len(causes), [Fraction()] * len(causes)
    for row, cause in enumerate(causes):
        for others in list_coalitions([other for other in causes if other != cause]):
            orders = math.factorial(len(others)) * math.factorial(count - len(others) - 1)
            adds = Fraction(worth[others | {cause}]) - Fraction(worth[others])
            exact[row] += Fraction(orders, math.factorial(count)) * adds
    # The smallest nonzero contribution, whose float steps are finest, absorbs the rounding of the
    # others; in a tie between two floats, the next smallest does.
    total = worth[frozenset(causes)] - worth[frozenset()]
    rounded = [float(one) for one in exact]
    rows = sorted((row for row, one in enumerate(rounded) if one), key=lambda row: abs(exact[row]))
    tried = [[*rounded] for _ in rows] or [rounded]
    for row, found in zip(rows, tried, strict=False):
        rest = sum((Fraction(one) for at, one in enumerate(rounded) if at != row), Fraction())
        found[row] = float(Fraction(total) - rest)
    chosen = next((found for found in tried if math.fsum(found) == total), tried[0])
    return dict(zip(causes, chosen, strict=True))


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


_Divided = TypeVar("_Divided", bound=AttributedValue)

_PAIRS: Final = 4 * len(SEEDS)
"""Number of sampled orders, each used together with its reverse: about 6 s for the paper's runs
with fourteen groups."""

ORDERS: Final = 2 * _PAIRS
"""Number of sampled orders."""


def sample_game(found: _Divided, game: Game) -> _Divided:
    """Return an attribution whose contributions are means over sampled orders of its causes.

    Each order is paired with its reverse, which cancels the effect of the position in an order. If
    the game is random, every seed has the same number of pairs, and the errors are over seeds.
    """
    # The same orders at each call; each order is followed by its reverse.
    draw, names = random.Random(0), found.causes
    drawn = (tuple(draw.sample(names, len(names))) for _ in range(_PAIRS))
    orders = [order for one in drawn for order in (one, one[::-1])]
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
    contributions = []
    for name, sizes in added.items():
        parts = [fmean(pair) for pair in zip(sizes[::2], sizes[1::2], strict=True)]
        if len(seeds) > 1:  # all pairs of a seed contain its effect
            parts = [fmean(parts[seed :: len(seeds)]) for seed in range(len(seeds))]
        contribution = Contribution(
            cause=name,
            contribution=fmean(sizes),
            alone=game.take_out([name]).value,
            meaning=game.causes[name].meaning,
            standard_error=_find_error(parts),
        )
        contributions.append(contribution)
    return replace(found, contributions=tuple(contributions))


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
    offsets_rad = spread_starts(scenario, built, _COUNT).tolist()
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


def vary_both_starts(
    scenarios: Sequence[Scenario], metric: str, difference: float, resolution: float
) -> answers.DifferenceRange | None:
    """Return the range of the difference over starts within one sample's turn of the faster run."""
    spreads = [spread_starts(one, simulate_run(one), _COUNT) for one in scenarios]
    offsets_rad = max(spreads, key=lambda one: one[-1] if len(one) else 0.0).tolist()
    if not offsets_rad:
        return None
    plays = [
        [Play(turn_start(scenario, by), is_finer=False, may_fail=True) for by in offsets_rad]
        for scenario in scenarios
    ]
    values = [[one.value for one in iterate_outcomes(metric, side, jobs=1)] for side in plays]
    apart = subtract_values(values[1], values[0])
    known = [[value for value in one if value is not None] for one in (apart, *values)]
    if not all(known):
        return None
    spans = [(min(one), max(one)) for one in known]
    return answers.DifferenceRange(
        count=len(offsets_rad),
        within_rad=offsets_rad[-1],
        difference=spans[0],
        first=spans[1],
        second=spans[2],
        is_wide=ranges_over(apart, find_steady_span(apart, difference, resolution)),
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


def divide_game(found: _Divided, game: Game) -> _Divided:
    """Return an attribution with the contributions of its causes, or why these are missing."""
    if game.is_random and found.resimulated is not None:
        return divide_over_seeds(found, game)
    # If a run has no value, the reason comes from its own seed.
    outcomes = {
        inside: game.play_as_recorded({*found.causes} - inside)
        for inside in list_coalitions(found.causes)
    }
    worth = {key: one.value for key, one in outcomes.items() if one.value is not None}
    found = replace(found, without_all=outcomes[frozenset()].value)
    if len(worth) < len(outcomes):
        return _tell_what_has_no_value(found, outcomes)
    contributions = compute_contributions(worth, found.causes)
    dividends = compute_dividends(worth, found.causes)
    return replace(
        found,
        contributions=tuple(game.describe_alone(*one) for one in contributions.items()),
        together=tuple(Together(causes=names, value=value) for names, value in dividends.items()),
    )


def _tell_what_has_no_value(found: _Divided, outcomes: Mapping[Coalition, Outcome]) -> _Divided:
    """Return the smallest sets of causes that decide whether there is a value."""
    missing = [inside for inside, outcome in outcomes.items() if outcome.value is None]
    present = [inside for inside in outcomes if inside not in missing]

    def describe(inside: Coalition) -> answers.ValueSet:
        names = tuple(name for name in found.causes if name in inside)
        return answers.ValueSet(causes=names, reason=outcomes[inside].reason or None)

    is_empty = frozenset() in missing
    return replace(
        found,
        withheld="with some of the causes it has a value, with others none"
        if present
        else "it has no value",
        without_value=tuple(describe(inside) for inside in find_smallest(missing)),
        with_value=tuple(describe(inside) for inside in find_smallest(present) if is_empty),
    )


_FEWEST: Final = 0.5
"""Smallest share of seeds with a value. With fewer seeds, those without a value would be the
majority."""

_CENTRAL: Final = (0.025, 0.975)  # quantiles that bound the central 95 %


def divide_over_seeds(found: _Divided, game: Game) -> _Divided:
    """Return the attribution divided over the seeds with which every combination has a value."""
    names = found.causes
    coalitions = list_coalitions(names)
    played = {inside: game.take_out_each(set(names) - inside) for inside in coalitions}
    count, known = max(map(len, played.values())), []
    for number in range(count):
        row = {key: found[min(number, len(found) - 1)].value for key, found in played.items()}
        worth = {inside: value for inside, value in row.items() if value is not None}
        if len(worth) == len(row):
            known.append(worth)
    if len(known) <= _FEWEST * count:
        reason = f"only with {len(known)} of {count} seeds every combination has a value"
        return replace(found, withheld=reason)
    worth = {inside: fmean(one[inside] for one in known) for inside in coalitions}
    contributions = [compute_contributions(one, names) for one in known]
    dividends = [compute_dividends(one, names) for one in known]
    means = compute_contributions(worth, names)
    together = compute_dividends(worth, names)
    values = [one[frozenset(names)] for one in known]
    low, high = np.quantile(values, _CENTRAL).tolist()
    built, others = game.take_out_each(), []
    for other in found.others:
        without = game.take_out_each([other.cause])
        pairs = [(one, without[min(row, len(without) - 1)]) for row, one in enumerate(built)]
        changes = [
            after.value - before.value
            for before, after in pairs
            if before.value is not None and after.value is not None
        ]
        error = _find_error(changes) if len(changes) > 1 else other.standard_error
        others.append(replace(other, standard_error=error))
    return replace(
        found,
        without_all=worth[frozenset()],
        seeds=answers.SeedRange(
            count=count,
            used=len(values),
            mean=fmean(values),
            standard_error=_find_error(values),
            low=low,
            high=high,
        ),
        contributions=tuple(
            replace(
                game.describe_alone(name, contribution),
                standard_error=_find_error([one[name] for one in contributions]),
            )
            for name, contribution in means.items()
        ),
        others=tuple(others),
        together=tuple(
            Together(
                causes=case,
                value=value,
                standard_error=_find_error([one[case] for one in dividends]),
            )
            for case, value in together.items()
        ),
    )


def _find_error(values: Sequence[float]) -> float:
    return stdev(values) / math.sqrt(len(values))


ALIKE: Final = 1.25  # largest ratio of contributions that count as about equal


def choose_leading(found: AttributedValue) -> list[Contribution]:
    """Return the other causes that change the value more than all effects, the largest first."""
    if found.without_value or found.withheld:
        return []
    sizes = [abs(one.size) for one in found.contributions]
    least = ALIKE * max(abs(sum_effects(found)), *sizes, 0.0)
    telling = sorted(list_telling(found), key=partial(_measure_change, found), reverse=True)
    # Runs that end otherwise have values of another kind.
    telling = [one for one in telling if not (one.ending or is_lowering(found, one))]
    return [one for one in telling if least < _measure_change(found, one) < math.inf]


def choose_named(found: AttributedValue) -> list[Contribution]:
    """Return the contributions that explain the value, the largest first; empty if too small."""
    if not found.acting or found.withheld or is_negligible(found):
        return []
    return [one for one in list_large(found) if one.is_clear]


def is_negligible(found: AttributedValue) -> bool:
    """Return whether each effect, and their total, is within the resolution."""
    largest = max((abs(one.size) for one in found.contributions), default=0.0)
    return max(largest, abs(sum_effects(found))) <= found.resolution.size


def sum_effects(found: AttributedValue) -> float:
    """Return the change of the value by all effects together."""
    return found.divided - (found.without_all or 0.0)


def list_large(found: AttributedValue) -> list[Contribution]:
    """Return the contributions that are not small beside all others, the largest first."""
    ordered = sorted(found.contributions, key=lambda one: -abs(one.size))
    least = NAMED * math.fsum(abs(one.size) for one in ordered)
    return [one for one in ordered if abs(one.size) > least]


def _measure_change(found: AttributedValue, one: Contribution) -> float:
    return math.inf if one.alone is None else abs(one.alone - found.divided)


def list_telling(found: AttributedValue) -> list[Contribution]:
    """Return the other causes that change the value clearly if they are removed alone."""

    def tells(one: Contribution) -> bool:
        # The tolerance is not judged by the resolution that it makes.
        makes = one.cause == "tolerance" and found.resolution.is_tolerance
        least = max(0.0 if makes else found.resolution.size, NAMED * abs(found.divided))
        change = _measure_change(found, one)
        return change > least and is_clear(change, one.standard_error)

    return [*filter(tells, found.others)]


def is_lowering(found: AttributedValue, one: Contribution) -> bool:
    """Return whether a design parameter lowers a value that the effects do not lower."""
    if one.cause in found.effects or one.alone is None or one.ending:
        return False
    return one.alone > found.divided >= 0.0 <= sum_effects(found)
