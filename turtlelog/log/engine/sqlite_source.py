"""Reading of requested messages from a SQLite bag, block by block as from an MCAP file.

The blobs of a batch are joined, with space for the header of an MCAP message record before each
blob. All headers are written at once. After that, decoding is the same as for MCAP files.

A recording cannot run code: only tables are read, never views, and no function of the schema is
called. Reading a file whose pages form a loop stops after a limited number of steps.

A damaged bag is read row by row: the readable rows, and the gaps between them. A table is a tree of
pages in order of row numbers, so with a page its rows are lost. The rows after it are found by
searching the smallest row number that SQLite can read again.
"""

from array import array
from collections import Counter
from collections.abc import Callable, Collection, Generator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TypeVar

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.blocks import Block
from turtlelog.log.engine.channels import Catalogue
from turtlelog.log.engine.limits import DAMAGES, Allowance
from turtlelog.log.engine.parsing import COUNTED_HEAD, HEADING, MESSAGE_HEAD
from turtlelog.log.engine.sqlite_file import (
    describe_sqlite_error,
    list_tables,
    measure_pages,
    open_connection,
    read_channels,
)
from turtlelog.log.engine.walk import Loss, Section
from turtlelog.log.file_access import DamageError

if TYPE_CHECKING:
    import sqlite3

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


class SqliteRows:
    """Rows of `topic_id`, `timestamp` and `data`, column by column.

    Only few rows are taken at a time. SQLite and Python then reuse memory that stays in the
    processor's cache, so a million rows take half as long.
    """

    def __init__(self) -> None:
        self.ids, self.times, self.lengths = (array("q") for _ in range(3))
        self.size = 0
        self._parts: list[bytearray] = []

    def take(self, rows: list[Row]) -> int:
        """Add rows; return the total size of their blobs [bytes].

        Raises:
            TypeError: If a value has the wrong type.
        """
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
        tables = list_tables(self.execute)
        connection.set_authorizer(_authorize)
        self.catalogue = Catalogue(allowance := Allowance(stored_size))
        self._numbers = read_channels(self.execute, tables, self.catalogue, allowance)
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
        channels: Collection[int] | None = None,
        start_ns: int = 0,
        end_ns: int = 2**64,
    ) -> Iterator[T]:
        """Yield the result of `work` for each block, in the order in which rows were written."""
        wanted = [
            topic_id
            for topic_id, number in self._numbers.items()
            if channels is None or number in channels
        ]
        query = "SELECT topic_id, timestamp, data FROM messages NOT INDEXED"
        # The plus sign keeps SQLite from converting a text to a number.
        conditions = (
            [f"+topic_id IN ({','.join(map(str, wanted))})"]
            if len(wanted) < len(self._numbers)
            else []
        )
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
        ends = np.cumsum(lengths + MESSAGE_HEAD)
        starts = ends - lengths - MESSAGE_HEAD
        _scatter_heads(data, starts, lengths, numbers, time_ns)
        order = np.argsort(numbers, kind="stable")
        present, firsts = np.unique(numbers[order], return_index=True)
        offsets = dict(zip(present.tolist(), np.split(starts[order], firsts[1:]), strict=True))
        return Block(data=bytes(data), byte=first, offsets=offsets, rest=(), unit="rows from")

    def find_fault_of(self, row: Row) -> str | None:
        """Return the error in a row of topic, time and data; None if valid."""
        topic_id, timestamp, data = row
        if not isinstance(topic_id, int):
            return f"topic_id: expected a whole number, found {_name_kind(topic_id)}"
        if topic_id not in self._numbers:
            return f"the table topics has no topic_id {topic_id}"
        if not isinstance(timestamp, int) or timestamp < 0:
            found = timestamp if isinstance(timestamp, int) else _name_kind(timestamp)
            return f"timestamp: expected nanoseconds from 0 on, found {found}"
        if not isinstance(data, bytes):
            return f"data: expected a blob, found {_name_kind(data)}"
        return None

    def _find_fault(self) -> DamageError:
        """Return the error of the first invalid row of `messages`."""
        query = (
            f"SELECT {self.row_number}, typeof(timestamp), typeof(data), typeof(topic_id),"
            " CASE typeof(timestamp) WHEN 'integer' THEN timestamp END,"
            " CASE typeof(topic_id) WHEN 'integer' THEN topic_id END FROM messages NOT INDEXED"
            " WHERE typeof(timestamp) != 'integer' OR typeof(data) != 'blob'"
            " OR typeof(topic_id) != 'integer' OR timestamp < 0"
            f" OR topic_id NOT IN (SELECT id FROM topics) ORDER BY {self.row_number} LIMIT 1"
        )
        found = self.execute(query).fetchone()
        if found is None:
            return DamageError(
                "messages: expected rows with a topic, a time and data, found others"
            )
        row, kind, held, named, timestamp, topic_id = found
        fault = f"the table topics has no topic_id {topic_id}"
        if kind != "integer" or timestamp < 0:
            value = timestamp if kind == "integer" else kind
            fault = f"timestamp: expected nanoseconds from 0 on, found {value}"
        elif held != "blob":
            fault = f"data: expected a blob, found {held}"
        elif named != "integer":
            fault = f"topic_id: expected a whole number, found {named}"
        return DamageError(f"messages: row {row}: {fault}")

    def _count_steps(self) -> bool:
        self._steps_left -= _STEPS
        return self._steps_left < 0


@contextmanager
def open_sqlite(
    path: Path, stored_size: int, *, is_damaged: bool = False
) -> Iterator[SqliteSource]:
    """Open a SQLite bag, as `open_connection` opens its file.

    The size of the file, packed if it was compressed [bytes], sets the limits.
    """
    with open_connection(path, is_damaged=is_damaged) as (connection, size):
        yield SqliteSource(connection, size, stored_size)


def _name_kind(value: object) -> str:
    """Return SQLite's name of a value's type."""
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


def _scatter_heads(
    data: bytearray,
    starts: NDArray[np.int64],
    lengths: NDArray[np.int64],
    numbers: NDArray[np.int64],
    time_ns: NDArray[np.int64],
) -> None:
    """Write the head of a message record before every blob."""
    heads = np.zeros(len(starts), HEADING)
    heads["opcode"] = Opcode.MESSAGE
    heads["length"] = lengths + COUNTED_HEAD
    heads["channel"] = numbers
    heads["log_time"] = heads["publish_time"] = time_ns
    kind = f"V{MESSAGE_HEAD}"
    places = np.ndarray((len(data) - MESSAGE_HEAD + 1,), kind, buffer=data, strides=(1,))
    places[starts] = heads.view(kind)


_BATCH: Final = 4096  # rows
_BATCH_BYTES: Final = 2**22
_MOST_NAMED: Final = 10_000  # invalid rows that are listed with their reasons
_LEAST, _MOST = -(2**63), 2**63 - 1  # smallest and largest row number
_BEFORE: Final = _LEAST - 1
"""Row number before the first row. The smallest number itself may belong to a row."""


def walk_damaged(source: SqliteSource, path: Path) -> Iterator[Section | Loss]:
    """Yield the messages of a bag that was opened as damaged, and the unreadable parts."""
    size, claimed, _ = measure_pages(path)
    yield from _group_rows(source, size)
    if size < claimed:
        reason = f"expected a file of {claimed} bytes, found its end: cut short"
        yield Loss(start=size, end=claimed, reason=reason)


def _group_rows(source: SqliteSource, size: int) -> Iterator[Section | Loss]:
    """Yield readable rows and losses in sections of some thousand rows."""
    rows = SqliteRows()

    def join() -> Section:
        data = source.build_block(rows, 1).data
        return Section(data=data, start=0, is_chunk=True, is_checked=False)

    for found in _judge_rows(source):
        if isinstance(found, str):
            yield Loss(start=0, end=size, reason=found)
            continue
        rows.take([found])
        if len(rows.times) == _BATCH or rows.size > _BATCH_BYTES:
            yield join()
            rows = SqliteRows()
    if rows.times:
        yield join()


def _judge_rows(source: SqliteSource) -> Iterator[Row | str]:
    """Yield the rows that are messages; for other rows and for gaps, yield the reason."""
    faults, left = 0, source.size
    for found in _walk_rows(source):
        if isinstance(found, str):
            yield found
            continue
        number, *values = found
        left -= sum(len(value) for value in values if isinstance(value, str | bytes))
        if left < 0:
            yield "expected messages of the size of the file"
            break
        fault = source.find_fault_of(tuple(values))
        faults += fault is not None
        if fault is None:
            yield tuple(values)
        elif faults <= _MOST_NAMED:
            yield f"messages: row {number}: {fault}"
    if faults > _MOST_NAMED:
        yield f"messages: {faults - _MOST_NAMED} rows more that are no messages"


def _walk_rows(source: SqliteSource) -> Iterator[Row | str]:
    """Yield the rows that SQLite can read, with their numbers; for gaps, yield the reason."""
    last: int | None = _BEFORE
    while last is not None:
        last, error = yield from _walk_sound(source, last)
        if error is None:
            return
        try:
            source.catalogue.allowance.spend(DAMAGES)
        except LogError as err:
            yield str(err)
            return
        # The cursor reads one row ahead: the row that it would return next may be valid.
        row = _read_row(source, last)
        if row:
            yield row
            last = int(row[0])
        elif row is None:
            after = _find_next(source, last)
            since = "the first row" if last == _BEFORE else f"row {last + 1}"
            until = "the last" if after is None else f"row {after - 1}"
            yield f"messages from {since} to {until}: {describe_sqlite_error(error)}"
            last = None if after is None else after - 1
        else:
            yield f"messages behind row {last}: {describe_sqlite_error(error)}"
            return


def _walk_sound(
    source: SqliteSource, last: int
) -> "Generator[Row, None, tuple[int, sqlite3.Error | None]]":
    """Yield rows after `last` up to an error; return the last row's number and the error."""
    import sqlite3

    try:
        for row in source.execute(_build_query(source), last + 1):
            if row[0] <= last:
                return last, sqlite3.DatabaseError("rows out of order")
            last = row[0]
            yield row
    except sqlite3.Error as err:
        return last, err
    return last, None


def _build_query(source: SqliteSource) -> str:
    number = source.row_number
    return (
        f"SELECT {number}, topic_id, timestamp, data FROM messages NOT INDEXED"
        f" WHERE {number} >= ? ORDER BY {number}"
    )


def _read_row(source: SqliteSource, after: int) -> Row | None:
    """Return the first row after another row; () after the last row, None if it cannot be read."""
    import sqlite3

    if after == _MOST:
        return ()
    try:
        found: Row | None = source.execute(f"{_build_query(source)} LIMIT 1", after + 1).fetchone()
    except sqlite3.Error:
        return None
    return () if found is None else found


def _find_next(source: SqliteSource, after: int) -> int | None:
    """Return the number of the first readable row after a gap; None if no such row exists."""
    lost = max(after, 0)
    step, found = 1, None
    while lost + step <= _MOST and (found := _read_row(source, lost + step)) is None:
        step *= 2
    if found is None:
        return None
    least, most = step // 2, step  # the row after `least` is lost, the row after `most` is not
    while most - least > 1:
        middle = (least + most) // 2
        nearer = _read_row(source, lost + middle)
        least, most, found = (middle, most, found) if nearer is None else (least, middle, nearer)
    return int(found[0]) if found else None
