"""A million messages on four topics, in columns against `mcap.Writer`; a live recorder's cost.

`mcap.Writer` is given messages whose bytes are ready: it does less, and takes longer. The bound is
to compress the chunks of the file, as large and at the same level as they are.
"""

import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from mcap.reader import make_reader
from mcap.writer import Writer
from numpy.typing import NDArray

import turtlelog as tl
from benchmarks.table import Cost, Row, run_alone, time_calls
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.mcap_writer import write_columns
from turtlelog.log.recording.recorder import Recorder
from turtlelog.log.recording.topics import SCHEMAS
from turtlelog.simulate import iterate_ticks

ROWS = 333_000  # on each of three topics
TEXTS = 1_000  # on the fourth
REPEATS = 3
SECONDS = 1600.0  # of simulated time: 100,000 samples


def make_topics(share: float) -> list[TopicColumns]:
    """Return poses, commands and planar poses that wander, and rare texts, all in one time."""
    rows, texts = round(ROWS * share), round(TEXTS * share)
    random = np.random.default_rng(0)
    walk = np.cumsum(random.normal(size=(rows, 3)), axis=0) * 1e-3
    x, y, heading = walk.T
    times = np.arange(rows, dtype=np.int64) * 16_000_000
    pose = {"x": x, "y": y, "theta": heading}
    words = np.array([f"sample {row} of many" for row in range(texts)], dtype=object)
    return [
        make_topic("/pose", "turtlesim/msg/Pose", times, pose),
        make_topic("/pose64", "geometry_msgs/msg/Pose2D", times + 1, pose),
        make_topic("/command", "geometry_msgs/msg/Twist", times + 2, {"linear.x": x}),
        make_topic("/text", "std_msgs/msg/String", times[:texts] * 300, {"data": words}),
    ]


def make_topic(
    topic: str, kind: str, times: NDArray[np.int64], fields: dict[str, NDArray[Any]]
) -> TopicColumns:
    return TopicColumns(
        topic=topic,
        type=kind,
        log_time_ns=times,
        publish_time_ns=times,
        sequence=np.arange(len(times), dtype=np.uint32),
        fields=fields,
    )


def read_messages(path: Path) -> list[tuple[int, int, int, bytes]]:
    """Return channel, sequence, log time and bytes of all messages in order."""
    with path.open("rb") as stream:
        found = make_reader(stream).iter_messages(log_time_order=False)
        return [(c.id, m.sequence, m.log_time, m.data) for _, c, m in found]


def write_ready(
    messages: list[tuple[int, int, int, bytes]], topics: list[TopicColumns], path: Path
) -> None:
    """Write messages whose bytes are ready, one by one."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        for topic in topics:
            schema = writer.register_schema(topic.type, "ros2msg", SCHEMAS[topic.type].encode())
            writer.register_channel(topic.topic, "cdr", schema)
        for channel, sequence, time_ns, data in messages:
            writer.add_message(channel, time_ns, data, time_ns, sequence)
        writer.finish()  # type: ignore[no-untyped-call]


def unpack_chunks(path: Path) -> list[bytes]:
    """Return the records of every chunk."""
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None
        chunks = []
        for index in summary.chunk_indexes:
            end = index.chunk_start_offset + index.chunk_length
            stream.seek(end - index.compressed_size)
            packed = stream.read(index.compressed_size)
            chunks.append(zstandard.ZstdDecompressor().decompress(packed))
    return chunks


def compress_alone(chunks: list[bytes]) -> None:
    """Compress the chunks, and nothing else."""
    compressor = zstandard.ZstdCompressor()
    for chunk in chunks:
        compressor.compress(chunk)


def measure_recorder(folder: Path, share: float) -> Iterator[Row]:
    """Yield what a live recorder takes of a core per sample, and in its worst tick."""
    changes = {"law.kp_angular": 0.0001, "max_duration_s": SECONDS * share}
    scenario = tl.override_scenario(tl.load_scenario("paper"), changes)
    ticks = list(iterate_ticks(scenario))
    with Recorder(folder / "whole.mcap", scenario) as recorder:
        start = time.process_time()
        for tick in ticks:
            recorder.receive(tick)
        recorder.flush()
        per_sample = (time.process_time() - start) / len(ticks)
    yield Row(job="record live, a sample", value=per_sample)
    worst = 0.0
    with Recorder(folder / "worst.mcap", scenario) as recorder:
        for tick in ticks:
            start = time.process_time()
            recorder.receive(tick)
            worst = max(worst, time.process_time() - start)
    period_s = 0.016  # a tick of the robot: a longer one would hold up the loop
    yield Row(job="record live, worst tick", value=worst, aim=period_s, aim_of="value")


def measure(share: float = 1.0) -> Iterator[Row]:
    topics = make_topics(share)
    count = sum(map(len, topics))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = folder / "columns.mcap"
        write_columns(topics, path)
        messages, chunks = read_messages(path), unpack_chunks(path)
        columns, ready, bound = time_calls(
            lambda: write_columns(topics, path),
            lambda: write_ready(messages, topics, folder / "ready.mcap"),
            lambda: compress_alone(chunks),
            repeats=REPEATS,
        )
        yield Row(
            job=f"write {count:,} messages",
            value=columns,
            peer=Cost("mcap.Writer", ready),
            bound=Cost("compress", bound),
        )
        yield from measure_recorder(folder, share)


if __name__ == "__main__":
    run_alone(measure)
