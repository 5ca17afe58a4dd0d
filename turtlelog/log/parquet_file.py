"""Reading of Parquet files as Arrow tables, checked before reading, without threads.

In a thread of its own, pyarrow may go on after the answer, and then ends the process with SIGABRT
when Python exits.

The footer and the headers of pages, structs in Thrift's compact protocol, are counted before Arrow
allocates memory. A footer of 900 kB can name 300,000 columns, which take 210 MB in Arrow. A page of
100 bytes can unpack to gigabytes, whatever the footer claims.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple

from turtlelog.errors import LogError
from turtlelog.files.urls import RemotePath, make_path
from turtlelog.libraries import load_library
from turtlelog.log.engine import limits
from turtlelog.log.file_access import DamageError, open_file

_DOWNLOAD: Final = "; download the file, then name the copy"


_SHARES_PREFIXES: Final = 7
"""Encoding DELTA_BYTE_ARRAY: a text of 1 MB that repeats the previous one takes 2 bytes."""
_PLACES: Final = frozenset({2, 8})
"""Encodings with indices of a dictionary, which may repeat one long text."""
_NO_DICTIONARY: Final = frozenset({6, _SHARES_PREFIXES})
"""Encodings that Arrow does not read into a dictionary."""


class _Chunk(NamedTuple):
    """The footer's entry for one column in one row group: values, first page and size [bytes]."""

    values: int
    start: int
    size: int  # of the pages with their headers


class _Page(NamedTuple):
    """A page header: size after decompression [bytes], values, Parquet's number of the encoding."""

    unpacked: int
    values: int
    encoding: int


class ParquetFile:
    """A Parquet file. The file is open only during reads and may be replaced between reads.

    Attributes:
        metadata: Arrow's metadata of the footer.
        schema: Arrow's schema.
        group_rows: Number of rows in each group.
        row_count: Number of rows.
        leaves: Arrow's descriptions of the columns of values; paths within structs have dots.
    """

    def __init__(self, path: str | Path) -> None:
        """Read the footer.

        Raises:
            LogError: If the file is not Parquet, or exceeds limits; without the file's name.
            LibraryError: If pyarrow is not installed.
        """
        self._path = make_path(path)
        parquet = load_library("pyarrow.parquet")
        with open_file(self._path) as stream:
            self._size = stream.seek(0, 2)
            is_remote = isinstance(self._path, RemotePath)
            # The size that a server claims does not raise any limit.
            self._believed = min(self._size, limits.SMALL_FILE - 1) if is_remote else self._size
            self._advice = _DOWNLOAD if is_remote else ""
            most = (
                limits.grow_bound(limits.PARQUET_FOOTER_BYTES, self._size),
                limits.grow_bound(limits.PARQUET_FOOTER_PARTS, self._size),
            )
            if is_remote:
                most = (
                    min(most[0], limits.PARQUET_REMOTE_FOOTER_BYTES),
                    min(most[1], limits.PARQUET_REMOTE_FOOTER_PARTS),
                )
            footer = _read_footer(stream, *most, self._advice)
            depth = _measure_depth([element.get(5, 0) for element in footer.get(2, [])])
            if depth > limits.PARQUET_DEPTH:
                raise LogError(
                    f"columns lie {depth} deep in each other; turtlelog reads up to"
                    f" {limits.PARQUET_DEPTH}. Write a table of flat columns"
                )
            stream.seek(0)
            try:
                self.metadata = parquet.read_metadata(stream)
            except (OSError, ValueError) as err:  # Arrow raises its own subclasses of these
                advice = "copy the file again from its source"
                raise _damage(f"a footer that is damaged; {advice}") from err
        self.schema = self.metadata.schema.to_arrow_schema()
        groups = footer.get(4, [])
        self._chunks = [[*map(_read_chunk, group.get(1, []))] for group in groups]
        self.group_rows: Sequence[int] = [group.get(3, 0) for group in groups]
        self.row_count = sum(self.group_rows)
        columns = self.metadata.schema
        self.leaves = [columns.column(number) for number in range(len(columns))]
        if min(self.group_rows, default=0) < 0:
            raise _damage("less than no rows")

    def read(self, names: Sequence[str] | None = None, group: int | None = None) -> Any:
        """Return columns of all row groups, or one, as an Arrow table of dictionary-encoded texts.

        Names have dots for columns within structs. Default: all columns.

        Raises:
            LogError: If the columns need too much memory; without the file's name.
        """
        starts = None if names is None else tuple(f"{name}." for name in names)
        places = [
            place
            for place, leaf in enumerate(self.leaves)
            if starts is None or f"{leaf.path}.".startswith(starts)
        ]
        groups = range(len(self.group_rows)) if group is None else [group]
        parquet = load_library("pyarrow.parquet")
        with open_file(self._path) as stream:
            texts = self._require_bounded(stream, places, groups)
            stream.seek(0)
            file = parquet.ParquetFile(
                stream, metadata=self.metadata, read_dictionary=texts, pre_buffer=False
            )
            asked = None if names is None else [*names]
            return file.read_row_groups([*groups], asked, use_threads=False)

    def require_rows(self) -> None:
        """Refuse a table with more rows than a run may have.

        A long table behind a URL is fetched completely before its number of rows is trusted.

        Raises:
            LogError: If there are too many rows; without the file's name.
        """
        most = limits.count_most_rows(self._size)
        if self.row_count > most:
            told = limits.describe_rows(f"{self.row_count:,}", most, self._size)
            raise LogError(f"{told}, or write it without compression")
        if self.row_count > limits.MOST_ROWS and isinstance(self._path, RemotePath):
            self._believed = self._path.file.fetch_whole()

    def require_cells(self, columns: int, rows: int | None = None) -> None:
        """Refuse to read more cells than the memory limit allows. Default: all rows."""
        rows = self.row_count if rows is None else rows
        most = limits.PARQUET_CELLS_A_ROW * max(
            limits.MOST_ROWS, self._believed // limits.ROW_BYTES
        )
        if rows * columns > most:
            raise LogError(
                f"the table has {columns:,} columns of {rows:,} rows; {most:,} cells are the most"
                f" for a file of {self._size:,} bytes. Write fewer columns{self._advice}"
            )

    def _require_bounded(
        self, stream: BinaryIO, places: Sequence[int], groups: Sequence[int]
    ) -> list[str]:
        """Return the text columns that are read as dictionaries."""
        self.require_cells(len(places), sum(self.group_rows[group] for group in groups))
        counts, texts = _PageCounts(stream, self._believed, self._advice), []
        for place in places:
            chunks = [self._find_chunk(group, place) for group in groups]
            if counts.count(chunks, self.leaves[place]):
                texts.append(self.leaves[place].path)
        return texts

    def _find_chunk(self, group: int, place: int) -> _Chunk:
        chunks, leaf = self._chunks[group], self.leaves[place]
        if leaf.max_repetition_level:
            raise LogError(f"column {leaf.path}: expected numbers or texts, found lists")
        if place >= len(chunks) or chunks[place].values != self.group_rows[group]:
            raise DamageError(f"column {leaf.path}: expected a value for each row, found others")
        return chunks[place]


_MAGIC: Final = b"PAR1"
_ENDING: Final = 8
"""Size of the length and the magic bytes after the footer [bytes]."""

_DEEPEST_STRUCT: Final = 16
"""Largest nesting depth of Thrift structs and lists; Parquet's is 8."""

_PAGE_HEAD: Final = 2**12
"""Bytes read for the header of a page; one with statistics of short texts takes 100."""
_LONGEST_PAGE_HEAD: Final = 2**20

_Wanted = Mapping[int, Any]
"""Wanted fields of a struct by number: None for a whole number, a mapping for a struct, and a list
of one mapping for a list of structs."""

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

_BOOLEANS, _WHOLES, _BINARY, _LISTS, _MAP, _STRUCT = (1, 2), (4, 5, 6), 8, (9, 10), 11, 12
_LENGTHS: Final = {1: 1, 2: 1, 3: 1, 7: 8}
"""Bytes of other values by kind: truth values in lists, a byte, a number with a point."""


def _damage(found: str) -> DamageError:
    return DamageError(f"expected a complete Parquet file, found {found}")


def _read_footer(
    stream: BinaryIO, most_bytes: int, most_parts: int, advice: str
) -> Mapping[int, Any]:
    """Return the wanted fields of a footer within limits; `advice` ends an error about them."""
    size = stream.seek(0, 2)
    stream.seek(max(size - _ENDING, 0))
    ending = stream.read(_ENDING)
    if size < len(_MAGIC) + _ENDING or ending[4:] != _MAGIC:
        raise _damage("no footer at its end")
    length = int.from_bytes(ending[:4], "little")
    if length > size - _ENDING:
        raise _damage(f"{size:,} bytes of it")
    if length > most_bytes:
        raise DamageError(
            f"expected a footer of up to {most_bytes:,} bytes, found {length:,}{advice}"
        )
    stream.seek(size - _ENDING - length)
    return _Thrift(stream.read(length), most_parts).read_struct(_FOOTER)


def _read_chunk(chunk: Mapping[int, Any]) -> _Chunk:
    found = chunk.get(3, {})
    first, dictionary = found.get(9, 0), found.get(11, 0)
    start = dictionary if 0 < dictionary < first else first
    return _Chunk(found.get(5, 0), start, found.get(7, 0))


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


def _iterate_pages(stream: BinaryIO, chunk: _Chunk) -> Iterator[_Page]:
    """Yield the headers of a column's pages in a row group; no page is unpacked."""
    place, end = chunk.start, chunk.start + chunk.size
    if chunk.start < len(_MAGIC) or chunk.size < 0 or end > stream.seek(0, 2):
        raise _damage("a column outside the file")
    while place < end:
        page, head = _read_page_header(stream, place, end)
        packed, unpacked = page.get(3, -1), page.get(2, -1)
        if packed < 0 or unpacked < 0:
            raise DamageError(f"byte {place}: expected a page of a column, found no size")
        data: Mapping[int, Any] = page.get(5) or page.get(7) or page.get(8) or {}
        yield _Page(unpacked, data.get(1, 0), data.get(4 if 8 in page else 2, 0))
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


def _require_shallow(depth: int) -> None:
    if depth > _DEEPEST_STRUCT:
        raise _damage("structs that nest too far")


class _Thrift:
    """Values in the compact protocol, read one after another; the next is at `place`."""

    def __init__(self, data: bytes, most_parts: int) -> None:
        self._data, self._parts, self._most = data, 0, most_parts
        self.place = 0

    def read_struct(self, wanted: _Wanted, depth: int = 0) -> dict[int, Any]:
        """Return the wanted fields that exist."""
        self._parts += 1
        if self._parts > self._most:
            raise DamageError(
                f"expected a footer of up to {self._most:,} columns, groups and other parts,"
                " found more"
            )
        _require_shallow(depth)
        found: dict[int, Any] = {}
        number = 0
        while (head := self._take()) != 0:
            kind, step = head & 15, head >> 4
            number = number + step if step else self._take_whole()
            is_wanted = number in wanted
            value = self._read(kind, wanted[number] if is_wanted else None, depth, is_field=True)
            if is_wanted:
                if type(value) is not _KINDS[type(wanted[number])]:
                    raise _damage(f"{kind} as a kind")
                found[number] = value
        return found

    def _read(self, kind: int, wanted: Any, depth: int, *, is_field: bool = False) -> Any:
        if kind in _WHOLES:
            return self._take_whole()
        if kind == _STRUCT:
            return self.read_struct(wanted if isinstance(wanted, dict) else {}, depth + 1)
        if kind in _LISTS:
            return self._read_list(wanted[0] if isinstance(wanted, list) else None, depth + 1)
        if kind in _BOOLEANS and is_field:
            return kind == 1
        self._skip(kind, depth + 1)
        return None

    def _read_list(self, wanted: Any, depth: int) -> list[Any]:
        _require_shallow(depth)
        head = self._take()
        count, kind = head >> 4, head & 15
        count = self._take_varint() if count == 15 else count
        if count > len(self._data) - self.place:
            raise _damage("a list longer than its bytes")
        if kind == _STRUCT and wanted is not None:
            return [self.read_struct(wanted, depth + 1) for _ in range(count)]
        for _ in range(count):
            self._read(kind, None, depth)
        return []

    def _skip(self, kind: int, depth: int) -> None:
        if kind == _MAP:
            count = self._take_varint()
            kinds = self._take() if count else 0
            for _ in range(min(count, len(self._data))):
                self._read(kinds >> 4, None, depth)
                self._read(kinds & 15, None, depth)
            return
        length = self._take_varint() if kind == _BINARY else _LENGTHS.get(kind)
        if length is None:
            raise _damage("a value of no known kind")
        self.place += length

    def _take(self) -> int:
        if self.place >= len(self._data):
            raise _damage("the end in its midst")
        self.place += 1
        return self._data[self.place - 1]

    def _take_varint(self) -> int:
        value, shift = 0, 0
        while (byte := self._take()) & 0x80:
            value |= (byte & 0x7F) << shift
            shift += 7
            if shift > 63:
                raise _damage("a number beyond 64 bits")
        return value | byte << shift

    def _take_whole(self) -> int:
        value = self._take_varint()
        return (value >> 1) ^ -(value & 1)


class _PageCounts:
    """Remaining limits for pages."""

    def __init__(self, stream: BinaryIO, file_size: int, advice: str) -> None:
        self._stream, self._advice = stream, advice
        self._pages = self._most_pages = limits.grow_bound(limits.PARQUET_PAGES, file_size)
        self._text_bytes = self._most_text_bytes = limits.grow_bound(
            limits.PARQUET_TEXT_BYTES, file_size
        )

    def count(self, chunks: Sequence[_Chunk], leaf: Any) -> bool:
        """Count the pages of a column, and return whether it is read as a dictionary of texts."""
        if leaf.physical_type == "BYTE_ARRAY":
            pages = [page for one in chunks for page in self._list(one)]
            encodings = {page.encoding for page in pages}
            is_dictionary = not encodings & _NO_DICTIONARY  # it stores repeated texts once
            repeating = encodings & _PLACES and not is_dictionary
            values = max((page.values for page in pages), default=0)
            for page in pages:
                repeats = repeating or page.encoding == _SHARES_PREFIXES
                self._spend_text(page.unpacked * (values if repeats else 1))
            return is_dictionary
        base, share = limits.PARQUET_PAGE_BYTES
        if leaf.physical_type == "FIXED_LEN_BYTE_ARRAY":
            share += leaf.length
            self._spend_text(sum(leaf.length * chunk.values for chunk in chunks))
        for chunk in chunks:
            most = base + share * chunk.values
            for page in self._list(chunk):
                if page.unpacked > most:
                    raise DamageError(
                        f"column {leaf.path}: expected a page of up to {most:,} bytes, found"
                        f" {page.unpacked:,}"
                    )
        return False

    def _list(self, chunk: _Chunk) -> Iterator[_Page]:
        for page in _iterate_pages(self._stream, chunk):
            self._pages -= 1
            if self._pages < 0:
                raise LogError(
                    f"the columns have more than {self._most_pages:,} pages. Write larger pages"
                    f"{self._advice}"
                )
            yield page

    def _spend_text(self, size: int) -> None:
        self._text_bytes -= size
        if self._text_bytes < 0:
            raise LogError(
                f"the texts may take more than {self._most_text_bytes:,} bytes. Write shorter texts"
                f" in a dictionary, or leave these columns out{self._advice}"
            )


def list_cells(cells: Any) -> list[Any]:
    """Return an Arrow array as Python values; repeated texts share one object."""
    found: list[Any] = []
    for chunk in getattr(cells, "chunks", [cells]):
        if hasattr(chunk, "dictionary"):
            used = chunk.indices.unique().drop_null()
            texts = chunk.dictionary.take(used).to_pylist()
            known = dict(zip(used.to_pylist(), texts, strict=True))
            found += [known.get(place) for place in chunk.indices.to_pylist()]
        else:
            found += chunk.to_pylist()
    return found
