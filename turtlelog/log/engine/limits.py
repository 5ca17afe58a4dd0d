"""Limits on memory and time for reading a file, by its size; reading and unpacking within them.

A few kilobytes can unpack to gigabytes, or contain millions of empty records. In every command, a
file of less than 10 MB takes less than 256 MB and 10 s, whatever its content. A larger file may
take more. Most limits are about ten times the needs of recordings.
"""

import threading
import zlib
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from io import SEEK_END, BytesIO
from typing import BinaryIO, Final

from mcap.records import Channel, Schema

from turtlelog.errors import LogError, describe_error

UNPACKED: Final = "bytes in chunks"
UNPACKED_FILE: Final = "bytes of a file that is compressed as a whole"
FRAMES: Final = "frames of a file that is compressed as a whole"
RECORDS: Final = "records"
DESCRIPTIONS: Final = "schemas and channels"
SCHEMA_BYTES: Final = "bytes of schemas"
CHANNEL_BYTES: Final = "bytes of channels"
FIELDS: Final = "fields of types"
NOTES: Final = "metadata records and attachments"
DAMAGES: Final = "damaged places"
CHUNKS: Final = "chunks"
CHUNK_CHANNELS: Final = "channels in chunks"
COLUMNS: Final = "bytes of columns"
CHANGES: Final = "channels that change their meaning"

SMALL_FILE: Final = 10**7
"""Size of a file below which reading takes less than 256 MB of memory and 10 s [bytes]."""

LARGEST_CHUNK: Final = 2**30
"""Largest size of a chunk, packed or unpacked [bytes]; a damaged header may claim any size."""

MOST_DESCRIBED: Final = 2**17
"""Largest number of schemas and channels in a chunk: their ids have 16 bits each."""

LONGEST_DESCRIBED: Final = 2**24
"""Largest size of a schema or channel [bytes]; a text with all its types takes 100 kB."""


LONGEST_MESSAGE: Final = 2**24
"""Largest size of a message [bytes]. Decoded objects may take thirty times as much memory."""

MOST_PARTS: Final = 2**18
"""Largest number of objects, references and choices that are read in a schema.

References to objects with references multiply, even without fields. Reading this number of parts
takes 0.5 s; a text of 1 MB has fewer objects."""

# A writer closes a chunk after the message that fills it, so one of 64 MiB is one message longer.
# Chunks should be much smaller than their file; a large file may have one eight times as large.
_CHUNK: Final = 80 * 2**20
_CHUNK_SHARE: Final = 8

_BASES: Final[Mapping[str, tuple[int, float]]] = {
    # The messages of a robot at rest pack to a fortieth, an empty map to a thousandth.
    UNPACKED: (2**30, 64),
    # Written to a disk before it is read.
    UNPACKED_FILE: (2**28, 64),
    # Parallel compressors write a frame for each 512 kB or more; starting a frame takes 20 us.
    FRAMES: (2**14, 1 / 1000),
    # The times of a message take at least two bytes, however well they are compressed.
    RECORDS: (2**22, 0.5),
    # Some writers repeat all schemas and channels in every chunk.
    DESCRIPTIONS: (2**19, 1 / 16),
    # Different schemas only.
    SCHEMA_BYTES: (2**24, 1),
    # In memory: enough for the largest possible number of channels with a table each.
    CHANNEL_BYTES: (80 * 2**20, 1),
    # Fields of different types, about 1 kB each in memory; 200 types of 50 fields are many.
    FIELDS: (50_000, 1 / 1000),
    # With their entries in the summary. Each attachment costs 200 us in every pass.
    NOTES: (2**12, 1 / 1000),
    # Each damage is noted with its reason.
    DAMAGES: (10_000, 1 / 1000),
    # One per second for an hour. A chunk with the poses of a second and all schemas packs to 1
    # kB. Each chunk costs 100 us in every pass, and some answers take five passes.
    CHUNKS: (2**12, 1 / 1000),
    # Each channel counts in every chunk with its messages.
    CHUNK_CHANNELS: (2**18, 1 / 32),
    # Joined files have one change for each channel.
    CHANGES: (2**12, 1 / 1000),
}
"""Limits by kind: a fixed number, and a number for each byte of the file."""

# A run takes five times as much memory as its columns. Columns of recordings take up to three bytes
# per byte of the file, those of a robot at rest 25: hours of rest fit into few bytes. The limit
# must not be higher: with the largest number of poses, `explain` and `replay --plant` take 240 MB.
_COLUMNS: Final = 40_000_000
_COLUMNS_SHARE: Final = 16  # of the size beyond

_CHANNEL: Final = 500  # bytes in memory, without the letters of its name
_ENTRY: Final = 200  # bytes in memory of an entry of its table, without its letters


class Allowance:
    """Remaining limits of one pass over a file.

    Attributes:
        largest_chunk: Largest size of an unpacked chunk [bytes].
    """

    def __init__(self, file_size: int) -> None:
        self.largest_chunk = min(LARGEST_CHUNK, max(_CHUNK, _CHUNK_SHARE * file_size))
        self._file_size = file_size
        self._most = {kind: grow_bound(bound, file_size) for kind, bound in _BASES.items()}
        self._most[COLUMNS] = _COLUMNS + _COLUMNS_SHARE * max(0, file_size - SMALL_FILE)
        self._left = dict(self._most)
        self._spending = threading.Lock()

    def count_left(self, kind: str) -> int:
        """Return the remaining number of a kind."""
        return max(self._left[kind], 0)

    def spend(self, kind: str, count: int = 1) -> None:
        """Subtract a number of a kind from the remaining limit.

        Raises:
            LogError: If there are more values than a file of this size may contain. The line
                contains the error and, for columns, the option that leaves some columns out.
        """
        with self._spending:  # several threads unpack messages at once
            self._left[kind] = left = self._left[kind] - count
        if left >= 0:
            return
        most, size = self._most[kind], self._file_size
        if kind == COLUMNS:
            raise LogError(
                f"its messages take more than {most:,} bytes as columns, the most for a file of"
                f" {size:,} bytes. Cut the file into parts, or store it without compression"
                " (mcap decompress FILE)"
            )
        advice = "; mcap filter FILE -o NEW.mcap writes larger ones" if kind == CHUNKS else ""
        raise LogError(
            f"expected up to {most} {kind} in a file of {size} bytes, found more{advice}"
        )

    def spend_description(self, described: Schema | Channel) -> None:
        """Subtract a new schema or channel from the limits."""
        if isinstance(described, Schema):
            texts = described.data, described.name, described.encoding
            self.spend(SCHEMA_BYTES, sum(map(len, texts)))
        else:
            entries, size = described.metadata, _CHANNEL + len(described.topic)
            size += len(described.message_encoding)
            if entries:
                size += _ENTRY * len(entries) + sum(map(len, entries.values()))
            self.spend(CHANNEL_BYTES, size)


def grow_bound(bound: tuple[int, float], file_size: int) -> int:
    """Return the limit for a file: a fixed number plus a fraction of its bytes."""
    base, share = bound
    return base + int(share * file_size)


def measure_stored(stream: BinaryIO) -> int:
    """Return the size of a stream's file [bytes]; for an unpacked file, its packed size."""
    stored: int | None = getattr(stream, "stored_size", None)
    if stored is not None:
        return stored
    place = stream.tell()
    size = stream.seek(0, 2)
    stream.seek(place)
    return size


MOST_ROWS: Final = 350_000
"""Largest number of rows of a small file, two hours at 50 poses per second.

Libraries leave 120 MB of the file's memory limit, and commands take up to 310 bytes per row."""
ROW_BYTES: Final = 8
"""Bytes of a larger file per further row: x and y as 32-bit numbers do not compress."""


def count_most_rows(size: int) -> int:
    """Return the largest number of table rows for a file size [bytes]."""
    return MOST_ROWS if size < SMALL_FILE else max(MOST_ROWS, size // ROW_BYTES)


def describe_rows(found: str, most: int, size: int) -> str:
    """Return why a table with too many rows is refused, and what to do."""
    return (
        f"the table has {found} rows; {most:,} are the most for a file of {size:,} bytes. Cut the"
        " table into parts"
    )


PARQUET_TEXT_BYTES: Final = (24 * 2**20, 2)
"""Bytes of texts that are read at once, plus bytes per byte of the file (for dictionaries)."""


PARQUET_CELLS_A_ROW: Final = 16
"""Number columns that are read at once with the most rows; fewer rows allow more columns."""

PARQUET_PAGES: Final = (10_000, 1 / 1000)
"""Number of pages, plus pages per byte of the file.

Writers put 20,000 values or 1 MB into a page. Reading the header of a page takes 30 us."""

PARQUET_PAGE_BYTES: Final = (2**16, 16)
"""Bytes of a page of numbers, plus bytes per row; the longest numbers have 16."""

PARQUET_FOOTER_BYTES: Final = (2**21, 1 / 16)
PARQUET_FOOTER_PARTS: Final = (2**16, 1 / 128)
"""Bytes and structs of the footer, plus those per byte of the file. Each column of each row group
takes 740 bytes in Arrow, and at least 100 in a file by other programs."""

PARQUET_REMOTE_FOOTER_BYTES: Final = 2**23
"""Largest footer behind a URL [bytes]: a server may claim any file size, and reading takes 80
MB."""
PARQUET_REMOTE_FOOTER_PARTS: Final = 2**17
"""Largest number of structs in a footer behind a URL; they take up to 100 MB in Arrow."""


PARQUET_DEPTH: Final = 32
"""Largest nesting depth of columns in structs and lists; ROS messages have 6."""


ROS1_MESSAGES: Final = (2**18, 1 / 20)
"""Largest number of messages in any bag, plus messages per byte; those of 10 MB take about 4 s."""

ROS1_BZ2_BYTES: Final = (48 * 2**20, 8.0)
"""Largest number of bytes that bz2 may unpack, plus bytes per byte of the bag.

A bag of 10 MB takes about 4 s. Messages of robots pack to a fifth or a tenth."""

ROS1_CHUNK: Final = (2**25, 1.0)
"""Largest size of a chunk in any bag [bytes], plus bytes per byte of the bag.

A larger one than 768 kB has one large message, which is in memory four times."""


ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"

_SPARE: Final = 2**25
"""Largest number of bytes that may be allocated when only a header claims the size."""

_STEP: Final = 2**22  # bytes unpacked at a time if the header's size may be wrong

_OF_THREAD: Final = threading.local()
"""The decompressor of each thread."""


def unpack_chunk(
    compression: str,
    packed: bytes | memoryview,
    size: int,
    *,
    largest: int = LARGEST_CHUNK,
    spend: Callable[[int], None] = lambda _: None,
) -> bytes:
    """Return the unpacked bytes of a chunk. The claimed `size` is not trusted.

    The result may be longer or shorter than claimed; the checksum shows whether it is valid.

    Args:
        compression: `zstd`, `lz4` or empty.
        packed: Compressed bytes.
        size: Claimed size [bytes].
        largest: Largest size of any unpacked chunk [bytes].
        spend: Function that is called with the number of unpacked bytes, and may raise an error.

    Raises:
        LogError: If the stream is damaged, or unpacks to far more than claimed or to more than
            `largest`; the message is one clause.
    """
    limit = min(max(size, _SPARE), largest)
    try:
        match compression:
            case "":
                return bytes(packed)
            case "zstd":
                return _unpack_zstd(packed, size, limit, spend)
            case "lz4":
                return _join(_iterate_lz4(packed, size), limit, spend)
    except LogError:
        raise
    except Exception as err:  # the libraries raise ZstdError, RuntimeError, MemoryError and more
        raise LogError(f"expected sound {compression} data, found {describe_error(err)}") from err
    raise LogError(f"expected the compression zstd, lz4 or none, found {compression[:20]!r}")


def unpack_within(allowance: Allowance, compression: str, packed: bytes, size: int) -> bytes:
    """Return the unpacked bytes of a chunk, within the limits that its file leaves."""
    largest = allowance.largest_chunk
    if compression and size > largest:
        raise LogError(f"expected a chunk of up to {largest} bytes, found {size}")
    if compression and not allowance.count_left(UNPACKED):
        allowance.spend(UNPACKED)
    spend = partial(allowance.spend, UNPACKED)
    return unpack_chunk(compression, packed, size, largest=largest, spend=spend)


def check_chunk(data: bytes, size: int, checksum: int, *, agree: bool) -> None:
    """Refuse unpacked bytes that contradict the chunk's checksum or, without one, its lengths."""
    if checksum and (found := zlib.crc32(data)) != checksum:
        raise LogError(f"expected a chunk with the checksum {checksum:#010x}, found {found:#010x}")
    if not checksum and (len(data) != size or not agree):
        raise LogError(f"expected a chunk of {size} bytes, found {len(data)} and no checksum")


LONGEST_COMPRESSION: Final = 64  # bytes of the name of a compression


def _unpack_zstd(
    packed: bytes | memoryview, size: int, limit: int, spend: Callable[[int], None]
) -> bytes:
    import zstandard  # tables need only the limits

    promised = zstandard.frame_content_size(packed)  # -1: not given
    # The size is trusted if two headers agree; a single header may be damaged.
    if promised in {-1, size} and size <= (limit if promised == size else _SPARE):
        spend(size)
        unpacker = getattr(_OF_THREAD, "unpacker", None)
        if unpacker is None:  # making one takes as long as 500 kB
            unpacker = _OF_THREAD.unpacker = zstandard.ZstdDecompressor()
        data: bytes = unpacker.decompress(packed, size)
        return data
    # The frame's header determines how large a window is allocated; a valid one fits the chunk.
    reader = zstandard.ZstdDecompressor(max_window_size=limit).stream_reader(packed)
    return _join(iter(lambda: reader.read(_STEP), b""), limit, spend)


def _iterate_lz4(packed: bytes | memoryview, size: int) -> Iterator[bytes]:
    import lz4.frame  # type: ignore[import-untyped]  # files of zstd spare it

    unpacker = lz4.frame.LZ4FrameDecompressor()
    yield unpacker.decompress(packed, max_length=min(max(size, 1), _SPARE))
    while not unpacker.eof:
        if unpacker.needs_input:
            raise LogError("expected sound lz4 data, found the end of the chunk within it")
        yield unpacker.decompress(b"", max_length=_STEP)


def _join(pieces: Iterator[bytes], limit: int, spend: Callable[[int], None]) -> bytes:
    first = next(pieces, b"")
    spend(len(first))
    data = BytesIO(first)  # takes and returns bytes without a copy
    data.seek(0, SEEK_END)
    for piece in pieces:
        spend(len(piece))
        data.write(piece)
        if data.tell() > limit:
            break
    if data.tell() > limit:
        raise LogError(f"expected up to {limit} bytes in a chunk, found more")
    return data.getvalue()


_WINDOW: Final = 2**22  # bytes read at once
_HELD: Final = 2**24  # bytes of a file that are cached, in whatever order records refer to them


class FileWindow:
    """A file with random access; small reads use a cached window, or the whole file.

    Attributes:
        size: Size of the file [bytes].
        allowance: Limits for unpacking the file's chunks.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._start, self._data = 0, b""
        self.size = stream.seek(0, 2)
        self._spare = self.size
        self.allowance = Allowance(measure_stored(stream))
        self._is_held = self.size <= _HELD
        if self._is_held:
            stream.seek(0)
            self._data = stream.read(self.size)

    def read(self, start: int, count: int) -> bytes:
        """Return `count` bytes from `start`, fewer at the end of the file."""
        at = start - self._start
        if self._is_held or (at >= 0 and at + count <= len(self._data)):
            return self._data[at : at + count]
        self._stream.seek(start)
        if count > _WINDOW:
            return self._stream.read(count)
        self._start, self._data = start, self._stream.read(_WINDOW)
        return self._data[:count]

    def spend(self, count: int) -> bool:
        """Return whether bytes may be read to try a checksum, in all as many as the file has."""
        self._spare -= count
        return self._spare >= 0
