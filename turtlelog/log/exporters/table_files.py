"""Run -> CSV and Parquet files."""

import csv
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from turtlelog.errors import LogError
from turtlelog.escapes import guard_cell
from turtlelog.log.complete_files import replace_when_complete
from turtlelog.log.exporters.folder import create_folder
from turtlelog.log.exporters.tables import TABLES, Table, tabulate_run
from turtlelog.run import Run

_DEFAULT_TABLE: Final = "poses"
_Write = Callable[[Table, Path], None]


def export_csv(run: Run, path: str | Path, *, table: str | None = None) -> tuple[Path, ...]:
    """Write the tables of a run as CSV and return the files; numbers read back to the last bit.

    Args:
        run: What to write.
        path: A name that ends in .csv is a file for one table, and replaces one that is there;
            any other is a new folder with a file per table.
        table: Which one (`poses`, `commands`, `samples`, `events`); a file holds `poses` and a
            folder all of them unless this is given.

    Raises:
        LogError: Where the place cannot be written, a folder exists, or there is no such table.
    """
    return _export(run, Path(path), ".csv", table, _write_csv)


def export_parquet(run: Run, path: str | Path, *, table: str | None = None) -> tuple[Path, ...]:
    """Write the tables of a run as Parquet and return the files; as `export_csv`, with types.

    Raises:
        LogError: Where the place cannot be written, a folder exists, or there is no such table.
    """
    return _export(run, Path(path), ".parquet", table, _write_parquet)


def _export(
    run: Run, path: Path, suffix: str, table: str | None, write: _Write
) -> tuple[Path, ...]:
    if table is not None and table not in TABLES:
        raise LogError(f"table: expected one of {', '.join(TABLES)}, found {table}")
    if path.suffix.lower() == suffix:
        with replace_when_complete(path) as temporary, _name_place(path):
            write(TABLES[table or _DEFAULT_TABLE](run), temporary)
        return (path,)
    names = tuple(TABLES) if table is None else (table,)
    tables = tabulate_run(run)
    with create_folder(path) as folder, _name_place(path):
        for name in names:
            write(tables[name], folder / f"{name}{suffix}")
    return tuple(path / f"{name}{suffix}" for name in names)


@contextmanager
def _name_place(path: Path) -> Iterator[None]:
    try:
        yield
    except UnicodeEncodeError as err:
        raise LogError(f"{path}: expected text, found characters that UTF-8 lacks: {err}") from err


def _write_csv(table: Table, path: Path) -> None:
    with path.open("w", encoding="utf-8", newline="") as stream:
        # One line end on every platform: the same run gives the same bytes.
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(table)
        columns = (map(guard_cell, column.tolist()) for column in table.values())
        writer.writerows(zip(*columns, strict=True))


def _write_parquet(table: Table, path: Path) -> None:
    # Comes with rerun-sdk and takes a second to load.
    import pyarrow as pa  # type: ignore[import-untyped]
    from pyarrow import parquet

    kinds = {"f": pa.float64(), "i": pa.int64(), "O": pa.string()}
    columns = {
        name: pa.array(values, type=kinds[values.dtype.kind]) for name, values in table.items()
    }
    with path.open("wb") as stream:
        parquet.write_table(pa.table(columns), stream, compression="zstd")
