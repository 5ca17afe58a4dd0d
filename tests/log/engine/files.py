"""MCAP files for the reader, written by the mcap library, and CDR bytes packed value by value."""

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, IndexType, Writer

CODES = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
POINT = "float64 x\nfloat64 y\n"


@dataclass(frozen=True, kw_only=True)
class Row:
    """One message as it goes into a file."""

    topic: str
    time_ns: int
    data: bytes
    sequence: int = 0


def pack(values: Iterable[tuple[str, Any]], order: str = "<") -> bytes:
    """Return the CDR message of numbers and texts, one by one, each aligned to its size."""
    body = bytearray()
    for kind, value in values:
        if kind == "string":
            text = value.encode() + b"\0"
            body += bytes(-len(body) % 4) + struct.pack(f"{order}I", len(text)) + text
        else:
            number = struct.pack(order + CODES[kind], value)
            body += bytes(-len(body) % len(number)) + number
    return (b"\0\1\0\0" if order == "<" else b"\0\0\0\0") + bytes(body)


def write_rows(
    path: Path,
    schemas: dict[str, tuple[str, str]],
    rows: Sequence[Row],
    *,
    compression: CompressionType = CompressionType.ZSTD,
    chunk_size: int = 2**20,
    **options: Any,
) -> Path:
    """Write messages in this order; `schemas` says type and definition by topic."""
    with path.open("wb") as stream:
        writer = Writer(
            stream,
            chunk_size,
            compression,
            index_types=options.pop("index_types", IndexType.CHUNK | IndexType.MESSAGE),
            enable_data_crcs=options.pop("enable_data_crcs", options.get("enable_crcs", True)),
            **options,
        )
        writer.start(profile="ros2")
        channels = {}
        for topic, (kind, text) in schemas.items():
            schema = writer.register_schema(kind, "ros2msg", text.encode())
            channels[topic] = writer.register_channel(topic, "cdr", schema)
        for row in rows:
            channel = channels[row.topic]
            writer.add_message(channel, row.time_ns, row.data, row.time_ns + 1, row.sequence)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def write_points(path: Path, times_ns: Sequence[int], **options: Any) -> Path:
    """Write points (i, 2 i) on topic /p at these times, numbered in this order."""
    rows = [
        Row(
            topic="/p",
            time_ns=time_ns,
            data=pack([("float64", number), ("float64", 2 * number)]),
            sequence=number,
        )
        for number, time_ns in enumerate(times_ns)
    ]
    return write_rows(path, {"/p": ("test/msg/Point", POINT)}, rows, **options)
