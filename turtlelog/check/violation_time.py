"""When a metric first goes beyond its limit."""

import operator as operators
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from turtlelog.measure import (
    MeasureSettings,
    Metric,
    find_first_stretch,
    list_metrics,
    measure_run,
)
from turtlelog.run import Run, slice_run


def find_metric_violation(
    run: Run, metric: Metric, operator: str, limit: float, settings: MeasureSettings | None = None
) -> float | None:
    """Return when a metric first violates a limit, from the first sample [s].

    What only grows (an error integral, a largest deviation) violates an upper limit at the first
    pose at which the run, had it ended there, would; what is waited for (a settling time), when
    the time allowed is over; what is taken at the end, at the end. Otherwise it is the moment at
    which the metric is taken; None where it belongs to no moment.
    """
    part = metric.id.split(".", 1)[0]
    kind = list_metrics(run.declaration).get(metric.id)
    if kind is not None and operator in {"<", "<="} and metric.value is not None:
        if kind.grows:
            return _find_growth(run, metric.id, operator, limit, settings)
        if kind.is_awaited:
            return _find_start_s(run, part) + max(limit, 0.0)
    if metric.at_s is None and part == "final":
        return (run.end_ns - run.start_ns) / 1e9
    return metric.at_s


def _find_growth(
    run: Run, name: str, operator: str, limit: float, settings: MeasureSettings | None
) -> float:
    first = int(np.searchsorted(run.poses.time_ns, run.start_ns, side="left"))
    last = len(run.poses) - 1
    while first < last:
        middle = (first + last) // 2
        part = slice_run(run, end_ns=int(run.poses.time_ns[middle]))
        part = replace(part, stop_reason=run.stop_reason)  # had it ended there
        value = measure_run(part, settings, only=(name,))[name].value
        if value is not None and not OPERATORS[operator](value, limit):
            last = middle
        else:
            first = middle + 1
    return float(run.poses.time_ns[last] - run.start_ns) / 1e9


def _find_start_s(run: Run, part: str) -> float:
    """Return when a loop first acts, from the first sample [s]; of anything else 0."""
    loop = run.declaration.find_loop(part)
    stretch = find_first_stretch(run, loop) if loop else []
    return (stretch[0].start_ns - run.start_ns) / 1e9 if stretch else 0.0


OPERATORS: Final[Mapping[str, Callable[[float, Any], bool]]] = MappingProxyType(
    {
        "<": operators.lt,
        "<=": operators.le,
        ">": operators.gt,
        ">=": operators.ge,
        "==": operators.eq,
        "!=": operators.ne,
    }
)

MIRRORED: Final[Mapping[str, str]] = MappingProxyType(
    {"<": ">", "<=": ">=", ">": "<", ">=": "<=", "==": "==", "!=": "!="}
)
"""What an operator becomes where its sides change places, or their signs."""


def measure_margin(value: float, operator: str, limit: float) -> float:
    """Return how far the value is from the other verdict, positive where it passes."""
    if operator in {"==", "!="}:
        return abs(value - limit) * (-1.0 if operator == "==" else 1.0) + 0.0
    return limit - value if operator in {"<", "<="} else value - limit
