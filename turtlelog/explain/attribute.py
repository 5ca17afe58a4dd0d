"""Attribute a value to its causes: Shapley values from simulations without them."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Final

from turtlelog.errors import ExplainError
from turtlelog.explain.attribution import (
    SAME,
    Attribution,
    Contribution,
    Together,
    ValueSet,
    choose_metric,
    find_resolution,
)
from turtlelog.explain.causes import (
    LOOP_CAUSES,
    PLANT_CAUSES,
    SAMPLING,
    describe_no_sampling,
    find_cause,
    find_causes,
    list_effects,
)
from turtlelog.explain.contributions import (
    Worth,
    compute_contributions,
    compute_dividends,
    describe_alone,
    divide_over_seeds,
    find_smallest,
    vary_start,
)
from turtlelog.explain.game import Coalition, Game, Outcome, ScenarioGame, Work, list_coalitions
from turtlelog.explain.scenario_from_log.identification import (
    LOOP_KEYS,
    Certainty,
    Finding,
    Identification,
)
from turtlelog.explain.scenario_from_log.identify_scenario import identify_run
from turtlelog.explain.scenario_from_log.resimulation import require_trust
from turtlelog.laws import LAWS, find_law, list_causes
from turtlelog.measure import describe_no_metric, list_metrics, measure_run
from turtlelog.run import Run, require_run
from turtlelog.run.loops import Cause, Declaration
from turtlelog.scenario import DEFAULT_LAW, Scenario, resolve_scenario
from turtlelog.simulate import declare_scenario

_MOST: Final = 6
"""Largest number of causes that take part: 64 simulations, a second or two for the paper's runs.
Random effects need 32 times as many simulations; each further cause doubles the number."""

_AGREEMENT: Final = 0.1
"""Largest difference between re-simulation and log, as a share of the effects' total. With a larger
difference, the re-simulation does not represent the log."""

_OUTSIDE: Final = (
    "the log's value lies outside of the central 95 % over seeds, its own is not known"
)


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
    found = replace(found, as_logged=logged.value, reason=logged.reason or found.reason or None)
    is_identified = scenario.law.kind == DEFAULT_LAW and not identified.is_recorded
    if is_identified:
        others = tuple(_withhold_alone(other, identified.findings) for other in found.others)
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
    _require_metric(declaration, metric)
    _require_distinct(causes)
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
        others=tuple(describe_alone(game, name) for name in others),
        resolution=find_resolution(scenario, declaration, metric, built.value or 0.0),
        reason=built.reason or None,
        left=tuple(name for name in causes if name in others),
        effects=list_effects(table),
        remarks=() if SAMPLING in table else (f"{obstacle[:1].upper()}{obstacle[1:]}.",),
    )
    found = divide_game(found, game)
    if found.seeds is not None or found.withheld:
        return found
    starts = vary_start(
        scenario,
        metric,
        added=(found.resimulated or 0.0) - (found.without_all or 0.0),
        resolution=found.resolution.size,
        acting=found.acting,
    )
    return replace(found, starts=starts)


def divide_game(found: Attribution, game: Game) -> Attribution:
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
    return _divide(found, game, worth)


def require_causes(run: Run, metric: str, causes: Sequence[str] | None) -> None:
    """Require a metric of the run and distinct causes that the run may have; no code is loaded.

    Causes of a law that is not built in are known only when it runs.

    Raises:
        ExplainError: If the metric or a cause is wrong. The message contains the nearest names.
    """
    _require_metric(run.declaration, metric)
    _require_distinct(causes)
    kind = str(run.parameters.get("law.kind", DEFAULT_LAW))
    if kind not in LAWS:
        return
    plant = str(run.parameters.get("plant.kind"))
    known = [*LOOP_CAUSES, *PLANT_CAUSES.get(plant, ()), *list_causes(find_law(kind))]
    table = {cause.name: cause for cause in known}
    for name in causes or ():
        find_cause(name, table, Scenario())


def _require_metric(declaration: Declaration, metric: str) -> None:
    known = list_metrics(declaration)
    if metric not in known:
        raise ExplainError(describe_no_metric(metric, known))


def _require_distinct(causes: Sequence[str] | None) -> None:
    if causes is None:
        return
    if not causes or len({*causes}) < len(causes):
        raise ExplainError(f"causes: expected different ones, found {', '.join(causes)}")


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


def _divide(found: Attribution, game: Game, worth: Worth) -> Attribution:
    contributions = compute_contributions(worth, found.causes)
    dividends = compute_dividends(worth, found.causes)
    return replace(
        found,
        contributions=tuple(
            describe_alone(game, name, contribution) for name, contribution in contributions.items()
        ),
        together=tuple(Together(causes=names, value=value) for names, value in dividends.items()),
    )


def _tell_what_has_no_value(
    found: Attribution, outcomes: Mapping[Coalition, Outcome]
) -> Attribution:
    """Return the smallest sets of causes that decide whether there is a value."""
    missing = [inside for inside, outcome in outcomes.items() if outcome.value is None]
    present = [inside for inside in outcomes if inside not in missing]

    def describe(inside: Coalition) -> ValueSet:
        names = tuple(name for name in found.causes if name in inside)
        return ValueSet(causes=names, reason=outcomes[inside].reason or None)

    is_empty = frozenset() in missing
    return replace(
        found,
        withheld="with some of the causes it has a value, with others none"
        if present
        else "it has no value",
        without_value=tuple(describe(inside) for inside in find_smallest(missing)),
        with_value=tuple(describe(inside) for inside in find_smallest(present) if is_empty),
    )


def _compare_with_log(found: Attribution, *, knows_seed: bool) -> str:
    """Return why the re-simulation does not represent the log; empty if it does represent it."""
    logged, built, without = found.as_logged, found.resimulated, found.without_all
    if logged is None:
        return "the log has no value"
    if built is None or without is None:
        return "the re-simulation has no value"
    if found.seeds is not None and not knows_seed:
        is_central = found.seeds.low <= logged <= found.seeds.high
        return "" if is_central else _OUTSIDE
    added, apart, same = abs(built - without), abs(logged - built), SAME * abs(logged)
    if apart <= (same if added <= same else _AGREEMENT * added):
        return ""
    limit = "a tenth of what the effects add together"
    if added <= same:
        limit = f"{100.0 * SAME:g} % of the value, and the effects add less"
    return f"log and re-simulation differ by more than {limit}"


def _withhold_alone(contribution: Contribution, findings: Mapping[str, Finding]) -> Contribution:
    """Return a property without its value if the value depends on a gain that the log hides."""
    unknown = [key for key in _list_gains(contribution.cause) if findings[key].value is None]
    ending = f"the log does not show {' and '.join(unknown)}"
    return replace(contribution, alone=None, ending=ending) if unknown else contribution


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
