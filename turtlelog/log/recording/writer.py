"""Columns -> file, all at once: a run's, or those of anybody's topics."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Final

from turtlelog.errors import LogError
from turtlelog.log.channels import describe_topics
from turtlelog.log.complete_files import replace_when_complete
from turtlelog.log.container import McapFile, pack_chunk
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.interleaving import ChannelRecords, cut_chunks
from turtlelog.log.recording.declaration import define_types
from turtlelog.log.recording.head import HEAD, describe_run, format_head, format_scenario_file
from turtlelog.log.recording.run_writer import build_messages
from turtlelog.log.recording.schemas import SCHEMAS
from turtlelog.log.records import encode_records
from turtlelog.run import Run
from turtlelog.scenario import DEFAULT_LAW

_NOTHING: Final[Mapping[str, Mapping[str, str]]] = MappingProxyType({})
_NO_FILES: Final[Mapping[str, bytes]] = MappingProxyType({})


def write_recording(run: Run, path: str | Path) -> None:
    """Write a run as an MCAP file; the same run gives the same bytes.

    Raises:
        LogError: Where the place cannot be written, or the run holds what a recording cannot.
    """
    try:
        topics = build_messages(run)
        head, scenario = format_head(describe_run(run)), format_scenario_file(run)
    except (LogError, UnicodeEncodeError) as err:
        raise _name_error(path, err) from err
    definitions = define_types(run.declaration, run.parameters.get("law.kind", DEFAULT_LAW))
    write_columns(
        topics, path, definitions=definitions, metadata={HEAD: head}, attachments=scenario
    )


def write_columns(
    topics: Sequence[TopicColumns],
    path: str | Path,
    *,
    definitions: Mapping[str, str] = SCHEMAS,
    metadata: Mapping[str, Mapping[str, str]] = _NOTHING,
    attachments: Mapping[str, bytes] = _NO_FILES,
) -> None:
    """Write topics as an MCAP file in order of log time; the same columns give the same bytes.

    Args:
        topics: As `read_columns` returns them; a field left out is 0 or empty. Messages of one
            time stand in the order of the topics.
        path: The file, replaced when all is written.
        definitions: The `ros2msg` text of every message type that occurs.
        metadata: Metadata records by name.
        attachments: Attached files by name.

    Raises:
        LogError: Where the place cannot be written, or a column does not fit its type.
    """
    try:
        channels = list(_encode_topics(topics, definitions))
        with replace_when_complete(path) as temporary, temporary.open("wb") as stream:
            file = McapFile(stream)
            file.begin()
            for name, entries in metadata.items():
                file.add_metadata(name, entries)
            for name, data in attachments.items():
                file.add_attachment(name, data)
            for rows in cut_chunks(channels):
                file.add_chunk(pack_chunk(rows))
            file.finish()
    except (LogError, UnicodeEncodeError) as err:
        raise _name_error(path, err) from err


def _encode_topics(
    topics: Sequence[TopicColumns], definitions: Mapping[str, str]
) -> Iterator[ChannelRecords]:
    names = [columns.topic for columns in topics]
    for name in names:
        if names.count(name) > 1:
            raise LogError(f"topic {name}: expected once, found {names.count(name)} times")
    channels = describe_topics([(columns.topic, columns.type) for columns in topics], definitions)
    for columns, (schema, channel) in zip(topics, channels, strict=True):
        try:
            records = encode_records(columns, definitions[columns.type], channel.id)
        except LogError as err:
            raise LogError(f"topic {columns.topic}: {err}") from err
        yield ChannelRecords(schema=schema, channel=channel, records=records)


def _name_error(path: str | Path, err: Exception) -> LogError:
    if isinstance(err, UnicodeEncodeError):
        return LogError(f"{path}: expected text, found characters that UTF-8 lacks: {err}")
    # What cannot be written is named already.
    text = str(err)
    return LogError(text if text.startswith(f"{path}: ") else f"{path}: {text}")
