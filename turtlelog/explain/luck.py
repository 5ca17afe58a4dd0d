"""Effect of chance on a value, with and without each effect, over starts or seeds.

A sampling controller reaches its tolerance at a random point within the turn of one sample. The
starts are those of `starts` for the range of an attribution, four times as dense. For a run with
random effects, the seeds of its contributions are varied instead.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import fit_line, join_words
from turtlelog.errors import ExplainError
from turtlelog.explain.attribute import attribute_run
from turtlelog.explain.attribution import Attribution, choose_metric
from turtlelog.explain.causes import simulate_without
from turtlelog.explain.contributions import (
    find_steady_span,
    ranges_over,
    spread_starts,
    subtract_values,
    turn_start,
)
from turtlelog.explain.game import SEEDS, Outcome, Play, ScenarioGame, Work, iterate_outcomes
from turtlelog.explain.scenario_from_log.identification import Identification
from turtlelog.explain.scenario_from_log.identify_scenario import identify_run
from turtlelog.run import Run
from turtlelog.scenario import resolve_scenario
from turtlelog.simulate import simulate_run

Values = NDArray[np.float64]

_COUNT: Final = 65
"""Number of starts; every fourth start belongs to the range of an attribution."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LuckCurve:
    """A value from each start, or with each seed, without some causes.

    Attributes:
        without: Causes that are removed; empty with all effects.
        values: Values of the metric, in its unit, shape (n,); NaN for a missing value.
        reasons: Reason why the value is missing, shape (n,); empty if there is a value.
        ends_xy_m: The last pose in the world frame [m], shape (n, 2); NaN if the law failed.
    """

    without: tuple[str, ...]
    values: Values
    reasons: tuple[str, ...]
    ends_xy_m: Values


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Luck:
    """Values that a metric of a run would have with other starts or seeds.

    Attributes:
        metric: Id of the metric.
        unit: Unit of the metric.
        varied: Varied quantity: start headings, or the seed of a run with random effects.
        starts_rad: Angle between each start and the recorded start [rad], shape (n,); empty for
            seeds.
        seeds: Varied seeds; empty for starts.
        causes: Causes that take part, in the order of the attribution.
        curves: Curves with all effects, then without each single cause that changes the value. With
            several causes, the last curve is without all of them.
        recorded: Value of the run; None without a value.
        recorded_end_xy_m: Position of the run's last pose in the world frame [m].
        goal_xy_m: Position of the run's goal [m]; None without a goal.
        dependence: `wide` if the value depends on single samples or on the seed: if the ranges of
            the value and of the effects' total are both large, as in `StartRange`, or if some
            starts have no value. `follows` if only the range of the value is large. Otherwise
            `steady`.
    """

    metric: str
    unit: str
    varied: Literal["start", "seed"]
    starts_rad: Values
    seeds: tuple[int, ...]
    causes: tuple[str, ...]
    curves: tuple[LuckCurve, ...]
    recorded: float | None
    recorded_end_xy_m: tuple[float, float]
    goal_xy_m: tuple[float, float] | None
    dependence: Literal["wide", "follows", "steady"]

    @property
    def acting(self) -> tuple[str, ...]:
        """Causes that change the value. The last curve is without them."""
        return self.curves[-1].without

    def __repr__(self) -> str:
        return fit_line(f"<Luck of {self.metric}: {len(self.curves[0].values)} {self.varied}s>")


def measure_luck(
    run: Run,
    *,
    metric: str | None = None,
    identified: Identification | None = None,
    found: Attribution | None = None,
    trust_law: bool = False,
    work: Work | None = None,
) -> Luck:
    """Measure the values that a run would have from other starts, or with other seeds.

    Args:
        run: Run whose value is explained.
        metric: Id of the metric. Default: the choice of `choose_metric`.
        identified: Result of `identify_run`, if already known.
        found: Result of `attribute_run` for this metric, if already known.
        trust_law: Whether to run the code of a recorded law that is not built in.
        work: Number of processes, and a function that receives the progress.

    Raises:
        ExplainError: If no scenario reproduces the run, if the re-simulation disagrees with the
            log, if the starts do not differ because the robot does not turn, or if no start has a
            value.
        ScenarioError: If the recorded law is neither built in nor trusted, or does not exist.
    """
    work = work or Work()
    identified = identified or identify_run(run, trust_law=trust_law)
    if found is None:
        metric = metric or choose_metric(run.declaration)
        if identified.scenario is None:
            reason = next(iter(identified.notes), "too little is known").rstrip(".")
            raise ExplainError(f"no scenario stands for it: {reason}")
        found = attribute_run(
            run, metric=metric, identified=identified, trust_law=trust_law, work=work
        )
    if found.withheld and not found.without_value:
        raise ExplainError(found.withheld)
    scenario = resolve_scenario(identified.build_scenario())
    game = ScenarioGame(scenario, found.metric)
    offsets_rad = np.zeros(0)
    if not game.is_random:
        offsets_rad = spread_starts(scenario, simulate_run(scenario), _COUNT)
        if not len(offsets_rad):
            raise ExplainError("the robot does not turn: no start meets its samples elsewhere")
    table = _Table(game, found.metric, offsets_rad, work)
    curves = _list_curves(table, found)
    if np.isnan(curves[0].values).all():
        raise ExplainError(f"{found.metric} has no value: {curves[0].reasons[0]}")
    return Luck(
        metric=found.metric,
        unit=found.unit,
        varied="seed" if game.is_random else "start",
        starts_rad=offsets_rad,
        seeds=SEEDS if game.is_random else (),
        causes=found.causes,
        curves=tuple(curves),
        recorded=found.resimulated if found.as_logged is None else found.as_logged,
        recorded_end_xy_m=(float(run.poses.xy_m[-1, 0]), float(run.poses.xy_m[-1, 1])),
        goal_xy_m=run.goal_xy_m,
        dependence=_judge(curves, found),
    )


@dataclass(frozen=True, slots=True)
class _Table:
    """Simulations of a game from every start, or with every seed."""

    game: ScenarioGame
    metric: str
    offsets_rad: Values
    work: Work

    def simulate(self, cases: Sequence[tuple[str, ...]]) -> list[LuckCurve]:
        """Return a curve for each set of removed causes."""
        plays = [self._list_plays(case) for case in cases]
        every = [play for row in plays for play in row]
        outcomes: list[Outcome] = []
        for outcome in iterate_outcomes(self.metric, every, self.work.jobs):
            outcomes.append(outcome)
            if self.work.report is not None:
                self.work.report(len(outcomes), len(every))
        count = len(self.offsets_rad) or len(SEEDS)
        ends = np.cumsum([len(row) for row in plays]).tolist()
        rows = [outcomes[end - len(row) : end] for row, end in zip(plays, ends, strict=True)]
        # A case without random numbers is simulated once for all seeds.
        rows = [row * (count // len(row)) for row in rows]
        return [_build_curve(case, row) for case, row in zip(cases, rows, strict=True)]

    def _list_plays(self, case: tuple[str, ...]) -> list[Play]:
        out = frozenset(case).intersection(self.game.present)
        if not len(self.offsets_rad):
            return [self.game.build_play(out, seed) for seed in self.game.list_seeds(out)]
        play = self.game.build_play(out)
        return [
            replace(play, scenario=turn_start(play.scenario, offset_rad), may_fail=True)
            for offset_rad in self.offsets_rad.tolist()
        ]


def _build_curve(case: tuple[str, ...], outcomes: Sequence[Outcome]) -> LuckCurve:
    nowhere = (math.nan, math.nan)
    return LuckCurve(
        without=case,
        values=np.array([math.nan if one.value is None else one.value for one in outcomes]),
        reasons=tuple(one.reason for one in outcomes),
        ends_xy_m=np.array([one.end_xy_m or nowhere for one in outcomes]),
    )


def _list_curves(table: _Table, found: Attribution) -> list[LuckCurve]:
    """Return the curves without causes that change the value of the run or of any start."""
    whole, *alone = table.simulate([(), *((name,) for name in found.causes)])
    deciding = _list_deciding(found)
    kept = [
        one
        for one in alone
        if one.without[0] in deciding
        or not np.array_equal(one.values, whole.values, equal_nan=True)
    ]
    if len(kept) < 2:
        return [whole, *kept]
    return [whole, *kept, *table.simulate([tuple(one.without[0] for one in kept)])]


def _judge(curves: Sequence[LuckCurve], found: Attribution) -> Literal["wide", "follows", "steady"]:
    values, without = (
        [None if math.isnan(value) else value for value in curve.values.tolist()]
        for curve in (curves[0], curves[-1])
    )
    added = (found.resimulated or 0.0) - (found.without_all or 0.0)
    span = find_steady_span(values, added, found.resolution.size)
    if 0 < values.count(None) < len(values):
        return "wide"
    if not ranges_over(values, span):
        return "steady"
    return "wide" if ranges_over(subtract_values(values, without), span) else "follows"


_MOST_NAMED: Final = 3
"""Largest number of causes in a name. A name for more causes gives their number, because a legend
has little space."""


def simulate_what_ifs(
    identified: Identification,
    found: Attribution,
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
    names = _list_deciding(found)
    chosen: list[tuple[str, ...]] = [(name,) for name in names]
    if len(names) > 1:
        chosen.append(tuple(names))
    scenario = identified.build_scenario()
    runs: dict[str, Run] = {}
    for number, taken in enumerate(chosen, start=1):
        runs[name_without(taken)] = simulate_without(scenario, taken)
        if report is not None:
            report(number, len(chosen))
    return runs


def _list_deciding(found: Attribution) -> tuple[str, ...]:
    """Return the causes that change the value, or decide whether there is a value."""
    if not found.without_value:
        return found.acting
    cases = (*found.without_value, *found.with_value)
    named = {name for case in cases for name in case.causes}
    return tuple(name for name in found.causes if name in named) or found.causes


def name_without(causes: tuple[str, ...]) -> str:
    """Return the removed causes in words: `queue`, `queue and pause`, `all 5 effects`."""
    if len(causes) > _MOST_NAMED:
        return f"all {len(causes)} effects"
    return join_words(causes)
