"""The tables of a bag in SQLite: held against what rosbag2 writes, its topics as channels."""

from collections.abc import Callable, Collection, Mapping
from itertools import count
from typing import TYPE_CHECKING, Final

from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding

from turtlelog.errors import LogError
from turtlelog.log.engine.channels import Catalogue
from turtlelog.log.engine.limits import DESCRIPTIONS, Allowance

if TYPE_CHECKING:
    from sqlite3 import Cursor

_TOPIC_COLUMNS: Final = ("id", "name", "type", "serialization_format")
_TOPIC_NOTES: Final = {
    "offered_qos_profiles": "offered_qos_profiles",
    "type_description_hash": "topic_type_hash",
}
"""Columns that only some versions of rosbag2 write, and their names in an MCAP channel."""

_MESSAGE_COLUMNS: Final = ("topic_id", "timestamp", "data")
_DEFINITION_COLUMNS: Final = ("topic_type", "encoding", "encoded_message_definition")

_MOST_CHANNELS: Final = 2**16 - 1  # their numbers have 16 bits in a block


Execute = Callable[..., "Cursor"]
"""Runs a query with its values, within a bounded number of steps."""


def list_columns(execute: Execute) -> dict[str, list[str]]:
    """Return the columns of the tables of a bag.

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
    columns = {}
    for table, names in (needed | {"message_definitions": _DEFINITION_COLUMNS}).items():
        if table in kinds:
            if kinds[table] != "table":
                raise LogError(f"{table}: expected a table, found {kinds[table]}")
            columns[table] = _list_table(execute, table, names)
    return columns


def _list_table(execute: Execute, table: str, needed: Collection[str]) -> list[str]:
    found = [
        (name, hidden) for _, name, _, _, _, _, hidden in execute(f"PRAGMA table_xinfo({table})")
    ]
    columns = [name for name, hidden in found if not hidden]
    for name in needed:
        if name not in columns:
            others = ", ".join(f"{other} computed" if hidden else other for other, hidden in found)
            raise LogError(f"{table}: expected a column {name}, found {others[:200]}")
    return columns


def describe_topics(
    execute: Execute,
    columns: Mapping[str, Collection[str]],
    catalogue: Catalogue,
    allowance: Allowance,
) -> dict[int, int]:
    """Fill the catalogue with the topics; return the number of each one's channel, by its id.

    Args:
        execute: Runs a query.
        columns: As `list_columns` returns them.
        catalogue: Takes channels, and the types as schemas.
        allowance: Of which each topic is spent.

    Raises:
        LogError: Where a row of `topics` or `message_definitions` is wrong, or there are too many.
    """
    numbers: dict[int, int] = {}
    definitions = _read_definitions(execute) if "message_definitions" in columns else {}
    notes = [name for name in _TOPIC_NOTES if name in columns["topics"]]
    query = f"SELECT {', '.join((*_TOPIC_COLUMNS, *notes))} FROM topics ORDER BY rowid"
    schemas: dict[str, int] = {}
    for row in execute(query):
        allowance.spend(DESCRIPTIONS)
        topic_id, name, kind, encoding, *texts = row
        if not isinstance(topic_id, int):
            raise LogError(f"topics: {name}: id: expected a whole number, found {topic_id!r:.60}")
        for column, value in zip(_TOPIC_COLUMNS[1:], (name, kind, encoding), strict=True):
            if not isinstance(value, str):
                found = "NULL" if value is None else repr(value)[:60]
                raise LogError(f"topics: row {topic_id}: {column}: expected text, found {found}")
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


def _read_definitions(execute: Execute) -> dict[str, tuple[str, str]]:
    """Return encoding and text of the types that the file defines itself."""
    query = f"SELECT {', '.join(_DEFINITION_COLUMNS)} FROM message_definitions ORDER BY rowid"
    definitions: dict[str, tuple[str, str]] = {}
    for number, row in zip(count(1), execute(query), strict=False):
        if not all(isinstance(value, str) for value in row):
            raise LogError(f"message_definitions: row {number}: expected texts, found {row!r:.60}")
        kind, encoding, text = row
        # rosbag2 writes the encoding `unknown`, and no text, where it finds no definition.
        if text and encoding != "unknown":
            definitions.setdefault(kind, (encoding, text))
    return definitions
