"""The run of a sweep: simulation of its rows on all cores, and their one table."""

import json
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from turtlelog.errors import LogError, SweepError
from turtlelog.files.urls import RemotePath, has_files, make_path
from turtlelog.laws import WorkWithLaws, is_given
from turtlelog.log.file_access import name_file, remove_leftovers
from turtlelog.processes import CAN_FORK, LONG_S, count_cores, map_in_processes
from turtlelog.scenario import parse_scenario
from turtlelog.sweep.batch.measured_rows import find_batch
from turtlelog.sweep.plan import PlannedCells, SweepPlan
from turtlelog.sweep.simulate_rows import RowChunk, RowResults, is_batch, simulate_rows
from turtlelog.sweep.table.result_table import (
    STATUS,
    ResultColumn,
    ResultTable,
    StoredTable,
    open_result_table,
    write_result_table,
)
from turtlelog.sweep.table.stored_rows import (
    Columns,
    KeptParts,
    Key,
    StoredCells,
    StoredRows,
    WindowedRows,
    build_result_columns,
    has_results,
    name_partial,
    require_same,
)

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from turtlelog.sweep.sweep_scenario import Sweep

_CHUNK_S: Final = 0.5
"""Duration of a chunk, measured on the first row [s]: the largest loss by an interruption."""

_MOST_IN_CHUNK: Final = 1024
"""Largest number of rows in an ordinary chunk, because a process keeps all results of a chunk in
memory."""

_MOST_IN_BATCH: Final = 4096
"""Largest number of rows in a compiled chunk: half a second for usual rows, and a few hundred
calls."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepSummary:
    """Results of a sweep.

    Attributes:
        output: Path of the table.
        rows: Number of rows.
        failed: Number of failed rows.
        samples: Total number of samples of all runs.
        recorded: Number of recorded runs.
        first_failure: Row and reason of the first failure; empty if no row failed.
        valueless: Metrics without a value in any row, with their statuses.
    """

    output: Path
    rows: int
    failed: int
    samples: int
    recorded: int = 0
    first_failure: str = ""
    valueless: Mapping[str, str] = field(default_factory=dict)


def run_sweep(
    sweep: "Sweep",
    output: str | Path,
    *,
    jobs: "int | Executor | None" = None,
    watch: Callable[[int], None] | None = None,
    tell: Callable[[str], None] | None = None,
) -> SweepSummary:
    """Simulate all rows of a sweep, write their table and return a summary.

    Finished rows are saved next to the output: the same sweep into the same file resumes from
    there. If the results already exist, nothing is simulated.

    Args:
        sweep: Result of `prepare_sweep`.
        output: Path of the Parquet file.
        jobs: Number of processes, or an executor. Default: one per core if that is faster.
        watch: Function that is called with the number of finished rows.
        tell: Function that is called once, with the first row whose law exceeds the step budget.

    Raises:
        SweepError: If the file belongs to another sweep, another process is writing it, or the disk
            is full.
        LogError: If the results cannot be written.
    """
    output, facts = make_path(output), sweep.list_facts()
    if has_results(output, facts):
        name_partial(output).unlink(missing_ok=True)
        return _summarise(output, sweep)
    kept = KeptParts(output, facts, RowResults, require=partial(require_same, facts))
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


def _begin_records(sweep: "Sweep", kept: KeptParts[RowResults]) -> None:
    """Create the folder of recordings, or remove a killed sweep's incomplete files from it.

    A folder with files is refused unless the sweep is resumed.
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
    sweep: "Sweep", rows: "SweptRows", jobs: "int | Executor | None", watch: "_Telling"
) -> None:
    """Simulate the remaining rows; the first two run alone to measure the time per row."""
    watch(rows.count)
    for _ in range(2):  # the first row includes loading times
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
            # Threads share loaded code; processes would take longer to start.
            jobs, threads = 1, jobs
    else:
        size = max(1, min(_MOST_IN_CHUNK, int(_CHUNK_S / row_s), -(-rest // count)))
    laws = _list_given_laws(sweep)
    if laws and isinstance(jobs, int) and not CAN_FORK:
        jobs = 1
    work = WorkWithLaws(simulate_rows, () if isinstance(jobs, int) else laws)
    cut = partial(sweep.cut_chunk, ahead=rest // count, threads=threads)
    chunks = _Chunks(cut, rows.list_gaps(sweep.plan.row_count), size)
    for results in map_in_processes(work, chunks, jobs, name=_name_chunk, is_forked=bool(laws)):
        rows.add(results)
        watch(rows.count, results)


class _Telling:
    """Reports the number of finished rows, notes of compiled loops, and the first late row."""

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
    """Chunks of work on segments of rows, created on demand."""

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

    def __getitem__(self, place: Any) -> Any:
        if isinstance(place, slice):
            return [self._cut(*cut) for cut in self._cuts[place]]
        return self._cut(*self._cuts[place])


def _name_chunk(chunk: RowChunk) -> str:
    return f"rows {chunk.first} to {chunk.first + len(chunk.values) - 1}"


def _summarise(output: Path, sweep: "Sweep") -> SweepSummary:
    """Return the summary of a table, with at most one row group in memory."""
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
        seconds: Duration with the given number of processes [s].
        bytes: Size of the table [bytes]; the file may be smaller if values repeat.
    """

    seconds: float
    bytes: int


def estimate_sweep(sweep: "Sweep", *, jobs: int | None = None) -> SweepEstimate:
    """Simulate a few rows and return the estimated cost of all rows."""
    count, jobs = sweep.plan.row_count, jobs or count_cores()
    probes = sweep.plan.list_probes()
    for row in probes:  # loading times are not counted for every row
        found = simulate_rows(sweep.cut_chunk(row, 1, ahead=count // jobs))
    begun = time.perf_counter()
    for row in probes:
        simulate_rows(sweep.cut_chunk(row, 1, ahead=count // jobs))
    row_s = (time.perf_counter() - begun) / len(probes)
    numbers = 1 + len(sweep.plan.keys) + len(found.metrics)
    return SweepEstimate(seconds=row_s * count / jobs, bytes=8 * numbers * count)


def _list_given_laws(sweep: "Sweep") -> tuple[str, ...]:
    """Return the laws of the rows that exist only in this process and its forks."""
    kinds = [parse_scenario(sweep.base).law.kind]
    for one in (*sweep.plan.grid, *sweep.plan.zipped):
        kinds += [*one.values] if one.key == "law.kind" else []
    return tuple(dict.fromkeys(filter(is_given, kinds)))


_STOP_REASON: Final = Key("stop_reason")
_FAILED: Final = Key("failed")


class SweptRows:
    """Known facts of the finished rows. The rows themselves are in the partial file."""

    def __init__(self, kept: KeptParts[RowResults]) -> None:
        """Load the results of an interrupted sweep."""
        self._kept = kept
        self._parts: list[tuple[int, int, int]] = []  # first row, number of rows, and place
        self._metrics: dict[str, tuple[int, int]] = {}  # first row and place of each metric
        self._units: dict[tuple[str, str], tuple[int, int]] = {}
        self.count = self.samples = self.recorded = 0
        for place in kept.places:
            self._enter(kept.read(place), place)

    def add(self, results: RowResults) -> None:
        """Save the results of a chunk."""
        self._enter(results, self._kept.add(results))

    def _enter(self, results: RowResults, place: int) -> None:
        self._parts.append((results.first, len(results), place))
        self.count += len(results)
        self.samples += results.samples
        self.recorded += results.recorded
        for number, (name, cells) in enumerate(results.metrics.items()):
            found = results.first, number
            self._metrics[name] = min(self._metrics.get(name, found), found)
            for order, unit in enumerate(cells.units):
                first = results.first, order
                self._units[name, unit] = min(self._units.get((name, unit), first), first)

    def list_gaps(self, count: int) -> list[tuple[int, int]]:
        """Return the segments of unfinished rows: the first row, and the row after the last."""
        gaps, row = [], 0
        for first, size, _ in sorted(self._parts):
            if first > row:
                gaps.append((row, first))
            row = first + size
        return [*gaps, (row, count)] if row < count else gaps

    def list_metrics(self) -> dict[str, str]:
        """Return the metrics in the order of the rows, with their units."""
        units = sorted(self._units, key=self._units.__getitem__)
        return {
            name: " or ".join(unit for other, unit in units if other == name)
            for name in sorted(self._metrics, key=self._metrics.__getitem__)
        }

    def order(self, count: int) -> WindowedRows:
        """Return the rows in order; SweepError if rows are missing or duplicated."""
        stored, row = StoredRows(), 0
        for first, size, place in sorted(self._parts):
            if first != row:
                raise SweepError(f"row {row}: expected every row once, found row {first} instead")
            row += size
            stored.add(size, partial(self._load, place))
        if row != count:
            raise SweepError(f"row {row}: expected {count} rows, found {row}")
        return WindowedRows(stored, range(count))

    def _load(self, place: int) -> Columns:
        results = self._kept.read(place)
        texts = {_STOP_REASON: results.stop_reasons, _FAILED: results.failed}
        cells = {key: StoredCells.pack("text", found) for key, found in texts.items()}
        for name, metric in results.metrics.items():
            cells[Key(name, "real")] = StoredCells.pack("real", metric.values)
            cells[Key(f"{name}{STATUS}")] = StoredCells.pack("text", metric.statuses)
        return Columns(len(results), cells)


def assemble_table(plan: SweepPlan, facts: Mapping[str, str], rows: SweptRows) -> ResultTable:
    """Return the table of a sweep, whose rows are loaded on demand."""
    ordered, units = rows.order(plan.row_count), rows.list_metrics()
    keys = [
        *(key for name in units for key in (Key(name, "real"), Key(f"{name}{STATUS}"))),
        *(_STOP_REASON, _FAILED),
    ]
    columns = [
        ResultColumn(name="row", type="whole", cells=range(plan.row_count)),
        *(
            ResultColumn(
                name=key,
                type=plan.find_type(key),
                cells=PlannedCells(plan, key),
                unit=find_key_unit(key),
            )
            for key in plan.keys
        ),
        *(
            replace(column, unit=units.get(column.name, column.unit))
            for column in build_result_columns(ordered, keys)
        ),
    ]
    names = [column.name for column in columns]
    twice = next((name for number, name in enumerate(names) if name in names[:number]), None)
    if twice is not None:
        raise SweepError(f"{twice}: expected one column of a name, found a key and a metric of it")
    own = {
        "varied": json.dumps(plan.keys),
        "samples": str(rows.samples),
        "recorded": str(rows.recorded),
    }
    return ResultTable(kind="sweep", columns=tuple(columns), facts={**facts, **own})


def find_key_unit(key: str) -> str | None:
    """Return the unit at the end of a key's name; None if the name has no unit."""
    found = _UNIT.search(key)
    if found is None:
        return None
    unit = found[1].replace("_s", "/s", 1) if found[1] != "s" else "s"
    return _POWER.sub(r"^\1", unit)


_UNIT: Final = re.compile(r"_((?:m|rad)(?:_s[23]?)?|s|ticks)$")
_POWER: Final = re.compile(r"(\d)$")


def list_valueless(table: StoredTable, patterns: Sequence[str]) -> dict[str, str]:
    """Return the metrics without a value in any row, with their statuses in words."""
    found: dict[str, str] = {}
    for name in table.names:
        status = f"{name}{STATUS}"
        if status in table.names and table.count_values(name) == 0:
            had = dict.fromkeys(
                text for cells in table.iterate(status) for text in cells.unique().to_pylist()
            )
            found[name] = " or ".join(text for text in had if text) or "every such row failed"
    for pattern in patterns:
        if not any(name == pattern or fnmatchcase(name, pattern) for name in table.names):
            found[pattern] = "no loop has that name"
    return found


def find_failure(table: StoredTable) -> str:
    """Return the first row that failed, with the reason."""
    texts = (text for cells in table.iterate("failed") for text in cells.to_pylist())
    return next(f"row {row}: {text}" for row, text in enumerate(texts) if text is not None)
