"""Reading of a damaged SQLite bag row by row: the readable rows, and the gaps between them.

A table is a tree of pages in order of row numbers. If a page is lost, its rows are lost too. The
rows after it are found by searching the smallest row number that SQLite can read again.
"""

import sqlite3
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Final

from turtlelog.errors import LogError
from turtlelog.log.engine.limits import DAMAGES
from turtlelog.log.engine.sqlite_file import describe_sqlite_error, measure_pages
from turtlelog.log.engine.sqlite_source import Row, SqliteRows, SqliteSource
from turtlelog.log.engine.walk import Loss, Section

_BATCH: Final = 4096  # rows
_BATCH_BYTES: Final = 2**22
_MOST_NAMED: Final = 10_000  # invalid rows that are listed with their reasons
_LEAST, _MOST = -(2**63), 2**63 - 1  # smallest and largest row number
_BEFORE: Final = _LEAST - 1
"""Row number before the first row. The smallest number itself may belong to a row."""


def walk_damaged(source: SqliteSource, path: Path) -> Iterator[Section | Loss]:
    """Yield the messages of a bag as sections of records, and the unreadable parts.

    Args:
        source: Bag that was opened as damaged.
        path: Path of the file, to find the file's size.
    """
    size, claimed, _ = measure_pages(path)
    yield from _group_rows(source, size)
    if size < claimed:
        reason = f"expected a file of {claimed} bytes, found its end: cut short"
        yield Loss(start=size, end=claimed, reason=reason)


def _group_rows(source: SqliteSource, size: int) -> Iterator[Section | Loss]:
    """Yield readable rows and losses in sections of some thousand rows."""
    rows, held = SqliteRows(), 0
    for found in _judge_rows(source):
        if isinstance(found, str):
            yield Loss(start=0, end=size, reason=found)
            continue
        rows.take([found])
        held += 1
        if held == _BATCH or rows.size > _BATCH_BYTES:
            yield _make_section(source, rows)
            rows, held = SqliteRows(), 0
    if held:
        yield _make_section(source, rows)


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


def _make_section(source: SqliteSource, rows: SqliteRows) -> Section:
    data = source.build_block(rows, 1).data
    return Section(data=data, start=0, is_chunk=True, is_checked=False)


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
) -> Generator[Row, None, tuple[int, sqlite3.Error | None]]:
    """Yield rows after `last` up to an error; return the last row's number and the error."""
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
