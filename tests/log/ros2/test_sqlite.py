import shutil
import sqlite3
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from tests.log.ros2.bags import (
    START_NS,
    make_command,
    make_odometry,
    make_poses,
    make_stamped_pose,
    write_mcap,
    write_sqlite,
)
from tests.log.runs import find_shared
from turtlelog.errors import LogError
from turtlelog.log import (
    TopicColumns,
    iter_columns,
    read_columns,
    read_info,
    read_run,
    recover_recording,
)
from turtlelog.log.engine import read_raw, sqlite_source
from turtlelog.log.ros2.bag import open_bag

MIXED = [
    *make_poses(700),
    make_odometry(yaw_rad=1.0, speed=(0.5, 0.1), turn_rate=0.2),
    *(replace(make_stamped_pose(), time_ns=START_NS - row) for row in range(5)),
    *(make_command(float(row)) for row in range(3)),
]


def assert_equal(found: Mapping[str, TopicColumns], expected: Mapping[str, TopicColumns]) -> None:
    assert list(found) == list(expected)
    for name, columns in expected.items():
        other = found[name]
        assert (other.topic, other.type) == (columns.topic, columns.type)
        pairs: list[tuple[NDArray[Any], NDArray[Any]]] = [
            (other.log_time_ns, columns.log_time_ns),
            (other.publish_time_ns, columns.publish_time_ns),
            (other.sequence, columns.sequence),
            *((other.fields[field], columns.fields[field]) for field in columns.fields),
        ]
        assert list(other.fields) == list(columns.fields)
        for ours, theirs in pairs:
            assert ours.dtype == theirs.dtype
            if ours.dtype == object:
                assert ours.tolist() == theirs.tolist()
            else:
                assert ours.tobytes() == theirs.tobytes()


@pytest.mark.parametrize("schema", [1, 2, 3, 4])
def test_a_bag_in_sqlite_gives_the_columns_of_mcap_to_the_last_bit(
    schema: int, tmp_path: Path
) -> None:
    expected = read_columns(write_mcap(tmp_path / "a.mcap", MIXED))
    file = write_sqlite(tmp_path / "a.db3", MIXED, schema=schema)
    assert_equal(read_columns(file), expected)
    some = read_columns(file, ["/turtle1/pose"], start_ns=START_NS + 1, end_ns=START_NS + 10**9)
    wanted = {"topics": ["/turtle1/pose"], "start_ns": START_NS + 1, "end_ns": START_NS + 10**9}
    assert_equal(some, read_columns(tmp_path / "a.mcap", **wanted))  # type: ignore[arg-type]
    assert len(some["/turtle1/pose"]) == 62


def test_batches_are_as_long_as_asked_for(tmp_path: Path) -> None:
    batches = list(iter_columns(write_sqlite(tmp_path / "a.db3", MIXED), rows=100))
    poses = [len(batch["/turtle1/pose"]) for batch in batches if "/turtle1/pose" in batch]
    assert max(poses) == 100
    assert sum(poses) == 700


def test_blocks_that_are_cut_small_give_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = write_sqlite(tmp_path / "a.db3", MIXED)
    expected = read_columns(file)
    monkeypatch.setattr(sqlite_source, "_BLOCK_BYTES", 1000)
    assert_equal(read_columns(file), expected)


def test_what_is_in_a_bag_in_sqlite_is_counted(tmp_path: Path) -> None:
    info = read_info(write_sqlite(tmp_path / "some.db3", MIXED))
    counts = {topic.topic: topic.count for topic in info.topics}
    assert counts == {"/odom": 1, "/pose": 5, "/turtle1/cmd_vel": 3, "/turtle1/pose": 700}
    assert (info.source, info.name, info.complete) == ("sqlite3", "some", True)
    assert info.duration_s == pytest.approx(699 * 0.016 + 4e-9)


def test_a_type_that_nobody_defines_is_named(tmp_path: Path) -> None:
    file = write_sqlite(tmp_path / "a.db3", make_poses(2), definitions=False)
    change(file, "UPDATE topics SET type = 'my_robot/msg/Secret'")
    line = "its type my_robot/msg/Secret is not known and the file holds no definition"
    assert read_info(file).not_understood == (f"/turtle1/pose: {line}",)
    with pytest.raises(LogError, match=rf"a\.db3: topic /turtle1/pose: not understood: {line}"):
        read_columns(file, ["/turtle1/pose"])
    assert dict(read_columns(file)) == {}


def test_a_definition_in_the_file_comes_before_our_own(tmp_path: Path) -> None:
    file = write_sqlite(tmp_path / "a.db3", make_poses(2))
    text = "encoded_message_definition"
    change(file, f"UPDATE message_definitions SET {text} = replace({text}, 'theta', 'angle')")
    assert "angle" in read_columns(file)["/turtle1/pose"].fields


@pytest.mark.parametrize(
    "name",
    ["amcl_pose", "sim_time", "tf_only", "turtlesim_sqlite", "tb3"],
)
def test_bags_of_robots_open(name: str) -> None:
    bag = open_bag(find_shared("robots", name))
    refused = {
        text.partition(":")[0] for info in bag.infos.values() for text in info.not_understood
    }
    counts = {topic.topic: topic.count for topic in bag.topics}
    read = bag.read(sorted(counts.keys() - refused), is_flat=False)
    for columns in read:
        assert {topic: len(of) for topic, of in columns.items()} == {
            topic: count for topic, count in counts.items() if count
        }


def test_an_old_turtlesim_in_sqlite_is_read() -> None:
    run = read_run(find_shared("ros2", "turtlesim_v4"))
    assert (len(run.poses), len(run.commands)) == (987, 18)


def test_rows_of_a_log_beside_the_file_are_read_and_nothing_is_written(tmp_path: Path) -> None:
    file = write_sqlite(tmp_path / "a.db3", make_poses(2))
    connection = sqlite3.connect(file)
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute(
        "INSERT INTO messages(topic_id, timestamp, data) SELECT topic_id, timestamp, data"
        " FROM messages"
    )
    connection.commit()
    folder = tmp_path / "while it is written"
    folder.mkdir()
    for path in tmp_path.glob("a.db3*"):
        shutil.copy(path, folder)
    connection.close()
    (folder / "a.db3-shm").unlink()
    before = {path: path.read_bytes() for path in folder.iterdir()}
    assert len(before) == 2
    assert len(read_columns(folder / "a.db3")["/turtle1/pose"]) == 4
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


@pytest.fixture
def interrupted(tmp_path: Path) -> Path:
    """A bag as it is within a transaction that has begun to write, with the journal beside it."""
    file = write_sqlite(tmp_path / "a.db3", make_poses(2000))
    connection = sqlite3.connect(file, isolation_level=None)
    connection.execute("PRAGMA cache_size = 1")
    connection.execute("BEGIN")
    connection.execute("UPDATE messages SET timestamp = timestamp + 1")
    folder = tmp_path / "interrupted"
    folder.mkdir()
    for path in tmp_path.glob("a.db3*"):
        shutil.copy(path, folder)
    connection.close()
    return folder / "a.db3"


def test_what_was_not_committed_is_taken_back(interrupted: Path, tmp_path: Path) -> None:
    journal = interrupted.with_name("a.db3-journal")
    before = interrupted.read_bytes(), journal.read_bytes()
    assert_equal(read_columns(interrupted), read_columns(tmp_path / "a.db3"))
    assert (interrupted.read_bytes(), journal.read_bytes()) == before
    journal.unlink()
    found = read_columns(interrupted)["/turtle1/pose"].log_time_ns
    assert (found != read_columns(tmp_path / "a.db3")["/turtle1/pose"].log_time_ns).any()


def test_a_journal_that_names_another_file_is_refused(interrupted: Path) -> None:
    victim = interrupted.with_name("victim")
    victim.write_text("x")
    name = str(victim).encode()
    with interrupted.with_name("a.db3-journal").open("ab") as stream:
        stream.write(b"\x00\x00\x00\x01" + name + len(name).to_bytes(4, "big"))
        stream.write(sum(name).to_bytes(4, "big") + bytes.fromhex("d9d505f920a163d7"))
    with pytest.raises(LogError, match=r"a\.db3: a\.db3-journal: expected the journal of one file"):
        read_info(interrupted)
    assert victim.exists()


def test_a_bag_that_another_program_holds_is_read(tmp_path: Path) -> None:
    file = write_sqlite(tmp_path / "a.db3", make_poses(2))
    connection = sqlite3.connect(file, isolation_level=None)
    connection.execute("PRAGMA locking_mode = EXCLUSIVE")
    connection.execute("BEGIN EXCLUSIVE")
    assert len(read_columns(file)["/turtle1/pose"]) == 2
    connection.close()


def test_a_name_that_a_uri_would_change_is_read(tmp_path: Path) -> None:
    file = write_sqlite(tmp_path / "a b?c#d%20e.db3", make_poses(2))
    assert len(read_columns(file)["/turtle1/pose"]) == 2


def change(file: Path, *queries: str) -> Path:
    connection = sqlite3.connect(file)
    for query in queries:
        connection.execute(query)
    connection.commit()
    connection.close()
    return file


NULLS = (
    "CREATE TABLE loose AS SELECT * FROM messages",
    "DROP TABLE messages",
    "ALTER TABLE loose RENAME TO messages",
)


@pytest.mark.parametrize(
    ("queries", "line"),
    [
        (("DROP TABLE messages",), "expected a bag with tables topics and messages, found "),
        (("DROP TABLE topics",), "expected a bag with tables topics and messages, found "),
        (
            (*NULLS, "UPDATE messages SET data = NULL WHERE id = 3"),
            "messages: row 3: data: expected a blob, found null",
        ),
        (
            (*NULLS, "UPDATE messages SET timestamp = NULL WHERE id = 2"),
            "messages: row 2: timestamp: expected nanoseconds from 0 on, found null",
        ),
        (
            ("UPDATE messages SET timestamp = 'noon' WHERE id = 2",),
            "messages: row 2: timestamp: expected nanoseconds from 0 on, found text",
        ),
        (
            ("UPDATE messages SET timestamp = 1.5 WHERE id = 1",),
            "messages: row 1: timestamp: expected nanoseconds from 0 on, found real",
        ),
        (
            ("UPDATE messages SET timestamp = -1 WHERE id = 3",),
            "messages: row 3: timestamp: expected nanoseconds from 0 on, found -1",
        ),
        (
            ("UPDATE messages SET data = 'text' WHERE id = 2",),
            "messages: row 2: data: expected a blob, found text",
        ),
        (
            ("UPDATE messages SET topic_id = 9 WHERE id = 2",),
            "messages: row 2: expected a row in topics of topic_id 9, found none",
        ),
        (
            (*NULLS, "UPDATE messages SET topic_id = NULL WHERE id = 2"),
            "messages: row 2: expected a row in topics of topic_id None, found none",
        ),
        (
            ("UPDATE messages SET data = x'0001000000' WHERE id = 2",),
            "rows from 1: topic /turtle1/pose: message 1: expected 24 bytes, found 5",
        ),
        (
            ("UPDATE messages SET data = x'' WHERE id = 3",),
            "rows from 1: topic /turtle1/pose: message 2: expected 24 bytes, found 0",
        ),
        (
            ("UPDATE topics SET type = x'00'",),
            "topics: row 1: type: expected text, found b",
        ),
        (
            ("ALTER TABLE topics RENAME COLUMN name TO called",),
            "topics: expected a column name, found id, called, type",
        ),
        (
            ("ALTER TABLE messages RENAME TO kept", "CREATE VIEW messages AS SELECT * FROM kept"),
            "messages: expected a table, found CREATE VIEW messages",
        ),
        (
            (
                "ALTER TABLE messages RENAME COLUMN data TO kept",
                "ALTER TABLE messages ADD COLUMN data AS (zeroblob(9))",
            ),
            "messages: expected a column data, found id, topic_id, timestamp, kept, data computed",
        ),
        (
            ("DROP TABLE messages", "CREATE VIRTUAL TABLE messages USING fts5(topic_id, data)"),
            "messages: expected a table, found CREATE VIRTUAL TABLE",
        ),
    ],
)
def test_a_database_that_is_no_sound_bag_is_one_line(
    queries: tuple[str, ...], line: str, tmp_path: Path
) -> None:
    file = change(write_sqlite(tmp_path / "a.db3", make_poses(3)), *queries)
    with pytest.raises(LogError) as caught:
        read_columns(file)
    assert str(caught.value).startswith(f"{file}: {line}")
    assert len(str(caught.value).replace(str(file), "")) < 200


def test_messages_without_a_topic_are_named_before_they_are_read(tmp_path: Path) -> None:
    file = write_sqlite(tmp_path / "a.db3", make_poses(3))
    change(file, "UPDATE messages SET topic_id = 9 WHERE id > 1")
    line = r"a\.db3: messages: topic_id 9: expected a row in topics, found only messages: 2"
    with pytest.raises(LogError, match=line):
        read_info(file)


def test_a_topic_of_two_types_is_named(tmp_path: Path) -> None:
    file = write_sqlite(tmp_path / "a.db3", [*make_poses(2), make_command(topic="/b")])
    change(file, "UPDATE topics SET name = '/turtle1/pose'")
    line = "geometry_msgs/msg/Twist and turtlesim/msg/Pose"
    assert line in read_info(file).not_understood[0]
    with pytest.raises(LogError, match=rf"/turtle1/pose: not understood: .*{line}"):
        read_columns(file, ["/turtle1/pose"])


def test_a_view_within_the_schema_calls_nothing(tmp_path: Path) -> None:
    # Under a name of a table: what the list of tables says may differ from what SQLite parses.
    file = write_sqlite(tmp_path / "a.db3", make_poses(2))
    change(
        file,
        "ALTER TABLE messages RENAME TO kept",
        "CREATE VIEW messages AS SELECT topic_id, timestamp, data FROM kept",
        "PRAGMA writable_schema = ON",
        "UPDATE sqlite_master SET type = 'table', sql = 'create table messages(a)'"
        " WHERE name = 'timestamp_idx'",
    )
    with pytest.raises(LogError, match=r"a\.db3: "):
        read_columns(file)


@pytest.mark.parametrize("part", [0.3, 0.5, 0.999])
def test_a_file_that_is_cut_is_one_line(part: float, tmp_path: Path) -> None:
    file = write_sqlite(tmp_path / "a.db3", make_poses(500))
    content = file.read_bytes()
    size = int(part * len(content))
    # At the end of a page, and within one.
    size -= 0 if part == 0.999 else size % 4096
    file.write_bytes(content[:size])
    for read in (read_columns, read_info, open_bag):
        line = f"expected a SQLite file of {len(content)} bytes, found {size} bytes: cut"
        with pytest.raises(LogError, match=rf"a\.db3: {line} short; turtlelog recover reads"):
            read(file)


def test_what_is_no_bag_in_sqlite_is_one_line(tmp_path: Path) -> None:
    empty = tmp_path / "a.db3"
    empty.touch()
    with pytest.raises(LogError, match=r"a\.db3: expected a bag in SQLite, found an empty file"):
        read_info(empty)
    empty.write_bytes(b"SQLite format 3\x00")
    with pytest.raises(
        LogError, match=r"a\.db3: expected a SQLite file of pages of 65536 bytes, found 16"
    ):
        read_info(empty)
    with pytest.raises(LogError, match=r"b\.db3: expected a bag in SQLite, found: No such file"):
        read_info(tmp_path / "b.db3")
    (tmp_path / "c.db3").mkdir()
    with pytest.raises(LogError, match=r"c\.db3: expected a bag in SQLite, found: Is a directory"):
        read_info(tmp_path / "c.db3")


def test_flipped_bytes_are_one_line_or_what_was_written(tmp_path: Path) -> None:
    file, output = write_sqlite(tmp_path / "a.db3", make_poses(200)), tmp_path / "out.mcap"
    sound, random = file.read_bytes(), np.random.default_rng(7)
    outcomes = Counter[str]()
    for _ in range(60):
        content = bytearray(sound)
        # Where the trees are, rather than within messages.
        page, byte = random.integers(len(sound) // 4096), random.integers(120)
        content[4096 * page + byte] ^= 1 << random.integers(8)
        file.write_bytes(content)
        for read in (read_columns, read_info, lambda path: recover_recording(path, output)):
            try:
                read(file)
                outcomes["read"] += 1
            except LogError as err:
                is_line = str(err).startswith(str(file)) and "\n" not in str(err)
                outcomes["refused" if is_line else str(err)] += 1
    assert set(outcomes) == {"read", "refused"}
    assert min(outcomes.values()) > 20


def test_a_table_that_leads_in_circles_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = write_sqlite(tmp_path / "a.db3", make_poses(20_000))
    monkeypatch.setattr(sqlite_source, "_BASE_STEPS", 100_000)
    monkeypatch.setattr(sqlite_source, "_STEPS_A_BYTE", 0)
    with pytest.raises(LogError, match=r"found: pages that lead in circles, or far more rows"):
        read_info(file)


def test_blobs_that_share_their_pages_are_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = write_sqlite(tmp_path / "a.db3", make_poses(100))
    monkeypatch.setattr(sqlite_source, "_ROW_BYTES", 2000)  # as if 100 rows held 200 kB
    with pytest.raises(LogError, match=r"expected messages of up to \d+ bytes in all"):
        read_columns(file)


WAYS = [
    (StoragePlugin.SQLITE3, CompressionMode.FILE),
    (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    (StoragePlugin.MCAP, CompressionMode.FILE),
    (StoragePlugin.MCAP, CompressionMode.MESSAGE),
    (StoragePlugin.MCAP, CompressionMode.STORAGE),
    (StoragePlugin.SQLITE3, CompressionMode.NONE),
]


@pytest.mark.parametrize(
    ("storage", "mode"), WAYS, ids=[f"{storage.value}-{mode.value}" for storage, mode in WAYS]
)
def test_what_rosbags_writes_is_read_however_it_is_compressed(
    storage: StoragePlugin, mode: CompressionMode, tmp_path: Path
) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    said = [row for row in MIXED if not row.type.startswith("turtlesim")]
    expected = write_mcap(tmp_path / "a.mcap", said)
    raw = read_raw(expected)
    writer = Writer(tmp_path / "bag", version=9, storage_plugin=storage)
    if mode != CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {
            number: writer.add_connection(
                channel.topic, raw.schemas[channel.schema_id].name, typestore=store
            )
            for number, channel in raw.channels.items()
        }
        for message in raw.messages:
            writer.write(connections[message.channel_id], message.log_time, message.data)
    [found] = open_bag(tmp_path / "bag").read(["/odom", "/pose", "/turtle1/cmd_vel"])
    assert_equal(found, read_columns(expected))
    if mode == CompressionMode.FILE:
        [lone] = (tmp_path / "bag").glob("*.zstd")
        assert_equal(read_columns(lone), read_columns(expected))
        assert sorted(path.name for path in (tmp_path / "bag").iterdir()) == sorted(
            [lone.name, "metadata.yaml"]
        )
