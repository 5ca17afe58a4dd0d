"""Which settings of the loop reproduce a log: simulate those that its hints allow, and compare."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, product
from math import ceil
from typing import Any, Final

import numpy as np

from turtlelog.explain.loop import Guess, Hints, agrees_with_clock, list_queues
from turtlelog.explain.resimulation import Row, compute_misfit, count_equal, list_rows
from turtlelog.explain.trace import Trace
from turtlelog.measure import DeadTime, Missing
from turtlelog.run import Phase
from turtlelog.scenario import Scenario, build_scenario, nest_parameters
from turtlelog.simulate import iterate_ticks, simulate_run
from turtlelog.turtlesim import TICK_S

_CERTAIN: Final = 10.0
"""Difference of log-likelihoods from which a setting is worse than another."""

_MOST_SIMULATED: Final = 24
"""Settings that are simulated to their end where none is exact."""

_MOST_TICKS: Final = 100_000

_SPARE_S: Final = 3.0
"""How much longer than the log a simulation may take before it counts as another [s]."""

_USUAL_S: Final = Scenario().max_duration_s

_DEPTHS: Final = ("loop.command_queue", "loop.pose_queue")

Settings = Mapping[str, Any]

_Exact = tuple[Guess, int]
"""Settings that reproduce every sample, and how many samples were simulated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fits:
    """The settings that fit a log.

    Attributes:
        guesses: Values by key of the scenario, the likeliest first; at least one.
        scenarios: The same as whole scenarios.
        is_exact: Whether they reproduce every sample, bit for bit or else to rounding.
        tried: How many were simulated.
        hidden: Keys whose value makes no difference in this run.
    """

    guesses: tuple[Guess, ...]
    scenarios: tuple[Scenario, ...]
    is_exact: bool
    tried: int
    hidden: frozenset[str] = frozenset()

    @property
    def scenario(self) -> Scenario:
        """The likeliest."""
        return self.scenarios[0]

    def list_values(self, key: str) -> tuple[Any, ...]:
        """Return the values of a key, the likeliest first."""
        return tuple(dict.fromkeys(guess[key] for guess in self.guesses))


def search_loop(
    trace: Trace,
    known: Settings,
    hints: Hints,
    dead_times: Mapping[Phase, DeadTime | Missing],
) -> Fits:
    """Return the settings of the loop that reproduce a log, with `known` for all others.

    The usual depths of the queues are tried first, others only where those do not fit, or fit with
    a pause or a backlog that the clock contradicts.
    Where nothing is exact the settings that leave the least are returned.
    """
    search = _Search(trace, known, hints)
    tiers = list_queues(trace, hints, dead_times[Phase.ROTATE], dead_times[Phase.TRANSLATE])
    for search.to_rounding in (False, True):
        exact: list[_Exact] = []
        for tier in tiers:
            exact += search.find_exact(tier)
            if any(search.contradict_clock(guess) == (False, False) for guess, _ in exact):
                break
        if exact:
            least = min(search.contradict_clock(guess) for guess, _ in exact)
            return search.build_exact_fits(
                [found for found in exact if search.contradict_clock(found[0]) == least]
            )
    return search.find_likeliest(next(filter(None, tiers)))


class _Search:
    """Builds and simulates scenarios; counts them.

    Attributes:
        to_rounding: Whether samples need to be reproduced to rounding only.
    """

    def __init__(self, trace: Trace, known: Settings, hints: Hints) -> None:
        self._trace, self._known, self._hints = trace, known, hints
        self._rows = list_rows(trace)
        pauses = hints.pauses
        self._near = [p for p in pauses if agrees_with_clock(p, hints, trace)] or pauses
        self._most_s = float(trace.run.end_ns - trace.run.poses.time_ns[0]) / 1e9 + _SPARE_S
        self._tried = 0
        self.to_rounding = False

    def build(self, guess: Settings, **more: Any) -> Scenario:
        """Return the scenario of a guess."""
        values = {"name": self._trace.run.name, **self._known, **guess, **more}
        values.setdefault("max_duration_s", self._most_s)
        return build_scenario(nest_parameters(values), source=self._trace.run.name)

    def find_exact(self, queues: Sequence[Guess]) -> list[_Exact]:
        """Return the settings that reproduce every sample, of them those nearest to the clock."""
        first, rotation = self._hints.pauses[0], self._list_rotation()
        alike = [
            guess
            for guess in queues
            if self._count(_pause(guess, first), rotation) >= len(rotation)
        ]
        guesses = [_pause(guess, pause) for pause, guess in product(self._hints.pauses, alike)]
        guesses.sort(key=self.contradict_clock)
        for _, group in groupby(guesses, key=self.contradict_clock):
            counted = [(guess, self._count(guess, self._rows)) for guess in group]
            exact = [(guess, count) for guess, count in counted if count >= len(self._rows)]
            if exact:
                return exact
        return []

    def contradict_clock(self, guess: Guess) -> tuple[bool, bool]:
        """Return whether time stamps and pose numbers contradict the pause, and the backlog."""
        return (
            guess["law.pause_ticks"] not in self._near,
            guess["loop.start_backlog"] not in self._hints.backlogs,
        )

    def build_exact_fits(self, exact: Sequence[_Exact]) -> Fits:
        """Return the settings found, as scenarios that end where the log does."""
        guess = exact[0][0]
        hidden = {
            key
            for key in _DEPTHS
            if self._count({**guess, key: guess[key] + 1}, self._rows) >= len(self._rows)
        }
        return Fits(
            guesses=tuple(guess for guess, _ in exact),
            scenarios=tuple(
                self._end(self.build(guess), goes_on=count > len(self._rows))
                for guess, count in exact
            ),
            is_exact=True,
            tried=self._tried,
            hidden=frozenset(hidden),
        )

    def find_likeliest(self, queues: Sequence[Guess]) -> Fits:
        """Return the settings that leave the least; the clock tells the pause."""
        guesses = [_pause(guess, pause) for guess, pause in product(queues, self._near)]
        ticks = self._most_s / TICK_S
        guesses = guesses[: max(min(_MOST_SIMULATED, int(_MOST_TICKS / ticks)), 1)]
        scenarios = [self.build(guess) for guess in guesses]
        misfits = [compute_misfit(self._trace, simulate_run(found)) for found in scenarios]
        order = np.argsort(misfits, kind="stable").tolist()
        best = [row for row in order if misfits[row] < misfits[order[0]] + _CERTAIN]
        return Fits(
            guesses=tuple(guesses[row] for row in best),
            scenarios=tuple(self._end(scenarios[row], goes_on=False) for row in best),
            is_exact=False,
            tried=self._tried + len(guesses),
        )

    def _list_rotation(self) -> list[Row | None]:
        return self._rows[: int(self._trace.number[self._trace.rotating - 1]) + 1]

    def _count(self, guess: Guess, rows: list[Row | None]) -> int:
        self._tried += 1
        return count_equal(self.build(guess), rows, to_rounding=self.to_rounding)

    def _end(self, scenario: Scenario, *, goes_on: bool) -> Scenario:
        """Let a scenario end with the log where the log was cut, else leave it the usual time."""
        if not goes_on:
            return replace(scenario, max_duration_s=max(_USUAL_S, ceil(self._most_s)))
        return replace(scenario, max_duration_s=self._find_end_s(scenario))

    def _find_end_s(self, scenario: Scenario) -> float:
        run = self._trace.run
        if self._trace.has_exact_clock and self._trace.has_ticks:
            return float(run.end_ns - run.poses.time_ns[0]) / 1e9
        samples = 0
        for tick in iterate_ticks(scenario):
            samples += len(tick.computed)
            if samples >= len(self._rows):
                return tick.time_ns / 1e9
        return scenario.max_duration_s


def _pause(guess: Guess, ticks: int) -> Guess:
    return {**guess, "law.pause_ticks": ticks}
