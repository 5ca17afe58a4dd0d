"""A plain table, text or Parquet -> named columns of cells."""

import csv
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from turtlelog.errors import LogError
from turtlelog.log.error_boundary import open_file
from turtlelog.log.parquet_file import ParquetFile, list_cells

TUM_COLUMNS: Final = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
"""The columns of a TUM trajectory, which has no header: time, position, quaternion."""

_NUMBER: Final = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)(e[+-]?\d+)?|[+-]?(nan|inf)|", re.I)
_LONGEST_HEAD: Final = 64 * 1024
"""Bytes of a first line that may name columns: 250 states of 60 letters, and the rest, fit in."""

_BLANK: Final = " "
"""Stands for any number of spaces and tabs between cells."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlainTable:
    """A table as its file holds it.

    Attributes:
        names: Of the columns, as the header writes them.
        columns: Cells of each column, from the first row on: texts, or numbers of Parquet.
        lines: Number of each row in its file, from 1.
        word: What that number counts: `line` or `row`.
        has_header: Whether the file names its columns; a TUM trajectory does not.
        units: Of columns whose kind tells it: times of Parquet are in ns, those of TUM in s.
    """

    names: tuple[str, ...]
    columns: Sequence[Sequence[Any]]
    lines: Sequence[int]
    word: str
    has_header: bool = True
    units: Mapping[str, str] = field(default_factory=dict)


def read_plain_table(path: Path) -> PlainTable:
    """Return the cells of a table of text, or of a Parquet file.

    Raises:
        LogError: Where it is no table, has no header and is no TUM trajectory, or has no rows.
    """
    if path.suffix.lower() == ".parquet":
        return _read_parquet(path)
    with open_file(path) as stream:
        data = stream.read()
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as err:
        found = f"0x{err.object[err.start]:02x}"
        raise LogError(f"byte {err.start}: expected UTF-8 text, found {found}") from err
    return _parse_text(text)


def read_header(path: Path) -> tuple[str, ...]:
    """Return the names of the columns without the rows: of text the cells of its first line.

    Raises:
        ValueError: Where a file that is called so is no Parquet file.
    """
    if path.suffix.lower() != ".parquet":
        with open_file(path) as stream:
            head = stream.readline(_LONGEST_HEAD).decode("utf-8-sig", errors="replace")
        return tuple(head.strip().split(","))
    return tuple(ParquetFile(path).schema.names)


def _parse_text(text: str) -> PlainTable:
    comments, first = _find_first_row(text)
    if not first:
        raise LogError("expected a table, found no rows")
    delimiter = _find_delimiter(first)
    lines, rows = _split(text, delimiter)
    header, count = _split_line(first, delimiter), len(rows[0])
    if not all(map(_is_number, header)):
        lines, rows, has_header = lines[1:], rows[1:], True
    else:
        has_header, header = _find_names(comments, delimiter, count)
    if not rows:
        raise LogError(f"expected rows below the header {_list(header)}, found none")
    for line, row in zip(lines, rows, strict=True):
        if len(row) != len(header):
            raise LogError(f"line {line}: expected {len(header)} cells, found {len(row)}")
    if delimiter != ",":
        rows = [[_replace_comma(cell) for cell in row] for row in rows]
    columns = tuple(zip(*rows, strict=True))
    return PlainTable(
        names=tuple(header),
        columns=columns,
        lines=lines,
        word="line",
        has_header=has_header,
        units={} if has_header else {"timestamp": "s", "tx": "m", "ty": "m", "tz": "m"},
    )


def _find_first_row(text: str) -> tuple[list[str], str]:
    """Return the comments before the first row, and that row's line."""
    comments: list[str] = []
    for line in io.StringIO(text):
        stripped = line.strip()
        if stripped.startswith("#"):
            comments.append(stripped.lstrip("#").strip())
        elif stripped:
            return comments, stripped
    return comments, ""


def _find_delimiter(line: str) -> str:
    for delimiter in (";", "\t", ","):
        if delimiter in line:
            return delimiter
    return _BLANK


def _find_names(comments: Sequence[str], delimiter: str, count: int) -> tuple[bool, list[str]]:
    """Return the names of columns without a header: of a comment above them, or those of TUM."""
    for comment in reversed(comments):
        for candidate in dict.fromkeys((delimiter, _find_delimiter(comment))):
            names = _split_line(comment, candidate)
            if len(names) == count and not any(map(_is_number, names)):
                return True, names
    if count == len(TUM_COLUMNS):
        return False, [*TUM_COLUMNS]
    raise LogError(
        "expected a header that names the columns, or the 8 columns of a TUM trajectory"
        f" ({' '.join(TUM_COLUMNS)}), found {count} columns without names"
    )


def _split(text: str, delimiter: str) -> tuple[list[int], list[list[str]]]:
    """Return the rows and the number of each one's line; comments and empty lines are left out."""
    kept = [
        (number, line)
        for number, line in enumerate(io.StringIO(text), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    lines = [number for number, _ in kept]
    if delimiter == _BLANK:
        rows = [_split_line(kept[0][1], delimiter), *(line.split() for _, line in kept[1:])]
        return lines, rows
    return lines, _read_csv((line for _, line in kept), lines, delimiter)


def _read_csv(kept: Iterable[str], lines: Sequence[int], delimiter: str) -> list[list[str]]:
    rows: list[list[str]] = []
    try:
        for row in csv.reader(kept, delimiter=delimiter, skipinitialspace=True, strict=True):
            rows.append([cell.strip() for cell in row])
    except csv.Error as err:
        raise LogError(f"line {lines[len(rows)]}: expected cells, found: {err}") from err
    if len(rows) != len(lines):
        raise LogError("expected one row per line, found a quoted cell over several")
    return rows


def _split_line(line: str, delimiter: str) -> list[str]:
    if delimiter != _BLANK:
        (row,) = _read_csv([line], [1], delimiter)
        return row
    # A unit may stand apart from its name: `yaw [deg]`.
    return re.findall(r"\S+(?:[ \t]+(?:\[[^\]\s]*\]|\([^)\s]*\)))?", line)


def _is_number(cell: str) -> bool:
    return bool(_NUMBER.fullmatch(cell.strip()))


def _replace_comma(cell: str) -> str:
    """Return a number with the point that a comma stands for."""
    return cell.replace(",", ".") if "," in cell and _is_number(cell) else cell


def _list(names: Sequence[str]) -> str:
    return ", ".join(names)[:160]


def _read_parquet(path: Path) -> PlainTable:
    file = ParquetFile(path)
    if not file.row_count:
        raise LogError("expected rows, found none")
    columns = _StoredColumns(file)
    return PlainTable(
        names=tuple(columns.names),
        columns=columns,
        lines=range(1, file.row_count + 1),
        word="row",
        units={leaf.path: "ns" for leaf in file.leaves if leaf.logical_type.type == "TIMESTAMP"},
    )


class _StoredColumns(Sequence[Sequence[Any]]):
    """The columns of a Parquet file, each read when it is asked for.

    Attributes:
        names: Of the columns, those within structs with dots.
    """

    def __init__(self, file: ParquetFile) -> None:
        self._file, self.names = file, [leaf.path for leaf in file.leaves]

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, place: Any) -> Any:
        name = self.names[place]
        table = self._file.read([name])
        while any(str(kind).startswith("struct") for kind in table.schema.types):
            table = table.flatten()
        if table.num_columns != 1:
            raise LogError(f"column {name}: expected one of that name, found {table.num_columns}")
        return _unpack(table.column(0))


def _unpack(column: Any) -> Sequence[Any]:
    """Return the cells of a column: numbers, times in ns, else texts; null is empty."""
    if not str(column.type).startswith(("dictionary", "string", "large_string")):
        values = column.to_numpy()
        if values.dtype.kind == "M":
            found: Sequence[Any] = values.astype("datetime64[ns]").astype(np.int64)
            return found
        if values.dtype.kind in "iuf":
            return values  # type: ignore[no-any-return]
    return ["" if cell is None else str(cell) for cell in list_cells(column)]
