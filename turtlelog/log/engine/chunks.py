"""Unpacking and checking of chunk records, in bounded memory."""

import struct
import threading
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import SEEK_END, BytesIO
from typing import Final

import zstandard

from turtlelog.errors import LogError, describe_error
from turtlelog.log.engine.limits import LARGEST_CHUNK
from turtlelog.log.file_access import DamageError

CHUNK_HEAD: Final = struct.Struct("<QQQII")
"""Start and end time, unpacked size, checksum, and length of the compression's name."""

_SIZE: Final = struct.Struct("<Q")

ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"

SPARE: Final = 2**25
"""Largest number of bytes that may be allocated when only a header claims the size."""

_STEP: Final = 2**22  # bytes unpacked at a time if the header's size may be wrong


@dataclass(frozen=True, slots=True, kw_only=True)
class ChunkEntry:
    """Entry of a chunk in the summary.

    Attributes:
        start: Offset in the file [bytes].
        length: Length of the chunk record [bytes].
        index_length: Length of the message indexes after the chunk [bytes].
        start_ns: Earliest log time of the chunk's messages [ns]; 0 without messages.
        end_ns: Latest log time [ns].
        channels: Ids of the channels that have messages in the chunk.
        size: Decompressed size of the chunk's records [bytes].
    """

    start: int
    length: int
    index_length: int
    start_ns: int
    end_ns: int
    channels: frozenset[int]
    size: int

    @property
    def end(self) -> int:
        """Offset after the chunk's message indexes [bytes]."""
        return self.start + self.length + self.index_length


def open_chunk(entry: ChunkEntry, body: bytes | memoryview, largest: int = LARGEST_CHUNK) -> bytes:
    """Return the decompressed records of a chunk after checking the checksum.

    Args:
        entry: Entry of the chunk in the summary.
        body: Body of the chunk record.
        largest: Largest size of an unpacked chunk [bytes].

    Raises:
        DamageError: If the chunk is too short, fails its checksum, or disagrees with the index.
    """
    byte = entry.start
    try:
        start_ns, end_ns, size, crc, length = CHUNK_HEAD.unpack_from(body)
        name = bytes(body[CHUNK_HEAD.size : CHUNK_HEAD.size + length])
        (data_size,) = _SIZE.unpack_from(body, CHUNK_HEAD.size + length)
        compression = name.decode()
    except (struct.error, ValueError) as err:
        raise DamageError(f"byte {byte}: expected a chunk, found {describe_error(err)}") from err
    data_start = CHUNK_HEAD.size + length + _SIZE.size
    if data_start + data_size > len(body) or size > largest:
        raise DamageError(
            f"byte {byte}: expected a chunk of up to {len(body) - data_start} bytes for up to"
            f" {largest}, found {data_size} for {size}"
        )
    found = (start_ns, end_ns, size)
    if found != (entry.start_ns, entry.end_ns, entry.size):
        expected = f"times {entry.start_ns} to {entry.end_ns} and {entry.size} bytes"
        raise DamageError(
            f"byte {byte}: expected a chunk of {expected} as its index says, found {found}"
        )
    packed = body[data_start : data_start + data_size]
    return _unpack_checked(compression, packed, size, crc, byte)


def _unpack_checked(
    compression: str, packed: bytes | memoryview, size: int, crc: int, byte: int
) -> bytes:
    try:
        data = unpack_chunk(compression, packed, size)
    except LogError as err:
        raise DamageError(f"byte {byte}: chunk: {err}") from err
    if len(data) != size:
        raise DamageError(f"byte {byte}: chunk: expected {size} bytes, found {len(data)}")
    if crc and crc != (found := zlib.crc32(data)):
        raise DamageError(f"byte {byte}: chunk: expected checksum {crc:#010x}, found {found:#010x}")
    return data


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
        spend: Function that is called with the number of unpacked bytes, also for damaged streams.
            The function may raise an error.

    Raises:
        LogError: If the stream is damaged, or unpacks to far more than claimed or to more than
            `largest`; the message is one clause.
    """
    limit = min(max(size, SPARE), largest)
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


def _unpack_zstd(
    packed: bytes | memoryview, size: int, limit: int, spend: Callable[[int], None]
) -> bytes:
    promised = zstandard.frame_content_size(packed)  # -1: not given
    # The size is trusted if two headers agree; a single header may be damaged.
    if promised in {-1, size} and size <= (limit if promised == size else SPARE):
        spend(size)
        return _find_unpacker().decompress(packed, size)
    # The frame's header determines how large a window is allocated; a valid one fits the chunk.
    unpacker = zstandard.ZstdDecompressor(max_window_size=limit).stream_reader(packed)
    return _join(iter(lambda: unpacker.read(_STEP), b""), limit, spend)


_OF_THREAD: Final = threading.local()


def _find_unpacker() -> zstandard.ZstdDecompressor:
    """Return the decompressor of this thread: making one takes as long as 500 kB."""
    found: zstandard.ZstdDecompressor | None = getattr(_OF_THREAD, "unpacker", None)
    if found is None:
        found = _OF_THREAD.unpacker = zstandard.ZstdDecompressor()
    return found


def _iterate_lz4(packed: bytes | memoryview, size: int) -> Iterator[bytes]:
    import lz4.frame  # type: ignore[import-untyped]  # files of zstd spare it

    unpacker = lz4.frame.LZ4FrameDecompressor()
    yield unpacker.decompress(packed, max_length=min(max(size, 1), SPARE))
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
