"""Bags in SQLite that are cut, corrupt, malicious or no bag: one line each."""

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from tests.log.ros2.bags import change, make_command, make_poses, write_sqlite
from turtlelog.errors import LogError
from turtlelog.log import read_columns, read_info, recover_recording
from turtlelog.log.engine import sqlite_source
from turtlelog.log.ros2.bag_rows import open_bag

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
            "messages: row 2: the table topics has no topic_id 9",
        ),
        (
            (*NULLS, "UPDATE messages SET topic_id = NULL WHERE id = 2"),
            "messages: row 2: topic_id: expected a whole number, found null",
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
        with pytest.raises(LogError, match=rf"a\.db3: {line} short; turtlelog convert"):
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
    with pytest.raises(LogError, match=r"b\.db3: no such file$"):
        read_info(tmp_path / "b.db3")
    (tmp_path / "c.db3").mkdir()
    with pytest.raises(LogError, match=r"c\.db3: expected a bag in SQLite, found: Is a directory"):
        read_info(tmp_path / "c.db3")


@pytest.mark.thorough
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
