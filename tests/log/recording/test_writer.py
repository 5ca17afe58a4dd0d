import threading
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from mcap.reader import make_reader
from mcap.records import Statistics
from rosbags.highlevel import AnyReader

from tests.log.runs import find_shared, make_run, simulate_preset
from tests.log.strict import check_strictly
from turtlelog.errors import LogError
from turtlelog.log import mcap_writer, write_recording
from turtlelog.log.engine.blocks import ChunkRows
from turtlelog.log.engine.topic_columns import TopicColumns, read_columns
from turtlelog.log.mcap_writer import write_columns
from turtlelog.log.recording.topics import SCHEMAS

MIXED = "mine_msgs/msg/Mixed"
DEFINITIONS = {
    "std_msgs/msg/String": "string data\n",
    "std_msgs/msg/Empty": "",
    MIXED: """\
bool on
int8 small
uint64 large
float32[3] triple
string[] words
mine_msgs/Point[<=2] points
float64[] numbers
mine_msgs/Point at
================================================================================
MSG: mine_msgs/Point
float64 x
string label
""",
}


def make_topic(
    fields: Mapping[str, list[Any]],
    times_ns: list[int],
    *,
    kind: str = "std_msgs/msg/String",
    topic: str = "/a",
) -> TopicColumns:
    columns = {}
    for name, values in fields.items():
        columns[name] = np.empty(len(values), dtype=object)
        columns[name][:] = values
    return TopicColumns(
        topic=topic,
        type=kind,
        log_time_ns=np.array(times_ns, dtype=np.int64),
        publish_time_ns=np.array(times_ns, dtype=np.int64),
        sequence=np.arange(len(times_ns), dtype=np.uint32),
        fields=columns,
    )


def make_texts(times_ns: list[int], topic: str = "/a") -> TopicColumns:
    return make_topic(
        {"data": [f"{topic} {time_ns}" for time_ns in times_ns]}, times_ns, topic=topic
    )


def make_twists(rows: int) -> TopicColumns:
    values = np.random.default_rng(0).normal(size=rows)
    times_ns = np.arange(rows, dtype=np.int64)
    return TopicColumns(
        topic="/twist",
        type="geometry_msgs/msg/Twist",
        log_time_ns=times_ns,
        publish_time_ns=times_ns - times_ns % 3,
        sequence=(times_ns * 7).astype(np.uint32),
        fields={"linear.x": values, "angular.z": -values},
    )


@pytest.mark.parametrize("preset", ["paper-kp10", "textbook"])
def test_every_index_of_a_recording_points_where_it_says(preset: str, tmp_path: Path) -> None:
    write_recording(simulate_preset(preset), tmp_path / "run.mcap")
    summary = check_strictly(tmp_path / "run.mcap")
    assert summary.statistics is not None
    assert summary.statistics.attachment_count == summary.statistics.metadata_count == 1


def test_every_index_of_a_run_that_lacks_much_points_where_it_says(tmp_path: Path) -> None:
    write_recording(make_run(np.ones(1)), tmp_path / "run.mcap")
    check_strictly(tmp_path / "run.mcap")


@pytest.mark.thorough
def test_many_messages_make_many_chunks_that_others_read_in_order(tmp_path: Path) -> None:
    """Libraries in Python read 60,000 messages back."""
    path, twists = tmp_path / "a.mcap", make_twists(60_000)
    write_columns([twists, make_texts([5, 5, 30_000, 59_999])], path)
    assert len(check_strictly(path).chunk_indexes) > 4
    with path.open("rb") as stream:
        messages = make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False)
        times = [message.log_time for _, _, message in messages]
    assert times == sorted([*twists.log_time_ns.tolist(), 5, 5, 30_000, 59_999])
    with AnyReader([path]) as bag:
        messages_of_bag: list[Any] = [
            bag.deserialize(data, connection.msgtype)
            for connection, _, data in bag.messages()
            if connection.topic == "/twist"
        ]
    assert [twist.linear.x for twist in messages_of_bag] == twists.fields["linear.x"].tolist()


def test_columns_come_back_with_times_and_numbers(tmp_path: Path) -> None:
    twists = make_twists(1000)
    write_columns([twists], tmp_path / "a.mcap")
    found = read_columns(tmp_path / "a.mcap")["/twist"]
    for name in ("log_time_ns", "publish_time_ns", "sequence"):
        assert np.array_equal(getattr(found, name), getattr(twists, name))
    assert np.array_equal(found.fields["angular.z"], twists.fields["angular.z"])
    assert not found.fields["linear.y"].any()


def test_rows_out_of_order_are_sorted_and_equal_times_keep_theirs(tmp_path: Path) -> None:
    times_ns, texts = [3, 1, 3, 2, 1], ["c", "a", "d", "z", "b"]
    write_columns([make_topic({"data": texts}, times_ns)], tmp_path / "a.mcap")
    check_strictly(tmp_path / "a.mcap")
    found = read_columns(tmp_path / "a.mcap")["/a"]
    assert found.fields["data"].tolist() == ["a", "b", "z", "c", "d"]


def test_messages_of_one_time_stand_in_the_order_of_the_topics(tmp_path: Path) -> None:
    topics = [make_texts([0, 7, 9], topic) for topic in ("/z", "/b", "/a")]
    write_columns(topics, tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as stream:
        messages = make_reader(stream).iter_messages(log_time_order=False)
        assert [channel.topic for _, channel, _ in messages] == ["/z", "/b", "/a"] * 3


def test_a_message_larger_than_a_chunk_has_its_own(tmp_path: Path) -> None:
    texts = ["small", "x" * 3_000_000, "small"]
    write_columns([make_topic({"data": texts}, [0, 1, 2])], tmp_path / "a.mcap")
    assert len(check_strictly(tmp_path / "a.mcap").chunk_indexes) == 3
    assert read_columns(tmp_path / "a.mcap")["/a"].fields["data"].tolist() == texts


def test_texts_sequences_and_nested_messages_come_back(tmp_path: Path) -> None:
    fields: dict[str, list[Any]] = {
        "on": [True, False],
        "small": [-128, 127],
        "large": [2**64 - 1, 0],
        "triple": [[1.0, 2.0, 3.0], [0.5, 0.0, -1.0]],
        "words": [["", "\u00fc"], []],
        "points": [[{"x": 1.5, "label": "p"}, {"x": 2.5, "label": ""}], []],
        "numbers": [[0.1], [1.0, 2.0]],
        "at.x": [3.0, -0.0],
        "at.label": ["here", "there"],
    }
    topic = make_topic(fields, [0, 1], kind=MIXED)
    write_columns([topic], tmp_path / "a.mcap", definitions=DEFINITIONS)
    found = read_columns(tmp_path / "a.mcap")["/a"].fields
    listed = {name: [as_list(value) for value in column] for name, column in found.items()}
    assert listed == fields


def as_list(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    texts=st.lists(st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"))),
    seed=st.integers(0, 99),
)
def test_any_texts_come_back_at_any_times(texts: list[str], seed: int, tmp_path: Path) -> None:
    times_ns = np.random.default_rng(seed).integers(0, 5, len(texts)).tolist()
    write_columns([make_topic({"data": texts}, times_ns)], tmp_path / "a.mcap")
    check_strictly(tmp_path / "a.mcap")
    found = read_columns(tmp_path / "a.mcap").get("/a")
    rows = sorted(zip(times_ns, range(len(texts)), texts, strict=True))
    assert [row[2] for row in rows] == ([] if found is None else found.fields["data"].tolist())


def test_a_bag_of_others_can_be_written_again(tmp_path: Path) -> None:
    source = find_shared("ros2", "turtlesim_jazzy", "subset_0.mcap")
    with source.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    definitions = {schema.name: schema.data.decode() for schema in summary.schemas.values()}
    columns = read_columns(source)
    write_columns([*columns.values()], tmp_path / "a.mcap", definitions=definitions)
    check_strictly(tmp_path / "a.mcap")
    with source.open("rb") as one, (tmp_path / "a.mcap").open("rb") as two:
        before, after = (
            sorted(
                (channel.topic, message.log_time, message.sequence, message.data)
                for _, channel, message in make_reader(stream).iter_messages()
                if channel.topic in columns
            )
            for stream in (one, two)
        )
    assert [row[:3] for row in after] == [row[:3] for row in before]
    # The middlewares leave anything in the gaps that CDR makes.
    again = read_columns(tmp_path / "a.mcap")
    assert all(repr_columns(again[topic]) == repr_columns(columns[topic]) for topic in columns)


def repr_columns(columns: TopicColumns) -> str:
    return repr({name: [as_list(value) for value in of] for name, of in columns.fields.items()})


def test_metadata_and_attachments_are_found_by_their_names(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write_columns(
        [make_texts([0])], path, metadata={"m": {"k": "v"}}, attachments={"a.bin": b"\0\1"}
    )
    check_strictly(path)
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        [metadata], [attachment] = reader.iter_metadata(), reader.iter_attachments()
    assert (metadata.name, metadata.metadata) == ("m", {"k": "v"})
    assert (attachment.name, attachment.data) == ("a.bin", b"\0\1")


def test_no_topic_at_all_is_a_file_that_is_whole(tmp_path: Path) -> None:
    write_columns([], tmp_path / "a.mcap")
    assert check_strictly(tmp_path / "a.mcap").chunk_indexes == []


@pytest.mark.parametrize(
    ("topic", "line"),
    [
        (make_topic({"dta": ["x"]}, [0]), "/a: dta: expected a field of std_msgs/msg/String: data"),
        (make_topic({"data": ["x"]}, [0, 1]), "/a: data: expected 2 rows, found 1"),
        (make_topic({"data": [3.0]}, [0]), "/a: row 0: expected values of the type's kinds, found"),
        (make_texts([-1]), "/a: log_time_ns: expected values from 0 to .* found -1"),
        (make_topic({}, [0], kind="a/msg/B"), "/a: no definition of a/msg/B"),
        (
            make_topic({"small": [128]}, [0], kind=MIXED),
            "/a: row 0: expected values of the type's kinds",
        ),
        (
            make_topic({"triple": [[1.0]]}, [0], kind=MIXED),
            "/a: row 0: .* triple: 1 values instead of 3",
        ),
        (
            replace(make_twists(2), fields={"linear.x": np.array(["a", "b"])}),
            r"/twist: linear\.x: expected numbers, found <U1",
        ),
        (
            replace(make_twists(2), fields={"linear.x": np.ones((2, 2))}),
            r"/twist: linear\.x: expected shape \(2,\), found \(2, 2\)",
        ),
    ],
)
def test_columns_that_do_not_fit_are_one_line(
    topic: TopicColumns, line: str, tmp_path: Path
) -> None:
    with pytest.raises(LogError, match=rf"^\S+a\.mcap: topic {line}"):
        write_columns([topic], tmp_path / "a.mcap", definitions={**SCHEMAS, **DEFINITIONS})
    assert not list(tmp_path.iterdir())


def test_text_that_utf8_lacks_is_one_line_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"^\S+a\.mcap: expected text, found characters"):
        write_columns([make_topic({"data": ["\ud800"]}, [0])], tmp_path / "a.mcap")
    with pytest.raises(LogError, match=r"^\S+a\.mcap: expected text, found characters"):
        write_columns([], tmp_path / "a.mcap", metadata={"\ud800": {}})
    assert not list(tmp_path.iterdir())


def test_the_same_columns_give_the_same_bytes(tmp_path: Path) -> None:
    topics = [make_twists(30_000), make_texts([1, 2])]
    for name in ("a.mcap", "b.mcap"):
        write_columns(topics, tmp_path / name)
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_chunks_packed_on_threads_are_those_packed_one_by_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    topics = [make_twists(60_000), make_texts([5, 5, 30_000, 59_999])]
    monkeypatch.setattr(mcap_writer, "_THREADS", 3)
    monkeypatch.setattr(mcap_writer, "_AHEAD", 4)
    write_columns(topics, tmp_path / "threads.mcap")
    monkeypatch.setattr(mcap_writer, "map_ahead", lambda work, jobs, *_: map(work, jobs))
    write_columns(topics, tmp_path / "alone.mcap")
    assert (tmp_path / "threads.mcap").read_bytes() == (tmp_path / "alone.mcap").read_bytes()


def test_two_chunks_are_packed_at_one_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pack, both = mcap_writer._pack_chunk, threading.Barrier(2)

    def meet(rows: ChunkRows) -> Any:
        both.wait(timeout=30.0)  # alone it would wait for the other in vain
        return pack(rows)

    monkeypatch.setattr(mcap_writer, "_THREADS", 2)
    monkeypatch.setattr(mcap_writer, "_pack_chunk", meet)
    write_columns([make_twists(20_000)], tmp_path / "a.mcap")
    assert len(check_strictly(tmp_path / "a.mcap").chunk_indexes) == 2


def test_a_chunk_that_cannot_be_packed_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: ChunkRows) -> Any:
        raise LogError("no")

    monkeypatch.setattr(mcap_writer, "_pack_chunk", fail)
    with pytest.raises(LogError, match="no"):
        write_columns([make_twists(60_000)], tmp_path / "a.mcap")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("left_out", [{"/twist"}, {"/twist", "/a"}])
def test_others_need_the_index_of_every_message(
    left_out: set[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They read nothing of a topic that is not indexed, without an error: so all of it is."""
    pack = mcap_writer._pack_chunk

    def leave_out(rows: ChunkRows) -> Any:
        topics = {channel.id: channel.topic for _, channel in rows.channels}
        packed = pack(rows)
        both = zip(rows.index, packed.indexes, strict=True)
        indexes = [record for number, record in both if topics[number] not in left_out]
        index = {n: entries for n, entries in rows.index.items() if topics[n] not in left_out}
        return replace(packed, rows=replace(rows, index=index), indexes=indexes)

    def count_all(**counts: Any) -> Statistics:
        known = {"channel_message_counts": {1: 100, 2: 2}, "message_count": 102}
        return Statistics(**counts | known)

    monkeypatch.setattr(mcap_writer, "_pack_chunk", leave_out)
    monkeypatch.setattr(mcap_writer, "Statistics", count_all)
    path = tmp_path / "a.mcap"
    write_columns([make_twists(100), make_texts([5, 6])], path)
    with AnyReader([path]) as bag:
        twist = [connection for connection in bag.connections if connection.topic == "/twist"]
        assert [connection.msgcount for connection in twist] == [100]
        assert not list(bag.messages(twist))
    with path.open("rb") as stream:
        twists = list(make_reader(stream).iter_messages(topics=["/twist"]))
    assert len(twists) == (100 if "/a" in left_out else 0)


def test_a_topic_twice_or_numbers_too_few_are_one_line(tmp_path: Path) -> None:
    twists = make_twists(5)
    with pytest.raises(LogError, match=f"topic {twists.topic}: expected once, found 2 times"):
        write_columns([twists, twists], tmp_path / "a.mcap")
    short = replace(twists, sequence=twists.sequence[:3])
    with pytest.raises(LogError, match="sequence: expected 5 rows, found 3"):
        write_columns([short], tmp_path / "a.mcap")
