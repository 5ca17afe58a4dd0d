"""Writing of topics or MCAP records: header, chunks with indexes, summary and checksums.

Every chunk contains the schemas and channels of its messages, so that it can be read alone. The
mcap library's writer writes these once, and takes messages one by one.
"""

import os
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, islice
from pathlib import Path, PurePath
from struct import Struct
from typing import Any, BinaryIO, Final

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.libraries import __version__
from turtlelog.log.engine.blocks import ChannelRecords, ChunkRows, fit_numbers
from turtlelog.log.engine.cdr import encode_alike, encode_fixed, encode_varied
from turtlelog.log.engine.message_types import (
    Field,
    lay_out_alike,
    name_parts,
    read_type,
)
from turtlelog.log.engine.source import map_ahead
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.file_access import (
    MCAP0_MAGIC,
    name_place,
    name_write_error,
    replace_when_complete,
)
from turtlelog.log.recording.topics import SCHEMAS, describe_topics

LIBRARY: Final = f"turtlelog/{__version__}"
"""Name of the program, written to the header of each file."""

_NOTHING: Final[Mapping[str, Any]] = {}

_COMPRESSION: Final = "zstd"
_INDEX: Final = Struct("<BQHI")  # opcode, length, channel, bytes of its entries
_MEDIA_TYPES: Final = {".toml": "application/toml"}
_THREADS: Final = min(os.cpu_count() or 1, 4)
_AHEAD: Final = 2 * _THREADS
"""Number of chunks that may wait to be written; each has 1 MiB unless one record is larger."""
CHUNK_BYTES: Final = 2**20
"""Largest chunk in a file that is written at once, without schemas and channels [bytes]."""


LIVE_CHUNK_BYTES: Final = 2**16
"""Approximate chunk size in a live recording [bytes]."""

_FOOTER_FRONT: Final = 25  # bytes of the footer that its checksum covers


def write_columns(
    topics: Sequence[TopicColumns],
    path: str | Path,
    *,
    definitions: Mapping[str, str] | None = None,
    metadata: Mapping[str, Mapping[str, str]] = _NOTHING,
    attachments: Mapping[str, bytes] = _NOTHING,
) -> None:
    """Write topics as an MCAP file in order of log time. Equal columns give identical files.

    Args:
        topics: Topics, as from `read_columns`. Missing fields are 0 or empty. Messages with equal
            times have the order of the topics.
        path: Path of the file, which is replaced when the new file is complete.
        definitions: The `ros2msg` text of every message type. Default: turtlelog's types.
        metadata: Metadata records by name.
        attachments: Attached files by name.

    Raises:
        LogError: If the file cannot be written, or a column does not fit its type.
    """
    try:
        channels = list(_encode_topics(topics, SCHEMAS if definitions is None else definitions))
        with replace_when_complete(path) as temporary, temporary.open("wb") as stream:
            file = McapFile(stream)
            file.begin()
            for name, entries in metadata.items():
                file.add_metadata(name, entries)
            for name, data in attachments.items():
                file.add_attachment(name, data)
            file.add_chunks(_cut_chunks(channels))
            file.finish()
    except (LogError, UnicodeEncodeError) as err:
        raise name_write_error(path, err) from err


Numbers = NDArray[np.int64]


def _encode_topics(
    topics: Sequence[TopicColumns], definitions: Mapping[str, str]
) -> Iterator[ChannelRecords]:
    names = [columns.topic for columns in topics]
    for name in names:
        if names.count(name) > 1:
            raise LogError(f"topic {name}: expected once, found {names.count(name)} times")
    channels = describe_topics([(columns.topic, columns.type) for columns in topics], definitions)
    for columns, (schema, channel) in zip(topics, channels, strict=True):
        with name_place(f"topic {columns.topic}"):
            yield encode_records(columns, schema, channel)


@dataclass(slots=True)
class _Summary:
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    chunks: list[bytes] = field(default_factory=list)  # of the records, whose tables are large
    spans_ns: list[tuple[int, int]] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _PackedChunk:
    rows: ChunkRows
    span_ns: tuple[int, int]
    record: bytes  # record of the chunk
    indexes: Sequence[bytes]  # records of the chunk's message indexes
    compressed_size: int
    uncompressed_size: int


class McapFile:
    """A writer of MCAP records to a new stream. Each call writes complete records at once.

    Attributes:
        end: Number of bytes written so far, all in complete records.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self.end = 0
        self._stream, self._checksum, self._summary = stream, 0, _Summary()

    def begin(self, *, profile: str = "ros2", library: str = LIBRARY) -> None:
        """Write the magic bytes and the header."""
        header = Header(profile=profile, library=library)
        self._write(MCAP0_MAGIC + join_records([header]))

    def add_metadata(self, name: str, entries: Mapping[str, str]) -> None:
        """Write a metadata record."""
        start = self.end
        self._write(join_records([Metadata(name=name, metadata=dict(entries))]))
        index = MetadataIndex(offset=start, length=self.end - start, name=name)
        self._summary.metadata.append(index)

    def add_attachment(self, name: str, data: bytes) -> None:
        """Write an attachment, without a time."""
        media_type = _MEDIA_TYPES.get(PurePath(name).suffix, "application/octet-stream")
        self.add_attachment_record(
            Attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=data)
        )

    def add_attachment_record(self, attachment: Attachment) -> None:
        """Write an attachment record unchanged."""
        start = self.end
        self._write(join_records([attachment]))
        index = AttachmentIndex(
            offset=start,
            length=self.end - start,
            log_time=attachment.log_time,
            create_time=attachment.create_time,
            data_size=len(attachment.data),
            name=attachment.name,
            media_type=attachment.media_type,
        )
        self._summary.attachments.append(index)

    def describe(self, schemas: Iterable[Schema], channels: Iterable[Channel]) -> None:
        """Write the schemas and channels that no chunk contains yet."""
        known = self._summary
        new_schemas = [schema for schema in schemas if schema.id not in known.schemas]
        new_channels = [channel for channel in channels if channel.id not in known.channels]
        self._write(join_records([*new_schemas, *new_channels]))
        known.schemas |= {schema.id: schema for schema in new_schemas}
        known.channels |= {channel.id: channel for channel in new_channels}

    def add_chunk(self, rows: ChunkRows) -> None:
        """Compress messages and write them as a chunk with its message indexes."""
        self._append(_pack_chunk(rows))

    def add_chunks(self, chunks: Iterable[ChunkRows]) -> None:
        """Write chunks in order, with the same bytes as from `add_chunk`. Threads compress them."""
        chunks = iter(chunks)
        few = list(islice(chunks, 2))
        # zstd and the checksum release the interpreter lock.
        work = map_ahead(_pack_chunk, chain(few, chunks), lambda _: 1, _AHEAD, _THREADS)
        for packed in work if len(few) > 1 else map(_pack_chunk, few):
            self._append(packed)

    def _append(self, packed: _PackedChunk) -> None:
        rows, start, (start_ns, end_ns) = packed.rows, self.end, packed.span_ns
        ends = np.cumsum([start + len(packed.record), *map(len, packed.indexes)]).tolist()
        self._write(b"".join((packed.record, *packed.indexes)))
        index = ChunkIndex(
            chunk_length=len(packed.record),
            chunk_start_offset=start,
            compression=_COMPRESSION,
            compressed_size=packed.compressed_size,
            message_end_time=end_ns,
            message_index_length=ends[-1] - ends[0],
            message_index_offsets=dict(zip(rows.index, ends, strict=False)),
            message_start_time=start_ns,
            uncompressed_size=packed.uncompressed_size,
        )
        self._summary.chunks.append(join_records([index]))
        self._summary.spans_ns.append(packed.span_ns)
        for schema, channel in rows.channels:
            if schema is not None:
                self._summary.schemas[schema.id] = schema
            self._summary.channels[channel.id] = channel
        for number, entries in rows.index.items():
            self._summary.counts[number] = self._summary.counts.get(number, 0) + len(entries)

    def finish(self) -> None:
        """Write the end of the data, the summary and the footer."""
        data_end = join_records([DataEnd(data_section_crc=self._checksum)])
        start = self.end + len(data_end)
        # Strict checkers reject a group without records.
        groups = [group for group in self._join_groups() if group]
        ends = np.cumsum([start, *map(len, groups)]).tolist()
        offsets = [
            SummaryOffset(group_opcode=group[0], group_start=place, group_length=len(group))
            for group, place in zip(groups, ends, strict=False)
        ]
        summary = b"".join((*groups, join_records(offsets)))
        footer = Footer(summary_start=start, summary_offset_start=ends[-1], summary_crc=0)
        front = join_records([footer])[:_FOOTER_FRONT]
        footer.summary_crc = zlib.crc32(summary + front)
        self._write(data_end + summary + join_records([footer]) + MCAP0_MAGIC)

    def cut_back(self) -> None:
        """Remove the bytes of a failed write after the last complete record."""
        self._stream.seek(self.end)
        self._stream.truncate()

    def _join_groups(self) -> Iterator[bytes]:
        summary = self._summary
        yield join_records([schema for _, schema in sorted(summary.schemas.items())])
        yield join_records([channel for _, channel in sorted(summary.channels.items())])
        statistics = Statistics(
            attachment_count=len(summary.attachments),
            channel_count=len(summary.channels),
            channel_message_counts=dict(sorted(summary.counts.items())),
            chunk_count=len(summary.chunks),
            message_count=sum(summary.counts.values()),
            message_end_time=max((end for _, end in summary.spans_ns), default=0),
            message_start_time=min((start for start, _ in summary.spans_ns), default=0),
            metadata_count=len(summary.metadata),
            schema_count=len(summary.schemas),
        )
        yield join_records([statistics])
        yield b"".join(summary.chunks)
        yield join_records(summary.attachments)
        yield join_records(summary.metadata)

    def _write(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest:
            # A stream without a buffer may write fewer bytes than it is given.
            rest = rest[self._stream.write(rest) :]
        self.end += len(data)
        self._checksum = zlib.crc32(data, self._checksum)


def _pack_chunk(rows: ChunkRows) -> _PackedChunk:
    described = [record for pair in rows.channels for record in pair if record is not None]
    # Each record is built once: ten thousand channels may share a schema.
    built = {id(record): record for record in described}
    records = {number: join_records([record]) for number, record in built.items()}
    front = b"".join([records[id(record)] for record in described])
    data = b"".join((front, rows.records))
    start_ns, end_ns = rows.span_ns
    chunk = Chunk(
        compression=_COMPRESSION,
        data=zstandard.ZstdCompressor().compress(data),
        message_start_time=start_ns,
        message_end_time=end_ns,
        uncompressed_crc=zlib.crc32(data),
        uncompressed_size=len(data),
    )
    return _PackedChunk(
        rows=rows,
        span_ns=(start_ns, end_ns),
        record=join_records([chunk]),
        indexes=[_format_index(*entries, len(front)) for entries in rows.index.items()],
        compressed_size=len(chunk.data),
        uncompressed_size=len(data),
    )


def join_records(records: Sequence[McapRecord]) -> bytes:
    """Return the bytes of records, one after the other."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]
    return data


def _format_index(channel: int, entries: NDArray[np.uint64], front: int) -> bytes:
    moved = (entries + np.array([0, front], np.uint64)).astype("<u8").tobytes()
    return _INDEX.pack(Opcode.MESSAGE_INDEX, 6 + len(moved), channel, len(moved)) + moved


def _cut_chunks(channels: Sequence[ChannelRecords]) -> Iterator[ChunkRows]:
    """Yield chunks of all records in order of log time; at equal times, channel by channel."""
    filled = [content for content in channels if len(content.sizes)]
    if not filled:
        return
    times = np.concatenate([content.log_time_ns for content in filled])
    sizes = np.concatenate([content.sizes for content in filled])
    order = np.argsort(times, kind="stable")
    ends = np.cumsum(sizes[order])
    starts = np.empty_like(ends)
    starts[order] = ends - sizes[order]
    borders = np.cumsum([len(content.sizes) for content in filled])[:-1]
    placed = list(zip(filled, np.split(starts, borders), strict=True))
    first, start = 0, 0
    while first < len(ends):
        after = int(np.searchsorted(ends, start + CHUNK_BYTES, side="right"))
        last = max(after - 1, first)
        end = int(ends[last])
        yield _fill_chunk(placed, start, end)
        first, start = last + 1, end


def _fill_chunk(
    placed: Sequence[tuple[ChannelRecords, Numbers]], start: int, end: int
) -> ChunkRows:
    """Return the records from `start` to `end` in the stream of channels with these starts."""
    buffer = bytearray(end - start)
    index, channels = {}, []
    for content, starts in placed:
        first, after = np.searchsorted(starts, (start, end)).tolist()
        if first == after:
            continue
        places = starts[first:after] - start
        _scatter(buffer, places, content, first, after)
        entries = np.column_stack([content.log_time_ns[first:after], places])
        index[content.channel.id] = entries.astype(np.uint64)
        channels.append((content.schema, content.channel))
    return ChunkRows(channels=channels, records=buffer, index=index)


def _scatter(
    buffer: bytearray, places: Numbers, content: ChannelRecords, first: int, after: int
) -> None:
    """Copy rows [first, after) of a channel to their offsets."""
    sizes = content.sizes[first:after]
    begin = int(content.ends[first] - sizes[0])
    data = content.data[begin : int(content.ends[after - 1])]
    size = int(sizes[0])
    if (sizes == size).all():
        # A view makes a row start at every byte of the buffer, so all rows are copied in one step.
        rows = len(buffer) - size + 1
        view = np.ndarray((rows,), f"V{size}", buffer=buffer, strides=(1,))
        view[places] = data.view(f"V{size}")
        return
    within = np.arange(len(data)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    np.frombuffer(buffer, np.uint8)[np.repeat(places, sizes) + within] = data


def encode_records(columns: TopicColumns, schema: Schema, channel: Channel) -> ChannelRecords:
    """Return the messages of a topic as records in order of log time.

    The columns may have any order of time. Missing fields are 0 or empty.
    """
    kind = read_type(columns.type, schema.data.decode())
    fields, layout = kind.fields, kind.layout
    has_rows = layout is None and len(columns) > 0
    alike = lay_out_alike(fields, columns.fields) if has_rows else None
    known = dict.fromkeys(_name_fields(fields, ""))
    known |= {} if alike is None else dict.fromkeys(alike.names)
    for name in columns.fields:
        if name not in known:
            raise LogError(f"{name}: expected a field of {columns.type}: {', '.join(known)}")
    lengths = {"publish_time_ns": len(columns.publish_time_ns), "sequence": len(columns.sequence)}
    lengths |= {name: len(values) for name, values in columns.fields.items()}
    for name, rows in lengths.items():
        if rows != len(columns):
            raise LogError(f"{name}: expected {len(columns)} rows, found {rows}")
    if (np.diff(columns.log_time_ns) < 0).any():
        columns = columns.select(np.argsort(columns.log_time_ns, kind="stable"))
    stamps = {
        "log_time": fit_numbers("log_time_ns", columns.log_time_ns, "<u8"),
        "publish_time": fit_numbers("publish_time_ns", columns.publish_time_ns, "<u8"),
        "sequence": fit_numbers("sequence", columns.sequence, "<u4"),
    }
    if alike is not None:
        data, sizes = encode_alike(alike, columns.fields, stamps, channel.id)
    elif layout is None:
        data, sizes = encode_varied(fields, columns.fields, stamps, channel.id)
    else:
        data, sizes = encode_fixed(layout, columns.fields, stamps, channel.id)
    return ChannelRecords(
        schema=schema,
        channel=channel,
        log_time_ns=columns.log_time_ns,
        data=data,
        sizes=sizes,
        ends=np.cumsum(sizes),
    )


def _name_fields(fields: tuple[Field, ...], prefix: str) -> Iterator[str]:
    for one in fields:
        if isinstance(one.kind, str) or one.is_sequence:
            yield prefix + one.name
        else:
            for part in name_parts(one):
                yield from _name_fields(one.kind, f"{prefix}{part}.")
