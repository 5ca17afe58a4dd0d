"""CSV and Parquet tables of runs: exported, read back, recognised by their header, imported."""

import csv
import io
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain, islice
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.escapes import guard_cell
from turtlelog.files.text_files import describe_csv_error
from turtlelog.files.urls import make_path
from turtlelog.libraries import load_library
from turtlelog.log.engine.limits import MOST_ROWS, count_most_rows, describe_rows
from turtlelog.log.file_access import (
    create_folder,
    name_file,
    name_write_error,
    open_file,
    replace_when_complete,
)
from turtlelog.log.parquet_file import (
    ParquetFile,
    list_cells,
)
from turtlelog.log.table_files import (
    ROWS_AT_ONCE,
    describe_mismatch,
    iterate_table_rows,
    read_header,
    require_few_columns,
)
from turtlelog.run import (
    TABLES,
    Clock,
    CommandColumns,
    Event,
    PoseColumns,
    Run,
    SampleColumns,
    tabulate_run,
)
from turtlelog.run.columns import PAIRS
from turtlelog.run.loops import DONE, PAUSE, Declaration, parse_declaration
from turtlelog.run.tables import Table, iterate_arrow, list_facts

_TABLE_SUFFIXES: Final = (".csv", ".parquet")
_FACTS: Final = "run.json"
"""File with the facts of the run beside its CSV tables, which Parquet tables hold themselves."""
_WHOLE: Final = frozenset({"time_ns", "sequence", "pose_sequence"})
_TEXTS: Final = frozenset({"phase", "kind", "text"})

_MARKS: Final[Mapping[str, frozenset[str]]] = {
    "events": frozenset({"time_ns", "kind", "text"}),
    "samples": frozenset({"time_ns", "sequence", "pose_sequence", "phase"}),
    "commands": frozenset({"time_ns", "speed_m_s", "lateral_speed_m_s", "turn_rate_rad_s"}),
    "poses": frozenset({"time_ns", "x_m", "y_m", "heading_rad"}),
}
"""Columns that identify the table in a file."""

_CLASSES: Final[Mapping[str, Any]] = {"poses": PoseColumns, "commands": CommandColumns}
"""Classes of the tables with fixed columns. Samples also have states of their law."""

_ROWS_GROUPED: Final = 2**16
"""Number of rows of a Parquet file encoded at once; each row takes 160 bytes during encoding."""


def export_csv(run: Run, path: str | Path, *, table: str | None = None) -> tuple[Path, ...]:
    """Write the tables of a run as CSV and return the files. Numbers can be read back exactly.

    Args:
        run: Run to write.
        path: A name that ends in .csv is one file, which replaces an existing file; any other name
            is a new folder with one file per table, and run.json with the name, goal, scenario and
            declaration of the run.
        table: Table to write (`poses`, `commands`, `samples`, `events`). Default: `poses` for a
            file, all tables for a folder.

    Raises:
        LogError: If the path cannot be written, a folder exists, or there is no such table.
    """
    return _export(run, make_path(path), ".csv", table, _write_csv)


def export_parquet(run: Run, path: str | Path, *, table: str | None = None) -> tuple[Path, ...]:
    """Write the tables of a run as Parquet, as `export_csv` does, and return the files.

    Columns keep their types. The metadata contain the units of the columns, and the name, goal,
    scenario and declaration of the run.

    Raises:
        LogError: If the path cannot be written, a folder exists, or there is no such table.
    """
    return _export(run, make_path(path), ".parquet", table, _write_parquet)


def _export(
    run: Run, path: Path, suffix: str, table: str | None, write: Callable[[Run, str, Path], None]
) -> tuple[Path, ...]:
    if table is not None and table not in TABLES:
        raise LogError(f"table: expected one of {', '.join(TABLES)}, found {table}")
    files = [f"{name}{suffix}" for name in (TABLES if table is None else (table,))]
    try:
        if path.suffix.lower() == suffix:
            with replace_when_complete(path) as temporary:
                write(run, table or "poses", temporary)
            return (path,)
        with create_folder(path) as folder:
            for file in files:
                write(run, file.removesuffix(suffix), folder / file)
            if suffix == ".csv":
                (folder / _FACTS).write_bytes(msgspec.json.encode(list_facts(run)))
                files.append(_FACTS)
    except UnicodeEncodeError as err:
        raise name_write_error(path, err) from err
    return tuple(path / file for file in files)


def _write_csv(run: Run, table: str, path: Path) -> None:
    columns = tabulate_run(run, table)
    with path.open("w", encoding="utf-8", newline="") as stream:
        # One line end on every platform: equal runs give identical files.
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(map(guard_cell, row) for row in iterate_table_rows([*columns.values()]))


def _write_parquet(run: Run, table: str, path: Path) -> None:
    parquet = load_library("pyarrow.parquet")
    parts = iterate_arrow(run, table, _ROWS_GROUPED)
    first = next(parts)
    # Readers accept a larger table only if the file has enough bytes, so it is not compressed.
    is_packed = len(tabulate_run(run, table)["time_ns"]) <= MOST_ROWS
    compression = "zstd" if is_packed else "none"
    with (
        path.open("wb") as stream,
        parquet.ParquetWriter(
            stream, first.schema, compression=compression, use_dictionary=is_packed
        ) as writer,
    ):
        for part in chain([first], parts):
            writer.write_table(part)


def _find_table(columns: Sequence[str]) -> str | None:
    """Return the name of the run's table with these columns; None for other tables."""
    return next((name for name, marks in _MARKS.items() if marks <= {*columns}), None)


def list_table_files(folder: Path) -> tuple[Path, ...]:
    """Return the table files from `turtlelog convert` in a folder; empty for other folders."""
    for suffix in _TABLE_SUFFIXES:
        if (folder / f"poses{suffix}").is_file():
            files = (folder / f"{name}{suffix}" for name in TABLES)
            return tuple(path for path in files if path.is_file())
    return ()


def holds_tables(path: Path) -> bool:
    """Return whether a folder or file contains tables by turtlelog, judging by the first line."""
    if path.is_dir():
        return bool(list_table_files(path))
    if path.suffix.lower() not in _TABLE_SUFFIXES:
        return False
    try:
        return _find_table(read_header(path)) is not None
    except ValueError:  # not a Parquet file despite its name
        return True


def import_tables(path: str | Path) -> Run:
    """Return the run from exported CSV or Parquet tables: a folder, or the table of poses.

    A CSV file alone does not contain the scenario, the goal, the loops of the law and the stop
    reason: they are in the run.json of its folder.

    Raises:
        LogError: If a table is invalid; one line with the file and the column.
    """
    path = make_path(path)
    is_folder = path.is_dir()
    files = list_table_files(path) if is_folder else (path,)
    tables: dict[str, Table] = {}
    facts: dict[str, Any] = {}
    for file in files:
        name, table, facts = _read_table(file)
        tables[name] = table
    if is_folder and (path / _FACTS).is_file():
        facts = _read_facts(path / _FACTS)
    with name_file(path, expected="tables of a run"):
        if "poses" not in tables:
            found = ", ".join(tables) or "none"
            raise LogError(f"expected the poses of a run, found its {found} alone")
        return _build_run(tables, facts, path)


def require_read_back(run: Run, written: Sequence[Path], read: Run | None) -> None:
    """Raise an error if written files, of which recordings were `read`, lack rows of the run."""
    if read is not None:
        for name in TABLES:
            _require_same(written[0], name, tabulate_run(run, name), tabulate_run(read, name))
        return
    for path in written:
        if path.name == _FACTS:
            if _read_facts(path) != list_facts(run):
                raise describe_mismatch(path, "facts of the run")
            continue
        name, table, _ = _read_table(path)
        _require_same(path, name, tabulate_run(run, name), table)


def _read_table(path: Path) -> tuple[str, Table, dict[str, Any]]:
    with name_file(path, expected="a table of a run"):
        is_parquet = path.suffix.lower() == ".parquet"
        table, facts = _open_parquet(path) if is_parquet else (_read_csv(path), {})
        name = _find_table([*table])
        if name is None:
            found = ", ".join(table)[:80] or "none"
            raise LogError(f"expected the columns of a table that turtlelog wrote, found {found}")
        return name, table, facts


def _read_facts(path: Path) -> dict[str, str]:
    with name_file(path, expected="the facts of a run as turtlelog writes them"):
        return msgspec.json.decode(path.read_bytes(), type=dict[str, str])


def _require_same(path: Path, name: str, expected: Table, found: Table) -> None:
    for column in dict.fromkeys([*expected, *found]):
        written, read = expected.get(column), found.get(column)
        if written is None or read is None or not len(written):
            is_same = not any(one is not None and len(one) for one in (written, read))
        else:
            is_same = np.array_equal(written, read, equal_nan=written.dtype.kind == "f")
        if not is_same:
            raise describe_mismatch(path, f"{column} of {name}")


def _read_csv(path: Path) -> Table:
    with open_file(path) as stream, io.TextIOWrapper(stream, "utf-8-sig", newline="") as text:
        size = stream.seek(0, 2)
        stream.seek(0)
        rows = filter(None, csv.reader(text))
        head, count = [*chain(*_take_rows(rows, 0, most=1))], 0
        require_few_columns(len(head))
        known = _list_known(head)
        # Rows are parsed in parts and stored as arrays: cells as texts take ten times as much
        # memory.
        parts: dict[str, list[NDArray[Any]]] = {name: [] for name in head if name in known}
        while part := _take_rows(rows, count):
            _require_rows(part, count, len(head), size)
            for name, cells in zip(head, zip(*part, strict=True), strict=True):
                if name in known:
                    parts[name].append(_parse(name, cells, count))
            count += len(part)
    nothing: tuple[str, ...] = ()
    return {
        name: np.concatenate(arrays) if arrays else _parse(name, nothing, 0)
        for name, arrays in parts.items()
    }


def _take_rows(
    rows: Iterator[list[str]], before: int, *, most: int = ROWS_AT_ONCE
) -> list[list[str]]:
    part: list[list[str]] = []
    try:
        part.extend(islice(rows, most))
    except csv.Error as err:
        found = describe_csv_error(err)
        raise LogError(f"behind row {before + len(part)}: expected cells, found {found}") from err
    return part


def _require_rows(part: Sequence[Sequence[str]], before: int, width: int, size: int) -> None:
    most = count_most_rows(size)
    for number, row in enumerate(part, start=before + 1):
        if len(row) != width:
            raise LogError(f"row {number}: expected {width} cells, found {len(row)}")
        if number > most:
            raise LogError(describe_rows(f"more than {most:,}", most, size))


def _parse(name: str, cells: Sequence[str], first: int) -> NDArray[Any]:
    """Return cells as an array; `first` is the row number of the first cell."""
    if name in _TEXTS:
        return np.array([_release(cell) for cell in cells], dtype=object)
    kind = np.int64 if name in _WHOLE else np.float64
    values = np.empty(len(cells), dtype=kind)
    for row, cell in enumerate(cells):
        try:
            values[row] = kind(cell)
        except (ValueError, OverflowError) as err:
            word = "a whole number" if name in _WHOLE else "a number"
            raise LogError(f"{name}[{first + row}]: expected {word}, found {cell[:40]!r}") from err
    return values


def _release(cell: str) -> str:
    """Return a text without the leading apostrophe of `guard_cell`."""
    inner = cell.removeprefix("'")
    return inner if guard_cell(inner) == cell else cell


def _open_parquet(path: Path) -> tuple[Table, dict[str, Any]]:
    file = ParquetFile(path)
    facts = {
        key.removeprefix(b"turtlelog.").decode(): text.decode()
        for key, text in (file.schema.metadata or {}).items()
        if key.startswith(b"turtlelog.")
    }
    known = _list_known(file.schema.names)
    file.require_rows()
    file.require_cells(len(known))
    return _ParquetTable(path, file, [name for name in file.schema.names if name in known]), facts


class _ParquetTable(Mapping[str, NDArray[Any]]):
    """The columns of a Parquet file, read on demand without a cache."""

    def __init__(self, path: Path, file: ParquetFile, names: Sequence[str]) -> None:
        self._path, self._file, self._names = path, file, names

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self._names:
            raise KeyError(name)
        with name_file(self._path, expected="a table of a run"):
            column = self._file.read([name])[name]
            if name in _TEXTS:
                return np.array(list_cells(column), dtype=object)
            values: NDArray[Any] = column.to_numpy()
            return values

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)


def _list_known(columns: Sequence[str]) -> set[str]:
    kind = _CLASSES.get(_find_table(columns) or "")
    if kind is None:
        return {*columns}
    return {column for name in kind.__dataclass_fields__ for column in PAIRS.get(name, (name,))}


def _build_run(tables: Mapping[str, Table], facts: Mapping[str, str], path: Path) -> Run:
    declaration = parse_declaration(facts["declaration"]) if "declaration" in facts else None
    is_declared = declaration is not None
    samples, declaration = _build_samples(tables.get("samples"), declaration)
    goal = _parse_fact(facts, "goal_m_m_rad", tuple[float, float, float | None] | None)
    absent = [name for name in ("commands", "samples", "events") if name not in tables]
    # Poses alone do not show which loop acts when; the samples do.
    absent += [] if is_declared and "samples" in tables else ["declaration"]
    if "scenario" not in facts:
        absent += ["goal_xy_m", "goal_heading_rad", "parameters", "stop_reason"]
    events = tables.get("events", {})
    return Run(
        name=facts.get("name", path.stem),
        source=facts.get("source", f"tables {path.name}"),
        poses=PoseColumns(**_gather(tables["poses"], PoseColumns)),
        commands=CommandColumns(**_gather(tables["commands"], CommandColumns))
        if "commands" in tables
        else CommandColumns.build_empty(),
        samples=samples,
        goal_xy_m=None if goal is None else (goal[0], goal[1]),
        goal_heading_rad=None if goal is None else goal[2],
        declaration=declaration,
        parameters=_parse_fact(facts, "scenario", dict[str, Any] | None) or {},
        scenario_is_complete=_parse_fact(facts, "scenario_is_complete", bool | None) or False,
        stop_reason=_parse_fact(facts, "stop_reason", str | None),
        clock=_parse_fact(facts, "clock", Clock | None),
        events=tuple(
            Event(time_ns=int(time_ns), kind=kind, text=text)
            for time_ns, kind, text in zip(*events.values(), strict=True)
        ),
        simulated_by=_parse_fact(facts, "simulated_by", dict[str, str] | None) or {},
        absent=tuple(absent),
    )


def _parse_fact(facts: Mapping[str, str], name: str, kind: Any) -> Any:
    """Return a fact of the run from the metadata of a Parquet file; None if missing."""
    try:
        return msgspec.convert(json.loads(facts.get(name, "null")), type=kind)
    except msgspec.ValidationError as err:
        found = str(err)
    except (ValueError, RecursionError):
        found = "no JSON"
    raise LogError(
        f"the metadata turtlelog.{name} are not as turtlelog writes them ({found}). Write the table"
        " again with turtlelog convert"
    )


def _build_samples(
    table: Table | None, declaration: Declaration | None
) -> tuple[SampleColumns, Declaration]:
    if table is None:
        return SampleColumns.build_empty(), Declaration()
    values = _gather(table, SampleColumns)
    known = {*(name for pair in PAIRS.values() for name in pair), *values}
    states = {
        name.removeprefix("state_") if name.removeprefix("state_") in known else name: column
        for name, column in table.items()
        if name not in known
    }
    if declaration is None:
        labels = [*dict.fromkeys(table["phase"].tolist())]
        phases = {name: () for name in labels if name not in {PAUSE, DONE}}
        declaration = Declaration(phases=phases or {"control": ()}, states=tuple(states))
    indices = {name: index for index, name in enumerate(declaration.phase_names)}
    values["phase"] = np.array([indices[name] for name in table["phase"]], dtype=np.int64)
    if states:
        values["states"] = np.column_stack([*states.values()])
    return SampleColumns(**values), declaration


def _gather(table: Table, kind: type) -> dict[str, NDArray[Any]]:
    """Return the columns of a table as the fields of a run; x and y are joined to pairs."""
    names = kind.__dataclass_fields__  # type: ignore[attr-defined]
    values = {name: np.array(column) for name, column in table.items() if name in names}
    for name, (first, second) in PAIRS.items():
        if name in names and first in table:
            values[name] = np.column_stack([table[first], table[second]])
    return values
