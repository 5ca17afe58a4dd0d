"""Many recordings, read and measured one by one: what is kept of each is its summary."""

import multiprocessing
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Final

from turtlelog.compare.summary import RunSummary, summarise_run
from turtlelog.errors import CompareError, TurtlelogError
from turtlelog.log import TopicChoice
from turtlelog.loops import Declaration
from turtlelog.measure import MeasureSettings, choose_metrics, measure_run

Choice = Collection[str] | Callable[[Declaration], Collection[str]] | None
"""Which metrics to compute: ids and patterns, or what says which, from the law of a run; all."""

_AT_ONCE: Final = 16
"""Files that a process takes at a time."""


def summarise_files(
    paths: Sequence[str | Path],
    settings: MeasureSettings | None = None,
    *,
    only: Choice = None,
    topics: TopicChoice | None = None,
    jobs: int = 1,
) -> Iterator[RunSummary | TurtlelogError]:
    """Yield the summary of every file in the order given, or the error where one cannot be read.

    One run at a time is in memory, with `jobs` one in each process.

    Args:
        paths: Recordings, bags or the paper's logs, as `read_run` takes them.
        settings: As in `measure_run`.
        only: The same, patterns stand for the metrics that each run has; or a function that says
            which, as `list_essential_metrics` does.
        topics: The same topics for all of them.
        jobs: Processes to measure in, at least 1. They import the module that runs: a script that
            asks for more than one keeps its own work under `if __name__ == "__main__":`.

    Raises:
        MeasureError: Where `only` names no metric.
        CompareError: Where `jobs` is no number of processes.
    """
    if jobs < 1:
        raise CompareError(f"jobs: expected at least 1 process, found {jobs}")
    if only is not None and not callable(only):
        choose_metrics(only, Declaration())  # refuses what names no metric of any law
        only = (only,) if isinstance(only, str) else tuple(only)
    measure = partial(_measure_file, settings=settings, only=only, topics=topics or TopicChoice())
    return _iterate(measure, [str(path) for path in paths], jobs)


def _measure_file(
    path: str,
    *,
    settings: MeasureSettings | None,
    only: Choice,
    topics: TopicChoice,
) -> RunSummary | TurtlelogError:
    try:
        run = topics.read(path)
    except TurtlelogError as err:
        return err
    chosen = only(run.declaration) if callable(only) else only
    return summarise_run(run, file=path, metrics=measure_run(run, settings, only=chosen))


def _iterate(
    measure: "partial[RunSummary | TurtlelogError]", paths: Sequence[str], jobs: int
) -> Iterator[RunSummary | TurtlelogError]:
    if jobs == 1 or len(paths) < 2:
        yield from map(measure, paths)
        return
    # Spawned and not forked: the same everywhere, and safe beside threads.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(min(jobs, len(paths)), mp_context=context)
    try:
        yield from pool.map(measure, paths, chunksize=_AT_ONCE)
    finally:
        pool.shutdown(cancel_futures=True)
