"""A million messages on four topics, in columns against `mcap.Writer`; a live recorder's cost."""

import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import Writer
from numpy.typing import NDArray

import turtlelog as tl
from turtlelog.log.container import write_columns
from turtlelog.log.engine.topic_columns import TopicColumns
from turtlelog.log.recording.recorder import Recorder
from turtlelog.log.recording.topics import SCHEMAS
from turtlelog.simulate import iterate_ticks

ROWS = 333_000  # on each of three topics
TEXTS = 1_000  # on the fourth
REPEATS = 5
SECONDS = 1600.0  # of simulated time: 100,000 samples


def measure(call: Callable[[], object]) -> float:
    """Return the median time of a call [s of one core]."""
    times = []
    for _ in range(REPEATS):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return statistics.median(times)


def make_topics() -> list[TopicColumns]:
    """Return poses, commands and planar poses that wander, and rare texts, all in one time."""
    random = np.random.default_rng(0)
    walk = np.cumsum(random.normal(size=(ROWS, 3)), axis=0) * 1e-3
    x, y, heading = walk.T
    times = np.arange(ROWS, dtype=np.int64) * 16_000_000
    pose = {"x": x, "y": y, "theta": heading}
    texts = np.array([f"sample {row} of many" for row in range(TEXTS)], dtype=object)
    return [
        make_topic("/pose", "turtlesim/msg/Pose", times, pose),
        make_topic("/pose64", "geometry_msgs/msg/Pose2D", times + 1, pose),
        make_topic("/command", "geometry_msgs/msg/Twist", times + 2, {"linear.x": x}),
        make_topic("/text", "std_msgs/msg/String", times[:TEXTS] * 300, {"data": texts}),
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


def measure_recorder(folder: Path) -> tuple[float, float]:
    """Return the time of a core per sample, and the wall clock's of the worst tick [s]."""
    changes = {"law.kp_angular": 0.0001, "max_duration_s": SECONDS}
    scenario = tl.override_scenario(tl.load_scenario("paper"), changes)
    ticks = list(iterate_ticks(scenario))
    with Recorder(folder / "whole.mcap", scenario) as recorder:
        start = time.process_time()
        for tick in ticks:
            recorder.receive(tick)
        recorder.flush()
        per_sample = (time.process_time() - start) / len(ticks)
    worst = 0.0
    with Recorder(folder / "worst.mcap", scenario) as recorder:
        for tick in ticks:
            start = time.perf_counter()
            recorder.receive(tick)
            worst = max(worst, time.perf_counter() - start)
    return per_sample, worst


def main() -> None:
    topics = make_topics()
    count = sum(map(len, topics))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        columns = measure(lambda: write_columns(topics, folder / "columns.mcap"))
        messages = read_messages(folder / "columns.mcap")
        ready = measure(lambda: write_ready(messages, topics, folder / "ready.mcap"))
        sizes = [(folder / f"{kind}.mcap").stat().st_size / 1e6 for kind in ("columns", "ready")]
        per_sample, worst = measure_recorder(folder)
    for label, time_s, size in zip(
        ("write_columns", "mcap.Writer, bytes"), (columns, ready), sizes, strict=True
    ):
        rate = count / time_s / 1e6
        print(f"{label:<19}  {time_s:6.3f} s of a core, {rate:.2f} M messages/s, {size:.1f} MB")
    print(f"ratio                {ready / columns:6.1f} times as fast, making the bytes included")
    print(
        f"Recorder             {per_sample * 1e6:6.1f} us a sample, worst tick {worst * 1e3:.1f} ms"
    )


if __name__ == "__main__":
    main()
