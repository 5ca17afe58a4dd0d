"""Compressed chunk -> bytes, in bounded memory whatever its headers claim."""

from collections.abc import Iterator
from typing import Final

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from turtlelog.errors import LogError, describe_error

LARGEST_CHUNK: Final = 2**30
"""No chunk may hold more bytes, packed or unpacked; a damaged header may claim anything."""

SPARE: Final = 2**25
"""Bytes that may be allocated on the word of a header alone."""

_STEP: Final = 2**22  # bytes unpacked at a time, where the header may lie


def unpack_chunk(compression: str, packed: bytes, size: int) -> bytes:
    """Return the bytes of a chunk that claims to unpack to `size`; the claim is not trusted.

    What comes may be longer or shorter than claimed: the checksum decides.

    Raises:
        LogError: One clause, where the stream is damaged or holds far more than it claims.
    """
    limit = min(max(size, SPARE), LARGEST_CHUNK)
    try:
        match compression:
            case "":
                return packed
            case "zstd":
                return _unpack_zstd(packed, size, limit)
            case "lz4":
                return _unpack_lz4(packed, size, limit)
    except LogError:
        raise
    except Exception as err:  # the libraries raise ZstdError, RuntimeError, MemoryError and more
        raise LogError(f"expected sound {compression} data, found {describe_error(err)}") from err
    raise LogError(f"expected the compression zstd, lz4 or none, found {compression[:20]!r}")


def _unpack_zstd(packed: bytes, size: int, limit: int) -> bytes:
    promised = zstandard.frame_content_size(packed)  # -1: not said
    if promised in {-1, size} and size <= SPARE:
        return zstandard.ZstdDecompressor().decompress(packed, size)
    # A window is allocated on the word of the frame's header; a sound one is within the chunk.
    unpacker = zstandard.ZstdDecompressor(max_window_size=limit).stream_reader(packed)
    return _join(iter(lambda: unpacker.read(_STEP), b""), limit)


def _unpack_lz4(packed: bytes, size: int, limit: int) -> bytes:
    unpacker = lz4.frame.LZ4FrameDecompressor()
    first = unpacker.decompress(packed, max_length=min(max(size, 1), SPARE))
    if unpacker.eof:
        return bytes(first)
    return _join(_continue_lz4(unpacker, first), limit)


def _continue_lz4(unpacker: lz4.frame.LZ4FrameDecompressor, piece: bytes) -> Iterator[bytes]:
    yield piece
    while not unpacker.eof:
        if unpacker.needs_input:
            raise LogError("expected sound lz4 data, found the end of the chunk within it")
        yield unpacker.decompress(b"", max_length=_STEP)


def _join(pieces: Iterator[bytes], limit: int) -> bytes:
    data = bytearray()
    for piece in pieces:
        data += piece
        if len(data) > limit:
            raise LogError(f"expected up to {limit} bytes in a chunk, found more")
    return bytes(data)
