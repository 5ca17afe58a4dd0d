"""The values of the answers: a value attributed to causes, and a difference divided."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from turtlelog.display import fit_line
from turtlelog.explain.causes import Resolution as Resolution, ResolutionReason as ResolutionReason
from turtlelog.replay import Departure as Departure

SAME: Final = 1e-6
"""Share of a value below which a difference counts as 0: two platforms differ by less."""

_ROUNDING: Final = 1e-12  # share of a value by which sums in another order may differ


_CLEAR: Final = 3.0
"""Number of standard errors from which a mean differs from 0. By Student's t with 31 degrees of
freedom, a contribution that is 0 seems to differ in 1 of 190 runs. For six such contributions, this
is 3 % of runs."""

THIS_SEED: Final = "this seed"
"""Name of the line with the effect of the run's own seed, which no contribution contains."""

THIS_SEED_MEANS: Final = "the value of its own seed, less the mean over seeds"


def is_clear(value: float, standard_error: float | None) -> bool:
    """Return whether a mean over seeds differs from 0 significantly."""
    return abs(value) > _CLEAR * (standard_error or 0.0)


class Sized:
    """A contribution, perhaps withheld, with its standard error, if any."""

    __slots__ = ()
    contribution: float | None
    standard_error: float | None

    @property
    def size(self) -> float:
        """The contribution; 0 without one."""
        return self.contribution or 0.0

    @property
    def is_clear(self) -> bool:
        """Whether the contribution differs from 0 significantly."""
        return is_clear(self.size, self.standard_error)


@dataclass(frozen=True, slots=True, kw_only=True)
class Contribution(Sized):
    """The contribution of one cause to a value, and the value without this cause alone.

    Attributes:
        cause: Name of the cause.
        contribution: Shapley value of the cause: its part of resimulated - without_all, in the
            metric's unit; negative if the cause makes the value smaller. None if the cause takes no
            part. With random effects, the mean over seeds.
        alone: The metric without this cause alone; None if the metric has no value. With random
            effects, the mean over seeds.
        ending: Difference in kind without the cause, in one clause: a phase that no longer ends, or
            the reason why there is no value. None if the run has the same phases.
        meaning: Meaning of the run without the cause, in one clause.
        standard_error: Standard error of the contribution with random effects. For a cause that
            takes no part, the standard error of the change without it. None otherwise.
    """

    cause: str
    contribution: float | None
    alone: float | None
    ending: str | None = None
    meaning: str
    standard_error: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Together:
    """The part of a value that arises only if several causes act together.

    Attributes:
        causes: Names of at least two causes.
        value: Part that fewer of these causes do not add, in the metric's unit. The part is divided
            equally among the contributions of the causes.
        standard_error: Standard error with random effects; None otherwise.
    """

    causes: tuple[str, ...]
    value: float
    standard_error: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ValueSet:
    """A smallest set of causes that gives the metric a value, or leaves it without one.

    Attributes:
        causes: Acting causes; all other causes that take part are removed.
        reason: Reason why the metric has no value.
    """

    causes: tuple[str, ...]
    reason: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class CausePart:
    """Range of a cause's part in the total of all causes, over starts; 1 is the total.

    Attributes:
        cause: Name of the cause.
        low: Lowest part.
        high: Highest part.
    """

    cause: str
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True)
class StartRange:
    """Range of a value over starts within the turn of one sample.

    Attributes:
        count: Number of start headings, equally spaced around the scenario's own heading.
        within_rad: Angle between the scenario's own heading and the heading of the first and last
            start [rad].
        low: Smallest value, in the metric's unit.
        high: Largest value.
        without_value: Number of starts without a value.
        is_wide: Whether the value depends on single samples: its range and the range of the
            effects' total both exceed half of the total for the scenario's own start. If this total
            is within the resolution, both ranges must exceed the resolution and half of the largest
            value.
        parts: Part of each cause that changes the value, if the range is wide. Empty if a cause
            acts against the total at some start, or if too many simulations are needed.
        without_all: Smallest and largest value without all acting causes, if the range is wide.
    """

    count: int
    within_rad: float
    low: float
    high: float
    without_value: int
    is_wide: bool
    parts: tuple[CausePart, ...] = ()
    without_all: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SeedRange:
    """Range of a value over seeds.

    Attributes:
        count: Number of simulated seeds.
        used: Seeds with which every combination of causes has a value, for the contributions.
        mean: Mean of the value with all effects over the used seeds.
        standard_error: Standard error of the mean.
        low: Lower end of the central 95 % of the values with all effects.
        high: Upper end of the same range.
    """

    count: int
    used: int
    mean: float
    standard_error: float
    low: float
    high: float

    @property
    def varies(self) -> bool:
        """Whether the value differs between seeds by more than rounding."""
        return self.high - self.low > _ROUNDING * max(abs(self.low), abs(self.high))


@dataclass(frozen=True, slots=True, kw_only=True)
class AttributedValue:
    """Causes of a value of a run, and their contributions.

    Attributes:
        metric: Id of the metric.
        unit: Unit of the metric.
        as_logged: Value of the log; None without a value, or without a log.
        resimulated: Value re-simulated with all effects; None without a value.
        without_all: Value re-simulated without all causes that take part; None without a value. If
            the rest of the scenario is random, the mean over seeds.
        causes: Causes that take part: the value is divided among them.
        contributions: Contributions of these causes, in the same order; empty if withheld. The
            `math.fsum` of the contributions is resimulated - without_all: see
            `compute_contributions`. With random effects they are means over seeds.
        others: Other causes in the scenario, each removed alone.
        resolution: Largest change that is negligible.
        withheld: Reason why there are no contributions, in one clause.
        together: Parts that several causes add only together.
        without_value: Smallest sets of causes that leave the metric without a value.
        with_value: Smallest sets of causes that give the metric a value, if it has no value without
            all causes.
        starts: Range of the value over starts within the turn of one sample. None if the robot does
            not turn, turns by more than 90 deg between samples, or with random effects.
        seeds: Range of the value over seeds; None without random effects.
        reason: Reason why the log, or else the re-simulation, has no value.
        doubts: Assumptions of the contributions that the log does not prove, in sentences.
        left: Effects that stay as recorded, because more than six are present.
        effects: Every effect that loop and law can have, in the scenario or not.
        remarks: Causes that could not be removed, and contact with a wall, in sentences.
        this_seed: Effect of the run's own seed: resimulated minus the mean over seeds; None without
            random effects.
        sentences: The attribution in words.
    """

    metric: str
    unit: str
    as_logged: float | None = None
    resimulated: float | None
    without_all: float | None
    causes: tuple[str, ...]
    contributions: tuple[Contribution, ...]
    others: tuple[Contribution, ...]
    resolution: Resolution
    withheld: str | None = None
    together: tuple[Together, ...] = ()
    without_value: tuple[ValueSet, ...] = ()
    with_value: tuple[ValueSet, ...] = ()
    starts: StartRange | None = None
    seeds: SeedRange | None = None
    reason: str | None = None
    doubts: tuple[str, ...] = ()
    left: tuple[str, ...] = ()
    effects: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    this_seed: float | None = field(init=False)
    sentences: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        value, seeds = self.resimulated, self.seeds
        this_seed = None if value is None or seeds is None else value - seeds.mean
        object.__setattr__(self, "this_seed", this_seed)
        object.__setattr__(self, "sentences", ())

    @property
    def acting(self) -> tuple[str, ...]:
        """Causes that change the value in any combination."""
        names = {one.cause for one in self.contributions if one.contribution}
        names |= {name for case in self.together if case.value for name in case.causes}
        return tuple(name for name in self.causes if name in names)

    @property
    def deciding(self) -> tuple[str, ...]:
        """Causes that change the value, or decide whether there is a value."""
        if not self.without_value:
            return self.acting
        sets = *self.without_value, *self.with_value
        named = {name for one in sets for name in one.causes}
        return tuple(name for name in self.causes if name in named) or self.causes

    @property
    def changing(self) -> tuple[Contribution, ...]:
        """Contributions and other causes that change the value or the ending of the run."""
        least = _ROUNDING * abs(self.divided)

        def acts(one: Contribution) -> bool:
            apart = 0.0 if one.alone is None else one.alone - self.divided
            return max(abs(apart), abs(one.size), one.standard_error or 0.0) > least

        return tuple(one for one in (*self.contributions, *self.others) if one.ending or acts(one))

    @property
    def divided(self) -> float:
        """Sum of `without_all` and all contributions; a mean with random effects; otherwise 0."""
        return (self.resimulated or 0.0) if self.seeds is None else self.seeds.mean

    def __repr__(self) -> str:
        parts = [
            f"{one.cause} {one.contribution:.4g}" for one in self.contributions if one.contribution
        ]
        is_divided = not (self.withheld or self.without_value)
        cause = (", ".join(parts) or "no effect changes it") if is_divided else "no contributions"
        value = self.resimulated if self.as_logged is None else self.as_logged
        size = "no value" if value is None else f"{value:.4g} {self.unit}"
        return fit_line(f"<Attribution of {self.metric}: {size}: {cause}>")


SEED: Final = "seed"
"""Name of the line with the effect of the two seeds, relative to the means over seeds."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Side:
    """One of two runs.

    Attributes:
        name: Name of the run.
        as_logged: The metric of the log; None if the metric has no value.
        resimulated: The metric re-simulated with the run's own seed; None without a value.
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
class Change(Sized):
    """A group of settings that differ, with its contribution to the difference of the metric.

    Attributes:
        name: Name of the group: `gains`, `queue`, `goal`, or the key of a setting.
        keys: Keys of the settings that differ; `seed` for the effect of the seeds.
        first: Values in the first run; None for a key that the run does not have.
        second: Values in the second run.
        contribution: Contribution to the difference, in the metric's unit; None if it is withheld.
        standard_error: Standard error of the contribution, if it is a mean over seeds or sampled
            orders, or depends on identified values.
        low: Lower end of the contribution's 95 % interval; None if the contribution is exact.
        high: Upper end of the interval.
        undone: The metric of the second run if only this group is as in the first run, if any.
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
        first: Contribution in the first run, in the metric's unit; 0 without the effect.
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
        is_wide: Whether the range exceeds half of the difference, which depends on single samples.
    """

    count: int
    within_rad: float
    difference: tuple[float, float]
    first: tuple[float, float]
    second: tuple[float, float]
    is_wide: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class DividedDifference:
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
        idle: Keys that differ (for robots, beyond their intervals) but never change the metric.
        unexplained: Part of the difference that neither the models of two robots nor the
            contributions explain; None if no robots are identified.
        withheld: Reason why there are no contributions, in one clause.
        together: Parts that several groups add only if all of these groups are changed.
        without_value: Smallest sets of changes that leave the metric without a value.
        with_value: Smallest sets of changes that give the metric a value, if the first lacks one.
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
        object.__setattr__(self, "sentences", ())

    def __repr__(self) -> str:
        first, second = self.first.name, self.second.name
        return fit_line(f"<ExplainedDifference of {first} and {second}: {self.metric}>")
