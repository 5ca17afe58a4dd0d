"""The tables of a bag in SQLite: held against what rosbag2 writes, its topics as channels."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding

from turtlelog.errors import LogError
from turtlelog.log.engine.channels import Catalogue
from turtlelog.log.engine.limits import DESCRIPTIONS, SCHEMA_BYTES, Allowance

if TYPE_CHECKING:
    from sqlite3 import Cursor

_TOPIC_COLUMNS: Final = ("id", "name", "type", "serialization_format")
_TOPIC_NOTES: Final = {
    "offered_qos_profiles": "offered_qos_profiles",
    "type_description_hash": "topic_type_hash",
}
"""Columns that only some versions of rosbag2 write, and their names in an MCAP channel."""

_ROW_NUMBERS: Final = ("rowid", "_rowid_", "oid")

_MESSAGE_COLUMNS: Final = ("topic_id", "timestamp", "data")
_DEFINITION_COLUMNS: Final = ("topic_type", "encoding", "encoded_message_definition")

_MOST_CHANNELS: Final = 2**16 - 1  # their numbers have 16 bits in a block


Execute = Callable[..., "Cursor"]
"""Runs a query with its values, within a bounded number of steps."""


@dataclass(frozen=True, slots=True)
class BagTable:
    """A table of a bag.

    Attributes:
        columns: Those that hold values, by the names that the file gives them.
        row_number: The name of the numbers of its rows: one that is no column's.
    """

    columns: Sequence[str]
    row_number: str


def list_tables(execute: Execute) -> dict[str, BagTable]:
    """Return the tables of a bag by their names.

    Raises:
        LogError: Where one that is needed is missing, or is no plain table.
    """
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


def _describe_table(execute: Execute, table: str, needed: Collection[str]) -> BagTable:
    found = [
        (name, hidden) for _, name, _, _, _, _, hidden in execute(f"PRAGMA table_xinfo({table})")
    ]
    columns = [name for name, hidden in found if not hidden]
    for name in needed:
        if name not in columns:
            others = ", ".join(f"{other} computed" if hidden else other for other, hidden in found)
            raise LogError(f"{table}: expected a column {name}, found {others[:200]}")
    import sqlite3  # files of MCAP spare it

    # A column of such a name hides the number.
    taken = {name.lower() for name, _ in found}
    free = [name for name in _ROW_NUMBERS if name not in taken]
    if not free:
        raise LogError(f"{table}: expected rows with numbers, found columns of all their names")
    try:
        execute(f"SELECT {free[0]} FROM {table} NOT INDEXED LIMIT 0")
    except sqlite3.OperationalError as err:
        raise LogError(f"{table}: its rows have no numbers: {err}") from err
    return BagTable(columns, free[0])


def describe_topics(
    execute: Execute,
    tables: Mapping[str, BagTable],
    catalogue: Catalogue,
    allowance: Allowance,
) -> dict[int, int]:
    """Fill the catalogue with the topics; return the number of each one's channel, by its id.

    Args:
        execute: Runs a query.
        tables: As `list_tables` returns them.
        catalogue: Takes channels, and the types as schemas.
        allowance: Of which each topic is spent.

    Raises:
        LogError: Where a row of `topics` or `message_definitions` is wrong, or there are too many.
    """
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
    execute: Execute, table: BagTable, allowance: Allowance
) -> dict[str, tuple[str, str]]:
    """Return encoding and text of the types that the file defines itself."""
    definitions: dict[str, tuple[str, str]] = {}
    rows = _select(execute, "message_definitions", table, _DEFINITION_COLUMNS)
    for number, row in enumerate(rows, start=1):
        allowance.spend(DESCRIPTIONS)
        _require_texts(f"message_definitions: row {number}", _DEFINITION_COLUMNS, row)
        allowance.spend(SCHEMA_BYTES, sum(map(len, row)))
        kind, encoding, text = row
        # rosbag2 writes the encoding `unknown`, and no text, where it finds no definition.
        if text and encoding != "unknown":
            definitions.setdefault(kind, (encoding, text))
    return definitions


def _select(
    execute: Execute, name: str, table: BagTable, columns: Sequence[str]
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
