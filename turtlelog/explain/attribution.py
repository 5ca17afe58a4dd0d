"""The data of an attribution: values, contributions, and their conditions."""

import math
from dataclasses import dataclass, field
from html import escape
from typing import Final

from turtlelog.display import fit_line, format_html, format_notebook
from turtlelog.measure import list_metrics
from turtlelog.run.angles import wrap_angle
from turtlelog.run.goal_end import allow_position
from turtlelog.run.loops import Declaration
from turtlelog.scenario import DEFAULT_LAW, Scenario

SAME: Final = 1e-6
"""Share of a value below which a difference counts as 0: two platforms differ by less."""

_SHARE: Final = 0.01
"""Share of a value that is negligible if neither a tolerance nor a clock bounds it. A phase of the
paper's runs has at least a hundred samples, so this is about one sample's effect on an integral."""

_ROUNDING: Final = 1e-12
"""Share of a value by which sums in another order may differ."""

_HALF_A_COUNT: Final = 0.5
"""Negligible change of a count; counts change by at least one."""

_COUNTS: Final = (
    *("crossings", "reversals", "burst_samples", "dropped_samples", "duplicates", "disorder"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Resolution:
    """The largest change of a metric that is negligible.

    Attributes:
        size: Size of the change, in the metric's unit.
        reason: Origin of a change of this size, in one clause.
    """

    size: float
    reason: str


def find_resolution(
    scenario: Scenario, declaration: Declaration, metric: str, value: float
) -> Resolution:
    """Return the resolution of a metric of a scenario, for unknown tolerances from its value."""
    unit = list_metrics(declaration)[metric].unit
    if unit == "s":
        return Resolution(size=find_sample_period_s(scenario), reason="one sample period")
    if scenario.law.kind == DEFAULT_LAW and unit in {"m", "deg", "%"}:
        return _find_tolerated(scenario, declaration, metric, unit)
    kind = metric.rpartition(".")[2]
    if kind.removeprefix("speed_").removeprefix("turn_rate_") in _COUNTS:
        return Resolution(size=_HALF_A_COUNT, reason="half a count")
    return Resolution(size=_SHARE * abs(value), reason=f"{100.0 * _SHARE:g} % of the value")


def find_sample_period_s(scenario: Scenario) -> float:
    """Return the usual time between two answers [s]."""
    loop = scenario.loop
    period_s: float = loop.period_s or loop.period_ticks * scenario.plant.facts.period_s
    return period_s


def _find_tolerated(
    scenario: Scenario, declaration: Declaration, metric: str, unit: str
) -> Resolution:
    """Return the errors that the tolerances of the sequential law allow."""
    heading_rad = scenario.law.parameters.heading_tolerance_rad
    position_m = scenario.law.parameters.position_tolerance_m
    distance_m, turn_rad = _find_steps(scenario)
    if unit == "m":
        reach = "heading tolerance times distance plus position tolerance"
        return Resolution(size=allow_position(heading_rad, position_m, distance_m), reason=reach)
    if unit == "deg":
        return Resolution(size=math.degrees(heading_rad), reason="the heading tolerance")
    loop = declaration.find_loop(metric.rpartition(".")[0])
    turns = loop is not None and loop.signal == "heading"
    tolerance, step = (heading_rad, turn_rad) if turns else (position_m, distance_m)
    return Resolution(size=100.0 * tolerance / step, reason="the tolerance over the step")


def _find_steps(scenario: Scenario) -> tuple[float, float]:
    """Return the distance to the goal [m] and the turn towards the goal [rad]; never 0."""
    start, goal = scenario.start, scenario.goal
    x_m, y_m = goal.x_m - start.x_m, goal.y_m - start.y_m
    turn_rad = math.atan2(y_m, x_m) - start.heading_rad
    if scenario.law.parameters.wrap_error:
        turn_rad = wrap_angle(turn_rad)
    return max(math.hypot(x_m, y_m), math.ulp(1.0)), max(abs(turn_rad), math.ulp(1.0))


_CLEAR: Final = 3.0
"""Number of standard errors from which a mean differs from 0. By Student's t with 31 degrees of
freedom, a contribution that is 0 seems to differ in 1 of 190 runs. For six such contributions, this
is 3 % of runs."""

THIS_SEED: Final = "this seed"
"""Name of the line with the effect of the run's own seed, which the contributions do not
contain."""

THIS_SEED_MEANS: Final = "the value of its own seed, less the mean over seeds"


def is_clear(value: float, standard_error: float | None) -> bool:
    """Return whether a mean over seeds differs from 0 significantly."""
    return abs(value) > _CLEAR * (standard_error or 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Contribution:
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

    @property
    def is_clear(self) -> bool:
        """Whether the contribution differs from 0 significantly over seeds."""
        return is_clear(self.contribution or 0.0, self.standard_error)


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
        reason: Reason why the metric has no value; None if it has a value.
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
        used: Seeds with which every combination of causes has a value; the contributions use only
            these seeds.
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
class Attribution:
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
            `compute_contributions`. With random effects the contributions are means over seeds, and
            `this_seed` is the difference.
        others: Other causes in the scenario, each removed alone.
        resolution: Largest change that is negligible.
        withheld: Reason why there are no contributions, in one clause; None if there are
            contributions.
        together: Parts that several causes add only together.
        without_value: Smallest sets of causes that leave the metric without a value.
        with_value: Smallest sets of causes that give the metric a value, if it has no value without
            all causes.
        starts: Range of the value over starts within the turn of one sample. None if the robot does
            not turn, or with random effects.
        seeds: Range of the value over seeds; None without random effects.
        reason: Reason why there is no value in the log, or else in the re-simulation; None if there
            is a value.
        doubts: Assumptions of the contributions that the log does not prove, in sentences.
        left: Effects that stay as recorded, because more than six are present.
        effects: Every effect that loop and law can have, in the scenario or not.
        remarks: Causes that could not be removed, in sentences.
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
        """Write the sentences."""
        from turtlelog.explain.answer_words import write_sentences

        this_seed = None
        if self.seeds is not None and self.resimulated is not None:
            this_seed = self.resimulated - self.seeds.mean
        object.__setattr__(self, "this_seed", this_seed)
        object.__setattr__(self, "sentences", write_sentences(self))

    @property
    def acting(self) -> tuple[str, ...]:
        """Causes that change the value in any combination."""
        names = {one.cause for one in self.contributions if one.contribution}
        names.update(name for case in self.together if case.value for name in case.causes)
        return tuple(name for name in self.causes if name in names)

    @property
    def changing(self) -> tuple[Contribution, ...]:
        """Contributions and other causes that change the value or the ending of the run."""
        return tuple(one for one in (*self.contributions, *self.others) if self._changes(one))

    def _changes(self, one: Contribution) -> bool:
        least = _ROUNDING * abs(self.divided)
        sizes = (one.contribution or 0.0, one.standard_error or 0.0)
        moves = one.alone is not None and abs(one.alone - self.divided) > least
        return bool(one.ending) or moves or any(abs(size) > least for size in sizes)

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

    def _repr_html_(self) -> str:
        from turtlelog.explain.answer_words import write_headline

        unit = self.unit
        heads = ["cause", f"contribution [{unit}]", f"without it alone [{unit}]", "means"]
        rows: list[list[object]] = [
            [one.cause, one.contribution, one.alone, one.ending or one.meaning]
            for one in self.changing
        ]
        if self.seeds is not None:
            heads.insert(2, f"s.e. [{unit}]")
            for row, one in zip(rows, self.changing, strict=True):
                row.insert(2, one.standard_error)
            if self.contributions and self.seeds.varies:
                row = [THIS_SEED, self.this_seed, None, None, THIS_SEED_MEANS]
                rows.insert(sum(one.contribution is not None for one in self.changing), row)
        table = format_html(rows, heads=heads)
        rest = [f"<p>{escape(text)}</p>" for text in self.sentences[1:]]
        return format_notebook(write_headline(self), table, *rest)


def choose_metric(declaration: Declaration) -> str:
    """Return the default metric to explain: the most important one for the run's law.

    With a goal, the metric is the final position error. Without a goal, it is the rms error of the
    last declared loop; for a law that tracks a path, the cross-track error; without loops, the path
    length.
    """
    if declaration.uses_goal:
        return "final.position_error"
    loops = [loop.name for loop in declaration.loops]
    return f"{loops[-1]}.rms_error" if loops else "run.path_length"
