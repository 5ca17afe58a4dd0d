"""The messages of one file written to another, whoever described their channels, and where."""

from collections import Counter
from collections.abc import Mapping
from typing import BinaryIO, Final

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.container import LIBRARY, ChunkRows, McapFile, pack_chunk
from turtlelog.log.engine.blocks import MESSAGE_HEAD
from turtlelog.log.engine.gather import gather_bytes
from turtlelog.log.engine.rows import LOG_TIME, MESSAGE_HEADER
from turtlelog.log.recovery.numbering import Numbering
from turtlelog.log.recovery.single_records import parse_record
from turtlelog.log.recovery.stretches import Stretch

_CHANNEL: Final = 9  # where in a message record the number of its channel stands, u16

Numbers = NDArray[np.int64]


class Rewriter:
    """Writes the records of a file to another, a stretch as a chunk, and counts.

    Attributes:
        recovered: Messages by topic.
        unchecked: Those of them that no checksum of their own stretch vouches for.
        unknown: Messages by the number of a channel that nothing before them describes.
        first_unknown: By the same, the byte of the stretch with the first of them.
        span_ns: Least and greatest log time, None before the first message.
        numbering: What the ids of the source mean.
    """

    def __init__(self, output: BinaryIO, numbering: Numbering) -> None:
        self.recovered: Counter[str] = Counter()
        self.unchecked: Counter[str] = Counter()
        self.unknown: Counter[int] = Counter()
        self.first_unknown: dict[int, int] = {}
        self.span_ns: tuple[int, int] | None = None
        self.numbering = numbering
        self._file, self._is_begun = McapFile(output), False

    def take_stretch(self, stretch: Stretch, byte: int, *, is_checked: bool) -> list[str]:
        """Write records that stand at a byte of the source; return what is wrong with them.

        A later description of an id holds from there on.
        """
        faults = [] if stretch.fault is None else [stretch.fault]
        first = 0
        for place, opcode, body in stretch.others:
            try:
                if opcode == Opcode.CHANNEL:
                    channel = parse_record(Channel, body)
                    if self.numbering.is_news(channel):
                        after = int(np.searchsorted(stretch.starts, place))
                        self._add_messages(stretch, slice(first, after), byte, is_checked)
                        first = after
                    self.numbering.add_channel(channel)
                else:
                    self._take_record(opcode, body)
            except LogError as err:
                faults.append(str(err))
        self._add_messages(stretch, slice(first, None), byte, is_checked)
        return faults

    def finish(self, notes: Mapping[str, Mapping[str, str]]) -> None:
        """Write metadata records of our own, and the summary."""
        self._begin()
        # Those without a message stand in no chunk.
        pairs = self.numbering.channels.values()
        self._file.describe(self.numbering.schemas.values(), [channel for _, channel in pairs])
        for name, entries in notes.items():
            self._file.add_metadata(name, entries)
        self._file.finish()

    def _take_record(self, opcode: int, body: bytes) -> None:
        if opcode == Opcode.HEADER:
            self._begin(parse_record(Header, body))
        elif opcode == Opcode.SCHEMA:
            self.numbering.add_schema(parse_record(Schema, body))
        elif opcode == Opcode.METADATA:
            metadata = parse_record(Metadata, body)
            self._begin()
            self._file.add_metadata(metadata.name, metadata.metadata)
        elif opcode == Opcode.ATTACHMENT:
            attachment = parse_record(Attachment, body)
            self._begin()
            self._file.add_attachment_record(attachment)

    def _begin(self, header: Header | None = None) -> None:
        """Write the header before anything else; where it is lost, one of our own."""
        if not self._is_begun:
            header = header or Header(profile="", library=LIBRARY)
            self._file.begin(profile=header.profile, library=header.library)
            self._is_begun = True

    def _add_messages(self, stretch: Stretch, rows: slice, byte: int, is_checked: bool) -> None:  # noqa: FBT001
        starts, ends = stretch.starts[rows], stretch.ends[rows]
        numbers = stretch.channels[rows]
        present = np.flatnonzero(np.bincount(numbers)).tolist() if len(numbers) else []
        unknown = [number for number in present if number not in self.numbering.channels]
        for number in unknown:
            self.unknown[number] += int((numbers == number).sum())
            self.first_unknown.setdefault(number, byte)
        if unknown:
            is_known = ~np.isin(numbers, unknown)
            starts, ends, numbers = starts[is_known], ends[is_known], numbers[is_known]
        if not len(starts):
            return
        records = _join(stretch.data, starts, ends)
        places = np.cumsum(ends - starts) - (ends - starts)
        chunk = self._build_chunk(records, places, numbers)
        self._begin()
        self._file.add_chunk(pack_chunk(chunk))
        self._count(chunk, is_checked=is_checked)

    def _build_chunk(self, records: bytearray, places: Numbers, numbers: Numbers) -> ChunkRows:
        heads = gather_bytes(records, places, MESSAGE_HEAD).view(MESSAGE_HEADER)
        entries = np.column_stack([heads[LOG_TIME], places.astype(np.uint64)])
        index, pairs = {}, {}
        for there in np.flatnonzero(np.bincount(numbers)).tolist():
            schema, channel = self.numbering.channels[there]
            is_own = numbers == there
            if channel.id != there:
                _rename(records, places[is_own], channel.id)
            index[channel.id] = entries[is_own]
            pairs[channel.id] = schema, channel
        return ChunkRows(
            channels=list(pairs.values()),
            records=records,
            index=index,
            start_ns=int(entries[:, 0].min()),
            end_ns=int(entries[:, 0].max()),
        )

    def _count(self, chunk: ChunkRows, *, is_checked: bool) -> None:
        for _, channel in chunk.channels:
            count = len(chunk.index[channel.id])
            self.recovered[channel.topic] += count
            if not is_checked:
                self.unchecked[channel.topic] += count
        start_ns, end_ns = self.span_ns or (chunk.start_ns, chunk.end_ns)
        self.span_ns = min(start_ns, chunk.start_ns), max(end_ns, chunk.end_ns)


def _join(data: bytes, starts: Numbers, ends: Numbers) -> bytearray:
    """Return records without what stands between them."""
    breaks = np.flatnonzero(starts[1:] != ends[:-1])
    firsts = starts[np.concatenate(([0], breaks + 1))].tolist()
    lasts = ends[np.concatenate((breaks, [len(ends) - 1]))].tolist()
    view, joined = memoryview(data), bytearray()
    for first, last in zip(firsts, lasts, strict=True):
        joined += view[first:last]
    return joined


def _rename(records: bytearray, places: Numbers, number: int) -> None:
    array = np.frombuffer(records, np.uint8)
    array[places + _CHANNEL] = number & 0xFF
    array[places + _CHANNEL + 1] = number >> 8
