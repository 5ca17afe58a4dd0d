"""Values of a measured signal that its neighbours on both sides contradict."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import describe_count
from turtlelog.measure.signals import find_signal
from turtlelog.run import Run

Values = NDArray[np.float64]

MEASURED: Final = ("measured_speed", "measured_turn_rate")
"""Signals that can have outliers. Published commands cannot."""

LONGEST_STEP_NS: Final = 250_000_000
"""Longest time to neighbours that can contradict a value [ns]: in this time a robot reaches 0.5 m/s
at 2 m/s2."""

_LEAST_ROWS: Final = 30
"""Smallest number of values that shows the usual scatter: of 20 normal values, one in 2,000
deviates this far."""

_MOST_SHARE: Final = 0.01
"""Share of rows above which deviating values belong to the signal."""

_APART: Final = 5.0
"""Ratio to the deviation of every other value from which a value is an outlier. In 2,000 values
with normal, uniform or Laplace noise, the largest deviation is less than 2 times the second."""

LOCAL_SPANS: Final = 3.0
"""Smallest ratio to the signal's range among its neighbours; a robot that speeds up or brakes needs
a larger one."""

NEIGHBOURS: Final = 5
"""Number of rows on either side that show the signal's range: half a second at 20 Hz."""

GRAINS: Final = 5.5
"""Smallest deviation in steps of a quantised signal: more than five steps, regardless of rounding.
An encoder at low speed shows single ticks."""

_ROUNDING: Final = 1e-6
"""Differences below this share of the largest value are 32-bit rounding instead of a quantisation
step."""

_ROWS_AT_ONCE: Final = 65_536

_LEAST_CHANGES: Final = 8
"""Number of changes, besides those of the outliers, that a signal needs: a single pulse in a
constant signal may be a test impulse."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outlier:
    """A value that its neighbours on both sides contradict.

    Attributes:
        signal: Name of the signal, one of `MEASURED`.
        row: Row of the poses.
        time_ns: Time of the value [ns].
        value: Value in the signal's unit.
        unit: Unit of the signal.
    """

    signal: str
    row: int
    time_ns: int
    value: float
    unit: str


def find_outliers(time_ns: NDArray[np.int64], values: Values) -> NDArray[np.int64]:
    """Return the rows of single values that are outliers of a measured signal, in order.

    A value deviates if it lies on the same side of both neighbours; its deviation is the distance
    to the nearer one. Steps, ramps, limits and anything that lasts two rows have no deviation. A
    value is an outlier if no other value deviates nearly as far, its neighbours agree, and they are
    close in time. The first and last rows are never outliers, because they have one neighbour.

    Args:
        time_ns: Time [ns], shape (n,), not decreasing.
        values: Finite values of one unit, angles without jumps at a full turn, shape (n,).
    """
    none = np.empty(0, dtype=np.int64)
    if len(values) < _LEAST_ROWS:
        return none
    smooth = np.array(values)
    for first in range(1, len(values) - 1, _ROWS_AT_ONCE):
        last = min(first + _ROWS_AT_ONCE, len(values) - 1)
        three = [values[first + step : last + step] for step in (-1, 0, 1)]
        smooth[first:last] = np.median(three, axis=0)
    height = np.abs(values - smooth)
    rows = _find_apart(height)
    if not len(rows) or _count_changes(values, rows) < _LEAST_CHANGES:
        return none
    least = np.maximum(
        LOCAL_SPANS * _find_spans(smooth, rows), GRAINS * find_quantisation_step(values)
    )
    step_ns = np.maximum(time_ns[rows] - time_ns[rows - 1], time_ns[rows + 1] - time_ns[rows])
    is_outlier = (height[rows] > least) & (step_ns <= LONGEST_STEP_NS)
    return np.asarray(rows[is_outlier])


def list_outliers(run: Run) -> tuple[Outlier, ...]:
    """Return the outliers of a run's measured signals, by signal and then by time."""
    return tuple(_iterate_outliers(run))


def _iterate_outliers(run: Run) -> Iterator[Outlier]:
    for name in MEASURED:
        signal = find_signal(run, name)
        if signal is None:
            continue
        for row in find_outliers(signal.time_ns, signal.values).tolist():
            yield Outlier(
                signal=name,
                row=row,
                time_ns=int(signal.time_ns[row]),
                value=float(signal.values[row]),
                unit=signal.kind.unit,
            )


def describe_outliers(run: Run) -> dict[str, str]:
    """Return a sentence for each signal with outliers, by name of the signal."""
    found: dict[str, list[Outlier]] = {}
    for outlier in list_outliers(run):
        found.setdefault(outlier.signal, []).append(outlier)
    return {name: _describe(outliers, run.start_ns) for name, outliers in found.items()}


def _describe(outliers: list[Outlier], start_ns: int) -> str:
    """Return the number of outliers and the largest one: `1 outlier, -143.6 rad/s at 31.9 s`."""
    worst = max(outliers, key=lambda outlier: abs(outlier.value))
    count = describe_count(len(outliers), "outlier")
    at_s = (worst.time_ns - start_ns) / 1e9
    which = "" if len(outliers) == 1 else "the largest "
    return f"{count}, {which}{worst.value:.1f} {worst.unit} at {at_s:.1f} s"


def _find_apart(height: Values) -> NDArray[np.int64]:
    """Return the rows whose deviation is far larger than all others, in order."""
    most = max(int(_MOST_SHARE * len(height)), 1)
    order = np.argsort(-height, kind="stable")[: most + 1]
    is_apart = height[order[:-1]] > _APART * height[order[1:]]
    count = int(np.flatnonzero(is_apart)[-1]) + 1 if is_apart.any() else 0
    return np.sort(order[:count])


def _count_changes(values: Values, rows: NDArray[np.int64]) -> int:
    return int(np.count_nonzero(np.diff(np.delete(values, rows))))


def _find_spans(smooth: Values, rows: NDArray[np.int64]) -> Values:
    """Return the range of the signal around each row, without single values."""
    around = np.arange(-NEIGHBOURS, NEIGHBOURS + 1)
    near = smooth[np.clip(rows[:, None] + around, 0, len(smooth) - 1)]
    return np.asarray(np.ptp(near, axis=1))


def find_quantisation_step(values: Values) -> float:
    """Return the quantisation step of a signal; a tiny number if it is not quantised."""
    steps = np.abs(np.diff(values))
    steps = steps[steps > _ROUNDING * float(np.abs(values).max())]
    return float(steps.min()) if len(steps) else 0.0


def compute_median(values: NDArray[Any]) -> float:
    """Return the median of one row as `np.median` does; NaN for an empty row.

    `np.median` itself is not used: to look for NaN, it loads numpy's masked arrays, in a tenth of
    numpy's loading time.
    """
    half, odd = divmod(len(values), 2)
    if not len(values):
        return math.nan
    places = [half] if odd else [half - 1, half]
    ordered = np.partition(values, [*places, -1])
    last = float(ordered[-1])  # NaN is sorted after all numbers
    return last if math.isnan(last) else sum(float(ordered[n]) for n in places) / len(places)
