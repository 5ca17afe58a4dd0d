"""Which schema and channel an id of a file means, and its id in a file that is written from it."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from mcap.records import Channel, Schema

from turtlelog.errors import LogError
from turtlelog.log.engine.limits import Allowance

_MOST_IDS: Final = 2**16 - 1

Pair = tuple[Schema | None, Channel]
"""A channel, and its schema if it has one."""


class Numbering:
    """Ids of one file -> ids of another. They stay as they are, unless one means two things.

    Attributes:
        schemas: By id there, as it is meant at this place of the file; with the id here.
        channels: By id there: the channel with its schema, both with the ids here.
        first_schemas: By id there, the first of each as it stands there.
        first_channels: The same.
    """

    def __init__(
        self,
        schemas: Mapping[int, Schema],
        channels: Mapping[int, Channel],
        allowance: Allowance,
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
        for schema in schemas.values():
            self.add_schema(schema)
        for channel in channels.values():
            self.add_channel(channel)

    def add_schema(self, schema: Schema) -> None:
        """Let an id mean a schema from here on."""
        self.first_schemas.setdefault(schema.id, schema)
        key = (schema.id, schema.name, schema.encoding, schema.data)
        if key not in self._known_schemas:
            self._allowance.spend_description(schema)
            number = self._taken_schemas.choose(schema.id)
            is_same = number == schema.id
            self._known_schemas[key] = schema if is_same else replace(schema, id=number)
        self.schemas[schema.id] = self._known_schemas[key]

    def add_channel(self, channel: Channel) -> None:
        """Let an id mean a channel from here on."""
        self.first_channels.setdefault(channel.id, channel)
        if channel.schema_id and channel.schema_id not in self.schemas:
            self._awaited.add(channel.schema_id)
        self.channels[channel.id] = self._number(channel)

    def is_news(self, channel: Channel) -> bool:
        """Return whether an id that has a meaning would get another."""
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
            is_same = (number, schema_id) == (channel.id, channel.schema_id)
            numbered = channel if is_same else replace(channel, id=number, schema_id=schema_id)
            self._known_channels[key] = schema, numbered
        return self._known_channels[key]


class _Ids:
    """Ids that are taken."""

    def __init__(self, *, least: int) -> None:
        self._least, self._greatest = least, _MOST_IDS
        self._taken: set[int] = set()

    def choose(self, wanted: int) -> int:
        """Take the id as it is, or the greatest free one: the least may be wanted later."""
        number = wanted
        if wanted < self._least or wanted in self._taken:
            while self._greatest in self._taken:
                self._greatest -= 1
            number = self._greatest
        if number < 1 and number != wanted:
            raise LogError(f"expected up to {_MOST_IDS} schemas and channels, found more")
        self._taken.add(number)
        return number
