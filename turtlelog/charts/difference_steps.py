"""The difference of two runs as steps from one value to the other: the bars of a waterfall."""

from turtlelog.charts import palette
from turtlelog.charts.attribution_steps import (
    AttributionStep,
    StepScale,
    Waterfall,
    choose_scale,
    note_averages,
)
from turtlelog.charts.palette import choose_cause_colors
from turtlelog.explain import Change, ExplainedDifference
from turtlelog.explain.explained_difference import SEED, Side


def draw_up_difference(found: ExplainedDifference) -> Waterfall:
    """Return the waterfall of a difference; without steps if the contributions are withheld."""
    steps = list_difference_steps(found)
    return Waterfall(
        steps=steps,
        scale=choose_difference_scale(found),
        metric=found.metric,
        notes=note_averages("the changes", found.seeds, is_average=len(steps) > 3),
    )


def list_difference_steps(found: ExplainedDifference) -> tuple[AttributionStep, ...]:
    """Return the steps from the value of the first run up or down to that of the second.

    Between them is each change with its contribution, the largest first.

    Returns:
        No steps if the contributions are withheld: the answer says why.
    """
    first, second = found.first.resimulated, found.second.resimulated
    if not found.contributions or first is None or second is None:
        return ()
    scale = choose_difference_scale(found)
    colors = choose_cause_colors([one.name for one in found.contributions])
    steps = [_make_total(found.first, scale, palette.REFERENCE)]
    at = first
    for one in found.contributions:
        end = at + (one.contribution or 0.0)
        color = palette.REFERENCE if one.name == SEED else colors[one.name]
        steps.append(
            AttributionStep(
                kind="contribution",
                cause=one.name,
                start=at,
                end=end,
                name=one.name,
                text=_describe(one, scale),
                color=color,
            )
        )
        at = end
    return (*steps, _make_total(found.second, scale, palette.MAIN))


def _make_total(side: Side, scale: StepScale, color: palette.Color) -> AttributionStep:
    value = side.resimulated or 0.0
    return AttributionStep(
        kind="total",
        start=0.0,
        end=value,
        name=side.name,
        text=scale.format_value(value),
        color=color,
    )


def choose_difference_scale(found: ExplainedDifference) -> StepScale:
    """Return the unit and the decimals of a difference's values: they are those of all of it."""
    return choose_scale([found.first.resimulated, found.second.resimulated], found.unit)


def _describe(one: Change, scale: StepScale) -> str:
    size = scale.format_value(one.contribution or 0.0, signed=True)
    if one.standard_error is not None:
        size += f" ± {abs(one.standard_error * scale.factor):.2g}"
    return size
