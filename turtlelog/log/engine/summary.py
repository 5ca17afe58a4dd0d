"""The summary of a file: what is where, without reading it, whether its data are sound or not."""

import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace
from io import SEEK_END
from typing import BinaryIO, Final

import numpy as np
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, MetadataIndex, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

from turtlelog.errors import LogError, describe_error
from turtlelog.log.engine.chunks import ChunkEntry
from turtlelog.log.engine.framing import RECORD
from turtlelog.log.engine.integrity import DamageError, Ends, read_summary
from turtlelog.log.engine.limits import DESCRIPTIONS, NOTES, Allowance
from turtlelog.log.engine.parsing import Place, iterate_places, parse_record

_TIMES: Final = struct.Struct("<QQQQI")  # start, end, place, length, bytes of the offsets
_OFFSET: Final = np.dtype([("channel", "<u2"), ("offset", "<u8")])
_SIZES: Final = struct.Struct("<QI")  # length of the message indexes, of the compression's name

_ALONE: Final = frozenset({Opcode.HEADER, Opcode.ATTACHMENT, Opcode.METADATA})
"""What is read from between the chunks of a file that has an index."""

_KINDS: Final[Mapping[int, str]] = {
    Opcode.SCHEMA: DESCRIPTIONS,
    Opcode.CHANNEL: DESCRIPTIONS,
    Opcode.STATISTICS: NOTES,
    Opcode.METADATA_INDEX: NOTES,
    Opcode.ATTACHMENT_INDEX: NOTES,
    Opcode.HEADER: NOTES,
    Opcode.METADATA: NOTES,
    Opcode.ATTACHMENT: NOTES,
}
"""Under what a record of the summary, or one that stands alone, is counted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FileSummary:
    """What stands in the summary section.

    Attributes:
        schemas: In its order.
        channels: In its order.
        chunks: In the order of the file.
        statistics: None where there are none.
        named: Opcode and name of each metadata record and attachment, by its byte in the file.
    """

    schemas: tuple[Schema, ...]
    channels: tuple[Channel, ...]
    chunks: tuple[ChunkEntry, ...]
    statistics: Statistics | None
    named: Mapping[int, tuple[int, str]]


def parse_summary(data: bytes, byte: int, allowance: Allowance) -> FileSummary:
    """Return what the summary section says; `byte` is where it starts in the file.

    Raises:
        DamageError: Where a record in it makes no sense, or there are too many.
    """
    chunks: list[ChunkEntry] = []
    schemas: list[Schema] = []
    channels: list[Channel] = []
    statistics, named = None, dict[int, tuple[int, str]]()
    for place in iterate_places(data, 0, len(data), byte):
        if place.opcode == Opcode.CHUNK_INDEX:
            chunks.append(_parse_entry(data, place, byte))
            continue
        _spend(allowance, place.opcode, byte + place.start)
        found = parse_record(place, data[place.start : place.end], byte + place.start)
        if isinstance(found, Schema):
            schemas.append(found)
        elif isinstance(found, Channel):
            channels.append(found)
        elif isinstance(found, Statistics):
            statistics = found
        elif isinstance(found, MetadataIndex):
            named[found.offset] = Opcode.METADATA, found.name
        elif isinstance(found, AttachmentIndex):
            named[found.offset] = Opcode.ATTACHMENT, found.name
    return FileSummary(
        schemas=tuple(schemas),
        channels=tuple(channels),
        chunks=tuple(sorted(chunks, key=lambda entry: entry.start)),
        statistics=statistics,
        named=named,
    )


def _spend(allowance: Allowance, opcode: int, byte: int) -> None:
    kind = _KINDS.get(opcode)
    try:
        if kind is not None:
            allowance.spend(kind)
    except LogError as err:
        raise DamageError(f"byte {byte}: {err}") from err


def find_lone_records(
    stream: BinaryIO, ends: Ends, summary: FileSummary, allowance: Allowance
) -> tuple[Place, ...] | None:
    """Return the records that stand between the chunks; None where the index does not tell all.

    It tells all where what lies between the chunks that it names holds no message and no further
    chunk, and every chunk has message indexes, of channels that are known
    with their schemas.
    """
    schemas = {0, *(schema.id for schema in summary.schemas)}  # 0: a channel without one
    known = {channel.id for channel in summary.channels if channel.schema_id in schemas}
    lone: list[Place] = []
    start = len(MCAP0_MAGIC)
    for entry in (*summary.chunks, None):
        end = ends.data_end if entry is None else entry.start
        if entry is not None and not _is_indexed(entry, known):
            return None
        places = _find_between(stream, start, end, allowance)
        if places is None:
            return None
        lone += places
        start = end if entry is None else entry.end
    return tuple(lone)


def _is_indexed(entry: ChunkEntry, known: set[int]) -> bool:
    return bool(entry.channels and entry.index_length) and entry.channels <= known


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
        offsets = np.frombuffer(
            body[_TIMES.size : _TIMES.size + offsets_size],
            _OFFSET,
            offsets_size // _OFFSET.itemsize,
        )
        index_length, name_length = _SIZES.unpack_from(body, _TIMES.size + offsets_size)
        (size,) = struct.unpack_from("<Q", body, _TIMES.size + offsets_size + 20 + name_length)
    except (struct.error, ValueError) as err:
        found = describe_error(err)
        raise DamageError(
            f"byte {byte + place.start}: expected the index of a chunk, found {found}"
        ) from err
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
    """Return what the summary says, of each id the last; None if the end or its checksum fails."""
    try:
        start, data = read_summary(stream)
        summary = parse_summary(data, start, Allowance(stream.seek(0, SEEK_END)))
    except DamageError:
        return None
    schemas = {schema.id: schema for schema in summary.schemas}
    channels = {channel.id: channel for channel in summary.channels}
    return replace(summary, schemas=tuple(schemas.values()), channels=tuple(channels.values()))
