"""Many recordings to one table: what has not changed since the table was written is not read."""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from turtlelog.errors import LibraryError, LogError
from turtlelog.libraries import load_library
from turtlelog.log.error_boundary import open_file
from turtlelog.processes import FILE_S, choose_jobs, map_in_processes
from turtlelog.sweep.find_recordings import FoundRecording, list_contents
from turtlelog.sweep.kept_rows import FileRows, KeptRows
from turtlelog.sweep.result_table import (
    ResultTable,
    read_result_facts,
    read_result_table,
    write_result_table,
)
from turtlelog.sweep.row_columns import GatheredCells, Key, Row, RowColumns, build_columns
from turtlelog.version import __version__

if TYPE_CHECKING:
    from concurrent.futures import Executor

FILE: Final = Key("file")
SIZE: Final = Key("size", "whole", "B")
CHANGED: Final = Key("mtime_ns", "whole", "ns")
HASH: Final = Key("sha256")
ERROR: Final = Key("error")
HEAD: Final = (FILE, SIZE, CHANGED, HASH, ERROR)
"""Columns of every table of recordings."""

_CHUNK_FILES: Final = 16
_CHUNK_BYTES: Final = 2**24
"""Of a chunk: as much as is read in a tenth of a second or so, which an interruption costs."""

_COLUMNS_AT_ONCE: Final = 16
"""Columns of the former table that are in memory as Python's values."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingTable:
    """Which table is asked for.

    Attributes:
        kind: As in `ResultTable`.
        facts: What rows depend on besides the content of files: settings, as texts.
        work: Makes the rows of a file, at least one; it can be pickled. It answers a file that
            cannot be read with a row of `ERROR`, and raises what ends the whole work.
        order: Returns the keys of columns, without those of `HEAD`, from the keys that there are
            and those of which a cell is not None.
    """

    kind: str
    facts: Mapping[str, str]
    work: Callable[[str], Sequence[Row]]
    order: Callable[[Set[Key], Set[Key]], Sequence[Key]]


@dataclass(frozen=True, slots=True, kw_only=True)
class TabulatedFiles:
    """What came of it.

    Attributes:
        output: The table.
        files: How many it holds.
        read: How many of them were read.
        failed: How many cannot be read; the column `error` says why.
        errors: Of the first of them, label and reason.
    """

    output: Path
    files: int
    read: int
    failed: int
    errors: tuple[tuple[str, str], ...]


def describe_former(output: Path, table: RecordingTable) -> str | None:
    """Return why nothing of the table that is there can be used; None: it can, or there is none.

    Raises:
        LogError: Where the file is no such table, and is not to be replaced.
        LibraryError: Where pyarrow is not installed.
    """
    if not output.exists():
        return None
    found = read_result_facts(output)
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
    """Write the rows of recordings as a Parquet table, in their order, and read what is new.

    A recording is taken from the table that is there if size and time of the last change are the
    same, and is not measured again if its content is. What an interrupted call has read is used.

    Args:
        found: The recordings.
        output: The table, which is replaced when the new one is complete.
        table: What it holds.
        jobs: Processes to read in, or what takes the work; None: as many as are quickest.
        file_s: What a file takes besides its bytes [s], to choose their number.
        watch: Sees the results of chunks on the way, and learns how many files they are of.

    Raises:
        LogError: Where the file there is no such table, or nothing can be written.
        LibraryError: Where pyarrow is not installed.
    """
    assembly = _Assembly(output, table)
    chunks = list(_cut(found, assembly.list_states(found)))
    if jobs is None:
        jobs = choose_jobs([one.path for chunk in chunks for one, _ in chunk], file_s=file_s)
    work = partial(_read_chunk, work=table.work)
    results = map_in_processes(work, chunks, jobs, name=_name_chunk)
    for chunk in watch(results, sum(map(len, chunks))):
        assembly.add(chunk)
    assembly.write(found)
    return assembly.summarise(found)


_State = tuple[int, int, str | None]
_Task = tuple[FoundRecording, str | None]
"""A recording, and the hash of what is known of it."""
_ERRORS_KEPT: Final = 10


class _Assembly:
    """Rows of the former table, those kept of an interrupted call, and new ones."""

    def __init__(self, output: Path, table: RecordingTable) -> None:
        self._output, self._table = output, table
        self._kept = KeptRows(output, {**table.facts, "kind": table.kind, "version": __version__})
        self._former, self._fresh = RowColumns(), RowColumns()
        self._places: dict[str, tuple[int, int]] = {}  # of a label, its rows: first and count
        self._states: dict[str, _State] = {}
        self._read = 0
        if describe_former(output, table) is None and output.exists():
            self._load_former()
        for one in self._kept.read():
            self._put(one)

    def _load_former(self) -> None:
        names = load_library("pyarrow.parquet").read_schema(self._output).names
        for first in range(0, len(names), _COLUMNS_AT_ONCE):
            some = names[first : first + _COLUMNS_AT_ONCE]
            self._former.add_table(
                read_result_table(self._output, kind=self._table.kind, columns=some)
            )
        states = zip(*(self._former.iterate(key) for key in HEAD[:4]), strict=True)
        for row, (label, size, changed, sha256) in enumerate(states):
            first, count = self._places.get(label, (row, 0))
            is_next = first + count == row  # in a table that somebody has put in another order not
            self._places[label] = (first, count + 1)
            self._states[label] = (size, changed, sha256 if is_next else None)

    def list_states(self, found: Sequence[FoundRecording]) -> Iterator[_Task]:
        """Yield the recordings that must be looked at, with the hash of what is known."""
        for one in found:
            size, changed, sha256 = self._states.get(one.label, (-1, -1, None))
            if sha256 is None or (size, changed) != (one.size, one.mtime_ns):
                yield one, sha256

    def add(self, chunk: Sequence[FileRows]) -> None:
        """Take what was found of some recordings, and keep it for the case of an interruption."""
        self._kept.add(chunk)
        for one in chunk:
            self._read += bool(one.rows)
            self._put(one)

    def _put(self, one: FileRows) -> None:
        self._states[one.label] = (one.size, one.mtime_ns, one.sha256)
        if one.rows:
            self._places[one.label] = (self._former.count + self._fresh.count, len(one.rows))
            for row in one.iterate_rows():
                self._fresh.add(row)

    def write(self, found: Sequence[FoundRecording]) -> None:
        """Write the table; then what was kept is not needed any more."""
        spans = [self._places[one.label] for one in found]
        order = np.array(list(chain.from_iterable(range(a, a + n) for a, n in spans)), np.intp)
        head = RowColumns()
        for one, (_, count) in zip(found, spans, strict=True):
            size, changed, sha256 = self._states[one.label]
            for _ in range(count):
                head.add({FILE: one.label, SIZE: size, CHANGED: changed, HASH: sha256})
        stores = (self._former, self._fresh)
        others = {key for store in stores for key in store.cells} - {*HEAD}
        used = {key for key in others if GatheredCells(stores, key, order).has_some}
        columns = (
            *build_columns([head], HEAD[:4], np.arange(len(order))),
            *build_columns(stores, (ERROR, *self._table.order(others, used)), order),
        )
        write_result_table(
            ResultTable(kind=self._table.kind, columns=columns, facts=self._table.facts),
            self._output,
        )
        self._kept.drop()

    def summarise(self, found: Sequence[FoundRecording]) -> TabulatedFiles:
        """Return how many were read, and what is wrong with those that cannot be."""
        firsts = np.array([self._places[one.label][0] for one in found], np.intp)
        errors = GatheredCells((self._former, self._fresh), ERROR, firsts)
        failed = [(one.label, text) for one, text in zip(found, errors[:], strict=True) if text]
        return TabulatedFiles(
            output=self._output,
            files=len(found),
            read=self._read,
            failed=len(failed),
            errors=tuple(failed[:_ERRORS_KEPT]),
        )


def _cut(found: Sequence[FoundRecording], tasks: Iterator[_Task]) -> Iterator[list[_Task]]:
    """Yield chunks of work: few large files, or some small ones."""
    most = max(1, min(_CHUNK_FILES, len(found) // _CHUNK_FILES))
    chunk: list[_Task] = []
    for task in tasks:
        chunk.append(task)
        if len(chunk) == most or sum(one.size for one, _ in chunk) > _CHUNK_BYTES:
            yield chunk
            chunk = []
    if chunk:
        yield chunk


def _name_chunk(chunk: Sequence[_Task]) -> str:
    more = f" and {len(chunk) - 1} more" if len(chunk) > 1 else ""
    return f"{chunk[0][0].label}{more}"


def _read_chunk(chunk: Sequence[_Task], *, work: Callable[[str], Sequence[Row]]) -> list[FileRows]:
    return [_read_one(one, known, work) for one, known in chunk]


def _read_one(
    one: FoundRecording, known: str | None, work: Callable[[str], Sequence[Row]]
) -> FileRows:
    # The hash comes first: of a file that changes meanwhile it is that of the former content, and
    # the next call finds another.
    try:
        sha256 = hash_recording(Path(one.path))
    except (OSError, LogError):
        sha256 = None  # what cannot be opened now may be later, unchanged
    state = (one.size, one.mtime_ns, sha256)
    if sha256 is not None and sha256 == known:
        return FileRows.pack(one.label, state, [])
    try:
        rows = work(one.path)
    except LibraryError as err:
        rows, state = [{ERROR: str(err)}], (*state[:2], None)  # it may be installed meanwhile
    return FileRows.pack(one.label, state, rows or [{}])


_HASHED_BYTES: Final = 2**20


def hash_recording(path: Path) -> str:
    """Return the SHA-256 of a file, or of the names and contents of the files of a bag.

    Raises:
        OSError: Where one cannot be read.
        LogError: Where one is a pipe or a device.
    """
    files, whole = list_contents(path), hashlib.sha256()
    if files == [path]:
        with open_file(path) as stream:
            while piece := stream.read(_HASHED_BYTES):
                whole.update(piece)
        return whole.hexdigest()
    for file in files:
        whole.update(f"{file.name!r} {hash_recording(file)}\n".encode())
    return whole.hexdigest()
