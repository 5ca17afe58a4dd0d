"""Tables of results in Parquet files: columns with units, and facts about the table."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError, SweepError
from turtlelog.files.urls import is_there
from turtlelog.libraries import __version__, load_library
from turtlelog.log.file_access import name_file, replace_when_complete
from turtlelog.log.parquet_file import ParquetFile, list_cells

ColumnType = Literal["whole", "real", "text", "truth"]
"""Type of the cells of a column, in addition to null: int64, float64, text or boolean."""

FORMAT: Final = "1"  # version of the file metadata. Readers refuse newer versions
ROW: Final = "row"  # name of the column with row numbers

STATUS: Final = ".status"
"""Suffix of the column next to a metric, which contains the reasons for missing values."""

_PREFIX: Final = "turtlelog."
"""Prefix of turtlelog's names in the file metadata, next to those of Arrow and pandas."""

_MOST_GROUPED: Final = 131_072
_CELLS_GROUPED: Final = 2**19
"""Number of cells in a row group: 1 MB for a number column and 4 MB for all columns, about the
memory for writing and reading. For a million files with all metrics, there are 500 groups, whose
footer has 20 MB. Groups do not depend on how rows reach the writer, so equal tables are equal
files."""

_WHOLE: Final = range(-(2**63), 2**63)


class ComputedItems(Sequence[Any]):
    """A sequence whose segments are computed on demand."""

    def __init__(self, count: int, compute: Callable[[int, int], Sequence[Any]]) -> None:
        """Take the number of items, and the function of the first item and the one after."""
        self._count, self._compute = count, compute

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, place: Any) -> Any:
        if not isinstance(place, slice):
            return self[place : place + 1][0]
        begin, end, _ = place.indices(self._count)
        return self._compute(begin, end)


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultColumn:
    """A named column."""

    name: str  # name of the column: a dotted scenario key, or a metric id
    type: ColumnType  # type of the cells
    cells: Sequence[Any]  # cells, one per row; None for a missing value
    unit: str | None = None  # unit of the numbers; None for texts, counts and numbers used as names


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultTable:
    """Columns of equal length, and facts about the table."""

    kind: str  # command that wrote the table, such as `sweep`. Readers refuse other kinds
    columns: tuple[ResultColumn, ...]  # columns in order, with unique names
    facts: Mapping[str, str] = field(default_factory=dict)  # without `kind`, `format`, `version`
    version: str = __version__  # version of turtlelog that wrote the table

    @property
    def row_count(self) -> int:
        """Number of rows."""
        return len(self.columns[0].cells) if self.columns else 0

    def find(self, name: str) -> ResultColumn | None:
        """Return the column with a name; None if there is no such column."""
        return next((column for column in self.columns if column.name == name), None)


def choose_type(values: Iterable[Any]) -> ColumnType:
    """Return the type that stores values without loss; text if kinds are mixed."""
    kinds = {_find_type(value) for value in values if value is not None}
    if kinds == {"whole", "real"}:
        return "real"
    return kinds.pop() if len(kinds) == 1 else "text"


def _find_type(value: Any) -> ColumnType:
    if isinstance(value, bool):
        return "truth"
    if isinstance(value, int):
        return "whole" if value in _WHOLE else "text"
    return "real" if isinstance(value, float) else "text"


def write_result_table(table: ResultTable, path: str | Path) -> None:
    """Write a table as a Parquet file. The file gets its name when it is complete.

    Raises:
        LogError: If the file cannot be written, for example on a full disk.
        LibraryError: If pyarrow is not installed.
    """
    parquet, schema = load_library("pyarrow.parquet"), _build_schema(table)
    with (
        replace_when_complete(path) as temporary,
        temporary.open("wb") as stream,
        parquet.ParquetWriter(stream, schema, compression="zstd") as writer,
    ):
        for rows in cut_groups(table.row_count, len(table.columns)):
            writer.write_table(_build_rows(table, rows, schema))


def build_result_arrow(table: ResultTable) -> Any:
    """Return a table as the `pyarrow.Table` that its file contains."""
    return _build_rows(table, slice(None), _build_schema(table))


def _build_rows(table: ResultTable, rows: slice, schema: Any) -> Any:
    columns = zip(table.columns, schema.types, strict=True)
    arrays = [_build_array(column, rows, kind) for column, kind in columns]
    return load_library("pyarrow").table(arrays, schema=schema)


def cut_groups(row_count: int, column_count: int) -> Iterator[slice]:
    """Yield the row groups in which a table is written and should be computed."""
    size = min(_MOST_GROUPED, max(1, _CELLS_GROUPED // max(1, column_count)))
    for first in range(0, row_count, size):
        yield slice(first, min(first + size, row_count))


def _build_schema(table: ResultTable) -> Any:
    pa = load_library("pyarrow")
    kinds = {"whole": pa.int64(), "real": pa.float64(), "text": pa.string(), "truth": pa.bool_()}
    units = [None if column.unit is None else {"unit": column.unit} for column in table.columns]
    fields = [
        pa.field(column.name, kinds[column.type], metadata=unit)
        for column, unit in zip(table.columns, units, strict=True)
    ]
    own = {"kind": table.kind, "format": FORMAT, "version": table.version}
    texts = {f"{_PREFIX}{name}": text for name, text in {**table.facts, **own}.items()}
    return pa.schema(fields, metadata=dict(sorted(texts.items())))


def _build_array(column: ResultColumn, rows: slice, kind: Any) -> Any:
    cells = column.cells[rows]
    if hasattr(cells, "build_arrow"):
        return cells.build_arrow()
    numbers: NDArray[Any]
    if isinstance(cells, np.ndarray) and column.type != "text":
        numbers = cells.astype(_NUMBERS[column.type])
        return build_numbers(numbers, np.ones(len(numbers), np.bool_), kind)
    has_value = np.array([cell is not None for cell in cells], np.bool_)
    if column.type == "text":
        return build_texts(["" if cell is None else str(cell) for cell in cells], has_value)
    known = (cell for cell in cells if cell is not None)
    numbers = np.zeros(len(has_value), _NUMBERS[column.type])
    numbers[has_value] = np.fromiter(known, numbers.dtype, int(has_value.sum()))
    return build_numbers(numbers, has_value, kind)


_NUMBERS: Final = {"whole": np.int64, "real": np.float64, "truth": np.bool_}


def build_numbers(numbers: NDArray[Any], has_value: NDArray[np.bool_], kind: Any) -> Any:
    """Return numbers or truths as an Arrow array, null where there is no value.

    From buffers, because `pyarrow.array` loads pandas if it is installed, which takes longer than
    loading turtlelog.
    """
    pa = load_library("pyarrow")
    stored = _pack_bits(numbers) if numbers.dtype == np.bool_ else pa.py_buffer(numbers)
    mask = None if has_value.all() else _pack_bits(has_value)
    return pa.Array.from_buffers(kind, len(numbers), [mask, stored])


def build_texts(texts: Sequence[str], has_value: NDArray[np.bool_]) -> Any:
    """Return texts as an Arrow array, null where there is no value; see `build_numbers`."""
    pa, stored = load_library("pyarrow"), [text.encode() for text in texts]
    ends = np.zeros(len(stored) + 1, np.int32)
    np.cumsum([len(text) for text in stored], out=ends[1:])
    mask = None if has_value.all() else _pack_bits(has_value)
    buffers = [mask, pa.py_buffer(ends), pa.py_buffer(b"".join(stored))]
    return pa.Array.from_buffers(pa.string(), len(stored), buffers)


def _pack_bits(values: NDArray[np.bool_]) -> Any:
    return load_library("pyarrow").py_buffer(np.packbits(values, bitorder="little"))


def has_result_file(path: Path) -> bool:
    """Return whether a file, or an object behind a URL, exists; LogError if this is unknown."""
    with name_file(path, expected="a place that can be looked at"):
        return is_there(path)


def read_result_facts(path: str | Path) -> Mapping[str, str] | None:
    """Return the `kind`, the `version` and the facts of the table in a file.

    The result is None if the Parquet file is not a result table of turtlelog.

    Raises:
        LogError: If the file is not a Parquet file, is truncated, or is from a newer turtlelog.
        LibraryError: If pyarrow is not installed.
    """
    with _name_table(path):
        return _read_facts(ParquetFile(path).schema.metadata)


def read_result_table(
    path: str | Path, *, kind: str, columns: Sequence[str] | None = None
) -> ResultTable:
    """Return a table that `write_result_table` wrote.

    Args:
        path: The file.
        kind: Kind of the expected table, such as `sweep`.
        columns: Names of the columns to read. Default: all.

    Raises:
        LogError: If the file cannot be read, is not a Parquet file, is truncated, or contains
            another table.
        LibraryError: If pyarrow is not installed.
    """
    return open_result_table(path, kind=kind).load(columns)


def list_row_numbers(cells: Sequence[Any] | None, count: int) -> Sequence[int]:
    """Return row numbers: the cells of the column `row` if they are unique, or else 0, 1, 2 ...

    Tables filtered or sorted by other programs keep their row numbers.
    """
    if cells is None or len(set(cells)) < count or not all(type(one) is int for one in cells):
        return range(count)
    return cells


def open_result_table(path: str | Path, *, kind: str) -> "StoredTable":
    """Return a table whose row groups are read one by one; errors as in `read_result_table`."""
    stored = StoredTable(path)
    if stored.kind != kind:
        other = f"a table of {stored.kind}" if stored.kind else "another Parquet file"
        if not stored.kind and {ROW, "failed"} <= {*stored.names}:
            other = "its columns without its metadata, which pandas and polars do not keep"
        raise LogError(f"{path}: expected a table of {kind}, found {other}")
    return stored


class StoredTable:
    """A table in a file. The file is open only during reads and may be replaced between reads."""

    def __init__(self, path: str | Path) -> None:
        """Read the facts of the table; errors are as in `read_result_table`."""
        self._path = path
        with _name_table(path):
            self._file = ParquetFile(path)
            facts = dict(_read_facts(self._file.schema.metadata) or {})
        self.kind = facts.pop("kind", "")  # empty if the file is not a result table
        self.version = facts.pop("version", "")
        facts.pop("format", None)
        self.facts: Mapping[str, str] = facts
        self.names: Sequence[str] = self._file.schema.names  # of the columns
        self.group_rows = self._file.group_rows  # number of rows in each group

    @property
    def row_count(self) -> int:
        """Number of rows."""
        return self._file.row_count

    def read(
        self, columns: Sequence[str] | None = None, group: int | None = None
    ) -> list[ResultColumn]:
        """Return columns with Arrow arrays as cells, of one row group. Default: all."""
        with _name_table(self._path):
            return list(_iterate_columns(self._file.read(columns, group)))

    def load(self, columns: Sequence[str] | None = None) -> ResultTable:
        """Return the table with Python values as cells; by default all columns."""
        found = tuple(replace(one, cells=list_cells(one.cells)) for one in self.read(columns))
        return ResultTable(kind=self.kind, columns=found, facts=self.facts, version=self.version)

    def read_row(self, row: int, names: Sequence[str]) -> list[Any]:
        """Return the cells of columns in a row as Python values; KeyError for an unknown column."""
        group = 0
        while row >= self.group_rows[group]:
            row, group = row - self.group_rows[group], group + 1
        found = {one.name: list_cells(one.cells)[row] for one in self.read(names, group)}
        return [found[name] for name in names]

    def find_row(self, number: int) -> int:
        """Return the position of the row with a number; SweepError if there is none."""
        has_numbers, is_place = ROW in self.names, 0 <= number < self.row_count
        if is_place and (not has_numbers or self.read_row(number, [ROW]) == [number]):
            return number
        cells = None
        if has_numbers:
            cells = [cell for one in self.iterate(ROW) for cell in one.to_pylist()]
        numbers = list_row_numbers(cells, self.row_count)
        if number in numbers:
            return numbers.index(number)
        if not numbers:
            raise SweepError(f"{self._path}: the table has no rows")
        ends = f"{min(numbers)} to {max(numbers)}"
        raise SweepError(f"{self._path}: expected a row from {ends}, found {number}")

    def iterate(self, name: str) -> Iterator[Any]:
        """Yield the cells of a column group by group, as Arrow arrays."""
        for group in range(len(self.group_rows)):
            for column in self.read([name], group):
                yield column.cells

    def count_values(self, name: str) -> int:
        """Return the number of cells with a value, without reading the cells."""
        place, groups = self.names.index(name), range(len(self.group_rows))
        chunks = (self._file.metadata.row_group(group).column(place) for group in groups)
        return sum(chunk.statistics.num_values for chunk in chunks)


def _name_table(path: str | Path) -> AbstractContextManager[None]:
    return name_file(path, expected="a complete Parquet file")


def _read_facts(metadata: Mapping[bytes, bytes] | None) -> Mapping[str, str] | None:
    texts = {key.decode(): text.decode() for key, text in (metadata or {}).items()}
    own = {key: text for key, text in texts.items() if key.startswith(_PREFIX)}
    facts = {key.removeprefix(_PREFIX): text for key, text in own.items()}
    if not {"kind", "format", "version"} <= facts.keys():
        return None
    if facts["format"] != FORMAT:
        raise LogError(
            f"expected a table of format {FORMAT}, found format {facts['format'][:20]} of turtlelog"
            f" {facts['version'][:20]}: a newer one reads it"
        )
    return facts


_TYPES: Final[Mapping[str, ColumnType]] = {
    **dict.fromkeys(("int64", "int32", "int16", "int8", "uint32", "uint16", "uint8"), "whole"),
    **dict.fromkeys(("double", "float", "halffloat"), "real"),
    "bool": "truth",
    **dict.fromkeys(("string", "large_string", "string_view", "null"), "text"),
}
"""Column types by Arrow's type names, including types that other programs write."""


def _iterate_columns(table: Any) -> Iterator[ResultColumn]:
    pa = load_library("pyarrow")
    text = pa.dictionary(pa.int32(), pa.string())
    stored = {"whole": pa.int64(), "real": pa.float64(), "truth": pa.bool_(), "text": text}
    for one, cells in zip(table.schema, table.columns, strict=True):
        kind = _TYPES.get(str(getattr(one.type, "value_type", one.type)))
        if kind is None or pa.types.is_nested(one.type):
            raise LogError(f"{one.name}: expected numbers, texts or truths, found {one.type}")
        unit = (one.metadata or {}).get(b"unit")
        yield ResultColumn(
            name=one.name,
            type=kind,
            cells=cells if one.type == stored[kind] else cells.cast(stored[kind]),
            unit=None if unit is None else unit.decode(),
        )
