"""Encoding of topic columns as message records, and of messages that differ only in numbers."""

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from struct import Struct
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.cursor import CODES
from turtlelog.log.engine.message_types import (
    LITTLE_ENDIAN,
    TEXT,
    AlikeLayout,
    Column,
    Field,
    Layout,
    lay_out_alike,
    name_parts,
    read_type,
)
from turtlelog.log.engine.records import HEADING_FIELDS, RECORD
from turtlelog.log.engine.topic_columns import TopicColumns

FRONT: Final = Struct("<BQHIQQ4s")
"""Front of a record: opcode, length, channel, sequence, log and publish time, encapsulation."""

_HEAD: Final = np.dtype([*HEADING_FIELDS, ("encapsulation", "u1", (4,))])
"""The same bytes as a row of an array."""

ENCAPSULATION: Final = b"\x00\x01\x00\x00"
"""Encapsulation of plain CDR, little-endian."""

_PACKERS: Final = MappingProxyType({kind: Struct(f"<{code}") for kind, code in CODES.items()})


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
        ends: End of each record in `data` [bytes], shape (n,).
    """

    schema: Schema
    channel: Channel
    log_time_ns: Numbers
    data: NDArray[np.uint8]
    sizes: Numbers
    ends: Numbers


@dataclass(frozen=True, slots=True)
class PackedItems:
    """Items of a sequence, encoded one after another from a multiple of 8 bytes on."""

    count: int
    data: bytes


def encode_records(columns: TopicColumns, schema: Schema, channel: Channel) -> ChannelRecords:
    """Return the messages of a topic as records in order of log time.

    The columns may have any order of time. Missing fields are 0 or empty.

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
        schema=schema,
        channel=channel,
        log_time_ns=columns.log_time_ns,
        data=data,
        sizes=sizes,
        ends=np.cumsum(sizes),
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
    heads["length"] = FRONT.size - RECORD.size + layout.size
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
    fields: tuple[Field, ...], values: Mapping[str, Any], channel: int, stamp: tuple[int, int, int]
) -> bytes:
    """Return the record of one message; `stamp` is its sequence, log and publish time [ns].

    Values have dotted names, like a row of `TopicColumns`. Missing values are 0 or empty.

    Raises:
        struct.error, TypeError, ValueError: If a value does not have the kind of its field.
    """
    body = bytearray()
    _append_fields(body, fields, values, "")
    length = FRONT.size - RECORD.size + len(body)
    return FRONT.pack(Opcode.MESSAGE, length, channel, *stamp, ENCAPSULATION) + body


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
