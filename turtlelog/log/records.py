"""The columns of a topic -> message records: whole columns at once where the type has one size."""

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from struct import Struct
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.columns import TopicColumns
from turtlelog.log.engine.message_types import (
    LITTLE_ENDIAN,
    TEXT,
    Column,
    Field,
    Layout,
    name_parts,
    read_type,
)

HEAD: Final = struct.Struct("<BQHIQQ4s")
"""Before the fields: opcode, length, channel, sequence, log and publish time, encapsulation."""

ENCAPSULATION: Final = b"\x00\x01\x00\x00"
"""Plain CDR, little-endian."""

UNCOUNTED: Final = 9
"""Bytes at the front of a record that its length does not count."""

CODES: Final = MappingProxyType(
    {"?": "?", "f4": "f", "f8": "d"}
    | {"i1": "b", "i2": "h", "i4": "i", "i8": "q"}
    | {"u1": "B", "u2": "H", "u4": "I", "u8": "Q"}
)
"""How `struct` names the numbers that a field may hold, little-endian."""

_PACKERS: Final = MappingProxyType({kind: Struct(f"<{code}") for kind, code in CODES.items()})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Records:
    """The message records of one channel, in order of log time.

    Attributes:
        log_time_ns: Of each [ns], shape (n,), not decreasing.
        data: The records one after the other, shape (bytes,).
        sizes: Of each [bytes], shape (n,).
    """

    log_time_ns: NDArray[np.int64]
    data: NDArray[np.uint8]
    sizes: NDArray[np.int64]


def encode_records(columns: TopicColumns, definition: str, channel: int) -> Records:
    """Return the messages of a topic as records in order of log time.

    Args:
        columns: In any order of time; a field left out is 0 or empty.
        definition: Of their type, as `ros2msg`.
        channel: The number that the records carry.

    Raises:
        LogError: Where a column is not one of the type, has another length, or does not fit.
    """
    kind = read_type(columns.type, definition)
    fields, layout = kind.fields, kind.layout
    known = dict.fromkeys(_name_fields(fields, ""))
    for name in columns.fields:
        if name not in known:
            raise LogError(f"{name}: expected a field of {columns.type}: {', '.join(known)}")
    lengths = {"publish_time_ns": len(columns.publish_time_ns), "sequence": len(columns.sequence)}
    lengths |= {name: len(values) for name, values in columns.fields.items()}
    for name, rows in lengths.items():
        if rows != len(columns):
            raise LogError(f"{name}: expected {len(columns)} rows, found {rows}")
    columns = _sort(columns)
    stamps = {
        "log_time": _fit("log_time_ns", columns.log_time_ns, "<u8"),
        "publish_time": _fit("publish_time_ns", columns.publish_time_ns, "<u8"),
        "sequence": _fit("sequence", columns.sequence, "<u4"),
    }
    if layout is None:
        data, sizes = _encode_varied(fields, columns.fields, stamps, channel)
    else:
        records = _encode_fixed(layout, columns.fields, stamps, channel)
        data, sizes = records.view(np.uint8), np.full(len(columns), records.itemsize)
    return Records(log_time_ns=columns.log_time_ns, data=data, sizes=sizes)


def _sort(columns: TopicColumns) -> TopicColumns:
    times = columns.log_time_ns
    if (np.diff(times) >= 0).all():
        return columns
    order = np.argsort(times, kind="stable")
    return replace(
        columns,
        log_time_ns=times[order],
        publish_time_ns=columns.publish_time_ns[order],
        sequence=columns.sequence[order],
        fields={name: values[order] for name, values in columns.fields.items()},
    )


def _encode_fixed(
    layout: Layout, columns: Mapping[str, Column], stamps: Mapping[str, Column], channel: int
) -> NDArray[np.void]:
    rows = len(stamps["log_time"])
    records = np.zeros(rows, dtype=layout.little)
    records["#opcode"], records["#length"] = Opcode.MESSAGE, records.itemsize - UNCOUNTED
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


def _encode_varied(
    fields: tuple[Field, ...],
    columns: Mapping[str, Column],
    stamps: Mapping[str, Column],
    channel: int,
) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Encode message by message; texts are rarely many."""
    data, sizes = bytearray(), []
    times = zip(*(values.tolist() for values in stamps.values()), strict=True)
    for row, (log_time, publish_time, sequence) in enumerate(times):
        try:
            body = encode_fields(fields, {name: values[row] for name, values in columns.items()})
        except UnicodeEncodeError:
            raise
        except (struct.error, TypeError, ValueError, AttributeError) as err:
            raise LogError(f"row {row}: expected values of the type's kinds, found: {err}") from err
        length = HEAD.size - UNCOUNTED + len(body)
        stamp = (sequence, log_time, publish_time)
        data += HEAD.pack(Opcode.MESSAGE, length, channel, *stamp, ENCAPSULATION) + body
        sizes.append(UNCOUNTED + length)
    return np.frombuffer(data, np.uint8), np.array(sizes, dtype=np.int64)


def _fit(name: str, values: Column, kind: str) -> Column:
    """Return numbers of a kind; whole ones must fit, what 32 bits cannot hold becomes inf."""
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


def encode_fields(fields: tuple[Field, ...], values: Mapping[str, Any]) -> bytes:
    """Return the bytes of one message behind its encapsulation.

    Args:
        fields: Of the message type.
        values: By dotted name, as a row of `TopicColumns`; one left out is 0 or empty.

    Raises:
        struct.error, TypeError, ValueError: Where a value is not of its field's kind.
    """
    body = bytearray()
    _append_fields(body, fields, values, "")
    return bytes(body)


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
