"""Every index of a finished MCAP file held against the bytes that it points at."""

import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import zstandard
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import ChunkIndex, SummaryOffset
from mcap.stream_reader import StreamReader
from mcap.summary import Summary


def check_strictly(path: Path) -> Summary:
    """Return the summary of a file in which every offset, length, count and checksum is right."""
    data = path.read_bytes()
    with path.open("rb") as stream:
        summary = make_reader(stream, validate_crcs=True).get_summary()
    with path.open("rb") as stream:
        records = [*StreamReader(stream, validate_crcs=True).records]
    assert summary is not None
    counts: Counter[int] = Counter()
    for chunk in summary.chunk_indexes:
        counts += check_chunk(data, chunk)
    check_statistics(summary, counts)
    for metadata in summary.metadata_indexes:
        check_place(data, Opcode.METADATA, metadata.offset, metadata.length, metadata.name)
    for file in summary.attachment_indexes:
        check_place(data, Opcode.ATTACHMENT, file.offset, file.length, file.name)
    check_summary(data, [record for record in records if isinstance(record, SummaryOffset)])
    return summary


def check_place(data: bytes, opcode: int, place: int, length: int, name: str) -> None:
    assert struct.unpack_from("<BQ", data, place) == (opcode, length - 9)
    assert name.encode() in data[place : place + length]


def check_chunk(data: bytes, index: ChunkIndex) -> Counter[int]:
    """Return how many messages of each channel a chunk holds; its index points at all of them."""
    start, head = index.chunk_start_offset, struct.Struct("<BQQQQII4sQ")
    opcode, length, start_ns, end_ns, size, checksum, _, kind, packed_size = head.unpack_from(
        data, start
    )
    assert (opcode, length + 9, kind) == (Opcode.CHUNK, index.chunk_length, b"zstd")
    assert (size, packed_size) == (index.uncompressed_size, index.compressed_size)
    end = start + index.chunk_length
    assert head.size + packed_size == index.chunk_length
    inner = zstandard.decompress(data[start + head.size : end])
    assert (len(inner), zlib.crc32(inner)) == (size, checksum)
    messages = dict(walk_messages(inner))
    entries = dict(walk_indexes(data, index))
    assert entries == messages
    times = [time_ns for _, time_ns in messages.values()]
    assert (min(times), max(times)) == (start_ns, end_ns)
    assert (start_ns, end_ns) == (index.message_start_time, index.message_end_time)
    return Counter(channel for channel, _ in messages.values())


def walk_messages(inner: bytes) -> Iterator[tuple[int, tuple[int, int]]]:
    """Yield place, channel and log time of a chunk's messages; their channels come before them."""
    place, known = 0, set()
    while place < len(inner):
        opcode, length = struct.unpack_from("<BQ", inner, place)
        [number] = struct.unpack_from("<H", inner, place + 9)
        if opcode == Opcode.CHANNEL:
            known.add(number)
        elif opcode == Opcode.MESSAGE:
            assert number in known
            [time_ns] = struct.unpack_from("<Q", inner, place + 15)
            yield place, (number, time_ns)
        else:
            assert opcode == Opcode.SCHEMA
        place += 9 + length
    assert place == len(inner)


def walk_indexes(data: bytes, index: ChunkIndex) -> Iterator[tuple[int, tuple[int, int]]]:
    """Yield the same from the message indexes, which stand behind the chunk without a gap."""
    place = index.chunk_start_offset + index.chunk_length
    for channel, offset in index.message_index_offsets.items():
        assert offset == place
        opcode, length, number, size = struct.unpack_from("<BQHI", data, place)
        assert (opcode, number, length) == (Opcode.MESSAGE_INDEX, channel, 6 + size)
        entries = struct.iter_unpack("<QQ", data[place + 15 : place + 15 + size])
        yield from ((offset, (channel, time_ns)) for time_ns, offset in entries)
        place += 9 + length
    assert place - index.chunk_start_offset - index.chunk_length == index.message_index_length


def check_statistics(summary: Summary, counts: Counter[int]) -> None:
    statistics = summary.statistics
    assert statistics is not None
    assert statistics.channel_message_counts == counts
    assert statistics.message_count == counts.total()
    assert statistics.chunk_count == len(summary.chunk_indexes)
    assert statistics.channel_count == len(summary.channels)
    assert statistics.schema_count == len(summary.schemas)
    assert statistics.metadata_count == len(summary.metadata_indexes)
    assert statistics.attachment_count == len(summary.attachment_indexes)
    starts = [chunk.message_start_time for chunk in summary.chunk_indexes]
    ends = [chunk.message_end_time for chunk in summary.chunk_indexes]
    times = statistics.message_start_time, statistics.message_end_time
    assert times == (min(starts, default=0), max(ends, default=0))


def check_summary(data: bytes, offsets: list[SummaryOffset]) -> None:
    """Check that groups follow each other without a gap, and the summary's checksum."""
    opcode, _, start, offset_start, checksum = struct.unpack("<BQQQI", data[-37:-8])
    assert opcode == Opcode.FOOTER
    assert checksum == zlib.crc32(data[start:-12])
    place = start
    for group in offsets:
        assert (group.group_start, group.group_length > 0) == (place, True)
        while place < group.group_start + group.group_length:
            opcode, length = struct.unpack_from("<BQ", data, place)
            assert opcode == group.group_opcode
            place += 9 + length
    assert place == offset_start
