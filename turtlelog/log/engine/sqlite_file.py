"""A SQLite file opened to read, without a byte written beside it: whole, in use, or damaged."""

import os
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final

from turtlelog.errors import LogError
from turtlelog.log.error_boundary import DamageError, open_file

if TYPE_CHECKING:
    import sqlite3

SQLITE_MAGIC: Final = b"SQLite format 3\x00"

_HEADER: Final = 100  # bytes
_PAGE_SIZE: Final = slice(16, 18)
_CHANGES: Final = slice(24, 28)
_PAGES: Final = slice(28, 32)
_COUNTED_AT: Final = slice(92, 96)
"""Where in the header stand the size of a page, how many there are, and at which change."""

_LEAST_LIMIT, _MOST_LIMIT = 2**16, 2**31 - 1  # bytes of a value; our own queries fit

_SIDES: Final = ("-wal", "-journal")
_JOURNAL_MAGIC: Final = bytes.fromhex("d9d505f920a163d7")
"""Ends a journal that names another file, which SQLite would delete."""


@contextmanager
def open_connection(path: Path, *, is_damaged: bool) -> "Iterator[tuple[sqlite3.Connection, int]]":
    """Open a SQLite file to read, with its size [bytes]; nothing is written beside it.

    A `-wal` beside the file holds rows that were committed, a `-journal` what to take back of those
    that were not; SQLite would write beside the file to use them. Then a copy in a temporary folder
    is opened. What the pages claim is held against their size before SQLite reads the first table.

    Args:
        path: The file.
        is_damaged: Read one that is cut as far as it goes.

    Raises:
        LogError: One clause, where it cannot be read, also for what SQLite finds while it is open.
    """
    import sqlite3  # files of MCAP spare both

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
            if size % page:  # SQLite would take zeros for what the last page lacks
                if place == path:
                    folder = Path(closing.enter_context(TemporaryDirectory(prefix="turtlelog-")))
                    place = folder / "bag.db3"
                    shutil.copyfile(path, place)
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
    if is_damaged:  # its header may promise more pages than there are
        connection.execute("PRAGMA writable_schema = ON")
    return connection


def _take_sides_in(place: Path, *, is_damaged: bool) -> None:
    """Have SQLite bring a copy up to date with what is beside it, without reading a table.

    Raises:
        DamageError: Where the file becomes larger than all that it was made of.
    """
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
    """Return a file's size, what its header says of that, and the size of a page [bytes]."""
    with path.open("rb") as stream:
        head = stream.read(_HEADER)
        size = stream.seek(0, os.SEEK_END)
    page = int.from_bytes(head[_PAGE_SIZE], "big")
    page = 2**16 if page == 1 else page or 2**16
    # Before version 3.7 SQLite did not keep the number of pages, and left another number there.
    is_kept = head[_CHANGES] == head[_COUNTED_AT]
    pages = int.from_bytes(head[_PAGES], "big") if is_kept else 0
    return size, pages * page, page


def describe_sqlite_error(err: "sqlite3.Error") -> str:
    """Return what SQLite found as one clause."""
    text = " ".join(str(err).split())
    if text == "interrupted":
        text = "pages that lead in circles, or far more rows than its size allows"
    return f"expected a sound SQLite file, found: {text}"


def _copy_with_sides(path: Path, place: Path, sides: list[Path]) -> None:
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
