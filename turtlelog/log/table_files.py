"""Files of plain tables: CSV, Parquet or TUM, as columns of cells; writing of TUM trajectories."""

import csv
import io
import re
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import describe_count, format_seconds
from turtlelog.errors import LogError
from turtlelog.files.text_files import BLANKS_AND_COMMENTS, describe_csv_error, iterate_lines
from turtlelog.files.urls import make_path
from turtlelog.log.engine.limits import count_most_rows, describe_rows
from turtlelog.log.file_access import decode_text, name_file, open_file, replace_when_complete
from turtlelog.log.parquet_file import ParquetFile, list_cells
from turtlelog.log.planar_poses import compute_heading
from turtlelog.log.units import is_row_of_units
from turtlelog.run import Lost, Run
from turtlelog.run.angles import wrap_angle

_TUM_COLUMNS: Final = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
"""Columns of a TUM trajectory, which has no header: time, position, quaternion."""

KITTI_COLUMNS: Final = (
    *("r11", "r12", "r13", "tx", "r21", "r22", "r23", "ty", "r31", "r32", "r33", "tz"),
)
"""Columns of a KITTI trajectory, without header and times: three rows of the robot's matrix."""

_NUMBER: Final = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)(e[+-]?\d+)?|[+-]?(nan|inf)|", re.I)

_SEPARATOR: Final = re.compile(r"sep=[,;\t]\s*\n", re.I)
"""First line of tables for Excel, which names the separator."""

_OTHER_COMMENTS: Final = re.compile(r"(?:\s++|#[^\n]*+)*+(?:%(?!time\b)|//)")
"""Text that begins with comments of MATLAB or C, not %time as in a header of ROS 1."""

_MOTION_CAPTURE: Final = re.compile(
    r"(?:(Objects|Segments|Trajectories|Joints|Model Outputs|Devices)[,;\t]*\s*\n|Format Version,)"
)
"""First line of tables by Vicon (a section) or OptiTrack."""

_MOST_KNOWN: Final = 2**14
"""Number of cell texts that are stored only once: all numbers of three digits with a decimal
point."""

_BLANK: Final = " "
"""Delimiter that means any number of spaces and tabs."""

LONGEST_HEAD: Final = 64 * 1024
"""Longest first line with column names, or comments above it [bytes]: 250 states of 60 letters
fit."""

MOST_COLUMNS: Final = 10_000
"""Largest number of columns: turtlelog's tables have 30, tables of robot models hundreds. Names are
searched once for each quantity, which takes 1 s."""

ROWS_AT_ONCE: Final = 4096
"""Number of rows converted to or from Python values at once; these take five times as many
bytes."""

_ROUNDED_RAD: Final = 2e-15
"""Rounding error of a heading after sine, cosine and arctangent [rad]: 4 float64 steps at pi."""


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


def read_plain_table(path: Path, *, allow_partial: bool = False) -> PlainTable:
    """Return the table in a text file or a Parquet file.

    A last row with too few cells, as after a power cut, is an error unless `allow_partial`.

    Raises:
        LogError: If the file is not a table, has neither a header nor a trajectory, or has no rows.
    """
    if path.suffix.lower() == ".parquet":
        return _read_parquet(path)
    with open_file(path) as stream:
        data = stream.read()
    return _parse_text(decode_text(data), len(data), allow_partial=allow_partial)


def _parse_text(text: str, size: int, *, allow_partial: bool) -> PlainTable:
    if _SEPARATOR.match(text):
        text = f"#{text}"
    if _OTHER_COMMENTS.match(text):
        text = re.sub(r"^(?=%|//)", "#", text, flags=re.MULTILINE)
    if motion_capture := _MOTION_CAPTURE.match(text):
        program = "Vicon" if motion_capture[1] else "OptiTrack"
        raise LogError(
            f"a table of {program} with several rows of names:"
            " keep one row of names, with a column of times and a name for each column"
        )
    comments, (first, second, third) = _find_first_rows(text)
    if not first:
        raise LogError("expected a table, found no rows")
    delimiter = _find_delimiter(first)
    require_few_columns(_count_cells(first, delimiter))
    header = _split_line(first, delimiter)
    has_header, units = True, dict[str, str]()
    is_first = all(map(_is_number, header))
    if is_first or (is_first := _is_row(header, second, delimiter)):
        has_header, header = _find_names(comments, delimiter, header)
        units = {} if has_header else {"timestamp": "s", "tx": "m", "ty": "m", "tz": "m"}
    elif is_row_of_units(cells := _split_line(second, delimiter) if _is_whole(second) else []):
        units = dict(zip(header, cells, strict=False))
    if not (is_first or (third if units else second)):
        raise LogError(f"no rows below the header {', '.join(header)[:160]}")
    head = 0 if is_first else 2 if units else 1
    return PlainTable(
        names=tuple(header),
        columns=_TextColumns(text, delimiter, header, size, head=head, is_cut=allow_partial),
        word="line",
        has_header=has_header,
        units=units,
    )


def _is_whole(line: str) -> bool:
    """Return whether a line has cells, and no quoted cell that goes on below."""
    return bool(line) and line.count('"') % 2 == 0


def _find_first_rows(text: str) -> tuple[list[str], tuple[str, str, str]]:
    """Return the last comments before the first row, and the first three rows."""
    rows = iterate_lines(text, comments=False)
    first, second, third = (next(rows, (0, ""))[1].strip() for _ in range(3))
    begin = BLANKS_AND_COMMENTS.match(text).end()  # type: ignore[union-attr]  # of none, too
    above = text[max(0, begin - LONGEST_HEAD) : begin].split("\n")
    comments = [line.strip().lstrip("#%/").strip() for line in above]
    return comments, (first, second, third)


def _count_cells(line: str, delimiter: str) -> int:
    return len(line.split(None if delimiter == _BLANK else delimiter, MOST_COLUMNS))


def _find_delimiter(line: str) -> str:
    return next((delimiter for delimiter in (";", "\t", ",") if delimiter in line), _BLANK)


def _is_row(first: Sequence[str], second: str, delimiter: str) -> bool:
    """Return whether the first row has numbers and texts where the second row has them."""
    kinds = [_is_number(cell) for cell in first if cell]
    if not any(kinds) or not _is_whole(second):
        return False
    cells = _split_line(second, delimiter)
    return [*map(_is_number, first)] == [*map(_is_number, cells)]


def _find_names(
    comments: Sequence[str], delimiter: str, first: Sequence[str]
) -> tuple[bool, list[str]]:
    """Return column names of a file without a header: from its last comment, or of TUM or KITTI.

    Columns of numbers and texts, as by `ros2 topic echo --csv`, are numbered.
    """
    count = len(first)
    for comment in reversed(comments):
        for candidate in dict.fromkeys((delimiter, _find_delimiter(comment))):
            if _count_cells(comment, candidate) > MOST_COLUMNS:
                continue
            names = _split_line(comment, candidate)
            if len(names) == count and not any(map(_is_number, names)):
                return True, names
    for known in (_TUM_COLUMNS, KITTI_COLUMNS):
        if count == len(known):
            return False, [*known]
    if not all(map(_is_number, first)):
        return True, [f"#{place + 1}" for place in range(count)]
    raise LogError(
        "expected a header that names the columns, the 8 columns of a TUM trajectory"
        f" ({' '.join(_TUM_COLUMNS)}) or the 12 of KITTI, found {count} columns without names"
    )


class _TextColumns:
    """The columns of a table of text, and the line of each row, known after the first reading."""

    def __init__(
        self,
        text: str,
        delimiter: str,
        header: Sequence[str],
        size: int,
        *,
        head: int,
        is_cut: bool,
    ) -> None:
        """Use a text of `size` bytes with `head` rows above the values; the last row may be cut."""
        self._text, self._delimiter, self._header = text, delimiter, [*header]
        self._size, self._head, self._is_cut = size, head, is_cut
        self.lines: Sequence[int] = ()
        self.notes: dict[str, str] = {}
        self.lost: Lost = "nothing"

    def read(self, places: Sequence[int]) -> list[Sequence[Any]]:
        """Return the cells of some columns."""
        found: list[list[str]] = [[] for _ in places]
        lines, most, known = array("q"), count_most_rows(self._size), dict[str, str]()
        pairs = [*zip(places, found, strict=True)]
        for line, row in self._iterate_rows():
            if len(lines) == most:
                raise LogError(describe_rows(f"more than {most:,}", most, self._size))
            lines.append(line)
            for place, cells in pairs:
                cell = row[place].strip()
                if self._delimiter != "," and "," in cell and _is_number(cell):
                    cell = cell.replace(",", ".")
                # Numbers with few digits repeat.
                cells.append(known.get(cell, cell))
                if len(known) < _MOST_KNOWN:
                    known[cell] = cell
        if not lines:
            raise LogError(f"no rows below the header {', '.join(self._header)[:160]}")
        self.lines = lines
        return [*found]

    def _iterate_rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield the line number and the cells of each row with values; note the other rows."""
        rows, repeated = _split_lines(iterate_lines(self._text, comments=False), self._delimiter), 0
        for line, row in islice(rows, self._head, None):
            if len(row) != len(self._header):
                self._note_cut(line, row, is_last=next(rows, None) is None)
            elif row[0].strip() == self._header[0] and [*map(str.strip, row)] == self._header:
                repeated += 1  # as in files that were joined
            else:
                yield line, row
        if repeated:
            self.notes["repeated_headers"] = f"{describe_count(repeated, 'row')} left out"

    def _note_cut(self, line: int, row: Sequence[str], *, is_last: bool) -> None:
        """Note that the last row is left out; raise an error if rows may not be cut."""
        found = f"line {line}: expected {len(self._header)} cells, found {len(row)}"
        if not is_last or len(row) > len(self._header):
            raise LogError(found)
        if not self._is_cut:
            raise LogError(f"{found} in the last row: --partial leaves it out")
        self.notes["partial"], self.lost = f"the last row is left out, {found}", "rows"


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
        units=dict.fromkeys(columns.list_times(), "ns"),
    )


class _StoredColumns:
    """The columns of a Parquet file, with dots in names within structs, and the row numbers."""

    def __init__(self, file: ParquetFile) -> None:
        self._file, self.names = file, [leaf.path for leaf in file.leaves]
        self.lines: Sequence[int] = range(1, file.row_count + 1)
        self.notes: Mapping[str, str] = {}
        self.lost: Lost = "nothing"

    def read(self, places: Sequence[int]) -> list[Sequence[Any]]:
        """Return the cells of some columns."""
        return [self._read_one(self.names[place]) for place in places]

    def list_times(self) -> list[str]:
        """Return the names of columns with the type of a time or duration, read in ns."""
        kinds = zip(self._file.schema.names, self._file.schema.types, strict=True)
        durations = [name for name, kind in kinds if str(kind).startswith("duration")]
        leaves = self._file.leaves
        return durations + [leaf.path for leaf in leaves if leaf.logical_type.type == "TIMESTAMP"]

    def _read_one(self, name: str) -> Sequence[Any]:
        """Return the cells of a column: numbers, times in ns, or else texts; null becomes empty."""
        table = self._file.read([name])
        while any(str(kind).startswith("struct") for kind in table.schema.types):
            table = table.flatten()
        if table.num_columns != 1:
            raise LogError(f"column {name}: expected one of that name, found {table.num_columns}")
        column = table.column(0)
        if not str(column.type).startswith(("dictionary", "string", "large_string")):
            values = column.to_numpy()
            if values.dtype.kind in "mM":
                found: Sequence[Any] = values.astype(f"{values.dtype.kind}8[ns]").astype(np.int64)
                return found
            if values.dtype.kind in "iuf":
                return values  # type: ignore[no-any-return]
        return ["" if cell is None else str(cell) for cell in list_cells(column)]


def read_header(path: Path) -> tuple[str, ...]:
    """Return the column names without reading rows; for text files the cells of the first line."""
    if path.suffix.lower() != ".parquet":
        with open_file(path) as stream:
            head = stream.readline(LONGEST_HEAD).decode("utf-8-sig", errors="replace")
        return tuple(head.strip().split(","))
    return tuple(ParquetFile(path).schema.names)


def require_few_columns(columns: int) -> None:
    """Refuse a table with too many columns."""
    if columns > MOST_COLUMNS:
        raise LogError(
            f"the table has more than {MOST_COLUMNS:,} columns. Write fewer columns: a drive needs"
            " time, x, y, heading and the commands"
        )


def export_tum(run: Run, path: str | Path) -> tuple[Path, ...]:
    """Write the poses of a run as a TUM trajectory, replacing the file, and return the file.

    Each pose is one line, for programs such as evo: time [s] on the clock of the run's source, x y
    z [m], and the quaternion x y z w of the heading. Position and time can be read back exactly,
    the heading to about 1e-15 rad.

    Raises:
        LogError: If the file cannot be written.
    """
    path = make_path(path)
    with (
        replace_when_complete(path) as temporary,
        temporary.open("w", encoding="ascii", newline="\n") as stream,
    ):
        stream.writelines(_format_tum(run))
    return (path,)


def _format_tum(run: Run) -> Iterator[str]:
    poses = run.poses
    half_rad = poses.heading_rad / 2.0
    columns = (
        poses.time_ns + run.source_start_ns,
        *poses.xy_m.T,
        np.sin(half_rad),
        np.cos(half_rad),
    )
    for time_ns, x, y, qz, qw in iterate_table_rows(columns):
        yield f"{format_seconds(time_ns)} {x!r} {y!r} 0 0 0 {qz!r} {qw!r}\n"


def require_same_poses(path: Path, run: Run) -> None:
    """Raise an error if the written trajectory does not contain the poses of the run."""
    poses, first = run.poses, 0
    for time_ns, xy_m, heading_rad in _iterate_trajectory(path):
        rows = slice(first, first + len(time_ns))
        if not np.array_equal(poses.time_ns[rows] + run.source_start_ns, time_ns):
            raise describe_mismatch(path, "time_ns")
        if not np.array_equal(poses.xy_m[rows], xy_m):
            raise describe_mismatch(path, "xy_m")
        if np.abs(wrap_angle(poses.heading_rad[rows] - heading_rad)).max() > _ROUNDED_RAD:
            raise describe_mismatch(path, "heading_rad")
        first = rows.stop
    if first != len(poses):
        raise describe_mismatch(path, "time_ns")


def _iterate_trajectory(path: Path) -> Iterator[tuple[list[int], NDArray[Any], NDArray[Any]]]:
    """Yield times [ns], positions [m] and headings [rad] of a trajectory by `export_tum`."""
    with (
        name_file(path, expected="a trajectory"),
        open_file(path) as stream,
        io.TextIOWrapper(stream, "ascii") as lines,
    ):
        while part := [*islice(lines, ROWS_AT_ONCE)]:
            # The digits of a time give its nanoseconds; a float has fewer digits.
            time_ns = [int(line[: line.index(" ")].replace(".", "")) for line in part]
            numbers = np.loadtxt(part, ndmin=2)
            yield time_ns, numbers[:, 1:3], compute_heading(*numbers[:, 4:8].T)


def iterate_table_rows(columns: Sequence[NDArray[Any]]) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of equally long columns as Python values, with few rows in memory."""
    for first in range(0, len(columns[0]), ROWS_AT_ONCE):
        parts = (column[first : first + ROWS_AT_ONCE].tolist() for column in columns)
        yield from zip(*parts, strict=True)


def describe_mismatch(path: Path, column: str) -> LogError:
    """Return the error for a written file that reads back with other values in a column."""
    return LogError(
        f"{path}: expected to read back what was written, found other values in {column}"
    )
