"""Common parts of maps of a sweep and of their report: edges of cells, ranges of values, limits."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.sweep.gain_borders import ColumnLimits
from turtlelog.sweep.table.swept_results import SweptAxis, SweptMetric

Values = NDArray[np.float64]

VERDICT_COLORS: Final = ("#e8a28f", "#d9d9d9", "#9ac7e0")
"""Colours of unstable, between and stable. The colours also differ in lightness, and are light
enough for theory's lines."""

VERDICT_WORDS: Final = ("not stable", "stable for some seeds", "stable")

DECADES: Final = 100.0
"""Ratio of largest to smallest value from which colours and axes are logarithmic. On a linear
scale, the whole lower decade would share 3 of 256 shades, or be as thin as a line."""

_OUTLYING: Final = 10.0
"""Distance from the central 90 % of values, as a multiple of their range, beyond which values share
the last colour. The bar then has a pointed end. Without this, all other values would have less than
a tenth of the colours."""

STABILITY: Final = "instability (theory)"
GROWN: Final = "instability with the most dead time (theory)"
OVERSHOOT: Final = "overshoot begins (theory)"
"""Names of theory's limits in a legend."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ValueRange:
    """Mapping of values to colours.

    Attributes:
        low: Value of the first colour.
        high: Value of the last colour; greater than `low`.
        is_logarithmic: Whether the scale is logarithmic.
        extend: Ends beyond which values exist: `neither`, `min`, `max` or `both`.
    """

    low: float
    high: float
    is_logarithmic: bool = False
    extend: str = "neither"


def find_value_range(values: Values) -> ValueRange:
    """Return the range of values without NaN."""
    known = values[np.isfinite(values)]
    if not len(known):
        return ValueRange(low=0.0, high=1.0)
    low, high = float(known.min()), float(known.max())
    if low > 0.0 and high / low >= DECADES:
        return ValueRange(low=low, high=high, is_logarithmic=True)
    inner_low, inner_high = (float(one) for one in np.quantile(known, [0.05, 0.95]))
    room = _OUTLYING * (inner_high - inner_low)
    is_below, is_above = 0.0 < room < inner_low - low, 0.0 < room < high - inner_high
    low, high = inner_low if is_below else low, inner_high if is_above else high
    if low == high:  # one colour, in the middle of a bar that shows the value
        spread = abs(low) * 1e-3 or 1e-3
        low, high = low - spread, high + spread
    extend = {(True, True): "both", (True, False): "min", (False, True): "max"}
    return ValueRange(low=low, high=high, extend=extend.get((is_below, is_above), "neither"))


def find_verdict_classes(values: Values) -> Values:
    """Return 0 for unstable, 1 for in between, 2 for stable; NaN stays NaN."""
    return np.where(values >= 1.0, 2.0, np.where(values <= 0.0, 0.0, values * 0.0 + 1.0))


def label_metric(metric: SweptMetric) -> str:
    """Return a metric's name with its unit; angles are in degrees."""
    unit = "deg" if metric.unit == "rad" else metric.unit
    return metric.name + (f" [{unit}]" if unit not in {"", "1"} else "")


def scale_values(metric: SweptMetric, values: Values) -> Values:
    """Return values in their display unit."""
    return np.degrees(values) if metric.unit == "rad" else values


def find_edges(axis: SweptAxis) -> Values:
    """Return the edges of the cells of an axis, halfway between the centres of the cells."""
    numbers = axis.numbers
    if len(numbers) == 1:
        half = abs(float(numbers[0])) * 0.1 or 0.5
        return np.array([numbers[0] - half, numbers[0] + half])
    if is_logarithmic(axis):
        return np.exp(_find_middles(np.log(numbers)))
    return _find_middles(numbers)


def is_logarithmic(axis: SweptAxis) -> bool:
    """Return whether the numbers of an axis have equal ratios rather than equal differences."""
    numbers = axis.numbers
    if not axis.is_number or len(numbers) < 3 or numbers[0] <= 0.0:
        return False
    steps, ratios = np.diff(numbers), np.diff(np.log(numbers))
    return bool(ratios.std() / ratios.mean() < 0.999 * steps.std() / steps.mean())


def _find_middles(numbers: Values) -> Values:
    middles = numbers[:-1] / 2.0 + numbers[1:] / 2.0
    first, last = 2.0 * numbers[0] - middles[0], 2.0 * numbers[-1] - middles[-1]
    return np.concatenate([[first], middles, [last]])


def list_branches(columns: Sequence[ColumnLimits | None], name: str) -> list[Values]:
    """Return the values of a limit, one for each column; NaN for no limit.

    If a loop is stable in several ranges of its gain, or not from 0 on, each end is a branch.
    """
    ends = [() if one is None else _list_ends(one, name) for one in columns]
    most = max(map(len, ends), default=0)
    # Counted from the top: if there is any end, there is a highest end.
    padded = [[*([math.nan] * (most - len(one))), *one] for one in ends]
    return [np.array(values, dtype=np.float64) for values in zip(*padded, strict=True)]


def _list_ends(limit: ColumnLimits, name: str) -> tuple[float, ...]:
    if name == OVERSHOOT:
        return () if limit.overshoot is None else (limit.overshoot,)
    ranges = limit.stable if name == STABILITY else limit.grown or ()
    return tuple(end for pair in ranges for end in pair if end > 0.0 and math.isfinite(end))
