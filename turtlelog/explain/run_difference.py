"""Explanation of a metric's difference between two runs: Shapley values of changed settings."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from turtlelog.display import join_words
from turtlelog.errors import ExplainError
from turtlelog.explain import answers
from turtlelog.explain.answers import SEED, AttributedValue, Change, Side
from turtlelog.explain.attribute import attribute_scenario
from turtlelog.explain.causes import (
    choose_metric,
    draws_random,
    find_changes,
    find_resolution,
    set_values,
)
from turtlelog.explain.contributions import ORDERS, divide_game, sample_game, vary_both_starts
from turtlelog.explain.difference_report import ExplainedDifference
from turtlelog.explain.game import SEEDS, ChangeGame, Work
from turtlelog.explain.robot_difference import explain_robots
from turtlelog.explain.scenario_from_log.identify_scenario import identify_run
from turtlelog.explain.scenario_from_log.resimulation import (
    LONGEST_S,
    check_recorded_scenario,
    require_trust,
)
from turtlelog.explain.scenario_from_log.trace import mark_breaks, trace_run
from turtlelog.laws import LAWS
from turtlelog.measure import describe_no_metric, list_metrics, measure_run
from turtlelog.replay import find_departure as find_departure
from turtlelog.run import Run, require_run
from turtlelog.run.loops import Cause
from turtlelog.scenario import Scenario, flatten_scenario
from turtlelog.simulate import declare_scenario

MOST_EXACT: Final = 10
"""Largest number of groups of settings whose 1024 combinations are all simulated: 20 s for the
paper's runs."""

_AGREEMENT: Final = 0.1
"""Largest difference between re-simulation and log, as a share of the difference between runs."""

_ROUNDING: Final = 1e-12  # share of a value that a mean over equal values may differ by
_NAMES: Final = ("the first run", "the second run")  # names of runs that have equal names

_NO_SAMPLES: Final = (
    "without controller samples no scenario is known (turtlelog identify shows how a robot follows"
    " its commands)"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Depth:
    """Amount of simulation.

    Attributes:
        most_exact: Largest number of groups of settings for which all combinations are simulated;
            with more groups, orders are sampled.
        identifies: Whether to identify a scenario if the recorded one does not reproduce the run.
        shows_effects: Whether to compare the contributions of `explain` too.
        shows_starts: Whether to simulate the metric from 17 starts.
    """

    most_exact: int = MOST_EXACT
    identifies: bool = True
    shows_effects: bool = True
    shows_starts: bool = True


def explain_difference(
    first: Run,
    second: Run,
    *,
    metric: str | None = None,
    trust_law: bool = False,
    depth: Depth | None = None,
    work: Work | None = None,
) -> ExplainedDifference:
    """Explain why a metric differs between two runs.

    The settings in which the scenarios differ are grouped, and the second run is simulated with
    each set of groups as in the first. A contribution is a Shapley value; the contributions add up
    to the difference. If both runs have the same settings, the answer is their first difference.

    Args:
        first: The run from which the difference is taken.
        second: The other run.
        metric: Id of the metric. Default: the final position error, or without a goal the error of
            the last loop.
        trust_law: Whether to run the code of recorded laws that are not built in.
        depth: Amount of simulation. Default: everything.
        work: Number of processes, and a function that receives the progress.

    Raises:
        ExplainError: If the metric does not exist for both runs.
        ScenarioError: If a trusted recorded law does not exist or cannot run.
    """
    require_run(first, "first")
    require_run(second, "second")
    depth = depth or Depth()
    metric = metric or choose_common_metric(first, second)
    _require_common_metric(first, second, metric)
    unit = list_metrics(second.declaration)[metric].unit
    if first.is_lawless or second.is_lawless:
        return explain_robots(first, second, metric, unit, work)
    laws = [run.parameters.get("law.kind") for run in (first, second) if run.scenario_is_complete]
    untrusted = [*dict.fromkeys(str(law) for law in laws if law and law not in LAWS)]
    if untrusted and not trust_law:
        return _name_untrusted(first, second, metric, unit, untrusted)
    for run in (first, second):
        require_trust(run, trust_law=trust_law)
    found = [_stand_for(run, metric, trust_law=trust_law, depth=depth) for run in (first, second)]
    sides = [side for side, _ in found]
    if first.name == second.name:
        sides = [replace(s, name=n) for s, n in zip(sides, _NAMES, strict=True)]
    scenarios = [scenario for _, scenario in found]
    value = max(abs(side.as_logged or 0.0) for side in sides)
    resolutions = [
        find_resolution(scenario, declare_scenario(scenario), metric, value)
        for scenario in scenarios
        if scenario is not None
    ]
    none = answers.Resolution(size=0.0, reason=answers.ResolutionReason.NO_SCENARIO)
    answer = ExplainedDifference(
        metric=metric,
        unit=unit,
        first=sides[0],
        second=sides[1],
        # The smaller one: a wider tolerance is a change itself, which it must not hide.
        resolution=min(resolutions, key=lambda one: one.size, default=none),
    )
    one, other = scenarios
    if one is None or other is None:
        return _answer_without_scenario(answer, first, second, work)
    one, other = _take_unknown(one, other, sides[0]), _take_unknown(other, one, sides[1])
    changes = find_changes(one, other)
    if not changes and (one.seed == other.seed or not draws_random(other)):
        before, after = (side.as_logged for side in sides)
        return replace(
            answer,
            difference=None if before is None or after is None else after - before,
            has_same_settings=True,
            departure=find_departure(first, second),
        )
    return _divide(answer, (one, other), changes, depth, work)


def _answer_without_scenario(
    found: ExplainedDifference, first: Run, second: Run, work: Work | None
) -> ExplainedDifference:
    """Return the explanation by the robots' models, or the first difference of the runs."""
    is_same = _hold_same_settings(first, second)
    if not (is_same or first.declaration.loops or second.declaration.loops):
        robots = explain_robots(first, second, found.metric, found.unit, work)
        if robots.contributions:
            return robots
    names: dict[str, list[str]] = {}
    for side in (found.first, found.second):
        if side.basis is None:
            names.setdefault(side.note, []).append(side.name)
    return replace(
        found,
        withheld="; ".join(f"{join_words(who)}: {note}" for note, who in names.items()),
        has_same_settings=is_same,
        departure=find_departure(first, second) if is_same else None,
    )


def _name_untrusted(
    first: Run, second: Run, metric: str, unit: str, laws: Sequence[str]
) -> ExplainedDifference:
    """Return the settings that differ, without contributions, because a law's code may not run."""
    sides = [_begin_side(run, metric) for run in (first, second)]
    is_same = _hold_same_settings(first, second)
    of_first, of_second = first.parameters, second.parameters
    keys = [key for key in {**of_first, **of_second} if key != "name"]
    does = "runs only if its code is" if len(laws) == 1 else "run only if their code is"
    return ExplainedDifference(
        metric=metric,
        unit=unit,
        first=sides[0],
        second=sides[1],
        resolution=answers.Resolution(size=0.0, reason=answers.ResolutionReason.NO_RUN),
        withheld=f"{join_words(laws)} {does} trusted (--trust-law)",
        has_same_settings=is_same,
        departure=find_departure(first, second) if is_same else None,
        changes=tuple(
            Change(
                name="law" if key == "law.kind" else key,
                keys=(key,),
                first=(of_first.get(key),),
                second=(of_second.get(key),),
            )
            for key in keys
            if of_first.get(key) != of_second.get(key)
        ),
    )


def _begin_side(run: Run, metric: str) -> Side:
    logged = measure_run(run, only=[metric])[metric]
    return Side(
        name=run.name, as_logged=logged.value, reason=logged.reason, simulated_by=run.simulated_by
    )


def _take_unknown(scenario: Scenario, other: Scenario, side: Side) -> Scenario:
    """Return a scenario with another scenario's values for unidentified settings."""
    values = flatten_scenario(other)
    return set_values(scenario, {key: values.get(key) for key in side.unknown})


def choose_common_metric(first: Run, second: Run) -> str:
    """Return the default metric to explain: the most important one for the laws of both runs."""
    known = list_metrics(first.declaration).keys() & list_metrics(second.declaration).keys()
    if first.goal_xy_m is None or second.goal_xy_m is None:
        known = {name for name in known if not name.startswith("final.")}
    chosen = [choose_metric(run.declaration) for run in (second, first)]
    return next((name for name in chosen if name in known), "run.path_length")


def _require_common_metric(first: Run, second: Run, metric: str) -> None:
    for run in (first, second):
        known = list_metrics(run.declaration)
        if metric not in known:
            raise ExplainError(f"{run.name}: {describe_no_metric(metric, known)}")
    units = [list_metrics(run.declaration)[metric].unit for run in (first, second)]
    if units[0] != units[1]:
        raise ExplainError(f"{metric} has the unit {units[0]} in one run, {units[1]} in the other")


def _hold_same_settings(first: Run, second: Run) -> bool:
    settings = [
        {key: value for key, value in run.parameters.items() if key != "name"}
        for run in (first, second)
    ]
    return first.scenario_is_complete and second.scenario_is_complete and settings[0] == settings[1]


def _stand_for(
    run: Run, metric: str, *, trust_law: bool, depth: Depth
) -> tuple[Side, Scenario | None]:
    """Return the facts about a run, with the scenario that represents it."""
    side = _begin_side(run, metric)
    length_s = float(run.end_ns - run.poses.time_ns[0]) / 1e9
    note = "the recording does not contain its scenario"
    if not len(run.samples):
        return replace(side, note=_NO_SAMPLES), None
    if run.scenario_is_complete and length_s <= LONGEST_S:
        recorded = check_recorded_scenario(mark_breaks(trace_run(run)), trust_law=trust_law)
        note = recorded.reach
        if recorded.scenario is not None:
            side = replace(side, basis="recorded", note=note, is_exact=True)
            return side, recorded.scenario
    if not depth.identifies:
        return replace(side, note=note), None
    identified = identify_run(run, trust_law=trust_law)
    if identified.scenario is None:
        return replace(side, note=identified.obstacle or note.rstrip(".")), None
    known = flatten_scenario(identified.scenario)
    unknown = tuple(
        key for key, one in identified.findings.items() if one.value is None and key in known
    )
    again = identified.resimulation
    is_exact = again is not None and again.is_exact
    side = replace(side, basis="identified", note=note, is_exact=is_exact, unknown=unknown)
    return side, identified.scenario


def _divide(
    found: ExplainedDifference,
    scenarios: Sequence[Scenario],
    changes: Mapping[str, Cause],
    depth: Depth,
    work: Work | None,
) -> ExplainedDifference:
    """Return the difference divided among the changes, or why contributions are withheld."""
    first, second = scenarios
    game = ChangeGame(second, found.metric, changes, first, work)
    own = ChangeGame(first, found.metric, {}, first, work)
    before, after = own.play_as_recorded().value, game.play_as_recorded().value
    values, listed = flatten_scenario(second), list[Change]()
    for name, change in changes.items():
        keys = tuple(key for key, value in change.neutral.items() if value != values.get(key))
        old, new = (tuple(side.get(key) for key in keys) for side in (change.neutral, values))
        listed.append(Change(name=name, keys=keys, first=old, second=new))
    found = replace(
        found,
        first=replace(found.first, resimulated=before),
        second=replace(found.second, resimulated=after),
        changes=tuple(listed),
        difference=None if before is None or after is None else after - before,
    )
    base = AttributedValue(
        metric=found.metric,
        unit=found.unit,
        resimulated=after,
        without_all=before,
        causes=tuple(changes),
        contributions=(),
        others=(),
        resolution=found.resolution,
        reason=found.second.reason or None,
    )
    is_exact = len(changes) <= depth.most_exact
    divided = divide_game(base, game) if is_exact else sample_game(base, game)
    seeds = len(SEEDS) if game.is_random else 1
    found = replace(
        found,
        seeds=seeds if divided.seeds is None else divided.seeds.used,
        orders=None if is_exact else ORDERS,
        without_value=divided.without_value,
        with_value=divided.with_value,
    )
    if obstacle := divided.withheld or _compare_with_logs(found):
        return replace(found, withheld=obstacle)
    found = replace(
        found,
        contributions=_list_contributions(found, divided, game, scenarios),
        changes=(),
        idle=tuple(k for one in listed if one.name not in divided.acting for k in one.keys),
        together=divided.together,
    )
    if depth.shows_starts and not game.is_random:
        size = found.resolution.size
        starts = vary_both_starts(scenarios, found.metric, found.difference or 0.0, size)
        found = replace(found, starts=starts)
    if depth.shows_effects:
        found = replace(found, effects=_shift_effects(scenarios, found.metric, work))
    return found


def _list_contributions(
    found: ExplainedDifference,
    divided: AttributedValue,
    game: ChangeGame,
    scenarios: Sequence[Scenario],
) -> tuple[Change, ...]:
    """Return the contributions of acting changes, the largest first, then that of the seeds."""
    listed = {one.name: one for one in found.changes}
    shares = [one for one in divided.contributions if one.cause in divided.acting]
    shares.sort(key=lambda one: -abs(one.size))
    contributions = [
        replace(
            listed[one.cause],
            contribution=one.contribution,
            standard_error=one.standard_error,
            undone=one.alone,
        )
        for one in shares
    ]
    rest = math.fsum([found.difference or 0.0, *(-one.size for one in shares)])
    if not game.is_random or abs(rest) <= _ROUNDING * abs(found.second.resimulated or 0.0):
        return tuple(contributions)
    seeds = tuple(one.seed for one in scenarios)
    contributions.append(
        Change(name=SEED, keys=(SEED,), first=seeds[:1], second=seeds[1:], contribution=rest)
    )
    return tuple(contributions)


def _compare_with_logs(found: ExplainedDifference) -> str:
    """Return why the re-simulations do not represent the logs; empty if they represent them."""
    apart, largest = 0.0, 0.0
    for side in (found.first, found.second):
        if side.as_logged is None:
            return f"{side.name} has no value: {side.reason}"
        if side.resimulated is None:
            return f"{side.name} has no value when it is simulated again"
        apart = max(apart, abs(side.as_logged - side.resimulated))
        largest = max(largest, abs(side.as_logged))
    if apart <= max(_AGREEMENT * abs(found.difference or 0.0), answers.SAME * largest):
        return ""
    return "logs and re-simulations differ by more than a tenth of the difference"


def _shift_effects(
    scenarios: Sequence[Scenario], metric: str, work: Work | None
) -> tuple[answers.EffectShift, ...]:
    """Return how the contributions of `explain` differ; empty if a run has no contributions."""
    found = [attribute_scenario(one, metric=metric, work=work) for one in scenarios]
    if any(one.withheld for one in found):
        return ()
    tables = [{one.cause: one.size for one in side.contributions} for side in found]
    shifts = [
        answers.EffectShift(
            cause=name, first=tables[0].get(name, 0.0), second=tables[1].get(name, 0.0)
        )
        for name in {**tables[0], **tables[1]}
    ]
    acting = [one for one in shifts if one.first or one.second]
    return tuple(sorted(acting, key=lambda one: -abs(one.shift)))
