"""Ranges of single keys around the best values, and robustness to variations of the scenario."""

import json
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any, Final, Literal

import numpy as np

from turtlelog.errors import TuneError
from turtlelog.files.text_files import read_text_file
from turtlelog.scenario import Scenario, flatten_scenario, override_scenario, resolve_scenario
from turtlelog.simulate.loop_parts import list_streams
from turtlelog.sweep.tune.candidates import Candidate, Candidates, Point, TuningGoal
from turtlelog.sweep.tune.search import SearchedKey, Tuned, sum_up

_WORSE: Final = 0.1
"""Largest loss of the objective, as a share of the best value: the rounding of a gain."""

_OF_SPREAD: Final = 0.01
"""The same loss as a share of the distance from the best to the median candidate, if that is
larger. A share of a best value of 0 would always be 0."""

_POINTS: Final = 16
"""Number of candidates between the best value and each bound, denser near the best."""

_ROUNDS: Final = 5
"""Largest number of neighbourhoods. If a metric depends on single samples, each may contain a
better value."""

_HALVINGS: Final = 8
"""Number of halvings of the step, down to 1/256."""

NEIGHBOURS: Final = 2 * (_POINTS + _HALVINGS)
"""Largest number of candidates of a neighbourhood for each key."""

End = Literal["objective", "constraint", "no value", "bound"]


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyRange:
    """Range of a key around its best value, with all other keys at their best values.

    Attributes:
        key: Dotted scenario key.
        low: Smallest value that is still good.
        high: Largest value that is still good.
        low_end: Reason for the lower end: the objective becomes worse, a constraint is violated, a
            value is missing, or the given bound is reached.
        high_end: Reason for the upper end, with the same values.
        low_constraint: Constraint that is violated below the range; empty if no constraint is.
        high_constraint: Constraint that is violated above the range; empty if no constraint is.
    """

    key: str
    low: float
    high: float
    low_end: End
    high_end: End
    low_constraint: str = ""
    high_constraint: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Neighbourhood:
    """The range in which each key can change while the other keys stay fixed.

    Attributes:
        slack: Largest accepted loss of the objective.
        ranges: Range of each key.
    """

    slack: float
    ranges: tuple[KeyRange, ...]


@dataclass(slots=True)
class _Walk:
    """A walk from the best value to a bound: the last good fraction and the first bad fraction."""

    place: int
    bound: float
    good: float = 0.0
    bad: float | None = None
    end: End = "bound"
    constraint: str = ""


def explore_best(
    candidates: Candidates, keys: Sequence[SearchedKey], found: Tuned
) -> tuple[Tuned, Neighbourhood]:
    """Return the best candidate and its neighbourhood. A better candidate found there replaces it.

    Args:
        candidates: Evaluator of candidates.
        keys: Varied keys.
        found: Best candidate so far, which satisfies the constraints.
    """
    for _ in range(_ROUNDS):
        around = explore_neighbourhood(candidates, keys, found.best)
        before, found = found, sum_up(candidates, keys)
        if found.best is before.best:
            break
    return replace(found, best=before.best, at_bounds=before.at_bounds), around


def explore_neighbourhood(
    candidates: Candidates, keys: Sequence[SearchedKey], best: Candidate
) -> Neighbourhood:
    """Return the range of each key, found by walks from the best value to both bounds.

    The best candidate satisfies the constraints.
    """
    assert best.objective is not None
    slack, sign = _find_slack(candidates, best.objective), candidates.goal.sign
    limit = sign * best.objective + slack
    walks = [_Walk(place, bound) for place, key in enumerate(keys) for bound in (key.low, key.high)]

    def move(walk: _Walk, share: float) -> Point:
        point = [*best.point]
        here, key = point[walk.place], keys[walk.place]
        point[walk.place] = key.round(here + share * (walk.bound - here))
        return tuple(point)

    def look(asked: Sequence[tuple[_Walk, float]]) -> list[tuple[End, str] | None]:
        found = candidates.evaluate([move(walk, share) for walk, share in asked])
        return [_find_fault(one, limit, sign) for one in found]

    shares = [(step / _POINTS) ** 2 for step in range(1, _POINTS + 1)]
    asked = [(walk, share) for walk in walks for share in shares]
    for (walk, share), fault in zip(asked, look(asked), strict=True):
        if walk.bad is None:
            _enter(walk, share, fault)
    for _ in range(_HALVINGS):
        halved = [(one, (one.good + one.bad) / 2.0) for one in walks if one.bad is not None]
        for (walk, share), fault in zip(halved, look(halved), strict=True):
            _enter(walk, share, fault)
    ranges = (
        KeyRange(
            key=key.key,
            low=move(below, below.good)[below.place],
            high=move(above, above.good)[above.place],
            low_end=below.end,
            high_end=above.end,
            low_constraint=below.constraint,
            high_constraint=above.constraint,
        )
        for key, below, above in zip(keys, walks[::2], walks[1::2], strict=True)
    )
    return Neighbourhood(slack=slack, ranges=tuple(ranges))


def _enter(walk: _Walk, share: float, fault: tuple[End, str] | None) -> None:
    if fault is None:
        walk.good = share
    else:
        walk.bad, (walk.end, walk.constraint) = share, fault


def _find_slack(candidates: Candidates, best: float) -> float:
    """Return the accepted loss of the objective, relative to the best value."""
    values = [
        one.objective
        for one in candidates.list_known()
        if one.is_feasible and one.objective is not None
    ]
    return max(_WORSE * abs(best), _OF_SPREAD * abs(median(values) - best))


def _find_fault(one: Candidate, limit: float, sign: float) -> tuple[End, str] | None:
    """Return why a candidate is not good; None if the candidate is good."""
    broken = [found for found in one.constraints if not found.holds]
    if broken:
        return "constraint", broken[0].expression
    if one.objective is None:
        return "no value", ""
    return ("objective", "") if sign * one.objective > limit else None


_DELAY: Final = "loop.transport_delay_ticks"
_SEED: Final = "seed"

_PARTS: Final = {
    **{
        name: name for name in ("gain", "dead_time_s", "lag_s", "bound", "deadband", "reverse_gain")
    },
    "rate_limit": "acceleration",
}
_AXES: Final = {"speed": "speed", "turn_rate": "turn"}
_MOST_BYTES: Final = 2**24
"""Largest output of `identify --json` that is read [bytes]; one robot has a few kB."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Variation:
    """A key of the scenario that is sampled at random.

    Attributes:
        key: Dotted scenario key.
        low: Smallest value.
        high: Largest value. The distribution is uniform, over whole numbers if `is_whole` is set.
        is_whole: Whether values are whole numbers.
    """

    key: str
    low: float
    high: float
    is_whole: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """Results of random variants of a candidate.

    Attributes:
        runs: Number of variants.
        with_value: Number of variants in which the objective has a value.
        holds: Number of variants in which every constraint holds and the objective has a value.
        median: Median of the objective; None if the objective has no value in any variant.
        low: 5th percentile of the objective, interpolated.
        high: 95th percentile of the objective, interpolated.
        worst: Worst value of the objective.
        varied: Keys that were sampled at random.
    """

    runs: int
    with_value: int
    holds: int
    median: float | None
    low: float | None
    high: float | None
    worst: float | None
    varied: tuple[Variation, ...]


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
        expected = (
            "intervals of a robot that the scenario drives, as `identify --scenario` writes it"
        )
        raise TuneError(f"{path}: has no {expected}")
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
    columns = [_draw(one, runs, generator) for one in variations]
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


def _draw(one: Variation, count: int, generator: np.random.Generator) -> list[Any]:
    if one.key == _SEED:
        return [int(one.low) + number % round(one.high - one.low + 1) for number in range(count)]
    if one.is_whole:
        drawn: list[Any] = generator.integers(int(one.low), int(one.high) + 1, count).tolist()
        return drawn
    return generator.uniform(one.low, one.high, count).tolist()  # type: ignore[no-any-return]
