"""Waterfalls: an attribution, or the difference of two runs, as steps between two values."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Literal

from turtlelog.charts import palette
from turtlelog.display import join_words
from turtlelog.explain import Attribution, Contribution, ExplainedDifference, choose_leading
from turtlelog.explain.answers import SEED, THIS_SEED

_SAME: Final = 1e-6
"""Share of the largest value below which a step counts as 0: two platforms differ by less."""

_DIGITS: Final = 4
"""Number of digits of the largest value. All values have as many decimals, so that they add up."""

_MOST_PERCENT: Final = 1000.0
"""Largest part of a value that is printed [%]. Near 0, larger parts mean nothing."""

_MOST_NAMED: Final = 2  # causes that the last bar names; more would be wider than the picture


@dataclass(frozen=True, slots=True, kw_only=True)
class AttributionStep:
    """A bar of the waterfall: the logged value, a contribution, or a value without causes."""

    # `left`: without all causes; `apart`: without one other cause, which changes the value more
    kind: Literal["total", "contribution", "left", "apart"]
    cause: str = ""  # name of the cause; empty for total, left, and a step without a cause
    start: float = 0.0  # start of the bar, in the metric's unit: 0, or the end of the previous step
    end: float  # end of the bar
    name: str  # label next to the bar, in a word or two
    text: str  # size in words, with its part of the logged value
    color: palette.Color  # of the run for the total, of the ghost for the value without all causes


@dataclass(frozen=True, slots=True, kw_only=True)
class StepScale:
    """Unit in which an attribution is drawn."""

    factor: float  # factor from the metric's unit
    unit: str  # unit on the axis: `mm` for a metric in m that stays below 1 m; empty for a number
    decimals: int  # number of decimals of the values

    def format_value(self, value: float, *, signed: bool = False) -> str:
        """Return a value of the metric as text. A nonzero value never becomes a plain 0."""
        scaled = value * self.factor
        sign = "+" if signed else ""
        text = f"{scaled:{sign}.{self.decimals}f}"
        if not float(text):
            text = f"{scaled:{sign}.1g}" if scaled else "0"
        return f"{text} {self.unit}".strip()


@dataclass(frozen=True, slots=True, kw_only=True)
class Waterfall:
    """Bars below each other; each bar starts where the bar above it ends."""

    steps: tuple[AttributionStep, ...]  # bars; names on the left, sizes in words on the right
    scale: StepScale  # unit in which the bars are drawn
    metric: str  # metric of the total
    notes: tuple[str, ...]  # notes for the reader, one line each, below the axis

    @property
    def joints(self) -> tuple[float, ...]:
        """Values at which lines join neighbouring bars, in the metric's unit."""
        return tuple(one.end for one, below in pairwise(self.steps) if below.kind != "apart")

    @property
    def span(self) -> tuple[float, float]:
        """Range of the bars in the metric's unit, including 0."""
        ends = [value for step in self.steps for value in (step.start, step.end)]
        return min(0.0, *ends), max(0.0, *ends)

    @property
    def label(self) -> str:
        """Name of the metric with the drawn unit."""
        return label_metric(self.metric, self.scale.unit)


def label_metric(metric: str, unit: str) -> str:
    """Return the label of an axis for a metric, with the drawn unit."""
    words = metric.replace("_", " ").replace("final.", "final ").replace("run.", "")
    return words.replace(".", " ") + (f" [{unit}]" if unit else "")


def choose_unit(largest: float, unit: str) -> tuple[float, str]:
    """Return the factor and the unit to draw values up to a size: mm below 1 m."""
    return (1e3, "mm") if unit == "m" and largest < 1.0 else (1.0, "" if unit == "1" else unit)


def draw_up_attribution(found: Attribution) -> Waterfall:
    """Return the waterfall of an attribution, without steps if contributions are withheld."""
    # If only one cause acts, its contribution is the effect of its removal.
    is_average = len(choose_acting_contributions(found)) > 1
    seeds = 0 if found.seeds is None else found.seeds.used
    return Waterfall(
        steps=list_attribution_steps(found),
        scale=choose_step_scale(found),
        metric=found.metric,
        notes=_note_averages("removal", seeds, is_average=is_average),
    )


def _note_averages(orders: str, seeds: int, *, is_average: bool) -> tuple[str, ...]:
    """Return a note that bars are averages, over orders and over a number of seeds."""
    notes = [f"bars: averages over the orders of {orders}; no run ends between them"]
    notes = notes if is_average else []
    return (*notes, f"contributions: means over {seeds} seeds") if seeds > 1 else tuple(notes)


def list_attribution_steps(found: Attribution) -> tuple[AttributionStep, ...]:
    """Return the steps from the logged value to the remainder without all causes.

    Between these two is a step for each cause that changes the value, the largest contribution
    first. A difference between log and re-simulation, or between one seed and the mean over seeds,
    is a separate step. The value without a design parameter that changes it more than all effects
    is last. If the contributions are withheld, there are no steps.
    """
    left = found.without_all
    total = found.resimulated if found.as_logged is None else found.as_logged
    if found.withheld or total is None or left is None:
        return ()
    scale = choose_step_scale(found)
    name = "as simulated" if found.as_logged is None else "as recorded"
    text = f"{scale.format_value(total)}{_explain_little(found, total)}"
    first = AttributionStep(kind="total", end=total, name=name, text=text, color=palette.MAIN)
    steps = [first, *_list_contributions(found, total, scale)]
    acting = [one.cause for one in choose_acting_contributions(found)]
    reason = _explain_little(found, left)
    if not reason and acting:
        few = join_words(acting) if len(acting) <= _MOST_NAMED else "all of these"
        reason = f", without {few}"
    part = _tell_part(left, total) if len(steps) > 1 else ""
    text = f"{scale.format_value(left)}{part}{reason or ', no effect changes it'}"
    step = AttributionStep(kind="left", end=left, name="left", text=text, color=palette.GHOST)
    steps.append(step)
    leading = choose_leading(found)
    colors = palette.choose_cause_colors([*found.causes, *(one.cause for one in leading)])
    for one in leading:
        value = one.alone or 0.0
        kind = "an effect apart" if one.cause in found.effects else "a design parameter"
        step = AttributionStep(
            kind="apart",
            cause=one.cause,
            end=value,
            name=f"without {one.cause}",
            text=f"{scale.format_value(value)}{_tell_part(value, total)}, {kind}",
            color=colors[one.cause],
        )
        steps.append(step)
    return tuple(steps)


def choose_step_scale(found: Attribution) -> StepScale:
    """Return the unit and the decimals for all values of an attribution."""
    values = (found.as_logged, found.resimulated, found.without_all, found.divided)
    return _choose_scale(values, found.unit)


def _choose_scale(values: Sequence[float | None], unit: str) -> StepScale:
    """Return the unit and the decimals for drawing values that have a metric's unit."""
    largest = max(abs(value) for value in (*values, 0.0) if value is not None)
    factor, unit = choose_unit(largest, unit)
    digits = _DIGITS - 1 - (math.floor(math.log10(largest * factor)) if largest else 0)
    return StepScale(factor=factor, unit=unit, decimals=min(max(digits, 0), 9))


def _list_contributions(
    found: Attribution, total: float, scale: StepScale
) -> Iterator[AttributionStep]:
    largest = max(abs(total), abs(found.divided))
    if abs(total - found.divided) > _SAME * largest:
        is_seed = found.seeds is not None
        differs = scale.format_value(total - found.divided, signed=True)
        yield AttributionStep(
            kind="contribution",
            start=total,
            end=found.divided,
            name=THIS_SEED if is_seed else "log only",
            text=f"{differs}, {'beside the mean over seeds' if is_seed else 'not re-simulated'}",
            color=palette.REFERENCE,
        )
    at = found.divided
    acting = choose_acting_contributions(found)
    colors = palette.choose_cause_colors(found.causes)
    for one in acting:
        value = one.contribution or 0.0
        size = _tell_size(value, one.standard_error, scale)
        chance = "" if one.is_clear else ", may be chance"
        yield AttributionStep(
            kind="contribution",
            cause=one.cause,
            start=at,
            end=at - value,
            name=one.cause,
            text=f"{size}{_tell_part(value, total)}{chance}",
            color=colors[one.cause],
        )
        at -= value


def choose_acting_contributions(found: Attribution) -> Sequence[Contribution]:
    """Return the contributions that are not 0, the largest first."""
    least = _SAME * max(abs(found.divided), abs(found.without_all or 0.0))
    acting = [one for one in found.contributions if abs(one.contribution or 0.0) > least]
    return sorted(acting, key=lambda one: -abs(one.contribution or 0.0))


def _tell_size(value: float, standard_error: float | None, scale: StepScale) -> str:
    size = scale.format_value(value, signed=True)
    if standard_error is not None:
        size += f" ± {abs(standard_error * scale.factor):.2g}"
    return size


def _tell_part(value: float, total: float) -> str:
    """Return the part of the logged value in brackets; empty if it is not meaningful."""
    percent = 100.0 * value / total if total else math.inf
    return f" ({percent:.0f} %)" if abs(percent) < _MOST_PERCENT else ""


def _explain_little(found: Attribution, value: float) -> str:
    """Return a sentence that the tolerances allow the remainder, for a bounded final error."""
    if found.metric not in {"final.position_error", "final.heading_error"}:
        return ""
    if abs(value) > found.resolution.size or not found.resolution.is_tolerance:
        return ""
    return ", no more than the tolerances leave"


def draw_up_difference(found: ExplainedDifference) -> Waterfall:
    """Return the waterfall of a difference, without steps if contributions are withheld."""
    steps = list_difference_steps(found)
    return Waterfall(
        steps=steps,
        scale=_choose_scale([found.first.resimulated, found.second.resimulated], found.unit),
        metric=found.metric,
        notes=_note_averages("the changes", found.seeds, is_average=len(steps) > 3),
    )


def list_difference_steps(found: ExplainedDifference) -> tuple[AttributionStep, ...]:
    """Return the steps from the value of the first run to that of the second.

    Between these two is a step for each change with its contribution, the largest first. If the
    contributions are withheld, there are no steps.
    """
    first, second = found.first.resimulated, found.second.resimulated
    if not found.contributions or first is None or second is None:
        return ()
    scale = _choose_scale([found.first.resimulated, found.second.resimulated], found.unit)
    colors = palette.choose_cause_colors([one.name for one in found.contributions])
    sides = zip(
        (found.first, found.second), palette.choose_run_colors(2), (first, second), strict=True
    )
    begin, end = (
        AttributionStep(
            kind="total", end=value, name=side.name, text=scale.format_value(value), color=color
        )
        for side, color, value in sides
    )
    steps, at = [begin], first
    for one in found.contributions:
        change = one.contribution or 0.0
        step = AttributionStep(
            kind="contribution",
            cause=one.name,
            start=at,
            end=at + change,
            name=one.name,
            text=_tell_size(change, one.standard_error, scale),
            color=palette.REFERENCE if one.name == SEED else colors[one.name],
        )
        steps.append(step)
        at = step.end
    return (*steps, end)
