"""Large files for benchmarks: the chunks of a small one, many times."""

import struct
import zlib
from dataclasses import replace
from pathlib import Path

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import ChunkIndex, DataEnd
from mcap.writer import MCAP0_MAGIC


def write_large_file(path: Path, small: Path, size: int) -> int:
    """Write a file of `size` bytes by repeating the chunks of a small one; return its messages."""
    with small.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        first, last = summary.chunk_indexes[0], summary.chunk_indexes[-1]
        start = first.chunk_start_offset
        end = last.chunk_start_offset + last.chunk_length + last.message_index_length
        stream.seek(0)
        head, chunks = stream.read(start), stream.read(end - start)
    repeats = -(-size // len(chunks))
    builder = RecordBuilder()
    with path.open("wb") as output:
        output.write(head)
        for _ in range(repeats):
            output.write(chunks)
        DataEnd(data_section_crc=0).write(builder)
        output.write(builder.end())  # type: ignore[no-untyped-call]
        summary_start = output.tell()
        for record in (*summary.schemas.values(), *summary.channels.values()):
            record.write(builder)
        counts = summary.statistics.channel_message_counts
        replace(
            summary.statistics,
            message_count=summary.statistics.message_count * repeats,
            chunk_count=len(summary.chunk_indexes) * repeats,
            channel_message_counts={number: count * repeats for number, count in counts.items()},
        ).write(builder)
        for number in range(repeats):
            for index in summary.chunk_indexes:
                shift_index(index, number * len(chunks)).write(builder)
        summary_bytes = builder.end()  # type: ignore[no-untyped-call]
        output.write(finish_summary(summary_bytes, summary_start))
    return summary.statistics.message_count * repeats


def shift_index(index: ChunkIndex, by: int) -> ChunkIndex:
    """Return the index of the same chunk so many bytes later."""
    offsets = {channel: place + by for channel, place in index.message_index_offsets.items()}
    start = index.chunk_start_offset + by
    return replace(index, chunk_start_offset=start, message_index_offsets=offsets)


def finish_summary(summary: bytes, start: int) -> bytes:
    """Return a summary with its footer, its checksum and the magic bytes."""
    front = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, 0)
    checksum = zlib.crc32(summary + front)
    return summary + front + struct.pack("<I", checksum) + MCAP0_MAGIC
