import shutil
import sqlite3
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from numpy.typing import NDArray
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from tests.log.engine.raw_records import read_raw
from tests.log.ros2.bags import (
    START_NS,
    change,
    make_command,
    make_odometry,
    make_poses,
    make_stamped_pose,
    write_mcap,
    write_sqlite,
)
from tests.log.runs import find_shared
from turtlelog.errors import LogError
from turtlelog.log import TopicColumns, iter_columns, read_columns, read_info, read_run
from turtlelog.log.engine import sqlite_source
from turtlelog.log.ros2.bag_rows import open_bag

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
    for asked in (["/turtle1/pose"], None):
        with pytest.raises(LogError, match=rf"a\.db3: topic /turtle1/pose: not understood: {line}"):
            read_columns(file, asked)


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
