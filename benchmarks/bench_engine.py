"""Reading a million messages as columns, and recovering them, against bounds and other readers.

The file has four topics, three of fixed size (24 to 52 bytes) and one of rare text, in chunks of
1 MiB, zstd. All times are the best of several on one machine in one run.
"""

import shutil
import struct
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import ChunkIndex, DataEnd
from mcap.writer import MCAP0_MAGIC, CompressionType, IndexType, Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from turtlelog.log import read_columns, recover_recording
from turtlelog.log.recording.topics import SCHEMAS

MESSAGES = 1_000_000
PART = 40_000  # messages that the row-by-row readers are measured on
LARGE = 2 * 10**9  # bytes
REPEATS = 5
PERIOD_NS = 16_000_000
TOPICS = {
    "/turtle1/pose": "turtlesim/msg/Pose",
    "/turtle1/cmd_vel": "geometry_msgs/msg/Twist",
    "/turtle1/pose64": "geometry_msgs/msg/Pose2D",
    "/turtle1/phase": "std_msgs/msg/String",
}
SIZES = {"turtlesim/msg/Pose": 24, "geometry_msgs/msg/Twist": 52, "geometry_msgs/msg/Pose2D": 28}

PEAK = """
import pathlib, sys, time, turtlelog.log as log
start, rows = time.perf_counter(), 0
for batch in log.iter_columns(sys.argv[1]):
    rows += sum(len(columns) for columns in batch.values())
took = time.perf_counter() - start
start = time.perf_counter()
log.read_info(sys.argv[1])
info = time.perf_counter() - start
status = pathlib.Path("/proc/self/status")
if status.exists():
    # The peak that getrusage gives includes the process that started this one.
    peak = next(int(line.split()[1]) for line in status.open() if line.startswith("VmHWM"))
elif sys.platform != "win32":
    import resource
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    peak //= 1024 if sys.platform == "darwin" else 1
else:
    peak = 0
print(rows, took, info, peak * 1024)
"""


def make_payloads(count: int) -> Iterator[tuple[str, bytes]]:
    """Yield topic and CDR bytes of messages like those of a run: slow curves with noise."""
    rng = np.random.default_rng(0)
    phase = np.linspace(0.0, 200.0, count)
    walk: dict[str, list[bytes]] = {}
    for kind, size in SIZES.items():
        code = "<f4" if size == 24 else "<f8"
        columns = (size - 4) // np.dtype(code).itemsize
        values = np.sin(phase[:, None] * np.arange(1, columns + 1)) + rng.normal(
            0, 1e-3, (count, 1)
        )
        data = values.astype(code).tobytes()
        step = size - 4
        walk[kind] = [
            b"\0\1\0\0" + data[start : start + step] for start in range(0, len(data), step)
        ]
    names = list(TOPICS)
    text = b"\0\1\0\0\x0a\0\0\0translate\0"
    for number in range(count):
        topic = names[3] if number % 1000 == 999 else names[number % 3]
        yield topic, text if topic == names[3] else walk[TOPICS[topic]][number]


def write_file(path: Path, count: int) -> None:
    """Write the file with mcap's own writer."""
    with path.open("wb") as stream:
        indexes = IndexType.CHUNK | IndexType.MESSAGE
        writer = Writer(stream, 2**20, CompressionType.ZSTD, index_types=indexes)
        writer.start(profile="ros2")
        channels = {}
        for topic, kind in TOPICS.items():
            schema = writer.register_schema(kind, "ros2msg", SCHEMAS[kind].encode())
            channels[topic] = writer.register_channel(topic, "cdr", schema)
        for number, (topic, payload) in enumerate(make_payloads(count)):
            time_ns = number * PERIOD_NS
            writer.add_message(channels[topic], time_ns, payload, time_ns, number)
        writer.finish()  # type: ignore[no-untyped-call]


def measure(call: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the best time of a call [s]: other programs only ever add."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return min(times)


def find_chunks(path: Path) -> list[tuple[int, int]]:
    """Return place and length of the compressed bytes of every chunk."""
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    return [
        (
            index.chunk_start_offset + index.chunk_length - index.compressed_size,
            index.compressed_size,
        )
        for index in summary.chunk_indexes
    ]


def unpack_alone(path: Path, chunks: list[tuple[int, int]]) -> int:
    """Read and decompress, and nothing else: no reader can be faster on one core."""
    total = 0
    with path.open("rb") as stream:
        for place, length in chunks:
            stream.seek(place)
            total += len(zstandard.ZstdDecompressor().decompress(stream.read(length)))
    return total


def decode_rows(path: Path, count: int) -> None:
    """Read messages through mcap-ros2-support's decoder."""
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _ in islice(reader.iter_decoded_messages(), count):
            pass


def deserialize_rows(path: Path, count: int) -> None:
    """Read messages through rosbags."""
    with AnyReader([path]) as reader:
        for connection, _, data in islice(reader.messages(), count):
            reader.deserialize(data, connection.msgtype)


def write_large_file(path: Path, small: Path, size: int) -> int:
    """Write a file of `size` bytes by repeating the chunks of a small one; return its messages."""
    with small.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        first, last = summary.chunk_indexes[0], summary.chunk_indexes[-1]
        start = first.chunk_start_offset
        end = last.chunk_start_offset + last.chunk_length + last.message_index_length
        stream.seek(0)
        head, chunks = stream.read(start), stream.read(end - start)
    repeats = -(-size // len(chunks))
    builder = RecordBuilder()
    with path.open("wb") as output:
        output.write(head)
        for _ in range(repeats):
            output.write(chunks)
        DataEnd(data_section_crc=0).write(builder)
        output.write(builder.end())  # type: ignore[no-untyped-call]
        summary_start = output.tell()
        for record in (*summary.schemas.values(), *summary.channels.values()):
            record.write(builder)
        counts = summary.statistics.channel_message_counts
        replace(
            summary.statistics,
            message_count=summary.statistics.message_count * repeats,
            chunk_count=len(summary.chunk_indexes) * repeats,
            channel_message_counts={number: count * repeats for number, count in counts.items()},
        ).write(builder)
        for number in range(repeats):
            for index in summary.chunk_indexes:
                shift_index(index, number * len(chunks)).write(builder)
        summary_bytes = builder.end()  # type: ignore[no-untyped-call]
        output.write(finish_summary(summary_bytes, summary_start))
    return summary.statistics.message_count * repeats


def shift_index(index: ChunkIndex, by: int) -> ChunkIndex:
    """Return the index of the same chunk so many bytes later."""
    offsets = {channel: place + by for channel, place in index.message_index_offsets.items()}
    start = index.chunk_start_offset + by
    return replace(index, chunk_start_offset=start, message_index_offsets=offsets)


def finish_summary(summary: bytes, start: int) -> bytes:
    """Return a summary with its footer, its checksum and the magic bytes."""
    front = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, 0)
    checksum = zlib.crc32(summary + front)
    return summary + front + struct.pack("<I", checksum) + MCAP0_MAGIC


def measure_large(path: Path, messages: int) -> None:
    """Stream a large file in a process of its own, and print time and peak memory."""
    answer = subprocess.run(
        [sys.executable, "-c", PEAK, str(path)], check=True, capture_output=True, text=True
    )
    rows, took, info, peak = answer.stdout.split()
    assert int(rows) == messages
    size = path.stat().st_size
    print(f"large file            {size / 1e9:.2f} GB, {messages / 1e6:.1f} M messages")
    print(f"  iter_columns        {float(took):.2f} s, peak {int(peak) / 1e6:.0f} MB (up to 300)")
    print(f"  read_info           {float(info):.3f} s (up to 0.2)")


def measure_recovery(path: Path, columns_s: float) -> None:
    """Recover a file without its end, and one with a damaged chunk, and print the times."""
    copy, output = path.with_name("copy.mcap"), path.with_name("recovered.mcap")
    copied = measure(lambda: shutil.copyfile(path, copy))
    data = bytearray(path.read_bytes())
    place, length = find_chunks(path)[5]
    data[place + length // 2] ^= 1
    for title, harmed in (("cut", data[: -len(data) // 100]), ("damaged", data)):
        copy.write_bytes(harmed)
        took = measure(lambda: recover_recording(copy, output), 3)
        ratios = f"{took / copied:.0f} times a copy, {took / columns_s:.1f} times read_columns"
        print(f"recover, {title:<12} {took:7.3f} s (up to 1.5), {ratios}")


def main() -> None:
    with tempfile.TemporaryDirectory() as name:
        path, part = Path(name) / "million.mcap", Path(name) / "part.mcap"
        write_file(path, MESSAGES)
        write_file(part, PART)
        chunks = find_chunks(path)
        bound = measure(lambda: unpack_alone(path, chunks))
        ours = measure(lambda: read_columns(path))
        scale = MESSAGES / PART
        decoder = measure(lambda: decode_rows(part, PART), 3) * scale
        rosbags = measure(lambda: deserialize_rows(part, PART), 3) * scale
        print(f"{MESSAGES:,} messages, {path.stat().st_size / 1e6:.1f} MB")
        print(f"read and decompress   {bound:7.3f} s on one core: the bound")
        print(f"read_columns          {ours:7.3f} s, {ours / bound:.2f} times the bound (up to 3)")
        for title, time_s, least in (("mcap_ros2 decoder", decoder, 60), ("rosbags", rosbags, 15)):
            ratio = f"{time_s / ours:.0f} times as long (at least {least})"
            print(f"{title:<20}  {time_s:7.2f} s, {ratio}; measured on {PART:,}, scaled")
        measure_recovery(path, ours)
        large = Path(name) / "large.mcap"
        measure_large(large, write_large_file(large, path, LARGE))


if __name__ == "__main__":
    main()
