"""The rows of a sweep, simulated on all cores into one table."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial as partial_call
from pathlib import Path
from typing import TYPE_CHECKING, Final, overload

from turtlelog.errors import LogError, SweepError
from turtlelog.files.urls import RemotePath, has_files, make_path
from turtlelog.laws import WorkWithLaws
from turtlelog.log.complete_files import remove_leftovers
from turtlelog.log.error_boundary import name_file
from turtlelog.processes import CAN_FORK, LONG_S, count_cores, map_in_processes
from turtlelog.scenario import parse_scenario
from turtlelog.sweep.batch import find_batch
from turtlelog.sweep.kept_parts import KeptParts, has_results, name_partial, require_same
from turtlelog.sweep.prepared_sweep import Sweep, list_given_laws
from turtlelog.sweep.result_table import write_result_table
from turtlelog.sweep.simulate_rows import RowChunk, RowResults, is_batch, simulate_rows
from turtlelog.sweep.stored_table import open_result_table
from turtlelog.sweep.sweep_table import SweptRows, assemble_table, find_failure, list_valueless

if TYPE_CHECKING:
    from concurrent.futures import Executor

_CHUNK_S: Final = 0.5
"""Work in a chunk, as measured on the first row [s]: what an interruption costs at most."""

_MOST_IN_CHUNK: Final = 1024
"""Rows of other chunks, however quick: so many results are in the memory of a process at once."""

_MOST_IN_BATCH: Final = 4096
"""Rows that compiled code takes at once: half a second of usual ones, and a few hundred calls."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepSummary:
    """Results of a sweep.

    Attributes:
        output: The results.
        rows: Number of rows.
        failed: Number of those that failed.
        samples: Samples of all runs together.
        recorded: Number of recorded runs.
        first_failure: The first reason with its row; empty if none failed.
        valueless: Metrics of which no row has a value, with the statuses they have instead.
    """

    output: Path
    rows: int
    failed: int
    samples: int
    recorded: int = 0
    first_failure: str = ""
    valueless: Mapping[str, str] = field(default_factory=dict)


def run_sweep(
    sweep: Sweep,
    output: str | Path,
    *,
    jobs: "int | Executor | None" = None,
    watch: Callable[[int], None] | None = None,
    tell: Callable[[str], None] | None = None,
) -> SweepSummary:
    """Simulate all rows of a sweep, write their table and return what came of it.

    What is done is kept beside the output as it grows: the same sweep into the same file goes on
    from there. If the results are there already nothing is simulated.

    Args:
        sweep: Result of `prepare_sweep`.
        output: The Parquet file.
        jobs: Processes, or what takes the work; None: as many as cores where that is quicker.
        watch: Called with the number of rows that are done.
        tell: Called once, with the first row whose law takes longer than its budget for a step.

    Raises:
        SweepError: If the file is that of another sweep, another process works on it, or the disk
            is full.
        LogError: If the results cannot be written.
    """
    output, facts = make_path(output), sweep.list_facts()
    if has_results(output, facts):
        name_partial(output).unlink(missing_ok=True)
        return _summarise(output, sweep)
    kept = KeptParts(output, facts, RowResults, require=partial_call(require_same, facts))
    is_complete = False
    try:
        _begin_records(sweep, kept)
        rows = SweptRows(kept)
        _simulate(sweep, rows, jobs, _Telling(watch or _ignore, tell or _ignore))
        write_result_table(assemble_table(sweep.plan, facts, rows), output)
        is_complete = True
    finally:
        kept.close(is_complete=is_complete)
    return _summarise(output, sweep)


def _ignore(_: object) -> None:
    """Do nothing."""


def _begin_records(sweep: Sweep, kept: KeptParts[RowResults]) -> None:
    """Make the folder of recordings; one with files is refused but where the sweep goes on.

    In that case files that a killed sweep left half written are removed.
    """
    if sweep.records is None:
        return
    if kept.was_begun:
        folder = make_path(sweep.records.folder)
        if not isinstance(folder, RemotePath):
            remove_leftovers(folder)
        return
    try:
        _require_empty(make_path(sweep.records.folder))
    except (LogError, SweepError):
        kept.close(is_complete=True)  # nothing was begun
        raise


def _require_empty(folder: Path) -> None:
    with name_file(folder, expected="a place that can be written"):
        is_used = has_files(folder)
    if is_used:
        raise SweepError(f"{folder}: expected a new folder for recordings, found one with files")
    if isinstance(folder, RemotePath):
        return
    try:
        folder.mkdir(exist_ok=True)
    except OSError as err:
        raise SweepError(
            f"{folder}: expected the name of a folder to make, found: {err.strerror or err}"
        ) from err


def _simulate(
    sweep: Sweep,
    rows: SweptRows,
    jobs: "int | Executor | None",
    watch: "_Telling",
) -> None:
    """Simulate the rows that are not done, two of them alone to see how long one takes."""
    watch(rows.count)
    for _ in range(2):  # the first one takes the time of what is loaded once
        gaps = rows.list_gaps(sweep.plan.row_count)
        if not gaps:
            return
        first = sweep.cut_chunk(gaps[0][0], 1)
        begun = time.perf_counter()
        found = simulate_rows(first)
        row_s = time.perf_counter() - begun
        rows.add(found)
        watch(rows.count, found)
    rest = sweep.plan.row_count - rows.count
    if jobs is None:
        jobs = count_cores() if rest * row_s > LONG_S else 1
    count, threads = (jobs if isinstance(jobs, int) else 1), 1
    batch = find_batch(parse_scenario(sweep.base)) if is_batch(first) else None
    if batch is not None and batch.expect(rest, row_s / count) is not None:
        size = _MOST_IN_BATCH
        if isinstance(jobs, int):
            # Threads share what is loaded, and processes would take longer to start.
            jobs, threads = 1, jobs
    else:
        size = max(1, min(_MOST_IN_CHUNK, int(_CHUNK_S / row_s), -(-rest // count)))
    laws = list_given_laws(sweep)
    if laws and isinstance(jobs, int) and not CAN_FORK:
        jobs = 1
    work = WorkWithLaws(simulate_rows, () if isinstance(jobs, int) else laws)
    cut = partial_call(sweep.cut_chunk, ahead=rest // count, threads=threads)
    chunks = _Chunks(cut, rows.list_gaps(sweep.plan.row_count), size)
    for results in map_in_processes(work, chunks, jobs, name=_name_chunk, is_forked=bool(laws)):
        rows.add(results)
        watch(rows.count, results)


class _Telling:
    """Tells how many rows are done, what compiled loops note, and the first row that is late."""

    def __init__(self, watch: Callable[[int], None], tell: Callable[[str], None]) -> None:
        self._watch, self._tell, self._has_told = watch, tell, False
        self._notes: set[str] = set()

    def __call__(self, done: int, results: RowResults | None = None) -> None:
        self._watch(done)
        for note in () if results is None else results.notes:
            if note not in self._notes:
                self._notes.add(note)
                self._tell(note)
        late = None if results is None or self._has_told else results.find_late()
        if late is not None:
            self._has_told = True
            self._tell(late)


class _Chunks(Sequence[RowChunk]):
    """The work on segments of rows, cut when it is asked for."""

    def __init__(
        self, cut: Callable[[int, int], RowChunk], gaps: Sequence[tuple[int, int]], size: int
    ) -> None:
        self._cut = cut
        self._cuts = [
            (first, min(size, end - first))
            for begin, end in gaps
            for first in range(begin, end, size)
        ]

    def __len__(self) -> int:
        return len(self._cuts)

    @overload
    def __getitem__(self, place: int) -> RowChunk: ...
    @overload
    def __getitem__(self, place: slice) -> list[RowChunk]: ...
    def __getitem__(self, place: int | slice) -> RowChunk | list[RowChunk]:
        if isinstance(place, slice):
            return [self[number] for number in range(*place.indices(len(self)))]
        return self._cut(*self._cuts[place])


def _name_chunk(chunk: RowChunk) -> str:
    return f"rows {chunk.first} to {chunk.first + len(chunk.values) - 1}"


def _summarise(output: Path, sweep: Sweep) -> SweepSummary:
    """Return what a table holds; of its rows no more than a group is in memory."""
    table = open_result_table(output, kind="sweep")
    failed = table.count_values("failed")
    return SweepSummary(
        output=output,
        rows=table.row_count,
        failed=failed,
        samples=int(table.facts["samples"]),
        recorded=int(table.facts["recorded"]),
        first_failure=find_failure(table) if failed else "",
        valueless=list_valueless(table, sweep.metrics or ()),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepEstimate:
    """Estimated cost of a sweep, measured on a few of its rows.

    Attributes:
        seconds: Duration on the given number of processes [s].
        bytes: Bytes of the table, which may be smaller where values repeat [bytes].
    """

    seconds: float
    bytes: int


def estimate_sweep(sweep: Sweep, *, jobs: int | None = None) -> SweepEstimate:
    """Simulate a few rows and return what all of them will take."""
    count, jobs = sweep.plan.row_count, jobs or count_cores()
    probes = sweep.plan.list_probes()
    for row in probes:  # what is loaded once is not counted for every row
        found = simulate_rows(sweep.cut_chunk(row, 1, ahead=count // jobs))
    begun = time.perf_counter()
    for row in probes:
        simulate_rows(sweep.cut_chunk(row, 1, ahead=count // jobs))
    row_s = (time.perf_counter() - begun) / len(probes)
    numbers = 1 + len(sweep.plan.keys) + len(found.metrics)
    return SweepEstimate(seconds=row_s * count / jobs, bytes=8 * numbers * count)
