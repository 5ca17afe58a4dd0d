"""Hostile MCAP files: attachments, metadata, chunks, types and messages whose lengths lie."""

import json
import struct
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

import lz4.frame  # type: ignore[import-untyped]

from benchmarks.hostile_mcap import make_poses
from benchmarks.put_files import Make, put_file
from tests.torture.bombs import (
    ATTACHMENT,
    CHUNK,
    POSE,
    attachment,
    channel,
    chunk,
    cut,
    describe,
    message,
    metadata,
    record,
    schema,
    text,
    whole,
)
from turtlelog.log.recording.topics import SCHEMAS

_ESCAPES: Final = "\x1b]0;owned\x07\x1b[2J\u202e\r\nturtlelog: error"


def _poses() -> bytes:
    return chunk([describe("/turtle1/pose"), make_poses(1000)])


def _claim_attachments() -> bytes:
    body = struct.pack("<QQ", 0, 0) + text("a") + text("") + struct.pack("<Q", 2**60) + bytes(100)
    return cut(_poses() + record(ATTACHMENT, body) * 1000)


def _long_table() -> bytes:
    table = b"".join(text(str(number)) + text("c") for number in range(400_000))
    return whole(_poses() + metadata("a", table))


def _claim_chunks(compression: str, claimed: int, packed: bytes, count: int) -> bytes:
    """Chunks that say that they unpack to more than there is."""
    head = struct.pack("<QQQI", 0, 10, claimed, 0) + text(compression)
    return cut(_poses() + record(CHUNK, head + struct.pack("<Q", len(packed)) + packed) * count)


def _zstd_frame() -> bytes:
    """Return the head of a frame that says that it unpacks to 2^60 bytes."""
    return b"\x28\xb5\x2f\xfd\xe0" + struct.pack("<Q", 2**60) + bytes(20)


def _define(definition: str) -> bytes:
    return whole(chunk([describe("/a", kind="a/T0", definition=definition), message(1, bytes(64))]))


def _nest_arrays() -> str:
    bar = "=" * 80
    parts = [f"{bar}\nMSG: a/T{n}\nT{n + 1}[65535] a\n" for n in range(1, 8)]
    return "T1[65535] a\n" + "".join(parts) + f"{bar}\nMSG: a/T8\nint8 x\n"


def _claim_frames() -> bytes:
    """Poses whose frames claim a name of 4 GB."""
    front = describe("/pose", kind="geometry_msgs/msg/PoseStamped", definition="")
    said = b"\0\1\0\0" + struct.pack("<III", 0, 0, 2**32 - 1) + bytes(64)
    return whole(chunk([front, *(message(1, said, n * 10**7) for n in range(50_000))]))


def _long_frames() -> bytes:
    """Odometry whose frames have names of 400 letters."""
    front = describe("/odom", kind="nav_msgs/msg/Odometry", definition="")
    name = struct.pack("<I", 401) + b"a" * 400 + bytes(4)
    said = b"\0\1\0\0" + struct.pack("<II", 0, 0) + name + struct.pack("<I", 1) + bytes(720)
    return whole(chunk([front, *(message(1, said, n * 10**7) for n in range(60_000))]))


def _escapes() -> bytes:
    """Names that would move the cursor of a terminal, and set its title."""
    topics = [
        schema(1, POSE, SCHEMAS[POSE]),
        channel(1, f"/turtle1/pose{_ESCAPES}"),
        channel(2, f"/b{_ESCAPES}", 0, text(f"k{_ESCAPES}") + text(_ESCAPES)),
    ]
    notes = metadata(f"m{_ESCAPES}", text(_ESCAPES) + text(_ESCAPES)) + attachment(_ESCAPES, b"x")
    return whole(chunk([*topics, make_poses(100)]) + notes)


def _many_keys() -> bytes:
    names = [f"k{number}" for number in range(60_000)]
    known = {"type": "object", "properties": {name: {"type": "number"} for name in names}}
    body = struct.pack("<H", 1) + text("a/B") + text("jsonschema") + text(json.dumps(known))
    topic = struct.pack("<HH", 1, 1) + text("/a") + text("json") + text("")
    said = json.dumps({f"k{number}": number for number in range(300_000)}).encode()
    return whole(chunk([record(3, body), record(4, topic), message(1, said)]))


def _jump() -> bytes:
    """Poses of which the second half comes a century later."""
    pose = b"\0\1\0\0" + bytes(20)
    times = [n * 16_000_000 + (3 * 10**18 if n > 1000 else 0) for n in range(2000)]
    return whole(chunk([describe("/turtle1/pose"), *(message(1, pose, time) for time in times)]))


FILES: Final[Mapping[str, Make]] = MappingProxyType(
    {
        f"mcap: {name}": put_file("file.mcap", make)
        for name, make in {
            "1,000 attachments that claim 2^60 bytes": _claim_attachments,
            "200,000 attachments": lambda: whole(_poses() + attachment("", b"") * 200_000),
            "metadata of 400,000 entries": _long_table,
            "chunk that claims 2^40 bytes": lambda: _claim_chunks("", 2**40, make_poses(100), 1),
            "lz4 that claims 2^31 bytes": lambda: _claim_chunks(
                "lz4", 2**31 - 1, lz4.frame.compress(bytes(2**24)), 20
            ),
            "zstd that claims 2^60 bytes": lambda: _claim_chunks("zstd", 1000, _zstd_frame(), 2000),
            "arrays of 2^31": lambda: _define("float64[2147483647] a\n" * 100),
            "arrays of arrays": lambda: _define(_nest_arrays()),
            "200,000 constants": lambda: _define(
                "".join(f"int32 A{n}={n}\n" for n in range(200_000)) + "int8 x\n"
            ),
            "constant of 9 MB": lambda: _define(f"string A={'a' * 9_000_000}\nint8 x\n"),
            "default of 900,000 numbers": lambda: _define(f"int32[] a [{'1,' * 900_000}1]\n"),
            "frames that claim 2^32 letters": _claim_frames,
            "60,000 poses with frames of 400 letters": _long_frames,
            "escapes in names": _escapes,
            "JSON of 300,000 keys": _many_keys,
            "jump by a century": _jump,
        }.items()
    }
)
"""By name."""
