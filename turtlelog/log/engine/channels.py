"""The topics of a file from its channels, the decoding of their messages, and known definitions."""

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any, Final

from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding

from turtlelog.display import join_words
from turtlelog.errors import LogError
from turtlelog.log.engine.limits import FIELDS, Allowance
from turtlelog.log.engine.message_types import (
    LONGEST_TEXT,
    NUMBER_SIZE,
    ROW_HEAD,
    TEXT_SIZE,
    Field,
    Layout,
    find_definition,
    read_type,
)
from turtlelog.log.engine.object_messages import (
    JsonField,
    read_json_schema,
    read_protobuf_type,
)
from turtlelog.log.file_access import DamageError, LimitError

_SCHEMAS: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        # A message type without a schema encoding has no text; its name must suffice.
        MessageEncoding.CDR: (SchemaEncoding.ROS2, "ros2idl", "omgidl", ""),
        MessageEncoding.JSON: (SchemaEncoding.JSONSchema,),
        MessageEncoding.ROS1: (SchemaEncoding.ROS1,),
        MessageEncoding.Protobuf: (SchemaEncoding.Protobuf,),
    }
)
"""Encodings of schemas by the encoding of their messages; each belongs to one."""

_NUMBERS: Final = frozenset({"boolean", "integer", "number"})

Decode = Callable[[int, bytes], dict[str, Any]]
"""A function from the number and the bytes of a message to an object. Errors contain the number."""


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
        row_size: Memory per message [bytes]; long texts and sequences need more.
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
    row_size: int = 0

    def describe_reason(self) -> str:
        """Return the topic with the reason why its messages cannot be decoded, for errors."""
        return describe_unread(self.topic, self.reason)

    @property
    def meaning(self) -> object:
        """Properties that all channels of one topic must share."""
        return self.type, self.fields, self.json, self.is_ros1, self.reason


def measure_object(fields: Iterable[JsonField]) -> int:
    """Return the memory per message of these fields [bytes]; long texts and sequences need more."""
    sizes = (NUMBER_SIZE if field.kind in _NUMBERS else TEXT_SIZE for field in fields)
    return ROW_HEAD + sum(sizes)


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
            if self._find_known(record) is not None:
                self.check((record,), byte)
                continue
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
            if len(channels) == 1:  # a reading takes less time than a plan
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
        """Return channels by topic."""
        topics: dict[str, list[int]] = {}
        for number in numbers:
            if number not in self.channels:
                raise DamageError(
                    f"byte {byte}: channel {number}: expected its record, found messages only"
                )
            topics.setdefault(self.channels[number].topic, []).append(number)
        return topics

    def _merge_plans(self, topic: str) -> TopicPlan:
        first, *others = [
            TopicPlan(topic=topic, **self._find_reading(channel))
            for channel in self._of_topics[topic]
        ]
        for plan in others:
            if plan.meaning != first.meaning:
                kinds = " and ".join(sorted({plan.type or "none" for plan in (first, *others)}))
                reason = f"channels of one type expected, found different ones: {kinds}"
                return TopicPlan(topic=topic, type=first.type, reason=reason)
        return first

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
        found: dict[str, Any] = {"type": "" if schema is None else schema.name}
        if encoding not in _SCHEMAS:
            named = f"are in the encoding {encoding}" if encoding else "name no encoding"
            reason = (
                f"its messages {named}, and turtlelog reads {join_words([*_SCHEMAS])}; record the"
                " topic in one of these"
            )
        elif schema is None:
            reason = "it has no schema"
        elif schema.encoding not in _SCHEMAS[encoding]:
            expected = " or ".join(filter(None, _SCHEMAS[encoding][:2]))
            reason = f"a schema in {expected} expected, found {schema.encoding!r}"
        else:
            try:
                return found | _read_schema(schema, self.allowance)
            except (LogError, UnicodeDecodeError) as err:
                reason = str(err)
        return {**found, "reason": reason}


_MOST_REASONS: Final = 3
"""Largest number of topics that an error lists with their reasons."""

EVER: Final = 2**64
"""A log time after all others [ns]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """The requested messages.

    Attributes:
        topics: Names of the topics to read. None: every topic that can be decoded.
        start_ns: Earliest log time [ns], inclusive.
        end_ns: End of the log time [ns], exclusive.
        is_lenient: Whether named topics may be missing or undecodable. All chunks are then read and
            checked.
        is_flat: Whether only numbers and texts are allowed as fields. Sequences of texts or
            messages take some hundred times their bytes in memory.
        is_counted: Whether the memory of rows is limited in proportion to the file's size.
        kept: Columns to keep, by topic, including the log time. Topics that are not listed keep all
            columns.
    """

    topics: frozenset[str] | None = None
    start_ns: int = 0
    end_ns: int = EVER
    is_lenient: bool = False
    is_flat: bool = False
    is_counted: bool = False
    kept: Mapping[str, Collection[str]] = field(default_factory=dict)

    @property
    def is_ever(self) -> bool:
        """Whether no message is left out because of its time."""
        return self.start_ns <= 0 and self.end_ns >= EVER

    def choose_plans(self, catalogue: Catalogue) -> dict[str, TopicPlan]:
        """Return the plans of the requested topics that are known so far."""
        known = catalogue.topics
        names = sorted(known if self.topics is None else self.topics.intersection(known))
        plans = ((topic, self.choose_plan(catalogue, topic)) for topic in names)
        return {topic: plan for topic, plan in plans if plan is not None}

    def choose_plan(self, catalogue: Catalogue, topic: str) -> TopicPlan | None:
        """Return the plan of a topic; None if it is not requested."""
        if self.topics is not None and topic not in self.topics:
            return None
        plan = catalogue.find_plan(topic)
        if plan.reason and self.topics is not None and not self.is_lenient:
            raise LogError(plan.describe_reason())
        if self.is_flat and plan.sequence is not None:
            raise LogError(
                f"topic {topic}: expected fields of numbers and texts, found the sequence"
                f" {plan.sequence}"
            )
        if self.is_flat and plan.json is not None:
            flat = tuple(field for field in plan.json if field.kind != "any")
            plan = replace(plan, json=flat, row_size=measure_object(flat))
        return None if plan.reason else plan

    def require_topics(self, catalogue: Catalogue) -> None:
        """Check that every topic requested by name exists, or that any topic can be decoded."""
        if self.topics is None and not self.is_lenient:
            plans = [catalogue.find_plan(topic) for topic in sorted(catalogue.topics)]
            if plans and all(plan.reason for plan in plans):
                raise LogError("; ".join(plan.describe_reason() for plan in plans[:_MOST_REASONS]))
        missing = (self.topics or frozenset()).difference(catalogue.topics)
        for topic in () if self.is_lenient else sorted(missing):
            raise LogError(f"topic {topic}: expected it in the file, found no such topic")


def _name_type(record: Any) -> Any:
    """Return a schema record; a ROS 1 schema gets the ROS 2 name of its type."""
    if not isinstance(record, Schema) or record.encoding != SchemaEncoding.ROS1:
        return record
    from turtlelog.log.ros1 import name_as_ros2  # only files of ROS 1 need it

    name = name_as_ros2(record.name)
    return Schema(id=record.id, name=name, encoding=record.encoding, data=record.data)


def _read_schema(schema: Schema, allowance: Allowance) -> dict[str, Any]:
    """Return the fields of a plan that follow from a schema alone."""
    allowance.spend(FIELDS, int(not allowance.count_left(FIELDS)))
    objects, decode = None, None
    if schema.encoding == SchemaEncoding.JSONSchema:
        objects = read_json_schema(schema.name, schema.data)
    elif schema.encoding == SchemaEncoding.Protobuf:
        kind = read_protobuf_type(schema.name, schema.data)
        objects, decode = tuple(kind.list_fields()), kind.decode
    if objects is not None:
        allowance.spend(FIELDS, len(objects))
        return {"json": objects, "decode": decode, "row_size": measure_object(objects)}
    is_ros1 = schema.encoding == SchemaEncoding.ROS1
    if is_ros1:
        from turtlelog.log.ros1 import read_ros1_type  # only ROS 1 files need it

        found = read_ros1_type(schema.name, _read_text(schema, None))
    else:
        known = find_definition(schema.name)
        try:
            found = read_type(schema.name, _read_text(schema, known))
        except (LogError, UnicodeDecodeError):
            if known is None:
                raise
            found = read_type(schema.name, known)
    allowance.spend(FIELDS, found.size)
    return {
        "fields": found.fields,
        "layout": found.layout,
        "sequence": found.sequence,
        "is_ros1": is_ros1,
        "row_size": found.row_size,
    }


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
