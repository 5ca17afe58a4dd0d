"""Tables of results as Parquet files: columns with units, and what the whole file is about.

The same table gives the same bytes, with the same pyarrow.
"""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

from turtlelog.errors import LogError
from turtlelog.libraries import load_library
from turtlelog.log.complete_files import replace_when_complete
from turtlelog.log.error_boundary import name_file, open_file
from turtlelog.version import __version__

ColumnType = Literal["whole", "real", "text", "truth"]
"""What the cells of a column are, beside null: int64, float64, strings, or true and false."""

FORMAT: Final = "1"
"""Version of the file metadata; a reader refuses newer ones."""

_PREFIX: Final = "turtlelog."

_ROW_GROUP: Final = 131_072
"""Rows in a group: 1 MB of a column of numbers, and whoever reads one group needs no more memory.
However rows come to the writer, groups are cut here, so that bytes do not depend on it."""

_WHOLE: Final = range(-(2**63), 2**63)


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultColumn:
    """A named column.

    Attributes:
        name: As queries name it: the dotted key of a scenario, or the id of a metric.
        type: Of its cells.
        cells: One per row; None where there is no value.
        unit: Of its numbers; None of texts, and of numbers that only count or name.
    """

    name: str
    type: ColumnType
    cells: Sequence[Any]
    unit: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultTable:
    """Columns of one length, and what the file says about all of them.

    Attributes:
        kind: What made it, as in `sweep`: a reader of one kind refuses others.
        columns: In their order; names differ.
        facts: Texts by name; `kind`, `format` and `version` are the table's own.
        version: Of the turtlelog that wrote it.
    """

    kind: str
    columns: tuple[ResultColumn, ...]
    facts: Mapping[str, str] = field(default_factory=dict)
    version: str = __version__

    @property
    def row_count(self) -> int:
        """How many rows it has."""
        return len(self.columns[0].cells) if self.columns else 0

    def find(self, name: str) -> ResultColumn | None:
        """Return the column of a name, None where there is none."""
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
        LogError: Where the place cannot be written, as on a full disk.
        LibraryError: Where pyarrow is not installed.
    """
    parquet, schema = load_library("pyarrow.parquet"), _build_schema(table)
    with (
        replace_when_complete(path) as temporary,
        temporary.open("wb") as stream,
        parquet.ParquetWriter(stream, schema, compression="zstd") as writer,
    ):
        for first in range(0, table.row_count, _ROW_GROUP):
            rows = slice(first, first + _ROW_GROUP)
            arrays = [
                _build_array(column, rows, kind)
                for column, kind in zip(table.columns, schema.types, strict=True)
            ]
            writer.write_table(load_library("pyarrow").table(arrays, schema=schema))


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
    texts = {f"{_PREFIX}{name}": text for name, text in {**table.facts, **own}.items()}
    return pa.schema(fields, metadata=dict(sorted(texts.items())))


def _build_array(column: ResultColumn, rows: slice, kind: Any) -> Any:
    cells = column.cells[rows]
    if column.type == "text":
        cells = [cell if cell is None or isinstance(cell, str) else str(cell) for cell in cells]
    elif column.type == "real" and isinstance(cells, list | tuple):
        cells = [None if cell is None else float(cell) for cell in cells]
    return load_library("pyarrow").array(cells, kind)


def read_result_facts(path: str | Path) -> Mapping[str, str] | None:
    """Return what a file says about itself: `kind`, `version` and the facts of its table.

    None where it is a Parquet file that turtlelog wrote no table of results to.

    Raises:
        LogError: Where it is no Parquet file, is cut, or a newer turtlelog wrote it.
        LibraryError: Where pyarrow is not installed.
    """
    parquet = load_library("pyarrow.parquet")
    with _name_table(path), open_file(path) as stream:
        return _read_facts(parquet.read_schema(stream).metadata)


def read_result_table(
    path: str | Path, *, kind: str, columns: Sequence[str] | None = None
) -> ResultTable:
    """Return a table that `write_result_table` wrote.

    Args:
        path: The file.
        kind: Which table is expected, as in `sweep`.
        columns: Names of those to read; None: all.

    Raises:
        LogError: Where it cannot be read, is no Parquet file, is cut, or holds another table.
        LibraryError: Where pyarrow is not installed.
    """
    parquet = load_library("pyarrow.parquet")
    with _name_table(path), open_file(path) as stream:
        file = parquet.ParquetFile(stream)
        facts = dict(_read_facts(file.schema_arrow.metadata) or {})
        found, version = facts.pop("kind", None), facts.pop("version", "")
        facts.pop("format", None)
        if found != kind:
            other = "another Parquet file" if found is None else f"a table of {found}"
            raise LogError(f"expected a table of {kind}, found {other}")
        table = file.read(None if columns is None else list(columns))
    return ResultTable(kind=kind, columns=tuple(_list_columns(table)), facts=facts, version=version)


def _name_table(path: str | Path) -> AbstractContextManager[None]:
    return name_file(path, expected="a complete Parquet file")


def _read_facts(metadata: Mapping[bytes, bytes] | None) -> Mapping[str, str] | None:
    texts = {key.decode(): text.decode() for key, text in (metadata or {}).items()}
    facts = {
        key.removeprefix(_PREFIX): text for key, text in texts.items() if key.startswith(_PREFIX)
    }
    if not {"kind", "format", "version"} <= facts.keys():
        return None
    if facts["format"] != FORMAT:
        raise LogError(
            f"expected a table of format {FORMAT}, found format {facts['format'][:20]} of turtlelog"
            f" {facts['version'][:20]}: a newer one reads it"
        )
    return facts


def _list_columns(table: Any) -> Iterable[ResultColumn]:
    pa = load_library("pyarrow")
    types: dict[Any, ColumnType] = {
        pa.int64(): "whole",
        pa.float64(): "real",
        pa.bool_(): "truth",
        pa.string(): "text",
    }
    for one, cells in zip(table.schema, table.columns, strict=True):
        if one.type not in types:
            raise LogError(f"{one.name}: expected numbers, texts or truths, found {one.type}")
        unit = (one.metadata or {}).get(b"unit")
        yield ResultColumn(
            name=one.name,
            type=types[one.type],
            cells=cells.to_pylist(),
            unit=None if unit is None else unit.decode(),
        )
