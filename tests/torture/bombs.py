"""Small files that ask for much: a writer of MCAP records, and what an attacker makes with it."""

import struct
import zlib
from collections.abc import Callable, Iterable
from itertools import chain, repeat
from typing import Any, Final

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from turtlelog.log.recording.topics import SCHEMAS

MAGIC: Final = b"\x89MCAP0\r\n"
POSE: Final = "turtlesim/msg/Pose"
MIB: Final = 2**20
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, INDEX = range(1, 8)
CHUNK_INDEX, ATTACHMENT, _, STATISTICS, METADATA, METADATA_INDEX, _, DATA_END = range(8, 16)


def record(opcode: int, body: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def text(value: str | bytes) -> bytes:
    data = value.encode() if isinstance(value, str) else value
    return struct.pack("<I", len(data)) + data


def schema(number: int, name: str, definition: str | bytes) -> bytes:
    body = struct.pack("<H", number) + text(name) + text("ros2msg") + text(definition)
    return record(SCHEMA, body)


def channel(number: int, topic: str, schema_number: int = 1, table: bytes = b"") -> bytes:
    body = struct.pack("<HH", number, schema_number) + text(topic) + text("cdr") + text(table)
    return record(CHANNEL, body)


def message(number: int, data: bytes = b"", time_ns: int = 0) -> bytes:
    return record(MESSAGE, struct.pack("<HIQQ", number, 0, time_ns, time_ns) + data)


def metadata(name: str = "", table: bytes = b"") -> bytes:
    return record(METADATA, text(name) + text(table))


def attachment(name: str, data: bytes) -> bytes:
    body = struct.pack("<QQ", 0, 0) + text(name) + text("") + struct.pack("<Q", len(data)) + data
    return record(ATTACHMENT, body + bytes(4))


def pose_messages(number: int, count: int) -> bytes:
    """Return a robot that stands still, its times and values the same."""
    return message(number, b"\0\1\0\0" + bytes(20), 1) * count


def chunk(parts: Iterable[bytes], compression: str = "zstd", *, checked: bool = True) -> bytes:
    """Return a chunk of parts, compressed one by one: nobody holds all of it."""
    packer: Any = zstandard.ZstdCompressor(level=1).compressobj()
    packed = []
    if compression == "lz4":
        packer = lz4.frame.LZ4FrameCompressor(block_size=lz4.frame.BLOCKSIZE_MAX4MB)
        packed = [packer.begin()]
    crc, size = 0, 0
    for part in parts:
        packed.append(packer.compress(part))
        crc, size = zlib.crc32(part, crc), size + len(part)
    data = b"".join((*packed, packer.flush()))
    head = struct.pack("<QQQI", 0, 0, size, crc if checked else 0)
    return record(CHUNK, head + text(compression) + struct.pack("<Q", len(data)) + data)


def describe(*topics: str, kind: str = POSE, definition: str | None = None) -> bytes:
    channels = (channel(number, topic) for number, topic in enumerate(topics, start=1))
    return schema(1, kind, SCHEMAS[kind] if definition is None else definition) + b"".join(channels)


def whole(data: bytes, summary: bytes = b"") -> bytes:
    """Return a finished file; without an index, so that everything in it must be walked."""
    front = MAGIC + record(HEADER, text("ros2") + text("")) + data + record(DATA_END, bytes(4))
    start = len(front) if summary else 0
    return front + summary + record(FOOTER, struct.pack("<QQI", start, 0, 0)) + MAGIC


def cut(data: bytes) -> bytes:
    """Return a file that was never finished."""
    return MAGIC + record(HEADER, text("ros2") + text("")) + data


def _zeros(size: int) -> Iterable[bytes]:
    return repeat(bytes(MIB), size // MIB)


def _some() -> bytes:
    return chunk([describe("/turtle1/pose"), pose_messages(1, 100)])


def _claim_zeros(compression: str, size: int, count: int) -> bytes:
    """One record of zeros that its chunk holds whole: an opcode that anybody may use."""
    large = chunk(chain([struct.pack("<BQ", 0x80, size)], _zeros(size)), compression)
    return cut(_some() + large * count)


def _tiny(mib: int, count: int) -> bytes:
    block = message(1) * 30_000
    return cut(_some() + chunk(repeat(block, mib * MIB // len(block))) * count)


def _tables(count: int) -> bytes:
    return b"".join(text(f"{number:x}") + text("") for number in range(count))


def _schemas(count: int, fields: int) -> bytes:
    lines = "".join(f"int8 f{number}\n" for number in range(fields))
    return b"".join(
        schema(number, f"a/B{number}", lines) + channel(number, f"/{number}", number)
        for number in range(1, count + 1)
    )


def _channels(count: int, *, loud: bool = False) -> bytes:
    names = (channel(number, f"/topic/{number}") for number in range(1, count + 1))
    said = (message(number, b"\0\1\0\0" + bytes(20)) for number in range(1, count + 1))
    return b"".join((schema(1, POSE, SCHEMAS[POSE]), *names, *(said if loud else ())))


def _nested(depth: int, length: str) -> str:
    types = [f"T{number + 1}{length} a" for number in range(depth)]
    parts = [f"{'=' * 80}\nMSG: a/T{number}\n{line}\n" for number, line in enumerate(types)]
    return types[0] + "\n" + "".join(parts) + f"{'=' * 80}\nMSG: a/T{depth}\nint8 x\n"


def _flip() -> bytes:
    pair = channel(1, "/a") + message(1) + channel(1, "/b") + message(1)
    return cut(_some() + chunk(repeat(pair * 1000, 300)))


def _split(count: int) -> bytes:
    """Attachments and a byte of no record by turns."""
    return cut(_some() + (attachment("", b"") + b"\x66") * count)


def _dictionaries(fields: str, data: bytes) -> bytes:
    definition = SCHEMAS["geometry_msgs/msg/PoseStamped"]
    odd = f"{fields}{definition}\n{'=' * 80}\nMSG: a/E\nint8 x\n"
    front = describe("/pose", kind="geometry_msgs/msg/PoseStamped", definition=odd)
    return whole(chunk([front, message(1, data)]))


BOMBS: Final[dict[str, Callable[[], bytes]]] = {
    "zstd 900 MB": lambda: _claim_zeros("zstd", 900 * MIB, 1),
    "lz4 900 MB": lambda: _claim_zeros("lz4", 900 * MIB, 1),
    "zstd 60 MB x 1000": lambda: _claim_zeros("zstd", 60 * MIB, 1000),
    "lz4 60 MB x 30": lambda: _claim_zeros("lz4", 60 * MIB, 30),
    "lz4 60 MB x 6": lambda: _claim_zeros("lz4", 60 * MIB, 6),
    "zstd 900 MB finished": lambda: whole(_some() + chunk(_zeros(900 * MIB))),
    "zstd unchecked": lambda: whole(_some() + chunk(_zeros(900 * MIB), checked=False)),
    "tiny messages 900 MB": lambda: _tiny(900, 1),
    "tiny messages 64 MB": lambda: _tiny(64, 1),
    "tiny messages 64 MB x 40": lambda: _tiny(64, 40),
    "tiny messages alone": lambda: cut(describe("/a") + message(1) * 320_000),
    "schema 1e7 fields": lambda: whole(
        chunk([describe("/a", definition="int8 a\n" * 10**7), pose_messages(1, 1)])
    ),
    "schema of comments": lambda: whole(
        chunk([describe("/a", definition="\n" * 60 * MIB), pose_messages(1, 1)])
    ),
    "schema nested x 10": lambda: whole(
        chunk([describe("/a", definition=_nested(60, "[10]")), pose_messages(1, 1)])
    ),
    "schema nested deep": lambda: whole(
        chunk([describe("/a", definition=_nested(5000, "")), pose_messages(1, 1)])
    ),
    "schema long array": lambda: whole(
        chunk([describe("/a", definition="int8[999999999] a\n"), pose_messages(1, 1)])
    ),
    "60,000 schemas": lambda: whole(chunk([_schemas(60_000, 20), message(1)])),
    "500 schemas of 9,000 fields": lambda: whole(
        chunk([_schemas(500, 9000), message(1)]) + chunk([message(1)])
    ),
    "channels": lambda: whole(chunk([_channels(65_535, loud=True)])),
    "a fifth of the channels": lambda: whole(chunk([_channels(13_107, loud=True)])),
    "channels x 20": lambda: cut(chunk([_channels(65_535, loud=True)]) * 20),
    "channels alone": lambda: whole(_channels(65_535) + message(1, b"\0\1\0\0" + bytes(20))),
    "channel table": lambda: whole(
        chunk([schema(1, POSE, SCHEMAS[POSE]), channel(1, "/a", 1, _tables(4_000_000)), message(1)])
    ),
    "channels by turns": _flip,
    "schemas again": lambda: cut(_some() + chunk([schema(7, "a/B", "") * 2_000_000])),
    "metadata": lambda: cut(_some() + metadata() * 550_000),
    "a fifth of the metadata": lambda: cut(_some() + metadata() * 110_000),
    "metadata finished": lambda: whole(_some() + metadata() * 550_000),
    "metadata in a chunk": lambda: cut(_some() + chunk([metadata() * 3_000_000])),
    "attachments": lambda: whole(_some() + attachment("", b"") * 200_000),
    "attachment in a chunk": lambda: whole(
        _some() + chunk(chain([attachment("", b"")], [attachment("a", bytes(60 * MIB))]))
    ),
    "damage by turns": lambda: _split(200_000),
    "summary of metadata": lambda: whole(
        _some(), record(METADATA_INDEX, struct.pack("<QQ", 8, 8) + text("")) * 330_000
    ),
    "summary of schemas": lambda: whole(_some(), schema(1, POSE, "") * 200_000),
    "summary of schemas, other": lambda: whole(
        _some(), b"".join(schema(number % 65535 + 1, "", "") for number in range(250_000))
    ),
    "summary of statistics": lambda: whole(
        _some(), record(STATISTICS, bytes(42) + text("")) * 160_000
    ),
    "summary of chunks": lambda: whole(
        _some(), record(CHUNK_INDEX, struct.pack("<QQQQIQIQQ", 0, 0, 8, 8, 0, 0, 0, 0, 0)) * 120_000
    ),
    "summary of nothing": lambda: whole(_some(), record(0x80, b"") * 1_000_000),
    "sequence of messages": lambda: _dictionaries(
        "a/E[] e\n", b"\0\1\0\0" + struct.pack("<I", 40 * MIB) + bytes(40 * MIB)
    ),
    "sequence of texts": lambda: _dictionaries(
        "string[] e\n", b"\0\1\0\0" + struct.pack("<I", 10 * MIB) + bytes(40 * MIB)
    ),
    "scenario": lambda: whole(
        _some()
        + metadata("turtlelog", text("format_version") + text("1"))
        + attachment("scenario.toml", b"".join(b"a%d=1\n" % n for n in range(800_000)))
    ),
}
