"""The metrics of a run by id: the one table that measuring, comparison and checks share."""

import difflib
import math
from collections.abc import Callable, Collection, Mapping
from fnmatch import fnmatchcase
from functools import lru_cache
from types import MappingProxyType
from typing import Final

import numpy as np

from turtlelog.errors import MeasureError
from turtlelog.measure.context import RunContext
from turtlelog.measure.metric import Metric, Missing, Result, Status
from turtlelog.measure.settings import MeasureSettings
from turtlelog.measure.table.clock import TIMING_METRICS
from turtlelog.measure.table.end import FINAL_METRICS
from turtlelog.measure.table.kinds import MetricKind
from turtlelog.measure.table.phase import PHASE_METRICS
from turtlelog.measure.table.whole import RUN_METRICS
from turtlelog.run import Run

METRICS: Final[Mapping[str, MetricKind]] = MappingProxyType(
    {**PHASE_METRICS, **FINAL_METRICS, **RUN_METRICS, **TIMING_METRICS}
)
"""Every metric by id."""

ESSENTIAL_METRICS: Final = (
    *(
        f"{phase}.{name}"
        for phase in ("rotate", "translate")
        for name in (
            *("duration", "rise_time", "overshoot", "settling_time", "final_error", "iae"),
            *("saturated_share", "dead_time"),
        )
    ),
    *("final.heading_error", "final.position_error"),
    *("run.duration", "run.path_length", "run.cross_track_max", "run.largest_gap"),
)
"""The metrics to look at first."""


def choose_metrics(patterns: Collection[str]) -> tuple[str, ...]:
    """Return the ids that are named, in the order of `METRICS`; `*`, `?`, `[...]` match.

    Raises:
        MeasureError: Where one names no metric; with those nearest to it.
    """
    return _choose((patterns,) if isinstance(patterns, str) else tuple(patterns))


@lru_cache(maxsize=64)
def _choose(patterns: tuple[str, ...]) -> tuple[str, ...]:
    chosen: set[str] = set()
    for pattern in patterns:
        found = {name for name in METRICS if name == pattern or fnmatchcase(name, pattern)}
        if not found:
            raise MeasureError(f"metric {pattern!r}: expected {suggest_metrics(pattern)}")
        chosen |= found
    return tuple(name for name in METRICS if name in chosen)


def suggest_metrics(pattern: str) -> str:
    """Return the ids nearest to a name that is none, or where they are listed."""
    near = difflib.get_close_matches(pattern, METRICS, n=3, cutoff=0.5)
    if not near:
        names = {name.partition(".")[2]: name for name in METRICS}
        near = [names[found] for found in difflib.get_close_matches(pattern, names, cutoff=0.5)]
    return f"one like {' or '.join(near)}" if near else "an id such as final.position_error"


def measure_run(
    run: Run,
    settings: MeasureSettings | None = None,
    *,
    only: Collection[str] | None = None,
) -> Mapping[str, Metric]:
    """Return the metrics of a run by id, in the order of `METRICS`.

    Args:
        run: At least one pose; what it does not hold leaves a status in the metrics that need it.
        settings: Otherwise the usual ones.
        only: Ids or patterns of them (`translate.*`); nothing else is computed.

    Raises:
        MeasureError: Where `only` names no metric.
    """
    names = METRICS if only is None else choose_metrics(only)
    context = RunContext(run, settings or MeasureSettings())
    # Figures at the border of what a float holds become statuses, not warnings.
    with np.errstate(all="ignore"):
        return {name: _measure(context, name, METRICS[name]) for name in names}


def _measure(context: RunContext, name: str, kind: MetricKind) -> Metric:
    result = _require_finite(kind.compute, context)
    if isinstance(result, Missing):
        return Metric(
            id=name, value=None, unit=kind.unit, status=result.status, reason=result.reason
        )
    return Metric(id=name, value=result.value, unit=kind.unit, at_s=result.at_s)


def _require_finite(compute: Callable[[RunContext], Result], context: RunContext) -> Result:
    result = compute(context)
    if isinstance(result, Missing) or math.isfinite(result.value):
        return result
    return Missing(status=Status.TOO_LARGE, reason="the value is beyond the largest float")
