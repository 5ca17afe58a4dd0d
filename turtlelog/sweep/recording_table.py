"""One table with the metrics of many recordings; unchanged recordings are not read again."""

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from turtlelog.compare import order_ids
from turtlelog.errors import LibraryError, LogError, TurtlelogError
from turtlelog.files.urls import make_path
from turtlelog.libraries import __version__
from turtlelog.log import ReadChoice, read_as_chosen
from turtlelog.log.parquet_file import list_cells
from turtlelog.measure import MeasureSettings, measure_run
from turtlelog.processes import FILE_S, choose_jobs, map_in_processes
from turtlelog.sweep import result_table
from turtlelog.sweep.find_recordings import FoundRecording, hash_recording
from turtlelog.sweep.partial_table import (
    ERROR,
    FILE,
    Cell,
    CellType,
    KeptParts,
    Key,
    PartialColumns,
    Row,
    StoredCells,
    StoredRows,
    WindowedRows,
    build_result_columns,
)
from turtlelog.sweep.result_table import STATUS, ResultColumn

if TYPE_CHECKING:
    from concurrent.futures import Executor


_STATE: Final = Key("size", "whole", "B"), Key("mtime_ns", "whole", "ns"), Key("sha256")
HEAD: Final = (FILE, *_STATE, ERROR)  # columns of every table of recordings

Order = Callable[[Set[Key], Set[Key]], Sequence[Key]]

_CHUNK_FILES: Final = 16
_CHUNK_BYTES: Final = 2**24
"""Size of a chunk [bytes], read in a tenth of a second; an interruption loses one."""


class FileState(msgspec.Struct, frozen=True, array_like=True):
    """Known facts of a file, with size and time as in `FoundRecording`, and its rows.

    The hash is None if the file must be read again in any case. The count is 0 if the content is
    unchanged and its rows are already known.
    """

    size: int
    mtime_ns: int
    sha256: str | None
    first: int
    count: int


class ReadFiles(msgspec.Struct, frozen=True, array_like=True):
    """Rows read from some files: states by label, and name, type, unit and cells of each column."""

    files: dict[str, FileState]
    count: int
    columns: list[tuple[str, CellType, str, list[Cell]]]

    def __len__(self) -> int:
        return len(self.files)

    def pack(self) -> PartialColumns:
        """Return the rows as columns."""
        packed = {
            Key(name, kind, unit): StoredCells.pack(kind, cells)
            for name, kind, unit, cells in self.columns
        }
        return PartialColumns(self.count, packed)


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingTable:
    """Kind and columns of the table to write.

    For a file that cannot be read, `work` returns a row with `ERROR`. A `LibraryError` gives such a
    row too; any other exception ends the call.
    """

    kind: str  # see `ResultTable`
    facts: Mapping[str, str]  # settings on which rows depend, apart from the content of files
    work: Callable[[str], Sequence[Row]]  # rows of a file, at least one; picklable
    order: Order  # keys of columns without those of `HEAD`, from all keys and those with a value


@dataclass(frozen=True, slots=True, kw_only=True)
class TabulatedFiles:
    """Result of writing a table of recordings: numbers of files and first errors."""

    output: Path  # path of the table
    files: int  # number of files in the table
    read: int  # number of files that were read
    failed: int  # number of files that cannot be read; the column `error` gives the reason
    errors: tuple[tuple[str, str], ...]  # label and reason of the first files that cannot be read


def describe_former(output: Path, table: RecordingTable) -> str | None:
    """Return why an existing table cannot be reused; None if it can, or does not exist.

    LogError if the file is not such a table and must not be replaced.
    """
    if not result_table.has_result_file(output):
        return None
    found = result_table.read_result_facts(output)
    if found is None or found["kind"] != table.kind:
        other = "another Parquet file" if found is None else f"a table of {found['kind']}"
        raise LogError(f"{output}: expected a table of {table.kind} or a new name, found {other}")
    if found["version"] != __version__:
        return f"turtlelog {found['version'][:40]} wrote it"
    others = [name for name, text in table.facts.items() if found.get(name) != text]
    return f"it was made with another choice of {' and '.join(others)}" if others else None


def tabulate_recordings(
    found: Sequence[FoundRecording],
    output: Path,
    table: RecordingTable,
    *,
    jobs: "int | Executor | None" = 1,
    file_s: float = FILE_S,
    watch: Callable[[Iterator[Any], int], Iterator[Any]] = lambda results, _: results,
) -> TabulatedFiles:
    """Write the rows of recordings, in order, as a Parquet table; read only new recordings.

    Rows are copied from the existing table if the size and modification time of a recording are
    unchanged, or if its content is unchanged. Results of an interrupted call are used.

    Args:
        found: The recordings.
        output: Path of the table, which is replaced when the new table is complete.
        table: Kind and columns of the table.
        jobs: Number of processes, or an executor. Default: the fastest number.
        file_s: Time per file, in addition to the time for its bytes [s], to choose the number of
            processes.
        watch: Function that receives the results of each finished chunk, and its number of files.

    Raises:
        LogError: If the existing file is not such a table, or the table cannot be written.
        SweepError: If another command is writing the table, or the disk is full.
        LibraryError: If pyarrow is not installed.
    """
    output = make_path(output)
    former = None
    if describe_former(output, table) is None and result_table.has_result_file(output):
        former = result_table.open_result_table(output, kind=table.kind)
    facts = {**table.facts, "kind": table.kind, "version": __version__}
    kept = KeptParts(output, facts, ReadFiles)
    is_complete = False
    try:
        rows = FileRows(kept, former)
        chunks = list(_cut(found, rows))
        if jobs is None:
            jobs = choose_jobs([one.path for chunk in chunks for one, _ in chunk], file_s=file_s)
        work = partial(_read_chunk, work=table.work)
        results = map_in_processes(work, chunks, jobs, name=_name_chunk)
        for chunk in watch(results, sum(map(len, chunks))):
            rows.add(chunk)
        labels = [one.label for one in found]
        made, failed, errors = rows.assemble(labels, table.kind, table.facts, table.order)
        result_table.write_result_table(made, output)
        is_complete = True
    finally:
        kept.close(is_complete=is_complete or not kept.places)
    return TabulatedFiles(
        output=output, files=len(found), read=rows.read, failed=failed, errors=errors
    )


_Task = tuple[FoundRecording, str | None]
"""A recording, with the known hash of its content."""


def _cut(found: Sequence[FoundRecording], rows: "FileRows") -> Iterator[list[_Task]]:
    """Yield chunks of recordings to check: a few large files, or many small files."""
    most = max(1, min(_CHUNK_FILES, len(found) // _CHUNK_FILES))
    chunk: list[_Task] = []
    for one in found:
        known = rows.find(one.label)
        sha256 = None if known is None else known.sha256
        state = None if known is None else (known.size, known.mtime_ns)
        if sha256 is not None and state == (one.size, one.mtime_ns):
            continue
        chunk.append((one, sha256))
        if len(chunk) == most or sum(one.size for one, _ in chunk) > _CHUNK_BYTES:
            yield chunk
            chunk = []
    if chunk:
        yield chunk


def _name_chunk(chunk: Sequence[_Task]) -> str:
    more = f" and {len(chunk) - 1} more" if len(chunk) > 1 else ""
    return f"{chunk[0][0].label}{more}"


def _read_chunk(chunk: Sequence[_Task], *, work: Callable[[str], Sequence[Row]]) -> ReadFiles:
    files: dict[str, FileState] = {}
    rows: list[Row] = []
    for one, known in chunk:
        sha256, found = _read_one(one, known, work)
        files[one.label] = FileState(one.size, one.mtime_ns, sha256, len(rows), len(found))
        rows += found
    keys = dict.fromkeys(key for row in rows for key in row)
    columns = [(*key, [row.get(key) for row in rows]) for key in keys]
    return ReadFiles(files, len(rows), columns)


def _read_one(
    one: FoundRecording, known: str | None, work: Callable[[str], Sequence[Row]]
) -> tuple[str | None, Sequence[Row]]:
    """Return the hash and the rows of a file; no rows if the content is known."""
    # The hash is computed first: if a file changes during reading, the hash is that of the former
    # content, and the next call reads the file again.
    try:
        sha256 = hash_recording(Path(one.path))
    except (OSError, LogError):
        sha256 = None  # the file may become readable without a change
    if sha256 is not None and sha256 == known:
        return sha256, []
    try:
        rows = work(one.path)
    except LibraryError as err:
        return None, [{ERROR: str(err)}]  # the library may be installed later
    return sha256, rows or [{}]


_TEXTS = (Key("name"), Key("source"), Key("stop_reason"), Key("notes"))


def _measure_file(
    path: str, *, settings: MeasureSettings, only: tuple[str, ...] | None, topics: ReadChoice
) -> list[Row]:
    try:
        run = read_as_chosen(path, topics)
    except LibraryError:
        raise
    except TurtlelogError as err:
        return [{ERROR: str(err).removeprefix(f"{path}: ")}]
    notes = "; ".join(f"{name}: {text}" for name, text in run.notes.items())
    row: dict[Key, Cell] = dict(
        zip(_TEXTS, (run.name, run.source, run.stop_reason, notes or None), strict=True)
    )
    for name, metric in measure_run(run, settings, only=only).items():
        value, status = _name_columns(name, metric.unit)
        row[value], row[status] = metric.value, metric.status.value
    return [row]


@lru_cache(maxsize=1024)  # of one folder: all metrics of some laws
def _name_columns(name: str, unit: str) -> tuple[Key, Key]:
    return Key(name, "real", unit), Key(f"{name}{STATUS}")


def plan_metric_table(
    settings: MeasureSettings | None = None,
    *,
    only: Sequence[str] | None = None,
    topics: ReadChoice | None = None,
) -> RecordingTable:
    """Return the `RecordingTable` for a table with one row of metrics per file.

    Args:
        settings: Settings of the metrics, as in `measure_run`.
        only: Metric ids and patterns. Default: every metric.
        topics: Topics to read from third-party files.
    """
    settings, topics = settings or MeasureSettings(), topics or ReadChoice()
    chosen = None if only is None else tuple(only)
    return RecordingTable(
        kind="metrics",
        facts={
            "metrics": "all" if chosen is None else ",".join(chosen),
            "settings": describe_values(settings),
            "reading": describe_values(topics),
        },
        work=partial(_measure_file, settings=settings, only=chosen, topics=topics),
        order=_order,
    )


def _order(keys: Set[Key], used: Set[Key]) -> list[Key]:
    """Return the text columns, then value and status of each metric that a run has."""
    ids = {key.name.removesuffix(STATUS) for key in used if key.name.endswith(STATUS)}
    chosen, values = [*_TEXTS], sorted(key for key in keys if key.type == "real")
    for name in order_ids(sorted(ids)):
        own = [key for key in values if key.name == name]
        chosen += [*own, Key(f"{name}{STATUS}")]
    return chosen


def describe_values(values: Any) -> str:
    """Return settings as JSON text; the same settings give the same text."""

    def describe(value: Any) -> Any:
        if isinstance(value, Mapping):
            return dict(value)
        return value.tolist() if hasattr(value, "tolist") else repr(value)

    return msgspec.json.encode(values, enc_hook=describe, order="deterministic").decode()


_ERRORS_KEPT: Final = 10

_COLUMNS_LOOKED: Final = 512
"""Number of row columns that fit in memory; all metrics have about 450 columns."""


class FileRows:
    """Known facts of files. The rows of files are in the existing table and the partial file."""

    def __init__(self, kept: KeptParts[ReadFiles], former: result_table.StoredTable | None) -> None:
        """Load the results of an interrupted call and the existing table."""
        self._kept, self._stored = kept, StoredRows()
        self._files: dict[str, FileState] = {}
        self.read = 0
        if former is not None:
            for group in range(len(former.group_rows)):
                self._enter_former(former, group)
        for place in kept.places:
            self._enter(kept.read(place), place)

    def _enter_former(self, former: result_table.StoredTable, group: int) -> None:
        row = self._stored.add(former.group_rows[group], partial(_load_group, former, group))
        columns = former.read([key.name for key in HEAD[:4]], group)
        heads = (list_cells(column.cells) for column in columns)
        for label, size, mtime_ns, sha256 in zip(*heads, strict=True):
            known = self._files.get(label)
            first, count = (row, 0) if known is None else (known.first, known.count)
            is_next = first + count == row  # False in a table that was reordered
            known_hash = sha256 if is_next else None
            self._files[label] = FileState(size, mtime_ns, known_hash, first, count + 1)
            row += 1

    def find(self, label: str) -> FileState | None:
        """Return the known facts of a file."""
        return self._files.get(label)

    def add(self, chunk: ReadFiles) -> None:
        """Add results of several recordings, and save them in case of an interruption."""
        self.read += sum(state.count > 0 for state in chunk.files.values())
        self._enter(chunk, self._kept.add(chunk))

    def _enter(self, chunk: ReadFiles, place: int) -> None:
        row = self._stored.add(chunk.count, lambda: self._kept.read(place).pack())
        for label, state in chunk.files.items():
            rows = row + state.first, state.count
            if not state.count:
                known = self._files[label]
                rows = known.first, known.count
            self._files[label] = FileState(state.size, state.mtime_ns, state.sha256, *rows)

    def assemble(
        self, labels: Sequence[str], kind: str, facts: Mapping[str, str], order: Order
    ) -> tuple[result_table.ResultTable, int, tuple[tuple[str, str], ...]]:
        """Return the table of files with these labels, whose rows are loaded on demand.

        Further results are the number of unreadable files, and label and reason of the first ones.
        """
        states = [self._files[label] for label in labels]
        counts = np.array([state.count for state in states], np.intp)
        which = np.repeat(np.arange(len(states)), counts)
        begins = np.cumsum(counts) - counts
        firsts = np.array([state.first for state in states], np.intp)
        rows = WindowedRows(self._stored, np.arange(len(which)) + (firsts - begins)[which])
        keys, used, failed, errors = _look_through(rows, begins)
        columns = (
            _repeat(FILE, labels, which),
            *(_repeat(key, [getattr(one, key.name) for one in states], which) for key in _STATE),
            *build_result_columns(rows, (ERROR, *order(keys, used))),
        )
        table = result_table.ResultTable(kind=kind, columns=columns, facts=facts)
        return table, failed, tuple((labels[file], text) for file, text in errors)


def _look_through(
    rows: WindowedRows, begins: NDArray[np.intp]
) -> tuple[set[Key], set[Key], int, list[tuple[int, str]]]:
    """Return the keys of rows, those with a value, and number and first errors of failed files.

    The error of a file is in the first row of the file.
    """
    keys, used, count = set[Key](), set[Key](), 0
    errors: list[tuple[int, str]] = []
    for stretch in result_table.cut_groups(len(rows), _COLUMNS_LOOKED):
        cells = rows.load(stretch).cells
        keys |= cells.keys()
        used |= {key for key in cells.keys() - used if cells[key].has_value.any()}
        if ERROR in cells:
            first, last = np.searchsorted(begins, (stretch.start, stretch.stop))
            places = begins[first:last] - stretch.start
            failed = np.flatnonzero(cells[ERROR].has_value[places])
            count += len(failed)
            for file in failed[: _ERRORS_KEPT - len(errors)].tolist():
                errors.append((int(first) + file, cells[ERROR][places[file]]))
    return keys - {*HEAD}, used - {*HEAD}, count, errors


def _repeat(key: Key, cells: Sequence[Cell], which: NDArray[np.intp]) -> ResultColumn:
    packed = StoredCells.pack(key.type, cells).take(which)
    return ResultColumn(name=key.name, type=key.type, cells=packed, unit=key.unit or None)


def _load_group(former: result_table.StoredTable, group: int) -> PartialColumns:
    """Return the rows of a group of an existing table, without the facts of its files."""
    known, packed = {key.name for key in HEAD[:4]}, {}
    for column in former.read([name for name in former.names if name not in known], group):
        unit = column.unit or ""
        name = column.name.removesuffix(f" [{unit}]") if unit else column.name
        key = Key(name, "text" if column.type == "truth" else column.type, unit)
        packed[key] = StoredCells.pack_arrow(key.type, column.cells)
    return PartialColumns(former.group_rows[group], packed)
