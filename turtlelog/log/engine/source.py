"""An MCAP file: its ends and summary, and its chunks by the index or record by record."""

import io
import os
import struct
import zlib
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, BinaryIO, Final, TypeVar

import numpy as np
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, MetadataIndex, Schema, Statistics

from turtlelog.errors import LogError, describe_error
from turtlelog.files.urls import expect_reads
from turtlelog.log.engine import records
from turtlelog.log.engine.blocks import (
    Block,
    ChunkEntry,
    build_indexed_block,
    build_walked_block,
    count_indexed,
    walk_through,
)
from turtlelog.log.engine.channels import Catalogue
from turtlelog.log.engine.decode import EVER
from turtlelog.log.engine.limits import CHUNKS, DESCRIPTIONS, NOTES, Allowance, measure_stored
from turtlelog.log.engine.records import RECORD, Place
from turtlelog.log.file_access import MCAP0_MAGIC, DamageError, UnfinishedError, check_start

if TYPE_CHECKING:
    from concurrent.futures import Future


T = TypeVar("T")
J = TypeVar("J")

_Job = tuple[ChunkEntry, bytes, Mapping[str, int]]

_THREADS: Final = min(os.cpu_count() or 1, 4)
_AHEAD: Final = 2**25  # bytes of chunks that are unpacked before they are needed


_FOOTER: Final = struct.Struct("<BQQQI")  # opcode, length, summary, summary offsets, crc
_DATA_END: Final = struct.Struct("<BQI")  # opcode, length, crc
_STEP: Final = 2**20  # bytes

_TIMES: Final = struct.Struct("<QQQQI")  # start, end, place, length, size of the offsets
_OFFSET: Final = np.dtype([("channel", "<u2"), ("offset", "<u8")])
_SIZES: Final = struct.Struct("<QI")  # size of the message indexes, of the compression's name

_ALONE: Final = frozenset({Opcode.HEADER, Opcode.ATTACHMENT, Opcode.METADATA})
"""Kinds of records that are read from between the chunks of a file with an index."""

_KINDS: Final[Mapping[int, str]] = {
    Opcode.CHUNK_INDEX: CHUNKS,
    Opcode.SCHEMA: DESCRIPTIONS,
    Opcode.CHANNEL: DESCRIPTIONS,
    Opcode.STATISTICS: NOTES,
    Opcode.METADATA_INDEX: NOTES,
    Opcode.ATTACHMENT_INDEX: NOTES,
    Opcode.HEADER: NOTES,
    Opcode.METADATA: NOTES,
    Opcode.ATTACHMENT: NOTES,
}
"""Limit that a record in the summary, or outside chunks, counts against."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FileSummary:
    """Contents of the summary section.

    Attributes:
        schemas: Schemas in order.
        channels: Channels in order.
        chunks: Chunks in the order of the file.
        statistics: Statistics record; None if the file has none.
        named: Opcode and name of each metadata record and attachment, by offset in the file.
        described: Schemas and channels by their bytes, including the opcode; chunks repeat them.
    """

    schemas: tuple[Schema, ...]
    channels: tuple[Channel, ...]
    chunks: tuple[ChunkEntry, ...]
    statistics: Statistics | None
    named: Mapping[int, tuple[int, str]]
    described: Mapping[bytes, Schema | Channel]


class Source:
    """An open MCAP file with checked ends and summary.

    Attributes:
        catalogue: Channels and schemas; without an index, of the blocks that were read.
        is_indexed: Whether the summary indexes the complete file.
        statistics: Statistics record; None if the file has none.
        summary_start: Offset of the summary [bytes]; of the footer if the summary is empty.
        allowance: Remaining limits of the file.
        size: Size of the file [bytes].
    """

    def __init__(self, stream: BinaryIO) -> None:
        """Check the ends and the summary.

        Raises:
            LogError: If the file is not MCAP.
            DamageError: If the file is truncated, or its summary is damaged.
        """
        check_start(stream)
        self._stream = stream
        footer, self.summary_start, checksum = _read_footer(stream)
        self._data_end, self._data_crc = _read_data_end(stream, self.summary_start)
        data = _read_summary(stream, footer, self.summary_start, checksum)
        self.size = stream.seek(0, os.SEEK_END)
        self.allowance = Allowance(measure_stored(stream))
        summary = _parse_summary(data, self.summary_start, self.allowance)
        self.catalogue = Catalogue(self.allowance)
        self.catalogue.add((*summary.schemas, *summary.channels), self.summary_start)
        lone = _find_lone_records(stream, self._data_end, summary, self.allowance)
        self.statistics, self.is_indexed = summary.statistics, lone is not None
        self._lone, self._summary = lone or (), summary

    def read_lone(self, opcodes: Collection[int]) -> Iterator[Any]:
        """Yield the records of several rare kinds outside chunks; none if the file has no index."""
        named = self._summary.named if self.is_indexed else {}
        named = {byte: of for byte, of in named.items() if of[0] in opcodes}
        for place in self._lone:
            if place.opcode not in opcodes:
                continue
            record, byte = records.read_record(self._stream, place), place.start - RECORD.size
            # Metadata has no checksum; the summary has one, and shows which metadata must exist.
            found = place.opcode, getattr(record, "name", "")
            if named.pop(byte, found) != found:
                raise DamageError(f"byte {byte}: expected what the summary names, found {found[1]}")
            yield record
        for byte, (_, name) in named.items():
            raise DamageError(f"byte {byte}: not the record named {name}")

    @property
    def index_length(self) -> int:
        """The total size of all message indexes [bytes]."""
        return sum(entry.index_length for entry in self._summary.chunks)

    def check_data(self) -> None:
        """Check the checksum of the whole data section, in one pass over the file."""
        expecting = f"byte {self._data_end}: expected data"
        check_sum(self._stream, 0, self._data_end, self._data_crc, expecting)

    def map_blocks(
        self,
        work: Callable[[Block], T],
        channels: Collection[int] | None = None,
        start_ns: int = 0,
        end_ns: int = EVER,
    ) -> Iterator[T]:
        """Yield the result of `work` for each block, in file order.

        With an index, threads process the chunks that contain one of the channels and overlap the
        time interval. Without an index all blocks are processed, and the checksum of all data is
        checked at the end.
        """
        if not self.is_indexed:
            yield from map(work, self._walk_blocks())
            return
        wanted = [
            entry
            for entry in self._summary.chunks
            if (channels is None or not entry.channels.isdisjoint(channels))
            and entry.start_ns < end_ns
            and entry.end_ns >= start_ns
        ]

        def build(job: _Job) -> T:
            entry, stored, before = job
            block = build_indexed_block(
                entry, stored, self._summary.described, self.allowance.largest_chunk
            )
            self.catalogue.check(block.rest, block.byte)
            return work(replace(block, before=before))

        expect_reads(self._stream, ((entry.start, entry.end) for entry in wanted))
        jobs = self._read_chunks(wanted)
        # Starting threads takes longer than reading one chunk.
        if len(wanted) <= 1:
            yield from map(build, jobs)
        else:
            yield from map_ahead(build, jobs, lambda job: job[0].size + job[0].length, _AHEAD)

    def _walk_blocks(self) -> Iterator[Block]:
        counts: Counter[str] = Counter()
        known = self.catalogue.channels
        for block in walk_through(self._stream, partial(build_walked_block, self.catalogue)):
            yield replace(block, before=dict(counts))
            for channel, starts in block.offsets.items():
                if channel in known:
                    counts[known[channel].topic] += len(starts)

    def _read_chunks(self, entries: Iterable[ChunkEntry]) -> Iterator[_Job]:
        counts: Counter[str] = Counter()
        known = self.catalogue.channels
        for entry in entries:
            self._stream.seek(entry.start)
            stored = self._stream.read(entry.length + entry.index_length)
            yield entry, stored, dict(counts)
            for channel, count in count_indexed(memoryview(stored)[entry.length :]):
                if channel in known:
                    counts[known[channel].topic] += count


def map_ahead(
    work: Callable[[J], T],
    jobs: Iterable[J],
    measure: Callable[[J], int],
    most: int,
    threads: int = _THREADS,
) -> Iterator[T]:
    """Yield results in order. Threads compute them ahead, up to a total size `most`."""
    from concurrent.futures import ThreadPoolExecutor  # 8 ms that a file with one chunk saves

    waiting: deque[tuple[int, Future[T]]] = deque()
    ahead = 0  # total size that is computed ahead
    with ThreadPoolExecutor(threads) as pool:
        try:
            for job in jobs:
                size = measure(job)
                while waiting and (ahead + size > most or len(waiting) > 4 * threads):
                    done, future = waiting.popleft()
                    ahead -= done
                    yield future.result()
                waiting.append((size, pool.submit(work, job)))
                ahead += size
            while waiting:
                yield waiting.popleft()[1].result()
        finally:
            for _, future in waiting:
                future.cancel()


def check_sum(stream: BinaryIO, start: int, end: int, expected: int, expecting: str) -> None:
    """Check a part of a file step by step, if it has a checksum; `expecting` begins the error."""
    if not expected:
        return
    stream.seek(start)
    found, buffer = 0, memoryview(bytearray(min(_STEP, max(end - start, 0))))
    while start < end:
        count = stream.readinto(buffer[: end - start])  # type: ignore[attr-defined]
        if not count:
            break  # the file became shorter; the checksum will differ
        found = zlib.crc32(buffer[:count], found)
        start += count
    if found != expected:
        raise DamageError(f"{expecting} of checksum {expected:#010x}, found {found:#010x}")


def _read_footer(stream: BinaryIO) -> tuple[int, int, int]:
    """Return the offsets of footer and summary, and the summary's checksum (0: none)."""
    size = stream.seek(0, io.SEEK_END)
    place = size - _FOOTER.size - len(MCAP0_MAGIC)
    stream.seek(max(place, 0))
    footer, end = stream.read(_FOOTER.size), stream.read()
    if place < len(MCAP0_MAGIC) or end != MCAP0_MAGIC:
        raise UnfinishedError(f"truncated or unfinished (no end of an MCAP file at byte {size})")
    opcode, length, start, _, checksum = _FOOTER.unpack(footer)
    if opcode != Opcode.FOOTER or length != 20 or start > place:
        raise DamageError(f"byte {place}: expected a footer, found 0x{footer.hex()}")
    return place, start or place, checksum


def _read_summary(stream: BinaryIO, footer: int, start: int, expected: int) -> bytes:
    end = footer + _FOOTER.size - 4  # the checksum covers the footer up to itself
    # Checked before anything is read: a damaged footer may claim that the whole file is summary.
    check_sum(stream, start, end, expected, f"byte {start}: expected a summary")
    stream.seek(start)
    return stream.read(footer - start)


def _read_data_end(stream: BinaryIO, summary_start: int) -> tuple[int, int]:
    place = max(summary_start - _DATA_END.size, 0)
    stream.seek(place)
    record = stream.read(_DATA_END.size)
    if len(record) < _DATA_END.size or _DATA_END.unpack(record)[:2] != (Opcode.DATA_END, 4):
        raise DamageError(f"byte {place}: expected the end of the data, found 0x{record.hex()}")
    return place, int(_DATA_END.unpack(record)[2])


def _parse_summary(data: bytes, byte: int, allowance: Allowance) -> FileSummary:
    """Return the contents of the summary section; `byte` is its offset in the file."""
    chunks: list[ChunkEntry] = []
    statistics, named = None, dict[int, tuple[int, str]]()
    described: dict[bytes, Schema | Channel] = {}
    for place in records.iterate_places(data, 0, len(data), byte):
        _spend(allowance, place.opcode, byte + place.start)
        if place.opcode == Opcode.CHUNK_INDEX:
            chunks.append(_parse_entry(data, place, byte))
            continue
        found = records.parse_record(place, data[place.start : place.end], byte + place.start)
        if isinstance(found, Schema | Channel):
            described[records.take_whole(data, place)] = found
        elif isinstance(found, Statistics):
            statistics = found
        elif isinstance(found, MetadataIndex):
            named[found.offset] = Opcode.METADATA, found.name
        elif isinstance(found, AttachmentIndex):
            named[found.offset] = Opcode.ATTACHMENT, found.name
    return FileSummary(
        schemas=tuple(found for found in described.values() if isinstance(found, Schema)),
        channels=tuple(found for found in described.values() if isinstance(found, Channel)),
        chunks=tuple(sorted(chunks, key=lambda entry: entry.start)),
        statistics=statistics,
        named=named,
        described=described,
    )


def _spend(allowance: Allowance, opcode: int, byte: int) -> None:
    kind = _KINDS.get(opcode)
    try:
        if kind is not None:
            allowance.spend(kind)
    except LogError as err:
        raise DamageError(f"byte {byte}: {err}") from err


def _find_lone_records(
    stream: BinaryIO, data_end: int, summary: FileSummary, allowance: Allowance
) -> tuple[Place, ...] | None:
    """Return the records between the chunks; None if the index is incomplete.

    A complete index has all chunks and messages, and only known channels and schemas.
    """
    schemas = {0, *(schema.id for schema in summary.schemas)}  # 0: a channel without a schema
    known = {channel.id for channel in summary.channels if channel.schema_id in schemas}
    lone: list[Place] = []
    start = len(MCAP0_MAGIC)
    for entry in (*summary.chunks, None):
        end = data_end if entry is None else entry.start
        if entry and not (entry.channels and entry.index_length and entry.channels <= known):
            return None
        places = _find_between(stream, start, end, allowance)
        if places is None:
            return None
        lone += places
        start = end if entry is None else entry.end
    return tuple(lone)


def _find_between(
    stream: BinaryIO, start: int, end: int, allowance: Allowance
) -> list[Place] | None:
    found = []
    while start < end:
        stream.seek(start)
        heading = stream.read(RECORD.size)
        if len(heading) < RECORD.size:
            return None
        opcode, length = RECORD.unpack(heading)
        if opcode in {0, Opcode.CHUNK, Opcode.MESSAGE}:
            return None
        _spend(allowance, opcode, start)
        if opcode in _ALONE:
            found.append(Place(opcode, start + RECORD.size, length))
        start += RECORD.size + length
    return found if start == end else None


def _parse_entry(data: bytes, place: Place, byte: int) -> ChunkEntry:
    body = data[place.start : place.end]
    try:
        start_ns, end_ns, start, length, offsets_size = _TIMES.unpack_from(body)
        after = _TIMES.size + offsets_size
        count = offsets_size // _OFFSET.itemsize
        offsets = np.frombuffer(body[_TIMES.size : after], _OFFSET, count)
        index_length, name_length = _SIZES.unpack_from(body, after)
        (size,) = struct.unpack_from("<Q", body, after + 20 + name_length)
    except (struct.error, ValueError) as err:
        expected = f"byte {byte + place.start}: expected the index of a chunk"
        raise DamageError(f"{expected}, found {describe_error(err)}") from err
    return ChunkEntry(
        start=start,
        length=length,
        index_length=index_length,
        start_ns=start_ns,
        end_ns=end_ns,
        channels=frozenset(offsets["channel"].tolist()),
        size=size,
    )


def salvage_summary(stream: BinaryIO) -> FileSummary | None:
    """Return the last record of each id in the summary; None if its end or checksum is wrong."""
    try:
        place, start, checksum = _read_footer(stream)
        if not checksum:  # without a checksum only this confirms the start
            _read_data_end(stream, start)
        data = _read_summary(stream, place, start, checksum)
        summary = _parse_summary(data, start, Allowance(measure_stored(stream)))
    except DamageError:
        return None
    schemas = {schema.id: schema for schema in summary.schemas}
    channels = {channel.id: channel for channel in summary.channels}
    return replace(summary, schemas=tuple(schemas.values()), channels=tuple(channels.values()))
