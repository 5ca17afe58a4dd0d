"""`turtlelog compare --reference`: how far each run is from one."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import turtlelog as tl
from turtlelog.cli.options import ReadingOptions, watch_files
from turtlelog.cli.output import print_json, print_run_notes, print_tables
from turtlelog.compare.difference import compare_measured
from turtlelog.display import format_number
from turtlelog.processes import map_in_processes

if TYPE_CHECKING:
    from collections.abc import Mapping

    from turtlelog import Metric, Run
    from turtlelog.compare import (
        MetricDifference,
        PathError,
        RunComparison,
        RunSummary,
        SignalDifference,
        Table,
    )
    from turtlelog.log import ReadChoice

_RUNS_ABREAST: Final = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class _Compared:
    """What is found of one run beside the reference."""

    summary: "RunSummary"
    comparison: "RunComparison"
    path_error: "PathError"


@dataclass(frozen=True, kw_only=True)
class _Comparer:
    """Compares one run after the other with a reference, in this process or another."""

    reference: "Run"
    alignment: str
    choice: "ReadChoice"

    @cached_property
    def _metrics(self) -> "Mapping[str, Metric]":
        return tl.measure_run(self.reference)

    def __call__(self, path: Path) -> _Compared:
        return self.compare(path, tl.log.read_as_chosen(path, self.choice))

    def compare(self, path: Path, run: "Run") -> _Compared:
        """Return what is found of a run that has been read."""
        usual = [
            name for one in (run, self.reference) for name in tl.compare.list_usual_of_run(one)
        ]
        metrics = _measure_known(run, usual)
        error = tl.compare.measure_path_error(self.reference, run, alignment=self.alignment)
        return _Compared(
            summary=tl.summarise_run(run, file=str(path), metrics=metrics),
            comparison=compare_measured(
                self.reference, self._metrics, run, alignment=self.alignment
            ),
            path_error=error,
        )


def compare_with_reference(
    paths: Sequence[Path],
    held: "Sequence[Run] | None",
    kind: str,
    *,
    align: str | None,
    topics: ReadingOptions | None,
    jobs: int,
) -> None:
    """Print how far runs are from the first.

    Args:
        paths: Of the reference, and of the others.
        held: The runs, where they are read already; then they are compared in this process.
        kind: How to print.
        align: What to bring together; None for the first samples.
        topics: What to read.
        jobs: Processes to read and compare in.
    """
    alignment = align or "first_sample"
    if alignment == "first-sample":
        alignment = "first_sample"
    choice = (topics or ReadingOptions()).build_choice()
    reference = tl.log.read_as_chosen(paths[0], choice) if held is None else held[0]
    comparer = _Comparer(reference=reference, alignment=alignment, choice=choice)
    others = paths[1:]
    if held is None:
        print_run_notes(paths[0], reference.notes)
        found: Iterable[_Compared] = map_in_processes(comparer, others, jobs)
    else:
        found = map(comparer.compare, others, held[1:])
    compared: list[_Compared] = []
    for one in watch_files(found, len(others)):
        compared.append(one)
        if held is None:
            print_run_notes(one.summary.file, one.summary.notes)
    if kind == "json":
        print_json(_describe(paths, compared, alignment))
    else:
        first = _summarise_reference(reference, paths[0], [one.summary for one in compared])
        print_tables(_tabulate(first, compared, kind), kind)


def _summarise_reference(
    reference: "Run", path: Path, others: "Sequence[RunSummary]"
) -> "RunSummary":
    """Return the reference in short, measured as itself and as others of which no law is known."""
    usual = list(tl.compare.list_usual_of_run(reference))
    is_lawless = tl.measure.is_lawless(reference)
    unlike = [found for found in others if found.is_lawless != is_lawless]
    if unlike:
        usual += tl.compare.list_usual_of_run(unlike[-1])
    return tl.summarise_run(reference, file=str(path), metrics=_measure_known(reference, usual))


def _measure_known(run: "Run", names: Sequence[str]) -> "Mapping[str, Metric]":
    known = tl.measure.list_metrics(run.declaration)
    return tl.measure_run(run, only=[name for name in names if name in known])


def _tell_path(name: str, reference: str, error: "PathError") -> str:
    def show(value_m: float) -> str:
        return format_number(round(value_m, 9), "m")  # less is rounding

    return (
        f"{name}: up to {show(error.largest_m)} from the path of {reference} at"
        f" {error.largest_at_s:.2f} s, RMS {show(error.rms_m)}; at equal times up to"
        f" {show(error.largest_apart_m)} apart, RMS {show(error.rms_apart_m)}."
    )


def _tabulate(first: "RunSummary", compared: "Sequence[_Compared]", kind: str) -> "list[Table]":
    summaries = [first, *(one.summary for one in compared)]
    comparisons = [one.comparison for one in compared]
    reference, *names = tl.compare.name_runs(summaries)
    # As many runs as a terminal has room for; a file has room for all.
    step = _RUNS_ABREAST if kind == "txt" else len(names)
    differences = [
        tl.compare.tabulate_differences(
            comparisons[first : first + step],
            names=names[first : first + step],
            reference=reference,
        )
        for first in range(0, len(names), step)
    ]
    if kind == "csv":
        return differences
    told = [
        _tell_path(name, reference, one.path_error)
        for name, one in zip(names, compared, strict=True)
    ]
    last = replace(differences[-1], notes=(*differences[-1].notes, *told))
    return [tl.tabulate_runs(summaries), *differences[:-1], last]


def _describe(
    paths: Sequence[Path],
    compared: "Sequence[_Compared]",
    alignment: str,
) -> dict[str, Any]:
    """Return runs against the reference, which is the first path."""
    return {
        "reference": str(paths[0]),
        "alignment": alignment,
        "runs": [
            {
                "file": str(path),
                "name": one.comparison.name,
                "overlap_s": one.comparison.overlap_s,
                "overlap_from_s": one.comparison.overlap_from_s,
                "notes": list(one.comparison.notes),
                "signals": [_describe_signal(signal) for signal in one.comparison.signals],
                "metrics": [_describe_difference(metric) for metric in one.comparison.metrics],
                "path_error": asdict(one.path_error),
            }
            for path, one in zip(paths[1:], compared, strict=True)
        ],
    }


def describe_metric(metric: "Metric") -> dict[str, Any]:
    """Return a metric as an entry of JSON answers; a reference is beside it where there is one."""
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
    kind = tl.measure.find_metric_kind(name)
    return None if kind is None else kind.better


def _describe_difference(found: "MetricDifference") -> dict[str, Any]:
    return {
        **describe_metric(found.metric),
        "reference": found.reference.value,
        "reference_status": found.reference.status.value,
    }
