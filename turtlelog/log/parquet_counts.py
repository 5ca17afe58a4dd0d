"""Checks of a Parquet file's footer and page headers before Arrow allocates memory.

Footer and page headers are structs in Thrift's compact protocol. A footer of 900 kB can name
300,000 columns, which take 210 MB in Arrow. A page of 100 bytes can unpack to gigabytes, whatever
the footer claims.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, BinaryIO, Final

from turtlelog.log.file_access import DamageError

_MAGIC: Final = b"PAR1"
_ENDING: Final = 8
"""Size of the length and the magic bytes after the footer [bytes]."""

_DEEPEST: Final = 16
"""Largest nesting depth of Thrift structs and lists; Parquet's is 8."""

_PAGE_HEAD: Final = 2**12
"""Bytes read for the header of a page; one with statistics of short texts takes 100."""
_LONGEST_PAGE_HEAD: Final = 2**20

_Wanted = Mapping[int, Any]
"""Wanted fields of a struct by number.

The value is None for a whole number, a mapping for a struct, and a list of one mapping for a list
of structs."""

_FOOTER: Final[_Wanted] = {
    2: [{5: None}],  # the schema: children
    3: None,  # rows
    4: [{1: [{3: dict.fromkeys((5, 7, 9, 11))}], 3: None}],  # groups: chunks of columns, rows
}
_PAGE: Final[_Wanted] = {
    **dict.fromkeys((2, 3)),  # bytes: unpacked, packed
    5: dict.fromkeys((1, 2)),  # values, encoding
    7: dict.fromkeys((1, 2)),
    8: dict.fromkeys((1, 4)),
}

_KINDS: Final[Mapping[type, type]] = {type(None): int, dict: dict, list: list}
"""Python type of a field, by the type of its entry in `_Wanted`."""

_BOOLEANS, _BYTE, _DOUBLE, _BINARY, _LISTS, _MAP, _STRUCT = (1, 2), 3, 7, 8, (9, 10), 11, 12
_WHOLES: Final = (4, 5, 6)


@dataclass(frozen=True, slots=True, kw_only=True)
class ChunkClaim:
    """The footer's entry for one column in one row group.

    Attributes:
        values: Number of values.
        start: Offset of the column's first page in the file [bytes].
        size: Size of the column's pages with their headers [bytes].
    """

    values: int
    start: int
    size: int


@dataclass(frozen=True, slots=True, kw_only=True)
class _FooterClaims:
    """Contents of the footer.

    Attributes:
        row_count: Number of rows of all groups.
        depth: Nesting depth of columns in structs and lists, 1 for a flat table.
        group_rows: Number of rows of each group.
        chunks: Entries by group, then by column.
    """

    row_count: int
    depth: int
    group_rows: tuple[int, ...]
    chunks: tuple[tuple[ChunkClaim, ...], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class PageClaim:
    """Contents of a page header.

    Attributes:
        unpacked: Size of the page after decompression [bytes].
        values: Number of values.
        encoding: Parquet's number of the encoding.
    """

    unpacked: int
    values: int
    encoding: int


def read_footer_claims(
    stream: BinaryIO, *, most_bytes: int, most_parts: int, advice: str = ""
) -> _FooterClaims:
    """Return the contents of a Parquet file's footer.

    Raises:
        DamageError: If the footer is invalid, or exceeds its most bytes, or columns, groups and
            other structs. `advice` ends the line about a footer of too many bytes.
    """
    size = stream.seek(0, 2)
    stream.seek(max(size - _ENDING, 0))
    ending = stream.read(_ENDING)
    if size < len(_MAGIC) + _ENDING or ending[4:] != _MAGIC:
        raise DamageError("expected a complete Parquet file, found no footer at its end")
    length = int.from_bytes(ending[:4], "little")
    if length > size - _ENDING:
        raise DamageError(f"expected a complete Parquet file, found {size:,} bytes of it")
    if length > most_bytes:
        raise DamageError(
            f"expected a footer of up to {most_bytes:,} bytes, found {length:,}{advice}"
        )
    stream.seek(size - _ENDING - length)
    footer = _Thrift(stream.read(length), most_parts).read_struct(_FOOTER)
    groups = footer.get(4, [])
    return _FooterClaims(
        row_count=sum(group.get(3, 0) for group in groups),
        depth=_measure_depth([element.get(5, 0) for element in footer.get(2, [])]),
        group_rows=tuple(group.get(3, 0) for group in groups),
        chunks=tuple(tuple(map(_read_chunk, group.get(1, []))) for group in groups),
    )


def _read_chunk(chunk: Mapping[int, Any]) -> ChunkClaim:
    found = chunk.get(3, {})
    first, dictionary = found.get(9, 0), found.get(11, 0)
    start = dictionary if 0 < dictionary < first else first
    return ChunkClaim(values=found.get(5, 0), start=start, size=found.get(7, 0))


def _measure_depth(children: list[int]) -> int:
    """Return the depth of a tree, given the number of children of each node, parents first."""
    open_nodes: list[int] = []
    deepest = 0
    for count in children[1:]:
        deepest = max(deepest, len(open_nodes) + 1)
        if count > 0:
            open_nodes.append(count)
            continue
        while open_nodes:
            open_nodes[-1] -= 1
            if open_nodes[-1]:
                break
            open_nodes.pop()
    return deepest


def iterate_pages(stream: BinaryIO, chunk: ChunkClaim) -> Iterator[PageClaim]:
    """Yield the headers of a column's pages in a row group; no page is unpacked."""
    place, end = chunk.start, chunk.start + chunk.size
    if chunk.start < len(_MAGIC) or chunk.size < 0 or end > stream.seek(0, 2):
        raise DamageError("expected a complete Parquet file, found a column outside the file")
    while place < end:
        page, head = _read_page_header(stream, place, end)
        packed, unpacked = page.get(3, -1), page.get(2, -1)
        if packed < 0 or unpacked < 0:
            raise DamageError(f"byte {place}: expected a page of a column, found no size")
        data: Mapping[int, Any] = page.get(5) or page.get(7) or page.get(8) or {}
        encoding = data.get(4 if 8 in page else 2, 0)
        yield PageClaim(unpacked=unpacked, values=data.get(1, 0), encoding=encoding)
        place += head + packed


def _read_page_header(stream: BinaryIO, place: int, end: int) -> tuple[dict[int, Any], int]:
    length = _PAGE_HEAD
    while True:
        stream.seek(place)
        data = stream.read(min(length, end - place))
        thrift = _Thrift(data, 16)
        try:
            return thrift.read_struct(_PAGE), thrift.place
        except DamageError:
            length *= 16
            if len(data) == end - place or length > _LONGEST_PAGE_HEAD:
                raise


class _Thrift:
    """Values in the compact protocol, read one after another; the next is at `place`."""

    def __init__(self, data: bytes, most_parts: int) -> None:
        self._data, self._parts, self._most = data, 0, most_parts
        self.place = 0

    def read_struct(self, wanted: _Wanted, depth: int = 0) -> dict[int, Any]:
        """Return the wanted fields that exist."""
        self._count_part(depth)
        found: dict[int, Any] = {}
        number = 0
        while (head := self._take()) != 0:
            kind, step = head & 15, head >> 4
            number = number + step if step else self._take_whole()
            is_wanted = number in wanted
            value = self._read(kind, wanted[number] if is_wanted else None, depth, is_field=True)
            if is_wanted:
                if type(value) is not _KINDS[type(wanted[number])]:
                    raise DamageError(f"expected a complete Parquet file, found {kind} as a kind")
                found[number] = value
        return found

    def _count_part(self, depth: int) -> None:
        self._parts += 1
        if self._parts > self._most:
            raise DamageError(
                f"expected a footer of up to {self._most:,} columns, groups and other parts,"
                " found more"
            )
        self._require_shallow(depth)

    @staticmethod
    def _require_shallow(depth: int) -> None:
        if depth > _DEEPEST:
            raise DamageError("expected a complete Parquet file, found structs that nest too far")

    def _read(self, kind: int, wanted: Any, depth: int, *, is_field: bool = False) -> Any:
        if kind in _WHOLES:
            return self._take_whole()
        if kind == _STRUCT:
            return self.read_struct(wanted if isinstance(wanted, dict) else {}, depth + 1)
        if kind in _LISTS:
            return self._read_list(wanted[0] if isinstance(wanted, list) else None, depth + 1)
        if kind == _MAP:
            return self._skip_map(depth + 1)
        if kind in _BOOLEANS and is_field:
            return kind == 1
        self._skip_bytes(kind)
        return None

    def _read_list(self, wanted: Any, depth: int) -> list[Any]:
        self._require_shallow(depth)
        head = self._take()
        count, kind = head >> 4, head & 15
        count = self._take_varint() if count == 15 else count
        if count > len(self._data) - self.place:
            raise DamageError(
                "expected a complete Parquet file, found a list longer than its bytes"
            )
        if kind == _STRUCT and wanted is not None:
            return [self.read_struct(wanted, depth + 1) for _ in range(count)]
        for _ in range(count):
            self._read(kind, None, depth)
        return []

    def _skip_map(self, depth: int) -> None:
        count = self._take_varint()
        kinds = self._take() if count else 0
        for _ in range(min(count, len(self._data))):
            self._read(kinds >> 4, None, depth)
            self._read(kinds & 15, None, depth)

    def _skip_bytes(self, kind: int) -> None:
        lengths = {_BYTE: 1, 1: 1, 2: 1, _DOUBLE: 8}
        length = self._take_varint() if kind == _BINARY else lengths.get(kind)
        if length is None:
            raise DamageError("expected a complete Parquet file, found a value of no known kind")
        self.place += length

    def _take(self) -> int:
        if self.place >= len(self._data):
            raise DamageError("expected a complete Parquet file, found the end in its midst")
        self.place += 1
        return self._data[self.place - 1]

    def _take_varint(self) -> int:
        value, shift = 0, 0
        while (byte := self._take()) & 0x80:
            value |= (byte & 0x7F) << shift
            shift += 7
            if shift > 63:
                raise DamageError("expected a complete Parquet file, found a number beyond 64 bits")
        return value | byte << shift

    def _take_whole(self) -> int:
        value = self._take_varint()
        return (value >> 1) ^ -(value & 1)
