"""How values become colours: a ramp with its bar, classes of verdicts, hatches of what has none."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from matplotlib.colors import Colormap, ListedColormap, LogNorm, Normalize
from numpy.typing import NDArray

from turtlelog.show.palette import choose_run_colors
from turtlelog.sweep.swept_results import SweptMetric

Values = NDArray[np.float64]

_SHADES: Final = 256

_DECADES: Final = 100.0
"""Largest over least value from which colours are logarithmic: on a linear scale all of the lower
decade would share 3 of 256 shades."""

_OUTLYING: Final = 10.0
"""Beyond the central nine tenths by more than so many times their range, values share the last
colour, which the bar shows by its pointed end: otherwise they leave all others less than a tenth of
the colours."""

VERDICT_COLORS: Final = ("#e8a28f", "#d9d9d9", "#9ac7e0")
"""Unstable, between, stable: apart in lightness too, and light enough for theory's lines."""

VERDICT_WORDS: Final = ("not stable", "stable for some seeds", "stable")

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
    known = values[np.isfinite(values)]
    ramp = [tuple(part / 255.0 for part in color) for color in choose_run_colors(_SHADES)]
    colors = ListedColormap(ramp, name="turtlelog")
    if not len(known):
        return ColorScale(norm=Normalize(0.0, 1.0), colors=colors, extend="neither")
    low, high = float(known.min()), float(known.max())
    if low > 0.0 and high / low >= _DECADES:
        return ColorScale(norm=LogNorm(low, high), colors=colors, extend="neither")
    inner_low, inner_high = (float(one) for one in np.quantile(known, [0.05, 0.95]))
    room = _OUTLYING * (inner_high - inner_low)
    is_below, is_above = 0.0 < room < inner_low - low, 0.0 < room < high - inner_high
    low, high = inner_low if is_below else low, inner_high if is_above else high
    extend = {(True, True): "both", (True, False): "min", (False, True): "max"}
    if low == high:  # one colour, in the middle of a bar that names the value
        spread = abs(low) * 1e-3 or 1e-3
        low, high = low - spread, high + spread
    return ColorScale(
        norm=Normalize(low, high),
        colors=colors,
        extend=extend.get((is_below, is_above), "neither"),
    )


def find_verdict_classes(values: Values) -> Values:
    """Return 0 for not stable, 1 for in between, 2 for stable; NaN stays."""
    return np.where(values >= 1.0, 2.0, np.where(values <= 0.0, 0.0, values * 0.0 + 1.0))


def label_metric(metric: SweptMetric) -> str:
    """Return a metric's name with its unit, angles in degrees."""
    unit = "deg" if metric.unit == "rad" else metric.unit
    return metric.name + (f" [{unit}]" if unit not in {"", "1"} else "")


def scale_values(metric: SweptMetric, values: Values) -> Values:
    """Return values in the unit in which they are shown."""
    return np.degrees(values) if metric.unit == "rad" else values


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
