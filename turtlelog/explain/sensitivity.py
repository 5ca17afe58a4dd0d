"""What a value hangs on: the same scenario from starts that lie within one sample's turn."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from turtlelog.explain.attribution import StartRange
from turtlelog.explain.shapley import Game, compute_shares, list_coalitions
from turtlelog.plants.turtlesim import TICK_S
from turtlelog.scenario import Scenario
from turtlelog.simulate import simulate_run

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
    grain: float,
    players: Sequence[str],
    acting: Sequence[str],
) -> StartRange | None:
    """Return the value over starts within one sample's turn, None where the robot does not turn.

    Args:
        scenario: With all mechanisms in.
        metric: Has a value.
        added: What the players add together.
        grain: The largest change that is next to nothing.
        players: Among whom the value is divided.
        acting: Those of them that change it.
    """
    built = simulate_run(scenario)
    turn_rate = float(np.abs(built.samples.turn_rate_rad_s).max())
    within_rad = 0.5 * turn_rate * scenario.loop.period_ticks * TICK_S
    if within_rad == 0.0:
        return None
    games = [
        Game(_turn_start(scenario, offset), metric)
        for offset in np.linspace(-within_rad, within_rad, _COUNT).tolist()
    ]
    found = [game.take_out().value for game in games]
    values = [value for value in found if value is not None]
    is_wide = _is_wide(values, games, players, added) if abs(added) > grain else False
    ticks = len(built.poses) * len(games) * 2 ** len(acting)
    return StartRange(
        count=len(games),
        within_rad=within_rad,
        low=min(values),
        high=max(values),
        without_value=len(found) - len(values),
        is_wide=is_wide,
        parts=_divide_again(games, acting) if is_wide and ticks <= _MOST_TICKS else {},
    )


def _is_wide(
    values: Sequence[float], games: Sequence[Game], players: Sequence[str], added: float
) -> bool:
    """Return whether the value, and what the players add to it, range over too much.

    A value that only follows the start, as a turn's length does, follows it without them as well.
    """
    if max(values) - min(values) <= _WIDE * abs(added):
        return False
    additions = [
        built - without
        for built, without in (
            (game.take_out().value, game.take_out(players).value) for game in games
        )
        if built is not None and without is not None
    ]
    return max(additions) - min(additions) > _WIDE * abs(added)


def _turn_start(scenario: Scenario, offset_rad: float) -> Scenario:
    heading_rad = scenario.start.heading_rad + offset_rad
    return replace(scenario, start=replace(scenario.start, heading_rad=heading_rad))


def _divide_again(
    games: Sequence[Game], players: Sequence[str]
) -> Mapping[str, tuple[float, float]]:
    """Return the lowest and highest part of each player; none where they do not all add alike."""
    parts = []
    for game in games:
        found = {inside: game.play(inside, players).value for inside in list_coalitions(players)}
        worth = {inside: value for inside, value in found.items() if value is not None}
        if len(worth) < len(found):
            return {}
        total = worth[frozenset(players)] - worth[frozenset()]
        shares = compute_shares(worth, players)
        if any(share * total <= 0.0 for share in shares.values()):
            return {}
        parts.append([share / total for share in shares.values()])
    lows, highs = np.min(parts, axis=0).tolist(), np.max(parts, axis=0).tolist()
    return dict(zip(players, zip(lows, highs, strict=True), strict=True))
