"""What an attribution says: values, shares, and what they hang on."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from html import escape
from typing import Final

from turtlelog.angles import wrap_angle
from turtlelog.compare.ranking import allow_position
from turtlelog.display import format_html
from turtlelog.loops import Declaration
from turtlelog.measure import list_metrics
from turtlelog.scenario import DEFAULT_LAW, Scenario

_SHARE: Final = 0.01
"""Of a value that no tolerance and no clock bounds. A phase of the paper's runs has a hundred
samples and more: about what one of them makes of an integral over it."""

_ROUNDING: Final = 1e-12
"""Of a value: sums of doubles in another order differ by less."""

_HALF_A_COUNT: Final = 0.5
"""Counts change by one at least."""

_COUNTS: Final = (
    "crossings",
    "reversals",
    "burst_samples",
    "dropped_samples",
    "duplicates",
    "disorder",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Grain:
    """The largest change of a metric that is next to nothing.

    Attributes:
        size: In the metric's unit.
        reason: What makes a change of this size, in one clause.
    """

    size: float
    reason: str


def find_grain(scenario: Scenario, declaration: Declaration, metric: str, value: float) -> Grain:
    """Return the grain of a metric of a scenario, where it has this value.

    Of a law whose tolerances are not known a share of the value stands for what they leave.
    """
    unit = list_metrics(declaration)[metric].unit
    if unit == "s":
        return Grain(size=find_sample_period_s(scenario), reason="one sample period")
    if scenario.law.kind == DEFAULT_LAW and unit in {"m", "deg", "%"}:
        return _find_tolerated(scenario, declaration, metric, unit)
    kind = metric.rpartition(".")[2]
    if kind.removeprefix("speed_").removeprefix("turn_rate_") in _COUNTS:
        return Grain(size=_HALF_A_COUNT, reason="half a count")
    return Grain(size=_SHARE * abs(value), reason=f"{100.0 * _SHARE:g} % of the value")


def find_sample_period_s(scenario: Scenario) -> float:
    """Return the usual time between two answers [s]."""
    loop = scenario.loop
    period_s: float = loop.period_s or loop.period_ticks * scenario.plant.facts.period_s
    return period_s


def _find_tolerated(scenario: Scenario, declaration: Declaration, metric: str, unit: str) -> Grain:
    """Return what the tolerances of the sequential law leave."""
    heading_rad = scenario.law.parameters.heading_tolerance_rad
    position_m = scenario.law.parameters.position_tolerance_m
    distance_m, turn_rad = _find_steps(scenario)
    if unit == "m":
        reach = "heading tolerance times distance plus position tolerance"
        return Grain(size=allow_position(heading_rad, position_m, distance_m), reason=reach)
    if unit == "deg":
        return Grain(size=math.degrees(heading_rad), reason="the heading tolerance")
    loop = declaration.find_loop(metric.rpartition(".")[0])
    turns = loop is not None and loop.signal == "heading"
    tolerance, step = (heading_rad, turn_rad) if turns else (position_m, distance_m)
    return Grain(size=100.0 * tolerance / step, reason="the tolerance over the step")


def _find_steps(scenario: Scenario) -> tuple[float, float]:
    """Return how far away the goal is [m], and how far the robot turns to it [rad]; never 0."""
    start, goal = scenario.start, scenario.goal
    x_m, y_m = goal.x_m - start.x_m, goal.y_m - start.y_m
    turn_rad = math.atan2(y_m, x_m) - start.heading_rad
    if scenario.law.parameters.wrap_error:
        turn_rad = wrap_angle(turn_rad)
    return max(math.hypot(x_m, y_m), math.ulp(1.0)), max(abs(turn_rad), math.ulp(1.0))


_CLEAR: Final = 3.0
"""Standard errors: of six shares that are 0, one seems to be more in 3 % of runs (with Student's t
of 31 degrees of freedom, each in 1 of 190)."""

THIS_SEED: Final = "this seed"
"""The line of what the shares do not hold."""

THIS_SEED_MEANS: Final = "the value of its own seed, less the mean over seeds"


def is_clear(value: float, standard_error: float | None) -> bool:
    """Return whether a mean over seeds differs from 0 by more than they do."""
    return abs(value) > _CLEAR * (standard_error or 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Share:
    """The part of one mechanism.

    Attributes:
        mechanism: Its name.
        share: Its Shapley share of as_built - without_all, in the metric's unit; negative where it
            makes the value smaller. None where it takes no part. With random effects the mean of
            its shares over seeds.
        alone: The metric with this mechanism out and all others in; None where it has no value.
            With random effects its mean over seeds.
        ending: What differs in kind without it, in one clause: a phase that no longer ends, or why
            there is no value. Empty where the run passes the same phases.
        meaning: What taking it out means, in one clause.
        standard_error: With random effects that of the share; where it takes no part, that of the
            change without it. None otherwise.
    """

    mechanism: str
    share: float | None
    alone: float | None
    ending: str = ""
    meaning: str
    standard_error: float | None = None

    @property
    def is_clear(self) -> bool:
        """Whether it differs from 0 by more than its seeds do."""
        return is_clear(self.share or 0.0, self.standard_error)


@dataclass(frozen=True, slots=True, kw_only=True)
class Together:
    """What several mechanisms make only when all of them act.

    Attributes:
        mechanisms: At least two.
        value: What they add beyond all that fewer of them add, in the metric's unit; their shares
            hold it in equal parts.
        standard_error: With random effects; None otherwise.
    """

    mechanisms: tuple[str, ...]
    value: float
    standard_error: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ValueSet:
    """A smallest set of mechanisms that gives the metric a value, or leaves it without one.

    Attributes:
        mechanisms: Those that are in; all others that take part are out.
        reason: Why there is no value; empty where there is.
    """

    mechanisms: tuple[str, ...]
    reason: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class StartRange:
    """A value over starts that one sample's turn spans.

    Attributes:
        count: How many starts, at equal distances; the scenario's own is in the middle.
        within_rad: How far the first and the last are turned from the scenario's own [rad].
        low: The smallest value, in the metric's unit.
        high: The largest value.
        without_value: How many starts have none.
        is_wide: Whether the value hangs on single samples: where the effects add more than the
            grain, whether both its range and that of what they add exceed half of it.
        parts: Where it is wide, the lowest and highest part of a mechanism in what those that
            change the value add together; 1 is all of it. Empty where they do not all add to it at
            every start, or where it takes too many simulations.
    """

    count: int
    within_rad: float
    low: float
    high: float
    without_value: int
    is_wide: bool
    parts: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class SeedRange:
    """A value over seeds.

    Attributes:
        count: Seeds that were simulated.
        used: Those with which every combination of mechanisms has a value: the shares are theirs.
        mean: Of the value as built, over those.
        standard_error: Of that mean.
        low: From here to `high` lie the central 95 % of the values as built.
        high: See `low`.
    """

    count: int
    used: int
    mean: float
    standard_error: float
    low: float
    high: float

    @property
    def varies(self) -> bool:
        """Whether seeds differ in the value by more than rounding."""
        return self.high - self.low > _ROUNDING * max(abs(self.low), abs(self.high))


@dataclass(frozen=True, slots=True, kw_only=True)
class Attribution:
    """What caused a value.

    Attributes:
        metric: Its id.
        unit: Its unit.
        as_logged: The log's own value; None where it has none, or where there is no log.
        as_built: Re-simulated, with all mechanisms in; None where it has no value.
        without_all: Re-simulated, with all that take part out; None where it has no value. Where
            what is left is random, the mean over seeds.
        mechanisms: Those that take part: the value is divided among them.
        shares: Theirs, in their order; none where they are withheld. `math.fsum` of them is
            as_built - without_all: see `compute_shares`. With random effects they are means over
            seeds, and `this_seed` is what is missing.
        others: What else is in the scenario, each taken out alone.
        grain: The largest change that is next to nothing.
        withheld: Why there are no shares, in one clause; empty where there are.
        together: What several mechanisms make only together.
        without_value: The smallest sets of mechanisms that leave the metric without a value.
        with_value: The smallest sets that give it one, where it has none without all.
        starts: The value over starts within one sample's turn; None where the robot does not turn,
            and with random effects.
        seeds: The value over seeds; None without random effects.
        reason: Why it has no value, in the log or else re-simulated; empty where it has.
        doubts: What the shares rest on that the log does not prove, in whole sentences.
        left: Mechanisms that were to take part and stay as built, being more than six.
        effects: Every effect that loop and law may have, whether it is in the scenario or not.
        remarks: What could not be taken out, in whole sentences.
    """

    metric: str
    unit: str
    as_logged: float | None = None
    as_built: float | None
    without_all: float | None
    mechanisms: tuple[str, ...]
    shares: tuple[Share, ...]
    others: tuple[Share, ...]
    grain: Grain
    withheld: str = ""
    together: tuple[Together, ...] = ()
    without_value: tuple[ValueSet, ...] = ()
    with_value: tuple[ValueSet, ...] = ()
    starts: StartRange | None = None
    seeds: SeedRange | None = None
    reason: str = ""
    doubts: tuple[str, ...] = ()
    left: tuple[str, ...] = ()
    effects: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def acting(self) -> tuple[str, ...]:
        """Those that change the value in any combination."""
        names = {share.mechanism for share in self.shares if share.share}
        names.update(name for case in self.together if case.value for name in case.mechanisms)
        return tuple(name for name in self.mechanisms if name in names)

    @property
    def changing(self) -> tuple[Share, ...]:
        """Of the shares and others those that say something: a change, or what is different."""
        return tuple(one for one in (*self.shares, *self.others) if self._changes(one))

    def _changes(self, one: Share) -> bool:
        least = _ROUNDING * abs(self.divided)
        sizes = (one.share or 0.0, one.standard_error or 0.0)
        moves = one.alone is not None and abs(one.alone - self.divided) > least
        return bool(one.ending) or moves or any(abs(size) > least for size in sizes)

    @property
    def this_seed(self) -> float | None:
        """What the run's own seed makes of it: as built less the mean over seeds."""
        if self.seeds is None or self.as_built is None:
            return None
        return self.as_built - self.seeds.mean

    @property
    def divided(self) -> float:
        """What the shares and `without_all` add up to: as built, with random effects in the mean.

        0 where there is no value.
        """
        return (self.as_built or 0.0) if self.seeds is None else self.seeds.mean

    def __repr__(self) -> str:
        parts = [f"{share.mechanism} {share.share:.4g}" for share in self.shares if share.share]
        is_divided = not (self.withheld or self.without_value)
        cause = (", ".join(parts) or "no effect changes it") if is_divided else "no shares"
        value = self.as_built if self.as_logged is None else self.as_logged
        size = "no value" if value is None else f"{value:.4g} {self.unit}"
        return f"<Attribution of {self.metric}: {size}: {cause}>"

    def _repr_html_(self) -> str:
        from turtlelog.explain.report import write_sentences

        heads = ["mechanism", f"share [{self.unit}]", f"without it alone [{self.unit}]", "means"]
        rows: list[list[object]] = [
            [one.mechanism, one.share, one.alone, one.ending or one.meaning]
            for one in self.changing
        ]
        if self.seeds is not None:
            heads.insert(2, f"s.e. [{self.unit}]")
            for row, one in zip(rows, self.changing, strict=True):
                row.insert(2, one.standard_error)
            if self.shares and self.seeds.varies:
                row = [THIS_SEED, self.this_seed, None, None, THIS_SEED_MEANS]
                rows.insert(sum(one.share is not None for one in self.changing), row)
        table = format_html(rows, heads=heads, title=f"What caused {self.metric}")
        return table + "".join(f"\n<p>{escape(text)}</p>" for text in write_sentences(self))
