"""The channels of a file -> its topics, and how the messages of each become columns."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding

from turtlelog.errors import LogError
from turtlelog.log.engine.ends import DamageError
from turtlelog.log.engine.layout import Layout, lay_out
from turtlelog.log.engine.schema import Field, parse_schema

_NO_FIELDS: Final[tuple[Field, ...]] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicPlan:
    """How the messages of a topic are read.

    Attributes:
        topic: Its name.
        type: Of its messages; empty where there is no schema.
        reason: Why they cannot be understood; empty where they can.
        fields: Of the type.
        layout: Of the type; None where its messages differ in size.
    """

    topic: str
    type: str
    reason: str = ""
    fields: tuple[Field, ...] = ()
    layout: Layout | None = None


class Catalogue:
    """The schemas and channels of a file, in the order in which they are found."""

    def __init__(self) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self._plans: dict[str, TopicPlan] = {}

    @property
    def types(self) -> dict[str, str]:
        """Type of the messages, by topic."""
        return {plan.topic: plan.type for plan in self.iterate_plans()}

    def __contains__(self, channel: int) -> bool:
        return channel in self.channels

    def add(self, records: Collection[Any], byte: int) -> None:
        """Take schemas and channels up; records of other kinds are passed over.

        Raises:
            DamageError: Where one differs from another of its id; `byte` is where they stand.
        """
        for record in records:
            if isinstance(record, Schema):
                known: Any = self.schemas.setdefault(record.id, record)
            elif isinstance(record, Channel):
                known = self.channels.setdefault(record.id, record)
                if known is record:
                    self._plans.pop(record.topic, None)
            else:
                continue
            if known != record:
                kind = type(record).__name__.lower()
                raise DamageError(f"byte {byte}: expected one {kind} {record.id}, found two")

    def check(self, records: Collection[Any], byte: int) -> None:
        """Hold schemas and channels against those that are known.

        Raises:
            DamageError: Where one differs.
        """
        known: dict[type, Mapping[int, Any]] = {Schema: self.schemas, Channel: self.channels}
        self.add([found for found in records if found.id in known.get(type(found), {})], byte)

    def iterate_plans(self) -> Iterator[TopicPlan]:
        """Yield the plan of every topic, in order of the topics' names."""
        for topic in sorted({channel.topic for channel in self.channels.values()}):
            yield self.find_plan(topic)

    def find_plan(self, topic: str) -> TopicPlan:
        """Return the plan of a topic that a channel names."""
        if topic not in self._plans:
            self._plans[topic] = self._merge_plans(topic)
        return self._plans[topic]

    def group_channels(self, numbers: Collection[int], byte: int) -> Mapping[str, list[int]]:
        """Return channels by topic.

        Raises:
            DamageError: Where a channel is not known.
        """
        topics: dict[str, list[int]] = {}
        for number in numbers:
            if number not in self.channels:
                raise DamageError(
                    f"byte {byte}: channel {number}: expected its record, found messages only"
                )
            topics.setdefault(self.channels[number].topic, []).append(number)
        return topics

    def _merge_plans(self, topic: str) -> TopicPlan:
        plans = [
            self._plan(channel) for channel in self.channels.values() if channel.topic == topic
        ]
        first = plans[0]
        for plan in plans[1:]:
            if (plan.type, plan.fields, plan.reason) != (first.type, first.fields, first.reason):
                kinds = " and ".join(sorted({plan.type or "none" for plan in plans}))
                reason = f"channels of one type expected, found different ones: {kinds}"
                return TopicPlan(topic=topic, type=first.type, reason=reason)
        return first

    def _plan(self, channel: Channel) -> TopicPlan:
        schema = self.schemas.get(channel.schema_id)
        kind = "" if schema is None else schema.name
        encoding = channel.message_encoding
        reason, fields = "", _NO_FIELDS
        if encoding != MessageEncoding.CDR:
            reason = f"messages in cdr expected, found {encoding!r}"
        elif schema is None:
            reason = "a schema expected, found none"
        elif schema.encoding != SchemaEncoding.ROS2:
            reason = f"a schema in ros2msg expected, found {schema.encoding!r}"
        else:
            fields, reason = _parse(schema)
        layout = None if reason else lay_out(fields)
        return TopicPlan(
            topic=channel.topic, type=kind, reason=reason, fields=fields, layout=layout
        )


def _parse(schema: Schema) -> tuple[tuple[Field, ...], str]:
    """Return the fields, or why there are none."""
    try:
        return parse_schema(schema.name, schema.data.decode()), ""
    except (LogError, UnicodeDecodeError) as err:
        return (), str(err)
