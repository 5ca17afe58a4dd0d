"""Blocks: segments of records in memory, with the offsets of each channel's messages.

In a file with an index, a block is a chunk and the message indexes give the offsets. The indexes
have no checksum and are checked against the chunk: its records must fill it without gap or overlap.
Otherwise the record headers are read one by one.
"""

import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, BinaryIO, Final, TypeVar

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from turtlelog.errors import LogError, describe_error
from turtlelog.log.engine import limits, records
from turtlelog.log.engine.channels import Catalogue
from turtlelog.log.engine.message_types import Column
from turtlelog.log.engine.records import RECORD, Place, parse_record
from turtlelog.log.engine.walk import CHUNK_HEAD, Section, walk_sections
from turtlelog.log.file_access import DamageError, LimitError, Loss, check_start

T = TypeVar("T")
Offsets = NDArray[np.int64]

_NOTES: Final = frozenset({Opcode.METADATA, Opcode.ATTACHMENT})
_SLOT: Final = 4  # bits of an offset: no two messages start within 16 bytes
_WITHIN: Final = 15
_UNMARKED: Final = 255
_SIZE: Final = struct.Struct("<Q")
_INDEX: Final = struct.Struct("<HI")  # channel, size of the pairs of log time and offset [bytes]


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """Records in memory.

    Attributes:
        data: Bytes of the records.
        byte: Offset in the file of the first record, or of the chunk that contains it.
        offsets: Start of each message by channel, shape (n,), increasing.
        rest: Other records in order: schemas and channels; outside chunks also headers and notes.
        before: Number of messages by topic in earlier chunks that are read; None without counting.
        unit: Unit of `byte`, if it is not bytes.
    """

    data: bytes
    byte: int
    offsets: Mapping[int, Offsets]
    rest: tuple[Any, ...]
    before: Mapping[str, int] | None = None
    unit: str = "byte"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChannelRecords:
    """The message records of one channel, in order of log time.

    Attributes:
        schema: Schema of the channel.
        channel: Channel of the records.
        log_time_ns: Log time of each record [ns], shape (n,), not decreasing.
        data: The records one after the other, shape (bytes,).
        sizes: Size of each record [bytes], shape (n,).
        ends: End of each record in `data` [bytes], shape (n,).
    """

    schema: Schema
    channel: Channel
    log_time_ns: Offsets
    data: NDArray[np.uint8]
    sizes: Offsets
    ends: Offsets


def fit_numbers(name: str, values: Column, kind: str) -> Column:
    """Return numbers of a kind. Integers must fit; floats beyond 32 bits become inf."""
    target, is_whole = np.dtype(kind), values.dtype.kind in "iub"
    if not is_whole and (values.dtype.kind != "f" or target.kind != "f"):
        expected = "numbers" if target.kind == "f" else "whole numbers"
        raise LogError(f"{name}: expected {expected}, found {values.dtype}")
    if target.kind != "f" and values.size:
        limits = np.iinfo(target)
        for value in (int(values.min()), int(values.max())):
            if not limits.min <= value <= limits.max:
                raise LogError(
                    f"{name}: expected values from {limits.min} to {limits.max}, found {value}"
                )
    with np.errstate(over="ignore"):
        return values.astype(target, copy=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class ChunkRows:
    """The messages of one chunk.

    Attributes:
        channels: Channels of the messages, with their schemas, if any.
        records: Message records, one after the other.
        index: By channel number: log time [ns] and offset of each message, shape (n, 2).
    """

    channels: Sequence[tuple[Schema | None, Channel]]
    records: bytes | bytearray | memoryview
    index: Mapping[int, NDArray[np.uint64]]

    @property
    def span_ns(self) -> tuple[int, int]:
        """Least and greatest log time [ns]."""
        times = [entries[:, 0] for entries in self.index.values()]
        return min(int(of.min()) for of in times), max(int(of.max()) for of in times)


def read_heads(block: Block) -> tuple[NDArray[np.uint16], NDArray[np.uint64]]:
    """Return channel and log time [ns] of the messages in a block, in the order of storage."""
    starts = np.sort(np.concatenate([np.empty(0, np.int64), *block.offsets.values()]))
    heads = records.gather_heads(block.data, starts)
    return heads["channel"], heads["log_time"]


def build_indexed_block(
    entry: ChunkEntry,
    stored: bytes,
    described: Mapping[bytes, Any],
    largest: int = limits.LARGEST_CHUNK,
) -> Block:
    """Return a chunk with its indexes as a block; records in `described` are not parsed again."""
    byte = entry.start
    opcode, length = RECORD.unpack_from(stored) if len(stored) > RECORD.size else (0, 0)
    if opcode != Opcode.CHUNK or RECORD.size + length != entry.length:
        raise DamageError(
            f"byte {byte}: expected a chunk of {entry.length} bytes,"
            f" found opcode {opcode} with {RECORD.size + length}"
        )
    body = memoryview(stored)[RECORD.size : entry.length]
    data = _open_chunk(entry, body, largest)
    offsets = _parse_indexes(memoryview(stored)[entry.length :], byte + entry.length)
    places = _check_tiling(data, offsets, byte)
    rest = tuple(
        described.get(records.take_whole(data, place))
        or parse_record(place, data[place.start : place.end], byte)
        for place in places
        if place.opcode in records.OF_CHUNKS
    )
    return Block(data=data, byte=byte, offsets=offsets, rest=rest)


def _open_chunk(entry: ChunkEntry, body: memoryview, largest: int) -> bytes:
    """Return the unpacked records of a chunk, after a check of its header and checksum."""
    byte = entry.start
    try:
        start_ns, end_ns, size, crc, length = CHUNK_HEAD.unpack_from(body)
        data_start = CHUNK_HEAD.size + length + _SIZE.size
        (data_size,) = _SIZE.unpack_from(body, data_start - _SIZE.size)
        compression = bytes(body[CHUNK_HEAD.size : CHUNK_HEAD.size + length]).decode()
    except (struct.error, ValueError) as err:
        raise DamageError(f"byte {byte}: expected a chunk, found {describe_error(err)}") from err
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
    try:
        data = limits.unpack_chunk(compression, body[data_start : data_start + data_size], size)
    except LogError as err:
        raise DamageError(f"byte {byte}: chunk: {err}") from err
    if len(data) != size:
        raise DamageError(f"byte {byte}: chunk: expected {size} bytes, found {len(data)}")
    if crc and crc != (found_crc := zlib.crc32(data)):
        raise DamageError(
            f"byte {byte}: chunk: expected checksum {crc:#010x}, found {found_crc:#010x}"
        )
    return data


def build_walked_block(catalogue: Catalogue, section: Section) -> Block:
    """Return records as a block by reading their headers, and add them to the catalogue."""
    stretch = take_walked(section, catalogue.allowance)
    numbers = [heads["channel"] for _, heads in stretch.iterate_rows()]
    offsets = group_starts(np.concatenate(numbers), stretch.starts) if numbers else {}
    rest = parse_others(stretch, section.start)
    catalogue.add(rest, section.start)
    return Block(data=section.data, byte=section.start, offsets=offsets, rest=rest)


def group_starts(channels: NDArray[Any], starts: NDArray[Any]) -> dict[int, Offsets]:
    """Return the starts of messages by channel, given the channel of each message in order."""
    order = np.argsort(channels, kind="stable")
    present, firsts = np.unique(channels[order], return_index=True)
    ordered, borders = starts[order].astype(np.int64), pairwise([*firsts.tolist(), len(starts)])
    return {
        channel: ordered[first:end]
        for channel, (first, end) in zip(present.tolist(), borders, strict=True)
    }


def walk_through(
    stream: BinaryIO, work: Callable[[Section], T], *, damages: list[Loss] | None = None
) -> Iterator[T]:
    """Yield the result of `work` for every section of a file, in file order."""
    check_start(stream)
    allowance = limits.Allowance(limits.measure_stored(stream))
    for section in walk_sections(stream):
        if isinstance(section, Loss):
            if damages is None:
                raise DamageError(f"byte {section.start}: {section.reason}")
            damages.append(section)
            continue
        try:
            found = work(section)
        except DamageError as err:
            if damages is None:
                raise
            is_last = isinstance(err, LimitError) or not allowance.count_left(limits.DAMAGES)
            end = stream.seek(0, 2) if is_last else section.start + len(section.data)
            reason = str(err).removeprefix(f"byte {section.start}: ")
            damages.append(Loss(start=section.start, end=end, reason=reason))
            if is_last:
                return
            allowance.spend(limits.DAMAGES)
            continue
        yield found


def take_walked(section: Section, allowance: limits.Allowance) -> records.RecordStretch:
    """Return the offsets of records that must all be valid."""
    left = allowance.count_left(limits.RECORDS)
    stretch = records.take_apart(section.data, is_chunk=section.is_chunk, most_records=left)
    try:
        allowance.spend(limits.RECORDS, stretch.records)
        notes = sum(opcode in _NOTES for _, opcode, _ in stretch.others)
        allowance.spend(limits.NOTES, notes)
        allowance.spend(limits.DESCRIPTIONS, len(stretch.others) - notes)
    except LogError as err:
        raise LimitError(f"byte {section.start}: {err}") from err
    if stretch.fault is not None:
        raise DamageError(f"byte {section.start}: {stretch.fault}")
    return stretch


def parse_others(stretch: records.RecordStretch, byte: int) -> tuple[Any, ...]:
    """Return all records of a segment that are not messages."""
    return tuple(
        parse_record(
            Place(opcode, start + RECORD.size, end - start - RECORD.size),
            stretch.data[start + RECORD.size : end],
            byte,
        )
        for start, opcode, end in stretch.others
    )


def count_indexed(data: memoryview) -> Iterator[tuple[int, int]]:
    """Yield channels and message counts from the message indexes of a chunk, unchecked."""
    place = 0
    while place + RECORD.size + _INDEX.size <= len(data):
        _, length = RECORD.unpack_from(data, place)
        channel, size = _INDEX.unpack_from(data, place + RECORD.size)
        yield channel, size // 16
        place += RECORD.size + length


def _parse_indexes(data: memoryview, byte: int) -> dict[int, Offsets]:
    """Return the start of each channel's messages, from the message indexes of a chunk."""
    offsets = {}
    for place in records.iterate_places(data, 0, len(data), byte):
        channel, size = _INDEX.unpack_from(data, place.start) if place.length >= 6 else (0, -1)
        if place.opcode != Opcode.MESSAGE_INDEX or size % 16 or size > place.length - 6:
            found = f"opcode {place.opcode} with {place.length}"
            raise DamageError(f"byte {byte}: expected a message index, found {found} bytes")
        pairs = np.frombuffer(data, "<u8", size // 8, place.start + _INDEX.size)
        found_offsets = pairs[1::2].astype(np.int64)
        if channel in offsets:
            raise DamageError(f"byte {byte}: expected one index of channel {channel}, found two")
        if len(found_offsets) > 1 and (found_offsets[1:] <= found_offsets[:-1]).any():
            # Sorted, because some writers order the index by time.
            found_offsets = np.sort(found_offsets)
        offsets[channel] = found_offsets
    return offsets


def _check_tiling(data: bytes, offsets: Mapping[int, Offsets], byte: int) -> list[Place]:
    """Return the places of a chunk's other records; messages must fill the rest without overlap.

    From 0 on, each record ends where another starts; if the lengths add up, none is left out.
    """
    starts = np.concatenate([np.empty(0, np.int64), *offsets.values()])
    counts = [len(found) for found in offsets.values()]
    ends = _check_messages(data, starts, np.repeat(np.array([*offsets], np.uint16), counts), byte)
    # A mark gives the start of a message within 16 bytes; all marks take a sixteenth of the chunk.
    marks = np.full((len(data) >> _SLOT) + 1, _UNMARKED, np.uint8)
    marks[starts >> _SLOT] = starts & _WITHIN
    marks[-1] = len(data) & _WITHIN
    gaps = ends[marks[ends >> _SLOT] != ends & _WITHIN].tolist()
    if marks[0]:
        gaps.append(0)
    rest, filled = list[Place](), int((ends - starts).sum())
    for gap in gaps:
        for place in records.iterate_places(data, gap, len(data), byte):
            if place.opcode == Opcode.MESSAGE:
                raise _mistrust(byte, f"a message at {gap} that is not in it")
            rest.append(place)
            filled += RECORD.size + place.length
            if marks[place.end >> _SLOT] == place.end & _WITHIN:
                break
        if filled > len(data):
            break
    if filled != len(data):
        raise _mistrust(byte, f"{filled} bytes of {len(data)}")
    return sorted(rest, key=lambda place: place.start)


def _check_messages(data: bytes, starts: Offsets, channels: NDArray[Any], byte: int) -> Offsets:
    """Return the ends of messages. Each must be a message of its channel within the chunk."""
    if not len(starts):
        return starts
    if starts.min() < 0 or starts.max() > len(data) - records.MESSAGE_HEAD:
        raise _mistrust(byte, f"offsets up to {starts.max()} in {len(data)} bytes")
    heads = records.gather_heads(data, starts)
    if (heads["opcode"] != Opcode.MESSAGE).any() or (heads["channel"] != channels).any():
        raise _mistrust(byte, "another record than a message of the channel")
    lengths = heads["length"]
    if lengths.min() < records.COUNTED_HEAD or lengths.max() > len(data):
        raise _mistrust(byte, f"messages of {lengths.min()} to {lengths.max()} bytes")
    ends = starts + lengths.astype(np.int64) + RECORD.size
    if ends.max() > len(data):
        raise _mistrust(byte, f"a message up to {ends.max()} of {len(data)} bytes")
    return ends


def _mistrust(byte: int, found: str) -> DamageError:
    return DamageError(f"byte {byte}: chunk: expected what its message index says, found {found}")
