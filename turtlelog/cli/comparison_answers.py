"""The JSON answers of `turtlelog compare`."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import turtlelog as tl

if TYPE_CHECKING:
    from turtlelog import Comparison, Finding, Metric, RunSummary
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
        "verdict": None,
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
    paths: Sequence[Path], comparisons: "Sequence[Comparison]", alignment: str
) -> dict[str, Any]:
    """Return runs against the reference, which is the first path."""
    verdicts = [found.verdict for found in comparisons]
    judged = "fail" if "fail" in verdicts else "pass"
    return {
        "reference": str(paths[0]),
        "alignment": alignment,
        "verdict": None if None in verdicts else judged,
        "runs": [
            {
                "file": str(path),
                "name": found.name,
                "verdict": found.verdict,
                "overlap_s": found.overlap_s,
                "overlap_from_s": found.overlap_from_s,
                "notes": list(found.notes),
                "signals": _describe_signals(found),
                "metrics": [_describe_difference(metric, found) for metric in found.metrics],
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


def _describe_signals(comparison: "Comparison") -> list[dict[str, Any]]:
    """Return every signal that both runs hold, and those that should have been judged."""
    findings = _index_findings(comparison, "signal")
    held = {found.signal: found for found in comparison.signals}
    return [
        {
            "signal": name,
            "unit": tl.SIGNALS[name].unit if name in tl.SIGNALS else "1",
            **_describe_largest(held.get(name)),
            **_describe_finding(findings.get(name)),
        }
        for name in dict.fromkeys([*tl.SIGNALS, *held, *findings])
        if name in held or name in findings
    ]


def _find_better(name: str) -> str | None:
    kind = tl.find_metric_kind(name)
    return None if kind is None else kind.better


def _describe_largest(found: "SignalDifference | None") -> dict[str, Any]:
    if found is None:
        return {"largest": None, "at_s": None}
    return {"largest": found.largest, "at_s": found.at_s}


def _describe_difference(found: "MetricDifference", comparison: "Comparison") -> dict[str, Any]:
    finding = _index_findings(comparison, "metric").get(found.metric.id)
    described = _describe_finding(finding)
    # A metric is one figure of the whole run: it is nowhere in time.
    for key in ("first_outside_s", "margin_at_s", "nearest"):
        del described[key]
    return {
        "id": found.metric.id,
        "value": found.metric.value,
        "unit": found.metric.unit,
        "status": found.metric.status.value,
        "reference": found.reference.value,
        "reference_status": found.reference.status.value,
        "better": _find_better(found.metric.id),
        **described,
    }


def _describe_finding(finding: "Finding | None") -> dict[str, Any]:
    if finding is None:
        keys = (
            *("within", "tolerance", "first_outside_s", "margin", "margin_at_s", "off", "limit"),
            *("nearest", "reason"),
        )
        return dict.fromkeys(keys)
    return {
        "within": finding.within,
        "tolerance": dataclasses.asdict(finding.tolerance),
        "first_outside_s": finding.first_outside_s,
        "margin": finding.margin,
        "margin_at_s": finding.at_s,
        "off": finding.off,
        "limit": finding.limit,
        "nearest": finding.reference,
        "reason": finding.reason or None,
    }


def _index_findings(comparison: "Comparison", kind: str) -> "dict[str, Finding]":
    return {found.name: found for found in comparison.findings if found.kind == kind}
