"""The messages of one file written to another, whoever described their channels, and where."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema
from mcap.writer import IndexType, Writer

from turtlelog import __version__
from turtlelog.log.engine.ending import Ending
from turtlelog.log.single_records import MESSAGE_HEAD, parse_record


@dataclass(slots=True, kw_only=True)
class Descriptions:
    """What a file says of its messages, before any is copied.

    Attributes:
        header: Its profile and library.
        schemas: By id, the first of each.
        channels: By id, the first of each.
        opcodes: How many records there are of each kind.
    """

    header: Header = field(default_factory=lambda: Header("", f"turtlelog/{__version__}"))
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    opcodes: Counter[int] = field(default_factory=Counter)

    def take_record(self, opcode: int, body: bytes) -> None:
        """Remember a record that describes."""
        self.opcodes[opcode] += 1
        if opcode == Opcode.HEADER:
            self.header = parse_record(Header, body)
        elif opcode == Opcode.SCHEMA:
            schema = parse_record(Schema, body)
            self.schemas.setdefault(schema.id, schema)
        elif opcode == Opcode.CHANNEL:
            channel = parse_record(Channel, body)
            self.channels.setdefault(channel.id, channel)

    def take_ending(self, ending: Ending) -> None:
        """Fill in what only the summary says."""
        self.schemas = {**ending.schemas, **self.schemas}
        self.channels = {**ending.channels, **self.channels}


class Rewriter:
    """Writes the records of a file to another, and counts.

    Ids are kept where they count from 1 without a gap, as most writers' do, and mean one thing.
    """

    def __init__(self, output: BinaryIO, described: Descriptions, *, has_notes: bool) -> None:
        self.recovered: Counter[str] = Counter()
        self.unchecked: Counter[str] = Counter()
        self.unknown: Counter[int] = Counter()
        self.first_unknown: dict[int, int] = {}
        self.span_ns: tuple[int, int] | None = None
        self._schemas = dict(described.schemas)
        self._schema_ids: dict[object, int] = {}
        self._channel_ids: dict[object, int] = {}
        self._channels: dict[int, tuple[int, str]] = {}  # by id there: id here, topic
        self._writer = Writer(
            output,
            index_types=_choose_indexes(described.opcodes, has_notes=has_notes),
            repeat_schemas=bool(described.schemas),
            repeat_channels=bool(described.channels),
            enable_data_crcs=True,
        )
        self._writer.start(profile=described.header.profile, library=described.header.library)
        for _, schema in sorted(described.schemas.items()):
            self._register_schema(schema)
        for _, channel in sorted(described.channels.items()):
            self._register_channel(channel)

    def take_record(self, opcode: int, body: bytes, place: int, *, is_checked: bool) -> None:
        """Write a record from `place`; a later description of an id holds from there on."""
        if opcode == Opcode.MESSAGE:
            self._add_message(body, place, is_checked=is_checked)
        elif opcode == Opcode.SCHEMA:
            schema = parse_record(Schema, body)
            self._schemas[schema.id] = schema
            self._register_schema(schema)
        elif opcode == Opcode.CHANNEL:
            self._register_channel(parse_record(Channel, body))
        elif opcode == Opcode.METADATA:
            metadata = parse_record(Metadata, body)
            self._writer.add_metadata(metadata.name, metadata.metadata)
        elif opcode == Opcode.ATTACHMENT:
            file = parse_record(Attachment, body)
            self._writer.add_attachment(
                file.create_time, file.log_time, file.name, file.media_type, file.data
            )

    def finish(self, notes: Mapping[str, Mapping[str, str]]) -> None:
        """Write metadata records of our own, and the summary."""
        for name, entries in notes.items():
            self._writer.add_metadata(name, dict(entries))
        self._writer.finish()  # type: ignore[no-untyped-call]

    def _add_message(self, body: bytes, place: int, *, is_checked: bool) -> None:
        number, sequence, log_time, publish_time = MESSAGE_HEAD.unpack_from(body)
        if number not in self._channels:
            self.unknown[number] += 1
            self.first_unknown.setdefault(number, place)
            return
        channel, topic = self._channels[number]
        payload = body[MESSAGE_HEAD.size :]
        self._writer.add_message(channel, log_time, payload, publish_time, sequence)
        self.recovered[topic] += 1
        if not is_checked:
            self.unchecked[topic] += 1
        start, end = self.span_ns or (log_time, log_time)
        self.span_ns = min(start, log_time), max(end, log_time)

    def _register_schema(self, schema: Schema) -> int:
        key = (schema.id, schema.name, schema.encoding, schema.data)
        if key not in self._schema_ids:
            self._schema_ids[key] = self._writer.register_schema(*key[1:])
        return self._schema_ids[key]

    def _register_channel(self, channel: Channel) -> None:
        schema = self._schemas.get(channel.schema_id)
        schema_id = 0 if schema is None else self._register_schema(schema)
        entries = tuple(sorted(channel.metadata.items()))
        key = (channel.id, channel.topic, channel.message_encoding, schema_id, entries)
        if key not in self._channel_ids:
            self._channel_ids[key] = self._writer.register_channel(
                channel.topic, channel.message_encoding, schema_id, channel.metadata
            )
        self._channels[channel.id] = self._channel_ids[key], channel.topic


def _choose_indexes(opcodes: Mapping[int, int], *, has_notes: bool) -> IndexType:
    # An index without entries would write an empty group, which strict checkers call an error.
    indexes = IndexType.CHUNK | IndexType.MESSAGE
    if opcodes[Opcode.METADATA] or has_notes:
        indexes |= IndexType.METADATA
    if opcodes[Opcode.ATTACHMENT]:
        indexes |= IndexType.ATTACHMENT
    return indexes
