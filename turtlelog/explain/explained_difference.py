"""The data of an explained difference between two runs, and their first different value."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from html import escape
from typing import Any, Final, Literal

import numpy as np

from turtlelog.display import fit_line, format_html, format_notebook
from turtlelog.explain.attribution import Resolution, Together, ValueSet
from turtlelog.replay import differences
from turtlelog.replay.differences import Difference, Pairing
from turtlelog.replay.loop_replay import compare_ends
from turtlelog.run import Run

SEED: Final = "seed"
"""Name of the line with the effect of the two seeds, relative to the means over seeds."""

ROBOT: Final = "robot"
"""Basis of a robot's log: its model, driven by the recorded commands."""


Part = Literal["start", "robot", "sensor", "controller", "timing", "end"]


_TIMES: Final = ("sample_time", "pose_read", "command_time")


_POSES: Final = ("x", "y", "heading", "applied_speed", "applied_turn_rate")


_ENDS: Final = ("stop", "samples", "poses", "commands")


@dataclass(frozen=True, slots=True, kw_only=True)
class Departure:
    """The earliest difference of two runs.

    Attributes:
        part: Part that differs first. `start`: the first pose. `robot`: the motion after equal
            commands. `sensor`: the sensed pose. `controller`: the answer to an equal pose.
            `timing`: the time of a sample or command. `end`: one run is longer.
        signal: Name of the signal that differs.
        unit: Unit of the values; empty for a name or a count.
        time_s: Time of the difference from the first sample, or else from the first pose [s].
        first: Value of the first run; None if it has no value there.
        second: Value of the second run.
        samples: Number of equal samples before the difference.
    """

    part: Part
    signal: str
    unit: str
    time_s: float
    first: float | str | None
    second: float | str | None
    samples: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Side:
    """One of two runs.

    Attributes:
        name: Name of the run.
        as_logged: The metric of the log; None if the metric has no value.
        resimulated: The metric re-simulated with the run's own seed; None if the metric has no
            value.
        reason: Reason why the metric has no value; empty if it has a value.
        basis: Scenario that reproduces the run. `recorded`: the run's own scenario, which
            reproduces every sample. `identified`: a scenario identified from the samples. `robot`:
            the robot model, driven by the recorded commands. None if no scenario reproduces the
            run.
        note: How accurately the recorded scenario reproduces the run, or why no scenario does.
        is_exact: Whether this scenario reproduces every sample.
        unknown: Keys that are not identified; the values of the other run are used instead.
        simulated_by: Versions, platform and digest of the law that simulated the run; see `Run`.
    """

    name: str
    as_logged: float | None
    resimulated: float | None = None
    reason: str = ""
    basis: str | None = None
    note: str = ""
    is_exact: bool = False
    unknown: tuple[str, ...] = ()
    simulated_by: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """A group of settings that differ, with its contribution to the difference of the metric.

    Attributes:
        name: Name of the group: `gains`, `queue`, `goal`, or the key of a setting.
        keys: Keys of the settings in which the scenarios differ; `seed` for the effect of the
            seeds.
        first: Values in the first run; None for a key that the run does not have.
        second: Values in the second run.
        contribution: Contribution to the difference, in the metric's unit; None if it is withheld.
        standard_error: Standard error of the contribution, if it is a mean over seeds or sampled
            orders, or depends on identified values.
        low: Lower end of the contribution's 95 % interval; None if the contribution is exact.
        high: Upper end of the interval.
        undone: The metric of the second run if only this group is as in the first run; None if it
            has no value.
    """

    name: str
    keys: tuple[str, ...]
    first: tuple[Any, ...] = ()
    second: tuple[Any, ...] = ()
    contribution: float | None = None
    standard_error: float | None = None
    low: float | None = None
    high: float | None = None
    undone: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class EffectShift:
    """The contribution of an effect to the metric of each run, as `explain` finds it.

    Attributes:
        cause: Name of the effect.
        first: Contribution in the first run, in the metric's unit; 0 if the run does not have the
            effect.
        second: Contribution in the second run.
    """

    cause: str
    first: float
    second: float

    @property
    def shift(self) -> float:
        """Change of the contribution from the first to the second run."""
        return self.second - self.first


@dataclass(frozen=True, slots=True, kw_only=True)
class DifferenceRange:
    """Range of the difference over starts within the turn of one sample.

    Attributes:
        count: Number of start headings, equally spaced around each scenario's own heading.
        within_rad: Angle between the scenarios' own heading and the heading of the first and last
            start [rad].
        difference: Smallest and largest difference, in the metric's unit.
        first: Smallest and largest metric of the first run.
        second: Smallest and largest metric of the second run.
        is_wide: Whether the difference depends on single samples: whether its range exceeds half of
            the difference.
    """

    count: int
    within_rad: float
    difference: tuple[float, float]
    first: tuple[float, float]
    second: tuple[float, float]
    is_wide: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class ExplainedDifference:
    """The difference of a metric between two runs, divided among the changed settings.

    Attributes:
        metric: Id of the metric.
        unit: Unit of all values.
        first: Run from which the difference is taken.
        second: Other run.
        difference: Metric of the second run minus metric of the first, re-simulated (for robots,
            as logged); None if a run has no value.
        contributions: Contribution of each group of changed settings, the largest first. The sum is
            `difference`; for robots, it includes `unexplained`. Empty if the contributions are
            withheld.
        changes: Names and values of the changed settings, without contributions, if contributions
            are withheld.
        idle: Keys that differ but never change the metric, in any combination.
        unexplained: Part of the difference that neither the models of two robots nor the
            contributions explain; None if no robots are identified.
        withheld: Reason why there are no contributions, in one clause; None if there are
            contributions.
        together: Parts that several groups add only if all of these groups are changed.
        without_value: Smallest sets of changes that leave the metric without a value.
        with_value: Smallest sets of changes that give the metric a value, if the first run has no
            value.
        resolution: Largest change that is negligible.
        starts: Range of the difference over starts within the turn of one sample; None with random
            effects.
        seeds: Number of seeds over which the contributions are means; 1 if nothing is random.
        orders: Number of sampled orders of the changes; None if all combinations were simulated.
        effects: Differences of the contributions of `explain`, the largest first.
        has_same_settings: Whether the runs have the same settings, as far as settings can change a
            run.
        departure: First difference of runs with the same settings; None for other runs.
        sentences: The answer in words.
    """

    metric: str
    unit: str
    first: Side
    second: Side
    difference: float | None = None
    contributions: tuple[Change, ...] = ()
    changes: tuple[Change, ...] = ()
    idle: tuple[str, ...] = ()
    unexplained: float | None = None
    withheld: str | None = None
    together: tuple[Together, ...] = ()
    without_value: tuple[ValueSet, ...] = ()
    with_value: tuple[ValueSet, ...] = ()
    resolution: Resolution
    starts: DifferenceRange | None = None
    seeds: int = 1
    orders: int | None = None
    effects: tuple[EffectShift, ...] = ()
    has_same_settings: bool = False
    departure: Departure | None = None
    sentences: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        """Write the sentences."""
        from turtlelog.explain.difference_report import write_difference_sentences

        object.__setattr__(self, "sentences", write_difference_sentences(self))

    def __repr__(self) -> str:
        names = f"{self.first.name} and {self.second.name}"
        return fit_line(f"<ExplainedDifference of {names}: {self.metric}>")

    def _repr_html_(self) -> str:
        heads = ["settings", f"contribution [{self.unit}]", "first run", "second run"]
        rows = [
            [
                one.name,
                one.contribution,
                _write_values(one, one.first),
                _write_values(one, one.second),
            ]
            for one in self.contributions
        ]
        table = format_html(rows, heads=heads) if rows else ""
        rest = [f"<p>{escape(text)}</p>" for text in self.sentences[1:]]
        return format_notebook(self.sentences[0], table, *rest)


def _write_values(change: Change, values: tuple[Any, ...]) -> str:
    return ", ".join(f"{key} = {value}" for key, value in zip(change.keys, values, strict=False))


def find_departure(first: Run, second: Run) -> Departure | None:
    """Return the first difference of two runs; None if all their common data are equal.

    Poses are compared tick by tick if both runs contain all ticks. Otherwise only the poses that
    samples read are compared.
    """
    signals = [differences.compare_pairing(one, tolerance=0.0) for one in _pair(first, second)]
    others = [*_compare_counts(first, second), compare_ends(first, second.stop_reason)]
    found = differences.find_earliest([*(one.first_difference for one in signals), *others])
    if found is None:
        return None
    units = {one.signal: one.unit for one in signals}
    return Departure(
        part=_name_part(found, first),
        signal=found.signal,
        unit=units.get(found.signal, ""),
        time_s=float(found.time_ns - first.start_ns) / 1e9,
        first=found.recorded,
        second=found.replayed,
        samples=int(np.searchsorted(first.samples.time_ns, found.time_ns)),
    )


def _pair(first: Run, second: Run) -> Iterator[Pairing]:
    """Yield the signals row by row; at equal times, causes before their consequences."""
    if differences.count_missing_samples(second.samples):  # rows are matched by sample number
        return
    by_tick = differences.has_ticks(first) and differences.has_ticks(second)
    pairings = (differences.pair_by_tick if by_tick else differences.pair_by_sample)(first, second)
    yield from (one for one in pairings if len(one.time_ns))


def _compare_counts(first: Run, second: Run) -> Iterator[Difference | None]:
    by_tick = differences.has_ticks(first) and differences.has_ticks(second)
    for name, count in differences.count_recorded_rows(first, second, by_tick=by_tick).items():
        found = differences.find_count_difference(first, name, count)
        if found is not None:
            end_ns = min(first.end_ns, second.end_ns)
            yield Difference(
                signal=name, time_ns=end_ns, recorded=found.recorded, replayed=found.replayed
            )


def _name_part(found: Difference, first: Run) -> Part:
    signal = found.signal
    if signal in _ENDS:
        return "end"
    if signal in _TIMES:
        return "timing"
    if signal.startswith("sensed_"):
        return "sensor"
    if signal in _POSES:
        return "start" if found.time_ns <= first.poses.time_ns[0] else "robot"
    return "controller"
