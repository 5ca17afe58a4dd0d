"""Rows of tables and of files in columns: most parts are on disk, a few in memory."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, Literal, NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray

from turtlelog.libraries import load_library
from turtlelog.log.parquet_file import list_cells
from turtlelog.sweep.table.kept_parts import KeptParts
from turtlelog.sweep.table.result_table import (
    ResultColumn,
    ResultTable,
    StoredTable,
    build_numbers,
    build_texts,
    cut_groups,
)

Cell = str | int | float | None
CellType = Literal["text", "real", "whole"]


class Key(NamedTuple):
    """Name, type and unit of a column; a name with several units has several columns."""

    name: str
    type: CellType = "text"
    unit: str = ""


Row = Mapping[Key, Cell]
_NONES: Final[Mapping[str, Any]] = {"text": -1, "real": np.nan, "whole": -(2**63)}
_NUMBERS: Final = {"text": np.int32, "real": np.float64, "whole": np.int64}


class StoredCells(Sequence[Any]):
    """The cells of one column: 8 bytes per number, 4 per text. Repeated texts are mostly shared."""

    def __init__(self, kind: CellType, numbers: NDArray[Any], texts: Sequence[str] = ()) -> None:
        """Store numbers, or for texts the indices into the list of texts."""
        self._kind, self._numbers, self._texts = kind, numbers, list(texts)

    @classmethod
    def pack(cls, kind: CellType, cells: Iterable[Any]) -> "StoredCells":
        """Return cells from Python values."""
        none = _NONES[kind]
        if kind != "text":
            numbers = [none if cell is None else cell for cell in cells]
            return cls(kind, np.array(numbers, _NUMBERS[kind]))
        codes: dict[str, int] = {}
        found = [none if cell is None else codes.setdefault(cell, len(codes)) for cell in cells]
        return cls(kind, np.array(found, _NUMBERS[kind]), list(codes))

    @classmethod
    def pack_arrow(cls, kind: CellType, cells: Any) -> "StoredCells":
        """Return cells from an Arrow array."""
        texts: Sequence[str] = ()
        if kind == "text":
            encoded = cells.combine_chunks().dictionary_encode()
            cells, texts = encoded.indices, encoded.dictionary.to_pylist()
        if kind != "real":
            cells = load_library("pyarrow.compute").fill_null(cells, _NONES[kind])
        return cls(kind, cells.to_numpy(zero_copy_only=False).astype(_NUMBERS[kind]), texts)

    @classmethod
    def fill(cls, kind: CellType, count: int) -> "StoredCells":
        """Return a number of cells without a value."""
        return cls(kind, np.full(count, _NONES[kind], _NUMBERS[kind]))

    def take(self, rows: NDArray[np.intp]) -> "StoredCells":
        """Return the cells of some rows."""
        return StoredCells(self._kind, self._numbers[rows], self._texts)

    def put(self, places: NDArray[np.intp], other: "StoredCells", rows: NDArray[np.intp]) -> None:
        """Copy cells of another column of the same kind to given rows of this column."""
        numbers = other._numbers[rows]
        if other._texts:
            numbers = np.where(numbers < 0, -1, numbers + len(self._texts))
            self._texts += other._texts
        self._numbers[places] = numbers

    def __len__(self) -> int:
        return len(self._numbers)

    def __getitem__(self, place: Any) -> Any:
        if isinstance(place, slice):
            return StoredCells(self._kind, self._numbers[place], self._texts)
        number = self._numbers[place].item()
        if number == _NONES[self._kind] or number != number:  # noqa: PLR0124 - of a NaN it is
            return None
        return self._texts[number] if self._kind == "text" else number

    @property
    def has_value(self) -> NDArray[np.bool_]:
        """Return for each row whether its cell has a value."""
        has: NDArray[np.bool_] = self._numbers != _NONES[self._kind]
        return has & ~np.isnan(self._numbers) if self._kind == "real" else has

    def build_arrow(self) -> Any:
        """Return the cells as an Arrow array."""
        has_value = self.has_value
        if self._kind != "text":
            pa = load_library("pyarrow")
            kind = pa.int64() if self._kind == "whole" else pa.float64()
            return build_numbers(self._numbers, has_value, kind)
        texts = ["" if number < 0 else self._texts[number] for number in self._numbers.tolist()]
        return build_texts(texts, has_value)


@dataclass(frozen=True, slots=True)
class Columns:
    """Rows stored as columns; cells of missing keys are None."""

    count: int
    cells: Mapping[Key, StoredCells]


class StoredRows:
    """Rows in parts that are loaded on demand."""

    def __init__(self) -> None:
        self.ends = [0]
        self.loads: list[Callable[[], Columns]] = []

    def add(self, count: int, load: Callable[[], Columns]) -> int:
        """Add a part, and return the number of its first row."""
        self.loads.append(load)
        self.ends.append(self.ends[-1] + count)
        return self.ends[-2]


class WindowedRows:
    """Stored rows in a given order, with one segment in memory."""

    def __init__(self, stored: StoredRows, order: NDArray[np.intp] | range) -> None:
        """Store the rows and the row numbers in order."""
        self._stored, self._order = stored, order
        self._stretch, self._held = (0, 0), Columns(0, {})

    def __len__(self) -> int:
        return len(self._order)

    def load(self, segment: slice) -> Columns:
        """Return a segment of the rows; each part is loaded once."""
        begin, end, _ = segment.indices(len(self))
        if (begin, end) == self._stretch:
            return self._held
        rows, ends = np.asarray(self._order[begin:end], np.intp), np.array(self._stored.ends)
        parts = np.searchsorted(ends, rows, "right") - 1
        found: dict[Key, StoredCells] = {}
        for part in np.unique(parts).tolist():
            places = np.flatnonzero(parts == part)
            for key, cells in self._stored.loads[part]().cells.items():
                if key not in found:
                    found[key] = StoredCells.fill(key.type, len(rows))
                found[key].put(places, cells, rows[places] - ends[part])
        self._stretch, self._held = (begin, end), Columns(len(rows), found)
        return self._held


class _Column(Sequence[Any]):
    """The cells of a key, for rows in a given order."""

    def __init__(self, rows: WindowedRows, key: Key) -> None:
        self._rows, self._key = rows, key

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, place: Any) -> Any:
        if not isinstance(place, slice):
            return self[place : place + 1][0]
        found = self._rows.load(place)
        return found.cells.get(self._key) or StoredCells.fill(self._key.type, found.count)


def build_result_columns(rows: WindowedRows, keys: Sequence[Key]) -> Iterator[ResultColumn]:
    """Yield the columns of keys. If a name has several units, the unit is appended to the name."""
    names = [key.name for key in keys]
    for key in keys:
        is_alone = names.count(key.name) == 1
        yield ResultColumn(
            name=key.name if is_alone else f"{key.name} [{key.unit}]",
            type=key.type,
            cells=_Column(rows, key),
            unit=key.unit or None,
        )


def parse_key(column: ResultColumn) -> Key:
    """Return the key of a column that `build_result_columns` created."""
    unit = column.unit or ""
    name = column.name.removesuffix(f" [{unit}]") if unit else column.name
    return Key(name, "text" if column.type == "truth" else column.type, unit)


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
    """Known facts of files. The rows of files are in the existing table and the partial file."""

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
    ) -> tuple[ResultTable, int, tuple[tuple[str, str], ...]]:
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
        table = ResultTable(kind=kind, columns=columns, facts=facts)
        return table, failed, tuple((labels[file], text) for file, text in errors)


def _look_through(
    rows: WindowedRows, begins: NDArray[np.intp]
) -> tuple[set[Key], set[Key], int, list[tuple[int, str]]]:
    """Return the keys of rows, those with a value, and number and first errors of failed files.

    The error of a file is in the first row of the file.
    """
    keys, used, count = set[Key](), set[Key](), 0
    errors: list[tuple[int, str]] = []
    for stretch in cut_groups(len(rows), _COLUMNS_LOOKED):
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


def _load_group(former: StoredTable, group: int) -> Columns:
    """Return the rows of a group of an existing table, without the facts of its files."""
    known = {key.name for key in HEAD[:4]}
    columns = former.read([name for name in former.names if name not in known], group)
    keys = ((parse_key(column), column.cells) for column in columns)
    packed = {key: StoredCells.pack_arrow(key.type, cells) for key, cells in keys}
    return Columns(former.group_rows[group], packed)
