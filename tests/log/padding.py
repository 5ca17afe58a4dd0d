"""Twins of MCAP files: every record that a later version may extend ends in unknown bytes."""

import struct
import zlib
from collections.abc import Callable, Collection
from dataclasses import replace
from io import BytesIO
from typing import Any, Final

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    MessageIndex,
    MetadataIndex,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

HEAD: Final = 9
FIXED: Final = frozenset({Opcode.MESSAGE, Opcode.DATA_END, Opcode.FOOTER})
"""What the specification says will not be extended: the data of a message go on to its end, and
the end of the data and the footer are found by their sizes."""

_KINDS: Final[dict[int, Any]] = {
    Opcode.CHUNK: Chunk,
    Opcode.MESSAGE_INDEX: MessageIndex,
    Opcode.CHUNK_INDEX: ChunkIndex,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex,
    Opcode.METADATA_INDEX: MetadataIndex,
    Opcode.SUMMARY_OFFSET: SummaryOffset,
    Opcode.DATA_END: DataEnd,
    Opcode.FOOTER: Footer,
}
_PACK: Final[dict[str, Callable[[bytes], bytes]]] = {
    "": bytes,
    "lz4": lz4.frame.compress,
    "zstd": zstandard.compress,
}
_UNPACK: Final[dict[str, Callable[[bytes], bytes]]] = {
    "": bytes,
    "lz4": lz4.frame.decompress,
    "zstd": zstandard.decompress,
}


def pad_file(data: bytes, padding: bytes, *, fixed: Collection[int] = FIXED) -> bytes:
    """Return a sound file with padding in every record; places, lengths and checksums follow.

    Args:
        data: The file.
        padding: What every record ends in.
        fixed: Kinds of records, by opcode, that get none.
    """
    return _Padder(data, padding, fixed).pad()


def split_records(data: bytes, start: int, end: int) -> list[tuple[int, int, bytes]]:
    """Return opcode, place and body of each."""
    records, place = [], start
    while place < end:
        opcode, length = struct.unpack_from("<BQ", data, place)
        records.append((opcode, place, data[place + HEAD : place + HEAD + length]))
        place += HEAD + length
    return records


class _Padder:
    def __init__(self, data: bytes, padding: bytes, fixed: Collection[int]) -> None:
        self._data, self._padding, self._fixed = data, padding, fixed
        self._output = bytearray(MCAP0_MAGIC)
        self._places: dict[int, int] = {0: 0}  # in the twin, by place in the file
        self._sizes: dict[int, tuple[int, int]] = {}  # of a chunk's data in the twin, by its place
        self._within: dict[int, int] = {}  # places within the chunk that was padded last

    def pad(self) -> bytes:
        for opcode, place, body in split_records(
            self._data, len(MCAP0_MAGIC), len(self._data) - len(MCAP0_MAGIC)
        ):
            self._places[place] = len(self._output)
            self._output += self._pad_record(opcode, self._rewrite(opcode, place, body))
        return bytes(self._output) + MCAP0_MAGIC

    def _pad_record(self, opcode: int, body: bytes) -> bytes:
        return make_record(opcode, body + (b"" if opcode in self._fixed else self._padding))

    def _rewrite(self, opcode: int, place: int, body: bytes) -> bytes:
        """Return the body of a record as it must be in the twin, not yet padded."""
        rewriters: dict[int, Callable[[Any, int], Any]] = {
            Opcode.CHUNK: self._rewrite_chunk,
            Opcode.MESSAGE_INDEX: self._rewrite_index,
            Opcode.CHUNK_INDEX: self._rewrite_chunk_index,
            Opcode.ATTACHMENT_INDEX: self._rewrite_place,
            Opcode.METADATA_INDEX: self._rewrite_place,
            Opcode.SUMMARY_OFFSET: self._rewrite_offset,
            Opcode.DATA_END: self._rewrite_data_end,
            Opcode.FOOTER: self._rewrite_footer,
        }
        if opcode not in rewriters:
            return body
        record = _KINDS[opcode].read(ReadDataStream(BytesIO(body)))
        return build(rewriters[opcode](record, place))

    def _move(self, start: int, length: int) -> tuple[int, int]:
        return self._places[start], self._places[start + length]

    def _rewrite_chunk(self, chunk: Chunk, place: int) -> Chunk:
        unpacked = _UNPACK[chunk.compression](chunk.data)
        records, self._within = bytearray(), {}
        for opcode, at, body in split_records(unpacked, 0, len(unpacked)):
            self._within[at] = len(records)
            records += self._pad_record(opcode, body)
        packed = _PACK[chunk.compression](bytes(records))
        self._sizes[place] = len(packed), len(records)
        return replace(
            chunk,
            uncompressed_size=len(records),
            uncompressed_crc=zlib.crc32(records) if chunk.uncompressed_crc else 0,
            data=packed,
        )

    def _rewrite_index(self, index: MessageIndex, _: int) -> MessageIndex:
        return replace(index, records=[(time, self._within[at]) for time, at in index.records])

    def _rewrite_chunk_index(self, index: ChunkIndex, _: int) -> ChunkIndex:
        start, end = self._move(index.chunk_start_offset, index.chunk_length)
        old_end = index.chunk_start_offset + index.chunk_length
        _, indexes_end = self._move(old_end, index.message_index_length)
        packed, unpacked = self._sizes[index.chunk_start_offset]
        return replace(
            index,
            chunk_start_offset=start,
            chunk_length=end - start,
            message_index_offsets={
                channel: self._places[at] for channel, at in index.message_index_offsets.items()
            },
            message_index_length=indexes_end - end,
            compressed_size=packed,
            uncompressed_size=unpacked,
        )

    def _rewrite_place(self, index: Any, _: int) -> Any:
        start, end = self._move(index.offset, index.length)
        return replace(index, offset=start, length=end - start)

    def _rewrite_offset(self, offset: SummaryOffset, _: int) -> SummaryOffset:
        start, end = self._move(offset.group_start, offset.group_length)
        return replace(offset, group_start=start, group_length=end - start)

    def _rewrite_data_end(self, end: DataEnd, _: int) -> DataEnd:
        return DataEnd(zlib.crc32(self._output) if end.data_section_crc else 0)

    def _rewrite_footer(self, footer: Footer, place: int) -> Footer:
        footer = replace(
            footer,
            summary_start=self._places[footer.summary_start],
            summary_offset_start=self._places[footer.summary_offset_start],
        )
        if not footer.summary_crc:
            return footer
        # The checksum covers the summary, and the footer up to itself.
        before = make_record(Opcode.FOOTER, build(footer))[:-4]
        start = footer.summary_start or self._places[place]
        return replace(footer, summary_crc=zlib.crc32(self._output[start:] + before))


def make_record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def build(record: Any) -> bytes:
    """Return the body of a record."""
    builder = RecordBuilder()
    record.write(builder)
    written: bytes = builder.end()  # type: ignore[no-untyped-call]
    return written[HEAD:]
