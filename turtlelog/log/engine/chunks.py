"""The bytes of a chunk record -> what it holds, unpacked and checked."""

import struct
import zlib
from dataclasses import dataclass
from typing import Final

from turtlelog.errors import LogError, describe_error
from turtlelog.log.engine.integrity import DamageError
from turtlelog.log.engine.limits import LARGEST_CHUNK
from turtlelog.log.engine.unpack import unpack_chunk

_HEAD: Final = struct.Struct("<QQQII")  # start, end, uncompressed size, crc, length of the name
_SIZE: Final = struct.Struct("<Q")


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
        start_ns, end_ns, size, crc, length = _HEAD.unpack_from(body)
        name = bytes(body[_HEAD.size : _HEAD.size + length])
        (data_size,) = _SIZE.unpack_from(body, _HEAD.size + length)
        compression = name.decode()
    except (struct.error, ValueError) as err:
        raise DamageError(f"byte {byte}: expected a chunk, found {describe_error(err)}") from err
    data_start = _HEAD.size + length + _SIZE.size
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
