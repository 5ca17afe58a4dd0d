"""The JSON answers of `turtlelog compare`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import turtlelog as tl

if TYPE_CHECKING:
    from turtlelog import Metric, RunComparison, RunSummary
    from turtlelog.compare import MetricDifference, SignalDifference


def describe_across(
    summaries: "Sequence[RunSummary]", *, only: Sequence[str], notes: Sequence[str]
) -> dict[str, Any]:
    """Return runs beside each other: no reference, no signals, marks on the metrics."""
    names = list(tl.list_metrics(*(found.declaration for found in summaries)))
    if only:
        chosen = tl.choose_columns(summaries, only)
        names = [name for name in chosen if any(found.find_metric(name) for found in summaries)]
    marks = {name: tl.mark_metric(summaries, name) for name in names}
    return {
        "reference": None,
        "alignment": None,
        "notes": list(notes),
        "runs": [
            {
                "file": summary.file,
                "name": name,
                "overlap_s": None,
                "parameters": dict(summary.parameters),
                "signals": [],
                "metrics": [
                    {**_describe_metric(metric), "mark": marks[metric.id].get(row)}
                    for metric in map(summary.find_metric, names)
                    if metric is not None
                ],
            }
            for row, (name, summary) in enumerate(
                zip(tl.name_runs(summaries), summaries, strict=True)
            )
        ],
    }


def describe_against(
    paths: Sequence[Path], comparisons: "Sequence[RunComparison]", alignment: str
) -> dict[str, Any]:
    """Return runs against the reference, which is the first path."""
    return {
        "reference": str(paths[0]),
        "alignment": alignment,
        "runs": [
            {
                "file": str(path),
                "name": found.name,
                "overlap_s": found.overlap_s,
                "overlap_from_s": found.overlap_from_s,
                "notes": list(found.notes),
                "signals": [_describe_signal(signal) for signal in found.signals],
                "metrics": [_describe_difference(metric) for metric in found.metrics],
            }
            for path, found in zip(paths[1:], comparisons, strict=True)
        ],
    }


def _describe_metric(metric: "Metric") -> dict[str, Any]:
    return {
        "id": metric.id,
        "value": metric.value,
        "unit": metric.unit,
        "status": metric.status.value,
        "reference": None,
        "better": _find_better(metric.id),
    }


def _describe_signal(found: "SignalDifference") -> dict[str, Any]:
    return {
        "signal": found.signal,
        "unit": found.unit,
        "largest": found.largest,
        "at_s": found.at_s,
    }


def _find_better(name: str) -> str | None:
    kind = tl.find_metric_kind(name)
    return None if kind is None else kind.better


def _describe_difference(found: "MetricDifference") -> dict[str, Any]:
    return {
        **_describe_metric(found.metric),
        "reference": found.reference.value,
        "reference_status": found.reference.status.value,
    }
