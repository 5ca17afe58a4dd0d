"""File -> columns, topic by topic.

The one place that walks over messages: a faster engine would replace these two functions.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from typing import Any, Final

import numpy as np
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk

from turtlelog.errors import LogError, describe_error
from turtlelog.log.cdr import Column, decode_columns
from turtlelog.log.integrity import check_ends
from turtlelog.log.topics import TOPICS, Topic

_LARGEST_CHUNK: Final = 2**30  # bytes; a damaged header may claim anything


@dataclass(frozen=True, slots=True, kw_only=True)
class Contents:
    """What a recording holds.

    Attributes:
        metadata: Records by name.
        attachments: Bytes by name.
        messages: By topic, in the order of the file.
        types: Message type by topic.
    """

    metadata: Mapping[str, Mapping[str, str]]
    attachments: Mapping[str, bytes]
    messages: Mapping[str, list[Message]]
    types: Mapping[str, str]


def read_contents(data: bytes) -> Contents:
    """Return what an MCAP file holds, checksums checked.

    Raises:
        LogError: Where the file is no MCAP, or is damaged.
    """
    check_ends(BytesIO(data))
    found: dict[type[McapRecord], list[Any]] = defaultdict(list)
    for record in _iterate_records(data):
        found[type(record)].append(record)
    schemas = {schema.id: schema.name for schema in found[Schema]}
    channels = {channel.id: channel for channel in found[Channel]}
    messages: dict[str, list[Message]] = defaultdict(list)
    types: dict[str, str] = {}
    for message in found[Message]:
        if message.channel_id not in channels:
            raise LogError(
                f"channel {message.channel_id}: expected its record, found messages only"
            )
        channel = channels[message.channel_id]
        messages[channel.topic].append(message)
        types[channel.topic] = schemas.get(channel.schema_id, "no type")
    return Contents(
        metadata={record.name: record.metadata for record in found[Metadata]},
        attachments={record.name: record.data for record in found[Attachment]},
        messages=messages,
        types=types,
    )


def build_columns(contents: Contents) -> Mapping[str, Mapping[str, Column]]:
    """Return the columns of every topic in `TOPICS` by its name; empty ones without messages.

    They are the fields of the messages, and `log_time` [ns], in order of time.

    Raises:
        LogError: Where a message is not of the topic's type.
    """
    return {
        topic.name: _build_columns(
            topic, contents.types.get(topic.name), contents.messages.get(topic.name, [])
        )
        for topic in TOPICS
    }


def _iterate_records(data: bytes) -> Iterator[McapRecord]:
    """Yield all records in the order of the file; damage is named by its chunk."""
    chunk = 0
    for record in StreamReader(BytesIO(data), emit_chunks=True, validate_crcs=True).records:
        if not isinstance(record, Chunk):
            yield record
            continue
        chunk += 1
        if record.uncompressed_size > _LARGEST_CHUNK:
            size = record.uncompressed_size
            raise LogError(f"chunk {chunk}: expected up to {_LARGEST_CHUNK} bytes, found {size}")
        try:
            inner = breakup_chunk(record, validate_crc=True)
        except Exception as err:
            found = describe_error(err)
            raise LogError(f"chunk {chunk}: expected sound data, found {found}") from err
        yield from inner


def _build_columns(
    topic: Topic, schema: str | None, messages: list[Message]
) -> Mapping[str, Column]:
    if schema not in {None, topic.schema}:
        raise LogError(f"topic {topic.name}: expected {topic.schema}, found {schema}")
    log_time = np.array([message.log_time for message in messages], dtype=np.int64)
    try:
        columns = decode_columns(topic.schema, [message.data for message in messages])
    except LogError as err:
        raise LogError(f"topic {topic.name}: {err}") from err
    columns["log_time"] = log_time
    if (np.diff(log_time) < 0).any():
        order = np.argsort(log_time, kind="stable")
        columns = {name: values[order] for name, values in columns.items()}
    return columns
