"""Opening of SQLite files without writing next to them, and the tables of a bag."""

import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding

from turtlelog.errors import LogError
from turtlelog.log.engine.channels import Catalogue
from turtlelog.log.engine.limits import DESCRIPTIONS, SCHEMA_BYTES, Allowance
from turtlelog.log.file_access import DamageError, open_file

if TYPE_CHECKING:
    import sqlite3
    from sqlite3 import Cursor


_HEADER: Final = 100  # bytes
_PAGE_SIZE: Final = slice(16, 18)
_CHANGES: Final = slice(24, 28)
_PAGES: Final = slice(28, 32)
_COUNTED_AT: Final = slice(92, 96)
"""Position in the header of the change counter and the number of pages."""

_LEAST_LIMIT, _MOST_LIMIT = 2**16, 2**31 - 1  # bytes of a value; turtlelog's own queries fit

_SIDES: Final = ("-wal", "-journal")
_JOURNAL_MAGIC: Final = bytes.fromhex("d9d505f920a163d7")
"""End of a journal that names another file, which SQLite would delete."""


@contextmanager
def open_connection(path: Path, *, is_damaged: bool) -> "Iterator[tuple[sqlite3.Connection, int]]":
    """Open a SQLite file for reading; yield the connection and the file's size [bytes].

    Nothing is written next to the file. A `-wal` file next to it contains committed rows, a
    `-journal` file contains uncommitted changes to undo. To use these files, SQLite would write
    next to the file; therefore a copy in a temporary folder is opened. The sizes that pages claim
    are checked before SQLite reads the first table. A damaged file is read as far as possible.

    Raises:
        LogError: If the file cannot be read, also for errors of SQLite while the file is open; the
            message is one clause.
    """
    import shutil  # MCAP files do not need these
    import sqlite3
    from tempfile import TemporaryDirectory

    from turtlelog.log.engine.sqlite_pages import check_pages

    path = path.resolve()
    with ExitStack() as closing:
        place = path
        sides = [path.with_name(path.name + side) for side in _SIDES]
        try:
            if present := [side for side in sides if side.exists() and side.stat().st_size]:
                folder = Path(closing.enter_context(TemporaryDirectory(prefix="turtlelog-")))
                place = folder / "bag.db3"
                _copy_with_sides(path, place, present)
                _take_sides_in(place, is_damaged=is_damaged)
            size, claimed, page = measure_pages(place)
            is_short = size % page or size < claimed
            if is_short and not is_damaged:
                expected = f"{claimed} bytes" if claimed > size else f"pages of {page} bytes"
                raise DamageError(
                    f"expected a SQLite file of {expected}, found {size} bytes: cut short;"
                    " turtlelog convert --recover reads what is left"
                )
            if size % page:  # SQLite would fill an incomplete last page with zeros
                if place == path:
                    folder = Path(closing.enter_context(TemporaryDirectory(prefix="turtlelog-")))
                    place = Path(shutil.copyfile(path, folder / "bag.db3"))
                os.truncate(place, size - size % page)
            check_pages(place, page, is_damaged=is_damaged)
            connection = _connect(place, "mode=ro&immutable=1", is_damaged=is_damaged)
            closing.callback(connection.close)
            longest = min(max(size, _LEAST_LIMIT), _MOST_LIMIT)
            connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, longest)
            yield connection, size
        except sqlite3.Error as err:
            raise DamageError(describe_sqlite_error(err)) from err


def _connect(place: Path, mode: str, *, is_damaged: bool) -> "sqlite3.Connection":
    import sqlite3

    connection = sqlite3.connect(
        f"{place.as_uri()}?{mode}", uri=True, isolation_level=None, check_same_thread=False
    )
    if is_damaged:  # the header may claim more pages than the file has
        connection.execute("PRAGMA writable_schema = ON")
    return connection


def _take_sides_in(place: Path, *, is_damaged: bool) -> None:
    """Make SQLite merge the files next to a copy into this copy, without reading a table."""
    most = sum(found.stat().st_size for found in place.parent.iterdir())
    connection = _connect(place, "mode=rw", is_damaged=is_damaged)
    try:
        connection.execute("BEGIN IMMEDIATE")
        connection.execute("COMMIT")
    finally:
        connection.close()
    if place.stat().st_size > most:
        raise DamageError(
            f"expected a SQLite file of up to {most} bytes, found a journal that claims more"
        )


def measure_pages(path: Path) -> tuple[int, int, int]:
    """Return the size of a file, the size in its header, and the size of a page [bytes]."""
    with path.open("rb") as stream:
        head = stream.read(_HEADER)
        size = stream.seek(0, os.SEEK_END)
    page = int.from_bytes(head[_PAGE_SIZE], "big")
    page = 2**16 if page == 1 else page or 2**16
    # Before version 3.7 SQLite did not update the number of pages and left another number there.
    is_kept = head[_CHANGES] == head[_COUNTED_AT]
    pages = int.from_bytes(head[_PAGES], "big") if is_kept else 0
    return size, pages * page, page


def describe_sqlite_error(err: "sqlite3.Error") -> str:
    """Return an error of SQLite as one clause."""
    text = " ".join(str(err).split())
    if text == "interrupted":
        text = "pages that lead in circles, or far more rows than its size allows"
    return f"expected a sound SQLite file, found: {text}"


def _copy_with_sides(path: Path, place: Path, sides: list[Path]) -> None:
    import shutil

    for source in (path, *sides):
        target = place.with_name(place.name + source.name.removeprefix(path.name))
        with open_file(source) as stream, target.open("wb") as copy:
            shutil.copyfileobj(stream, copy, 2**20)
        if source.name.endswith("-journal"):
            with target.open("rb") as stream:
                stream.seek(-min(16, target.stat().st_size), 2)
                if stream.read()[-8:] == _JOURNAL_MAGIC:
                    raise LogError(
                        f"{source.name}: expected the journal of one file, found one that names"
                        " another"
                    )


_TOPIC_COLUMNS: Final = ("id", "name", "type", "serialization_format")
_TOPIC_NOTES: Final = {
    "offered_qos_profiles": "offered_qos_profiles",
    "type_description_hash": "topic_type_hash",
}
"""Columns that only some rosbag2 versions have, and their names in an MCAP channel."""

_ROW_NUMBERS: Final = ("rowid", "_rowid_", "oid")

_MESSAGE_COLUMNS: Final = ("topic_id", "timestamp", "data")
_DEFINITION_COLUMNS: Final = ("topic_type", "encoding", "encoded_message_definition")

_MOST_CHANNELS: Final = 2**16 - 1  # channel numbers have 16 bits in a block

_Execute = Callable[..., "Cursor"]
"""A function that runs a query with its values, within a limited number of steps."""


@dataclass(frozen=True, slots=True)
class BagTable:
    """A table of a bag.

    Attributes:
        columns: Columns with values, named as in the file.
        row_number: Name of the row number; no column has this name.
    """

    columns: Sequence[str]
    row_number: str


def list_tables(execute: _Execute) -> dict[str, BagTable]:
    """Return the tables of a bag by name."""
    kinds = {}
    for kind, name, sql in execute("SELECT type, name, sql FROM sqlite_master"):
        if kind in {"table", "view"}:
            is_plain = kind == "table" and str(sql).upper().startswith("CREATE TABLE")
            kinds[str(name)] = "table" if is_plain else str(sql)[:40]
    needed = {"topics": _TOPIC_COLUMNS, "messages": _MESSAGE_COLUMNS}
    for table in needed:
        if table not in kinds:
            found = ", ".join(kinds)[:200] or "no tables"
            raise LogError(f"expected a bag with tables topics and messages, found {found}")
    tables = {}
    for table, names in (needed | {"message_definitions": _DEFINITION_COLUMNS}).items():
        if table in kinds:
            if kinds[table] != "table":
                raise LogError(f"{table}: expected a table, found {kinds[table]}")
            tables[table] = _describe_table(execute, table, names)
    return tables


def _describe_table(execute: _Execute, table: str, needed: Collection[str]) -> BagTable:
    found = [(name, hidden) for _, name, *_, hidden in execute(f"PRAGMA table_xinfo({table})")]
    columns = [name for name, hidden in found if not hidden]
    for name in needed:
        if name not in columns:
            others = ", ".join(f"{other} computed" if hidden else other for other, hidden in found)
            raise LogError(f"{table}: expected a column {name}, found {others[:200]}")
    import sqlite3  # MCAP files do not need it

    # A column with such a name hides the row number.
    taken = {name.lower() for name, _ in found}
    free = [name for name in _ROW_NUMBERS if name not in taken]
    if not free:
        raise LogError(f"{table}: expected rows with numbers, found columns of all their names")
    try:
        execute(f"SELECT {free[0]} FROM {table} NOT INDEXED LIMIT 0")
    except sqlite3.OperationalError as err:
        raise LogError(f"{table}: its rows have no numbers: {err}") from err
    return BagTable(columns, free[0])


def read_channels(
    execute: _Execute, tables: Mapping[str, BagTable], catalogue: Catalogue, allowance: Allowance
) -> dict[int, int]:
    """Add the topics to the catalogue; return the channel number of each topic by its id."""
    numbers: dict[int, int] = {}
    described = tables.get("message_definitions")
    definitions = _read_definitions(execute, described, allowance) if described else {}
    topics = tables["topics"]
    notes = [name for name in _TOPIC_NOTES if name in topics.columns]
    schemas: dict[str, int] = {}
    for row in _select(execute, "topics", topics, (*_TOPIC_COLUMNS, *notes)):
        allowance.spend(DESCRIPTIONS)
        topic_id, name, kind, encoding, *texts = row
        if not isinstance(topic_id, int):
            found = repr(topic_id)[:60]
            raise LogError(f"topics: {str(name)[:60]}: id: expected a whole number, found {found}")
        _require_texts(f"topics: row {topic_id}", _TOPIC_COLUMNS[1:], (name, kind, encoding))
        if len(numbers) == _MOST_CHANNELS:
            raise LogError(f"topics: expected up to {_MOST_CHANNELS}, found more")
        if kind not in schemas:
            schemas[kind] = len(schemas) + 1
            encoded, data = definitions.get(kind, ("", ""))
            schema = Schema(id=schemas[kind], name=kind, encoding=encoded, data=data.encode())
            catalogue.add([schema], 0)
        numbers[topic_id] = number = len(numbers) + 1
        channel = Channel(
            id=number,
            topic=name,
            message_encoding=encoding or MessageEncoding.CDR,
            schema_id=schemas[kind],
            metadata={
                _TOPIC_NOTES[key]: str(text or "") for key, text in zip(notes, texts, strict=True)
            },
        )
        catalogue.add([channel], 0)
    return numbers


def _read_definitions(
    execute: _Execute, table: BagTable, allowance: Allowance
) -> dict[str, tuple[str, str]]:
    """Return encoding and text of the types that the file defines."""
    definitions: dict[str, tuple[str, str]] = {}
    rows = _select(execute, "message_definitions", table, _DEFINITION_COLUMNS)
    for number, row in enumerate(rows, start=1):
        allowance.spend(DESCRIPTIONS)
        _require_texts(f"message_definitions: row {number}", _DEFINITION_COLUMNS, row)
        allowance.spend(SCHEMA_BYTES, sum(map(len, row)))
        kind, encoding, text = row
        # If rosbag2 finds no definition, it writes the encoding `unknown` and no text.
        if text and encoding != "unknown":
            definitions.setdefault(kind, (encoding, text))
    return definitions


def _select(
    execute: _Execute, name: str, table: BagTable, columns: Sequence[str]
) -> Iterator[tuple[Any, ...]]:
    return execute(
        f"SELECT {', '.join(columns)} FROM {name} NOT INDEXED ORDER BY {table.row_number}"
    )


def _require_texts(place: str, columns: Sequence[str], values: Sequence[object]) -> None:
    for column, value in zip(columns, values, strict=True):
        if not isinstance(value, str):
            shown = value[:60] if isinstance(value, bytes) else value
            found = "NULL" if value is None else repr(shown)[:60]
            raise LogError(f"{place}: {column}: expected text, found {found}")
