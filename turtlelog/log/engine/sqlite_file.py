"""Opening of SQLite files without writing next to them, after counting their pages.

A row claims its length and the pages of the part that does not fit into its own page. In a valid
file each page belongs to one tree. In other files thousands of rows may refer to the same megabyte,
which SQLite would copy for each.

Numbers are read as SQLite reads them (https://www.sqlite.org/fileformat2.html), so that every row
is counted: offsets in a page wrap around, lengths have 32 bits.
"""

import os
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.file_access import DamageError, open_file

if TYPE_CHECKING:
    import sqlite3


_FILE_HEAD: Final = 100  # bytes
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
        LogError: If the file cannot be read, now or while it is open; the message is one clause.
    """
    import shutil  # MCAP files do not need these
    import sqlite3
    from tempfile import TemporaryDirectory

    path = path.resolve()
    with ExitStack() as closing:
        place = path
        sides = [path.with_name(path.name + side) for side in _SIDES]
        try:
            if present := [side for side in sides if side.exists() and side.stat().st_size]:
                folder = Path(closing.enter_context(TemporaryDirectory(prefix="turtlelog-")))
                place = folder / "bag.db3"
                _copy_merged(path, place, present, is_damaged=is_damaged)
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


def _copy_merged(path: Path, place: Path, sides: list[Path], *, is_damaged: bool) -> None:
    """Copy a file and the files next to it, which SQLite merges without reading a table."""
    import shutil

    for source in (path, *sides):
        target = place.with_name(place.name + source.name.removeprefix(path.name))
        with open_file(source) as stream, target.open("w+b") as copy:
            shutil.copyfileobj(stream, copy, 2**20)
            copy.seek(max(copy.tell() - len(_JOURNAL_MAGIC), 0))
            end = copy.read()
        if source.name.endswith("-journal") and end == _JOURNAL_MAGIC:
            raise LogError(
                f"{source.name}: expected the journal of one file, found one that names another"
            )
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
        head = stream.read(_FILE_HEAD)
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


_TABLE_LEAF, _TABLE_INTERIOR, _INDEX_LEAF, _INDEX_INTERIOR = 13, 5, 10, 2
_PARENTS: Final = (_TABLE_INTERIOR, _INDEX_INTERIOR)

_RESERVED: Final = 20
_PAGE_SIZES: Final = frozenset(2**power for power in range(9, 17))
_LEAST_USABLE: Final = 480  # bytes of a page
_PARENT_HEAD: Final = 12
_LEAF_HEAD: Final = 8
_COUNT: Final = 3
_RIGHT: Final = 8
"""Position in a page's header of the number of its cells and the last page below it."""

_LEAST_CELL: Final = 6  # bytes, including its pointer
_LONGEST_VARINT: Final = 9
_DEEPEST: Final = 20  # levels; SQLite reads no deeper tree
_READ_BYTES: Final = 2**20

_MOST_DEFINED: Final = 2**16
"""Largest size of table definitions [bytes]. A bag has 2,000; SQLite stores 100 times as many."""

_MOST_TABLES: Final = 2**10
_DAMAGED_SHARE: Final = 64
"""Total size of rows in a recovery, as a multiple of the file's; a row may claim any length."""

_INTEGERS: Final = {0: 0, 1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 8: 0, 9: 0}
"""Size of a whole number in a row, by its kind [bytes]; NULL, 0 and 1 take no space."""

_ONE: Final = 9
_REAL: Final = 8  # bytes


def check_pages(path: Path, page_size: int, *, is_damaged: bool) -> None:
    """Check that the rows of a SQLite file claim no more bytes than the file has.

    Of a damaged file, invalid pages and rows are skipped, but not invalid definitions of tables.
    """
    with path.open("rb") as stream:
        usable = page_size - stream.read(_FILE_HEAD)[_RESERVED]
        if page_size not in _PAGE_SIZES or usable < _LEAST_USABLE:
            found = f"{usable} of {page_size}"
            raise DamageError(f"expected pages of 512 to 65536 bytes, found {found} to use")
        pages = _Pages(stream, page_size, usable)
        roots = pages.list_roots()
        pages.most_bytes *= _DAMAGED_SHARE if is_damaged else 1
        pages.is_damaged = is_damaged
        for root in roots:
            pages.count_tree(root)


@dataclass(frozen=True, slots=True)
class _Batch:
    """Several pages of a tree: their bytes one after another, and the offset of each header."""

    data: NDArray[np.uint8]
    heads: NDArray[np.int64]
    page_size: int

    def find_cells(self, kinds: tuple[int, ...], head: int) -> NDArray[np.int64]:
        """Return the offsets of the cells of pages of some kinds."""
        heads = self.heads[np.isin(self.data[self.heads], kinds)]
        counts = _read_number(self.data, heads + _COUNT, 2)
        counts[counts > (self.page_size - _LEAF_HEAD) // _LEAST_CELL] = 0  # SQLite refuses these
        first = np.repeat(heads + head - 2 * (np.cumsum(counts) - counts), counts)
        places = _read_number(self.data, first + 2 * np.arange(len(first)), 2)
        starts = np.repeat(heads - heads % self.page_size, counts)
        return starts + places % self.page_size

    def list_children(self) -> NDArray[np.int64]:
        """Return the numbers of the child pages."""
        heads = self.heads[np.isin(self.data[self.heads], _PARENTS)]
        cells = self.find_cells(_PARENTS, _PARENT_HEAD)
        return _read_number(self.data, np.concatenate([cells, heads + _RIGHT]), 4)

    def find_rows(self) -> NDArray[np.int64]:
        """Return the offsets of rows and their lengths."""
        leaves = self.find_cells((_TABLE_LEAF, _INDEX_LEAF), _LEAF_HEAD)
        return np.concatenate([leaves, self.find_cells((_INDEX_INTERIOR,), _PARENT_HEAD) + 4])

    def read_varints(self, places: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return numbers of up to nine bytes, of which 32 bits are used."""
        values = self.data[places].astype(np.int64)
        more = np.flatnonzero(values > 0x7F)
        values &= 0x7F
        for byte in range(1, _LONGEST_VARINT):
            if not len(more):
                break
            found = self.data[places[more] + byte].astype(np.int64)
            values[more] = (values[more] << 7 | found & 0x7F) & 0xFFFFFFFF
            more = more[found > 0x7F]
        return values


class _Pages:
    """The pages of a file.

    Attributes:
        most_bytes: Largest total size of all rows [bytes].
        is_damaged: Whether pages that occur twice are skipped.
    """

    def __init__(self, stream: BinaryIO, page_size: int, usable: int) -> None:
        self._stream, self._size, self._usable = stream, page_size, usable
        self.file_size = stream.seek(0, 2)
        self._count = self.file_size // page_size
        self._seen = np.zeros(self._count + 1, np.bool_)
        self._bytes = 0
        self.most_bytes = self.file_size
        self.is_damaged = False

    def list_roots(self) -> list[int]:
        """Return the first page of every tree in the table of tables."""
        roots, defined, tables = [], 0, 0
        for batch in self._walk(1):
            rows = batch.find_rows()
            lengths = batch.read_varints(rows)
            defined, tables = defined + int(lengths.sum()), tables + len(rows)
            if defined > _MOST_DEFINED or tables > _MOST_TABLES:
                raise DamageError(
                    f"expected up to {_MOST_DEFINED} bytes that define up to {_MOST_TABLES} tables,"
                    " found more: this is no bag"
                )
            for place, length in zip(rows.tolist(), lengths.tolist(), strict=True):
                cell = batch.data[place : place + self._size].tobytes()
                roots.append(_find_root(self._read_payload(cell, length)))
        return [root for root in roots if root]

    def _read_payload(self, cell: bytes, length: int) -> bytes:
        _, at = _read_varint(cell, 0)
        _, at = _read_varint(cell, at)
        local = length
        if length > self._usable - 35:  # the rest is in other pages
            least = (self._usable - 12) * 32 // 255 - 23
            local = least + (length - least) % (self._usable - 4)
            local = local if local <= self._usable - 35 else least
        data, following = cell[at : at + local], cell[at + local : at + local + 4]
        while len(data) < length and (number := int.from_bytes(following, "big")):
            self._stream.seek((number - 1) * self._size)
            page = self._stream.read(self._size)[: self._usable]
            if len(page) <= len(following):
                break
            data, following = data + page[4:], page[:4]
        return data[:length]

    def count_tree(self, root: int) -> None:
        """Add the number of bytes that the rows of a tree claim."""
        for batch in self._walk(root):
            lengths = batch.read_varints(batch.find_rows())
            if self.is_damaged:
                lengths = np.minimum(lengths, self.file_size)
            self._bytes += int(lengths.sum())
            if self._bytes > self.most_bytes:
                fix = "" if self.is_damaged else "; turtlelog convert --recover reads what is left"
                raise DamageError(
                    f"expected rows of up to {self.file_size} bytes in all, the size of the file,"
                    f" found more: rows share their pages, or claim a wrong length{fix}"
                )

    def _walk(self, root: int) -> Iterator[_Batch]:
        level = np.array([root], np.int64)
        for _ in range(_DEEPEST):
            below = [np.empty(0, np.int64)]
            for batch in self._read(self._visit(level)):
                yield batch
                below.append(batch.list_children())
            level = np.concatenate(below)

    def _visit(self, numbers: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return pages in order. SQLite itself reports missing pages."""
        numbers = np.sort(numbers[(numbers > 0) & (numbers <= self._count)])
        is_again = self._seen[numbers]
        is_again[1:] |= numbers[1:] == numbers[:-1]
        if is_again.any() and not self.is_damaged:
            number = numbers[is_again][0]
            raise DamageError(
                f"page {number}: expected each page in one table once, found it twice: pages lead"
                " in circles, or are shared; turtlelog convert --recover reads what is left"
            )
        self._seen[numbers] = True
        return numbers[~is_again]

    def _read(self, numbers: NDArray[np.int64]) -> Iterator[_Batch]:
        for some in np.split(numbers, np.arange(0, len(numbers), _READ_BYTES // self._size)[1:]):
            if not len(some):
                continue
            data = bytearray()
            for run in np.split(some, np.flatnonzero(np.diff(some) != 1) + 1):
                self._stream.seek((int(run[0]) - 1) * self._size)
                data += self._stream.read(len(run) * self._size)
            heads = np.arange(len(some)) * self._size
            heads[some == 1] += _FILE_HEAD
            data += bytes(_FILE_HEAD + _PARENT_HEAD)  # pointers to cells may lie beyond the end
            yield _Batch(np.frombuffer(data, np.uint8), heads, self._size)


def _read_number(
    data: NDArray[np.uint8], places: NDArray[np.int64], size: int
) -> NDArray[np.int64]:
    found = np.zeros(len(places), np.int64)
    for byte in range(size):
        found = found << 8 | data[places + byte]
    return found


def _find_root(row: bytes) -> int:
    """Return the root page in a row of the table of tables; 0 for a view or a trigger."""
    place, at = _read_varint(row, 0)
    kinds = list[int]()
    for _ in range(4):
        kind, at = _read_varint(row, at)
        kinds.append(kind)
    place += sum(map(_measure_value, kinds[:3]))
    count = _measure_value(kinds[3])
    if kinds[3] not in _INTEGERS or place + count > len(row):
        raise DamageError("expected a sound SQLite file, found a damaged table of tables")
    return int.from_bytes(row[place : place + count], "big", signed=True) + (kinds[3] == _ONE)


def _measure_value(kind: int) -> int:
    return (kind - 12) // 2 if kind >= 12 else _INTEGERS.get(kind, _REAL)


def _read_varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for byte in data[at : at + _LONGEST_VARINT]:
        value, at = value << 7 | byte & 0x7F, at + 1
        if byte < 0x80:
            break
    return value & 0xFFFFFFFF, at
