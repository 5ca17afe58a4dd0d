"""Reading of text and Parquet tables as named columns of cells."""

import csv
import re
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np

from turtlelog.errors import LogError
from turtlelog.files.text_files import BLANKS_AND_COMMENTS, describe_csv_error, iterate_lines
from turtlelog.log.file_access import open_file
from turtlelog.log.parquet_file import ParquetFile, count_most_rows, describe_rows, list_cells

_TUM_COLUMNS: Final = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
"""Columns of a TUM trajectory, which has no header: time, position, quaternion."""

KITTI_COLUMNS: Final = (
    *("r11", "r12", "r13", "tx", "r21", "r22", "r23", "ty", "r31", "r32", "r33", "tz"),
)
"""Columns of a KITTI trajectory, which has neither header nor times.

The columns contain the first three rows, one after another, of the matrix from the robot's frame to
the world frame."""

_NUMBER: Final = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)(e[+-]?\d+)?|[+-]?(nan|inf)|", re.I)
_LONGEST_HEAD: Final = 64 * 1024
"""Longest first line with column names, or longest comments above it [bytes]: 250 states with names
of 60 letters, and the other columns, fit."""

_MOST_COLUMNS: Final = 10_000
"""Largest number of columns: turtlelog's tables have 30, tables of robot models hundreds. Names are
searched once for each quantity, which takes 1 s."""

_MOST_KNOWN: Final = 2**14
"""Number of cell texts that are stored only once: all numbers of three digits with a decimal
point."""

_BLANK: Final = " "
"""Delimiter that means any number of spaces and tabs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlainTable:
    """A table as in its file.

    Attributes:
        names: Column names in the header.
        columns: Reader of the cells, from the first row on. Cells are texts, or numbers of Parquet.
        word: Word for the number of a row: `line` or `row`.
        has_header: Whether the file names its columns. Trajectories of TUM and KITTI have no names.
        units: Known units of columns: times of Parquet are in ns, those of TUM in s.
    """

    names: tuple[str, ...]
    columns: "_TextColumns | _StoredColumns"
    word: str
    has_header: bool = True
    units: Mapping[str, str] = field(default_factory=dict)


def read_plain_table(path: Path) -> PlainTable:
    """Return the table in a text file or a Parquet file.

    Raises:
        LogError: If the file is not a table, has neither a header nor a trajectory, or has no rows.
    """
    if path.suffix.lower() == ".parquet":
        return _read_parquet(path)
    with open_file(path) as stream:
        data = stream.read()
    return _parse_text(decode_text(data), len(data))


def decode_text(data: bytes) -> str:
    """Return the text of a table or log; spreadsheet programs write a byte order mark first."""
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as err:
        found = f"0x{err.object[err.start]:02x}"
        raise LogError(f"byte {err.start}: expected UTF-8 text, found {found}") from err


def read_header(path: Path) -> tuple[str, ...]:
    """Return the column names without reading rows; for text files the cells of the first line.

    Raises:
        ValueError: If a file with the suffix of Parquet is not a Parquet file.
    """
    if path.suffix.lower() != ".parquet":
        with open_file(path) as stream:
            head = stream.readline(_LONGEST_HEAD).decode("utf-8-sig", errors="replace")
        return tuple(head.strip().split(","))
    return tuple(ParquetFile(path).schema.names)


def _parse_text(text: str, size: int) -> PlainTable:
    comments, first, has_more = _find_first_row(text)
    if not first:
        raise LogError("expected a table, found no rows")
    delimiter = _find_delimiter(first)
    require_few_columns(_count_cells(first, delimiter))
    header = _split_line(first, delimiter)
    has_header = True
    is_first = all(map(_is_number, header))
    if is_first:
        has_header, header = _find_names(comments, delimiter, len(header))
    elif not has_more:
        raise LogError(f"no rows below the header {_list(header)}")
    return PlainTable(
        names=tuple(header),
        columns=_TextColumns(text, delimiter, len(header), size, is_first=is_first),
        word="line",
        has_header=has_header,
        units={} if has_header else {"timestamp": "s", "tx": "m", "ty": "m", "tz": "m"},
    )


def require_few_columns(columns: int) -> None:
    """Refuse a table with too many columns."""
    if columns > _MOST_COLUMNS:
        raise LogError(
            f"the table has more than {_MOST_COLUMNS:,} columns. Write fewer columns: a drive needs"
            " time, x, y, heading and the commands"
        )


def _find_first_row(text: str) -> tuple[list[str], str, bool]:
    """Return the last comments before the first row, that row, and whether there are more rows."""
    rows = iterate_lines(text, comments=False)
    _, first = next(rows, (0, ""))
    begin = BLANKS_AND_COMMENTS.match(text).end()  # type: ignore[union-attr]  # of none, too
    above = text[max(0, begin - _LONGEST_HEAD) : begin].split("\n")
    comments = [line.strip().lstrip("#").strip() for line in above]
    return comments, first.strip(), next(rows, None) is not None


def _count_cells(line: str, delimiter: str) -> int:
    return len(line.split(None if delimiter == _BLANK else delimiter, _MOST_COLUMNS))


def _find_delimiter(line: str) -> str:
    return next((delimiter for delimiter in (";", "\t", ",") if delimiter in line), _BLANK)


def _find_names(comments: Sequence[str], delimiter: str, count: int) -> tuple[bool, list[str]]:
    """Return column names of a file without a header: from its last comment, or of TUM or KITTI."""
    for comment in reversed(comments):
        for candidate in dict.fromkeys((delimiter, _find_delimiter(comment))):
            if _count_cells(comment, candidate) > _MOST_COLUMNS:
                continue
            names = _split_line(comment, candidate)
            if len(names) == count and not any(map(_is_number, names)):
                return True, names
    for known in (_TUM_COLUMNS, KITTI_COLUMNS):
        if count == len(known):
            return False, [*known]
    raise LogError(
        "expected a header that names the columns, the 8 columns of a TUM trajectory"
        f" ({' '.join(_TUM_COLUMNS)}) or the 12 of KITTI, found {count} columns without names"
    )


class _TextColumns:
    """The columns of a table of text, and the line of each row, known after the first reading."""

    def __init__(self, text: str, delimiter: str, count: int, size: int, *, is_first: bool) -> None:
        """Use a text whose lines have `count` cells; the file has `size` bytes.

        The first row contains either names or already values (`is_first`).
        """
        self._text, self._delimiter, self._count = text, delimiter, count
        self._size, self._is_first = size, is_first
        self.lines: Sequence[int] = ()

    def read(self, places: Sequence[int]) -> list[Sequence[Any]]:
        """Return the cells of some columns."""
        found: list[list[str]] = [[] for _ in places]
        lines, most, known = array("q"), count_most_rows(self._size), dict[str, str]()
        pairs = [*zip(places, found, strict=True)]
        for line, row in self._iterate_rows():
            if len(row) != self._count:
                raise LogError(f"line {line}: expected {self._count} cells, found {len(row)}")
            if len(lines) == most:
                raise LogError(describe_rows(f"more than {most:,}", most, self._size))
            lines.append(line)
            for place, cells in pairs:
                cell = row[place].strip()
                if self._delimiter != ",":
                    cell = _replace_comma(cell)
                # Numbers with few digits repeat.
                cells.append(known.get(cell, cell))
                if len(known) < _MOST_KNOWN:
                    known[cell] = cell
        self.lines = lines
        return [*found]

    def _iterate_rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield the rows below the header with their line numbers."""
        rows = _split_lines(iterate_lines(self._text, comments=False), self._delimiter)
        if not self._is_first:
            next(rows)
        yield from rows


def _split_lines(
    kept: Iterable[tuple[int, str]], delimiter: str
) -> Iterator[tuple[int, list[str]]]:
    if delimiter == _BLANK:
        for number, line in kept:
            yield number, line.split()
        return
    numbers: list[int] = []

    def feed() -> Iterator[str]:
        for number, line in kept:
            numbers.append(number)
            yield line

    reader = csv.reader(feed(), delimiter=delimiter, skipinitialspace=True, strict=True)
    try:
        for row in reader:
            if len(numbers) != 1:
                raise LogError("expected one row per line, found a quoted cell over several")
            yield numbers.pop(), row
    except csv.Error as err:
        raise LogError(
            f"line {numbers[0]}: expected cells, found {describe_csv_error(err)}"
        ) from err


def _split_line(line: str, delimiter: str) -> list[str]:
    if delimiter != _BLANK:
        ((_, row),) = _split_lines([(1, line)], delimiter)
        return [cell.strip() for cell in row]
    # A blank may separate a name from its unit: `yaw [deg]`.
    return re.findall(r"\S+(?:[ \t]+(?:\[[^\]\s]*\]|\([^)\s]*\)))?", line)


def _is_number(cell: str) -> bool:
    return bool(_NUMBER.fullmatch(cell.strip()))


def _replace_comma(cell: str) -> str:
    """Return a number with a decimal point instead of a comma."""
    return cell.replace(",", ".") if "," in cell and _is_number(cell) else cell


def _list(names: Sequence[str]) -> str:
    return ", ".join(names)[:160]


def _read_parquet(path: Path) -> PlainTable:
    file = ParquetFile(path)
    file.require_rows()
    if not file.row_count:
        raise LogError("no rows")
    require_few_columns(len(file.leaves))
    columns = _StoredColumns(file)
    return PlainTable(
        names=tuple(columns.names),
        columns=columns,
        word="row",
        units={leaf.path: "ns" for leaf in file.leaves if leaf.logical_type.type == "TIMESTAMP"},
    )


class _StoredColumns:
    """The columns of a Parquet file, with dots in names within structs, and the row numbers."""

    def __init__(self, file: ParquetFile) -> None:
        self._file, self.names = file, [leaf.path for leaf in file.leaves]
        self.lines: Sequence[int] = range(1, file.row_count + 1)

    def read(self, places: Sequence[int]) -> list[Sequence[Any]]:
        """Return the cells of some columns."""
        return [self._read_one(self.names[place]) for place in places]

    def _read_one(self, name: str) -> Sequence[Any]:
        table = self._file.read([name])
        while any(str(kind).startswith("struct") for kind in table.schema.types):
            table = table.flatten()
        if table.num_columns != 1:
            raise LogError(f"column {name}: expected one of that name, found {table.num_columns}")
        return _unpack(table.column(0))


def _unpack(column: Any) -> Sequence[Any]:
    """Return the cells of a column: numbers, times in ns, or else texts; null becomes empty."""
    if not str(column.type).startswith(("dictionary", "string", "large_string")):
        values = column.to_numpy()
        if values.dtype.kind == "M":
            found: Sequence[Any] = values.astype("datetime64[ns]").astype(np.int64)
            return found
        if values.dtype.kind in "iuf":
            return values  # type: ignore[no-any-return]
    return ["" if cell is None else str(cell) for cell in list_cells(column)]
