"""Scenarios by name: presets, TOML files, and CSV files of numbers that TOML files name.

`[law] file = "commands.csv"` names a file in the folder of the scenario file. The scenario and the
recording contain the numbers, not the file name: reading a recording opens no other file.
"""

import csv
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from turtlelog.errors import ScenarioError, describe_unknown
from turtlelog.files.text_files import (
    describe_csv_error,
    describe_missing,
    describe_value,
    format_toml,
    parse_toml,
    read_text_file,
)
from turtlelog.files.urls import make_path
from turtlelog.laws.open_loop import MOST_ROWS
from turtlelog.run.paths import MOST_POINTS
from turtlelog.scenario.model import Scenario, require_scenario
from turtlelog.scenario.presets import PAPER_RUNS, PRESET_TABLES, PRESETS
from turtlelog.scenario.table_conversion import build_scenario, nest_scenario


def load_scenario(name_or_path: str | Path) -> Scenario:
    """Return a preset by its name, or the scenario in a TOML file.

    Raises:
        ScenarioError: If the name is neither a preset nor a file, or the file is wrong.
    """
    name = str(name_or_path)
    if name in PRESETS:
        return get_preset(name)
    path = make_path(name)
    if path.suffix != ".toml" and not path.is_file():
        if path.is_dir():
            raise ScenarioError(f"{name}: a folder, not a scenario file (.toml)")
        place = "turtlelog list presets"
        raise ScenarioError(describe_unknown("preset or file", name, PRESETS, place=place))
    return read_scenario(name_or_path)


def read_scenario(path: str | Path) -> Scenario:
    """Return the scenario in a TOML file, with the numbers from the files that this file names.

    Raises:
        ScenarioError: If the file cannot be read, is not TOML, or a key or value is wrong.
    """
    try:
        text = read_text_file(path)
    except UnicodeDecodeError as err:
        raise ScenarioError(f"{path}: not TOML, not even text") from err
    except FileNotFoundError as err:
        raise ScenarioError(f"{path}: {describe_missing(path, PRESETS)}") from err
    except (OSError, ValueError) as err:
        found = getattr(err, "strerror", None) or err
        raise ScenarioError(f"{path}: expected a scenario file, found: {found}") from err
    path = make_path(path)
    if not text.strip() and path.suffix != ".toml":
        raise ScenarioError(f"{path}: expected a scenario, found an empty file")
    return _build(text, str(path), path)


def parse_scenario(text: str, *, source: str = "scenario") -> Scenario:
    """Return the scenario in a TOML text. The text comes from the user, so its law may run.

    A text has no folder, so it cannot name a file of commands.

    Raises:
        ScenarioError: If the text is not TOML, or a key or value is wrong.
    """
    return _build(text, source, None)


def _build(text: str, source: str, path: Path | None) -> Scenario:
    try:
        tables = parse_toml(text)
    except ValueError as err:
        raise ScenarioError(f"{source}: not TOML: {err}") from err
    tables = tables if path is None else _embed_files(tables, path)
    return build_scenario(tables, source=source, trust_law=True)


def format_scenario(scenario: Scenario) -> str:
    """Return the TOML text of a scenario, from which `parse_scenario` returns the same scenario."""
    require_scenario(scenario)
    return format_toml(nest_scenario(scenario))


def get_preset(name: str) -> Scenario:
    """Return a preset.

    Raises:
        ScenarioError: If no preset has this name.
    """
    if name not in PRESET_TABLES:
        raise ScenarioError(f"preset: expected one of {', '.join(PRESETS)}, found {name!r}")
    return build_scenario(PRESET_TABLES[name], source=name)


def iterate_paper_runs() -> Iterator[Scenario]:
    """Yield the scenarios of the paper's experiment, in order of gain."""
    return (get_preset(name) for name in PAPER_RUNS)


@dataclass(frozen=True, slots=True, kw_only=True)
class TableFile:
    """The columns that a table of a scenario takes from a file.

    Attributes:
        columns: Names of the columns; the first is required.
        most_rows: Largest number of rows below the header.
        rises: Whether the first column must increase, as times do.
        key: Key of the table that gets all rows, each row a list in the order of `columns`. All
            columns are then required, and a header is optional. None: each column is a key.
        where: Values of the table for which its `file` is read. With other values, `file` is a key
            of the law.
        sets: Values that the file implies; the table may state the same values.
    """

    columns: tuple[str, ...]
    most_rows: int
    rises: bool = True
    key: str | None = None
    where: Mapping[str, str] = field(default_factory=dict)
    sets: Mapping[str, str] = field(default_factory=dict)

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys of the table that the file provides."""
        return self.columns if self.key is None else (self.key,)


_TABLE_FILES: Final[Mapping[str, TableFile]] = MappingProxyType(
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
"""Files of numbers by the name of the scenario's table."""


def _embed_files(tables: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Return the tables of a scenario file, with numbers from the files that the tables name."""
    embedded = dict(tables)
    for name, kind in _TABLE_FILES.items():
        table = tables.get(name)
        if isinstance(table, Mapping) and "file" in table and table.items() >= kind.where.items():
            embedded[name] = _embed(table, kind, f"{path}: {name}", path.parent)
    return embedded


def _embed(table: Mapping[str, Any], kind: TableFile, place: str, folder: Path) -> dict[str, Any]:
    file = table["file"]
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
    rest = {key: value for key, value in table.items() if key != "file"}
    columns = _read_columns_of_numbers(folder / file, kind)
    if kind.key is None:
        return {**rest, **kind.sets, **columns}
    rows = zip(*(columns[name] for name in kind.columns), strict=True)
    return {**rest, **kind.sets, kind.key: [list(row) for row in rows]}


def _read_columns_of_numbers(path: Path, kind: TableFile) -> dict[str, list[float]]:
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
            expected = f"more than {rising[-2]} of the line before, found {rising[-1]}"
            raise ScenarioError(f"{place}: {kind.columns[0]}: expected {expected}")
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
