"""The answer of `tune` as text and as JSON."""

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import turtlelog as tl
from turtlelog.cli.console import build_table, copy_fields, fill_lines, fit_table
from turtlelog.display import describe_count, format_number, format_short, join_words
from turtlelog.errors import ScenarioError
from turtlelog.explain.causes import find_drawn_seed

if TYPE_CHECKING:
    from turtlelog.sweep.tune import Spread, TunedScenario
    from turtlelog.sweep.tune_candidates import SearchedKey
    from turtlelog.sweep.tune_search import KeyRange, ObjectiveJump


@dataclass(frozen=True, slots=True, kw_only=True)
class ConstraintAnswer:
    """A constraint at the best values; the margin is negative if it fails."""

    expression: str
    value: float | None
    margin: float | None
    holds: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class RangeAnswer:
    """Range of a single key: reasons for its ends, and largest step between tried values."""

    key: str
    low: float
    high: float
    largest_step: float
    low_end: str | None
    high_end: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class SpreadAnswer:
    """Spread of the objective over variants of the best scenario: median, percentiles, worst."""

    runs: int
    with_value: int
    holds: int
    median: float | None
    low_5_percent: float | None
    high_95_percent: float | None
    worst: float | None
    varied: Mapping[str, list[float]]


@dataclass(frozen=True, slots=True, kw_only=True)
class TuneAnswer:
    """The best values that were found.

    Attributes:
        best: Values by key.
        objective: Value of the objective; None if no run has a value.
        minimise: Objective to minimise; None if the objective is maximised.
        maximise: Objective to maximise; None if the objective is minimised.
        unit: Unit of the objective.
        is_feasible: Whether all constraints hold.
        constraints: Constraints at the best values.
        evaluations: Number of simulated candidates.
        failed: Number of failed candidates.
        failure: Reason of the first failure.
        feasible: Number of candidates that fulfil the constraints.
        at_bounds: Keys whose best value is at a bound.
        is_flat: Whether all candidates have the same value.
        neighbourhood: Range of each key with good values.
        slack: Accepted loss of the objective in this range.
        jump: Largest jump of the objective by more than the accepted loss. A search may miss a
            better value of an objective that jumps.
        largest_step: Largest distance between neighbouring tried values in the searched range; None
            if several keys vary.
        seed: Seed of every candidate; None if the scenario draws no random numbers.
        spread: Spread of variants; None if no variants were simulated.
    """

    best: Mapping[str, float]
    objective: float | None
    minimise: str | None
    maximise: str | None
    unit: str | None
    is_feasible: bool
    constraints: list[ConstraintAnswer]
    evaluations: int
    failed: int
    failure: str | None
    feasible: int
    at_bounds: list[str]
    is_flat: bool
    neighbourhood: list[RangeAnswer]
    slack: float | None
    jump: "ObjectiveJump | None"
    largest_step: float | None
    seed: int | None
    spread: SpreadAnswer | None


def build_tune_answer(found: "TunedScenario", spread: "Spread | None") -> TuneAnswer:
    """Return the answer for JSON; `spread` are the results of variants, if any were simulated."""
    tuned = found.tuned
    return copy_fields(
        TuneAnswer,
        tuned,
        best=found.values,
        objective=tuned.best.objective,
        minimise=None if found.goal.is_maximised else found.goal.objective.text,
        maximise=found.goal.objective.text if found.goal.is_maximised else None,
        unit=found.unit or None,
        is_feasible=tuned.best.is_feasible,
        constraints=[copy_fields(ConstraintAnswer, one) for one in tuned.best.constraints],
        failure=tuned.failure or None,
        at_bounds=[*tuned.at_bounds],
        neighbourhood=[
            copy_fields(
                RangeAnswer,
                one,
                low_end=one.low_constraint or one.low_end,
                high_end=one.high_constraint or one.high_end,
            )
            for one in (found.around.ranges if found.around else ())
        ],
        slack=found.around.slack if found.around else None,
        jump=found.around.jump if found.around else None,
        seed=find_drawn_seed(found.scenario),
        spread=None
        if spread is None
        else copy_fields(
            SpreadAnswer,
            spread,
            low_5_percent=spread.low,
            high_95_percent=spread.high,
            varied={one.key: [one.low, one.high] for one in spread.varied},
        ),
    )


def format_tune_answer(found: "TunedScenario", spread: "Spread | None") -> str:
    """Return the answer as text. The first line has the best values and their result."""
    tables = [_tabulate_best(found)]
    if found.tuned.best.constraints:
        rows = (
            (
                *(one.expression, one.value, one.margin if math.isfinite(one.margin) else None),
                "yes" if one.holds else "no",
            )
            for one in found.tuned.best.constraints
        )
        heads = ("constraint", "value", "margin", "holds")
        tables.append(build_table("Constraints", heads, rows))
    tables += [] if spread is None else [_tabulate_spread(found, spread)]
    told = [] if spread else _describe_seed(found)
    head = fill_lines([_conclude(found), *_describe_room(found), *told])
    return "\n".join([head, "", *map(fit_table, tables)])


def _conclude(found: "TunedScenario") -> str:
    tuned, best = found.tuned, found.tuned.best
    values = ", ".join(f"{key} = {format_number(value)}" for key, value in found.values.items())
    count, name = describe_count(tuned.evaluations, "candidate"), found.goal.objective.text
    if not best.is_feasible:
        return f"None of {count} fulfils the constraints; {values} comes nearest."
    value = format_number(best.objective, found.unit)
    if tuned.is_flat:
        same = f"all {tuned.feasible} candidates that can be compared"
        rest = tuned.evaluations - tuned.feasible
        told = f"{rest} others have no value or break a constraint" if rest else "no key changes it"
        return f"{name} is {value} for {same}: {told}."
    word = "largest" if found.goal.is_maximised else "smallest"
    if found.goal.constraints and tuned.feasible < tuned.evaluations:
        count = f"the {tuned.feasible} of {count} that fulfil the constraints"
    elif found.goal.constraints:
        count += ", which all fulfil the constraints"
    return f"{values}: {name} is {value}, the {word} of {count}."


def _describe_room(found: "TunedScenario") -> Iterator[str]:
    """Yield which best values are at a bound, and the ranges in which the loss stays small."""
    if found.tuned.is_flat:
        return
    for key in found.keys:
        number = found.values[key.key]
        if key.key in found.tuned.at_bounds and _goes_on(found, key, number):
            yield f"{key.key} is at its bound: beyond {format_number(number)} it may be better."
    if found.around is not None:
        slack = format_short(found.around.slack, found.unit)
        ways = [_describe_range(one) for one in found.around.ranges]
        alone = "" if len(ways) == 1 else " (each changed alone)"
        yield (
            f"Every value tried from {join_words(ways)}{alone} is at most {slack} worse than the"
            " best."
        )
        yield from _describe_jump(found)


def _describe_seed(found: "TunedScenario") -> Iterator[str]:
    """Yield that all candidates have one seed, with which the best may be an accident."""
    seed = find_drawn_seed(found.scenario)
    if seed is not None and found.tuned.best.is_feasible:
        yield (
            f"Every candidate has the same random effects, of seed {seed}. --monte-carlo 100 shows"
            " how the best values do with other seeds."
        )


def _describe_jump(found: "TunedScenario") -> Iterator[str]:
    """Yield that the objective jumps, and how closely the range of a single key was tried."""
    jump = None if found.around is None else found.around.jump
    if jump is None:
        return
    change = format_short(jump.change, found.unit)
    # The sides of a jump may differ in a late digit.
    digits = max(
        3, 2 - math.floor(math.log10((jump.high - jump.low) / max(abs(jump.high), 1e-300)))
    )
    sides = f"{jump.low:.{digits}g} and {jump.high:.{digits}g}"
    yield (
        f"{found.goal.objective.text} jumps by {change} between {jump.key} = {sides}, so the search"
        " may miss a better value."
    )
    step = found.tuned.largest_step
    if step:
        (key,) = found.keys
        low, high = format_number(key.low), format_number(key.high)
        yield (
            f"From {key.key} = {low} to {high}, neighbouring values that were tried are up to"
            f" {format_short(step)} apart."
        )


def _goes_on(found: "TunedScenario", key: "SearchedKey", number: float) -> bool:
    """Return whether a scenario may have a value beyond the bound of the search."""
    if key.key == "kp":  # the gains of all loops
        return True
    step = 1 if key.is_whole else 0.01 * max(abs(number), 1.0)
    beyond = number + (step if number == key.high else -step)
    with suppress(ScenarioError):
        tl.override_scenario(found.scenario, {key.key: beyond})
        return True
    return False


def _describe_range(found: "KeyRange") -> str:
    """Return the range of a key; beyond a bound nothing was tried."""
    if found.low == found.high:
        return f"{found.key} = {format_number(found.low)} alone"
    ends = (found.low, found.low_end), (found.high, found.high_end)
    low, high = (
        format_number(value) + (" (its bound)" if end == "bound" else "") for value, end in ends
    )
    return f"{found.key} = {low} to {high}"


def _tabulate_best(found: "TunedScenario") -> "tl.compare.Table":
    notes = _list_notes(found)
    if found.around is None:
        return build_table("Values of the keys", ("key", "best"), found.values.items(), notes)
    rows = []
    for one in found.around.ranges:
        low, high = (end.replace("objective", "worse") for end in (one.low_end, one.high_end))
        reasons = one.low_constraint or low, one.high_constraint or high
        ends = one.low, one.high, float(f"{one.largest_step:.3g}")
        rows.append((one.key, found.values[one.key], *ends, *reasons))
    heads = ("key", "best", "from", "to", "step", "below", "above")
    return build_table("How far each key can go", heads, rows, notes)


def _list_notes(found: "TunedScenario") -> Iterator[str]:
    if found.around:
        slack = format_number(found.around.slack, found.unit)
        yield (
            f"From and to: as far as this key alone can go until the objective is worse by {slack},"
            " or a constraint breaks. Step: the largest distance between values tried in this"
            " range."
        )
    goal, tuned = found.goal, found.tuned
    kind = None if goal.metric is None else tl.measure.find_metric_kind(goal.metric)
    is_signed = kind is not None and kind.better is None and (tuned.best.objective or 0.0) < 0.0
    if is_signed and not goal.is_maximised:  # neither direction is better
        yield f"{goal.metric} has a sign: abs({goal.metric}) is least where it is nearest to 0."
    if tuned.failed:
        yield f"{describe_count(tuned.failed, 'candidate')} failed, the first: {tuned.failure}."


def _tabulate_spread(found: "TunedScenario", spread: "Spread") -> "tl.compare.Table":
    rows = (
        ("median", spread.median),
        ("5 % below", spread.low),
        ("5 % above", spread.high),
        ("worst", spread.worst),
    )
    varied = "; ".join(
        f"{one.key} from {format_number(one.low)} to {format_number(one.high)}"
        for one in spread.varied
    )
    notes = [
        f"Drawn, each by itself: {varied}.",
        f"The objective has a value in {spread.with_value} of {spread.runs}.",
    ]
    if found.goal.constraints:
        notes.append(f"All constraints hold in {spread.holds} of {spread.runs}.")
    if not any(one.key == "seed" for one in spread.varied):
        notes.append("The scenario has no random effects: its seed changes nothing.")
    objective = tl.compare.Column(title=found.goal.objective.text, unit=found.unit)
    title = f"{describe_count(spread.runs, 'variant')} of the best"
    return build_table(title, ("of them", objective), rows, notes)
