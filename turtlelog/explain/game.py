"""A value as a cooperative game: simulations without sets of causes, and from turned starts.

Scenarios with a random acting cause are simulated with all of `SEEDS`, also without causes.
"""

import math
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, combinations, islice
from statistics import fmean
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import join_words
from turtlelog.errors import ExplainError, ScenarioError, SimulationError
from turtlelog.explain.answers import AttributedValue, Contribution
from turtlelog.explain.causes import (
    SAMPLING,
    draws_random,
    find_causes,
    find_sample_period_s,
    is_present,
    simulate_finer,
    simulate_without,
    take_out,
    undo_changes,
)
from turtlelog.explain.scenario_from_log import Identification
from turtlelog.explain.scenario_from_log.law_identification import describe_phase
from turtlelog.laws import LAWS
from turtlelog.measure import find_metric_kind, measure_run
from turtlelog.processes import count_cores, map_in_processes
from turtlelog.run import Run
from turtlelog.run.loops import Cause
from turtlelog.run.tables import find_phase_spans
from turtlelog.scenario import Scenario
from turtlelog.simulate import simulate_many

SEEDS: Final = tuple(range(1_000_000_000, 1_000_000_032))
"""Seeds for means. The seeds are the same for all runs, so that runs with different seeds have
equal contributions. The seeds differ from the usual seeds."""

_FEW: Final = 4
"""Number of simulations up to which another process is never useful: about 40 ms of work."""

_BLOCK: Final = 8
"""Number of simulations in one task, small enough that all processes finish together."""

_LONG_S: Final = 6.0
"""Work from which several processes are used [s]: starting a process takes one or two seconds."""

Coalition = frozenset[str]
"""The acting causes."""

_Play = tuple[frozenset[str], int | None]
"""The removed causes, and the seed; None: the seed of the scenario."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Work:
    """Settings of the simulation.

    Attributes:
        jobs: Number of processes, at least 1. Default: one per core if that is faster. Each process
            imports the main module, so a script with several processes keeps its own work under `if
            __name__ == "__main__":`. A law that is not built in is simulated in one process.
        report: Function called with the numbers of simulations done and known to be needed.
    """

    jobs: int | None = 1
    report: Callable[[int, int], None] | None = None

    def __post_init__(self) -> None:
        if self.jobs is not None and self.jobs < 1:
            raise ExplainError(f"jobs: expected at least 1 process, found {self.jobs}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """Result of a simulation, or the majority of results over several seeds.

    Attributes:
        value: Value of the metric, over several seeds the mean; None if the metric has no value.
        reason: Reason why there is no value; otherwise empty.
        ended: Names of the phases that ended, in order.
        end_xy_m: Position of the last pose [m]; None for several seeds, or if the law failed.
    """

    value: float | None
    reason: str
    ended: tuple[str, ...]
    end_xy_m: tuple[float, float] | None = None


class Game(ABC):
    """Base of games: simulations without any given set of causes, with stored outcomes.

    Attributes:
        causes: All removable causes by name.
        present: Acting causes, in the order of `causes`; removing another cause changes nothing.
        is_random: Whether a single run shows little, so that outcomes are averaged over seeds.
    """

    def __init__(
        self,
        causes: Mapping[str, Cause],
        present: Sequence[str],
        work: Work | None = None,
        *,
        is_random: bool,
    ) -> None:
        """Store the causes; nothing is simulated yet."""
        self._work = work or Work()
        self.causes, self.present, self.is_random = causes, tuple(present), is_random
        self._outcomes: dict[_Play, Outcome] = {}

    @abstractmethod
    def list_seeds(self, out: Coalition) -> tuple[int | None, ...]:
        """Return the seeds for a simulation; only None if the remaining scenario is not random."""

    @abstractmethod
    def describe_ending(self, name: str) -> str:
        """Return a difference in kind without a cause, in one clause; empty if nothing differs."""

    @abstractmethod
    def _play(self, plays: Sequence[_Play]) -> Iterator[Outcome]:
        """Yield the outcome of each simulation."""

    def describe_alone(self, name: str, contribution: float | None = None) -> Contribution:
        """Return the value without a cause alone."""
        return Contribution(
            cause=name,
            contribution=contribution,
            alone=self.take_out([name]).value,
            ending=self.describe_ending(name) or None,
            meaning=self.causes[name].meaning,
        )

    def take_out(self, names: Iterable[str] = ()) -> Outcome:
        """Return the outcome without these causes; for a random game, the majority over seeds."""
        outcomes = self.take_out_each(names)
        if len(outcomes) == 1:
            return outcomes[0]
        most = len(outcomes) / 2.0
        values = [found.value for found in outcomes if found.value is not None]
        ended = Counter(phase for found in outcomes for phase in found.ended)
        phases = tuple(phase for phase, count in ended.items() if count > most)
        if len(values) > most:
            return Outcome(value=fmean(values), reason="", ended=phases)
        reasons = Counter(found.reason for found in outcomes if found.value is None)
        ((reason, count),) = reasons.most_common(1)
        reason = f"{reason} (with {count} of {len(outcomes)} seeds)"
        return Outcome(value=None, reason=reason, ended=phases)

    def take_out_each(self, names: Iterable[str] = ()) -> list[Outcome]:
        """Return the outcomes without these causes, by seed; one outcome if nothing is random."""
        out = frozenset(names).intersection(self.present)
        self.prepare([out])
        return [self._outcomes[out, seed] for seed in self.list_seeds(out)]

    def play_as_recorded(self, names: Iterable[str] = ()) -> Outcome:
        """Return the outcome without these causes, with the scenario's own seed."""
        out = frozenset(names).intersection(self.present)
        self._simulate([(out, None)])
        return self._outcomes[out, None]

    def play_each(self, plays: Sequence[_Play]) -> list[Outcome]:
        """Return the outcomes without each set of causes, for each of the seeds."""
        self._simulate(plays)
        return [self._outcomes[one] for one in plays]

    def prepare(self, sets: Iterable[Iterable[str]]) -> None:
        """Simulate without each of these sets of causes, and store the outcomes."""
        outs = dict.fromkeys(frozenset(names).intersection(self.present) for names in sets)
        self._simulate([(out, seed) for out in outs for seed in self.list_seeds(out)])

    def _simulate(self, wanted: Sequence[_Play]) -> None:
        missing = [one for one in dict.fromkeys(wanted) if one not in self._outcomes]
        total = len(self._outcomes) + len(missing)
        for one, outcome in zip(missing, self._play(missing), strict=True):
            self._outcomes[one] = outcome
            if self._work.report is not None:
                self._work.report(len(self._outcomes), total)


class ScenarioGame(Game):
    """Simulations of a scenario with some of its causes removed."""

    def __init__(
        self,
        scenario: Scenario,
        metric: str,
        work: Work | None = None,
        *,
        changes: Mapping[str, Cause] | None = None,
    ) -> None:
        """Store the scenario with all causes, or else with changes from another scenario."""
        self._scenario, self._metric = scenario, metric
        self._undo = take_out if changes is None else undo_changes
        causes = find_causes(scenario) if changes is None else changes
        present = [name for name, one in causes.items() if changes or is_present(scenario, one)]
        super().__init__(causes, present, work, is_random=draws_random(scenario))
        self._without: dict[Coalition, Scenario] = {}

    def describe_ending(self, name: str) -> str:
        """Return a difference in kind without a cause, in one clause; empty if nothing differs."""
        built, without = self.take_out(), self.take_out([name])
        longer = [phase for phase in built.ended if phase not in without.ended]
        sooner = [phase for phase in without.ended if phase not in built.ended]
        within = f"within {self._scenario.max_duration_s:g} s"
        within += " with most seeds" * self.is_random
        kind = self._scenario.law.kind
        if longer:
            return f"{describe_phase(kind, longer[0])} no longer ends {within}"
        if sooner:
            return f"{describe_phase(kind, sooner[0])} ends {within}"
        return without.reason

    def _take_out(self, out: Coalition) -> Scenario:
        if out not in self._without:
            causes = [found for name, found in self.causes.items() if name in out]
            self._without[out] = self._undo(self._scenario, causes)
        return self._without[out]

    def list_seeds(self, out: Coalition) -> tuple[int | None, ...]:
        """Return the seeds for a simulation; only None if the remaining scenario is not random."""
        return SEEDS if self.is_random and draws_random(self._take_out(out)) else (None,)

    def _play(self, plays: Sequence[_Play]) -> Iterator[Outcome]:
        built = [self.build_play(out, seed) for out, seed in plays]
        return iterate_outcomes(self._metric, built, self._work.jobs)

    def build_play(self, out: Coalition, seed: int | None = None) -> "Play":
        """Return the simulation without these causes, with this seed or the scenario's own."""
        scenario = self._take_out(out)
        if seed is not None:
            scenario = replace(scenario, seed=seed)
        return Play(scenario, is_finer=SAMPLING in out, may_fail=seed is not None or bool(out))


@dataclass(frozen=True, slots=True)
class Play:
    """A scenario to simulate, perhaps on a finer clock. A failing law may only leave no value."""

    scenario: Scenario
    is_finer: bool
    may_fail: bool

    def turn(self, offset_rad: float) -> "Play":
        """Return the simulation from a start that is turned by an angle."""
        return replace(self, scenario=turn_start(self.scenario, offset_rad), may_fail=True)


def iterate_outcomes(metric: str, plays: Sequence[Play], jobs: int | None) -> Iterator[Outcome]:
    """Yield the outcome of each simulation, computed in as many processes as `Work` allows."""
    outcomes = _simulate_each(metric, plays)
    if any(play.scenario.law.kind not in LAWS for play in plays):
        jobs = 1
    if jobs is None:
        # The first simulation may load a compiled loop; the second measures the time.
        yield from islice(outcomes, 1)
        began_s = time.perf_counter()
        yield from islice(outcomes, 1)
        plays = plays[2:]
        is_long = len(plays) * (time.perf_counter() - began_s) > _LONG_S
        jobs = count_cores() if is_long else 1
    if jobs == 1 or len(plays) <= _FEW:
        yield from outcomes
        return
    blocks = [plays[first : first + _BLOCK] for first in range(0, len(plays), _BLOCK)]
    simulate = partial(_simulate_block, metric)
    yield from chain.from_iterable(
        map_in_processes(simulate, blocks, jobs, name=lambda _: "simulations")
    )


def _simulate_block(metric: str, plays: Sequence[Play]) -> list[Outcome]:
    return list(_simulate_each(metric, plays))


def _simulate_each(metric: str, plays: Sequence[Play]) -> Iterator[Outcome]:
    """Yield the outcome of each simulation, with one run at a time in memory."""
    runs = simulate_many([play.scenario for play in plays if not play.is_finer], threads=1)
    for play in plays:
        try:
            run = simulate_finer(play.scenario) if play.is_finer else next(runs)
        except SimulationError as err:
            run = err
        if isinstance(run, Run):
            yield _measure(metric, run, is_finer=play.is_finer)
        elif play.may_fail:
            yield Outcome(value=None, reason=str(run), ended=())
        else:
            raise run


def _measure(metric: str, run: Run, *, is_finer: bool) -> Outcome:
    found = measure_run(run, only=[metric])[metric]
    value, reason = found.value, found.reason
    kind = find_metric_kind(metric)
    if is_finer and kind is not None and kind.needs_dead_time:
        # It is searched up to 40 poses, which a finer clock has in a few ticks.
        value, reason = None, "dead times are not measured on a finer clock"
    end_xy_m = (float(run.poses.xy_m[-1, 0]), float(run.poses.xy_m[-1, 1]))
    spans = find_phase_spans(run, has_all=True)
    ended = dict.fromkeys(span.phase for span in (spans if run.is_complete else spans[:-1]))
    return Outcome(value=value, reason=reason, ended=tuple(ended), end_xy_m=end_xy_m)


def list_coalitions(causes: Sequence[str]) -> list[Coalition]:
    """Return all sets of causes, smaller sets first."""
    return [
        frozenset(inside)
        for size in range(len(causes) + 1)
        for inside in combinations(causes, size)
    ]


class ChangeGame(ScenarioGame):
    """Simulations of the second of two scenarios, with some changes undone as in the first."""

    def __init__(
        self,
        second: Scenario,
        metric: str,
        changes: Mapping[str, Cause],
        first: Scenario,
        work: Work | None = None,
    ) -> None:
        """Store the scenario with all changes."""
        super().__init__(second, metric, work, changes=changes)
        self.is_random = draws_random(second) or draws_random(first)
        self._impossible: dict[Coalition, str] = {}

    def list_seeds(self, out: Coalition) -> tuple[int | None, ...]:
        """Return the seeds for a simulation; None alone if there is nothing to simulate."""
        return (None,) if self._find_obstacle(out) else super().list_seeds(out)

    def _simulate(self, wanted: Any) -> None:
        for out, seed in wanted:
            if reason := self._find_obstacle(out):
                self._outcomes[out, seed] = Outcome(value=None, reason=reason, ended=())
        super()._simulate(wanted)

    def build_play(self, out: Coalition, seed: int | None = None) -> Play:
        """Return the simulation. A law that fails with another law's settings gives no value."""
        return replace(super().build_play(out, seed), may_fail=True)

    def _find_obstacle(self, out: Coalition) -> str:
        """Return why these settings are not a valid scenario; empty if the scenario is valid."""
        if out not in self._impossible:
            try:
                self._take_out(out)
                self._impossible[out] = ""
            except ScenarioError as err:
                self._impossible[out] = f"these settings contradict each other ({err})"
        return self._impossible[out]


_FURTHEST_RAD: Final = math.pi / 4.0
"""Largest angle between the scenario's start and another start. Between starts further apart, the
robot turns to the goal in another way, and its value is no chance of when it is sampled."""


def spread_starts(scenario: Scenario, built: Run, count: int) -> NDArray[np.float64]:
    """Return angles of equally spaced starts, relative to the scenario's start [rad], shape (n,).

    The angles span the largest turn from one sample to the next, with the scenario's own start in
    the middle; `count` is odd. Empty if the robot does not turn in `built`, the scenario's run, or
    if it turns by more than a quarter turn from one sample to the next.
    """
    turn_rate = float(np.abs(built.samples.turn_rate_rad_s).max(initial=0.0))
    within_rad = 0.5 * turn_rate * find_sample_period_s(scenario)
    is_near = 0.0 < within_rad <= _FURTHEST_RAD
    return np.linspace(-within_rad, within_rad, count) if is_near else np.zeros(0)


def turn_start(scenario: Scenario, offset_rad: float) -> Scenario:
    """Return a scenario with its start turned by an angle."""
    heading_rad = scenario.start.heading_rad + offset_rad
    if abs(heading_rad) > math.tau:
        heading_rad -= math.copysign(math.tau, heading_rad)
    return replace(scenario, start=replace(scenario.start, heading_rad=heading_rad))


_MOST_NAMED: Final = 3
"""Largest number of causes in a name. A name for more causes gives their number, because a legend
has little space."""


def simulate_what_ifs(
    identified: Identification,
    found: AttributedValue,
    *,
    report: Callable[[int, int], None] | None = None,
) -> Mapping[str, Run]:
    """Simulate the run without each acting cause, and without all of them.

    Acting causes change the value, or decide whether there is a value. If there is never a value,
    every cause that takes part is used. The result is None if re-simulation and log disagree,
    because the runs would not represent the log.

    Args:
        identified: Scenario that reproduces the run.
        found: Attribution of the run's value, with the causes.
        report: Function called with the numbers of simulations done and in total.

    Returns:
        Runs by removed causes, named by `name_without`: one cause each, in the order of the
        attribution. With several causes, the last run is without all.

    Raises:
        ExplainError: If no scenario reproduces the run.
        ScenarioError: If the law cannot be loaded or may not run.
        SimulationError: If the law fails in a simulation without some cause.
    """
    if found.withheld and not found.without_value:
        return {}
    names = tuple(found.deciding)
    chosen = [*((name,) for name in names), *([names] if len(names) > 1 else [])]
    scenario = identified.build_scenario()
    runs: dict[str, Run] = {}
    for number, taken in enumerate(chosen, start=1):
        runs[name_without(taken)] = simulate_without(scenario, taken)
        if report is not None:
            report(number, len(chosen))
    return runs


def name_without(causes: tuple[str, ...]) -> str:
    """Return the removed causes in words: `queue`, `queue and pause`, `all 5 effects`."""
    if len(causes) > _MOST_NAMED:
        return f"all {len(causes)} effects"
    return join_words(causes)
