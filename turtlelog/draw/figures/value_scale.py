"""Colours of values in a figure: a ramp for its bar, hatches of what has no value."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

from matplotlib.colors import Colormap, ListedColormap, LogNorm, Normalize

from turtlelog.charts.map_values import Values, find_value_range
from turtlelog.charts.palette import choose_shades
from turtlelog.draw.figures.page import to_rgb
from turtlelog.sweep.swept_results import SweptMetric

_SHADES: Final = 256

_HATCHES: Final = ("", "////", "....", "xxxx")
"""Of reasons for no value; the last stands for all others."""

VALUELESS: Final[Mapping[str, Any]] = MappingProxyType({"facecolor": "0.93", "edgecolor": "0.6"})


@dataclass(frozen=True, slots=True, kw_only=True)
class ColorScale:
    """Colours of the values of one metric.

    Attributes:
        norm: From values to 0 to 1.
        colors: Of those.
        extend: Which ends of the bar are pointed: `neither`, `min`, `max` or `both`.
    """

    norm: Normalize
    colors: Colormap
    extend: str


def build_scale(values: Values) -> ColorScale:
    """Return the scale of values, of which those that are NaN are left out."""
    ramp = [*map(to_rgb, choose_shades(_SHADES))]
    found = find_value_range(values)
    return ColorScale(
        norm=(LogNorm if found.is_logarithmic else Normalize)(found.low, found.high),
        colors=ListedColormap(ramp, name="turtlelog"),
        extend=found.extend,
    )


def group_reasons(metrics: Sequence[SweptMetric]) -> dict[str, tuple[str, str]]:
    """Return for each reason for no value the words of a legend and a hatch, the most usual first.

    Where there are more than hatches, the rare ones share the last.
    """
    counts = Counter(reason for one in metrics for reason in one.reasons if reason is not None)
    order = [reason for reason, _ in counts.most_common()]
    few = order if len(order) <= len(_HATCHES) else order[: len(_HATCHES) - 1]
    others = dict.fromkeys(order, ("no value: others", _HATCHES[-1]))
    words = {one: (f"no value: {one}", hatch) for one, hatch in zip(few, _HATCHES, strict=False)}
    return {**others, **words}
