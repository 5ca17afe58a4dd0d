"""Copying of messages from one MCAP file to another, with new channel ids if necessary."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from hashlib import blake2b
from typing import Any, BinaryIO, Final, TypeVar

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.blocks import ChunkRows
from turtlelog.log.engine.limits import CHANGES, CHUNK_CHANNELS, Allowance
from turtlelog.log.engine.records import RECORD, RecordStretch, parse_body
from turtlelog.log.mcap_writer import LIBRARY, McapFile, join_records

_CHANNEL: Final = 9  # offset of the channel number in a message record, u16
_MOST_FAULTS: Final = 100  # errors reported for one segment
_SMALL_CHUNK: Final = 2**16  # bytes of records
_MOST_NOTES: Final = 2000
"""Largest number of metadata records and attachments, of which a file may have twice as many."""

Numbers = NDArray[np.int64]

_MOST_IDS: Final = 2**16 - 1

Pair = tuple[Schema | None, Channel]
"""A channel, with its schema, if any."""

Described = TypeVar("Described", Header, Schema, Channel, Metadata, Attachment)


class Numbering:
    """Mapping from the ids of a file to those of another file. Only ids with two meanings change.

    Attributes:
        schemas: Schemas by source id, as valid at this place of the source, with their target ids.
        channels: Channels with their schemas by source id, with their target ids.
        first_schemas: First schema of each source id, unchanged.
        first_channels: First channel of each source id, unchanged.
    """

    def __init__(
        self, schemas: Iterable[Schema], channels: Iterable[Channel], allowance: Allowance
    ) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Pair] = {}
        self.first_schemas: dict[int, Schema] = {}
        self.first_channels: dict[int, Channel] = {}
        self._allowance = allowance
        self._taken_schemas = _Ids(least=1)
        self._taken_channels = _Ids(least=0)
        self._known_schemas: dict[object, Schema] = {}
        self._known_channels: dict[object, Pair] = {}
        self._awaited: set[int] = set()
        for schema in schemas:
            self.add_schema(schema)
        for channel in channels:
            self.add_channel(channel)

    def add_schema(self, schema: Schema) -> None:
        """Set the schema of a source id from here on."""
        key = (schema.id, schema.name, schema.encoding, schema.data)
        if key not in self._known_schemas:
            self._allowance.spend_description(schema)
            number = self._taken_schemas.choose(schema.id)
            self._known_schemas[key] = replace(schema, id=number)
        self.first_schemas.setdefault(schema.id, schema)
        self.schemas[schema.id] = self._known_schemas[key]

    def add_channel(self, channel: Channel) -> None:
        """Set the channel of a source id from here on."""
        if channel.schema_id and channel.schema_id not in self.schemas:
            self._awaited.add(channel.schema_id)
        self.channels[channel.id] = self._number(channel)
        self.first_channels.setdefault(channel.id, channel)

    def is_news(self, channel: Channel) -> bool:
        """Return whether a known id would get another meaning."""
        known = self.channels.get(channel.id)
        return known is not None and known != self._number(channel)

    @property
    def has_late_schemas(self) -> bool:
        """Whether a schema came after a channel that needs it."""
        return not self._awaited.isdisjoint(self.schemas)

    def _number(self, channel: Channel) -> Pair:
        schema = self.schemas.get(channel.schema_id)
        schema_id = 0 if schema is None else schema.id
        entries = tuple(sorted(channel.metadata.items()))
        key = (channel.id, channel.topic, channel.message_encoding, schema_id, entries)
        if key not in self._known_channels:
            self._allowance.spend_description(channel)
            number = self._taken_channels.choose(channel.id)
            self._known_channels[key] = schema, replace(channel, id=number, schema_id=schema_id)
        return self._known_channels[key]


class _Ids:
    """Ids in use."""

    def __init__(self, *, least: int) -> None:
        self._least, self._greatest = least, _MOST_IDS
        self._taken: set[int] = set()

    def choose(self, wanted: int) -> int:
        """Return the wanted id, or else the largest free id: small ids may be wanted later."""
        number = wanted
        if wanted < self._least or wanted in self._taken:
            while self._greatest in self._taken:
                self._greatest -= 1
            number = self._greatest
        if number < 1 and number != wanted:
            raise LogError(f"expected up to {_MOST_IDS} schemas and channels, found more")
        self._taken.add(number)
        return number


class Rewriter:
    """Writer of a file's records to another file, one segment as one chunk, with counts.

    Attributes:
        recovered: Number of recovered messages by topic.
        unchecked: Recovered messages by topic in segments without a checksum of their own.
        unknown: Number of messages by channel id, for channels that no earlier record describes.
        first_unknown: Offset of the segment with the first such message, by channel id.
        span_ns: Earliest and latest log time [ns]; None before the first message.
        numbering: Meaning of the source's ids.
    """

    def __init__(self, output: BinaryIO, numbering: Numbering, allowance: Allowance) -> None:
        self.recovered: Counter[str] = Counter()
        self.unchecked: Counter[str] = Counter()
        self.unknown: Counter[int] = Counter()
        self.first_unknown: dict[int, int] = {}
        self.span_ns: tuple[int, int] | None = None
        self.numbering = numbering
        self._file, self._is_begun, self._allowance = McapFile(output), False, allowance
        # Last meaning of each id, by kind: some writers repeat it in every chunk.
        self._last: dict[int, dict[bytes, bytes]] = {Opcode.SCHEMA: {}, Opcode.CHANNEL: {}}
        self._notes = 0
        self._small: list[ChunkRows] = []
        self._small_size = 0  # bytes of the small chunks' records

    def take_stretch(self, stretch: RecordStretch, byte: int, *, is_checked: bool) -> list[str]:
        """Write the records at an offset of the source, and return their errors."""
        faults = [] if stretch.fault is None else [stretch.fault]
        first = 0

        def add_before(place: int) -> None:
            nonlocal first
            after = int(np.searchsorted(stretch.starts, place))
            self._add_messages(stretch, slice(first, after), byte, is_checked=is_checked)
            first = after

        for place, opcode, end in stretch.others:
            body = stretch.data[place + RECORD.size : end]
            try:
                if opcode in {Opcode.SCHEMA, Opcode.CHANNEL}:
                    self._take_description(opcode, body, partial(add_before, place))
                else:
                    self._take_record(opcode, body)
            except LogError as err:
                faults.append(str(err))
            if len(faults) == _MOST_FAULTS:
                break
        try:
            self._add_messages(stretch, slice(first, None), byte, is_checked=is_checked)
        except LogError as err:
            faults.append(str(err))
        return faults

    def finish(self, notes: Mapping[str, Mapping[str, str]]) -> None:
        """Write turtlelog's metadata records and the summary."""
        self._begin()
        self._write_small()
        # Channels without a message are in no chunk.
        pairs = self.numbering.channels.values()
        self._file.describe(self.numbering.schemas.values(), [channel for _, channel in pairs])
        for name, entries in notes.items():
            self._file.add_metadata(name, entries)
        self._file.finish()

    def _take_description(self, opcode: int, body: bytes, flush: Callable[[], None]) -> None:
        """Add a schema or channel. If its id had another meaning, `flush` earlier records first."""
        known, digest = self._last[opcode], blake2b(body, digest_size=16).digest()
        if known.get(body[:2]) == digest:
            return
        if opcode == Opcode.SCHEMA:
            self.numbering.add_schema(_parse_exact_record(Schema, body))
            self._last[Opcode.CHANNEL].clear()  # their ids may have another meaning now
        else:
            channel = _parse_exact_record(Channel, body)
            if self.numbering.is_news(channel):
                self._allowance.spend(CHANGES)
                flush()
            self.numbering.add_channel(channel)
        known[body[:2]] = digest

    def _take_record(self, opcode: int, body: bytes) -> None:
        if opcode == Opcode.HEADER:
            self._begin(_parse_exact_record(Header, body))
            return
        self._notes += 1
        if self._notes > _MOST_NOTES:
            raise LogError(
                f"expected up to {_MOST_NOTES} metadata records and attachments, found more"
            )
        if opcode == Opcode.METADATA:
            note = _parse_exact_record(Metadata, body)
            write = partial(self._file.add_metadata, note.name, note.metadata)
        else:
            write = partial(self._file.add_attachment_record, _parse_exact_record(Attachment, body))
        self._begin()
        self._write_small()
        write()

    def _begin(self, header: Header | None = None) -> None:
        """Write the header first. If the source's header is lost, write a header by turtlelog."""
        if not self._is_begun:
            header = header or Header(profile="", library=LIBRARY)
            self._file.begin(profile=header.profile, library=header.library)
            self._is_begun = True

    def _add_messages(
        self, stretch: RecordStretch, rows: slice, byte: int, *, is_checked: bool
    ) -> None:
        for starts, heads in stretch.iterate_rows(rows):
            ends = starts + heads["length"].astype(np.int64) + RECORD.size
            unknown = self._note_unknown(heads["channel"], byte)
            if unknown:
                is_known = ~np.isin(heads["channel"], unknown)
                starts, ends, heads = starts[is_known], ends[is_known], heads[is_known]
            if not len(starts):
                continue
            places = np.cumsum(ends - starts) - (ends - starts)
            chunk = self._build_chunk(_join(stretch.data, starts, ends), places, heads)
            self._add_chunk(chunk)
            self._count(chunk, is_checked=is_checked)

    def _add_chunk(self, chunk: ChunkRows) -> None:
        """Write a chunk. Small chunks are merged, because readers refuse very many chunks."""
        self._begin()
        if len(chunk.records) >= _SMALL_CHUNK:
            self._write_small()
            self._file.add_chunk(chunk)
            return
        # A view would keep the complete unpacked chunk in memory.
        self._small.append(replace(chunk, records=bytes(chunk.records)))
        self._small_size += len(chunk.records)
        if self._small_size >= _SMALL_CHUNK:
            self._write_small()

    def _write_small(self) -> None:
        if self._small:
            self._file.add_chunk(merge_chunks(self._small))
        self._small, self._small_size = [], 0

    def _note_unknown(self, numbers: NDArray[np.uint16], byte: int) -> list[int]:
        """Count messages of channels without a description; return the ids of these channels."""
        present, counts = np.unique(numbers, return_counts=True)
        known, unknown = self.numbering.channels, []
        for number, count in zip(present.tolist(), counts.tolist(), strict=True):
            if number not in known:
                unknown.append(number)
                self.unknown[number] += count
                self.first_unknown.setdefault(number, byte)
        return unknown

    def _build_chunk(
        self, records: bytearray | memoryview, places: Numbers, heads: NDArray[Any]
    ) -> ChunkRows:
        numbers, times = heads["channel"], heads["log_time"]
        order = np.argsort(numbers, kind="stable")
        present, firsts = np.unique(numbers[order], return_index=True)
        self._allowance.spend(CHUNK_CHANNELS, len(present))
        entries = np.column_stack([times, places.astype(np.uint64)])[order]
        index, pairs, renamed = {}, {}, present.astype(np.int64)
        for row, (there, of) in enumerate(
            zip(present.tolist(), np.split(entries, firsts[1:]), strict=True)
        ):
            schema, channel = self.numbering.channels[there]
            index[channel.id], pairs[channel.id] = of, (schema, channel)
            renamed[row] = channel.id
        if (renamed != present).any():
            records, numbers = bytearray(records), renamed[np.searchsorted(present, numbers)]
            array = np.frombuffer(records, np.uint8)
            array[places + _CHANNEL] = numbers & 0xFF
            array[places + _CHANNEL + 1] = numbers >> 8
        return ChunkRows(
            channels=list(pairs.values()),
            records=records,
            index=index,
        )

    def _count(self, chunk: ChunkRows, *, is_checked: bool) -> None:
        for _, channel in chunk.channels:
            count = len(chunk.index[channel.id])
            self.recovered[channel.topic] += count
            if not is_checked:
                self.unchecked[channel.topic] += count
        spans_ns = [chunk.span_ns, self.span_ns or chunk.span_ns]
        self.span_ns = min(start for start, _ in spans_ns), max(end for _, end in spans_ns)


def _join(data: bytes, starts: Numbers, ends: Numbers) -> bytearray | memoryview:
    """Return records without the bytes between them."""
    breaks = np.flatnonzero(starts[1:] != ends[:-1])
    firsts = starts[np.concatenate(([0], breaks + 1))].tolist()
    lasts = ends[np.concatenate((breaks, [len(ends) - 1]))].tolist()
    view = memoryview(data)
    if len(firsts) == 1:
        return view[firsts[0] : lasts[0]]
    joined = bytearray()
    for first, last in zip(firsts, lasts, strict=True):
        joined += view[first:last]
    return joined


def _parse_exact_record(kind: type[Described], body: bytes) -> Described:
    """Return a record with consistent lengths. Bytes that a later version appended are ignored."""
    record, size = parse_body(kind, body)
    if isinstance(record, Attachment):
        return record
    # A table that claims to be too short would lose entries silently.
    written = join_records([record])[RECORD.size :]
    if isinstance(record, Channel | Schema):
        if size != len(written):
            raise LogError(f"expected a sound {kind.__name__} record, found an entry twice")
    elif not body.startswith(written):
        raise LogError(f"expected a sound {kind.__name__} record, found lengths that disagree")
    return record


def merge_chunks(chunks: Sequence[ChunkRows]) -> ChunkRows:
    """Merge chunks into one chunk. A channel number must have the same meaning in all chunks."""
    if len(chunks) == 1:
        return chunks[0]
    channels: dict[int, tuple[Schema | None, Channel]] = {}
    index: dict[int, list[NDArray[np.uint64]]] = {}
    size = 0
    for chunk in chunks:
        channels |= {channel.id: (schema, channel) for schema, channel in chunk.channels}
        for number, entries in chunk.index.items():
            moved = entries + np.array([0, size], np.uint64)
            index.setdefault(number, []).append(moved)
        size += len(chunk.records)
    return ChunkRows(
        channels=[*channels.values()],
        records=b"".join(chunk.records for chunk in chunks),
        index={number: np.concatenate(entries) for number, entries in index.items()},
    )
