"""Import of plain tables: CSV, Parquet or TUM, as columns of cells and as a run."""

import csv
import re
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.display import format_utc, join_words
from turtlelog.errors import LogError
from turtlelog.files.text_files import BLANKS_AND_COMMENTS, describe_csv_error, iterate_lines
from turtlelog.files.urls import make_path
from turtlelog.log.exported_tables import (
    LONGEST_HEAD,
    MOST_COLUMNS,
    decode_text,
    require_few_columns,
)
from turtlelog.log.file_access import name_file, open_file
from turtlelog.log.parquet_file import ParquetFile, count_most_rows, describe_rows, list_cells
from turtlelog.log.planar_poses import (
    Values,
    compute_heading,
    compute_tilt,
    describe_height,
    lift_poses,
    separate_times,
    wrap_far_headings,
)
from turtlelog.log.read_choice import CHOSEN
from turtlelog.log.table_columns import Cells, Choice, assign_columns
from turtlelog.run import CommandColumns, PoseColumns, Run, SampleColumns

_NEVER: Final = (
    *("poses.speed_m_s", "poses.turn_rate_rad_s", "samples", "goal_xy_m", "goal_heading_rad"),
    *("parameters", "stop_reason", "events"),
)

_QUATERNION: Final = ("qx", "qy", "qz", "qw")
_NEEDED: Final = ("t", "x", "y", "heading")

_SHOWN_NAMES: Final = 12
"""Largest number of columns that an error lists."""

_OTHERS: Final = ("z", "speed", "turn_rate", "command_speed", "command_turn_rate")

_TUM_COLUMNS: Final = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
"""Columns of a TUM trajectory, which has no header: time, position, quaternion."""

KITTI_COLUMNS: Final = (
    *("r11", "r12", "r13", "tx", "r21", "r22", "r23", "ty", "r31", "r32", "r33", "tz"),
)
"""Columns of a KITTI trajectory, which has neither header nor times.

The columns contain the first three rows, one after another, of the matrix from the robot's frame to
the world frame."""

_NUMBER: Final = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)(e[+-]?\d+)?|[+-]?(nan|inf)|", re.I)

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


def import_plain_table(path: str | Path, columns: Mapping[str, str] | None = None) -> Run:
    """Return the run in a table with a header, or in a TUM trajectory.

    Column names or `columns` determine quantities and units; the note `columns` lists the result.
    Rows are sorted by time, and duplicate rows are dropped. If several poses have the same time,
    the later poses are moved by 1 ns each. The notes give the counts.

    Args:
        path: Text file with commas, semicolons, tabs or blanks between cells, or a Parquet file.
        columns: Columns by quantity, if names are not clear, as in `{"heading": "psi [deg]"}`.

    Raises:
        LogError: If the table is invalid; one line with the file, the row and the column.
    """
    path = make_path(path)
    with name_file(path, expected="a table"):
        table = read_plain_table(path)
        chosen = assign_columns(table.names, columns or {}, table.units)
        _require_columns(table, chosen)
        return _build_run(path, Cells(table, chosen))


def _require_columns(table: PlainTable, chosen: Mapping[str, Choice]) -> None:
    has_quaternion = all(name in chosen for name in _QUATERNION)
    missing = [
        name
        for name in _NEEDED
        if name not in chosen and not (name == "heading" and has_quaternion)
    ]
    if missing:
        if {"row", "failed"} <= {*table.names}:
            raise LogError("a table of turtlelog sweep, not a run: turtlelog plot shows it")
        if table.names == KITTI_COLUMNS and not table.has_header:
            raise LogError(
                "a KITTI trajectory has no times, so it is no run; turtlelog compare FILE"
                " --reference FILE --ate compares two of them"
            )
        found = ", ".join(table.names[:_SHOWN_NAMES])
        more = ", ..." if len(table.names) > _SHOWN_NAMES else ""
        raise LogError(
            f"no column for {join_words(missing)}; there are {found}{more}:"
            f" --column {missing[0]}='NAME [UNIT]' says which"
        )


def _build_run(path: Path, cells: Cells) -> Run:
    values = {
        "x": cells.require("x"),
        "y": cells.require("y"),
        **_read_rotation(cells),
        **{name: found for name in _OTHERS if (found := cells.read(name)) is not None},
    }
    time_ns, values, notes = _order_rows(cells.time_ns, values)
    places = np.column_stack([values[name] for name in ("x", "y", "heading")])
    has_pose = np.asarray(np.isfinite(places).all(axis=1))
    if not has_pose.any():
        raise LogError("no row has x, y and heading")
    commands = _build_commands(time_ns, values)
    start_ns = int(min([time_ns[has_pose][0], *commands.time_ns[:1]]))
    poses = {name: column[has_pose] for name, column in values.items()}
    whole = {name: column for name, column in poses.items() if not np.isnan(column).any()}
    absent = [*_NEVER, *(() if len(commands) else ("commands",))]
    start = f"{start_ns / 1e9:.9f} s" if start_ns < 1e18 else format_utc(start_ns)
    pose_time_ns, moved = separate_times(time_ns[has_pose] - start_ns)
    heading_rad, wrapped = wrap_far_headings(poses["heading"])
    plane = describe_height(poses.get("z"), poses.get("tilt"))
    notes = {
        CHOSEN: cells.describe(),
        "columns": cells.describe(),
        **({"original_timestamp": start} if start_ns else {}),
        **notes,
        "moved_rows": str(moved),
        "wrapped_headings": str(wrapped),
        **_describe_gaps(values, has_pose, commands),
        **({} if plane is None else {"plane": plane}),
    }
    return Run(
        name=path.stem,
        source=f"{'table' if cells.table.has_header else 'tum'}: {path.name}",
        poses=PoseColumns(
            time_ns=pose_time_ns,
            xy_m=np.column_stack([poses["x"], poses["y"]]),
            heading_rad=heading_rad,
            measured_speed_m_s=whole.get("speed"),
            measured_turn_rate_rad_s=whole.get("turn_rate"),
            **lift_poses(poses.get("z"), poses.get("tilt")),
        ),
        commands=replace(commands, time_ns=commands.time_ns - start_ns),
        samples=SampleColumns.build_empty(),
        absent=tuple(absent),
        notes=notes,
    )


def _read_rotation(cells: Cells) -> dict[str, Values]:
    """Return headings, and the tilt if the rotations are quaternions."""
    heading = cells.read("heading")
    if heading is not None:
        return {"heading": heading}
    x, y, z, w = (cells.require(name) for name in _QUATERNION)
    with np.errstate(over="ignore"):
        empty = x**2 + y**2 + z**2 + w**2 == 0.0
    if empty.any():
        cells.refuse("qw", int(empty.argmax()), "a rotation of a length other than 0")
    return {"heading": compute_heading(x, y, z, w), "tilt": compute_tilt(x, y, z, w)}


def _order_rows(
    time_ns: NDArray[np.int64], values: Mapping[str, Values]
) -> tuple[NDArray[np.int64], dict[str, Values], dict[str, str]]:
    """Return the rows sorted by time without duplicates, and notes on the changes."""
    late = int((time_ns < np.maximum.accumulate(time_ns)).sum())
    if late:
        order = np.argsort(time_ns, kind="stable")
        time_ns = time_ns[order]
        values = {name: column[order] for name, column in values.items()}
    twice = np.flatnonzero(time_ns[1:] == time_ns[:-1])
    for column in values.values():
        bits = column.view(np.int64)
        twice = twice[bits[twice] == bits[twice + 1]]
    notes = {"sorted_rows": str(late), "dropped_duplicates": str(len(twice))}
    if len(twice):
        time_ns = np.delete(time_ns, twice + 1)
        values = {name: np.delete(column, twice + 1) for name, column in values.items()}
    return time_ns, dict(values), notes


def _build_commands(time_ns: NDArray[np.int64], values: Mapping[str, Values]) -> CommandColumns:
    """Return a command for each row that contains one; missing columns count as 0."""
    zeros = np.zeros(len(time_ns))
    found = [values.get(name, zeros) for name in ("command_speed", "command_turn_rate")]
    has = np.isfinite(found).all(axis=0)
    if "command_speed" not in values and "command_turn_rate" not in values:
        has = np.zeros(len(time_ns), dtype=np.bool_)
    return CommandColumns(
        time_ns=time_ns[has],
        speed_m_s=found[0][has],
        lateral_speed_m_s=zeros[has],
        turn_rate_rad_s=found[1][has],
    )


def _describe_gaps(
    values: Mapping[str, Values], has_pose: NDArray[np.bool_], commands: CommandColumns
) -> dict[str, str]:
    """Return notes on rows with missing values."""
    notes, rows = {}, len(has_pose)
    if missing := rows - int(has_pose.sum()):
        notes["rows_without_pose"] = f"{missing} of {rows}"
    if len(commands) and (missing := rows - len(commands)):
        notes["rows_without_command"] = f"{missing} of {rows}"
    for name in ("speed", "turn_rate"):
        gaps = int(np.isnan(values[name][has_pose]).sum()) if name in values else 0
        if gaps:
            notes[f"measured_{name}"] = f"not read: {gaps} of {int(has_pose.sum())} poses lack it"
    return notes


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
        raise LogError(f"no rows below the header {', '.join(header)[:160]}")
    return PlainTable(
        names=tuple(header),
        columns=_TextColumns(text, delimiter, len(header), size, is_first=is_first),
        word="line",
        has_header=has_header,
        units={} if has_header else {"timestamp": "s", "tx": "m", "ty": "m", "tz": "m"},
    )


def _find_first_row(text: str) -> tuple[list[str], str, bool]:
    """Return the last comments before the first row, that row, and whether there are more rows."""
    rows = iterate_lines(text, comments=False)
    _, first = next(rows, (0, ""))
    begin = BLANKS_AND_COMMENTS.match(text).end()  # type: ignore[union-attr]  # of none, too
    above = text[max(0, begin - LONGEST_HEAD) : begin].split("\n")
    comments = [line.strip().lstrip("#").strip() for line in above]
    return comments, first.strip(), next(rows, None) is not None


def _count_cells(line: str, delimiter: str) -> int:
    return len(line.split(None if delimiter == _BLANK else delimiter, MOST_COLUMNS))


def _find_delimiter(line: str) -> str:
    return next((delimiter for delimiter in (";", "\t", ",") if delimiter in line), _BLANK)


def _find_names(comments: Sequence[str], delimiter: str, count: int) -> tuple[bool, list[str]]:
    """Return column names of a file without a header: from its last comment, or of TUM or KITTI."""
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
        rows = _split_lines(iterate_lines(self._text, comments=False), self._delimiter)
        for line, row in rows if self._is_first else islice(rows, 1, None):
            if len(row) != self._count:
                raise LogError(f"line {line}: expected {self._count} cells, found {len(row)}")
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
        self.lines = lines
        return [*found]


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
        """Return the cells of a column: numbers, times in ns, or else texts; null becomes empty."""
        table = self._file.read([name])
        while any(str(kind).startswith("struct") for kind in table.schema.types):
            table = table.flatten()
        if table.num_columns != 1:
            raise LogError(f"column {name}: expected one of that name, found {table.num_columns}")
        column = table.column(0)
        if not str(column.type).startswith(("dictionary", "string", "large_string")):
            values = column.to_numpy()
            if values.dtype.kind == "M":
                found: Sequence[Any] = values.astype("datetime64[ns]").astype(np.int64)
                return found
            if values.dtype.kind in "iuf":
                return values  # type: ignore[no-any-return]
        return ["" if cell is None else str(cell) for cell in list_cells(column)]
