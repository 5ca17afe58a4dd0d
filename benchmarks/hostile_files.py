"""Files below 10 MB that ask for far more than they hold, each made in a folder that is given."""

import json
import os
import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

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
from tests.torture.bombs import (
    CHUNK_INDEX,
    MIB,
    POSE as POSE_TYPE,
    STATISTICS,
    attachment,
    channel,
    chunk,
    cut,
    describe,
    message,
    metadata,
    record,
    schema,
    text,
    whole,
)
from turtlelog.log.recording.head import CHECKSUM, sum_up
from turtlelog.log.recording.topics import SCHEMAS

Make = Callable[[Path], Path]

_TOPIC: Final = (None, "/turtle1/pose", "turtlesim/msg/Pose", "cdr", "")
_YAML: Final = "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n"


def make_poses(count: int, *, step_ns: int = 16_000_000) -> bytes:
    """Return poses that stand still, each a step later than the one before."""
    pose = b"\0\1\0\0" + bytes(20)
    return b"".join(message(1, pose, number * step_ns) for number in range(count))


def _put(name: str, make: Callable[[], bytes | str]) -> Make:
    def put(folder: Path) -> Path:
        content, path = make(), folder / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return path

    return put


def _mcap(make: Callable[[], bytes]) -> Make:
    return _put("file.mcap", make)


def _sqlite(make: Callable[[], Database]) -> Make:
    return _put("file.db3", lambda: make().finish())


# SQLite


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


# MCAP


def _chunk_indexes() -> bytes:
    """Many entries of the summary that all name one chunk, which unpacks to 60 MB."""
    front = describe("/turtle1/pose")
    body = chunk([front, make_poses(2000), record(0x80, bytes(60 * MIB))])
    start = 8 + 9 + 12
    data_size = struct.unpack_from("<Q", body, 9 + 28 + 8)[0]
    unpacked = struct.unpack_from("<Q", body, 9 + 16)[0]
    entry = struct.pack("<QQQQ", 0, 2000 * 16_000_000, start, len(body)) + struct.pack("<I", 0)
    entry += struct.pack("<Q", 0) + text("zstd") + struct.pack("<QQ", data_size, unpacked)
    return whole(body, front + record(CHUNK_INDEX, entry) * 90_000)


def _statistics_lie(messages: int) -> bytes:
    front = describe("/turtle1/pose")
    body = chunk([front, make_poses(2000)])
    start = 8 + 9 + 12
    data_size = struct.unpack_from("<Q", body, 9 + 28 + 8)[0]
    unpacked = struct.unpack_from("<Q", body, 9 + 16)[0]
    entry = struct.pack("<QQQQ", 0, 2000 * 16_000_000, start, len(body)) + struct.pack("<I", 0)
    entry += struct.pack("<Q", 0) + text("zstd") + struct.pack("<QQ", data_size, unpacked)
    counts = struct.pack("<HQ", 1, messages)
    said = struct.pack("<QHIIIIQQI", messages, 1, 1, 0, 0, 1, 0, 2**62, len(counts)) + counts
    return whole(body, front + record(CHUNK_INDEX, entry) + record(STATISTICS, said))


def _long_names() -> bytes:
    """Schemas whose names are long and all of one letter."""
    name = "a" * 100_000
    schemas = (schema(number, name, "") for number in range(1, 16_000))
    return cut(chunk([describe("/a")]) + b"".join(chunk([part]) for part in schemas))


def _long_encodings() -> bytes:
    encoding = text("c" * 100_000)
    found = (
        record(4, struct.pack("<HH", number, 1) + text("/a") + encoding + text(""))
        for number in range(2, 16_000)
    )
    return cut(chunk([describe("/a")]) + b"".join(chunk([part]) for part in found))


def _define(definition: str, kind: str = "a/T0", encoding: str = "ros2msg") -> bytes:
    body = struct.pack("<H", 1) + text(kind) + text(encoding) + text(definition)
    front = record(3, body) + channel(1, "/a")
    return whole(chunk([front, message(1, bytes(64))]))


def _doubled(depth: int) -> str:
    bar = "=" * 80
    parts = [f"{bar}\nMSG: a/T{n}\nT{n + 1} a\nT{n + 1} b\n" for n in range(1, depth)]
    return "T1 a\nT1 b\n" + "".join(parts) + f"{bar}\nMSG: a/T{depth}\nint8 x\n"


def _claim_sequences() -> bytes:
    """Paths whose messages each claim 4 billion poses."""
    kind = "nav_msgs/msg/Path"
    definition = "uint8[] a\nstring[] b\nfloat64[] c\n"
    said = b"\0\1\0\0" + struct.pack("<I", 2**32 - 1) + bytes(12)
    messages = b"".join(message(1, said, number) for number in range(200_000))
    return whole(chunk([describe("/a", kind=kind, definition=definition), messages]))


def _claim_sizes() -> bytes:
    """Poses in a type with a text, whose lengths are right, of messages of many sizes."""
    definition = "string s\nuint8[] b\n"
    rows = b"".join(
        message(
            1,
            b"\0\1\0\0" + struct.pack("<I", 1) + bytes(4) + struct.pack("<I", n % 9) + bytes(n % 9),
            n,
        )
        for n in range(1_500_000)
    )
    return whole(chunk([describe("/a", kind="a/B", definition=definition), rows]))


def _json_messages(definition: str, said: str, count: int = 1) -> bytes:
    body = struct.pack("<H", 1) + text("a/B") + text("jsonschema") + text(definition)
    found = struct.pack("<HH", 1, 1) + text("/a") + text("json") + text("")
    return whole(chunk([record(3, body), record(4, found), message(1, said.encode()) * count]))


def _doubled_objects(depth: int) -> str:
    """Objects that each refer to the next one twice; the last one is empty."""
    parts: dict[str, Any] = {f"a{depth}": {"properties": {}}, "$ref": "#/a0"}
    for number in range(depth):
        inner = {"$ref": f"#/a{number + 1}"}
        parts[f"a{number}"] = {"properties": {"x": inner, "y": inner}}
    return json.dumps(parts)


def _long_numbers() -> bytes:
    names = [f"/robot{'9' * 5000}{number}/pose" for number in (1, 2)]
    pose = b"\0\1\0\0" + bytes(20)
    rows = (message(1 + n % 2, pose, n * 16_000_000) for n in range(200))
    return whole(chunk([describe(*names), *rows]))


def _own_recording(scenario: bytes = b"", **entries: str) -> bytes:
    """Return a recording of turtlelog with a scenario and some entries of its head changed."""
    head = {"format_version": "1", "source": "simulation", "name": "hostile", "absent": "[]"}
    head |= {"nan_columns": "[]", "notes": "{}"} | entries
    head[CHECKSUM] = sum_up(head)
    table = b"".join(text(key) + text(value) for key, value in head.items())
    data = chunk([describe("/turtle1/pose"), make_poses(100)])
    return whole(data + metadata("turtlelog", table) + attachment("scenario.toml", scenario))


def _many_poses(count: int) -> bytes:
    front = describe("/turtle1/pose")
    part = 100_000
    pose = b"\0\1\0\0" + bytes(20)
    chunks = []
    for start in range(0, count, part):
        rows = b"".join(message(1, pose, n * 2**20) for n in range(start, min(start + part, count)))
        chunks.append(chunk([front, rows]))
    return whole(b"".join(chunks))


def _paths(count: int, poses: int) -> bytes:
    """Plans of many poses, which all are zeros."""
    kind = "nav_msgs/msg/Path"
    one = b"\0\1\0\0" + bytes(8) + struct.pack("<I", 1) + bytes(4) + struct.pack("<I", poses)
    said = one + bytes(poses * 72 - 4)
    front = schema(2, kind, "") + channel(2, "/plan", 2)
    rows = b"".join(message(2, said, n) for n in range(count))
    return whole(chunk([describe("/turtle1/pose"), make_poses(1000)]) + chunk([front, rows]))


def _strings(count: int) -> bytes:
    said = b"\0\1\0\0" + struct.pack("<I", 60 * MIB) + bytes(60 * MIB)
    front = describe("/a", kind="std_msgs/msg/String", definition="string data\n")
    poses = chunk([schema(2, POSE_TYPE, SCHEMAS[POSE_TYPE]), channel(2, "/turtle1/pose", 2)])
    return whole(poses + b"".join(chunk([front, message(1, said, n)]) for n in range(count)))


def _transforms(count: int) -> bytes:
    """One message of transforms, each of a child of its own."""
    kind = "tf2_msgs/msg/TFMessage"
    one = bytes(8) + struct.pack("<I", 5) + b"base\0" + bytes(3)
    row = one + struct.pack("<I", 5) + b"link\0" + bytes(3) + bytes(56)
    said = b"\0\1\0\0" + struct.pack("<I", count) + row * count
    front = describe("/tf", kind=kind, definition="")
    return whole(chunk([front, *(message(1, said, n) for n in range(10))]))


def _lone_transforms(count: int) -> bytes:
    """Messages of one transform, of frames by turns: chains that a tree is made of."""
    kind = "tf2_msgs/msg/TFMessage"

    def link(number: int) -> bytes:
        names = [f"{(number + more) % 500:04}".encode() + b"\0" for more in (0, 1)]
        head = struct.pack("<III", 1, 0, 0) + struct.pack("<I", 5) + names[0] + bytes(3)
        return (
            b"\0\1\0\0"
            + head
            + struct.pack("<I", 5)
            + names[1]
            + bytes(3 + 4 + 48)
            + bytes(6)
            + b"\xf0\x3f"
        )

    front = describe("/tf", kind=kind, definition="")
    rows = [message(1, link(number), number) for number in range(count)]
    return whole(
        b"".join(chunk([front, *rows[at : at + 100_000]]) for at in range(0, count, 100_000))
    )


def _packed_twice() -> bytes:
    one = chunk([record(0x80, bytes(60 * MIB))])
    packer = zstandard.ZstdCompressor(level=3)
    return packer.compress(cut(chunk([describe("/turtle1/pose"), make_poses(10)]) + one * 20_000))


def _empty_frames() -> bytes:
    packer = zstandard.ZstdCompressor()
    first = packer.compress(cut(chunk([describe("/turtle1/pose"), make_poses(100)])))
    return first + packer.compress(b"") * 1_080_000


def _many_topics(count: int) -> bytes:
    topics = (channel(number, f"/robot{number}/pose") for number in range(1, count + 1))
    pose = b"\0\1\0\0" + bytes(20)
    said = (message(number, pose, number) for number in range(1, count + 1))
    return whole(chunk([schema(1, POSE_TYPE, SCHEMAS[POSE_TYPE]), *topics, *said]))


def _long_metadata() -> bytes:
    long = metadata("a", text("b") + text(bytes(70 * MIB)))
    return cut(chunk([describe("/turtle1/pose"), make_poses(10)]) + chunk([long]) * 12)


def _one_time(count: int) -> bytes:
    """Messages of one time, of which each might repeat another."""
    pose = b"\0\1\0\0" + bytes(16)
    rows = b"".join(message(1, pose + struct.pack("<I", number), 1) for number in range(count))
    return whole(chunk([describe("/turtle1/pose"), rows]))


def _odd_poses(count: int, values: bytes) -> bytes:
    rows = b"".join(message(1, b"\0\1\0\0" + values, n * 16_000_000) for n in range(count))
    return whole(chunk([describe("/turtle1/pose"), rows]))


def _ends_of_time() -> bytes:
    pose = b"\0\1\0\0" + bytes(20)
    times = [0, 1, 2**62, 2**63 - 1, 2**63, 2**64 - 1]
    return whole(chunk([describe("/turtle1/pose"), *(message(1, pose, time) for time in times)]))


# Tables and logs


def _parquet(folder: Path) -> Path:
    import numpy as np
    import pyarrow as pa
    from pyarrow import parquet

    count, path = 5_000_000, folder / "file.parquet"
    zeros = np.zeros(count)
    columns = {"t": zeros, "x": zeros, "y": zeros, "yaw": zeros}
    parquet.write_table(pa.table(columns), path, compression="zstd")
    return path


def _parquet_columns(folder: Path) -> Path:
    import pyarrow as pa
    from pyarrow import parquet

    path = folder / "file.parquet"
    parquet.write_table(pa.table({f"c{n}": [0.0] for n in range(20_000)}), path)
    return path


def _paper_json(rows: str) -> str:
    return f'{{"metadata": {{}}, "data": {rows}}}'


# Folders


def _folder(make: Callable[[Path], Any]) -> Make:
    def fill(folder: Path) -> Path:
        place = folder / "bag"
        place.mkdir()
        make(place)
        return place

    return fill


def _describe(text: str) -> Make:
    def put(place: Path) -> Path:
        (place / "metadata.yaml").write_text(text, "utf-8")
        (place / "bag_0.mcap").write_bytes(
            whole(chunk([describe("/turtle1/pose"), make_poses(100)]))
        )
        return place

    return _folder(put)


def _name_files(*names: str) -> Make:
    lines = "".join(f"    - {name}\n" for name in names)
    return _describe(f"{_YAML}  relative_file_paths:\n{lines}")


def _fill_with_files(place: Path) -> None:
    for number in range(100_000):
        (place / f"bag_{number}.mcap").touch()


def _nest_folders(place: Path) -> None:
    for number in range(400):
        place = place / f"{number % 10}"
    place.mkdir(parents=True)
    (place / "bag_0.mcap").write_bytes(b"")


def _put_pipe(place: Path) -> None:
    os.mkfifo(place / "bag_0.mcap")
    (place / "metadata.yaml").write_text(f"{_YAML}  relative_file_paths: [bag_0.mcap]\n", "utf-8")


def _put_device(place: Path) -> None:
    (place / "bag_0.mcap").symlink_to("/dev/zero")
    (place / "metadata.yaml").symlink_to("/dev/zero")


def _put_loop(place: Path) -> None:
    (place / "bag_0.mcap").symlink_to("bag_0.mcap")
    (place / "bag_1.mcap").symlink_to(".")
    (place / "metadata.yaml").symlink_to("metadata.yaml")


def _share_rows(place: Path) -> None:
    """Many links to one file that takes as much as a file may."""
    content = whole(chunk([describe("/turtle1/pose"), message(1) * 1_200_000]))
    (place / "bag_0.mcap").write_bytes(content)
    for number in range(1, 300):
        (place / f"bag_{number}.mcap").symlink_to("bag_0.mcap")


_LONG: Final = "a" * MIB

FILES: Final[Mapping[str, Make]] = MappingProxyType(
    {
        # Rows that lead to the same pages, and tables that SQLite reads before it is asked.
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
        "sqlite: damage in every other page": _put("file.db3", _damaged_leaves),
        "sqlite: rows up and down": _put("file.db3", _alternate_order),
        "sqlite: column rowid": _own_rowid,
        "sqlite: shared pages in a -wal": _wal,
        "sqlite: journal of 2^32 pages": _journal,
        "sqlite: 600,000 rows in .db3.zstd": _put("file.db3.zstd", _compressed_bag),
        "sqlite: 1 GB of zeros in .db3.zstd": _put(
            "file.db3.zstd",
            lambda: zstandard.compress(_bag().finish() + bytes(1000 * MIB)),
        ),
        "sqlite: least number of a row": _least_row,
        "sqlite: topic of 2.3 M letters in UTF-16": _long_topic,
        # Indexes, names, types and messages that claim more than there is.
        "mcap: 90,000 entries of one chunk": _mcap(_chunk_indexes),
        "mcap: statistics of 2^40 messages": _mcap(lambda: _statistics_lie(2**40)),
        "mcap: statistics of 2^63 messages": _mcap(lambda: _statistics_lie(2**63)),
        "mcap: long names of schemas": _mcap(_long_names),
        "mcap: long encodings of channels": _mcap(_long_encodings),
        "mcap: type within itself": _mcap(lambda: _define(f"T1 a\n{'=' * 80}\nMSG: a/T1\nT1 a\n")),
        "mcap: types that double": _mcap(lambda: _define(_doubled(60))),
        "mcap: IDL of modules in modules": _mcap(
            lambda: _define("module a { " * 40_000, "a/B", "ros2idl")
        ),
        "mcap: IDL of sequences in sequences": _mcap(
            lambda: _define(
                "struct B { " + "sequence<" * 50_000 + "long" + ">" * 50_000 + " a; };",
                "B",
                "ros2idl",
            )
        ),
        "mcap: IDL of names for names": _mcap(
            lambda: _define(
                "typedef long t0; "
                + " ".join(f"typedef t{n}[9] t{n + 1};" for n in range(10_000))
                + " struct B { t9999 a; };",
                "B",
                "ros2idl",
            )
        ),
        "mcap: sequences of 2^32": _mcap(_claim_sequences),
        "mcap: 1.5 M texts": _mcap(_claim_sizes),
        "mcap: texts of 60 MB": _mcap(lambda: _strings(25)),
        "mcap: JSON in JSON": _mcap(lambda: _json_messages('{"type": "object"}', "[" * 9_000_000)),
        "mcap: JSON number of 9 M digits": _mcap(
            lambda: _json_messages(
                '{"type": "object", "properties": {"a": {"type": "integer"}}}',
                f'{{"a": {"1" * 9_000_000}}}',
            )
        ),
        "mcap: JSON schema of itself": _mcap(
            lambda: _json_messages('{"$ref": "#", "properties": {"a": {"$ref": "#"}}}', "{}")
        ),
        "mcap: JSON schema of empty objects that double": _mcap(
            lambda: _json_messages(_doubled_objects(40), "{}")
        ),
        "mcap: topics of 5,000 digits": _mcap(_long_numbers),
        "mcap: JSON schema of 400,000 lists": _mcap(
            lambda: _json_messages('{"items":' * 400_000 + "{}" + "}" * 400_000, "{}")
        ),
        "mcap: 3 M poses": _mcap(lambda: _many_poses(3_000_000)),
        "mcap: plans of 100,000 poses": _mcap(lambda: _paths(10, 100_000)),
        "mcap: 900,000 transforms": _mcap(lambda: _transforms(90_000)),
        "mcap: 400,000 messages of a transform": _mcap(lambda: _lone_transforms(400_000)),
        "mcap: 20,000 chunks of 60 MB in .mcap.zstd": _put("file.mcap.zstd", _packed_twice),
        "mcap: 1 M empty frames in .mcap.zstd": _put("file.mcap.zstd", _empty_frames),
        "mcap: 65,000 topics of poses": _mcap(lambda: _many_topics(65_000)),
        "mcap: metadata of 70 MB": _mcap(_long_metadata),
        "mcap: commands at one time": _mcap(lambda: _one_time(500_000)),
        "mcap: poses of NaN": _mcap(lambda: _odd_poses(700_000, b"\0\0\xc0\x7f" * 5)),
        "mcap: poses at the ends of time": _mcap(_ends_of_time),
        "mcap: scenario of lists in lists": _mcap(lambda: _own_recording(b"a = " + b"[" * 250_000)),
        "mcap: scenario of a long key": _mcap(
            lambda: _own_recording(b".".join([b"a"] * 120_000) + b" = 1")
        ),
        "mcap: scenario of 240,000 digits": _mcap(lambda: _own_recording(b"a = " + b"1" * 240_000)),
        "mcap: declaration of lists in lists": _mcap(
            lambda: _own_recording(format_version="2", declaration="[" * 200_000)
        ),
        "mcap: scenario of 100,000 tables": _mcap(
            lambda: _own_recording(b"".join(b"[a%d]\n" % number for number in range(100_000)))
        ),
        "mcap: notes of 250 kB": _mcap(
            lambda: _own_recording(notes=json.dumps({str(n): "a" for n in range(18_000)}))
        ),
        # Tables and logs.
        "csv: 400,000 columns": _put(
            "file.csv",
            lambda: (
                "t,x,y,heading,"
                + ",".join(f"c{n}" for n in range(400_000))
                + "\n"
                + "0," * 400_003
                + "0\n"
            ),
        ),
        "csv: a cell of 9 MB": _put(
            "file.csv", lambda: 't,x,y,heading\n0,"' + "\n" * 9_000_000 + '",0,0\n'
        ),
        "csv: 4.9 M empty lines": _put(
            "file.csv", lambda: "t,x,y,heading\n0,0,0,0\n" + "\n" * 9_800_000
        ),
        "csv: 1.2 M rows of zeros": _put(
            "file.csv", lambda: "t,x,y,heading\n" + "0,0,0,0\n" * 1_200_000
        ),
        "csv: 350,000 rows": _put(
            "file.csv", lambda: "t,x,y,heading\n" + "".join(f"{n},0,0,0\n" for n in range(350_000))
        ),
        "csv: numbers of 2.4 M digits": _put(
            "file.csv", lambda: "t,x,y,heading\n" + ",".join(["1" * 2_400_000] * 4)
        ),
        "csv: quotes": _put("file.csv", lambda: "t,x,y,heading\n" + '"' * 9_000_000),
        "csv: texts for times": _put(
            "file.csv",
            lambda: (
                "t,x,y,heading\n"
                + "".join(
                    f"2020-01-01T{n // 3600:02}:{n // 60 % 60:02}:{n % 60:02}+01:00,0,0,0\n"
                    for n in range(86_400)
                )
            ),
        ),
        "csv: dates and 120,000 blanks": _put(
            "file.csv",
            lambda: "t,x,y,heading\n" + ("2020-01-01T00:00:00" + " " * 120_000 + "x,0,0,0\n") * 80,
        ),
        "tum: 600,000 rows": _put(
            "file.tum", lambda: "".join(f"{n} 0 0 0 0 0 0 1\n" for n in range(420_000))
        ),
        "tum: quaternions of 1e308": _put(
            "file.tum",
            lambda: "".join(f"{n} 0 0 0 1e308 1e308 1e308 1e308\n" for n in range(250_000)),
        ),
        "tum: one line": _put("file.tum", lambda: "0 " * 4_900_000),
        "tum: blanks": _put("file.tum", lambda: "0 0 0 0 0 0 0 1\n" + " " * 9_800_000),
        "tum: comments": _put("file.tum", lambda: "#\n" * 4_800_000 + "0 0 0 0 0 0 0 1\n"),
        "json: lists in lists": _put("file.json", lambda: "[" * 9_800_000),
        "json: 4.9 M numbers": _put("file.json", lambda: "[" + "1," * 4_900_000 + "1]"),
        "json: 3 M empty objects": _put(
            "file.json", lambda: _paper_json("[" + "{}," * 3_200_000 + "{}]")
        ),
        "json: number of 9 M digits": _put("file.json", lambda: _paper_json("1" * 9_800_000)),
        "parquet: 5 M rows of zeros": _parquet,
        "parquet: 20,000 columns": _parquet_columns,
        # Bags in folders.
        "yaml: a line of blanks and quotes": _describe(_YAML + "  x: " + "' " * 4_900_000),
        "yaml: blanks": _describe(_YAML + " " * 9_800_000),
        "yaml: anchors": _describe(
            _YAML
            + "  a0: &a0 [x, x]\n"
            + "".join(f"  a{n + 1}: &a{n + 1} [*a{n}, *a{n}]\n" for n in range(64))
        ),
        "yaml: lists in lists": _describe(_YAML + "  x: " + "[" * 9_000_000),
        "yaml: 100,000 files": _name_files(*(f"bag_{n}.mcap" for n in range(100_000))),
        "yaml: a file 100,000 times": _name_files(*["bag_0.mcap"] * 100_000),
        "yaml: files elsewhere": _name_files("../../../etc/passwd", "/etc/passwd"),
        "yaml: itself": _name_files("metadata.yaml"),
        "folder: pipe": _folder(_put_pipe),
        "folder: /dev/zero": _folder(_put_device),
        "folder: links to themselves": _folder(_put_loop),
        "folder: 300 links to one file": _folder(_share_rows),
        "folder: 400 folders deep": _folder(_nest_folders),
        "folder: 100,000 empty files": _folder(_fill_with_files),
    }
)
"""By name, of which the first word is the kind."""
