"""A search for the best values in one call, and the robustness of these values to variations."""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from turtlelog.display import fit_line, format_html, format_notebook, format_number
from turtlelog.errors import TuneError
from turtlelog.expressions import parse_expression
from turtlelog.files.text_files import read_text_file
from turtlelog.measure import list_metrics
from turtlelog.scenario import (
    Scenario,
    choose_scenario,
    flatten_scenario,
    override_scenario,
    resolve_scenario,
    unwrap_number,
)
from turtlelog.simulate import declare_scenario
from turtlelog.simulate.loop_parts import list_streams
from turtlelog.simulate.step_budget import STEP_BUDGET_S
from turtlelog.sweep import tune_search
from turtlelog.sweep.sweep_plan import KP, EqualSteps, parse_key_values
from turtlelog.sweep.tune_candidates import Candidates, SearchedKey, TuningGoal, spread_keys

if TYPE_CHECKING:
    from concurrent.futures import Executor

FOR_EACH_KEY: Final = 300
"""Candidates per key: the cover takes 32 (128 of one key alone), a generation 12."""

FEWEST: Final = 8  # candidates of a search
_MOST_STEPS: Final = 10_000  # values of a key with a step, of which the nearest is searched


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class TunedScenario:
    """The best values that a search found.

    Attributes:
        scenario: Scenario with the best values.
        keys: Keys with their search ranges.
        goal: Goal of the search.
        tuned: Result of the search.
        around: Range of each key; None if no candidate satisfies the constraints.
    """

    scenario: Scenario
    keys: tuple[SearchedKey, ...]
    goal: TuningGoal
    tuned: tune_search.Tuned
    around: tune_search.Neighbourhood | None = None

    @property
    def values(self) -> dict[str, float]:
        """Best value of each key."""
        return dict(zip((one.key for one in self.keys), self.tuned.best.point, strict=True))

    @property
    def objective(self) -> float:
        """Value of the objective at the best values."""
        found = self.tuned.best.objective
        return math.nan if found is None else found

    @property
    def unit(self) -> str:
        """Unit of the objective if it is a metric; else empty."""
        if self.goal.metric is None:
            return ""
        return list_metrics(declare_scenario(self.scenario))[self.goal.metric].unit

    @property
    def is_feasible(self) -> bool:
        """Whether the constraints hold at the best values."""
        return self.tuned.best.is_feasible

    def _describe(self) -> str:
        value = format_number(self.objective, self.unit)
        told = ", ".join(f"{key} = {one:.5g}" for key, one in self.values.items())
        no = "" if self.is_feasible else "no candidate fulfils the constraints, "
        return f"{no}{self.goal.objective.text} is {value} with {told}"

    def __repr__(self) -> str:
        return fit_line(f"<TunedScenario: {self._describe()}>")

    def _repr_html_(self) -> str:
        heads = ("key", "best", "good from", "to", "looked from", "to")
        ranges = {} if self.around is None else {one.key: one for one in self.around.ranges}
        rows = []
        for one in self.keys:
            found = ranges.get(one.key)
            ends = (None, None) if found is None else (found.low, found.high)
            rows.append((one.key, self.values[one.key], *ends, one.low, one.high))
        return format_notebook(self._describe(), format_html(rows, heads=heads))


def tune_scenario(  # noqa: PLR0913  (all but the first two have defaults)
    scenario: Scenario | str | Path,
    ranges: Mapping[str, tuple[float, float]],
    *,
    minimise: str | None = None,
    maximise: str | None = None,
    subject_to: Sequence[str] = (),
    law: Any = None,
    changes: Mapping[str, Any] | None = None,
    evaluations: int | None = None,
    seed: int = 0,
    jobs: "int | Executor | None" = None,
    step_budget_s: float = STEP_BUDGET_S,
) -> TunedScenario:
    """Search for the best values of keys, and for the range of each key around them.

    Args:
        scenario: Scenario to tune: a scenario, the name of a preset, or a file.
        ranges: Bounds by dotted key, as in `{"law.kp_linear": (1, 6)}`; `kp` sets all gains.
        minimise: Metric, or formula of metrics and keys, to minimise.
        maximise: Metric or formula to maximise, instead of `minimise`.
        subject_to: Constraints, as in `["rotate.overshoot <= 2"]`.
        law: Law to use instead of the scenario's law, as in `simulate_run`.
        changes: Values by dotted key, the same for all candidates.
        evaluations: Approximate largest number of candidates. Default: 300 per key.
        seed: Seed of the search; the same seed gives the same result.
        jobs: Number of processes, or an executor. Default: one per core if that is faster.
        step_budget_s: Longest computing time of the law per step [s].

    Raises:
        TuneError: If arguments are inconsistent, or the objective has no value for any candidate.
        ExpressionError: If a formula cannot be parsed, or contains an unknown name.
        LawError: If `law` is not a law.
        ScenarioError: If the scenario does not exist, or the ranges contain no valid scenario.
    """
    goal, texts = _build_goal(minimise, maximise, subject_to), [*_list_ranges(ranges)]
    most = FOR_EACH_KEY * len(texts) if evaluations is None else evaluations
    for name, number, least in (("seed", seed, 0), ("evaluations", most, FEWEST)):
        if not isinstance(number, Integral):
            raise TuneError(f"{name}: expected a whole number, found {number!r:.60}")
        if number < least:
            raise TuneError(f"{name}: expected at least {least}, found {number}")
    base = choose_scenario(scenario, law=law, changes=changes)
    base, keys = complete_searched(base, texts, source="ranges")
    candidates = Candidates(
        base,
        [one.key for one in keys],
        goal,
        jobs=jobs,
        expected=most + tune_search.NEIGHBOURS * len(keys),
        step_budget_s=step_budget_s,
        source="ranges",
    )
    return tune_candidates(candidates, keys, evaluations=most, seed=seed)


def _build_goal(
    minimise: str | None, maximise: str | None, subject_to: Sequence[str]
) -> TuningGoal:
    if (minimise is None) == (maximise is None):
        raise TuneError("tune_scenario: expected minimise or maximise, one of them")
    name, text = ("minimise", minimise) if maximise is None else ("maximise", maximise)
    constraints = [subject_to] if isinstance(subject_to, str) else subject_to
    return TuningGoal(
        objective=parse_expression(str(text), source=name),
        is_maximised=maximise is not None,
        constraints=tuple(parse_expression(one, source="subject_to") for one in constraints),
    )


def tune_candidates(
    candidates: Candidates,
    keys: tuple[SearchedKey, ...],
    *,
    evaluations: int,
    seed: int = 0,
) -> TunedScenario:
    """Search for the best candidate, and for the range of each key around it.

    Args:
        candidates: Evaluator of candidates.
        keys: Keys with their search ranges.
        evaluations: Approximate largest number of candidates of the search.
        seed: Seed of the search; the same seed gives the same result.

    Raises:
        TuneError: If the objective has no value for any candidate.
        ScenarioError: If a bound makes no valid scenario.
    """
    candidates.require_bounds([tuple(one.low for one in keys), tuple(one.high for one in keys)])
    goal, around = candidates.goal, None
    tuned = tune_search.search_best(candidates, keys, evaluations=evaluations, seed=seed)
    if tuned.best.is_feasible:
        tuned, around = tune_search.explore_best(candidates, keys, tuned)
    best = candidates.build_scenario(tuned.best.point)
    return TunedScenario(scenario=best, keys=keys, goal=goal, tuned=tuned, around=around)


def complete_searched(
    scenario: Scenario, texts: Sequence[str], *, source: str, trust_law: bool = False
) -> tuple[Scenario, tuple[SearchedKey, ...]]:
    """Return the keys, and the scenario with a value for each key, because laws may lack defaults.

    The keys are texts that `parse_searched_keys` reads, `source` is the prefix of error messages.
    """
    known = flatten_scenario(scenario)
    keys = parse_searched_keys(texts, known, source=source)
    names = tuple(one.key for one in keys)
    if KP in names:
        gains = declare_scenario(resolve_scenario(scenario, trust_law=trust_law)).list_gains()
        spread_keys(names, gains, source=source)
    lows = {one.key: one.low for one in keys if one.key not in {*known, KP}}
    whole = {key: int(low) if float(low).is_integer() else low for key, low in lows.items()}
    scenario = override_scenario(scenario, whole, source=source)
    resolved = flatten_scenario(resolve_scenario(scenario, trust_law=trust_law))
    return scenario, parse_searched_keys(texts, resolved, source=source)


def parse_searched_keys(
    texts: Sequence[str], parameters: Mapping[str, Any], *, source: str = "--grid"
) -> tuple[SearchedKey, ...]:
    """Parse texts such as `law.kp_linear=0.5:12`.

    Args:
        texts: Texts, each with a key, an equals sign and bounds.
        parameters: Parameters of the scenario by key; they show which keys need whole numbers.
        source: Prefix of error messages.

    Raises:
        SweepError: If a text cannot be parsed.
        TuneError: If there is no text, or a key occurs twice or has no range.
    """
    if not texts:
        raise TuneError(f"{source}: expected a key and its bounds, as in law.kp_linear=0.5:12")
    found: dict[str, SearchedKey] = {}
    for text in texts:
        one = parse_key_values(text, source=source, is_sampled=True)
        steps = one.values
        if not isinstance(steps, EqualSteps) or (not one.is_open and len(steps) > _MOST_STEPS):
            expected = "two bounds and perhaps a step, as in 0.5:12 or 0.5:12:0.5"
            raise TuneError(f"{source}: {one.key}: expected {expected}, found {one.text[:60]!r}")
        if one.key in found:
            raise TuneError(f"{source}: {one.key}: expected each key once, found it twice")
        low, high = steps[0], steps[-1]
        if not low < high:
            raise TuneError(f"{source}: {one.key}: expected a range, found {one.text[:60]!r}")
        known = parameters.get(one.key)
        if isinstance(known, bool) or not isinstance(known, int | float | None):
            expected = "a key whose values are numbers"
            raise TuneError(f"{source}: {one.key}: expected {expected}, found {known!r}")
        is_whole = isinstance(known, int) and not isinstance(known, bool)
        if is_whole and not (float(low).is_integer() and float(high).is_integer()):
            expected = "whole bounds of a key that counts"
            raise TuneError(f"{source}: {one.key}: expected {expected}, found {one.text[:60]!r}")
        found[one.key] = SearchedKey(
            key=one.key,
            low=low,
            high=high,
            is_whole=is_whole,
            steps=() if one.is_open else tuple(steps),
        )
    return tuple(found.values())


def _list_ranges(ranges: Mapping[str, tuple[float, float]]) -> Iterator[str]:
    example = '{"law.kp_linear": (1, 6)}'
    if not isinstance(ranges, Mapping) or not ranges:
        raise TuneError(f"ranges: expected bounds by key, as in {example}, found {ranges!r:.60}")
    for key, bounds in ranges.items():
        try:
            low, high = (unwrap_number(one) for one in bounds)
            is_sound = math.isfinite(low) and math.isfinite(high)
        except (TypeError, ValueError):
            is_sound = False
        if not is_sound:
            expected = f"two finite numbers, as in {example}"
            raise TuneError(f"ranges: {key}: expected {expected}, found {bounds!r:.60}")
        yield f"{key}={low!r}:{high!r}"


_DELAY: Final = "loop.transport_delay_ticks"
_SEED: Final = "seed"

_SAME: Final = ("gain", "dead_time_s", "lag_s", "bound", "deadband", "friction", "reverse_gain")
_PARTS: Final = {**{name: name for name in _SAME}, "rate_limit": "acceleration"}
_AXES: Final = {"speed": "speed", "turn_rate": "turn"}
_MOST_BYTES: Final = 2**24
"""Largest output of `identify --json` that is read [bytes]; one robot has a few kB."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Variation:
    """A key of the scenario that is sampled at random.

    The distribution is uniform, over whole numbers if `is_whole` is set.
    """

    key: str  # dotted scenario key
    low: float  # smallest value
    high: float  # largest value
    is_whole: bool = False  # whether values are whole numbers


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """Results of random variants of a candidate."""

    runs: int  # number of variants
    with_value: int  # number of variants in which the objective has a value
    holds: int  # number of variants with a value in which every constraint holds
    median: float | None  # median of the objective; None, like the next three, if there is no value
    low: float | None  # 5th percentile of the objective, interpolated
    high: float | None  # 95th percentile of the objective, interpolated
    worst: float | None  # worst value of the objective
    varied: tuple[Variation, ...]  # keys that were sampled at random


def choose_variations(
    scenario: Scenario, runs: int, more: Sequence[Variation] = ()
) -> tuple[Variation, ...]:
    """Return the keys to sample at random in variants of a scenario.

    The seed varies if the scenario has random effects. The transport delay varies by one tick up
    and down, because a program that runs on ticks may differ from its model by one tick. The keys
    in `more` vary too, for example with the intervals of an identified robot.

    Args:
        scenario: Best scenario; its law may run.
        runs: Number of variants.
        more: Further keys, which replace the keys above.
    """
    given = {one.key: one.high for one in more}
    resolved = resolve_scenario(override_scenario(scenario, given, source="--spread"))
    found: list[Variation] = []
    if list_streams(resolved) and _SEED not in given:
        first = resolved.seed
        found.append(Variation(key=_SEED, low=first, high=first + runs - 1, is_whole=True))
    if _DELAY not in given:
        ticks = resolved.loop.transport_delay_ticks
        found.append(Variation(key=_DELAY, low=max(ticks - 1, 0), high=ticks + 1, is_whole=True))
    return (*found, *more)


def read_intervals(path: Path, scenario: Scenario) -> tuple[Variation, ...]:
    """Return the intervals of a robot's gains, dead times, time constants and limits.

    Args:
        path: File with the output of `turtlelog identify --json`.
        scenario: Scenario with that robot.

    Raises:
        TuneError: If the file has other content, or the scenario has another robot.
    """
    try:
        text = read_text_file(path, most=_MOST_BYTES)
    except OSError as err:
        raise TuneError(f"{path}: expected a file, found: {err.strerror or err}") from err
    try:
        axes = json.loads(text)["axes"]
        intervals = {
            f"plant.{_AXES[axis['axis']]}_{name}": (axis[part]["low"], axis[part]["high"])
            for axis in axes
            for part, name in _PARTS.items()
            if axis.get(part) is not None
        }
    except (ValueError, KeyError, TypeError, RecursionError) as err:
        expected = "what `turtlelog identify --json` prints"
        raise TuneError(f"{path}: is not {expected}") from err
    parameters = flatten_scenario(scenario)
    known = {
        key: (float(low), float(high))
        for key, (low, high) in intervals.items()
        if _is_number(low) and _is_number(high) and key in parameters
    }
    if not known:
        what = "intervals of a robot that the scenario drives, as `identify --scenario` writes it"
        raise TuneError(f"{path}: has no {what}")
    # The interval around a dead time of 0 is cut at 0, because a dead time is never negative.
    return tuple(
        Variation(key=key, low=max(low, 0.0), high=max(high, 0.0))
        for key, (low, high) in known.items()
    )


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e300


def simulate_variants(
    scenario: Scenario,
    goal: TuningGoal,
    variations: Sequence[Variation],
    *,
    runs: int,
    seed: int = 0,
    jobs: "int | Executor | None" = None,
    **more: Any,
) -> Spread:
    """Simulate variants of a scenario and return their results.

    Args:
        scenario: Best scenario.
        goal: Objective and constraints.
        variations: Keys to sample, each uniformly from its range and independently.
        runs: Number of variants.
        seed: Seed of the sampling. The scenario's seed, if varied, rises by one per variant.
        jobs: Number of processes, as in `Candidates`.
        more: Further options, as in `Candidates`.
    """
    generator = np.random.default_rng(seed)
    columns: list[list[Any]] = []
    for one in variations:
        if one.key == _SEED:
            first, count = int(one.low), round(one.high - one.low + 1)
            columns.append([first + number % count for number in range(runs)])
        elif one.is_whole:
            drawn = generator.integers(int(one.low), int(one.high) + 1, runs)
            columns.append(drawn.tolist())
        else:
            columns.append(generator.uniform(one.low, one.high, runs).tolist())
    points = [*zip(*columns, strict=True)]
    candidates = Candidates(
        scenario, [one.key for one in variations], goal, jobs=jobs, expected=runs, **more
    )
    found = candidates.evaluate(points)
    values = [one.objective for one in found if one.objective is not None]
    low, middle, high = (
        np.quantile(values, [0.05, 0.5, 0.95]).tolist() if values else (None, None, None)
    )
    worst = min if goal.is_maximised else max
    return Spread(
        runs=runs,
        with_value=len(values),
        holds=sum(one.is_feasible for one in found),
        median=middle,
        low=low,
        high=high,
        worst=worst(values, default=None),
        varied=tuple(variations),
    )
