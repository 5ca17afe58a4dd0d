"""Bags in SQLite whose pages claim what they do not hold: counted before anything is read."""

import struct
from collections.abc import Callable
from pathlib import Path

import pytest

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
from tests.log.ros2.bags import change, make_poses, write_sqlite
from turtlelog.errors import LogError
from turtlelog.log import read_columns, read_info, recover_recording, recovery
from turtlelog.log.engine import limits

TOPIC = (None, "/turtle1/pose", "turtlesim/msg/Pose", "cdr", "")
LONG = "a" * 50_000
SQL = {"topics": TOPICS, "messages": MESSAGES, "message_definitions": DEFINITIONS}

Read = Callable[[Path], object]


def recover(path: Path) -> object:
    return recover_recording(path, path.with_name("out.mcap"))


READERS: list[Read] = [read_info, read_columns, recover]


def make_bag(**tables: list[Cell] | int) -> Database:
    """Return a sound bag of ten poses with other tables, by their rows or root pages."""
    bag = Database()
    rows = {"topics": bag.make_rows(lambda _: TOPIC, 1), "messages": bag.make_rows(choose_pose, 10)}
    for name, found in (rows | tables).items():
        root = found if isinstance(found, int) else bag.add_tree(found)
        bag.name_table(name, SQL[name], root)
    return bag


def choose_pose(number: int) -> tuple[None, int, int, bytes]:
    return (None, 1, number, POSE)


def write(bag: Database, folder: Path) -> Path:
    file = folder / "a.db3"
    file.write_bytes(bag.finish())
    return file


SHARED: dict[str, tuple[str, Choose]] = {
    "type": ("topics", lambda row: (None, f"/{row}", LONG, "cdr", "")),
    "serialization_format": ("topics", lambda row: (None, f"/{row}", "a/B", LONG, "")),
    "definition": ("message_definitions", lambda row: (None, f"a/B{row:4}", "ros2msg", LONG, "")),
    "topic_id": ("messages", lambda row: (None, LONG, row, POSE)),
    "timestamp": ("messages", lambda row: (None, 1, LONG, POSE)),
    "data": ("messages", lambda row: (None, 1, row, LONG.encode())),
}


def test_pages_made_by_hand_are_a_bag(tmp_path: Path) -> None:
    file = write(make_bag(), tmp_path)
    assert len(read_columns(file)["/turtle1/pose"]) == 10


def share(column: str, count: int) -> Database:
    """Return a bag with rows whose values of a column are one chain of pages."""
    table, choose = SHARED[column]
    bag = Database(512)
    for name, sql in SQL.items():
        rows = bag.make_rows(lambda _: TOPIC, int(name == "topics"))
        bag.add_table(name, sql, bag.share_chain(choose, count) if name == table else rows)
    return bag


@pytest.mark.parametrize("column", SHARED)
@pytest.mark.parametrize("read", READERS)
def test_rows_that_share_one_chain_of_pages_are_refused(
    column: str, read: Read, tmp_path: Path
) -> None:
    file = write(share(column, 500), tmp_path)
    with pytest.raises(
        LogError, match=r"a\.db3: expected rows of up to \d+ bytes in all, the size"
    ):
        read(file)


def test_recover_stops_at_the_size_of_the_file(tmp_path: Path) -> None:
    file = write(share("data", 40), tmp_path)
    report = recover_recording(file, tmp_path / "out.mcap")
    assert report.recovered == {"/turtle1/pose": 1}
    assert report.lost[-1].reason == "expected messages of the size of the file"


def test_recover_keeps_no_more_texts_than_a_file_may_hold(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "_BASES", {**limits._BASES, limits.SCHEMA_BYTES: (0, 2)})
    file = write(share("definition", 40), tmp_path)
    with pytest.raises(LogError, match=r"a\.db3: expected up to \d+ bytes of schemas in a file of"):
        recover_recording(file, tmp_path / "out.mcap")


def test_a_bag_may_be_as_full_of_rows_as_of_bytes(tmp_path: Path) -> None:
    bag = Database()
    bag.add_table("topics", TOPICS, bag.make_rows(lambda _: TOPIC, 1))
    rows = bag.make_rows(lambda row: (None, 1, row, bytes(100_000)), 20)
    bag.add_table("messages", MESSAGES, rows)
    file = write(bag, tmp_path)
    assert 0.98 * file.stat().st_size < 20 * 100_000
    assert read_info(file).topics[0].count == 20


def test_recover_lets_some_rows_claim_too_much(tmp_path: Path) -> None:
    rows = Database().make_rows(choose_pose, 100)
    rows[6] = Cell(7, b"\xff\xff\xff\xff\x7f" + rows[6].data[1:])
    file = write(make_bag(messages=rows), tmp_path)
    with pytest.raises(
        LogError, match=r"claim a wrong length; turtlelog convert --recover reads what is left"
    ):
        read_info(file)
    report = recover_recording(file, tmp_path / "out.mcap")
    assert not report.complete
    assert report.recovered["/turtle1/pose"] >= 90


@pytest.mark.parametrize("read", READERS[:2])
def test_a_page_in_two_places_is_refused(read: Read, tmp_path: Path) -> None:
    bag = Database()
    bag.add_table("topics", TOPICS, bag.make_rows(lambda _: TOPIC, 1))
    leaf = bag.add_page(make_page(13, bag.make_rows(choose_pose, 10), bag.page_size))
    twice = [bag.make_child(leaf, key) for key in (10, 20, 30)]
    bag.name_table("messages", MESSAGES, bag.add_page(make_page(5, twice, bag.page_size)))
    with pytest.raises(LogError, match=r"a\.db3: page \d+: expected each page in one table once"):
        read(write(bag, tmp_path))


@pytest.mark.parametrize("read", READERS)
def test_one_row_in_many_places_of_its_page_is_refused(read: Read, tmp_path: Path) -> None:
    bag = Database(2**16)
    row = bag.make_cell(1, (None, 1, 1, POSE + bytes(30_000)))
    bag.add_table("topics", TOPICS, bag.make_rows(lambda _: TOPIC, 1))
    page = bag.add_page(repeat_cell(row, 10_000, bag.page_size))
    bag.name_table("messages", MESSAGES, page)
    with pytest.raises(LogError, match=r"a\.db3: expected rows of up to \d+ bytes in all"):
        read(write(bag, tmp_path))


@pytest.mark.parametrize("read", READERS)
def test_definitions_of_tables_that_no_bag_has_are_refused(read: Read, tmp_path: Path) -> None:
    bag = make_bag()
    bag.name_table("more", f"CREATE VIEW more AS VALUES(1){',(1)' * 2**14}", 0, kind="view")
    with pytest.raises(
        LogError, match=r"a\.db3: expected up to 65536 bytes that define up to 1024"
    ):
        read(write(bag, tmp_path))


def test_a_root_that_is_no_number_is_refused(tmp_path: Path) -> None:
    bag = make_bag()
    bag.name_table("more", "CREATE TABLE more(a)", "7")  # type: ignore[arg-type]
    with pytest.raises(LogError, match=r"a\.db3: .*found a damaged table of tables"):
        read_info(write(bag, tmp_path))


def test_a_long_default_counts_for_every_row_that_has_it(tmp_path: Path) -> None:
    bag = Database()
    default = f"DEFAULT x'{'00' * 20_000}'"
    sql = MESSAGES.replace("NOT NULL)", f"{default})")
    bag.add_table("topics", TOPICS, bag.make_rows(lambda _: TOPIC, 1))
    bag.add_table("messages", sql, bag.make_rows(lambda row: (None, 1, row), 100))
    file = write(bag, tmp_path)
    with pytest.raises(LogError, match=r"expected messages of up to \d+ bytes in all, the size of"):
        read_columns(file)
    report = recover_recording(file, tmp_path / "out.mcap")
    assert report.lost[-1].reason == "expected messages of the size of the file"


def write_with_column(file: Path, column: str, count: int = 200) -> Path:
    """Write a bag whose messages have one column more, of a name that means the row's number."""
    write_sqlite(file, make_poses(count))
    return change(
        file,
        "ALTER TABLE messages RENAME TO kept",
        f"CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,"
        f" timestamp INTEGER NOT NULL, data BLOB NOT NULL, {column})",
        "INSERT INTO messages(topic_id, timestamp, data)"
        " SELECT topic_id, timestamp, data FROM kept ORDER BY id",
        "DROP TABLE kept",
    )


@pytest.mark.parametrize(
    "column",
    [
        *("rowid", "oid", "_rowid_", "ROWID TEXT DEFAULT 'x'", '"RowId" BLOB COLLATE NOCASE'),
        *("rowid DEFAULT 7, oid DEFAULT 7", "rowid AS (1)", "rowid AS (1) STORED, _rowid_ AS (9)"),
    ],
)
def test_a_column_may_be_called_like_the_number_of_its_row(column: str, tmp_path: Path) -> None:
    file = write_with_column(tmp_path / "a.db3", column)
    report = recover_recording(file, tmp_path / "out.mcap")
    assert (report.complete, report.recovered["/turtle1/pose"]) == (True, 200)
    times = read_columns(file)["/turtle1/pose"].log_time_ns
    assert times.tolist() == sorted(times.tolist())
    assert len(times) == 200


def test_the_least_number_that_there_is_may_be_that_of_a_row(tmp_path: Path) -> None:
    first = Database().make_cell(-(2**63), choose_pose(0))
    file = write(make_bag(messages=[first, *Database().make_rows(choose_pose, 9)]), tmp_path)
    report = recover_recording(file, tmp_path / "out.mcap")
    assert (report.complete, report.recovered["/turtle1/pose"]) == (True, 10)


def test_the_greatest_number_that_there_is_may_be_that_of_a_row(tmp_path: Path) -> None:
    last = Database().make_cell(2**63 - 1, choose_pose(10))
    file = write(make_bag(messages=[*Database().make_rows(choose_pose, 9), last]), tmp_path)
    report = recover_recording(file, tmp_path / "out.mcap")
    assert (report.complete, report.recovered["/turtle1/pose"]) == (True, 10)


@pytest.mark.parametrize("read", READERS)
def test_rows_without_numbers_are_refused(read: Read, tmp_path: Path) -> None:
    file = write_with_column(tmp_path / "a.db3", "rowid, oid, _rowid_")
    with pytest.raises(LogError, match=r"a\.db3: messages: expected rows with numbers, found col"):
        read(file)
    change(
        file,
        "DROP TABLE messages",
        "CREATE TABLE messages(topic_id INTEGER, timestamp INTEGER PRIMARY KEY, data BLOB)"
        " WITHOUT ROWID",
    )
    with pytest.raises(LogError, match=r"a\.db3: messages: its rows have no numbers"):
        read(file)


def test_rows_out_of_order_are_told(tmp_path: Path) -> None:
    rows = Database().make_rows(choose_pose, 200)
    rows[100:] = [Cell(cell.key - 100, cell.data) for cell in rows[100:]]
    file = write(make_bag(messages=[replace_key(cell) for cell in rows]), tmp_path)
    report = recover_recording(file, tmp_path / "out.mcap")
    assert not report.complete
    assert [loss.reason for loss in report.lost][-1].startswith("messages behind row 100: ")


def replace_key(cell: Cell) -> Cell:
    """Return a short row with its number written anew."""
    return Cell(cell.key, cell.data[:1] + struct.pack("B", cell.key) + cell.data[2:])


def test_no_more_rows_are_named_than_anybody_reads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recovery, "_MOST_NAMED", 5)
    rows = Database().make_rows(lambda row: (None, 1 if row < 3 else 9, row, POSE), 9)
    file = write(make_bag(messages=rows), tmp_path)
    reasons = [loss.reason for loss in recover_recording(file, tmp_path / "out.mcap").lost]
    assert len(reasons) == 6
    assert reasons[-1] == "messages: 2 rows more that are no messages"


def write_wal(file: Path, bag: Database, page_size: int = 4096) -> Path:
    """Write the pages of a bag as a log beside a sound file."""
    content = bytearray(make_bag().finish())
    content[18:20] = b"\2\2"
    file.write_bytes(content)
    file.with_name("a.db3-wal").write_bytes(make_wal(bag.finish(), page_size))
    return file


def test_what_stands_beside_a_file_counts(tmp_path: Path) -> None:
    file = write_wal(tmp_path / "a.db3", make_bag(messages=Database().make_rows(choose_pose, 30)))
    assert len(read_columns(file)["/turtle1/pose"]) == 30
    bag = Database()
    bag.add_table("topics", TOPICS, bag.make_rows(lambda _: TOPIC, 1))
    bag.add_table("messages", MESSAGES, bag.share_chain(SHARED["data"][1], 500))
    with pytest.raises(LogError, match=r"a\.db3: expected rows of up to \d+ bytes in all"):
        read_info(write_wal(file, bag))


def test_a_journal_does_not_make_a_file_larger(tmp_path: Path) -> None:
    file = write(make_bag(), tmp_path)
    head = bytes.fromhex("d9d505f920a163d7") + struct.pack(">5I", 0, 1, 2**20, 512, 4096)
    file.with_name("a.db3-journal").write_bytes(head.ljust(512, b"\0") + bytes(4096))
    with pytest.raises(LogError, match=r"a\.db3: expected a SQLite file of up to \d+ bytes, found"):
        read_info(file)
