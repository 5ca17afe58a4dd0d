"""Tables of results, written as Parquet files: columns with units, and what the file is about.

The same table gives the same bytes, with the same pyarrow. `stored_table` reads them.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

from turtlelog.libraries import load_library
from turtlelog.log.complete_files import replace_when_complete
from turtlelog.version import __version__

ColumnType = Literal["whole", "real", "text", "truth"]
"""What the cells of a column are, beside null: int64, float64, strings, or true and false."""

FORMAT: Final = "1"
"""Version of the file metadata; a reader refuses newer ones."""

ROW: Final = "row"
"""The column of the rows' numbers."""

PREFIX: Final = "turtlelog."
"""Begins the names of what a file says about itself, among those of Arrow and pandas."""

_MOST_GROUPED: Final = 131_072
_CELLS_GROUPED: Final = 2**19
"""Rows and cells of a group: 1 MB of a column of numbers and 4 MB of all columns, which is about
what writing and reading need of memory; a million files with all metrics have 500 groups, of which
the end of the file tells in 20 MB. However rows come to the writer, groups are cut here, so that
bytes do not depend on it."""

_WHOLE: Final = range(-(2**63), 2**63)


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultColumn:
    """A named column.

    Attributes:
        name: Name in queries: the dotted key of a scenario, or the id of a metric.
        type: Type of its cells.
        cells: One per row; None if there is no value.
        unit: Unit of its numbers; None of texts, and of numbers that only count or name.
    """

    name: str
    type: ColumnType
    cells: Sequence[Any]
    unit: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultTable:
    """Columns of one length, and what the file says about all of them.

    Attributes:
        kind: Command that made it, such as `sweep`: a reader of one kind refuses others.
        columns: In their order; names differ.
        facts: Texts by name; `kind`, `format` and `version` are the table's own.
        version: Version of the turtlelog that wrote it.
    """

    kind: str
    columns: tuple[ResultColumn, ...]
    facts: Mapping[str, str] = field(default_factory=dict)
    version: str = __version__

    @property
    def row_count(self) -> int:
        """Number of rows."""
        return len(self.columns[0].cells) if self.columns else 0

    def find(self, name: str) -> ResultColumn | None:
        """Return the column of a name, None if there is none."""
        return next((column for column in self.columns if column.name == name), None)


def choose_type(values: Iterable[Any]) -> ColumnType:
    """Return the type that holds values without a loss; text where kinds are mixed."""
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
    """Write a table as a Parquet file, which appears under its name when it is complete.

    Raises:
        LogError: If the place cannot be written, as on a full disk.
        LibraryError: If pyarrow is not installed.
    """
    parquet, schema = load_library("pyarrow.parquet"), _build_schema(table)
    with (
        replace_when_complete(path) as temporary,
        temporary.open("wb") as stream,
        parquet.ParquetWriter(stream, schema, compression="zstd") as writer,
    ):
        for rows in cut_groups(table.row_count, len(table.columns)):
            arrays = [
                _build_array(column, rows, kind)
                for column, kind in zip(table.columns, schema.types, strict=True)
            ]
            writer.write_table(load_library("pyarrow").table(arrays, schema=schema))


def build_result_arrow(table: ResultTable) -> Any:
    """Return a table as the `pyarrow.Table` that its file holds."""
    schema, rows = _build_schema(table), slice(None)
    arrays = [
        _build_array(column, rows, kind)
        for column, kind in zip(table.columns, schema.types, strict=True)
    ]
    return load_library("pyarrow").table(arrays, schema=schema)


def cut_groups(row_count: int, column_count: int) -> Iterator[slice]:
    """Yield the groups in which the rows of a table are written, and best made."""
    size = min(_MOST_GROUPED, max(1, _CELLS_GROUPED // max(1, column_count)))
    for first in range(0, row_count, size):
        yield slice(first, min(first + size, row_count))


def _build_schema(table: ResultTable) -> Any:
    pa = load_library("pyarrow")
    kinds = {"whole": pa.int64(), "real": pa.float64(), "text": pa.string(), "truth": pa.bool_()}
    fields = [
        pa.field(
            column.name,
            kinds[column.type],
            metadata=None if column.unit is None else {"unit": column.unit},
        )
        for column in table.columns
    ]
    own = {"kind": table.kind, "format": FORMAT, "version": table.version}
    texts = {f"{PREFIX}{name}": text for name, text in {**table.facts, **own}.items()}
    return pa.schema(fields, metadata=dict(sorted(texts.items())))


def _build_array(column: ResultColumn, rows: slice, kind: Any) -> Any:
    cells = column.cells[rows]
    if hasattr(cells, "__arrow_array__"):
        return load_library("pyarrow").array(cells, kind)
    if column.type == "text":
        cells = [cell if cell is None or isinstance(cell, str) else str(cell) for cell in cells]
    elif column.type == "real" and isinstance(cells, list | tuple):
        cells = [None if cell is None else float(cell) for cell in cells]
    return load_library("pyarrow").array(cells, kind)
