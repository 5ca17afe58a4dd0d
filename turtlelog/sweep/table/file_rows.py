"""Files and their rows: from an existing table, and from files read since."""

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass, field
from functools import partial
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from turtlelog.sweep.table.kept_parts import KeptParts
from turtlelog.sweep.table.result_table import (
    ResultColumn,
    ResultTable,
    StoredTable,
    cut_groups,
    list_values,
)
from turtlelog.sweep.table.row_columns import (
    Cell,
    CellType,
    Columns,
    Key,
    StoredCells,
    StoredRows,
    WindowedRows,
    build_result_columns,
    parse_key,
)

FILE: Final = Key("file")
SIZE: Final = Key("size", "whole", "B")
CHANGED: Final = Key("mtime_ns", "whole", "ns")
HASH: Final = Key("sha256")
ERROR: Final = Key("error")
HEAD: Final = (FILE, SIZE, CHANGED, HASH, ERROR)
"""Columns of every table of recordings."""

_STATE: Final = HEAD[1:4]
Order = Callable[[Set[Key], Set[Key]], Sequence[Key]]


class FileState(msgspec.Struct, frozen=True, array_like=True):
    """Known facts of a file.

    Attributes:
        size: As in `FoundRecording`.
        mtime_ns: As in `FoundRecording`.
        sha256: SHA-256 of the content; None if the file must be read again in any case.
        first: Number of the file's first row.
        count: Number of the file's rows; 0 if the content is unchanged and its rows are already
            known.
    """

    size: int
    mtime_ns: int
    sha256: str | None
    first: int
    count: int


class ReadFiles(msgspec.Struct, frozen=True, array_like=True):
    """Rows read from some files.

    Attributes:
        files: States by label; rows are numbered from 0.
        count: Number of rows.
        columns: Name, type, unit and cells of each column.
    """

    files: dict[str, FileState]
    count: int
    columns: list[tuple[str, CellType, str, list[Cell]]]

    def __len__(self) -> int:
        return len(self.files)

    def pack(self) -> Columns:
        """Return the rows as columns."""
        packed = {
            Key(name, kind, unit): StoredCells.pack(kind, cells)
            for name, kind, unit, cells in self.columns
        }
        return Columns(self.count, packed)


_ERRORS_KEPT: Final = 10
_COLUMNS_LOOKED: Final = 512
"""Number of row columns that fit in memory; all metrics have about 450 columns."""


class FileRows:
    """Known facts of files. The rows of files are in the existing table and the partial file.

    Attributes:
        read: Number of files that were read.
    """

    def __init__(self, kept: KeptParts[ReadFiles], former: StoredTable | None) -> None:
        """Load the results of an interrupted call and the existing table."""
        self._kept, self._stored = kept, StoredRows()
        self._files: dict[str, FileState] = {}
        self.read = 0
        if former is not None:
            for group in range(len(former.group_rows)):
                self._enter_former(former, group)
        for place in kept.places:
            self._enter(kept.read(place), place)

    def _enter_former(self, former: StoredTable, group: int) -> None:
        """Find the files of a group of rows in the existing table."""
        row = self._stored.add(former.group_rows[group], partial(_load_group, former, group))
        heads = map(list_values, former.read([key.name for key in HEAD[:4]], group))
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
        row = self._stored.add(chunk.count, partial(self._load, place))
        for label, state in chunk.files.items():
            rows = row + state.first, state.count
            if not state.count:
                known = self._files[label]
                rows = known.first, known.count
            self._files[label] = FileState(state.size, state.mtime_ns, state.sha256, *rows)

    def _load(self, place: int) -> Columns:
        return self._kept.read(place).pack()

    def assemble(
        self, labels: Sequence[str], kind: str, facts: Mapping[str, str], order: Order
    ) -> "FileTable":
        """Return the table of files, whose rows are loaded on demand.

        Args:
            labels: Labels of the files, in order.
            kind: As in `ResultTable`.
            facts: As in `ResultTable`.
            order: As in `RecordingTable`.
        """
        states = [self._files[label] for label in labels]
        counts = np.array([state.count for state in states], np.intp)
        which = np.repeat(np.arange(len(states)), counts)
        begins = np.cumsum(counts) - counts
        firsts = np.array([state.first for state in states], np.intp)
        rows = WindowedRows(self._stored, np.arange(len(which)) + (firsts - begins)[which])
        looked = _look_through(rows, begins)
        columns = (
            _repeat(FILE, labels, which),
            *(_repeat(key, [getattr(one, key.name) for one in states], which) for key in _STATE),
            *build_result_columns(rows, (ERROR, *order(looked.keys, looked.used))),
        )
        return FileTable(
            table=ResultTable(kind=kind, columns=columns, facts=facts),
            failed=looked.failed,
            errors=tuple((labels[file], text) for file, text in looked.errors),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class FileTable:
    """A table of files, and the files that cannot be read.

    Attributes:
        table: Table whose rows are loaded on demand.
        failed: Number of files that cannot be read.
        errors: Label and reason of the first files that cannot be read.
    """

    table: ResultTable
    failed: int
    errors: tuple[tuple[str, str], ...]


@dataclass(slots=True)
class _Looked:
    """Contents of rows: column keys, keys with a cell that is not None, and errors of files."""

    keys: set[Key] = field(default_factory=set)
    used: set[Key] = field(default_factory=set)
    failed: int = 0
    errors: list[tuple[int, str]] = field(default_factory=list)


def _look_through(rows: WindowedRows, begins: NDArray[np.intp]) -> _Looked:
    """Return the contents of rows. The error of a file is in the first row of the file."""
    looked = _Looked()
    for stretch in cut_groups(len(rows), _COLUMNS_LOOKED):
        cells = rows.load(stretch).cells
        looked.keys |= cells.keys() - {*HEAD}
        looked.used |= {key for key in cells.keys() - looked.used if cells[key].has_value.any()}
        if ERROR in cells:
            first, last = np.searchsorted(begins, (stretch.start, stretch.stop))
            places = begins[first:last] - stretch.start
            failed = np.flatnonzero(cells[ERROR].has_value[places])
            looked.failed += len(failed)
            for file in failed[: _ERRORS_KEPT - len(looked.errors)].tolist():
                looked.errors.append((int(first) + file, cells[ERROR][places[file]]))
    looked.used -= {*HEAD}
    return looked


def _repeat(key: Key, cells: Sequence[Cell], which: NDArray[np.intp]) -> ResultColumn:
    packed = StoredCells.pack(key.type, cells).take(which)
    return ResultColumn(name=key.name, type=key.type, cells=packed, unit=key.unit or None)


def _load_group(former: StoredTable, group: int) -> Columns:
    """Return the rows of a group of an existing table, without the facts of its files."""
    known = {key.name for key in HEAD[:4]}
    columns = former.read([name for name in former.names if name not in known], group)
    keys = ((parse_key(column), column.cells) for column in columns)
    packed = {key: StoredCells.pack_arrow(key.type, cells) for key, cells in keys}
    return Columns(former.group_rows[group], packed)
