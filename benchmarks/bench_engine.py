"""Reading a million messages as columns, and recovering them, against bounds and other readers.

The file has four topics, three of fixed size (24 to 52 bytes) and one of rare text, in chunks of
1 MiB, zstd. The bound is to read and decompress these, on one core, without a look at them. Other
readers give messages one by one; they read a part of the file, and their times are scaled.
"""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from benchmarks.long_runs import write_long_recording
from benchmarks.table import Cost, Row, run_alone, run_apart, time_calls
from turtlelog.log import read_columns, read_recording, recover_recording
from turtlelog.log.recording.topics import SCHEMAS

MESSAGES = 1_000_000
PART = 40_000  # of them, that the row-by-row readers read
PERIOD_NS = 16_000_000
TOPICS = {
    "/turtle1/pose": "turtlesim/msg/Pose",
    "/turtle1/cmd_vel": "geometry_msgs/msg/Twist",
    "/turtle1/pose64": "geometry_msgs/msg/Pose2D",
    "/turtle1/phase": "std_msgs/msg/String",
}
SIZES = {"turtlesim/msg/Pose": 24, "geometry_msgs/msg/Twist": 52, "geometry_msgs/msg/Pose2D": 28}

READ = """
from benchmarks.bench_engine import Path, time_reading
names = [name for name in arguments if name != "run"]
said["unpack"], *said["read"] = time_reading(
    [Path(name) for name in names], as_run="run" in arguments
)
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


def write_file(path: Path, count: int, lacks: str = "") -> None:
    """Write the file with mcap's own writer, also without message indexes or without chunks."""
    with path.open("wb") as stream:
        indexes = IndexType.CHUNK | (IndexType.NONE if lacks == "indexes" else IndexType.MESSAGE)
        writer = Writer(
            stream,
            2**20,
            CompressionType.ZSTD,
            index_types=indexes,
            use_chunking=lacks != "chunks",
        )
        writer.start(profile="ros2")
        channels = {}
        for topic, kind in TOPICS.items():
            schema = writer.register_schema(kind, "ros2msg", SCHEMAS[kind].encode())
            channels[topic] = writer.register_channel(topic, "cdr", schema)
        for number, (topic, payload) in enumerate(make_payloads(count)):
            time_ns = number * PERIOD_NS
            writer.add_message(channels[topic], time_ns, payload, time_ns, number)
        writer.finish()  # type: ignore[no-untyped-call]


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
    """Read and decompress, and nothing else: no reader can do without."""
    total, decompressor = 0, zstandard.ZstdDecompressor()
    with path.open("rb") as stream:
        for place, length in chunks:
            stream.seek(place)
            total += len(decompressor.decompress(stream.read(length)))
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


def time_reading(paths: Sequence[Path], *, as_run: bool = False) -> list[float]:
    """Return the times to decompress the chunks of the first file, and to read each [s].

    With `as_run` also that to read the first as the run of a recording, the last of them.
    """
    chunks = find_chunks(paths[0])
    reading: list[Callable[[], object]] = [partial(read_columns, path) for path in paths]
    if as_run:
        reading.append(partial(read_recording, paths[0]))
    return time_calls(lambda: unpack_alone(paths[0], chunks), *reading)


def measure_reading(folder: Path, messages: int) -> Iterator[Row]:
    """Yield what it takes to read files in a fresh process."""
    names = "million.mcap", "indexes.mcap", "chunks.mcap", "own.mcap"
    *paths, own = (folder / name for name in names)
    for path, lacks in zip(paths, ("", "indexes", "chunks"), strict=True):
        write_file(path, messages, lacks)
    write_long_recording(own, messages)
    said = run_apart(READ, *map(str, paths))
    indexed, *lacking = said["read"]
    bound = Cost("unpack", said["unpack"])
    yield Row(job=f"read {messages:,}", value=indexed, bound=bound, aim=4.5)
    peer = Cost("indexed", indexed, is_yardstick=True)
    for lacks, time_s in zip(("indexes", "chunks"), lacking, strict=True):
        yield Row(job=f"read without {lacks}", value=time_s, peer=peer, aim=1.5)
    said = run_apart(READ, str(own), "run")
    bound = Cost("unpack", said["unpack"])
    columns, run = said["read"]
    yield Row(job=f"read our {messages:,}", value=columns, bound=bound, aim=8)
    yield Row(job=f"our {messages:,} as run", value=run, bound=bound, aim=8)


def measure_peers(folder: Path, path: Path, messages: int, part: int) -> Iterator[Row]:
    """Yield the same reading beside two other readers."""
    small = folder / "part.mcap"
    write_file(small, part)
    scale = messages / part
    ours, decoder, rosbags = time_calls(
        lambda: read_columns(path),
        lambda: decode_rows(small, part),
        lambda: deserialize_rows(small, part),
        repeats=3,
    )
    # A reader by rows is left behind by at least so much: they were 60 and 15 when this began.
    yield Row(
        job=f"read {messages:,}", value=ours, peer=Cost("mcap_ros2", decoder * scale), aim=1 / 60
    )
    yield Row(
        job=f"read {messages:,}", value=ours, peer=Cost("rosbags", rosbags * scale), aim=1 / 15
    )


def measure_recovery(path: Path, messages: int) -> Iterator[Row]:
    """Yield what it takes to recover a file without its end, and one with a damaged chunk."""
    copy, output = path.with_name("copy.mcap"), path.with_name("recovered.mcap")
    data = bytearray(path.read_bytes())
    chunks = find_chunks(path)
    place, length = chunks[len(chunks) // 2]
    data[place + length // 2] ^= 1
    for title, harmed in (("cut", data[: -len(data) // 100]), ("damaged", data)):
        copy.write_bytes(harmed)
        ours, bound = time_calls(
            lambda: recover_recording(copy, output),
            lambda: unpack_alone(path, chunks),
            repeats=3,
        )
        yield Row(
            job=f"recover {messages:,}, {title}",
            value=ours,
            bound=Cost("unpack", bound),
            aim=1.5,
            aim_of="value",
        )


def measure(share: float = 1.0) -> Iterator[Row]:
    messages, part = round(MESSAGES * share), round(PART * share)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = folder / "million.mcap"
        yield from measure_reading(folder, messages)
        yield from measure_peers(folder, path, messages, part)
        yield from measure_recovery(path, messages)


if __name__ == "__main__":
    run_alone(measure)
