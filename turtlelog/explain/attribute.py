"""Attribute a value to its causes, by simulations without them; the effect of chance on it.

A sampling controller reaches its tolerance at a random point within the turn of one sample. Luck is
measured over the starts of an attribution's range, four times as dense. For a run with random
effects, the seeds of its contributions are varied instead.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import fit_line
from turtlelog.errors import ExplainError
from turtlelog.explain import contributions
from turtlelog.explain.answer_words import Attribution
from turtlelog.explain.answers import SAME, Contribution
from turtlelog.explain.causes import (
    SAMPLING,
    choose_metric,
    describe_no_sampling,
    find_cause,
    find_causes,
    find_resolution,
    list_effects,
    require_causes,
    require_distinct,
    require_metric,
)
from turtlelog.explain.game import (
    SEEDS,
    Game,
    Outcome,
    Play,
    ScenarioGame,
    Work,
    iterate_outcomes,
    list_coalitions,
    spread_starts,
)
from turtlelog.explain.scenario_from_log import (
    LOOP_KEYS,
    Certainty,
    Finding,
    Identification,
)
from turtlelog.explain.scenario_from_log.identify_scenario import identify_run
from turtlelog.explain.scenario_from_log.resimulation import require_trust
from turtlelog.measure import list_metrics, measure_run
from turtlelog.run import Run, require_run
from turtlelog.run.loops import Cause
from turtlelog.run.stop_reasons import describe_wall
from turtlelog.scenario import DEFAULT_LAW, Scenario, resolve_scenario
from turtlelog.simulate import declare_scenario, simulate_run

_MOST: Final = 6
"""Largest number of causes that take part: 64 simulations, a second or two for the paper's runs.
Random effects need 32 times as many simulations; each further cause doubles the number."""

_AGREEMENT: Final = 0.1
"""Largest difference between re-simulation and log, as a share of the effects' total. With a larger
difference, the re-simulation does not represent the log."""


def attribute_run(
    run: Run,
    *,
    metric: str | None = None,
    causes: Sequence[str] | None = None,
    identified: Identification | None = None,
    trust_law: bool = False,
    work: Work | None = None,
) -> Attribution:
    """Attribute a value of a run to causes in the scenario that reproduces it.

    The identified scenario is used. For a law that cannot be identified, the recorded scenario is
    used if its re-simulation reproduces the run. Contributions are withheld if the values of log
    and re-simulation differ by more than a tenth of the effects' total. For random effects with an
    unknown seed, contributions are withheld if the log's value is outside the central 95 % over
    seeds.

    Args:
        run: Run whose value is explained.
        metric: Id of the metric. Default: the choice of `choose_metric`.
        causes: Causes that take part. Default: every effect in the scenario.
        identified: Result of `identify_run`, if already known.
        trust_law: Whether to run the code of a recorded law that is not built in.
        work: Number of processes, and a function that receives the progress.

    Raises:
        ExplainError: If no scenario reproduces the run, or as in `attribute_scenario`.
        ScenarioError: If the recorded law is neither built in nor trusted, or does not exist.
    """
    require_run(run)
    metric = metric or choose_metric(run.declaration)
    require_causes(run, metric, causes)
    require_trust(run, trust_law=trust_law)
    identified = identified or identify_run(run, trust_law=trust_law)
    scenario = identified.build_scenario()
    found = attribute_scenario(scenario, metric=metric, causes=causes, work=work)
    logged = measure_run(run, only=[metric])[metric]
    reason = logged.reason or found.reason or None
    remarks = (*found.remarks, *filter(None, [describe_wall(run)]))
    found = replace(found, as_logged=logged.value, reason=reason, remarks=remarks)
    is_identified = scenario.law.kind == DEFAULT_LAW and not identified.is_recorded
    if is_identified:
        others = tuple(_withhold_hidden(one, identified.findings) for one in found.others)
        found = replace(found, others=others)
    obstacle = found.withheld or _compare_with_log(found, knows_seed=identified.is_recorded)
    if obstacle:
        return replace(found, withheld=obstacle, contributions=())
    if not is_identified:
        return found
    table = find_causes(scenario)
    acting = [table[name] for name in found.acting]
    return replace(found, doubts=tuple(_list_doubts(identified.findings, acting)))


def attribute_scenario(
    scenario: Scenario,
    *,
    metric: str | None = None,
    causes: Sequence[str] | None = None,
    work: Work | None = None,
) -> Attribution:
    """Attribute a value of a scenario to causes.

    All 2^n sets of n causes are simulated, with each of 32 seeds if the set contains a random
    cause. Of more than six causes, the six that change the value most, removed alone or acting
    alone, take part. The others stay as recorded.

    Raises:
        ExplainError: If a metric or cause is unknown, a cause is named twice, or there are no
            causes.
        ScenarioError: If the law cannot be loaded or may not run.
        SimulationError: If the law fails in a simulation without some cause.
    """
    scenario = resolve_scenario(scenario)
    declaration = declare_scenario(scenario)
    metric = metric or choose_metric(declaration)
    game = ScenarioGame(scenario, metric, work)
    table = game.causes
    require_metric(declaration, metric)
    require_distinct(causes)
    for name in causes or ():
        find_cause(name, table, scenario)
    present = game.present
    if causes is None:
        causes = [name for name in list_effects(table) if name in present]
    chosen = _choose_causes(game, causes)
    others = [name for name in present if name not in chosen]
    game.prepare(
        [*({*chosen} - inside for inside in list_coalitions(chosen)), *([o] for o in others)]
    )
    built, obstacle = game.play_as_recorded(), describe_no_sampling(scenario)
    found = Attribution(
        metric=metric,
        unit=list_metrics(declaration)[metric].unit,
        resimulated=built.value,
        without_all=game.take_out(chosen).value,
        causes=tuple(chosen),
        contributions=(),
        others=tuple(game.describe_alone(name) for name in others),
        resolution=find_resolution(scenario, declaration, metric, built.value or 0.0),
        reason=built.reason or None,
        left=tuple(name for name in causes if name in others),
        effects=list_effects(table),
        remarks=() if SAMPLING in table else (f"{obstacle[:1].upper()}{obstacle[1:]}.",),
    )
    found = contributions.divide_game(found, game)
    if found.seeds is not None or found.withheld:
        return found
    starts = contributions.vary_start(
        scenario,
        metric,
        added=(found.resimulated or 0.0) - (found.without_all or 0.0),
        resolution=found.resolution.size,
        acting=found.acting,
    )
    return replace(found, starts=starts)


def _choose_causes(game: Game, causes: Sequence[str]) -> list[str]:
    if len(causes) <= _MOST:
        return [*causes]
    every = {*causes}
    game.prepare([[], every, *(every - {name} for name in causes), *([name] for name in causes)])

    def weigh(name: str) -> float:
        out = _compare(game.take_out(), game.take_out([name]))
        return max(out, _compare(game.take_out(every - {name}), game.take_out(every)))

    chosen = sorted(causes, key=weigh, reverse=True)[:_MOST]
    return [name for name in causes if name in chosen]


def _compare(left: Outcome, right: Outcome) -> float:
    """Return the difference between two outcomes; infinite if only one has a value."""
    if left.value is None or right.value is None:
        return 0.0 if left.value is right.value else math.inf
    return abs(left.value - right.value)


def _compare_with_log(found: Attribution, *, knows_seed: bool) -> str:
    """Return why the re-simulation does not represent the log; empty if it does represent it."""
    logged, built, without = found.as_logged, found.resimulated, found.without_all
    if logged is None:
        return "the log has no value"
    if built is None or without is None:
        return "the re-simulation has no value"
    if found.seeds is not None and not knows_seed:
        if found.seeds.low <= logged <= found.seeds.high:
            return ""
        return "the log's value lies outside of the central 95 % over seeds, its own is not known"
    added, apart, same = abs(built - without), abs(logged - built), SAME * abs(logged)
    if apart <= (same if added <= same else _AGREEMENT * added):
        return ""
    limit = "a tenth of what the effects add together"
    if added <= same:
        limit = f"{100.0 * SAME:g} % of the value, and the effects add less"
    return f"log and re-simulation differ by more than {limit}"


def _withhold_hidden(other: Contribution, findings: Mapping[str, Finding]) -> Contribution:
    """Return a cause without its value alone if this depends on a gain that the log hides."""
    gains = [key for key in _list_gains(other.cause) if findings[key].value is None]
    ending = f"the log does not show {' and '.join(gains)}"
    return replace(other, alone=None, ending=ending) if gains else other


def _list_gains(cause: str) -> tuple[str, ...]:
    """Return the gains that the value without a cause depends on; if clipped, any gain fits."""
    return ("law.kp_angular", "law.kp_linear") if cause == "saturation" else ()


def _list_doubts(findings: Mapping[str, Finding], acting: Sequence[Cause]) -> Iterator[str]:
    """Yield assumptions about settings that change when acting causes are removed."""
    concerned = [(*found.neutral, *_list_gains(found.name)) for found in acting]
    keys = [key for names in concerned for key in names if key in findings]
    found = {findings[key].certainty for key in keys}
    if Certainty.AMBIGUOUS in found:
        alike = [
            f"{key} {' or '.join(map(str, finding.candidates))}"
            for key, finding in findings.items()
            if key in LOOP_KEYS and finding.certainty is Certainty.AMBIGUOUS
        ]
        yield (
            "Other settings fit the log as well, and their contributions may differ:"
            f" {'; '.join(alike)}."
        )
    if Certainty.FITTED in found:
        yield "Contributions are those of the likeliest settings. None reproduces every sample."
    if Certainty.UNKNOWN in found:
        unknown = [key for key in keys if findings[key].certainty is Certainty.UNKNOWN]
        assumed = ", ".join(f"{key} {findings[key].used}" for key in unknown)
        yield f"Assumed, because the log does not show them: {assumed}."


Values = NDArray[np.float64]

_COUNT: Final = 65  # number of starts; every fourth start belongs to the range of an attribution


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
            reason = identified.obstacle or "too little is known"
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
            reason = "the robot does not turn, or by more than 90 deg between two samples"
            raise ExplainError(f"{reason}: no start meets its samples elsewhere")
    cases = [(), *((name,) for name in found.causes)]
    whole, *alone = _simulate_curves(game, found.metric, offsets_rad, work, cases)
    curves = [whole, *(one for one in alone if _acts(one, whole, found))]
    if len(curves) > 2:
        cases = [tuple(one.without[0] for one in curves[1:])]
        curves += _simulate_curves(game, found.metric, offsets_rad, work, cases)
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


def _acts(one: LuckCurve, whole: LuckCurve, found: Attribution) -> bool:
    """Return whether a cause decides the value, or changes it from some start or with some seed."""
    is_same = np.array_equal(one.values, whole.values, equal_nan=True)
    return one.without[0] in found.deciding or not is_same


def _simulate_curves(
    game: ScenarioGame,
    metric: str,
    offsets_rad: Values,
    work: Work,
    cases: Sequence[tuple[str, ...]],
) -> list[LuckCurve]:
    """Return a curve over the starts or seeds for each set of removed causes."""
    plays: list[list[Play]] = []
    for case in cases:
        out = frozenset(case).intersection(game.present)
        if not len(offsets_rad):
            plays.append([game.build_play(out, seed) for seed in game.list_seeds(out)])
            continue
        play = game.build_play(out)
        plays.append([play.turn(offset_rad) for offset_rad in offsets_rad.tolist()])
    every = [play for row in plays for play in row]
    outcomes: list[Outcome] = []
    for outcome in iterate_outcomes(metric, every, work.jobs):
        outcomes.append(outcome)
        if work.report is not None:
            work.report(len(outcomes), len(every))
    curves, count, nowhere = [], len(offsets_rad) or len(SEEDS), (math.nan, math.nan)
    for case, row in zip(cases, plays, strict=True):
        own, outcomes = outcomes[: len(row)], outcomes[len(row) :]
        own *= count // len(row)  # without random numbers, a case is simulated once for all seeds
        curve = LuckCurve(
            without=case,
            values=np.array([math.nan if one.value is None else one.value for one in own]),
            reasons=tuple(one.reason for one in own),
            ends_xy_m=np.array([one.end_xy_m or nowhere for one in own]),
        )
        curves.append(curve)
    return curves


def _judge(curves: Sequence[LuckCurve], found: Attribution) -> Literal["wide", "follows", "steady"]:
    values, without = (
        [None if math.isnan(value) else value for value in curve.values.tolist()]
        for curve in (curves[0], curves[-1])
    )
    added = (found.resimulated or 0.0) - (found.without_all or 0.0)
    span = contributions.find_steady_span(values, added, found.resolution.size)
    if 0 < values.count(None) < len(values):
        return "wide"
    if not contributions.ranges_over(values, span):
        return "steady"
    is_wide = contributions.ranges_over(contributions.subtract_values(values, without), span)
    return "wide" if is_wide else "follows"
