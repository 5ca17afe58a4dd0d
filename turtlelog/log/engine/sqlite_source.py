"""Reading of requested messages from a SQLite bag, block by block as from an MCAP file.

The blobs of a batch are joined, each after the header of an MCAP message record.

A recording cannot run code: only tables are read, never views, and no function of the schema is
called. Reading a file whose pages form a loop stops after a limited number of steps.
"""

from array import array
from collections import Counter
from collections.abc import (
    Callable,
    Collection,
    Iterable,
    Iterator,
    Mapping,
    Sequence,
    Set as AbstractSet,
)
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding

from turtlelog.errors import LogError
from turtlelog.log.engine.blocks import Block, group_starts
from turtlelog.log.engine.channels import Catalogue
from turtlelog.log.engine.limits import DESCRIPTIONS, SCHEMA_BYTES, Allowance
from turtlelog.log.engine.records import COUNTED_HEAD, HEADING, MESSAGE_HEAD
from turtlelog.log.engine.sqlite_file import open_connection
from turtlelog.log.file_access import DamageError

if TYPE_CHECKING:
    import sqlite3
    from sqlite3 import Cursor

T = TypeVar("T")
Row = tuple[Any, ...]

_LEAST_ROWS: Final = 16
_MOST_ROWS: Final = 2**9
_BLOCK_BYTES: Final = 2**22

_ROW_BYTES: Final = 4
"""Smallest size of a row in addition to its blob, for the limit [bytes]; real rows have about
12."""

_STEPS: Final = 100_000  # steps of SQLite's virtual machine between two checks of their number
_BASE_STEPS: Final = 20_000_000
_STEPS_A_BYTE: Final = 20
"""Steps per byte: counting a row of 20 bytes takes about 40 steps."""

_FUNCTIONS: Final = frozenset({"count", "min", "max", "typeof"})

_GAP: Final = bytearray(MESSAGE_HEAD)

_SHORTENED: Final = (
    "CASE typeof({0}) WHEN 'integer' THEN {0} WHEN 'real' THEN 0.5 WHEN 'text' THEN ''"
    " WHEN 'blob' THEN x'' END"
)
"""A value of the same type as a column's, and of few bytes."""


class SqliteRows:
    """Rows of `topic_id`, `timestamp` and `data` by column; few at a time stay in the cache."""

    def __init__(self) -> None:
        self.ids, self.times, self.lengths = (array("q") for _ in range(3))
        self.size = 0
        self._parts: list[bytearray] = []

    def take(self, rows: list[Row]) -> int:
        """Add rows; return the total size of their blobs [bytes]."""
        ids, times, blobs = zip(*rows, strict=True)
        self.ids.extend(ids)
        self.times.extend(times)
        self.lengths.extend(map(len, blobs))
        part = _GAP.join(blobs)
        self._parts.append(part)
        size = len(part) - MESSAGE_HEAD * (len(rows) - 1)
        self.size += size
        return size

    def join(self) -> bytearray:
        """Return the blobs with a gap before each blob."""
        return _GAP.join((b"", *self._parts))


class SqliteSource:
    """An open SQLite bag with checked tables.

    Attributes:
        catalogue: Catalogue with topics as channels and types as schemas.
        is_indexed: Always True: the catalogue is complete before the first message is read.
        statistics: Always None. `count_messages` counts messages instead.
        size: Size of the file [bytes].
        row_number: Name of the row number in the table `messages`.
    """

    is_indexed = True
    statistics = None
    summary_start = 0
    index_length = 0

    def __init__(self, connection: "sqlite3.Connection", size: int, stored_size: int) -> None:
        self._connection = connection
        connection.execute("PRAGMA query_only = ON")
        connection.execute("PRAGMA trusted_schema = OFF")
        connection.execute("PRAGMA cell_size_check = ON")
        self.size = size
        self._steps_left = 0
        connection.set_progress_handler(self._count_steps, _STEPS)
        tables = _list_tables(self.execute)
        connection.set_authorizer(_authorize)
        self.catalogue = Catalogue(Allowance(stored_size))
        self._numbers = _read_channels(self.execute, tables, self.catalogue)
        self.row_number = tables["messages"].row_number

    def execute(self, query: str, *values: object) -> "sqlite3.Cursor":
        """Run a query. The number of steps is limited in proportion to the file's size."""
        self._steps_left = _BASE_STEPS + _STEPS_A_BYTE * self.size
        return self._connection.execute(query, values)

    def count_messages(self) -> tuple[Counter[int], tuple[int, int] | None]:
        """Return the number of messages by channel; the first and last log time [ns], if any."""
        counts, times = Counter[int](), list[int]()
        query = (
            "SELECT topic_id, count(*), min(timestamp), max(timestamp) FROM messages NOT INDEXED"
            " WHERE typeof(topic_id) = 'integer' AND typeof(timestamp) = 'integer'"
            " GROUP BY topic_id"
        )
        for topic_id, messages, start_ns, end_ns in self.execute(query):
            number = self._numbers.get(topic_id)
            if number is None:
                raise DamageError(
                    f"messages: topic_id {topic_id}: expected a row in topics, found only"
                    f" messages: {messages}"
                )
            counts[number] = messages
            times += start_ns, end_ns
        [(rows,)] = self.execute("SELECT count(*) FROM messages NOT INDEXED")
        if rows != counts.total():
            raise self._find_fault()
        return counts, (min(times), max(times)) if times else None

    def map_blocks(
        self,
        work: Callable[[Block], T],
        channels: AbstractSet[int] | None = None,
        start_ns: int = 0,
        end_ns: int = 2**64,
    ) -> Iterator[T]:
        """Yield the result of `work` for each block, in the order in which rows were written."""
        query, conditions = "SELECT topic_id, timestamp, data FROM messages NOT INDEXED", []
        # The plus sign keeps SQLite from converting a text to a number.
        if channels is not None and not channels >= {*self._numbers.values()}:
            wanted = (str(key) for key, number in self._numbers.items() if number in channels)
            conditions.append(f"+topic_id IN ({','.join(wanted)})")
        conditions += [f"+timestamp >= {min(start_ns, 2**63 - 1)}"] if start_ns > 0 else []
        conditions += [f"+timestamp < {end_ns}"] if end_ns < 2**63 else []
        if conditions:
            query += f" WHERE {' AND '.join(conditions)}"
        cursor = self.execute(f"{query} ORDER BY {self.row_number}")
        yield from map(work, self._iterate_blocks(cursor))

    def _iterate_blocks(self, cursor: "sqlite3.Cursor") -> Iterator[Block]:
        first, count, left = 1, _LEAST_ROWS, self.size
        rows = SqliteRows()
        while found := cursor.fetchmany(count):
            try:
                size = rows.take(found)
            except TypeError as err:
                raise self._find_fault() from err
            left -= size + _ROW_BYTES * len(found)
            if left < 0:
                raise DamageError(
                    f"expected messages of up to {self.size} bytes in all, the size of the file,"
                    " found more"
                )
            if rows.size >= _BLOCK_BYTES:
                yield self.build_block(rows, first)
                first, rows = first + len(rows.times), SqliteRows()
            count = min(2 * count, _BLOCK_BYTES * len(found) // (size + 1) + 1, _MOST_ROWS)
        if rows.times:
            yield self.build_block(rows, first)

    def build_block(self, rows: SqliteRows, first: int) -> Block:
        """Return rows as a block; `first` is the number of the first row, from 1."""
        time_ns, ids = np.frombuffer(rows.times, np.int64), np.frombuffer(rows.ids, np.int64)
        known = np.array(sorted(self._numbers), np.int64)
        places = np.minimum(np.searchsorted(known, ids), len(known) - 1)
        if time_ns.min() < 0 or not len(known) or (known[places] != ids).any():
            raise self._find_fault()
        numbers = np.array([self._numbers[number] for number in known.tolist()])[places]
        data, lengths = rows.join(), np.frombuffer(rows.lengths, np.int64)
        starts = np.cumsum(lengths + MESSAGE_HEAD) - lengths - MESSAGE_HEAD
        heads = np.zeros(len(starts), HEADING)
        heads["opcode"], heads["length"] = Opcode.MESSAGE, lengths + COUNTED_HEAD
        heads["channel"], heads["log_time"], heads["publish_time"] = numbers, time_ns, time_ns
        kind = f"V{MESSAGE_HEAD}"
        places = np.ndarray((len(data) - MESSAGE_HEAD + 1,), kind, buffer=data, strides=(1,))
        places[starts] = heads.view(kind)
        offsets = group_starts(numbers, starts)
        return Block(data=bytes(data), byte=first, offsets=offsets, rest=(), unit="rows from")

    def judge_row(self, topic_id: object, timestamp: object, data: object) -> str | None:
        """Return the error in a row; None if valid."""
        if not isinstance(topic_id, int):
            return f"topic_id: expected a whole number, found {_name_kind(topic_id)}"
        if topic_id not in self._numbers:
            return f"the table topics has no topic_id {topic_id}"
        if not isinstance(timestamp, int) or timestamp < 0:
            found = timestamp if isinstance(timestamp, int) else _name_kind(timestamp)
            return f"timestamp: expected nanoseconds from 0 on, found {found}"
        is_blob = isinstance(data, bytes)
        return None if is_blob else f"data: expected a blob, found {_name_kind(data)}"

    def _find_fault(self) -> DamageError:
        """Return the error of the first invalid row of `messages`."""
        query = (
            f"SELECT {self.row_number}, {', '.join(map(_SHORTENED.format, _MESSAGE_COLUMNS))}"
            " FROM messages NOT INDEXED"
            " WHERE typeof(timestamp) != 'integer' OR typeof(data) != 'blob'"
            " OR typeof(topic_id) != 'integer' OR timestamp < 0"
            f" OR topic_id NOT IN (SELECT id FROM topics) ORDER BY {self.row_number} LIMIT 1"
        )
        found = self.execute(query).fetchone()
        if found is None:
            return DamageError(
                "messages: expected rows with a topic, a time and data, found others"
            )
        row, *values = found
        return DamageError(f"messages: row {row}: {self.judge_row(*values)}")

    def _count_steps(self) -> bool:
        self._steps_left -= _STEPS
        return self._steps_left < 0


@contextmanager
def open_sqlite(
    path: Path, stored_size: int, *, is_damaged: bool = False
) -> Iterator[SqliteSource]:
    """Open a SQLite bag; the size of the file before unpacking [bytes] sets the limits."""
    with open_connection(path, is_damaged=is_damaged) as (connection, size):
        yield SqliteSource(connection, size, stored_size)


def _name_kind(value: object) -> str:
    names = {bytes: "blob", float: "real", int: "integer", str: "text"}
    return names.get(type(value), "null")


def _authorize(
    action: int, _: str | None, second: str | None, __: str | None, inside: str | None
) -> int:
    """Allow reading and counting tables, and deny everything within a view or trigger."""
    import sqlite3

    is_reading = action in {sqlite3.SQLITE_SELECT, sqlite3.SQLITE_READ}
    is_known = is_reading or (action == sqlite3.SQLITE_FUNCTION and second in _FUNCTIONS)
    return sqlite3.SQLITE_OK if is_known and inside is None else sqlite3.SQLITE_DENY


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


class _BagTable(NamedTuple):
    columns: Sequence[str]  # with values, named as in the file
    row_number: str  # name of the row number; no column has this name


def _list_tables(execute: _Execute) -> dict[str, _BagTable]:
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


def _describe_table(execute: _Execute, table: str, needed: Collection[str]) -> _BagTable:
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
    return _BagTable(columns, free[0])


def _read_channels(
    execute: _Execute, tables: Mapping[str, _BagTable], catalogue: Catalogue
) -> dict[int, int]:
    """Add the topics to the catalogue; return the channel number of each topic by its id."""
    numbers: dict[int, int] = {}
    allowance = catalogue.allowance
    definitions = _read_definitions(execute, tables, allowance)
    notes = [name for name in _TOPIC_NOTES if name in tables["topics"].columns]
    schemas: dict[str, int] = {}
    for row in _select(execute, tables, "topics", (*_TOPIC_COLUMNS, *notes)):
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
    execute: _Execute, tables: Mapping[str, _BagTable], allowance: Allowance
) -> dict[str, tuple[str, str]]:
    definitions: dict[str, tuple[str, str]] = {}
    rows = _select(execute, tables, "message_definitions", _DEFINITION_COLUMNS)
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
    execute: _Execute, tables: Mapping[str, _BagTable], name: str, columns: Sequence[str]
) -> Iterable[tuple[Any, ...]]:
    if name not in tables:
        return ()
    order = tables[name].row_number
    return execute(f"SELECT {', '.join(columns)} FROM {name} NOT INDEXED ORDER BY {order}")


def _require_texts(place: str, columns: Sequence[str], values: Sequence[object]) -> None:
    for column, value in zip(columns, values, strict=True):
        if not isinstance(value, str):
            shown = value[:60] if isinstance(value, bytes) else value
            found = "NULL" if value is None else repr(shown)[:60]
            raise LogError(f"{place}: {column}: expected text, found {found}")


FIRST_ROW: Final = -(2**63)
LAST_ROW: Final = 2**63 - 1
"""Smallest and largest number of a row in SQLite."""


def build_query(source: SqliteSource) -> str:
    """Return the query for the rows of messages from a row number on, in order."""
    number = source.row_number
    return (
        f"SELECT {number}, topic_id, timestamp, data FROM messages NOT INDEXED"
        f" WHERE {number} >= ? ORDER BY {number}"
    )


def read_row(source: SqliteSource, after: int) -> Row | None:
    """Return the first row after another row; () after the last row, None if it cannot be read."""
    import sqlite3

    if after == LAST_ROW:
        return ()
    try:
        found: Row | None = source.execute(f"{build_query(source)} LIMIT 1", after + 1).fetchone()
    except sqlite3.Error:
        return None
    return () if found is None else found


def find_next_row(source: SqliteSource, after: int) -> int | None:
    """Return the number of the first readable row after a gap; None if no such row exists."""
    lost = max(after, 0)
    step, found = 1, None
    while lost + step <= LAST_ROW and (found := read_row(source, lost + step)) is None:
        step *= 2
    if found is None:
        return None
    least, most = step // 2, step  # the row after `least` is lost, the row after `most` is not
    while most - least > 1:
        middle = (least + most) // 2
        nearer = read_row(source, lost + middle)
        least, most, found = (middle, most, found) if nearer is None else (least, middle, nearer)
    return int(found[0]) if found else None
