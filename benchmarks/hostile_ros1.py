"""Hostile bags of ROS 1 and protobuf: chunks, messages and types that claim more than there is."""

import bz2
import struct
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import lz4.frame  # type: ignore[import-untyped]

from benchmarks.put_files import Make, put_file
from tests.torture.bombs import (
    CHANNEL,
    MIB,
    SCHEMA,
    chunk as mcap_chunk,
    message,
    record,
    text,
    whole,
)

_START: Final = b"#ROSBAG V2.0\n"
_TWIST: Final = "geometry_msgs/Twist"
_DEFINITION: Final = (
    "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n"
    + "=" * 80
    + "\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n"
)
_POSE: Final = (
    "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n"
    + "=" * 80
    + "\nMSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
    + "=" * 80
    + "\nMSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
)


def _pack(fields: Mapping[str, bytes], data: bytes = b"") -> bytes:
    parts = [name.encode() + b"=" + value for name, value in fields.items()]
    header = b"".join(struct.pack("<I", len(part)) + part for part in parts)
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def _connect(number: int = 0, *, topic: str = "/pose", kind: str = "geometry_msgs/Pose",
             definition: str = _POSE) -> bytes:  # fmt: skip
    fields = {"type": kind.encode(), "md5sum": b"*", "message_definition": definition.encode()}
    head = {"op": b"\x07", "conn": struct.pack("<I", number), "topic": topic.encode()}
    return _pack(head, _pack(fields)[4:-4])


def _say(row: int, data: bytes = bytes(48) + struct.pack("<d", 1.0), number: int = 0) -> bytes:
    time = struct.pack("<II", 1_000_000 + row // 1000, row % 1000 * 1_000_000)
    return _pack({"op": b"\x02", "conn": struct.pack("<I", number), "time": time}, data)


def _chunk(data: bytes, compression: str = "bz2") -> bytes:
    packed = bz2.compress(data) if compression == "bz2" else lz4.frame.compress(data)
    size = struct.pack("<I", len(data))
    return _pack({"op": b"\x05", "compression": compression.encode(), "size": size}, packed)


def _pad(size: int) -> bytes:
    """Return a record of an index, which makes a file larger."""
    return _pack({"op": b"\x04"}, bytes(size))


def _bag(*records: bytes) -> bytes:
    body = b"".join(records)
    head = {"op": b"\x03", "index_pos": bytes(8)}
    head["index_pos"] = struct.pack("<Q", len(_START) + len(_pack(head)) + len(body))
    return _START + _pack(head) + body


def _many_messages() -> bytes:
    chunks = [
        _chunk(b"".join(_say(100_000 * part + row) for row in range(100_000))) for part in range(10)
    ]
    return _bag(_connect(), *chunks)


def _protobuf(types: int, width: int) -> bytes:
    """Return a file whose types hold each other, ten times each."""

    def pack(number: int, data: bytes) -> bytes:
        size, length = len(data), b""
        while True:
            length += bytes([size & 0x7F | (0x80 if size > 0x7F else 0)])
            size >>= 7
            if not size:
                return bytes([number << 3 | 2]) + length + data

    def field(number: int, of: str) -> bytes:
        kind = b"\x28\x0b" if of else b"\x28\x01"
        named = pack(6, of.encode()) if of else b""
        return pack(2, pack(1, f"f{number}".encode()) + bytes([0x18, number]) + kind + named)

    messages = b"".join(
        pack(
            4,
            pack(1, f"T{level}".encode())
            + b"".join(field(n + 1, f".p.T{level - 1}" if level else "") for n in range(width)),
        )
        for level in range(types)
    )
    found = pack(1, pack(2, b"p") + messages)
    kind = text(f"p.T{types - 1}") + text("protobuf")
    front = record(SCHEMA, struct.pack("<H", 1) + kind + text(found))
    front += record(
        CHANNEL, struct.pack("<HH", 1, 1) + text("/pose") + text("protobuf") + text(b"")
    )
    return whole(mcap_chunk([front, message(1, b"\x0a" * 1000, 1)]), front)


def _put(make: object) -> Make:
    return put_file("file.bag", make)  # type: ignore[arg-type]


FILES: Final[Mapping[str, Make]] = MappingProxyType(
    {
        "ros1: bz2 of 2 GB of zeros": _put(
            lambda: _bag(_connect(), *[_chunk(bytes(64 * MIB))] * 32)
        ),
        "ros1: bz2 of 40 MB in one record": _put(
            lambda: _bag(_connect(), _chunk(_say(0, bytes(40 * MIB))), _pad(9_500_000))
        ),
        "ros1: lz4 of 40 MB in one record": _put(
            lambda: _bag(_connect(), _chunk(_say(0, bytes(40 * MIB)), "lz4"), _pad(9_500_000))
        ),
        "ros1: 1 M messages": _put(_many_messages),
        "ros1: 300,000 messages of 9 MB": _put(
            lambda: _bag(
                _connect(kind="std_msgs/Int8", definition="int8 data"),
                b"".join(_say(row, b"1") for row in range(150_000)),
            )
        ),
        "ros1: 60,000 connections": _put(
            lambda: _bag(
                b"".join(
                    _connect(n, topic=f"/t{n}", kind="a/B", definition="int8 d")
                    for n in range(65_000)
                )
            )
        ),
        "ros1: 65,600 connections": _put(
            lambda: _bag(
                b"".join(
                    _connect(n, topic="/t", kind="a/B", definition="int8 d") for n in range(65_600)
                )
            )
        ),
        "ros1: 9,000 definitions of 1 kB": _put(
            lambda: _bag(
                b"".join(
                    _connect(n, topic=f"/t{n}", kind=f"a/B{n}", definition="int8 d\n" * 130)
                    for n in range(9000)
                )
            )
        ),
        "ros1: a list of 4 G items": _put(
            lambda: _bag(
                _connect(
                    kind="geometry_msgs/PoseArray",
                    definition="Pose[] poses\n" + "=" * 80 + "\nMSG: geometry_msgs/Pose\nint8 a\n",
                ),
                _say(0, b"\xff" * 4),
            )
        ),
        "ros1: 2 M empty items": _put(
            lambda: _bag(
                _connect(
                    kind="a/PoseList",
                    definition="std_msgs/Empty[] list\n" + "=" * 80 + "\nMSG: std_msgs/Empty\n",
                ),
                _say(0, struct.pack("<I", 4_000_000) + bytes(4_000_000)),
            )
        ),
        "ros1: a header of 2 GB": _put(lambda: _bag(struct.pack("<I", 2**31 - 1) + bytes(100))),
        "ros1: 9 MB of records of nothing": _put(lambda: _bag(_pack({"op": b"\x04"}) * 600_000)),
        "protobuf: types of 10 to the 9": put_file("file.mcap", lambda: _protobuf(10, 10)),
        "protobuf: 60 types within types": put_file("file.mcap", lambda: _protobuf(70, 1)),
        "kitti: 40,000 rows": put_file("file.txt", lambda: "1 0 0 0 0 1 0 0 0 0 1 0\n" * 400_000),
    }
)
"""By name."""
