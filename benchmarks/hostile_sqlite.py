"""SQLite files made page by page, as no writer makes them: rows that share pages, trees in circles.

The format is that of https://www.sqlite.org/fileformat2.html; a cell is what its caller says.
"""

import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

TOPICS: Final = (
    "CREATE TABLE topics(id INTEGER PRIMARY KEY,name TEXT NOT NULL,type TEXT NOT NULL,"
    "serialization_format TEXT NOT NULL,offered_qos_profiles TEXT NOT NULL)"
)
MESSAGES: Final = (
    "CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL,"
    "timestamp INTEGER NOT NULL, data BLOB NOT NULL)"
)
DEFINITIONS: Final = (
    "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY,topic_type TEXT NOT NULL,"
    "encoding TEXT NOT NULL,encoded_message_definition TEXT NOT NULL,"
    "type_description_hash TEXT NOT NULL)"
)
POSE: Final = b"\0\1\0\0" + bytes(20)

Value = int | str | bytes | None
Choose = Callable[[int], Sequence[Value]]
"""The values of the row of a number, from 1 on."""

_LEAF, _INTERIOR = 13, 5
_HEADER: Final = 100


@dataclass(frozen=True, slots=True)
class Cell:
    """What stands in a page of a tree: a row, or a page below and the last row's number there."""

    key: int
    data: bytes


class Database:
    """A SQLite file in the making; its first page leads to the table of tables."""

    def __init__(self, page_size: int = 4096) -> None:
        self.page_size = page_size
        self.pages: list[bytes] = [b""]
        self._tables: list[Sequence[Value]] = []

    def add_page(self, data: bytes) -> int:
        """Return the number of a new page."""
        self.pages.append(data.ljust(self.page_size, b"\0"))
        return len(self.pages)

    def add_chain(self, data: bytes) -> int:
        """Return the first of the overflow pages that hold some bytes."""
        room, first = self.page_size - 4, len(self.pages) + 1
        parts = [data[at : at + room] for at in range(0, len(data), room)]
        for number, part in enumerate(parts, start=1):
            following = first + number if number < len(parts) else 0
            self.add_page(struct.pack(">I", following) + part)
        return first

    def make_cell(self, key: int, values: Sequence[Value], chain: int | None = None) -> Cell:
        """Return a row; what its page has no room for is in a chain of its own, or in that one."""
        kinds, bodies = zip(*map(_pack_value, values), strict=True)
        head = _pack_head(kinds)
        size = len(head) + sum(map(len, bodies))
        local = self._count_local(size)
        data = pack_varint(size) + pack_varint(key)
        if local == size or chain is None:
            payload = head + b"".join(bodies)
            chain = self.add_chain(payload[local:]) if local < size else 0
        else:  # thousands of rows of megabytes: only what stands in the page is put together
            payload = head + b"".join(body[:local] for body in bodies)
        data += payload[:local]
        return Cell(key, data + struct.pack(">I", chain) if local < size else data)

    def share_chain(self, choose: Choose, count: int) -> list[Cell]:
        """Return rows that differ in their first bytes; the first one's chain is that of all."""
        first = self.make_cell(1, choose(1))
        chain = int.from_bytes(first.data[-4:], "big")
        return [first, *(self.make_cell(key, choose(key), chain) for key in range(2, count + 1))]

    def make_rows(self, choose: Choose, count: int) -> list[Cell]:
        """Return honest rows."""
        return [self.make_cell(key, choose(key)) for key in range(1, count + 1)]

    def add_table(self, name: str, sql: str, cells: Iterable[Cell]) -> int:
        """Return the root page of a table of rows in their order."""
        return self.name_table(name, sql, self.add_tree(cells))

    def name_table(self, name: str, sql: str, root: int, kind: str = "table") -> int:
        """Name a page as the root of a table; return the page."""
        self._tables.append((kind, name, name, root, sql))
        return root

    def add_tree(self, cells: Iterable[Cell]) -> int:
        """Return the root of a tree of rows."""
        level = list(self._pack(_LEAF, cells))
        while len(level) > 1:
            children = [self.make_child(self.add_page(page), key) for page, key in level]
            level = list(self._pack(_INTERIOR, children))
        return self.add_page(level[0][0])

    def finish(self) -> bytes:
        """Return the file."""
        cells = self.make_rows(lambda key: self._tables[key - 1], len(self._tables))
        first = make_page(_INTERIOR, [self.make_child(self.add_tree(cells), 0)], self.page_size)
        size = self.page_size if self.page_size < 2**16 else 1
        head = b"SQLite format 3\0" + struct.pack(">HBBBBBB", size, 1, 1, 0, 64, 32, 32)
        head += struct.pack(">12I", 1, len(self.pages), 0, 0, 1, 4, 0, 0, 1, 0, 0, 0)
        head = head.ljust(92, b"\0") + struct.pack(">II", 1, 3_040_001)
        self.pages[0] = (head + first)[: self.page_size]
        return b"".join(self.pages)

    @staticmethod
    def make_child(page: int, key: int) -> Cell:
        """Return what an interior page says of a page below."""
        return Cell(key, struct.pack(">I", page) + pack_varint(key))

    def _pack(self, kind: int, cells: Iterable[Cell]) -> Iterator[tuple[bytes, int]]:
        held: list[Cell] = []
        left = room = self.page_size - 12
        for cell in cells:
            left -= len(cell.data) + 2
            if left < 0 and held:
                yield make_page(kind, held, self.page_size), held[-1].key
                held, left = [], room - len(cell.data) - 2
            held.append(cell)
        yield make_page(kind, held, self.page_size), held[-1].key if held else 0

    def _count_local(self, size: int) -> int:
        if size <= self.page_size - 35:
            return size
        least = (self.page_size - 12) * 32 // 255 - 23
        more = least + (size - least) % (self.page_size - 4)
        return more if more <= self.page_size - 35 else least


def make_page(kind: int, cells: Sequence[Cell], page_size: int) -> bytes:
    """Return a page of a tree; the last child of an interior one stands in its head."""
    right, inside = b"", cells
    if kind == _INTERIOR:
        right, inside = cells[-1].data[:4], cells[:-1]
    place, places = page_size, []
    for cell in inside:
        place -= len(cell.data)
        places.append(place)
    head = struct.pack(">BHHHB", kind, 0, len(places), place % 2**16, 0) + right
    head += struct.pack(f">{len(places)}H", *places)
    return head.ljust(place, b"\0") + b"".join(cell.data for cell in reversed(inside))


def repeat_cell(cell: Cell, count: int, page_size: int) -> bytes:
    """Return a leaf with one row that many places lead to."""
    place = page_size - len(cell.data)
    head = struct.pack(">BHHHB", _LEAF, 0, count, place, 0) + struct.pack(">H", place) * count
    return head.ljust(place, b"\0") + cell.data


def _pack_head(kinds: Sequence[int]) -> bytes:
    data = b"".join(map(pack_varint, kinds))
    size = len(data) + 1
    size += size > 127
    return pack_varint(size) + data


@lru_cache(maxsize=16)
def _encode(value: str) -> bytes:
    return value.encode()


def _pack_value(value: Value) -> tuple[int, bytes]:
    match value:
        case None:
            return 0, b""
        case int():
            return 6, value.to_bytes(8, "big", signed=True)
        case str():
            data = _encode(value)
            return 13 + 2 * len(data), data
        case bytes():
            return 12 + 2 * len(value), value


def pack_varint(value: int) -> bytes:
    """Return a whole number as SQLite writes it."""
    value %= 2**64
    if value >= 2**56:
        tail, value, groups = bytes([value & 0xFF]), value >> 8, 8
        return bytes((value >> 7 * at & 0x7F) | 0x80 for at in reversed(range(groups))) + tail
    parts = [value & 0x7F]
    while value := value >> 7:
        parts.append(value & 0x7F | 0x80)
    return bytes(reversed(parts))


def make_wal(content: bytes, page_size: int) -> bytes:
    """Return a file of SQLite as the log beside another, which it replaces."""
    head = struct.pack(">6I", 0x377F0683, 3_007_000, page_size, 0, 1, 1)
    sums = _sum_words(head, (0, 0))
    log = [head, struct.pack(">2I", *sums)]
    pages = [content[at : at + page_size] for at in range(0, len(content), page_size)]
    pages[0] = pages[0][:18] + b"\2\2" + pages[0][20:]
    for number, page in enumerate(pages, start=1):
        frame = struct.pack(">2I", number, len(pages) if number == len(pages) else 0)
        sums = _sum_words(page, _sum_words(frame, sums))
        log += [frame, struct.pack(">4I", 1, 1, *sums), page]
    return b"".join(log)


def _sum_words(data: bytes, sums: tuple[int, int]) -> tuple[int, int]:
    first, second = sums
    words = struct.unpack(f">{len(data) // 4}I", data)
    for even, odd in zip(words[::2], words[1::2], strict=True):
        first = (first + even + second) & 0xFFFFFFFF
        second = (second + odd + first) & 0xFFFFFFFF
    return first, second
