"""Summaries of the runs in files, read one by one in one or several processes."""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from turtlelog.compare.run_summary import RunSummary, summarise_measured
from turtlelog.errors import CompareError, TurtlelogError
from turtlelog.log import ReadChoice, read_as_chosen
from turtlelog.measure import MeasureSettings, choose_metrics, measure_run
from turtlelog.processes import map_in_processes
from turtlelog.run import Run
from turtlelog.run.loops import Declaration

if TYPE_CHECKING:
    from concurrent.futures import Executor

Choice = Collection[str] | Callable[[Run], Collection[str]] | None
"""Metrics to compute: ids and patterns, or a function that returns the metrics of a run. None: all
metrics."""


def summarise_files(
    paths: Sequence[str | Path],
    settings: MeasureSettings | None = None,
    *,
    only: Choice = None,
    topics: ReadChoice | None = None,
    jobs: "int | Executor" = 1,
    with_parameters: bool = True,
) -> Iterator[RunSummary | TurtlelogError]:
    """Yield the summary of every file in the given order, or the error if it cannot be read.

    Each process has one run at a time in memory.

    Args:
        paths: Any files that `read_run` takes.
        settings: Settings of the metrics, as in `measure_run`.
        only: Metrics, as in `measure_run`; a pattern selects the metrics that each run has. A
            function may choose the metrics of each run.
        topics: Topics to read from bags, the same for all files.
        jobs: Number of processes, at least 1, or a pool. Processes import the main module: a script
            that uses several processes keeps its own work under `if __name__ == "__main__":`.
        with_parameters: Whether summaries contain all parameters, which are half of their size, or
            only the gains.

    Raises:
        MeasureError: If `only` names no metric.
        CompareError: If `jobs` is not a number of processes.
    """
    if isinstance(jobs, int) and jobs < 1:
        raise CompareError(f"jobs: expected at least 1 process, found {jobs}")
    if only is not None and not callable(only):
        choose_metrics(only, Declaration())  # refuses what names no metric of any law
        only = (only,) if isinstance(only, str) else tuple(only)
    measure = partial(
        _measure_file,
        settings=settings,
        only=only,
        topics=topics or ReadChoice(),
        with_parameters=with_parameters,
    )
    return map_in_processes(measure, [str(path) for path in paths], jobs)


def _measure_file(
    path: str,
    *,
    settings: MeasureSettings | None,
    only: Choice,
    topics: ReadChoice,
    with_parameters: bool,
) -> RunSummary | TurtlelogError:
    try:
        run = read_as_chosen(path, topics)
    except TurtlelogError as err:
        return err
    chosen = only(run) if callable(only) else only
    metrics = measure_run(run, settings, only=chosen)
    return summarise_measured(run, path, metrics, with_parameters=with_parameters)


def complete_summaries(
    summaries: Sequence[RunSummary],
    settings: MeasureSettings | None = None,
    *,
    topics: ReadChoice | None = None,
) -> tuple[RunSummary, ...]:
    """Return runs with all metrics of `final` and `run` that any of the runs has.

    If third-party bags are compared with runs of a law, the files are read again; otherwise nothing
    changes.
    """
    if len({found.is_lawless for found in summaries}) < 2:
        return tuple(summaries)
    ids = dict.fromkeys(name for found in summaries for name in found.metrics)
    shared = [name for name in ids if name.partition(".")[0] in {"final", "run"}]
    return tuple(_complete(found, shared, settings, topics or ReadChoice()) for found in summaries)


def _complete(
    summary: RunSummary,
    ids: Sequence[str],
    settings: MeasureSettings | None,
    topics: ReadChoice,
) -> RunSummary:
    lacking = [name for name in ids if name not in summary.metrics]
    if not lacking:
        return summary
    found = measure_run(read_as_chosen(summary.file, topics), settings, only=lacking)
    return replace(summary, metrics={**summary.metrics, **found})
