"""Compiled loops give the same columns, bit for bit, and the same errors as reading without."""

import random
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import CompressionType, IndexType, Writer

from tests.log.engine.files import CODES, pack
from tests.log.runs import SHARED
from tests.log.ways import load_kernels, use_kernels
from turtlelog.errors import LogError
from turtlelog.log import TopicColumns, read_columns
from turtlelog.log.engine import read_raw
from turtlelog.log.engine.parsing import take_apart
from turtlelog.log.engine.walk import walk_sections

ALL = IndexType.CHUNK | IndexType.MESSAGE
WAYS = [
    (CompressionType.ZSTD, {}),
    (CompressionType.LZ4, {}),
    (CompressionType.NONE, {}),
    (CompressionType.ZSTD, {"index_types": IndexType.NONE}),
    (CompressionType.NONE, {"index_types": IndexType.NONE}),
    (CompressionType.NONE, {"use_chunking": False}),
]


@pytest.fixture(scope="module")
def kernels() -> Any:
    return load_kernels()


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


def read_bits(path: Path) -> Any:
    try:
        return {topic: list_bits(columns) for topic, columns in read_columns(path).items()}
    except LogError as err:
        return str(err)


def read_both(path: Path, kernels: Any, read: Callable[[Path], Any]) -> tuple[Any, Any]:
    answers = []
    for way in (None, kernels):
        with use_kernels(way):
            answers.append(read(path))
    return answers[0], answers[1]


@pytest.mark.parametrize(("compression", "options"), WAYS)
def test_both_ways_give_the_same_columns(
    compression: CompressionType, options: Any, tmp_path: Path, kernels: Any
) -> None:
    for seed in range(12):
        path = write_file(tmp_path / "a.mcap", seed, compression, **options)
        plain, fast = read_both(path, kernels, read_bits)
        assert isinstance(plain, dict), plain
        assert fast == plain


@pytest.mark.parametrize(("compression", "options"), WAYS)
def test_both_ways_refuse_damage_in_the_same_words(
    compression: CompressionType, options: Any, tmp_path: Path, kernels: Any
) -> None:
    rng, refused = random.Random(0), 0
    path = write_file(tmp_path / "a.mcap", 3, compression, enable_crcs=False, **options)
    sound = path.read_bytes()
    for _ in range(60):
        data = bytearray(sound)
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        path.write_bytes(data)
        plain, fast = read_both(path, kernels, read_bits)
        assert fast == plain
        refused += isinstance(plain, str)
    assert refused


@pytest.mark.parametrize("path", sorted(SHARED.glob("conformance/*/*.mcap")), ids=lambda p: p.stem)
def test_both_ways_read_the_conformance_suite(path: Path, kernels: Any) -> None:
    plain, fast = read_both(path, kernels, read_raw)
    assert fast == plain


@pytest.mark.parametrize("path", sorted(SHARED.glob("ro*/*.mcap")), ids=lambda path: path.stem)
def test_both_ways_read_other_peoples_files(path: Path, kernels: Any) -> None:
    plain, fast = read_both(path, kernels, read_bits)
    assert fast == plain


def test_damaged_stretches_are_walked_to_the_same_place(kernels: Any, tmp_path: Path) -> None:
    path = write_file(tmp_path / "a.mcap", 5, CompressionType.NONE, use_chunking=False)
    rng, sound = random.Random(1), path.read_bytes()
    for most in [10**6] * 60 + [0, 1, 20, 300]:
        data = bytearray(sound)
        for _ in range(most == 10**6):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        harmed = bytes(data)
        answers = []
        for way in (None, kernels):
            with use_kernels(way):
                found = take_apart(harmed[8:], is_chunk=False, most_records=most)
                walked = [*walk_sections(BytesIO(harmed))]
            answers.append(
                (found.starts.tolist(), found.others, found.fault, found.records, walked)
            )
        assert answers[0] == answers[1]
