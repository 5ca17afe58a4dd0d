"""Reading of Parquet files as Arrow tables, checked before reading, without threads.

By default pyarrow reads a Python stream in threads of its own. Such a thread may continue after the
answer, and then ends the process with SIGABRT when Python exits.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO, Final

from turtlelog.errors import LogError
from turtlelog.files.urls import RemotePath, make_path
from turtlelog.libraries import load_library
from turtlelog.log.engine.limits import SMALL_FILE, grow_bound
from turtlelog.log.file_access import DamageError, open_file
from turtlelog.log.parquet_counts import ChunkClaim, PageClaim, iterate_pages, read_footer_claims

MOST_ROWS: Final = 350_000
"""Largest number of rows of a small file, two hours at 50 poses per second.

Libraries leave 120 MB of the file's memory limit, and commands take up to 310 bytes per row."""
_ROW_BYTES: Final = 8
"""Bytes of a larger file per further row: x and y as 32-bit numbers do not compress."""

_CELLS_A_ROW: Final = 16
"""Number columns that are read at once with the most rows; fewer rows allow more columns."""

_TEXT_BYTES: Final = (24 * 2**20, 2)
"""Bytes of texts that are read at once, plus bytes per byte of the file (for dictionaries)."""

_PAGES: Final = (10_000, 1 / 1000)
"""Number of pages, plus pages per byte of the file.

Writers put 20,000 values or 1 MB into a page. Reading the header of a page takes 30 us."""

_PAGE_BYTES: Final = (2**16, 16)
"""Bytes of a page of numbers, plus bytes per row; the longest numbers have 16."""

_FOOTER_BYTES: Final = (2**21, 1 / 16)
_FOOTER_PARTS: Final = (2**16, 1 / 128)
"""Bytes and structs of the footer, plus those per byte of the file. Each column of each row group
takes 740 bytes in Arrow, and at least 100 in a file by other programs."""

_REMOTE_FOOTER_BYTES: Final = 2**23
"""Largest footer behind a URL, where the server may claim any file size [bytes].

Reading, copying and decoding the footer takes up to 80 MB.
"""
_REMOTE_FOOTER_PARTS: Final = 2**17
"""Largest number of structs in a footer behind a URL; they take up to 100 MB in Arrow."""

_DOWNLOAD: Final = "; download the file, then name the copy"

_DEEPEST: Final = 32
"""Largest nesting depth of columns in structs and lists; ROS messages have 6."""

_SHARES_PREFIXES: Final = 7
"""Encoding DELTA_BYTE_ARRAY: a text of 1 MB that repeats the previous one takes 2 bytes."""
_PLACES: Final = frozenset({2, 8})
"""Encodings with indices of a dictionary, which may repeat one long text."""
_NO_DICTIONARY: Final = frozenset({6, _SHARES_PREFIXES})
"""Encodings that Arrow does not read into a dictionary."""


def count_most_rows(size: int) -> int:
    """Return the largest number of table rows for a file size [bytes]."""
    return MOST_ROWS if size < SMALL_FILE else max(MOST_ROWS, size // _ROW_BYTES)


def describe_rows(found: str, most: int, size: int) -> str:
    """Return why a table with too many rows is refused, and what to do."""
    return (
        f"the table has {found} rows; {most:,} are the most for a file of {size:,} bytes. Cut the"
        " table into parts"
    )


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
            LogError: If the file is not Parquet, or exceeds limits. The message does not contain
                the file's name.
            LibraryError: If pyarrow is not installed.
        """
        self._path = make_path(path)
        parquet = load_library("pyarrow.parquet")
        with open_file(self._path) as stream:
            self._size = stream.seek(0, 2)
            is_remote = isinstance(self._path, RemotePath)
            # The size that a server claims does not raise any limit.
            self._believed = min(self._size, SMALL_FILE - 1) if is_remote else self._size
            self._advice = _DOWNLOAD if is_remote else ""
            most_bytes = grow_bound(_FOOTER_BYTES, self._size)
            most_parts = grow_bound(_FOOTER_PARTS, self._size)
            self._claims = read_footer_claims(
                stream,
                most_bytes=min(most_bytes, _REMOTE_FOOTER_BYTES) if is_remote else most_bytes,
                most_parts=min(most_parts, _REMOTE_FOOTER_PARTS) if is_remote else most_parts,
                advice=self._advice,
            )
            if self._claims.depth > _DEEPEST:
                raise LogError(
                    f"columns lie {self._claims.depth} deep in each other; turtlelog reads up to"
                    f" {_DEEPEST}. Write a table of flat columns"
                )
            stream.seek(0)
            try:
                self.metadata = parquet.read_metadata(stream)
            except (OSError, ValueError) as err:  # Arrow raises its own subclasses of these
                raise DamageError(
                    "expected a complete Parquet file, found a footer that is damaged; copy the"
                    " file again from its source"
                ) from err
        self.schema = self.metadata.schema.to_arrow_schema()
        self.group_rows: Sequence[int] = self._claims.group_rows
        self.row_count = self._claims.row_count
        columns = self.metadata.schema
        self.leaves = [columns.column(number) for number in range(len(columns))]
        if min(self.group_rows, default=0) < 0:
            raise DamageError("expected a complete Parquet file, found less than no rows")

    def read(self, names: Sequence[str] | None = None, group: int | None = None) -> Any:
        """Return columns of all row groups, or one, as an Arrow table of dictionary-encoded texts.

        Names have dots for columns within structs. Default: all columns.

        Raises:
            LogError: If the columns need too much memory. The message does not contain the file's
                name.
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
            LogError: If there are too many rows. The message contains the number of rows, the limit
                and advice, but not the file's name.
        """
        most = count_most_rows(self._size)
        if self.row_count > most:
            told = describe_rows(f"{self.row_count:,}", most, self._size)
            raise LogError(f"{told}, or write it without compression")
        if self.row_count > MOST_ROWS and isinstance(self._path, RemotePath):
            self._believed = self._path.file.fetch_whole()

    def require_cells(self, columns: int, rows: int | None = None) -> None:
        """Refuse to read more cells than the memory limit allows. Default: all rows."""
        rows = self.row_count if rows is None else rows
        most = _CELLS_A_ROW * max(MOST_ROWS, self._believed // _ROW_BYTES)
        if rows * columns > most:
            raise LogError(
                f"the table has {columns:,} columns of {rows:,} rows; {most:,} cells are the most"
                f" for a file of {self._size:,} bytes. Write fewer columns"
                f"{self._advice}"
            )

    def _require_bounded(
        self, stream: BinaryIO, places: Sequence[int], groups: Sequence[int]
    ) -> list[str]:
        """Return the text columns that are read as dictionaries."""
        self.require_cells(len(places), sum(self.group_rows[group] for group in groups))
        size = self._believed
        counts = _PageCounts(grow_bound(_PAGES, size), grow_bound(_TEXT_BYTES, size), self._advice)
        texts = []
        for place in places:
            chunks = [self._find_chunk(group, place) for group in groups]
            if counts.count(stream, chunks, self.leaves[place]):
                texts.append(self.leaves[place].path)
        return texts

    def _find_chunk(self, group: int, place: int) -> ChunkClaim:
        chunks, leaf = self._claims.chunks[group], self.leaves[place]
        if leaf.max_repetition_level:
            raise LogError(f"column {leaf.path}: expected numbers or texts, found lists")
        if place >= len(chunks) or chunks[place].values != self.group_rows[group]:
            raise DamageError(f"column {leaf.path}: expected a value for each row, found others")
        return chunks[place]


class _PageCounts:
    """Remaining limits for pages."""

    def __init__(self, pages: int, text_bytes: int, advice: str) -> None:
        self._advice = advice
        self._pages, self._text_bytes = pages, text_bytes
        self._most_pages, self._most_text_bytes = pages, text_bytes

    def count(self, stream: BinaryIO, chunks: Sequence[ChunkClaim], leaf: Any) -> bool:
        """Count the pages of a column, and return whether it is read as a dictionary of texts."""
        if leaf.physical_type == "BYTE_ARRAY":
            return self._count_texts([page for one in chunks for page in self._list(stream, one)])
        base, share = _PAGE_BYTES
        if leaf.physical_type == "FIXED_LEN_BYTE_ARRAY":
            share += leaf.length
            self._spend_text(sum(leaf.length * chunk.values for chunk in chunks))
        for chunk in chunks:
            most = base + share * chunk.values
            for page in self._list(stream, chunk):
                if page.unpacked > most:
                    raise DamageError(
                        f"column {leaf.path}: expected a page of up to {most:,} bytes, found"
                        f" {page.unpacked:,}"
                    )
        return False

    def _list(self, stream: BinaryIO, chunk: ChunkClaim) -> Iterator[PageClaim]:
        for page in iterate_pages(stream, chunk):
            self._pages -= 1
            if self._pages < 0:
                raise LogError(
                    f"the columns have more than {self._most_pages:,} pages. Write larger pages"
                    f"{self._advice}"
                )
            yield page

    def _count_texts(self, pages: Sequence[PageClaim]) -> bool:
        """Return whether texts are read as a dictionary, which stores repeated texts once."""
        found = {page.encoding for page in pages}
        is_dictionary = not found & _NO_DICTIONARY
        values = max((page.values for page in pages), default=0)
        for page in pages:
            repeats = page.encoding == _SHARES_PREFIXES or (found & _PLACES and not is_dictionary)
            self._spend_text(page.unpacked * (values if repeats else 1))
        return is_dictionary

    def _spend_text(self, size: int) -> None:
        self._text_bytes -= size
        if self._text_bytes < 0:
            raise LogError(
                f"the texts may take more than {self._most_text_bytes:,} bytes. Write shorter texts"
                f" in a dictionary, or leave these columns out{self._advice}"
            )


def list_cells(cells: Any) -> list[Any]:
    """Return an Arrow array as Python values; repeated texts share one object."""
    chunks = getattr(cells, "chunks", [cells])
    return [cell for chunk in chunks for cell in _list_chunk(chunk)]


def _list_chunk(cells: Any) -> list[Any]:
    found: list[Any]
    if not hasattr(cells, "dictionary"):
        found = cells.to_pylist()
        return found
    used = cells.indices.unique().drop_null()
    texts = dict(zip(used.to_pylist(), cells.dictionary.take(used).to_pylist(), strict=True))
    return [texts.get(place) for place in cells.indices.to_pylist()]
