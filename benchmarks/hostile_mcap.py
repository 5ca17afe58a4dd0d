"""Hostile MCAP files: indexes, names, types, chunks and messages that claim more than there is."""

import json
import struct
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final

import zstandard

from benchmarks.put_files import Make, put_file
from tests.torture.bombs import (
    CHUNK_INDEX,
    INDEX,
    MIB,
    POSE as POSE_TYPE,
    STATISTICS,
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
from turtlelog.log.recording.head import CHECKSUM, sum_up_record
from turtlelog.log.recording.topics import SCHEMAS


def make_poses(count: int, *, step_ns: int = 16_000_000) -> bytes:
    """Return poses that stand still, each a step later than the one before."""
    pose = b"\0\1\0\0" + bytes(20)
    return b"".join(message(1, pose, number * step_ns) for number in range(count))


def _mcap(make: Callable[[], bytes]) -> Make:
    return put_file("file.mcap", make)


def _chunk_indexes() -> bytes:
    """Many entries of the summary that all name one chunk, which unpacks to 60 MB."""
    front = describe("/turtle1/pose")
    body = chunk([front, make_poses(2000), record(0x80, bytes(60 * MIB))])
    start = 8 + 9 + 12
    data_size = struct.unpack_from("<Q", body, 9 + 28 + 8)[0]
    unpacked = struct.unpack_from("<Q", body, 9 + 16)[0]
    entry = struct.pack("<QQQQ", 0, 2000 * 16_000_000, start, len(body)) + struct.pack("<I", 0)
    entry += struct.pack("<Q", 0) + text("zstd") + struct.pack("<QQ", data_size, unpacked)
    return whole(body, front + record(CHUNK_INDEX, entry) * 90_000)


def _statistics_lie(messages: int) -> bytes:
    front = describe("/turtle1/pose")
    body = chunk([front, make_poses(2000)])
    start = 8 + 9 + 12
    data_size = struct.unpack_from("<Q", body, 9 + 28 + 8)[0]
    unpacked = struct.unpack_from("<Q", body, 9 + 16)[0]
    entry = struct.pack("<QQQQ", 0, 2000 * 16_000_000, start, len(body)) + struct.pack("<I", 0)
    entry += struct.pack("<Q", 0) + text("zstd") + struct.pack("<QQ", data_size, unpacked)
    counts = struct.pack("<HQ", 1, messages)
    said = struct.pack("<QHIIIIQQI", messages, 1, 1, 0, 0, 1, 0, 2**62, len(counts)) + counts
    return whole(body, front + record(CHUNK_INDEX, entry) + record(STATISTICS, said))


def _long_names() -> bytes:
    """Schemas whose names are long and all of one letter."""
    name = "a" * 100_000
    schemas = (schema(number, name, "") for number in range(1, 16_000))
    return cut(chunk([describe("/a")]) + b"".join(chunk([part]) for part in schemas))


def _long_encodings() -> bytes:
    encoding = text("c" * 100_000)
    found = (
        record(4, struct.pack("<HH", number, 1) + text("/a") + encoding + text(""))
        for number in range(2, 16_000)
    )
    return cut(chunk([describe("/a")]) + b"".join(chunk([part]) for part in found))


def _define(definition: str, kind: str = "a/T0", encoding: str = "ros2msg") -> bytes:
    body = struct.pack("<H", 1) + text(kind) + text(encoding) + text(definition)
    front = record(3, body) + channel(1, "/a")
    return whole(chunk([front, message(1, bytes(64))]))


def _doubled(depth: int) -> str:
    bar = "=" * 80
    parts = [f"{bar}\nMSG: a/T{n}\nT{n + 1} a\nT{n + 1} b\n" for n in range(1, depth)]
    return "T1 a\nT1 b\n" + "".join(parts) + f"{bar}\nMSG: a/T{depth}\nint8 x\n"


def _claim_sequences() -> bytes:
    """Paths whose messages each claim 4 billion poses."""
    kind = "nav_msgs/msg/Path"
    definition = "uint8[] a\nstring[] b\nfloat64[] c\n"
    said = b"\0\1\0\0" + struct.pack("<I", 2**32 - 1) + bytes(12)
    messages = b"".join(message(1, said, number) for number in range(200_000))
    return whole(chunk([describe("/a", kind=kind, definition=definition), messages]))


def _claim_sizes() -> bytes:
    """Poses in a type with a text, whose lengths are right, of messages of many sizes."""
    definition = "string s\nuint8[] b\n"
    rows = b"".join(
        message(
            1,
            b"\0\1\0\0" + struct.pack("<I", 1) + bytes(4) + struct.pack("<I", n % 9) + bytes(n % 9),
            n,
        )
        for n in range(1_500_000)
    )
    return whole(chunk([describe("/a", kind="a/B", definition=definition), rows]))


def _json_messages(definition: str, said: str, count: int = 1) -> bytes:
    body = struct.pack("<H", 1) + text("a/B") + text("jsonschema") + text(definition)
    found = struct.pack("<HH", 1, 1) + text("/a") + text("json") + text("")
    return whole(chunk([record(3, body), record(4, found), message(1, said.encode()) * count]))


def _doubled_objects(depth: int) -> str:
    """Objects that each refer to the next one twice; the last one is empty."""
    parts: dict[str, Any] = {f"a{depth}": {"properties": {}}, "$ref": "#/a0"}
    for number in range(depth):
        inner = {"$ref": f"#/a{number + 1}"}
        parts[f"a{number}"] = {"properties": {"x": inner, "y": inner}}
    return json.dumps(parts)


def _long_numbers() -> bytes:
    names = [f"/robot{'9' * 5000}{number}/pose" for number in (1, 2)]
    pose = b"\0\1\0\0" + bytes(20)
    rows = (message(1 + n % 2, pose, n * 16_000_000) for n in range(200))
    return whole(chunk([describe(*names), *rows]))


def _own_recording(scenario: bytes = b"", **entries: str) -> bytes:
    """Return a recording of turtlelog with a scenario and some entries of its head changed."""
    head = {"format_version": "1", "source": "simulation", "name": "hostile", "absent": "[]"}
    head |= {"nan_columns": "[]", "notes": "{}"} | entries
    head[CHECKSUM] = sum_up_record(head)
    table = b"".join(text(key) + text(value) for key, value in head.items())
    data = chunk([describe("/turtle1/pose"), make_poses(100)])
    return whole(data + metadata("turtlelog", table) + attachment("scenario.toml", scenario))


def _many_poses(count: int) -> bytes:
    front = describe("/turtle1/pose")
    part = 100_000
    pose = b"\0\1\0\0" + bytes(20)
    chunks = []
    for start in range(0, count, part):
        rows = b"".join(message(1, pose, n * 2**20) for n in range(start, min(start + part, count)))
        chunks.append(chunk([front, rows]))
    return whole(b"".join(chunks))


def _paths(count: int, poses: int) -> bytes:
    """Plans of many poses, which all are zeros."""
    kind = "nav_msgs/msg/Path"
    one = b"\0\1\0\0" + bytes(8) + struct.pack("<I", 1) + bytes(4) + struct.pack("<I", poses)
    said = one + bytes(poses * 72 - 4)
    front = schema(2, kind, "") + channel(2, "/plan", 2)
    rows = b"".join(message(2, said, n) for n in range(count))
    return whole(chunk([describe("/turtle1/pose"), make_poses(1000)]) + chunk([front, rows]))


def _strings(count: int) -> bytes:
    said = b"\0\1\0\0" + struct.pack("<I", 60 * MIB) + bytes(60 * MIB)
    front = describe("/a", kind="std_msgs/msg/String", definition="string data\n")
    poses = chunk([schema(2, POSE_TYPE, SCHEMAS[POSE_TYPE]), channel(2, "/turtle1/pose", 2)])
    return whole(poses + b"".join(chunk([front, message(1, said, n)]) for n in range(count)))


def _transforms(count: int) -> bytes:
    """One message of transforms, each of a child of its own."""
    kind = "tf2_msgs/msg/TFMessage"
    one = bytes(8) + struct.pack("<I", 5) + b"base\0" + bytes(3)
    row = one + struct.pack("<I", 5) + b"link\0" + bytes(3) + bytes(56)
    said = b"\0\1\0\0" + struct.pack("<I", count) + row * count
    front = describe("/tf", kind=kind, definition="")
    return whole(chunk([front, *(message(1, said, n) for n in range(10))]))


def _lone_transforms(count: int) -> bytes:
    """Messages of one transform, of frames by turns: chains that a tree is made of."""
    kind = "tf2_msgs/msg/TFMessage"

    def link(number: int) -> bytes:
        names = [f"{(number + more) % 500:04}".encode() + b"\0" for more in (0, 1)]
        head = struct.pack("<III", 1, 0, 0) + struct.pack("<I", 5) + names[0] + bytes(3)
        return (
            b"\0\1\0\0"
            + head
            + struct.pack("<I", 5)
            + names[1]
            + bytes(3 + 4 + 48)
            + bytes(6)
            + b"\xf0\x3f"
        )

    front = describe("/tf", kind=kind, definition="")
    rows = [message(1, link(number), number) for number in range(count)]
    return whole(
        b"".join(chunk([front, *rows[at : at + 100_000]]) for at in range(0, count, 100_000))
    )


def _packed_twice() -> bytes:
    one = chunk([record(0x80, bytes(60 * MIB))])
    packer = zstandard.ZstdCompressor(level=3)
    return packer.compress(cut(chunk([describe("/turtle1/pose"), make_poses(10)]) + one * 20_000))


def _empty_frames() -> bytes:
    packer = zstandard.ZstdCompressor()
    first = packer.compress(cut(chunk([describe("/turtle1/pose"), make_poses(100)])))
    return first + packer.compress(b"") * 1_080_000


def _many_topics(count: int) -> bytes:
    topics = (channel(number, f"/robot{number}/pose") for number in range(1, count + 1))
    pose = b"\0\1\0\0" + bytes(20)
    said = (message(number, pose, number) for number in range(1, count + 1))
    return whole(chunk([schema(1, POSE_TYPE, SCHEMAS[POSE_TYPE]), *topics, *said]))


def _long_metadata() -> bytes:
    long = metadata("a", text("b") + text(bytes(70 * MIB)))
    return cut(chunk([describe("/turtle1/pose"), make_poses(10)]) + chunk([long]) * 12)


def _one_time(count: int) -> bytes:
    """Messages of one time, of which each might repeat another."""
    pose = b"\0\1\0\0" + bytes(16)
    rows = b"".join(message(1, pose + struct.pack("<I", number), 1) for number in range(count))
    return whole(chunk([describe("/turtle1/pose"), rows]))


def _odd_poses(count: int, values: bytes) -> bytes:
    rows = b"".join(message(1, b"\0\1\0\0" + values, n * 16_000_000) for n in range(count))
    return whole(chunk([describe("/turtle1/pose"), rows]))


def _ends_of_time() -> bytes:
    pose = b"\0\1\0\0" + bytes(20)
    times = [0, 1, 2**62, 2**63 - 1, 2**63, 2**64 - 1]
    return whole(chunk([describe("/turtle1/pose"), *(message(1, pose, time) for time in times)]))


def _small_chunks(count: int) -> bytes:
    """Return chunks of one message each, which an index names."""
    front = describe("/turtle1/pose")
    first, one = chunk([front, make_poses(1)]), chunk([make_poses(1)])
    parts, entries, place = [], [], 8 + 9 + 12
    for number in range(count):
        body = one if number else first
        offset = 0 if number else len(front)
        index = record(INDEX, struct.pack("<HIQQ", 1, 16, 0, offset))
        entries.append(record(CHUNK_INDEX, _name_chunk(body, place, len(index))))
        parts += [body, index]
        place += len(body) + len(index)
    return whole(b"".join(parts), front + b"".join(entries))


def _name_chunk(body: bytes, place: int, index_length: int) -> bytes:
    """Return the entry of the summary for a chunk of one message at time 0."""
    (unpacked,), (packed,) = struct.unpack_from("<Q", body, 25), struct.unpack_from("<Q", body, 45)
    times = struct.pack("<QQQQ", 0, 0, place, len(body))
    offsets = struct.pack("<IHQ", 10, 1, place + len(body))
    return (
        times
        + offsets
        + struct.pack("<Q", index_length)
        + text("zstd")
        + struct.pack("<QQ", packed, unpacked)
    )


FILES: Final[Mapping[str, Make]] = MappingProxyType(
    {
        "mcap: 90,000 entries of one chunk": _mcap(_chunk_indexes),
        "mcap: statistics of 2^40 messages": _mcap(lambda: _statistics_lie(2**40)),
        "mcap: statistics of 2^63 messages": _mcap(lambda: _statistics_lie(2**63)),
        "mcap: long names of schemas": _mcap(_long_names),
        "mcap: long encodings of channels": _mcap(_long_encodings),
        "mcap: type within itself": _mcap(lambda: _define(f"T1 a\n{'=' * 80}\nMSG: a/T1\nT1 a\n")),
        "mcap: types that double": _mcap(lambda: _define(_doubled(60))),
        "mcap: IDL of modules in modules": _mcap(
            lambda: _define("module a { " * 40_000, "a/B", "ros2idl")
        ),
        "mcap: IDL of sequences in sequences": _mcap(
            lambda: _define(
                "struct B { " + "sequence<" * 50_000 + "long" + ">" * 50_000 + " a; };",
                "B",
                "ros2idl",
            )
        ),
        "mcap: IDL of names for names": _mcap(
            lambda: _define(
                "typedef long t0; "
                + " ".join(f"typedef t{n}[9] t{n + 1};" for n in range(10_000))
                + " struct B { t9999 a; };",
                "B",
                "ros2idl",
            )
        ),
        "mcap: sequences of 2^32": _mcap(_claim_sequences),
        "mcap: 1.5 M texts": _mcap(_claim_sizes),
        "mcap: texts of 60 MB": _mcap(lambda: _strings(25)),
        "mcap: JSON in JSON": _mcap(lambda: _json_messages('{"type": "object"}', "[" * 9_000_000)),
        "mcap: JSON number of 9 M digits": _mcap(
            lambda: _json_messages(
                '{"type": "object", "properties": {"a": {"type": "integer"}}}',
                f'{{"a": {"1" * 9_000_000}}}',
            )
        ),
        "mcap: JSON schema of itself": _mcap(
            lambda: _json_messages('{"$ref": "#", "properties": {"a": {"$ref": "#"}}}', "{}")
        ),
        "mcap: JSON schema of empty objects that double": _mcap(
            lambda: _json_messages(_doubled_objects(40), "{}")
        ),
        "mcap: topics of 5,000 digits": _mcap(_long_numbers),
        "mcap: JSON schema of 400,000 lists": _mcap(
            lambda: _json_messages('{"items":' * 400_000 + "{}" + "}" * 400_000, "{}")
        ),
        "mcap: 3 M poses": _mcap(lambda: _many_poses(3_000_000)),
        "mcap: plans of 100,000 poses": _mcap(lambda: _paths(10, 100_000)),
        "mcap: 900,000 transforms": _mcap(lambda: _transforms(90_000)),
        "mcap: 400,000 messages of a transform": _mcap(lambda: _lone_transforms(400_000)),
        "mcap: 20,000 chunks of 60 MB in .mcap.zstd": put_file("file.mcap.zstd", _packed_twice),
        "mcap: 1 M empty frames in .mcap.zstd": put_file("file.mcap.zstd", _empty_frames),
        "mcap: 65,000 topics of poses": _mcap(lambda: _many_topics(65_000)),
        "mcap: metadata of 70 MB": _mcap(_long_metadata),
        "mcap: commands at one time": _mcap(lambda: _one_time(500_000)),
        "mcap: poses of NaN": _mcap(lambda: _odd_poses(700_000, b"\0\0\xc0\x7f" * 5)),
        "mcap: poses at the ends of time": _mcap(_ends_of_time),
        "mcap: scenario of lists in lists": _mcap(lambda: _own_recording(b"a = " + b"[" * 250_000)),
        "mcap: scenario of a long key": _mcap(
            lambda: _own_recording(b".".join([b"a"] * 120_000) + b" = 1")
        ),
        "mcap: scenario of 240,000 digits": _mcap(lambda: _own_recording(b"a = " + b"1" * 240_000)),
        "mcap: declaration of lists in lists": _mcap(
            lambda: _own_recording(format_version="2", declaration="[" * 200_000)
        ),
        "mcap: scenario of 100,000 tables": _mcap(
            lambda: _own_recording(b"".join(b"[a%d]\n" % number for number in range(100_000)))
        ),
        "mcap: notes of 250 kB": _mcap(
            lambda: _own_recording(notes=json.dumps({str(n): "a" for n in range(18_000)}))
        ),
        "mcap: 70,000 chunks of a pose": _mcap(
            lambda: whole(chunk([describe("/turtle1/pose")]) + chunk([make_poses(1)]) * 70_000)
        ),
        "mcap: 40,000 chunks of a pose with an index": _mcap(lambda: _small_chunks(40_000)),
    }
)
"""By name."""
