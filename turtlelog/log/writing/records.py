"""Encoding of topic columns as message records, and division into chunks by time."""

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from struct import Struct
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.framing import RECORD
from turtlelog.log.engine.message_types import (
    LITTLE_ENDIAN,
    TEXT,
    Column,
    Field,
    Layout,
    name_parts,
    read_type,
)
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.writing.alike_messages import AlikeLayout, PackedItems, lay_out_alike

HEAD: Final = struct.Struct("<BQHIQQ4s")
"""Front of a record: opcode, length, channel, sequence, log and publish time, encapsulation."""

_HEAD: Final = np.dtype(
    [
        *(("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4")),
        *(("log_time", "<u8"), ("publish_time", "<u8"), ("encapsulation", "u1", (4,))),
    ]
)
"""The same bytes as a row of an array."""

ENCAPSULATION: Final = b"\x00\x01\x00\x00"
"""Encapsulation of plain CDR, little-endian."""

CODES: Final = MappingProxyType(
    {"?": "?", "f4": "f", "f8": "d"}
    | {"i1": "b", "i2": "h", "i4": "i", "i8": "q"}
    | {"u1": "B", "u2": "H", "u4": "I", "u8": "Q"}
)
"""`struct` codes of little-endian numbers in fields."""

_PACKERS: Final = MappingProxyType({kind: Struct(f"<{code}") for kind, code in CODES.items()})


CHUNK_BYTES: Final = 2**20
"""Largest chunk in a file that is written at once, without schemas and channels [bytes]."""

Numbers = NDArray[np.int64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChannelRecords:
    """The message records of one channel, in order of log time.

    Attributes:
        schema: Schema of the channel.
        channel: Channel of the records.
        log_time_ns: Log time of each record [ns], shape (n,), not decreasing.
        data: The records one after the other, shape (bytes,).
        sizes: Size of each record [bytes], shape (n,).
    """

    schema: Schema
    channel: Channel
    log_time_ns: Numbers
    data: NDArray[np.uint8]
    sizes: Numbers


@dataclass(frozen=True, slots=True, kw_only=True)
class ChunkRows:
    """The messages of one chunk.

    Attributes:
        channels: Channels of the messages, with their schemas, if any.
        records: Message records, one after the other.
        index: By channel number: log time [ns] and offset in `records` of each message, shape (n,
            2).
        start_ns: Least log time [ns].
        end_ns: Greatest log time [ns].
    """

    channels: Sequence[tuple[Schema | None, Channel]]
    records: bytes | bytearray | memoryview
    index: Mapping[int, NDArray[np.uint64]]
    start_ns: int
    end_ns: int


def merge_chunks(chunks: Sequence[ChunkRows]) -> ChunkRows:
    """Merge chunks into one chunk. A channel number must have the same meaning in all chunks."""
    if len(chunks) == 1:
        return chunks[0]
    channels: dict[int, tuple[Schema | None, Channel]] = {}
    index: dict[int, list[NDArray[np.uint64]]] = {}
    size = 0
    for chunk in chunks:
        channels |= {channel.id: (schema, channel) for schema, channel in chunk.channels}
        for number, entries in chunk.index.items():
            moved = entries + np.array([0, size], np.uint64)
            index.setdefault(number, []).append(moved)
        size += len(chunk.records)
    return ChunkRows(
        channels=[*channels.values()],
        records=b"".join(chunk.records for chunk in chunks),
        index={number: np.concatenate(entries) for number, entries in index.items()},
        start_ns=min(chunk.start_ns for chunk in chunks),
        end_ns=max(chunk.end_ns for chunk in chunks),
    )


def encode_records(columns: TopicColumns, schema: Schema, channel: Channel) -> ChannelRecords:
    """Return the messages of a topic as records in order of log time.

    Args:
        columns: Columns in any order of time. Missing fields are 0 or empty.
        schema: Schema of the type, as `ros2msg`.
        channel: Channel of the topic.

    Raises:
        LogError: If a column is not a field of the type, has another length, or does not fit its
            field.
    """
    kind = read_type(columns.type, schema.data.decode())
    fields, layout = kind.fields, kind.layout
    has_rows = layout is None and len(columns) > 0
    alike = lay_out_alike(fields, columns.fields) if has_rows else None
    known = dict.fromkeys(_name_fields(fields, ""))
    known |= {} if alike is None else dict.fromkeys(alike.names)
    for name in columns.fields:
        if name not in known:
            raise LogError(f"{name}: expected a field of {columns.type}: {', '.join(known)}")
    lengths = {"publish_time_ns": len(columns.publish_time_ns), "sequence": len(columns.sequence)}
    lengths |= {name: len(values) for name, values in columns.fields.items()}
    for name, rows in lengths.items():
        if rows != len(columns):
            raise LogError(f"{name}: expected {len(columns)} rows, found {rows}")
    if (np.diff(columns.log_time_ns) < 0).any():
        columns = columns.select(np.argsort(columns.log_time_ns, kind="stable"))
    stamps = {
        "log_time": _fit("log_time_ns", columns.log_time_ns, "<u8"),
        "publish_time": _fit("publish_time_ns", columns.publish_time_ns, "<u8"),
        "sequence": _fit("sequence", columns.sequence, "<u4"),
    }
    if alike is not None:
        data, sizes = _encode_alike(alike, columns.fields, stamps, channel.id)
    elif layout is None:
        data, sizes = _encode_varied(fields, columns.fields, stamps, channel.id)
    else:
        records = _encode_fixed(layout, columns.fields, stamps, channel.id)
        data, sizes = records.view(np.uint8), np.full(len(columns), records.itemsize)
    return ChannelRecords(
        schema=schema, channel=channel, log_time_ns=columns.log_time_ns, data=data, sizes=sizes
    )


def _encode_fixed(
    layout: Layout, columns: Mapping[str, Column], stamps: Mapping[str, Column], channel: int
) -> NDArray[np.void]:
    rows = len(stamps["log_time"])
    records = np.zeros(rows, dtype=layout.little)
    records["#opcode"], records["#length"] = Opcode.MESSAGE, records.itemsize - RECORD.size
    records["#channel"], records["#encapsulation"] = channel, LITTLE_ENDIAN
    for name, values in stamps.items():
        records[f"#{name}"] = values
    for name, values in columns.items():
        column = layout.little[name]
        if values.shape[1:] != column.shape:
            shape = (rows, *column.shape)
            raise LogError(f"{name}: expected shape {shape}, found {values.shape}")
        records[name] = _fit(name, values, column.base.str)
    return records


def _encode_alike(
    layout: AlikeLayout, columns: Mapping[str, Column], stamps: Mapping[str, Column], channel: int
) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Encode messages that differ only in numbers."""
    rows = len(stamps["log_time"])
    numbers = {
        name: _fit(name, columns[name], f"<{kind.replace('?', 'u1')}")
        for name, kind, *_ in layout.numbers
        if name in columns
    }
    heads = np.zeros(rows, dtype=_HEAD)
    heads["opcode"], heads["channel"] = Opcode.MESSAGE, channel
    heads["length"] = HEAD.size - RECORD.size + layout.size
    heads["encapsulation"] = np.frombuffer(ENCAPSULATION, np.uint8)
    for name, values in stamps.items():
        heads[name] = values
    found = np.concatenate(
        [heads.view(np.uint8).reshape(rows, -1), layout.fill(rows, numbers)], axis=1
    )
    return found.reshape(-1), np.full(rows, found.shape[1], dtype=np.int64)


def _encode_varied(
    fields: tuple[Field, ...],
    columns: Mapping[str, Column],
    stamps: Mapping[str, Column],
    channel: int,
) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Encode messages one by one, because messages with texts are rarely many."""
    data, sizes = bytearray(), []
    times = zip(*(values.tolist() for values in stamps.values()), strict=True)
    for row, (log_time, publish_time, sequence) in enumerate(times):
        values = {name: column[row] for name, column in columns.items()}
        try:
            record = encode_message(fields, values, channel, (sequence, log_time, publish_time))
        except UnicodeEncodeError:
            raise
        except (struct.error, TypeError, ValueError, AttributeError) as err:
            raise LogError(f"row {row}: expected values of the type's kinds, found: {err}") from err
        data += record
        sizes.append(len(record))
    return np.frombuffer(data, np.uint8), np.array(sizes, dtype=np.int64)


def _fit(name: str, values: Column, kind: str) -> Column:
    """Return numbers of a kind. Integers must fit; floats beyond 32 bits become inf."""
    target, is_whole = np.dtype(kind), values.dtype.kind in "iub"
    if not is_whole and (values.dtype.kind != "f" or target.kind != "f"):
        expected = "numbers" if target.kind == "f" else "whole numbers"
        raise LogError(f"{name}: expected {expected}, found {values.dtype}")
    if target.kind != "f" and values.size:
        limits = np.iinfo(target)
        for value in (int(values.min()), int(values.max())):
            if not limits.min <= value <= limits.max:
                raise LogError(
                    f"{name}: expected values from {limits.min} to {limits.max}, found {value}"
                )
    with np.errstate(over="ignore"):
        return values.astype(target, copy=False)


def _name_fields(fields: tuple[Field, ...], prefix: str) -> Iterator[str]:
    for field in fields:
        if isinstance(field.kind, str) or field.is_sequence:
            yield prefix + field.name
        else:
            for part in name_parts(field):
                yield from _name_fields(field.kind, f"{prefix}{part}.")


def encode_message(
    fields: tuple[Field, ...],
    values: Mapping[str, Any],
    channel: int,
    stamp: tuple[int, int, int],
) -> bytes:
    """Return the record of one message.

    Args:
        fields: Fields of the message type.
        values: Values by dotted name, like a row of `TopicColumns`. Missing values are 0 or empty.
        channel: Channel number of the record.
        stamp: Sequence, log time and publish time [ns].

    Raises:
        struct.error, TypeError, ValueError: If a value does not have the kind of its field.
    """
    body = bytearray()
    _append_fields(body, fields, values, "")
    length = HEAD.size - RECORD.size + len(body)
    return HEAD.pack(Opcode.MESSAGE, length, channel, *stamp, ENCAPSULATION) + body


def _append_fields(
    body: bytearray, fields: tuple[Field, ...], values: Mapping[str, Any], prefix: str
) -> None:
    for field in fields:
        if not isinstance(field.kind, str) and not field.is_sequence:
            for part in name_parts(field):
                _append_fields(body, field.kind, values, f"{prefix}{part}.")
            continue
        value = values.get(prefix + field.name)
        if field.is_sequence or field.length is not None:
            _append_items(body, field, value)
        else:
            _append_item(body, field.kind, value)
    if not fields:  # ROS gives a type without fields one byte
        body.append(0)


def _append_items(body: bytearray, field: Field, items: Any) -> None:
    if isinstance(items, PackedItems):
        _append_item(body, "u4", items.count)
        body += bytes(-len(body) % 8) + items.data
        return
    if items is None:
        items = [None] * (field.length or 0)
    if field.is_sequence:
        _append_item(body, "u4", len(items))
    elif len(items) != field.length:
        raise ValueError(f"{field.name}: {len(items)} values instead of {field.length}")
    for item in items:
        _append_item(body, field.kind, item)


def _append_item(body: bytearray, kind: str | tuple[Field, ...], value: Any) -> None:
    if not isinstance(kind, str):
        _append_fields(body, kind, value, "")
    elif kind == TEXT:
        text = ("" if value is None else value).encode() + b"\x00"
        _append_item(body, "u4", len(text))
        body += text
    else:
        packer = _PACKERS[kind]
        body += bytes(-len(body) % packer.size)
        body += packer.pack(0 if value is None else value)


def cut_chunks(channels: Sequence[ChannelRecords]) -> Iterator[ChunkRows]:
    """Yield chunks of all records in order of log time; at equal times, channel by channel.

    The records of each channel are in order of log time. A record larger than a chunk gets its own.
    """
    filled = [content for content in channels if len(content.sizes)]
    if not filled:
        return
    times = np.concatenate([content.log_time_ns for content in filled])
    sizes = np.concatenate([content.sizes for content in filled])
    order = np.argsort(times, kind="stable")
    ends, times = np.cumsum(sizes[order]), times[order]
    starts = np.empty_like(ends)
    starts[order] = ends - sizes[order]
    placed = list(_split(filled, starts))
    for first, last in _find_borders(ends):
        start = int(ends[first - 1]) if first else 0
        yield _fill_chunk(placed, start, int(ends[last]), (int(times[first]), int(times[last])))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Placed:
    """The records of a channel, with their offsets in the stream of all channels [bytes]."""

    content: ChannelRecords
    starts: Numbers
    ends_in_data: Numbers


def _split(channels: Sequence[ChannelRecords], starts: Numbers) -> Iterator[_Placed]:
    first = 0
    for content in channels:
        sizes = content.sizes
        own = starts[first : first + len(sizes)]
        yield _Placed(content=content, starts=own, ends_in_data=np.cumsum(sizes))
        first += len(sizes)


def _find_borders(ends: Numbers) -> Iterator[tuple[int, int]]:
    """Yield the first row of every chunk, and the row after its last."""
    first, start = 0, 0
    while first < len(ends):
        after = int(np.searchsorted(ends, start + CHUNK_BYTES, side="right"))
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
        times = content.log_time_ns[first:after]
        index[content.channel.id] = np.column_stack([times, places]).astype(np.uint64)
        channels.append((content.schema, content.channel))
    return ChunkRows(
        channels=channels, records=buffer, index=index, start_ns=times_ns[0], end_ns=times_ns[1]
    )


def _scatter(buffer: bytearray, places: Numbers, channel: _Placed, first: int, after: int) -> None:
    """Copy rows [first, after) of a channel to their offsets."""
    sizes = channel.content.sizes[first:after]
    begin = int(channel.ends_in_data[first] - sizes[0])
    data = channel.content.data[begin : int(channel.ends_in_data[after - 1])]
    size = int(sizes[0])
    if (sizes == size).all():
        # A view makes a row start at every byte of the buffer, so all rows are copied in one step.
        rows = len(buffer) - size + 1
        view = np.ndarray((rows,), f"V{size}", buffer=buffer, strides=(1,))
        view[places] = data.view(f"V{size}")
        return
    within = np.arange(len(data)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    np.frombuffer(buffer, np.uint8)[np.repeat(places, sizes) + within] = data
