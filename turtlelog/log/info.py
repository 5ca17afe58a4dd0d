"""What is in a file, without reading its messages."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from mcap.reader import McapReader, make_reader
from mcap.records import Channel, Message, Schema
from mcap.stream_reader import StreamReader
from mcap.summary import Summary

from turtlelog.log.border import name_file
from turtlelog.log.head import (
    HEAD,
    PARAMETER_FILE,
    SCENARIO_FILE,
    parse_head,
    parse_scenario_file,
)
from turtlelog.log.integrity import check_ends
from turtlelog.run import Parameter
from turtlelog.scenario import flatten_tables


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicInfo:
    """One topic of a file: its name, the type of its messages, how many there are."""

    topic: str
    type: str
    count: int


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingInfo:
    """What is in a file.

    Attributes:
        file: Its path, as given.
        format_version: Of the recording, None where turtlelog did not write it.
        source: As in `Run`; `mcap` where turtlelog did not write it.
        name: As in `Run`; otherwise the file's name.
        complete: Whether the file was finished; one that was not is refused so far.
        stop_reason: As in `Run`.
        duration_s: First to last message [s], None where there is no message.
        scenario: The tables of the whole scenario, None where it is not known.
        parameters: What is known of the scenario, by dotted key.
        topics: By name.
        absent: As in `Run`.
        notes: As in `Run`.
    """

    file: str
    format_version: int | None
    source: str
    name: str
    complete: bool
    stop_reason: str | None = None
    duration_s: float | None
    scenario: Mapping[str, Any] | None = None
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    topics: tuple[TopicInfo, ...]
    absent: tuple[str, ...] = ()
    notes: Mapping[str, str] = field(default_factory=dict)


def read_info(path: str | Path) -> RecordingInfo:
    """Return what is in an MCAP file, whoever wrote it, from its summary where it has one.

    Raises:
        LogError: Where it cannot be read, is no MCAP file, or is damaged.
    """
    with name_file(path, expected="an MCAP file"), Path(path).open("rb") as stream:
        check_ends(stream)
        reader = make_reader(stream, validate_crcs=True)
        duration_s, topics = _list_topics(reader.get_summary(), stream)
        head = next((found for found in reader.iter_metadata() if found.name == HEAD), None)
        if head is None:
            return RecordingInfo(
                file=str(path),
                format_version=None,
                source="mcap",
                name=Path(path).stem,
                complete=True,
                duration_s=duration_s,
                topics=topics,
            )
        return _build_info(str(path), head.metadata, _find_attachment(reader), duration_s, topics)


def _build_info(
    file: str,
    record: Mapping[str, str],
    attachments: Mapping[str, bytes],
    duration_s: float | None,
    topics: tuple[TopicInfo, ...],
) -> RecordingInfo:
    head = parse_head(record)
    tables, is_complete = parse_scenario_file(attachments)
    return RecordingInfo(
        file=file,
        format_version=head.format_version,
        source=head.source,
        name=head.name,
        complete=True,
        stop_reason=head.stop_reason,
        duration_s=duration_s,
        scenario=tables if is_complete else None,
        parameters=flatten_tables(tables),
        topics=topics,
        absent=head.absent,
        notes=head.notes,
    )


def _find_attachment(reader: McapReader) -> dict[str, bytes]:
    for attachment in reader.iter_attachments():
        if attachment.name in {SCENARIO_FILE, PARAMETER_FILE}:
            return {attachment.name: attachment.data}
    return {}


def _list_topics(
    summary: Summary | None, stream: IO[bytes]
) -> tuple[float | None, tuple[TopicInfo, ...]]:
    """Return duration and topics; without statistics the messages have to be counted."""
    if summary is None or summary.statistics is None or not summary.channels:
        return _count_messages(stream)
    statistics = summary.statistics
    duration_s = None
    if statistics.message_count:
        duration_s = (statistics.message_end_time - statistics.message_start_time) / 1e9
    counts = Counter(statistics.channel_message_counts)
    types = {number: schema.name for number, schema in summary.schemas.items()}
    return duration_s, _name_topics(summary.channels, types, counts)


def _count_messages(stream: IO[bytes]) -> tuple[float | None, tuple[TopicInfo, ...]]:
    channels: dict[int, Channel] = {}
    types: dict[int, str] = {}
    counts: Counter[int] = Counter()
    span_ns: tuple[int, int] | None = None
    stream.seek(0)
    for record in StreamReader(stream, validate_crcs=True).records:
        if isinstance(record, Schema):
            types[record.id] = record.name
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message):
            counts[record.channel_id] += 1
            start_ns, end_ns = span_ns or (record.log_time, record.log_time)
            span_ns = min(start_ns, record.log_time), max(end_ns, record.log_time)
    duration_s = None if span_ns is None else (span_ns[1] - span_ns[0]) / 1e9
    return duration_s, _name_topics(channels, types, counts)


def _name_topics(
    channels: Mapping[int, Channel], types: Mapping[int, str], counts: Counter[int]
) -> tuple[TopicInfo, ...]:
    """Return the topics by name; channels of one topic and type are one."""
    merged: Counter[tuple[str, str]] = Counter()
    for number, channel in channels.items():
        merged[channel.topic, types.get(channel.schema_id, "")] += counts[number]
    return tuple(
        TopicInfo(topic=topic, type=kind, count=count)
        for (topic, kind), count in sorted(merged.items())
    )
