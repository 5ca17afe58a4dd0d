"""Verdicts: what was found of each signal and metric that has a tolerance."""

from dataclasses import dataclass
from typing import Literal

from turtlelog.compare.clock import Clock
from turtlelog.compare.tolerances import Tolerance
from turtlelog.compare.tube import Rows, find_limit, find_nearest, measure_distance
from turtlelog.measure import Metric, Signal, find_metric_kind


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """What was found of one signal or metric.

    Figures are those of the place with the least margin, and None where there was nothing to
    compare.

    Attributes:
        kind: `signal` or `metric`.
        name: Of the signal, or id of the metric.
        unit: Of all figures but the times.
        tolerance: As given.
        within: Whether it passes.
        value: Of the run.
        reference: Nearest value of the reference within the tolerance in time.
        off: How far the one is from the other; of a metric that is better in one direction, how
            much worse it is, negative where it is better.
        limit: max(abs, rel |reference|).
        at_s: Where that is on the common clock [s], None for a metric.
        first_outside_s: First time at which the signal is outside [s], None where it never is.
        reason: Why it passes or fails, where figures do not say it.
    """

    kind: Literal["signal", "metric"]
    name: str
    unit: str
    tolerance: Tolerance
    within: bool
    value: float | None = None
    reference: float | None = None
    off: float | None = None
    limit: float | None = None
    at_s: float | None = None
    first_outside_s: float | None = None
    reason: str = ""

    @property
    def margin(self) -> float | None:
        """How much further off it could be, None without figures; negative: the excess."""
        return None if self.off is None or self.limit is None else self.limit - self.off


def judge_signal(reference: Signal, rows: Rows, tolerance: Tolerance, clock: Clock) -> Finding:
    """Return the verdict on a run's rows beside the reference's signal, both on the clock."""
    half_width = round(tolerance.time_s * 1e9) if clock.tells_time else 0
    nearest = find_nearest(reference, rows, tolerance, half_width=half_width)
    off = measure_distance(reference, rows.values, nearest)
    limit = find_limit(reference, nearest, tolerance)
    outside = off > limit
    row = int((off - limit).argmax())
    if not outside[row] and outside.any():
        row = int(outside.argmax())
    first = clock.read_seconds(int(rows.grid.at[outside.argmax()])) if outside.any() else None
    return Finding(
        kind="signal",
        name=reference.name,
        unit=reference.kind.unit,
        tolerance=tolerance,
        within=first is None,
        value=float(rows.values[row]),
        reference=float(nearest[row]),
        off=float(off[row]),
        limit=float(limit[row]),
        at_s=clock.read_seconds(int(rows.grid.at[row])),
        first_outside_s=first,
    )


def miss_signal(name: str, unit: str, tolerance: Tolerance, reason: str) -> Finding:
    """Return the verdict on a signal that one of the runs does not hold."""
    return Finding(
        kind="signal", name=name, unit=unit, tolerance=tolerance, within=False, reason=reason
    )


def judge_metric(metric: Metric, reference: Metric, tolerance: Tolerance) -> Finding:
    """Return the verdict on a metric: it fails in its bad direction, or by another status."""
    if metric.value is None or reference.value is None:
        return _judge_status(metric, reference, tolerance)
    kind = find_metric_kind(metric.id)
    if kind is None or metric.unit != reference.unit:
        reason = f"in {metric.unit}, where the reference has {reference.unit}: not compared"
        return leave_open(metric, tolerance, reason)
    off = kind.compute_loss(metric.value, reference.value)
    limit = max(tolerance.abs, tolerance.rel * abs(reference.value))
    return Finding(
        kind="metric",
        name=metric.id,
        unit=metric.unit,
        tolerance=tolerance,
        within=off <= limit,
        value=metric.value,
        reference=reference.value,
        off=off,
        limit=limit,
    )


def leave_open(metric: Metric, tolerance: Tolerance, reason: str) -> Finding:
    """Return that a metric cannot be judged, which does not pass."""
    return Finding(
        kind="metric",
        name=metric.id,
        unit=metric.unit,
        tolerance=tolerance,
        within=False,
        reason=reason,
    )


def _judge_status(metric: Metric, reference: Metric, tolerance: Tolerance) -> Finding:
    same = metric.status == reference.status
    described = [
        f"{found.status.value}{f' ({found.reason})' if found.reason else ''}"
        for found in (metric, reference)
    ]
    reason = f"same status as the reference: {described[0]}"
    if not same:
        reason = f"{described[0]}, where the reference has {described[1]}"
    return Finding(
        kind="metric",
        name=metric.id,
        unit=metric.unit,
        tolerance=tolerance,
        within=same,
        value=metric.value,
        reference=reference.value,
        reason=reason,
    )
