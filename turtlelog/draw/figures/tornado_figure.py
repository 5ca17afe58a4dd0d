"""Tornados: how far each key of a sweep moves a metric, the furthest on top."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from turtlelog.charts.map_values import label_metric, scale_values
from turtlelog.draw.figures.page import REFERENCE, choose_colors
from turtlelog.sweep.sensitivities import Sensitivities, Sensitivity

_MOST_KEYS: Final = 12
"""Bars of a panel: each has 4 mm of a column."""

_NO_VALUE: Final = "#a03020"

_THIN: Final = 0.01
"""Of the widest bar: one of less looks like none, and its ends are told."""

_ROOM_FOR_WORDS: Final = 0.9
"""Of what the bars span, to the right of them."""

_HEIGHT: Final = 0.62


def draw_tornado(axes: Axes, found: Sensitivities) -> None:
    """Draw a bar for each key: the metric's range along it, or its rank correlation."""
    keys = found.keys[:_MOST_KEYS]
    title = label_metric(found.metric) if found.chance is None else found.metric.name
    axes.set_title(title, loc="right")  # beside long names of keys there is no room on both sides
    axes.grid(visible=False, axis="y")
    axes.set_yticks(range(len(keys)), labels=[_name(one) for one in keys])
    axes.set_ylim(max(len(keys), 1) - 0.4, -0.6)
    if not any(one.size for one in keys):
        is_still = found.chance is None and any(one.least is not None for one in keys)
        text = "no key moves it" if is_still else "no value to compare"
        axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", fontsize=7.0, color="0.4")
    if found.chance is None:
        _draw_ranges(axes, found, keys)
    else:
        _draw_correlations(axes, found, keys)


def _name(one: Sensitivity) -> str:
    """Return a key, and below it its values where the metric is least and greatest."""
    name = one.axis.name.replace(", ", ",\n")
    if one.least_place is not None and one.most_place is not None:
        ends = (one.axis.tell_place(place) for place in (one.least_place, one.most_place))
        unit = f" {one.axis.unit}" if one.axis.unit else ""
        name += f"\n{' to '.join(ends)}{unit}" if one.size else "\nmakes no difference"
    return name.replace("$", r"\$")


def _draw_ranges(axes: Axes, found: Sensitivities, keys: Sequence[Sensitivity]) -> None:
    (color,) = choose_colors(1)
    sizes = [one.most - one.least for one in keys if one.least is not None and one.most is not None]
    widest = _scale(found, max(sizes, default=0.0))
    ends = [] if found.center is None else [_scale(found, found.center)]
    for number, one in enumerate(keys):
        if one.least is None or one.most is None:
            continue
        low, high = _scale(found, one.least), _scale(found, one.most)
        axes.barh(number, high - low, _HEIGHT, left=low, color=color, alpha=0.8)
        if one.left_out:
            # What has no value, such as a loop that never settles, may be the largest effect.
            told = f" {one.left_out} of {len(one.axis)} values: no value"
            axes.text(high, number, told, fontsize=6.2, va="center", color=_NO_VALUE)
        elif high - low < _THIN * widest:
            told = f" {low:.3g} to {high:.3g}"
            axes.text(high, number, told, fontsize=6.2, va="center", color="0.25")
        ends += [low, high]
    if found.center is not None:
        axes.axvline(_scale(found, found.center), **REFERENCE)
    if ends:
        room = 0.05 * (max(ends) - min(ends)) or 0.05 * abs(ends[0]) or 1.0
        axes.set_xlim(min(ends) - room, max(ends) + room)
        if any(one.left_out for one in keys):
            axes.set_xlim(right=max(ends) + _ROOM_FOR_WORDS * (max(ends) - min(ends)))
    axes.xaxis.set_major_locator(MaxNLocator(4))


def _scale(found: Sensitivities, value: float) -> float:
    return float(scale_values(found.metric, np.array(value)))


def _draw_correlations(axes: Axes, found: Sensitivities, keys: Sequence[Sensitivity]) -> None:
    positive, negative = choose_colors(2)
    if found.chance is not None:
        axes.axvspan(-found.chance, found.chance, color="0.92", linewidth=0.0, zorder=0.5)
    for number, one in enumerate(keys):
        value = one.correlation or 0.0
        color = positive if value >= 0.0 else negative
        axes.barh(number, value, _HEIGHT, color=color, zorder=2.0)
        ha = "left" if value >= 0.0 else "right"
        axes.text(value, number, f" {value:.2f} ", fontsize=6.2, ha=ha, va="center", color="0.25")
    axes.axvline(0.0, **REFERENCE)
    axes.set_xlim(-1.35, 1.35)
    share = (
        "" if found.explained is None else f";\nall together explain {100 * found.explained:.0f} %"
    )
    axes.set_xlabel(f"rank correlation, {found.rows} rows{share}", fontsize=7.0)
