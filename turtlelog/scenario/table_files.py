"""Files of numbers that a scenario file names: their columns become values of the scenario.

`[law] file = "commands.csv"` is read when the scenario file is, from its folder. The scenario, and
so the recording, holds the numbers and no name of a file: reading a recording opens no other file.
"""

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from turtlelog.errors import ScenarioError
from turtlelog.files.text_files import describe_csv_error, read_text_file
from turtlelog.laws.open_loop import MOST_ROWS
from turtlelog.run.paths import MOST_POINTS
from turtlelog.scenario.dotted_keys import describe_value

_FILE: Final = "file"


@dataclass(frozen=True, slots=True, kw_only=True)
class TableFile:
    """What a table of a scenario takes from a file.

    Attributes:
        columns: Its columns; the first is needed.
        most_rows: Below the line of names.
        rises: Whether the first column rises, as times do.
        key: The key of the table that holds all rows, each a list in the order of `columns`, which
            are all needed, or need no line of names; None where each column is a key.
        where: Values of the table with which its `file` is read; with others `file` is a key of
            the law's own.
        sets: Values that the table takes with the file; it may state the same.
    """

    columns: tuple[str, ...]
    most_rows: int
    rises: bool = True
    key: str | None = None
    where: Mapping[str, str] = field(default_factory=dict)
    sets: Mapping[str, str] = field(default_factory=dict)

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys of the table that the file gives."""
        return self.columns if self.key is None else (self.key,)


TABLE_FILES: Final[Mapping[str, TableFile]] = MappingProxyType(
    {
        "law": TableFile(
            columns=("time_s", "speed_m_s", "turn_rate_rad_s"),
            most_rows=MOST_ROWS,
            where={"kind": "open-loop"},
            sets={"signal": "sequence"},
        ),
        "path": TableFile(columns=("x_m", "y_m"), most_rows=MOST_POINTS, rises=False, key="points"),
    }
)
"""By the name of the scenario's table."""


def embed_files(tables: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Return the tables of a scenario file with the numbers of the files that it names.

    Raises:
        ScenarioError: Where a file cannot be read, or what it holds stands in the table as well.
    """
    embedded = dict(tables)
    for name, kind in TABLE_FILES.items():
        table = tables.get(name)
        if isinstance(table, Mapping) and _FILE in table and _agrees(table, kind.where):
            embedded[name] = _embed(table, kind, f"{path}: {name}", path.parent)
    return embedded


def _embed(table: Mapping[str, Any], kind: TableFile, place: str, folder: Path) -> dict[str, Any]:
    file = table[_FILE]
    if not isinstance(file, str) or not file:
        expected = "the name of a CSV file"
        raise ScenarioError(f"{place}.file: expected {expected}, found {describe_value(file)}")
    for key in kind.keys:
        if key in table:
            raise ScenarioError(f"{place}.{key}: expected it in {file} alone, found it here, too")
    for key, value in kind.sets.items():
        if table.get(key, value) != value:
            expected, found = f"{value} beside file", describe_value(table[key])
            raise ScenarioError(f"{place}.{key}: expected {expected}, found {found}")
    rest = {key: value for key, value in table.items() if key != _FILE}
    columns = read_columns_of_numbers(folder / file, kind)
    if kind.key is None:
        return {**rest, **kind.sets, **columns}
    rows = zip(*(columns[name] for name in kind.columns), strict=True)
    return {**rest, **kind.sets, kind.key: [list(row) for row in rows]}


def read_columns_of_numbers(path: Path, kind: TableFile) -> dict[str, list[float]]:
    """Return the columns of a CSV file by name.

    Raises:
        ScenarioError: Where it cannot be read, or a line is wrong: file, line, expected, found.
    """
    try:
        text = read_text_file(path)
    except UnicodeDecodeError as err:
        raise ScenarioError(f"{path}: expected CSV, found bytes that are no text") from err
    except (OSError, ValueError) as err:
        found = getattr(err, "strerror", None) or err
        raise ScenarioError(f"{path}: expected a CSV file, found: {found}") from err
    rows = text.rstrip().splitlines()
    is_unnamed = kind.key is not None and bool(rows) and not any(map(str.isalpha, rows[0]))
    lines = csv.reader(rows)
    try:
        names = [*kind.columns] if is_unnamed else _read_names(next(lines, []), kind, path)
        return _read_rows(lines, names, kind, path)
    except csv.Error as err:
        found = describe_csv_error(err)
        raise ScenarioError(f"{path}: line {lines.line_num}: expected CSV, found {found}") from err


def _read_names(cells: list[str], kind: TableFile, path: Path) -> list[str]:
    names = [cell.strip() for cell in cells]
    is_known = set(names) <= set(kind.columns) and len(set(names)) == len(names)
    is_whole = kind.key is None or set(names) == set(kind.columns)
    if not is_known or kind.columns[0] not in names or len(names) < 2 or not is_whole:
        needed, *others = kind.columns
        expected = f"the columns {needed} and {' or '.join(others)}"
        found = describe_value(",".join(names)) if names else "nothing"
        raise ScenarioError(f"{path}: line 1: expected {expected}, found {found}")
    return names


def _read_rows(lines: Any, names: list[str], kind: TableFile, path: Path) -> dict[str, list[float]]:
    columns: dict[str, list[float]] = {name: [] for name in names}
    rising = columns[kind.columns[0]]
    for cells in lines:
        place = f"{path}: line {lines.line_num}"
        if len(rising) == kind.most_rows:
            raise ScenarioError(f"{place}: expected up to {kind.most_rows:,} rows, found more")
        if len(cells) != len(names):
            raise ScenarioError(f"{place}: expected {len(names)} numbers, found {len(cells)}")
        for name, cell in zip(names, cells, strict=True):
            columns[name].append(_read_number(cell, f"{place}: {name}"))
        if kind.rises and len(rising) > 1 and not rising[-1] > rising[-2]:
            expected = f"more than {rising[-2]} of the line before"
            found = f"{kind.columns[0]}: expected {expected}, found {rising[-1]}"
            raise ScenarioError(f"{place}: {found}")
    if not rising:
        raise ScenarioError(f"{path}: line 2: no row of numbers")
    return columns


def _read_number(cell: str, place: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or "_" in cell:
        raise ScenarioError(f"{place}: expected a finite number, found {describe_value(cell)}")
    return value


def _agrees(table: Mapping[str, Any], values: Mapping[str, str]) -> bool:
    return all(table.get(key) == value for key, value in values.items())
