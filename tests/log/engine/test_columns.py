import struct
from concurrent import futures
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from mcap.records import Metadata
from mcap.writer import CompressionType, IndexType, Writer

from tests.log.engine.files import CODES, POINT, Row, pack, write_points, write_rows
from tests.log.engine.raw_records import read_raw
from tests.log.runs import find_shared
from turtlelog.errors import LogError
from turtlelog.log import TopicColumns, iter_columns, read_columns, read_info

NUMBERS: dict[str, st.SearchStrategy[Any]] = {
    "bool": st.booleans(),
    "float32": st.floats(width=32, allow_nan=False),
    "float64": st.floats(allow_nan=False),
    **{
        kind: st.integers(0, 2 ** (8 * struct.calcsize(code)) - 1)
        for kind, code in CODES.items()
        if code in "BHIQ"
    },
    **{
        f"int{bits}": st.integers(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
        for bits in (8, 16, 32, 64)
    },
}


@st.composite
def draw_file(draw: st.DrawFn) -> tuple[dict[str, list[str]], list[Row], dict[str, list[Any]]]:
    """Return kinds of fields by topic, messages in the order of the file, and their values."""
    topics = {
        f"/t{number}": draw(st.lists(st.sampled_from([*NUMBERS]), min_size=1, max_size=9))
        for number in range(draw(st.integers(1, 3)))
    }
    rows: list[Row] = []
    values: dict[str, list[Any]] = {topic: [] for topic in topics}
    for topic in draw(st.lists(st.sampled_from([*topics]), max_size=25)):
        fields = [draw(NUMBERS[kind]) for kind in topics[topic]]
        order = draw(st.sampled_from("<<>"))
        data = pack(zip(topics[topic], fields, strict=True), order)
        time_ns, sequence = draw(st.integers(0, 2**63 - 2)), draw(st.integers(0, 2**32 - 1))
        rows.append(Row(topic=topic, time_ns=time_ns, data=data, sequence=sequence))
        values[topic].append((time_ns, sequence, *fields))
    return topics, rows, values


def list_values(columns: TopicColumns) -> list[Any]:
    fields = [column.tolist() for column in columns.fields.values()]
    heads = [columns.log_time_ns.tolist(), columns.sequence.tolist()]
    return list(zip(*heads, *fields, strict=True))


def select(values: list[Any], start_ns: int | None, end_ns: int | None) -> list[Any]:
    """Return what is in time, in its order; rows of one time stay as they are."""
    first, end = start_ns or 0, 2**64 if end_ns is None else end_ns
    inside = [row for row in values if first <= row[0] < end]
    return sorted(inside, key=lambda row: row[0])


@pytest.mark.thorough
@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    file=draw_file(),
    compression=st.sampled_from([*CompressionType]),
    chunk_size=st.sampled_from([1, 200, 2**20]),
    chunked=st.booleans(),
    indexed=st.booleans(),
    data=st.data(),
)
def test_any_numbers_come_back_as_columns(
    tmp_path_factory: pytest.TempPathFactory,
    file: Any,
    compression: CompressionType,
    chunk_size: int,
    *,
    chunked: bool,
    indexed: bool,
    data: st.DataObject,
) -> None:
    topics, rows, values = file
    schemas = {}
    for topic, kinds in topics.items():
        text = "".join(f"{kind} f{number}\n" for number, kind in enumerate(kinds))
        schemas[topic] = (f"test/msg/T{topic[2:]}", text)
    path = write_rows(
        tmp_path_factory.mktemp("files") / "a.mcap",
        schemas,
        rows,
        compression=compression,
        chunk_size=chunk_size,
        use_chunking=chunked,
        index_types=IndexType.CHUNK | IndexType.MESSAGE if indexed else IndexType.NONE,
    )
    times = st.none() | st.sampled_from([0, 2**63, *(row.time_ns for row in rows)])
    start_ns, end_ns = data.draw(times), data.draw(times)
    wanted = data.draw(st.none() | st.sets(st.sampled_from([*topics])))
    found = read_columns(path, wanted, start_ns, end_ns)
    assert set(found) == set(topics if wanted is None else wanted)
    for topic, columns in found.items():
        assert list_values(columns) == select(values[topic], start_ns, end_ns)
        assert (columns.publish_time_ns == columns.log_time_ns + 1).all()
    batches: dict[str, list[Any]] = {topic: [] for topic in found}
    for batch in iter_columns(path, rows=3, topics=wanted, start_ns=start_ns, end_ns=end_ns):
        for topic, columns in batch.items():
            assert 0 < len(columns) <= 3
            assert (np.diff(columns.log_time_ns) >= 0).all()
            batches[topic] += list_values(columns)
    for topic, listed in batches.items():
        assert sorted(listed) == sorted(select(values[topic], start_ns, end_ns))


def test_messages_of_one_time_keep_the_order_of_the_file(tmp_path: Path) -> None:
    times = [5, 5, 3, 5, 3, 0, 5]
    for chunk_size in (1, 2**20):
        write_points(tmp_path / "a.mcap", times, chunk_size=chunk_size)
        found = read_columns(tmp_path / "a.mcap")["/p"]
        assert found.sequence.tolist() == [5, 2, 4, 0, 1, 3, 6]
        assert found.fields["x"].tolist() == found.sequence.tolist()


def test_the_start_is_in_and_the_end_is_out(tmp_path: Path) -> None:
    path = write_points(tmp_path / "a.mcap", [0, 10, 20, 30], chunk_size=1)
    found = read_columns(path, start_ns=10, end_ns=30)["/p"]
    assert found.log_time_ns.tolist() == [10, 20]


def test_a_topic_without_messages_has_empty_columns(tmp_path: Path) -> None:
    schemas = {"/a": ("t/msg/A", "float32[3] a\n"), "/b": ("t/msg/B", "string b\n")}
    found = read_columns(write_rows(tmp_path / "a.mcap", schemas, []))
    assert found["/a"].fields["a"].shape == (0, 3)
    assert found["/a"].fields["a"].dtype == np.float32
    assert (len(found["/b"]), found["/b"].fields["b"].dtype) == (0, np.dtype(object))


def test_only_what_is_asked_for_is_read(tmp_path: Path) -> None:
    path = write_points(tmp_path / "a.mcap", range(0, 1000, 10), chunk_size=200)
    data = bytearray(path.read_bytes())
    data[len(data) // 4] ^= 1
    path.write_bytes(data)
    with pytest.raises(LogError, match=r"a\.mcap: byte \d+: "):
        read_columns(path)
    assert len(read_columns(path, start_ns=900)["/p"]) == 10


def test_a_topic_that_is_not_there_is_named(tmp_path: Path) -> None:
    for options in ({}, {"use_chunking": False}):
        path = write_points(tmp_path / "a.mcap", [0], **options)
        with pytest.raises(LogError, match=r"a\.mcap: topic /q: expected it in the file, found no"):
            read_columns(path, topics=["/p", "/q"])


def test_two_channels_of_one_topic_are_one(tmp_path: Path) -> None:
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("t/msg/Point", "ros2msg", POINT.encode())
        channels = [
            writer.register_channel("/p", "cdr", schema, {"node": str(number)}) for number in (0, 1)
        ]
        for number in range(6):
            data = pack([("float64", number), ("float64", 0)])
            writer.add_message(channels[number % 2], number, data, number)
        writer.finish()  # type: ignore[no-untyped-call]
    assert read_columns(tmp_path / "a.mcap")["/p"].fields["x"].tolist() == [0, 1, 2, 3, 4, 5]


def test_a_topic_of_two_types_is_not_understood(tmp_path: Path) -> None:
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for number, text in enumerate([b"int32 a\n", b"int32 b\n"]):
            schema = writer.register_schema(f"t/msg/T{number}", "ros2msg", text)
            channel = writer.register_channel("/p", "cdr", schema)
            writer.add_message(channel, number, b"\0\1\0\0\1\0\0\0", number)
        writer.finish()  # type: ignore[no-untyped-call]
    for asked in ({"/p"}, None):
        with pytest.raises(LogError, match=r"topic /p: .* different ones: t/msg/T0 and t/msg/T1"):
            read_columns(tmp_path / "a.mcap", topics=asked)


def test_a_batch_of_large_messages_is_cut_by_bytes(tmp_path: Path) -> None:
    large = b"\0\1\0\0" + struct.pack("<I", 2**22) + bytes(2**22)
    rows = [Row(topic="/a", time_ns=number, data=large) for number in range(20)]
    write_rows(tmp_path / "a.mcap", {"/a": ("t/msg/Image", "uint8[] data\n")}, rows)
    batches = [len(batch["/a"]) for batch in iter_columns(tmp_path / "a.mcap")]
    assert sum(batches) == 20
    assert max(batches) <= 8


def test_batches_need_a_row(tmp_path: Path) -> None:
    path = write_points(tmp_path / "a.mcap", [0])
    with pytest.raises(LogError, match="expected batches of at least one row, found 0"):
        next(iter_columns(path, rows=0))


def test_a_time_beyond_63_bits_is_refused(tmp_path: Path) -> None:
    path = write_points(tmp_path / "a.mcap", [2**63])
    with pytest.raises(LogError, match=r"topic /p: expected times below 2\^63 ns"):
        read_columns(path)


@pytest.mark.parametrize(
    ("name", "counts"),
    [
        ("eprosima_ros2_talker.mcap", {"/chatter": 10, "/rosout": 10, "ros_discovery_info": 13}),
        ("lichtblick_example_logs.mcap", {"/rosout": 1000, "mouse": 111}),
        ("rosbag2_talker.mcap", {"/topic": 10, "/rosout": 10, "/parameter_events": 0}),
        ("turtlesim_jazzy/subset_0.mcap", {"/turtle1/cmd_vel": 18, "/turtle1/pose": 2501}),
    ],
)
def test_other_peoples_files_are_read_as_far_as_understood(name: str, counts: Any) -> None:
    found = read_columns(find_shared("ros2", *name.split("/")))
    assert {topic: len(columns) for topic, columns in found.items()}.items() >= counts.items()


def test_a_file_of_which_nothing_is_understood_is_refused_with_the_reasons() -> None:
    path = find_shared("ros2", "service_events.mcap")
    with pytest.raises(LogError, match="topic /add_two_ints/_service_event: not understood: "):
        read_columns(path)


@pytest.mark.parametrize(("rows", "pools"), [(1, 0), (2, 1)])
def test_threads_are_started_for_more_than_one_chunk(
    rows: int, pools: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = [Row(topic="/a", time_ns=row, data=pack([("uint8", 1)])) for row in range(rows)]
    write_rows(tmp_path / "a.mcap", {"/a": ("test/msg/Kind", "uint8 a\n")}, data, chunk_size=1)
    started: list[int] = []

    def start(threads: int) -> ThreadPoolExecutor:
        started.append(threads)
        return ThreadPoolExecutor(threads)

    monkeypatch.setattr(futures, "ThreadPoolExecutor", start)
    assert len(read_columns(tmp_path / "a.mcap")["/a"]) == rows
    assert len(started) == pools


@pytest.mark.parametrize("odd", [0, 70, 199])
def test_one_message_out_of_line_changes_nothing(odd: int, tmp_path: Path) -> None:
    rows = [
        Row(
            topic="/t",
            time_ns=number,
            data=pack([("float64", number), ("uint8", number % 7)], ">" if number == odd else "<"),
            sequence=number,
        )
        for number in range(200)
    ]
    path = tmp_path / "t.mcap"
    write_rows(path, {"/t": ("t/msg/T", "float64 x\nuint8 n\n")}, rows, chunk_size=1000)
    found = read_columns(path)["/t"]
    np.testing.assert_array_equal(found.fields["x"], np.arange(200.0))
    np.testing.assert_array_equal(found.fields["n"], np.arange(200) % 7)
    np.testing.assert_array_equal(found.sequence, np.arange(200))


@pytest.mark.parametrize("index_types", [IndexType.CHUNK | IndexType.MESSAGE, IndexType.NONE])
def test_a_chunk_may_hold_a_record_that_does_not_belong_there(
    index_types: IndexType, tmp_path: Path
) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, index_types=index_types)
        writer.start(profile="ros2")
        schema = writer.register_schema("t/msg/P", "ros2msg", b"float64 x")
        channel = writer.register_channel("/p", "cdr", schema)
        for time_ns in (1, 2):
            writer.add_message(channel, time_ns, pack([("float64", time_ns)]), time_ns)
            inside = writer._Writer__chunk_builder.record_writer  # type: ignore[attr-defined]
            Metadata(name="out of place", metadata={}).write(inside)
        writer.finish()  # type: ignore[no-untyped-call]
    assert read_columns(path)["/p"].fields["x"].tolist() == [1, 2]
    assert read_raw(path).metadata == ()


def test_a_topic_that_comes_late_has_its_type(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(
            stream, 1, index_types=IndexType.NONE, repeat_channels=False, repeat_schemas=False
        )
        writer.start(profile="ros2")
        for number, name in enumerate(("Early", "Late")):
            schema = writer.register_schema(f"t/msg/{name}", "ros2msg", b"float64 x")
            channel = writer.register_channel(f"/{name.lower()}", "cdr", schema)
            writer.add_message(channel, number, pack([("float64", number)]), number)
        writer.finish()  # type: ignore[no-untyped-call]
    expected = {"/early": "t/msg/Early", "/late": "t/msg/Late"}
    assert {topic: found.type for topic, found in read_columns(path).items()} == expected
    assert [*read_columns(path, ["/late"])["/late"].fields["x"]] == [1]
    batches = [{topic: of.type for topic, of in batch.items()} for batch in iter_columns(path)]
    assert {topic: kind for batch in batches for topic, kind in batch.items()} == expected
    assert {topic.topic: topic.type for topic in read_info(path).topics} == expected
