"""The topics of a file from its channels, and the decoding of their messages."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding

from turtlelog.display import join_words
from turtlelog.errors import LogError
from turtlelog.log.engine.json_messages import JsonField, read_json_schema
from turtlelog.log.engine.known_definitions import find_definition
from turtlelog.log.engine.limits import FIELDS, Allowance
from turtlelog.log.engine.message_types import (
    LONGEST_TEXT,
    TEXT,
    Field,
    Layout,
    MessageType,
    read_type,
)
from turtlelog.log.error_boundary import DamageError, LimitError

_SCHEMAS: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        # A message type without a schema encoding has no text; its name must suffice.
        MessageEncoding.CDR: (SchemaEncoding.ROS2, "ros2idl", "omgidl", ""),
        MessageEncoding.JSON: (SchemaEncoding.JSONSchema,),
        MessageEncoding.ROS1: (SchemaEncoding.ROS1,),
        MessageEncoding.Protobuf: (SchemaEncoding.Protobuf,),
    }
)
"""Encodings of schemas by the encoding of their messages."""

_ADVICE: Final = "record the topic in one of these"
"""Advice about messages in an encoding that turtlelog cannot read."""


_HEAD: Final = 20  # bytes of two times and a sequence number
_NUMBER, _TEXT, _SEQUENCE = 8, 72, 200  # bytes of a value; texts and sequences are objects
_NUMBERS: Final = frozenset({"boolean", "integer", "number"})


Decode = Callable[[int, bytes], dict[str, Any]]
"""A function from the number and the bytes of a message to an object. Errors contain the number."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectType:
    """A message type that is decoded into objects.

    Attributes:
        fields: Fields of each message.
        decode: Function that decodes a message into an object; None for JSON.
    """

    fields: tuple[JsonField, ...]
    decode: Decode | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicPlan:
    """The decoding of a topic's messages.

    Attributes:
        topic: Name of the topic.
        type: Message type; empty if there is no schema.
        reason: Why the messages cannot be decoded; empty if they can be decoded.
        fields: Fields of the type.
        layout: Layout of the type; None if its messages differ in size.
        sequence: Dotted name of a sequence of texts or messages in the type; None if the type has
            no sequence.
        json: Fields of each message in JSON or protobuf; None for CDR.
        decode: Function that decodes a protobuf message into an object; None for JSON.
        is_ros1: Whether messages are in the ROS 1 format and are converted to CDR first.
    """

    topic: str
    type: str
    reason: str = ""
    fields: tuple[Field, ...] = ()
    layout: Layout | None = None
    sequence: str | None = None
    json: tuple[JsonField, ...] | None = None
    decode: Decode | None = None
    is_ros1: bool = False

    def describe_reason(self) -> str:
        """Return the topic with the reason why its messages cannot be decoded, for errors."""
        return describe_unread(self.topic, self.reason)

    @property
    def row_size(self) -> int:
        """Memory per message [bytes]; long texts and sequences need more."""
        if self.json is not None:
            return _HEAD + sum(_NUMBER if field.kind in _NUMBERS else _TEXT for field in self.json)
        return _HEAD + (_measure(self.fields) if self.layout is None else self.layout.size)

    @property
    def meaning(self) -> object:
        """Properties that all channels of one topic must share."""
        return self.type, self.fields, self.json, self.is_ros1, self.reason


def describe_unread(topic: str, reason: str) -> str:
    """Return the sentence about a topic whose messages cannot be decoded."""
    return f"topic {topic}: not understood: {reason}"


class Catalogue:
    """The schemas and channels of a file, in the order of discovery.

    Attributes:
        allowance: Remaining limits for reading the file.
    """

    def __init__(self, allowance: Allowance) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.allowance = allowance
        self._plans: dict[str, TopicPlan] = {}
        self._of_topics: dict[str, list[Channel]] = {}
        self._types: dict[int, MessageType | ObjectType | str] = {}
        self._readings: dict[tuple[int, str], dict[str, Any]] = {}

    @property
    def topics(self) -> Collection[str]:
        """Names of the topics, unordered."""
        return self._of_topics.keys()

    @property
    def types(self) -> dict[str, str]:
        """Message type by topic, from the first channel of the topic."""
        first = {topic: channels[0].schema_id for topic, channels in self._of_topics.items()}
        names = {number: schema.name for number, schema in self.schemas.items()}
        return {topic: names.get(number, "") for topic, number in first.items()}

    def __contains__(self, channel: int) -> bool:
        return channel in self.channels

    def add(self, records: Collection[Any], byte: int) -> None:
        """Add schemas and channels; other records are ignored.

        Raises:
            DamageError: If a record differs from another record with the same id; `byte` is the
                place of the new records.
        """
        for record in map(_name_type, records):
            if not isinstance(record, Schema | Channel):
                continue
            if self._find_known(record) is None:
                self._take(record, byte)
            else:
                self.check((record,), byte)

    def check(self, records: Collection[Any], byte: int) -> None:
        """Compare schemas and channels with the known ones, without changing anything.

        Raises:
            DamageError: If a record differs.
        """
        for record in map(_name_type, records):
            known = self._find_known(record)
            if known is not None and known is not record and known != record:
                kind = type(record).__name__.lower()
                raise DamageError(f"byte {byte}: expected one {kind} {record.id}, found two")

    def _find_known(self, record: Any) -> Schema | Channel | None:
        if isinstance(record, Schema):
            return self.schemas.get(record.id)
        return self.channels.get(record.id) if isinstance(record, Channel) else None

    def list_reasons(self) -> dict[str, str]:
        """Return the reasons why topics cannot be decoded, by topic in order of names."""
        reasons = {}
        for topic, channels in sorted(self._of_topics.items()):
            if len(channels) == 1:
                reason = self._find_reading(channels[0]).get("reason")
            else:
                reason = self.find_plan(topic).reason
            if reason:
                reasons[topic] = reason
        return reasons

    def find_plan(self, topic: str) -> TopicPlan:
        """Return the plan of a topic, which must be the topic of a channel."""
        if topic not in self._plans:
            self._plans[topic] = self._merge_plans(topic)
        return self._plans[topic]

    def group_channels(self, numbers: Collection[int], byte: int) -> Mapping[str, list[int]]:
        """Return channels by topic.

        Raises:
            DamageError: If a channel is unknown.
        """
        topics: dict[str, list[int]] = {}
        for number in numbers:
            if number not in self.channels:
                raise DamageError(
                    f"byte {byte}: channel {number}: expected its record, found messages only"
                )
            topics.setdefault(self.channels[number].topic, []).append(number)
        return topics

    def _take(self, record: Schema | Channel, byte: int) -> None:
        """Add new schemas and channels."""
        try:
            self.allowance.spend_description(record)
        except LogError as err:
            raise LimitError(f"byte {byte}: {err}") from err
        if isinstance(record, Schema):
            self.schemas[record.id] = record
        else:
            self.channels[record.id] = record
            self._of_topics.setdefault(record.topic, []).append(record)
            self._plans.pop(record.topic, None)

    def _merge_plans(self, topic: str) -> TopicPlan:
        first, *others = [self._plan(channel) for channel in self._of_topics[topic]]
        for plan in others:
            if plan.meaning != first.meaning:
                kinds = " and ".join(sorted({plan.type or "none" for plan in (first, *others)}))
                reason = f"channels of one type expected, found different ones: {kinds}"
                return TopicPlan(topic=topic, type=first.type, reason=reason)
        return first

    def _plan(self, channel: Channel) -> TopicPlan:
        return TopicPlan(topic=channel.topic, **self._find_reading(channel))

    def _find_reading(self, channel: Channel) -> Mapping[str, Any]:
        """Return the fields of a topic's plan except its topic, from schema and encoding."""
        key = channel.schema_id, channel.message_encoding
        reading = self._readings.get(key)
        if reading is None:
            reading = self._choose_reading(*key)
            if channel.schema_id in self.schemas:  # a missing schema may still follow
                self._readings[key] = reading
        return reading

    def _choose_reading(self, number: int, encoding: str) -> dict[str, Any]:
        schema = self.schemas.get(number)
        found = {"type": "" if schema is None else schema.name}
        if encoding not in _SCHEMAS:
            return {**found, "reason": _describe_encoding(encoding)}
        if schema is None:
            return {**found, "reason": "it has no schema"}
        if schema.encoding not in _SCHEMAS[encoding]:
            expected = " or ".join(filter(None, _SCHEMAS[encoding][:2]))
            reason = f"a schema in {expected} expected, found {schema.encoding!r}"
            return {**found, "reason": reason}
        match self._read_type(schema):
            case str(reason):
                return {**found, "reason": reason}
            case MessageType() as described:
                return {
                    **found,
                    "fields": described.fields,
                    "layout": described.layout,
                    "sequence": described.sequence,
                    "is_ros1": encoding == MessageEncoding.ROS1,
                }
            case described:
                return {**found, "json": described.fields, "decode": described.decode}

    def _read_type(self, schema: Schema) -> MessageType | ObjectType | str:
        """Return the message type, or the reason why it cannot be read."""
        if schema.id not in self._types:
            try:
                self._types[schema.id] = _parse(schema, self.allowance)
            except (LogError, UnicodeDecodeError) as err:
                self._types[schema.id] = str(err)
        return self._types[schema.id]


def _name_type(record: Any) -> Any:
    """Return a schema record; a ROS 1 schema gets the ROS 2 name of its type."""
    if not isinstance(record, Schema) or record.encoding != SchemaEncoding.ROS1:
        return record
    from turtlelog.log.engine.ros1_messages import name_as_ros2  # only files of ROS 1 need it

    name = name_as_ros2(record.name)
    return Schema(id=record.id, name=name, encoding=record.encoding, data=record.data)


def _describe_encoding(encoding: str) -> str:
    """Return why messages in an encoding are not read, with advice."""
    read = join_words([*_SCHEMAS])
    if not encoding:
        return f"its messages name no encoding, and turtlelog reads {read}; {_ADVICE}"
    return f"its messages are in the encoding {encoding}, and turtlelog reads {read}; {_ADVICE}"


def _measure(fields: tuple[Field, ...]) -> int:
    return sum(_measure_field(field) * (field.length or 1) for field in fields)


def _measure_field(field: Field) -> int:
    if field.is_sequence:
        return _SEQUENCE
    if isinstance(field.kind, str):
        return _TEXT if field.kind == TEXT else _NUMBER
    return _measure(field.kind)


def _parse(schema: Schema, allowance: Allowance) -> MessageType | ObjectType:
    allowance.spend(FIELDS, int(not allowance.count_left(FIELDS)))
    if schema.encoding in {SchemaEncoding.JSONSchema, SchemaEncoding.Protobuf}:
        described = _describe_objects(schema)
        allowance.spend(FIELDS, len(described.fields))
        return described
    if schema.encoding == SchemaEncoding.ROS1:
        from turtlelog.log.engine.ros1_messages import read_ros1_type  # only ROS 1 files need it

        found = read_ros1_type(schema.name, _read_text(schema, None))
        allowance.spend(FIELDS, found.size)
        return found
    known = find_definition(schema.name)
    try:
        found = read_type(schema.name, _read_text(schema, known))
    except (LogError, UnicodeDecodeError):
        if known is None:
            raise
        found = read_type(schema.name, known)
    allowance.spend(FIELDS, found.size)
    return found


def _describe_objects(schema: Schema) -> ObjectType:
    if schema.encoding == SchemaEncoding.JSONSchema:
        return ObjectType(fields=read_json_schema(schema.name, schema.data))
    from turtlelog.log.engine.protobuf_messages import read_protobuf_type  # only protobuf needs it

    found = read_protobuf_type(schema.name, schema.data)
    return ObjectType(fields=tuple(found.list_fields()), decode=found.decode)


def _read_text(schema: Schema, known: str | None) -> str:
    """Return a definition in `ros2msg`: that of the schema, or else a known definition."""
    size = len(schema.data)
    if size > LONGEST_TEXT:
        raise LogError(f"schema {schema.name}: expected up to {LONGEST_TEXT} bytes, found {size}")
    # In ros2msg the text of a type without fields is empty.
    plain = (SchemaEncoding.ROS2, SchemaEncoding.ROS1)
    if not size and (known is not None or schema.encoding not in plain):
        if known is None:
            raise LogError(f"its type {schema.name} is not known and the file holds no definition")
        return known
    text = schema.data.decode()
    if schema.encoding in plain:
        return text
    from turtlelog.log.engine.idl import convert_idl

    return convert_idl(schema.name, text)
