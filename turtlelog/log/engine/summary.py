"""The summary of a file: what is where, without reading it."""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, BinaryIO, Final

import numpy as np
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, MetadataIndex, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

from turtlelog.errors import describe_error
from turtlelog.log.engine.ends import DamageError, Ends, SummaryBytes
from turtlelog.log.engine.framing import RECORD
from turtlelog.log.engine.parsing import Place, iterate_places, parse_record

_TIMES: Final = struct.Struct("<QQQQI")  # start, end, place, length, bytes of the offsets
_OFFSET: Final = np.dtype([("channel", "<u2"), ("offset", "<u8")])
_SIZES: Final = struct.Struct("<QI")  # length of the message indexes, of the compression's name

_ALONE: Final = frozenset(
    {Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.ATTACHMENT, Opcode.METADATA}
)
"""What may stand between chunks of a file that is read by its index."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChunkEntry:
    """What the summary says of a chunk.

    Attributes:
        start: Byte in the file.
        length: Of its record [bytes].
        index_length: Of the message indexes behind it [bytes].
        start_ns: Least log time of its messages.
        end_ns: Greatest log time.
        channels: Ids of the channels of which it holds messages.
        size: Of the records in it, decompressed [bytes].
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
        """The byte behind its message indexes."""
        return self.start + self.length + self.index_length


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
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


def parse_summary(section: SummaryBytes) -> Summary:
    """Return what the summary section says.

    Raises:
        DamageError: Where a record in it makes no sense.
    """
    chunks: list[ChunkEntry] = []
    records: list[Any] = []
    data, byte = section.data, section.start
    for place in iterate_places(data, 0, len(data), byte):
        if place.opcode == Opcode.CHUNK_INDEX:
            chunks.append(_parse_entry(data, place, byte))
        else:
            records.append(parse_record(place, data[place.start : place.end], byte + place.start))
    statistics = [record for record in records if isinstance(record, Statistics)]
    return Summary(
        schemas=tuple(record for record in records if isinstance(record, Schema)),
        channels=tuple(record for record in records if isinstance(record, Channel)),
        chunks=tuple(sorted(chunks, key=lambda entry: entry.start)),
        statistics=statistics[-1] if statistics else None,
        named={
            **{
                found.offset: (Opcode.METADATA, found.name)
                for found in records
                if isinstance(found, MetadataIndex)
            },
            **{
                found.offset: (Opcode.ATTACHMENT, found.name)
                for found in records
                if isinstance(found, AttachmentIndex)
            },
        },
    )


def find_lone_records(stream: BinaryIO, ends: Ends, summary: Summary) -> tuple[Place, ...] | None:
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
        places = _find_between(stream, start, end)
        if places is None:
            return None
        lone += places
        start = end if entry is None else entry.end
    return tuple(lone)


def _is_indexed(entry: ChunkEntry, known: set[int]) -> bool:
    return bool(entry.channels and entry.index_length) and entry.channels <= known


def _find_between(stream: BinaryIO, start: int, end: int) -> list[Place] | None:
    found = []
    while start < end:
        stream.seek(start)
        heading = stream.read(RECORD.size)
        if len(heading) < RECORD.size:
            return None
        opcode, length = RECORD.unpack(heading)
        if opcode in {0, Opcode.CHUNK, Opcode.MESSAGE}:
            return None
        place = Place(opcode, start + RECORD.size, length)
        if place.opcode in _ALONE:
            found.append(place)
        start = place.end
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
