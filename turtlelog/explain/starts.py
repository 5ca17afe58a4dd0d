"""How steady a value is: over starts that one sample's turn spans."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.explain.attribution import CausePart, StartRange, find_sample_period_s
from turtlelog.explain.game import ScenarioGame, list_coalitions
from turtlelog.explain.shapley import compute_contributions
from turtlelog.run import Run
from turtlelog.scenario import Scenario
from turtlelog.simulate import simulate_run

_COUNT: Final = 17
"""Starts: a sixteenth of one sample's turn apart, so that each of them meets the tolerance at
another point of a sample's way."""

_WIDE: Final = 0.5
"""Of what the effects add: over a wider range their parts change places from start to start. Of a
start to which they add little, by luck, it is taken of the greatest value."""

_MOST_TICKS: Final = 200_000
"""Simulated to divide the value again at every start: two to three seconds."""


def spread_starts(scenario: Scenario, built: Run, count: int = _COUNT) -> NDArray[np.float64]:
    """Return how far starts at equal distances are turned from a scenario's own [rad], shape (n,).

    They span the largest turn from one sample to the next, with the scenario's own in the middle.

    Args:
        scenario: With all causes in.
        built: Its run.
        count: How many starts, odd.

    Returns:
        The angles; empty where the robot does not turn.
    """
    turn_rate = float(np.abs(built.samples.turn_rate_rad_s).max(initial=0.0))
    within_rad = 0.5 * turn_rate * find_sample_period_s(scenario)
    return np.linspace(-within_rad, within_rad, count) if within_rad else np.zeros(0)


def turn_start(scenario: Scenario, offset_rad: float) -> Scenario:
    """Return a scenario whose start is turned by an angle."""
    heading_rad = scenario.start.heading_rad + offset_rad
    return replace(scenario, start=replace(scenario.start, heading_rad=heading_rad))


def find_steady_span(values: Sequence[float | None], added: float, resolution: float) -> float:
    """Return over how much values may range that are steady.

    Args:
        values: From each start.
        added: What the causes add to the scenario's own.
        resolution: The largest change that is negligible.
    """
    if abs(added) > resolution:
        return _WIDE * abs(added)
    greatest = max((abs(value) for value in values if value is not None), default=0.0)
    return max(resolution, _WIDE * greatest)


def ranges_over(values: Sequence[float | None], span: float) -> bool:
    """Return whether those of the values that are there range over more than a span."""
    known = [value for value in values if value is not None]
    return bool(known) and max(known) - min(known) > span


def subtract_values(
    values: Sequence[float | None], without: Sequence[float | None]
) -> list[float | None]:
    """Return what the causes add at each start; None where one of both has no value.

    A value that only follows the start, as a turn's length does, follows it without them as well:
    what they add is steady.
    """
    return [
        None if value is None or rest is None else value - rest
        for value, rest in zip(values, without, strict=True)
    ]


def vary_start(
    scenario: Scenario, metric: str, *, added: float, resolution: float, acting: Sequence[str]
) -> StartRange | None:
    """Return the value over starts within one sample's turn, None where the robot does not turn.

    Args:
        scenario: With all causes in.
        metric: Has a value.
        added: What the causes add together.
        resolution: The largest change that is negligible.
        acting: The causes that change the value.
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
        CausePart(cause=name, low=low, high=high)
        for name, low, high in zip(causes, lows, highs, strict=True)
    )
