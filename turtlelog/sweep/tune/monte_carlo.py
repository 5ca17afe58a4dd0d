"""How the best values do where the loop is not quite as it was thought to be: drawn variants."""

import json
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from turtlelog.errors import TuneError
from turtlelog.files.text_files import read_text_file
from turtlelog.scenario import (
    Scenario,
    flatten_scenario,
    override_scenario,
    resolve_scenario,
)
from turtlelog.simulate.streams import list_streams
from turtlelog.sweep.tune.candidates import Candidates
from turtlelog.sweep.tune.goal import TuningGoal

DELAY: Final = "loop.transport_delay_ticks"
SEED: Final = "seed"

_PARTS: Final = {
    **{
        name: name for name in ("gain", "dead_time_s", "lag_s", "bound", "deadband", "reverse_gain")
    },
    "rate_limit": "acceleration",
}
_AXES: Final = {"speed": "speed", "turn_rate": "turn"}
_MOST_BYTES: Final = 2**24
"""Of what `identify --json` printed: of one robot it prints some kB."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Variation:
    """A key of the scenario that variants draw.

    Attributes:
        key: Dotted.
        low: Least value.
        high: Largest; every value between, whole ones where it counts, is as likely.
        is_whole: Whether it counts.
    """

    key: str
    low: float
    high: float
    is_whole: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """What variants of a candidate come to.

    Attributes:
        runs: How many.
        with_value: In how many the objective has a value.
        holds: In how many every constraint holds, and the objective has a value.
        median: Of the objective, of those that have one; None where none has.
        low: 5 % of them are below, interpolated.
        high: 5 % are above.
        worst: The worst of them.
        varied: What was drawn.
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
    """Return what variants of a scenario draw.

    The seed, where the scenario has random effects: without them it changes nothing. The transport
    delay, by a tick to either side: no program on a clock of ticks is nearer than that to its
    model. And what else is given, as the intervals of an identified robot.

    Args:
        scenario: The best one, whose law may run.
        runs: How many variants there will be.
        more: Further keys; one of the two above takes its place.
    """
    given = {one.key: one.high for one in more}
    resolved = resolve_scenario(override_scenario(scenario, given, source="--spread"))
    found: list[Variation] = []
    if list_streams(resolved) and SEED not in given:
        first = resolved.seed
        found.append(Variation(key=SEED, low=first, high=first + runs - 1, is_whole=True))
    if DELAY not in given:
        ticks = resolved.loop.transport_delay_ticks
        found.append(Variation(key=DELAY, low=max(ticks - 1, 0), high=ticks + 1, is_whole=True))
    return (*found, *more)


def read_intervals(path: Path, scenario: Scenario) -> tuple[Variation, ...]:
    """Return the intervals of a robot's gains, dead times, lags and limits.

    Args:
        path: What `turtlelog identify --json` printed.
        scenario: Around that robot.

    Raises:
        TuneError: Where the file is another, or the scenario has another robot.
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
    # A dead time of 0 is as likely as the interval around it; below 0 there is none.
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
    """Simulate variants of a scenario, and return what they come to.

    Args:
        scenario: The best one.
        goal: What they are judged by.
        variations: What they draw, each evenly from its range and by itself.
        runs: How many.
        seed: Of what is drawn; the seeds of the scenario go on one by one.
        jobs: As in `Candidates`.
        more: Likewise.
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
    if one.key == SEED:
        return [int(one.low) + number % round(one.high - one.low + 1) for number in range(count)]
    if one.is_whole:
        drawn: list[Any] = generator.integers(int(one.low), int(one.high) + 1, count).tolist()
        return drawn
    return generator.uniform(one.low, one.high, count).tolist()  # type: ignore[no-any-return]
