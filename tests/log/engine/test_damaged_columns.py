"""Whatever the bytes, a read ends in what was written or in one line that names file and place."""

import re
import struct
import tracemalloc
import zlib
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from random import Random
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.writer import MCAP0_MAGIC, CompressionType, IndexType

from tests.log.engine.files import Row, pack, write_points, write_rows
from turtlelog.errors import LogError
from turtlelog.log import iter_columns, read_columns, read_info
from turtlelog.log.engine.source import _STEP, check_sum
from turtlelog.log.file_access import DamageError

BUGS = ("TypeError", "AttributeError", "NameError", "AssertionError", "UnboundLocalError")
OPTIONS: dict[str, dict[str, Any]] = {
    "none": {"compression": CompressionType.NONE},
    "lz4": {"compression": CompressionType.LZ4},
    "zstd": {"compression": CompressionType.ZSTD},
    "one chunk": {"compression": CompressionType.NONE, "chunk_size": 2**20},
    "unchunked": {"use_chunking": False},
    "no index": {"index_types": IndexType.NONE, "use_statistics": False},
}


def write_sample(path: Path, **options: Any) -> bytes:
    schemas = {
        "/p": ("t/msg/P", "uint8 n\nfloat64 x\n"),
        "/s": ("t/msg/S", "string s\nuint8[] data\n"),
    }
    rows = []
    for number in range(60):
        point = pack([("uint8", number), ("float64", number / 7)])
        text = pack([("string", "x" * number), ("uint32", 1), ("uint8", number)])
        rows += [
            Row(topic="/p", time_ns=number * 10, data=point, sequence=number),
            Row(topic="/s", time_ns=number * 10 + 3, data=text, sequence=number),
        ]
    return write_rows(path, schemas, rows, **({"chunk_size": 700} | options)).read_bytes()


def list_all(path: Path) -> dict[str, Any]:
    return {
        topic: (
            columns.log_time_ns.tolist(),
            columns.publish_time_ns.tolist(),
            columns.sequence.tolist(),
            {name: repr(list(values)) for name, values in columns.fields.items()},
        )
        for topic, columns in read_columns(path).items()
    }


def damage(data: bytes, random: Random) -> bytes:
    damaged, place = bytearray(data), random.randrange(len(data))
    match random.randrange(6):
        case 0 | 1 | 2:
            damaged[place] ^= 1 << random.randrange(8)
        case 3:
            del damaged[place:]
        case 4:
            damaged[place : place + random.randrange(1, 90)] = b""
        case _:
            other = random.randrange(len(data))
            damaged[place : place + 16] = data[other : other + 16]
    return bytes(damaged)


@pytest.mark.everyday("lz4", "no index")
@pytest.mark.parametrize("kind", OPTIONS)
def test_damage_is_found_or_does_no_harm(kind: str, tmp_path: Path) -> None:
    """Hundreds of flips are read, each in a file of its own."""
    path, random = tmp_path / "a.mcap", Random(kind)
    data = write_sample(path, **OPTIONS[kind])
    expected, messages = list_all(path), list[str]()
    for _ in range(150):
        path.write_bytes(damage(data, random))
        try:
            assert list_all(path) == expected
        except LogError as err:
            messages.append(str(err))
    assert len(messages) > 60
    for message in messages:
        found = "byte |truncated or unfinished .no end of an MCAP file at byte "
        assert re.match(rf"{re.escape(str(path))}: ({found})\d+\b", message)
        assert "\n" not in message
        assert not any(bug in message for bug in BUGS), message


@pytest.mark.parametrize("read", [read_columns, read_info, lambda path: list(iter_columns(path))])
def test_a_file_cut_short_is_one_line(read: Callable[[Path], Any], tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    data = write_sample(path)
    path.write_bytes(data[:-20])
    if read is read_info:
        assert not read_info(path).complete
        return
    with pytest.raises(LogError, match=rf"^\S+: .*no end of an .* at byte {len(data) - 20}\)"):
        read(path)


@pytest.mark.parametrize("size", [_STEP - 1, _STEP, 2 * _STEP + 1])
def test_the_data_of_a_file_are_checked_step_by_step(size: int) -> None:
    data = Random(size).randbytes(size)
    expected = zlib.crc32(data), "expected data"
    check_sum(BytesIO(data + b"more"), 0, size, *expected)
    with pytest.raises(DamageError, match="expected data of checksum"):
        check_sum(BytesIO(data[:-1] + bytes([data[-1] ^ 1])), 0, size, *expected)


def test_a_damaged_summary_is_named(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    data = bytearray(write_sample(path))
    (start,) = struct.unpack_from("<Q", data, len(data) - 8 - 20)
    data[start + 40] ^= 4
    path.write_bytes(data)
    for read in (read_columns, read_info):
        with pytest.raises(LogError, match=rf"a\.mcap: byte {start}: expected a summary of"):
            read(path)


def rebuild_chunk(data: bytes, claimed: int, compression: str, packed: bytes) -> bytes:
    """Return a file without summary whose first chunk claims a size and holds other bytes."""
    index = read_first_chunk(data)
    name = compression.encode()
    body = struct.pack("<QQQII", 0, 10, claimed, 1, len(name)) + name
    body += struct.pack("<Q", len(packed)) + packed
    chunk = struct.pack("<BQ", Opcode.CHUNK, len(body)) + body
    end = struct.pack("<BQI", Opcode.DATA_END, 4, 0) + struct.pack("<BQQQ", Opcode.FOOTER, 20, 0, 0)
    front = end[-25:]
    return data[:index] + chunk + end + struct.pack("<I", zlib.crc32(front)) + MCAP0_MAGIC


def read_first_chunk(data: bytes) -> int:
    (length,) = struct.unpack_from("<Q", data, len(MCAP0_MAGIC) + 1)
    return len(MCAP0_MAGIC) + 9 + int(length)


def pack_zeros(size: int) -> tuple[bytes, bytes, bytes]:
    """Return zeros as a zstd frame with its size, one without, and an lz4 frame."""
    zeros = bytes(size)
    return (
        zstandard.ZstdCompressor().compress(zeros),
        zstandard.ZstdCompressor(write_content_size=False).compress(zeros),
        lz4.frame.compress(zeros),
    )


@pytest.mark.parametrize("claimed", [2**20, 2**29, 2**40, 2**64 - 1])
def test_a_chunk_that_lies_about_its_size_costs_no_memory(claimed: int, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    data = write_points(path, [0]).read_bytes()
    sized, silent, lz4_frame = pack_zeros(2**16)
    assert sized[4:7] == b"\x60\x00\xff"  # one segment, its size less 256 in two bytes
    lying = sized[:4] + b"\xe0" + struct.pack("<Q", claimed) + sized[7:]
    assert zstandard.frame_content_size(lying) % 2**64 in {claimed, 2**64 - 1}
    for compression, packed in (("zstd", lying), ("zstd", silent), ("lz4", lz4_frame)):
        path.write_bytes(rebuild_chunk(data, claimed, compression, packed))
        tracemalloc.start()
        with pytest.raises(LogError, match=r"a\.mcap: byte \d+: expected"):
            read_columns(path)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < 2**26


def test_a_chunk_that_holds_far_more_than_it_claims_is_not_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    data = write_points(path, [0]).read_bytes()
    for compression, packed in zip(("zstd", "zstd", "lz4"), pack_zeros(2**28), strict=True):
        path.write_bytes(rebuild_chunk(data, 1000, compression, packed))
        tracemalloc.start()
        with pytest.raises(LogError, match=r"a\.mcap: byte \d+: expected"):
            read_columns(path)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < 2**26 + 2 * len(packed)


def test_statistics_that_count_more_messages_are_not_believed(tmp_path: Path) -> None:
    """A chunk that the summary leaves out, with the summary's checksum made to fit."""
    path = tmp_path / "a.mcap"
    data = write_points(path, range(9), chunk_size=60, use_summary_offsets=False).read_bytes()
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    (start,) = struct.unpack_from("<Q", data, len(data) - 8 - 20)
    head = data[: len(data) - 8 - 4 - 25]
    # The statistics come with the number of messages first.
    place = data.index(struct.pack("<BQQ", Opcode.STATISTICS, 56, 9), start)
    changed = head[: place + 46 + 9] + struct.pack("<HQ", 1, 8)[:10] + head[place + 46 + 19 :]
    footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, 0)
    checksum = struct.pack("<I", zlib.crc32(changed[start:] + footer))
    path.write_bytes(changed + footer + checksum + MCAP0_MAGIC)
    with pytest.raises(LogError, match="channel 1: expected 8 messages as the statistics say"):
        read_columns(path)
