"""The columns of topics -> one file: their records in order of time, in chunks."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Final

import numpy as np
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.complete_files import replace_when_complete
from turtlelog.log.container import ChunkRows, McapFile
from turtlelog.log.engine.columns import TopicColumns
from turtlelog.log.recording.topics import SCHEMAS, describe_topics
from turtlelog.log.records import Records, encode_records

_NOTHING: Final[Mapping[str, Mapping[str, str]]] = MappingProxyType({})
_NO_FILES: Final[Mapping[str, bytes]] = MappingProxyType({})

CHUNK_BYTES: Final = 2**20
"""What a chunk of a file that is written at once may hold, schemas and channels not counted."""

Numbers = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChannelRecords:
    """A channel with its schema and its records, in order of log time."""

    schema: Schema
    channel: Channel
    records: Records


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Placed:
    """The records of a channel, and where each goes in the stream of all channels [bytes]."""

    content: ChannelRecords
    starts: Numbers
    ends_in_data: Numbers


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
                file.add_chunk(rows)
            file.finish()
    except (LogError, UnicodeEncodeError) as err:
        raise name_write_error(path, err) from err


def cut_chunks(
    channels: Sequence[ChannelRecords], *, chunk_bytes: int = CHUNK_BYTES
) -> Iterator[ChunkRows]:
    """Yield the chunks of all records in order of log time; those of one time channel by channel.

    Args:
        channels: With their records in order of log time.
        chunk_bytes: What a chunk may hold; one larger record makes a chunk of its own.
    """
    filled = [content for content in channels if len(content.records.sizes)]
    if not filled:
        return
    times = np.concatenate([content.records.log_time_ns for content in filled])
    sizes = np.concatenate([content.records.sizes for content in filled])
    order = np.argsort(times, kind="stable")
    ends, times = np.cumsum(sizes[order]), times[order]
    starts = np.empty_like(ends)
    starts[order] = ends - sizes[order]
    placed = list(_split(filled, starts))
    for first, last in _find_borders(ends, chunk_bytes):
        start = int(ends[first - 1]) if first else 0
        yield _fill_chunk(placed, start, int(ends[last]), (int(times[first]), int(times[last])))


def name_write_error(path: str | Path, err: Exception) -> LogError:
    """Return an error of what cannot be written, with the file's name."""
    if isinstance(err, UnicodeEncodeError):
        return LogError(f"{path}: expected text, found characters that UTF-8 lacks: {err}")
    # What cannot be written is named already.
    text = str(err)
    return LogError(text if text.startswith(f"{path}: ") else f"{path}: {text}")


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


def _split(channels: Sequence[ChannelRecords], starts: Numbers) -> Iterator[_Placed]:
    first = 0
    for content in channels:
        sizes = content.records.sizes
        own = starts[first : first + len(sizes)]
        yield _Placed(content=content, starts=own, ends_in_data=np.cumsum(sizes))
        first += len(sizes)


def _find_borders(ends: Numbers, chunk_bytes: int) -> Iterator[tuple[int, int]]:
    """Yield the first and the last row of every chunk."""
    first, start = 0, 0
    while first < len(ends):
        after = int(np.searchsorted(ends, start + chunk_bytes, side="right"))
        last = max(after - 1, first)
        yield first, last
        first, start = last + 1, int(ends[last])


def _fill_chunk(
    placed: Sequence[_Placed], start: int, end: int, times_ns: tuple[int, int]
) -> ChunkRows:
    buffer = bytearray(end - start)
    index, channels = {}, []
    for channel in placed:
        first, after = np.searchsorted(channel.starts, (start, end)).tolist()
        if first == after:
            continue
        places = channel.starts[first:after] - start
        _scatter(buffer, places, channel, first, after)
        content = channel.content
        times = content.records.log_time_ns[first:after]
        index[content.channel.id] = np.column_stack([times, places]).astype(np.uint64)
        channels.append((content.schema, content.channel))
    return ChunkRows(
        channels=channels, records=buffer, index=index, start_ns=times_ns[0], end_ns=times_ns[1]
    )


def _scatter(buffer: bytearray, places: Numbers, channel: _Placed, first: int, after: int) -> None:
    """Copy rows [first, after) of a channel to their places."""
    sizes = channel.content.records.sizes[first:after]
    begin = int(channel.ends_in_data[first] - sizes[0])
    data = channel.content.records.data[begin : int(channel.ends_in_data[after - 1])]
    size = int(sizes[0])
    if (sizes == size).all():
        # The view lets every byte of the buffer start a row: all rows go in one step.
        rows = len(buffer) - size + 1
        view = np.ndarray((rows,), f"V{size}", buffer=buffer, strides=(1,))
        view[places] = data.view(f"V{size}")
        return
    within = np.arange(len(data)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    np.frombuffer(buffer, np.uint8)[np.repeat(places, sizes) + within] = data
