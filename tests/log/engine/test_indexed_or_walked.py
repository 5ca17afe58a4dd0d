"""Files with an index give the same columns as those that are walked."""

import random
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import CompressionType, IndexType, Writer

from tests.log.engine.files import CODES, pack
from turtlelog.log import TopicColumns, read_columns

ALL = IndexType.CHUNK | IndexType.MESSAGE
WAYS: list[tuple[CompressionType, dict[str, Any]]] = [
    (CompressionType.ZSTD, {}),
    (CompressionType.LZ4, {}),
    (CompressionType.NONE, {}),
    (CompressionType.ZSTD, {"index_types": IndexType.NONE}),
    (CompressionType.NONE, {"index_types": IndexType.NONE}),
    (CompressionType.NONE, {"use_chunking": False}),
]


def write_file(path: Path, seed: int, compression: CompressionType, **options: Any) -> Path:
    """Write topics of several channels, rates and types: numbers, arrays, bools, texts."""
    rng = random.Random(seed)
    with path.open("wb") as stream:
        chunk_size = rng.choice([1, 3000, 2**20])
        options = {"index_types": ALL, **options}
        writer = Writer(stream, chunk_size, compression, enable_data_crcs=True, **options)
        writer.start(profile="ros2")
        topics = []
        for number in range(rng.randint(1, 4)):
            kinds = rng.choices([*CODES, "string"] if rng.random() < 0.3 else [*CODES], k=4)
            length = rng.choice([1, 3])
            text = "".join(f"{kind} f{field}\n" for field, kind in enumerate(kinds))
            schema = writer.register_schema(
                f"t/msg/T{number}", "ros2msg", f"{text}float32[{length}] a\nbool b\n".encode()
            )
            channels = [
                writer.register_channel(f"/t{number}", "cdr", schema, {"node": str(node)})
                for node in range(rng.randint(1, 2))
            ]
            topics.append((channels, [*kinds, *["float32"] * length, "bool"]))
        add_messages(writer, rng, topics)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def add_messages(writer: Writer, rng: random.Random, topics: list[Any]) -> None:
    """Add messages in turns with others between; some big-endian, filled up or late."""
    has_odd = rng.random() < 0.3
    for count in range(rng.choice([0, 40, 700])):
        channels, kinds = topics[count % len(topics)]
        if rng.random() < 0.01:
            channels, kinds = rng.choice(topics)
        values = [(kind, draw_value(rng, kind)) for kind in kinds]
        is_odd = has_odd and rng.random() < 0.1
        data = pack(values, ">" if is_odd and rng.random() < 0.5 else "<")
        late = 50 if is_odd else 0
        if is_odd:
            data += bytes(rng.randint(0, 3))
        writer.add_message(rng.choice(channels), 10**6 + count - late, data, count, count)


def draw_value(rng: random.Random, kind: str) -> Any:
    if kind == "string":
        return "a" * rng.randint(0, 5)
    if kind == "bool":
        return rng.random() < 0.5
    return rng.randint(0, 127) if CODES[kind] not in "fd" else rng.uniform(-1, 1)


def list_bits(columns: TopicColumns) -> list[Any]:
    """Return all that columns hold, to be compared exactly."""
    fixed: dict[str, Any] = {
        "log": columns.log_time_ns,
        "publish": columns.publish_time_ns,
        "sequence": columns.sequence,
        **columns.fields,
    }
    return [
        (
            name,
            values.dtype.str,
            values.shape,
            repr(values.tolist()) if values.dtype == object else bits,
        )
        for name, values in fixed.items()
        for bits in [b"" if values.dtype == object else values.tobytes()]
    ]


@pytest.mark.everyday("0", "1", "4", "7", "13")
@pytest.mark.parametrize("seed", range(24))
def test_columns_are_the_same_with_an_index_and_without(seed: int, tmp_path: Path) -> None:
    """The same messages are written and read as six files, some in hundreds of chunks."""
    indexed, *others = [
        read_columns(write_file(tmp_path / "a.mcap", seed, compression, **options))
        for compression, options in WAYS
    ]
    expected = {topic: list_bits(columns) for topic, columns in indexed.items()}
    for found in others:
        assert {topic: list_bits(columns) for topic, columns in found.items()} == expected
