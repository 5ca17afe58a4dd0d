"""Tables that turtlelog wrote, CSV or Parquet -> Run; what was written, read back."""

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError, RunError
from turtlelog.escapes import guard_cell
from turtlelog.log.error_boundary import name_file, open_file
from turtlelog.log.exporters import PAIRS, TABLES, Table, tabulate_run
from turtlelog.loops import PAUSE, Declaration
from turtlelog.run import CommandColumns, Event, PoseColumns, Run, SampleColumns

TABLE_SUFFIXES: Final = (".csv", ".parquet")
_WHOLE: Final = frozenset({"time_ns", "sequence", "pose_sequence"})
_TEXTS: Final = frozenset({"phase", "kind", "text"})
_LONGEST_HEAD: Final = 64 * 1024
"""Bytes of a first line that may name columns: 250 states of 60 letters, and the rest, fit in."""

_MARKS: Final[Mapping[str, frozenset[str]]] = {
    "events": frozenset({"time_ns", "kind", "text"}),
    "samples": frozenset({"time_ns", "sequence", "pose_sequence", "phase"}),
    "commands": frozenset({"time_ns", "speed_m_s", "lateral_speed_m_s", "turn_rate_rad_s"}),
    "poses": frozenset({"time_ns", "x_m", "y_m", "heading_rad"}),
}
"""Columns that tell which table a file holds."""


def find_table(columns: Sequence[str]) -> str | None:
    """Return which table of a run has these columns, None where it is none of ours."""
    return next((name for name, marks in _MARKS.items() if marks <= {*columns}), None)


def list_table_files(folder: Path) -> tuple[Path, ...]:
    """Return the tables that `turtlelog convert` wrote into a folder, none in any other folder."""
    for suffix in TABLE_SUFFIXES:
        if (folder / f"poses{suffix}").is_file():
            files = (folder / f"{name}{suffix}" for name in TABLES)
            return tuple(path for path in files if path.is_file())
    return ()


def holds_tables(path: Path) -> bool:
    """Return whether a folder or a file holds tables that turtlelog wrote, by its first line."""
    if path.is_dir():
        return bool(list_table_files(path))
    if path.suffix.lower() != ".csv":
        return path.suffix.lower() == ".parquet"
    with open_file(path) as stream:
        head = stream.readline(_LONGEST_HEAD).decode("utf-8-sig", errors="replace")
    return find_table(head.strip().split(",")) is not None


def import_tables(path: str | Path) -> Run:
    """Return the run in tables that were written as CSV or Parquet: a folder of them, or its poses.

    Tables do not hold the scenario, the goal, the loops of the law and the stop reason.

    Raises:
        LogError: One line with the file and the column, where a table is wrong.
    """
    path = Path(path)
    files = list_table_files(path) if path.is_dir() else (path,)
    tables: dict[str, Table] = {}
    for file in files:
        tables |= read_table(file)
    with name_file(path, expected="tables of a run"):
        if "poses" not in tables:
            found = ", ".join(tables) or "none"
            raise LogError(f"expected the poses of a run, found its {found} alone")
        try:
            return _build_run(tables, path)
        except RunError as err:
            raise LogError(str(err)) from err


def read_table(path: Path) -> Mapping[str, Table]:
    """Return the one table in a file under its name.

    Raises:
        LogError: One line with the file, where it holds none.
    """
    with name_file(path, expected="a table of a run"):
        is_parquet = path.suffix.lower() == ".parquet"
        table = _read_parquet(path) if is_parquet else _read_csv(path)
        name = find_table([*table])
        if name is None:
            found = ", ".join(table)[:80] or "none"
            raise LogError(f"expected the columns of a table that turtlelog wrote, found {found}")
        return {name: table}


def require_read_back(run: Run, written: Sequence[Path], read: Run | None) -> None:
    """Refuse files that hold other rows than the run that was written.

    Args:
        run: What was written.
        written: The files; tables among them are read here.
        read: The run that was read back from a recording or a bag; None where tables were written.

    Raises:
        LogError: With the file, the table and the column.
    """
    expected = tabulate_run(run)
    if read is not None:
        _require_same(written[0], expected, tabulate_run(read))
        return
    for path in written:
        found = read_table(path)
        _require_same(path, {name: expected[name] for name in found}, found)


def _require_same(path: Path, expected: Mapping[str, Table], found: Mapping[str, Table]) -> None:
    for name, table in expected.items():
        for column in [*dict.fromkeys([*table, *found[name]])]:
            if not _is_same(table.get(column), found[name].get(column)):
                raise LogError(
                    f"{path}: expected to read back what was written, found other values in"
                    f" {column} of {name}"
                )


def _is_same(written: NDArray[Any] | None, read: NDArray[Any] | None) -> bool:
    if written is None or read is None or not len(written):
        return not len([] if written is None else written) and not len([] if read is None else read)
    return np.array_equal(written, read, equal_nan=written.dtype.kind == "f")


def _read_csv(path: Path) -> Table:
    with open_file(path) as stream, io.TextIOWrapper(stream, "utf-8-sig", newline="") as text:
        head, *rows = [row for row in csv.reader(text) if row] or [[]]
    for number, row in enumerate(rows, start=1):
        if len(row) != len(head):
            raise LogError(f"row {number}: expected {len(head)} cells, found {len(row)}")
    columns = zip(*rows, strict=True) if rows else ((),) * len(head)
    return {name: _parse(name, column) for name, column in zip(head, columns, strict=True)}


def _parse(name: str, cells: Sequence[str]) -> NDArray[Any]:
    if name in _TEXTS:
        return np.array([_release(cell) for cell in cells], dtype=object)
    kind = np.int64 if name in _WHOLE else np.float64
    values = np.empty(len(cells), dtype=kind)
    for row, cell in enumerate(cells):
        try:
            values[row] = kind(cell)
        except (ValueError, OverflowError) as err:
            word = "a whole number" if name in _WHOLE else "a number"
            raise LogError(f"{name}[{row}]: expected {word}, found {cell[:40]!r}") from err
    return values


def _release(cell: str) -> str:
    """Return a text without the apostrophe that `guard_cell` put before it."""
    inner = cell.removeprefix("'")
    return inner if guard_cell(inner) == cell else cell


def _read_parquet(path: Path) -> Table:
    from pyarrow import ArrowException, parquet  # type: ignore[import-untyped]

    with open_file(path) as stream:
        try:
            table = parquet.read_table(stream)
        except ArrowException as err:
            raise LogError(f"expected a Parquet file, found none: {err}") from err
        return {
            name: table[name].to_numpy() if name not in _TEXTS else _list_texts(table[name])
            for name in table.column_names
        }


def _list_texts(column: Any) -> NDArray[Any]:
    return np.array(column.to_pylist(), dtype=object)


def _build_run(tables: Mapping[str, Table], path: Path) -> Run:
    poses, events = tables["poses"], tables.get("events", {})
    empty = np.array([], dtype=np.float64)
    commands = tables.get("commands") or {
        "time_ns": np.array([], dtype=np.int64),
        **dict.fromkeys(("speed_m_s", "lateral_speed_m_s", "turn_rate_rad_s"), empty),
    }
    samples, declaration = _build_samples(tables.get("samples"))
    absent = [name for name in ("commands", "samples", "events") if name not in tables]
    absent += ["goal_xy_m", "goal_heading_rad", "parameters", "stop_reason"]
    return Run(
        name=path.stem,
        source=f"tables {path.name}",
        poses=PoseColumns(**_gather(poses, PoseColumns)),
        commands=CommandColumns(**_gather(commands, CommandColumns)),
        samples=samples,
        declaration=declaration,
        events=tuple(
            Event(time_ns=int(time_ns), kind=kind, text=text)
            for time_ns, kind, text in zip(*events.values(), strict=True)
        ),
        absent=tuple(absent),
    )


def _build_samples(table: Table | None) -> tuple[SampleColumns, Declaration]:
    if table is None:
        none, nothing = np.array([], dtype=np.int64), np.array([], dtype=np.float64)
        empty = SampleColumns(
            time_ns=none,
            sequence=none,
            pose_sequence=none,
            phase=none,
            speed_m_s=nothing,
            turn_rate_rad_s=nothing,
        )
        return empty, Declaration()
    labels = [*dict.fromkeys(table["phase"].tolist())]
    phases = {name: () for name in labels if name not in {PAUSE, "done"}}
    values = _gather(table, SampleColumns)
    known = {*(name for pair in PAIRS.values() for name in pair), *values}
    states = {
        name.removeprefix("state_") if name.removeprefix("state_") in known else name: column
        for name, column in table.items()
        if name not in known
    }
    declaration = Declaration(phases=phases or {"control": ()}, states=tuple(states))
    indices = {name: index for index, name in enumerate(declaration.phase_names)}
    values["phase"] = np.array([indices[name] for name in table["phase"]], dtype=np.int64)
    if states:
        values["states"] = np.column_stack([*states.values()])
    return SampleColumns(**values), declaration


def _gather(table: Table, kind: type) -> dict[str, NDArray[Any]]:
    """Return the columns of a table as the fields of a run's, pairs put together."""
    names = kind.__dataclass_fields__  # type: ignore[attr-defined]
    values = {name: np.array(column) for name, column in table.items() if name in names}
    for name, (first, second) in PAIRS.items():
        if name in names and first in table:
            values[name] = np.column_stack([table[first], table[second]])
    return values
