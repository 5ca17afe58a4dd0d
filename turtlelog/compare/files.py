"""Many recordings, read and measured one by one: what is kept of each is its summary."""

import multiprocessing
import warnings
from collections.abc import Collection, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Final

from turtlelog.compare.summary import RunSummary
from turtlelog.errors import CompareError, TurtlelogError
from turtlelog.log import PartialRecordingWarning, read_run
from turtlelog.measure import MeasureSettings, Metric, choose_metrics, measure_run
from turtlelog.run import Parameter, Run

_AT_ONCE: Final = 16
"""Files that a process takes at a time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicChoice:
    """Which topics of somebody else's bags to read, and whether recordings may be unfinished.

    Topics are None where but one can be meant.
    """

    pose_topic: str | None = None
    command_topic: str | None = None
    allow_partial: bool = False


def summarise_files(
    paths: Sequence[str | Path],
    settings: MeasureSettings | None = None,
    *,
    only: Collection[str] | None = None,
    topics: TopicChoice | None = None,
    jobs: int = 1,
) -> Iterator[RunSummary | TurtlelogError]:
    """Yield the summary of every file in the order given, or the error where one cannot be read.

    One run at a time is in memory, with `jobs` one in each process.

    Args:
        paths: Recordings, bags or the paper's logs, as `read_run` takes them.
        settings: As in `measure_run`.
        only: The same.
        topics: The same topics for all of them.
        jobs: Processes to measure in, at least 1. They import the module that runs: a script that
            asks for more than one keeps its own work under `if __name__ == "__main__":`.

    Raises:
        MeasureError: Where `only` names no metric.
        CompareError: Where `jobs` is no number of processes.
    """
    if jobs < 1:
        raise CompareError(f"jobs: expected at least 1 process, found {jobs}")
    names = None if only is None else choose_metrics(only)
    measure = partial(_measure_file, settings=settings, only=names, topics=topics or TopicChoice())
    return _iterate(measure, [str(path) for path in paths], jobs)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Measured:
    """A summary on its way from one process to another."""

    name: str
    source: str
    stop_reason: str | None
    parameters: dict[str, Parameter]
    metrics: dict[str, Metric]
    notes: dict[str, str]


def _measure_file(
    path: str,
    *,
    settings: MeasureSettings | None,
    only: Collection[str] | None,
    topics: TopicChoice,
) -> _Measured | TurtlelogError:
    try:
        run = _read(path, topics)
    except TurtlelogError as err:
        return err
    return _Measured(
        name=run.name,
        source=run.source,
        stop_reason=run.stop_reason,
        parameters=dict(run.parameters),
        metrics=dict(measure_run(run, settings, only=only)),
        notes=dict(run.notes),
    )


def _read(path: str, topics: TopicChoice) -> Run:
    with warnings.catch_warnings():
        # The run's note says the same.
        warnings.simplefilter("ignore", PartialRecordingWarning)
        return read_run(
            path,
            pose_topic=topics.pose_topic,
            command_topic=topics.command_topic,
            allow_partial=topics.allow_partial,
        )


def _iterate(
    measure: "partial[_Measured | TurtlelogError]", paths: Sequence[str], jobs: int
) -> Iterator[RunSummary | TurtlelogError]:
    if jobs == 1 or len(paths) < 2:
        yield from map(_summarise, map(measure, paths), paths)
        return
    # Spawned and not forked: the same everywhere, and safe beside threads.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(min(jobs, len(paths)), mp_context=context)
    try:
        yield from map(_summarise, pool.map(measure, paths, chunksize=_AT_ONCE), paths)
    finally:
        pool.shutdown(cancel_futures=True)


def _summarise(found: _Measured | TurtlelogError, path: str) -> RunSummary | TurtlelogError:
    if isinstance(found, TurtlelogError):
        return found
    return RunSummary(
        name=found.name,
        source=found.source,
        stop_reason=found.stop_reason,
        parameters=MappingProxyType(found.parameters),
        metrics=MappingProxyType(found.metrics),
        file=path,
        notes=MappingProxyType(found.notes),
    )
