"""Metrics of several runs in figures: their choice, unit and scale."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, LogLocator, NullFormatter, NullLocator
from numpy.typing import NDArray

from turtlelog.errors import ShowError
from turtlelog.measure import Metric, choose_metrics, find_metric_kind, measure_run
from turtlelog.run import Run

Values = NDArray[np.float64]

USUAL: Final = ("*.overshoot", "*.settling_time", "final.position_error")
OF_TRACKING: Final = ("*.rms_error", "*.largest_error")
"""Default metrics if no loop responds to a step: errors of loops with a moving reference."""

_LOGARITHMIC: Final = 30.0
"""Ratio of largest to smallest value from which a scale is logarithmic. On a linear scale of 30 mm,
the smallest value would be within 1 mm of 0."""

_LEAST_PERCENT: Final = 0.5
"""Smallest height of a percentage axis [%], a quarter of the settling band. On a smaller axis, the
last digits of a run without overshoot would look like an overshoot."""

_POINTS_PER_INCH: Final = 72.0
_LETTER_WIDTH: Final = 0.65
"""Width of a digit as a share of the font size. DejaVu Sans, the widest font in use, has 0.636."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MetricValues:
    """A metric of several runs.

    Attributes:
        id: Id of the metric.
        label: Label of an axis, with the unit.
        values: Value of each run in this unit; NaN for a missing value.
        reasons: Reason for each missing value; empty for an existing value, or if the run was not
            measured.
        factor: Factor from the metric's unit to the unit of the label.
    """

    id: str
    label: str
    values: Values
    reasons: tuple[str, ...]
    factor: float = 1.0

    @property
    def loop(self) -> str:
        """Name of the metric's loop; empty for the whole run."""
        loop = self.id.rpartition(".")[0]
        return "" if loop in {"final", "run"} else loop

    @property
    def name(self) -> str:
        """Name of the metric without its loop."""
        return self.id.rpartition(".")[2] if self.loop else self.id

    @property
    def is_logarithmic(self) -> bool:
        """Whether the values need a logarithmic scale."""
        known = self.values[np.isfinite(self.values)]
        return (
            len(known) > 1
            and bool(known.min() > 0.0)
            and bool(known.max() > _LOGARITHMIC * known.min())
        )


def measure_for_figure(
    figure: str, runs: Sequence[Run], names: Sequence[str] | None
) -> list[MetricValues]:
    """Return metrics for which at least one run has a value.

    Args:
        figure: Name of the figure, for errors.
        runs: Runs to measure.
        names: Ids, patterns, or names of metrics of any loop (`overshoot`). Default: the usual
            metrics.

    Raises:
        ShowError: If no run has a value of any metric. The message has the first reason.
        MeasureError: If a name is not a metric.
    """
    patterns = [complete_name(name) for name in names] if names else [*USUAL]
    measured = [measure_run(run, only=choose_metrics(patterns, run.declaration)) for run in runs]
    found = _gather(measured)
    if not found and not names:
        patterns = [*OF_TRACKING]
        measured = [
            measure_run(run, only=choose_metrics(patterns, run.declaration)) for run in runs
        ]
        found = _gather(measured)
    if not found:
        reasons = [one.reason for metrics in measured for one in metrics.values() if one.reason]
        reason = f": {reasons[0]}" if reasons else ""
        wanted = ", ".join(names or USUAL)
        raise ShowError(f"figure {figure} needs a value of {wanted}{reason}")
    return found


def complete_name(name: str) -> str:
    """Return an id or pattern unchanged, and `overshoot` as the overshoot of any loop."""
    is_bare = "." not in name and find_metric_kind(name) is None
    return f"*.{name}" if is_bare else name


def _gather(measured: Sequence[Mapping[str, Metric]]) -> list[MetricValues]:
    ids = dict.fromkeys(name for metrics in measured for name in metrics)
    found = []
    for name in ids:
        metrics = [one.get(name) for one in measured]
        if any(metric is not None and metric.value is not None for metric in metrics):
            found.append(_build(name, metrics))
    return found


def _build(name: str, metrics: Sequence[Metric | None]) -> MetricValues:
    known = [one for one in metrics if one is not None and one.value is not None]
    values = [np.nan if one is None or one.value is None else one.value for one in metrics]
    unit, factor = known[0].unit, 1.0
    if unit == "m" and max(abs(one.value or 0.0) for one in known) < 1.0:
        unit, factor = "mm", 1e3
    loop, _, last = name.rpartition(".")
    words = last if loop != "final" or last.startswith("final") else f"final {last}"
    words = words.replace("_", " ")
    return MetricValues(
        id=name,
        label=words if unit == "1" else f"{words} [{unit}]",
        values=factor * np.array(values),
        reasons=tuple("" if one is None else one.reason for one in metrics),
        factor=factor,
    )


def set_value_scale(axes: Axes, found: MetricValues) -> None:
    """Set the scale of an axis for a metric, with room for its values."""
    known = found.values[np.isfinite(found.values)]
    low, high = float(known.min()), float(known.max())
    if found.is_logarithmic:
        axes.set_yscale("log")
        axes.set_ylim(low / 1.6, high * 1.9)
        few = high < 100.0 * low
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,)))
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter(NullFormatter())
        return
    if found.label.endswith("[%]"):
        high = max(high, low + _LEAST_PERCENT, _LEAST_PERCENT)
    # The room is a share of the axis, which includes 0; nearly equal values would be at the edge.
    room = 0.14 * (max(high, 0.0) - min(low, 0.0)) or 1.0
    axes.set_ylim(min(low - room, 0.0), max(high + room, 0.0))


def set_ticks_at(axes: Axes, values: Sequence[float]) -> None:
    """Place the ticks of the lower axis at the values that have enough room."""
    axes.xaxis.set_major_locator(FixedLocator(_choose_places(axes, sorted({*values}))))
    axes.xaxis.set_minor_locator(NullLocator())
    formatter: Any = "{x:.4g}"
    axes.xaxis.set_major_formatter(formatter)


def _choose_places(axes: Axes, values: Sequence[float]) -> list[float]:
    """Return the smallest and largest values, and values between them whose labels do not touch."""
    points = axes.get_xaxis_transform().transform([(value, 0.0) for value in values])[:, 0]
    points = points * _POINTS_PER_INCH / axes.figure.dpi
    size: Any = axes.xaxis.get_major_ticks()[0].label1.get_fontsize()
    letter = _LETTER_WIDTH * size
    halves = [letter * (len(f"{value:.4g}") + 1) / 2.0 for value in values]
    last = len(values) - 1
    chosen: list[int] = []
    for row in [0, last, *range(1, last)]:
        if all(abs(points[row] - points[one]) >= halves[row] + halves[one] for one in chosen):
            chosen.append(row)
    return [values[row] for row in sorted(chosen)]
