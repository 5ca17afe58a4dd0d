"""The bytes of a chunk record -> what it holds, unpacked in bounded memory and checked."""

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import SEEK_END, BytesIO
from typing import Final

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from turtlelog.errors import LogError, describe_error
from turtlelog.log.engine.integrity import DamageError
from turtlelog.log.engine.limits import LARGEST_CHUNK

CHUNK_HEAD: Final = struct.Struct("<QQQII")
"""Start, end, size unpacked, crc, and length of the name of the compression."""

_SIZE: Final = struct.Struct("<Q")

SPARE: Final = 2**25
"""Bytes that may be allocated on the word of a header alone."""

_STEP: Final = 2**22  # bytes unpacked at a time, where the header may lie


@dataclass(frozen=True, slots=True, kw_only=True)
class ChunkHead:
    """The head of a chunk record.

    Attributes:
        start_ns: Least log time of its messages, 0 where it has none.
        end_ns: Greatest log time.
        size: Of the records in it, decompressed [bytes].
        crc: Of these bytes, 0 where there is none.
        compression: `zstd`, `lz4` or empty.
        data_start: Where the compressed bytes start in the record's body.
        data_size: Their number.
    """

    start_ns: int
    end_ns: int
    size: int
    crc: int
    compression: str
    data_start: int
    data_size: int


def parse_chunk_head(
    body: bytes | memoryview, byte: int, largest: int = LARGEST_CHUNK
) -> ChunkHead:
    """Return the head of a chunk record; `byte` is where it stands in the file.

    Raises:
        DamageError: Where the body is too short for what it says, or that is more than `largest`.
    """
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
    return ChunkHead(
        start_ns=start_ns,
        end_ns=end_ns,
        size=size,
        crc=crc,
        compression=compression,
        data_start=data_start,
        data_size=data_size,
    )


def open_chunk(head: ChunkHead, body: bytes | memoryview, byte: int) -> bytes:
    """Return the records in a chunk, decompressed, their checksum checked.

    Raises:
        DamageError: Where they are not those that were written; `byte` is where the chunk stands.
    """
    packed = body[head.data_start : head.data_start + head.data_size]
    try:
        data = unpack_chunk(head.compression, packed, head.size)
    except LogError as err:
        raise DamageError(f"byte {byte}: chunk: {err}") from err
    if len(data) != head.size:
        raise DamageError(f"byte {byte}: chunk: expected {head.size} bytes, found {len(data)}")
    if head.crc and head.crc != (found := zlib.crc32(data)):
        raise DamageError(
            f"byte {byte}: chunk: expected checksum {head.crc:#010x}, found {found:#010x}"
        )
    return data


def unpack_chunk(
    compression: str,
    packed: bytes | memoryview,
    size: int,
    *,
    largest: int = LARGEST_CHUNK,
    spend: Callable[[int], None] = lambda _: None,
) -> bytes:
    """Return the bytes of a chunk that claims to unpack to `size`; the claim is not trusted.

    What comes may be longer or shorter than claimed: the checksum decides.

    Args:
        compression: `zstd`, `lz4` or empty.
        packed: The compressed bytes.
        size: The claim.
        largest: What no chunk may exceed [bytes].
        spend: Called with bytes as they come, of damaged streams too; may refuse them.

    Raises:
        LogError: One clause, where the stream is damaged, holds far more than it claims, or more
            than `largest`.
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
    promised = zstandard.frame_content_size(packed)  # -1: not said
    # Two headers that agree are believed: one alone may be damaged.
    if promised in {-1, size} and size <= (limit if promised == size else SPARE):
        spend(size)
        return zstandard.ZstdDecompressor().decompress(packed, size)
    # A window is allocated on the word of the frame's header; a sound one is within the chunk.
    unpacker = zstandard.ZstdDecompressor(max_window_size=limit).stream_reader(packed)
    return _join(iter(lambda: unpacker.read(_STEP), b""), limit, spend)


def _iterate_lz4(packed: bytes | memoryview, size: int) -> Iterator[bytes]:
    unpacker = lz4.frame.LZ4FrameDecompressor()
    yield unpacker.decompress(packed, max_length=min(max(size, 1), SPARE))
    while not unpacker.eof:
        if unpacker.needs_input:
            raise LogError("expected sound lz4 data, found the end of the chunk within it")
        yield unpacker.decompress(b"", max_length=_STEP)


def _join(pieces: Iterator[bytes], limit: int, spend: Callable[[int], None]) -> bytes:
    first = next(pieces, b"")
    spend(len(first))
    data = BytesIO(first)  # takes bytes over, and hands them over, without a copy
    data.seek(0, SEEK_END)
    for piece in pieces:
        spend(len(piece))
        data.write(piece)
        if data.tell() > limit:
            break
    if data.tell() > limit:
        raise LogError(f"expected up to {limit} bytes in a chunk, found more")
    return data.getvalue()
