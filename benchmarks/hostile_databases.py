"""Hostile bags in SQLite: rows and pages that lead to the same bytes, and tables that lie."""

import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Final

import zstandard

from benchmarks.hostile_sqlite import (
    DEFINITIONS,
    MESSAGES,
    POSE,
    TOPICS,
    Cell,
    Choose,
    Database,
    make_page,
    make_wal,
    repeat_cell,
)
from benchmarks.put_files import Make, put_file
from tests.torture.bombs import MIB

_TOPIC: Final = (None, "/turtle1/pose", "turtlesim/msg/Pose", "cdr", "")


def _sqlite(make: Callable[[], Database]) -> Make:
    return put_file("file.db3", lambda: make().finish())


def _bag(page_size: int = 4096, **rows: Callable[[Database], list[Cell]]) -> Database:
    """Return a bag of ten poses, but for the rows of the tables that are given."""
    bag = Database(page_size)
    usual: dict[str, Callable[[Database], list[Cell]]] = {
        "topics": lambda bag: bag.make_rows(lambda _: _TOPIC, 1),
        "messages": lambda bag: bag.make_rows(_choose_pose, 10),
    }
    sql = {"topics": TOPICS, "messages": MESSAGES, "message_definitions": DEFINITIONS}
    for name, make in (usual | rows).items():
        bag.add_table(name, sql[name], make(bag))
    return bag


def _choose_pose(row: int) -> tuple[None, int, int, bytes]:
    return (None, 1, row * 16_000_000, POSE)


def _share(table: str, choose: Choose, count: int) -> Make:
    return _sqlite(lambda: _bag(512, **{table: lambda bag: bag.share_chain(choose, count)}))


def _repeat_rows() -> Database:
    bag = Database(2**16)
    bag.add_table("topics", TOPICS, bag.make_rows(lambda _: _TOPIC, 1))
    cell = bag.make_cell(1, (None, 1, 1, bytes(15_000)))
    leaves = [bag.add_page(repeat_cell(cell, 20_000, 2**16)) for _ in range(140)]
    children = [bag.make_child(leaf, key) for key, leaf in enumerate(leaves)]
    bag.name_table("messages", MESSAGES, bag.add_page(make_page(5, children, 2**16)))
    return bag


def _double_pages(levels: int = 18) -> Database:
    bag = Database(512)
    bag.add_table("topics", TOPICS, bag.make_rows(lambda _: _TOPIC, 1))
    page = bag.add_page(make_page(13, bag.make_rows(_choose_pose, 5), 512))
    for _ in range(levels):
        page = bag.add_page(make_page(5, [bag.make_child(page, key) for key in range(40)], 512))
    bag.name_table("messages", MESSAGES, page)
    return bag


def _view() -> Database:
    bag = _bag()
    bag.name_table("many", f"CREATE VIEW many AS VALUES(1){',(1)' * 2_300_000}", 0, kind="view")
    return bag


def _default() -> Database:
    bag = Database()
    sql = MESSAGES.replace("topic_id INTEGER NOT NULL", f"topic_id DEFAULT '{'1' * 30_000}'")
    sql = sql.replace("id INTEGER PRIMARY KEY,", "").replace("(topic_id", "(id, topic_id")
    bag.add_table("topics", TOPICS, bag.make_rows(lambda _: _TOPIC, 1))
    bag.add_table("messages", sql, bag.make_rows(lambda _: (None,), 900_000))
    return bag


def _statistics() -> Database:
    bag = _bag(512)
    long = "a" * 4 * MIB
    sql = "CREATE TABLE sqlite_stat1(tbl,idx,stat)"
    bag.add_table("sqlite_stat1", sql, bag.share_chain(lambda _: (long, "b", "1"), 9_000))
    return bag


def _junk_first() -> Database:
    bag = Database(512)
    sql = "CREATE TABLE messages(kept, topic_id INTEGER, timestamp INTEGER, data BLOB)"
    long = bytes(4 * MIB)
    bag.add_table("topics", TOPICS, bag.make_rows(lambda _: _TOPIC, 1))
    payload = bag.share_chain(lambda row: (long, 1, row, POSE), 9_000)
    bag.add_table("messages", sql, payload)
    return bag


def _claims_in_damage() -> Database:
    """Rows that claim up to 4 GB each, a few below what recover lets through."""
    bag = Database(512)
    bag.add_table("topics", TOPICS, bag.make_rows(lambda _: _TOPIC, 1))
    long = bytes(4 * MIB)
    sql = "CREATE TABLE messages(kept, topic_id INTEGER, timestamp INTEGER, data BLOB)"
    bag.add_table("messages", sql, bag.share_chain(lambda row: (long, 1, row, POSE), 60))
    return bag


def _damaged_leaves() -> bytes:
    """Every other page of messages is damaged, and the rows' numbers lie far apart."""
    bag = Database(512)
    bag.add_table("topics", TOPICS, bag.make_rows(lambda _: _TOPIC, 1))
    step = 2**44
    rows = [bag.make_cell(row * step, _choose_pose(row)) for row in range(1, 150_000)]
    bag.add_table("messages", MESSAGES, rows)
    content = bytearray(bag.finish())
    for page in range(2, len(content) // 512 - 200, 2):
        if content[page * 512] == 13:
            content[page * 512] = 0
    return bytes(content)


def _alternate_order() -> bytes:
    """Numbers of rows go up and down by turns."""
    bag = Database(512)
    bag.add_table("topics", TOPICS, bag.make_rows(lambda _: _TOPIC, 1))
    rows = [
        bag.make_cell(row + (1000 if row % 2 else 0), _choose_pose(row))
        for row in range(1, 150_000)
    ]
    bag.add_table("messages", MESSAGES, rows)
    return bag.finish()


def _with(*statements: str) -> Make:
    """Make a sound bag on which some statements were run."""

    def make(folder: Path) -> Path:
        import sqlite3

        path = folder / "file.db3"
        path.write_bytes(_bag().finish())
        connection = sqlite3.connect(path)
        for statement in statements:
            connection.execute(statement)
        connection.commit()
        connection.close()
        return path

    return make


def _free_circle() -> bytes:
    """A list of free pages whose only page comes after itself."""
    content = bytearray(_bag().finish())
    size = struct.unpack_from(">H", content, 16)[0]
    page = len(content) // size + 1
    struct.pack_into(">III", content, 28, page, page, 2**31)
    return bytes(content) + struct.pack(">II", page, 0) + bytes(size - 8)


def _own_rowid(folder: Path) -> Path:
    import sqlite3

    path = folder / "file.db3"
    path.write_bytes(_bag().finish())
    connection = sqlite3.connect(path)
    connection.execute("DROP TABLE messages")
    connection.execute(MESSAGES.replace("data BLOB", "rowid DEFAULT 7, data BLOB"))
    rows = [(1, row * 16_000_000, POSE) for row in range(200)]
    query = "INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)"
    connection.executemany(query, rows)
    connection.commit()
    connection.close()
    return path


def _least_row(folder: Path) -> Path:
    """The first row has the least number that there is."""
    first = Database().make_cell(-(2**63), _choose_pose(0))
    bag = _bag(messages=lambda bag: [first, *bag.make_rows(_choose_pose, 199)])
    path = folder / "file.db3"
    path.write_bytes(bag.finish())
    return path


def _long_topic(folder: Path) -> Path:
    import sqlite3

    path = folder / "file.db3"
    connection = sqlite3.connect(path)
    connection.execute("PRAGMA encoding = 'UTF-16le'")
    connection.execute(TOPICS)
    connection.execute(MESSAGES)
    topic = (1, "/" + "\U0001f600" * 2_300_000, *_TOPIC[2:])
    connection.execute("INSERT INTO topics VALUES(?, ?, ?, ?, ?)", topic)
    rows = [(None, 1, row * 16_000_000, POSE) for row in range(100)]
    connection.executemany("INSERT INTO messages VALUES(?, ?, ?, ?)", rows)
    connection.commit()
    connection.close()
    return path


def _wal(folder: Path) -> Path:
    """A sound file, and a log beside it that makes it one whose rows share their pages."""
    long = "a" * MIB
    shared = _bag(
        4096, topics=lambda bag: bag.share_chain(lambda r: (None, f"/{r:4}", long, "", ""), 900)
    ).finish()
    path = folder / "file.db3"
    sound = bytearray(_bag().finish())
    sound[18:20] = b"\2\2"
    path.write_bytes(sound)
    path.with_name("file.db3-wal").write_bytes(make_wal(shared, 4096))
    return path


def _journal(folder: Path) -> Path:
    """A journal that says that the file had 2^32 pages."""
    path = folder / "file.db3"
    path.write_bytes(_bag().finish())
    head = bytes.fromhex("d9d505f920a163d7") + struct.pack(">5I", 0, 1, 2**32 - 2, 512, 4096)
    path.with_name("file.db3-journal").write_bytes(head.ljust(512, b"\0") + bytes(4096))
    return path


def _compressed_bag() -> bytes:
    bag = _bag(4096, messages=lambda bag: bag.make_rows(_choose_pose, 600_000))
    return zstandard.compress(bag.finish(), 3)


_LONG: Final = "a" * MIB

FILES: Final[Mapping[str, Make]] = MappingProxyType(
    {
        "sqlite: shared topics.type": _share(
            "topics", lambda row: (None, f"/{row:6}", _LONG, "cdr", ""), 800
        ),
        "sqlite: shared serialization_format": _share(
            "topics", lambda row: (None, f"/{row:6}", "a/B", 2 * _LONG, ""), 800
        ),
        "sqlite: shared definitions": _share(
            "message_definitions", lambda row: (None, f"a/{row:6}", "ros2msg", 2 * _LONG, ""), 2000
        ),
        "sqlite: shared topic_id": _share(
            "messages", lambda row: (None, 2 * _LONG, row, POSE), 5000
        ),
        "sqlite: shared timestamp": _share("messages", lambda _: (None, 1, 2 * _LONG, POSE), 5000),
        "sqlite: shared blobs": _share(
            "messages", lambda row: (None, 1, row, bytes(7 * MIB)), 2000
        ),
        "sqlite: blobs that recover lets through": _share(
            "messages", lambda row: (None, 1, row, bytes(7 * MIB)), 60
        ),
        "sqlite: one row in many places": _sqlite(_repeat_rows),
        "sqlite: pages of pages": _sqlite(_double_pages),
        "sqlite: view of 2.3 M rows": _sqlite(_view),
        "sqlite: default of 30 kB": _sqlite(_default),
        "sqlite: shared sqlite_stat1": _sqlite(_statistics),
        "sqlite: long column first": _sqlite(_junk_first),
        "sqlite: long column first, 60 rows": _sqlite(_claims_in_damage),
        "sqlite: damage in every other page": put_file("file.db3", _damaged_leaves),
        "sqlite: rows up and down": put_file("file.db3", _alternate_order),
        "sqlite: column rowid": _own_rowid,
        "sqlite: free pages in a circle": put_file("file.db3", _free_circle),
        "sqlite: 1,000 tables more": _with(*(f"CREATE TABLE t{n}(a)" for n in range(1000))),
        "sqlite: view without end": _with(
            "ALTER TABLE messages RENAME TO m",
            "CREATE VIEW messages AS WITH RECURSIVE c(id) AS (SELECT 1 UNION ALL SELECT id + 1"
            " FROM c) SELECT id, 1 AS topic_id, id AS timestamp, zeroblob(24) AS data FROM c",
        ),
        "sqlite: shared pages in a -wal": _wal,
        "sqlite: journal of 2^32 pages": _journal,
        "sqlite: 600,000 rows in .db3.zstd": put_file("file.db3.zstd", _compressed_bag),
        "sqlite: 1 GB of zeros in .db3.zstd": put_file(
            "file.db3.zstd",
            lambda: zstandard.compress(_bag().finish() + bytes(1000 * MIB)),
        ),
        "sqlite: least number of a row": _least_row,
        "sqlite: topic of 2.3 M letters in UTF-16": _long_topic,
    }
)
"""By name."""
