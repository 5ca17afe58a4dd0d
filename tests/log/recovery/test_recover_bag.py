import shutil
import sqlite3
from pathlib import Path

import pytest
import zstandard
from rosbags.highlevel import AnyReader

from tests.log.ros2.bags import make_command, make_poses, write_mcap, write_metadata, write_sqlite
from turtlelog.errors import LogError
from turtlelog.log import (
    PartialRecordingWarning,
    read_columns,
    read_info,
    read_run,
    recover_recording,
)
from turtlelog.log.ros2 import read_bag_info
from turtlelog.log.ros2.bag_files import parse_bag_metadata

ROWS = 3000
PAGE = 4096
POSE = "/turtle1/pose"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    poses = make_poses(ROWS)
    return write_sqlite(tmp_path_factory.mktemp("whole") / "a.db3", [make_command(), *poses])


def find_leaves(file: Path) -> list[int]:
    """Return the numbers of the pages that hold the messages, from 1 on, in their order."""
    connection = sqlite3.connect(file)
    query = "SELECT pageno FROM dbstat WHERE name = 'messages' AND pagetype = 'leaf' ORDER BY path"
    try:
        return [page for (page,) in connection.execute(query)]
    except sqlite3.OperationalError:
        content = file.read_bytes()
        pages = [content[at : at + PAGE] for at in range(0, len(content), PAGE)]
        return [
            number
            for number, page in enumerate(pages, start=1)
            if page[0] == 13 and page.count(b"\x00\x01\x00\x00") > 20
        ]
    finally:
        connection.close()


def test_a_sound_bag_in_sqlite_is_recovered_whole(whole: Path, tmp_path: Path) -> None:
    report = recover_recording(whole, tmp_path / "out.mcap")
    assert (report.complete, report.lost, report.missing) == (True, (), {})
    assert report.recovered == {"/turtle1/cmd_vel": 1, POSE: ROWS}
    found, expected = read_columns(tmp_path / "out.mcap"), read_columns(whole)
    for topic, columns in expected.items():
        assert found[topic].log_time_ns.tolist() == columns.log_time_ns.tolist()
        for name, values in columns.fields.items():
            assert found[topic].fields[name].tobytes() == values.tobytes()
    with AnyReader([tmp_path / "out.mcap"]) as reader:
        assert sum(1 for _ in reader.messages()) == ROWS + 1


@pytest.mark.parametrize("is_folder", [False, True])
@pytest.mark.parametrize("is_mcap", [False, True])
def test_partial_reads_what_is_left_of_a_bag(
    whole: Path, tmp_path: Path, *, is_mcap: bool, is_folder: bool
) -> None:
    folder = tmp_path / "bag"
    folder.mkdir()
    file = folder / f"bag.{'mcap' if is_mcap else 'db3'}"
    write_mcap(file, make_poses(200)) if is_mcap else shutil.copyfile(whole, file)
    bag = folder if is_folder else file
    expected, content = read_run(bag), file.read_bytes()
    file.write_bytes(content[: len(content) - 100 if is_mcap else len(content) // 2])
    with pytest.raises(LogError):
        read_run(bag)
    with pytest.warns(PartialRecordingWarning, match="from a damaged or unfinished file"):
        run = read_run(bag, allow_partial=True)
    count = len(run.poses)
    assert run.name == expected.name
    assert run.poses.xy_m.tolist() == expected.poses.xy_m[:count].tolist()
    assert (count == len(expected.poses)) == is_mcap
    file.write_bytes(content[:20])
    with pytest.raises(LogError, match="bag"):
        read_run(bag, allow_partial=True)


def test_an_intact_bag_keeps_its_own_error(whole: Path) -> None:
    with pytest.raises(LogError, match="pose_topic: expected a topic with messages, found /none"):
        read_run(whole, pose_topic="/none", allow_partial=True)


@pytest.mark.parametrize("part", [0.35, 0.6, 0.999])
def test_of_a_cut_file_the_first_messages_come(part: float, whole: Path, tmp_path: Path) -> None:
    content = whole.read_bytes()
    cut = tmp_path / "a.db3"
    cut.write_bytes(content[: int(part * len(content))])
    report = recover_recording(cut, tmp_path / "out.mcap")
    times = read_columns(tmp_path / "out.mcap")[POSE].log_time_ns
    expected = read_columns(whole)[POSE].log_time_ns
    assert 0.2 * part * ROWS < len(times) < ROWS
    assert not report.complete
    assert report.missing is None
    assert set(times.tolist()) < set(expected.tolist())
    assert report.lost[-1].reason.endswith("found its end: cut short")
    assert "recovered" in read_info(tmp_path / "out.mcap").notes
    assert len(read_run(tmp_path / "out.mcap").poses) == len(times)


def test_messages_behind_a_damaged_page_come(whole: Path, tmp_path: Path) -> None:
    content, damaged = bytearray(whole.read_bytes()), tmp_path / "a.db3"
    leaves = find_leaves(whole)
    page = leaves[len(leaves) // 2]
    content[(page - 1) * PAGE : (page - 1) * PAGE + 100] = b"\xff" * 100
    damaged.write_bytes(content)
    with pytest.raises(LogError, match=r"a\.db3: expected a sound SQLite file"):
        read_columns(damaged)
    report = recover_recording(damaged, tmp_path / "out.mcap")
    [loss] = report.lost
    assert loss.reason.startswith("messages from row ")
    lost = ROWS + 1 - sum(report.recovered.values())
    first, last = (
        int(word.rstrip(":")) for word in loss.reason.split() if word.rstrip(":").isdigit()
    )
    assert last - first + 1 == lost
    assert 20 < lost < 150


def test_rows_that_are_no_messages_are_named_and_left_out(whole: Path, tmp_path: Path) -> None:
    file = shutil.copy(whole, tmp_path / "a.db3")
    connection = sqlite3.connect(file)
    connection.execute("UPDATE messages SET timestamp = -5 WHERE id = 7")
    connection.execute("UPDATE messages SET data = 'text' WHERE id = 9")
    connection.execute("UPDATE messages SET topic_id = 12 WHERE id = 11")
    connection.commit()
    connection.close()
    report = recover_recording(file, tmp_path / "out.mcap")
    assert report.recovered[POSE] == ROWS - 3
    assert [loss.reason for loss in report.lost] == [
        "messages: row 7: timestamp: expected nanoseconds from 0 on, found -5",
        "messages: row 9: data: expected a blob, found text",
        "messages: row 11: the table topics has no topic_id 12",
    ]


def test_a_bag_is_recovered_file_by_file(whole: Path, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    content = whole.read_bytes()
    shutil.copy(whole, bag / "a_0.db3")
    (bag / "a_1.db3").write_bytes(content[: len(content) // 2])
    (bag / "a_2.db3").write_bytes(b"")
    write_metadata(bag, ["a_0.db3", "a_1.db3", "a_2.db3"], storage="sqlite3")
    report = recover_recording(bag, tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "metadata.yaml",
        "out_0.mcap",
        "out_1.mcap",
    ]
    described = parse_bag_metadata((tmp_path / "out" / "metadata.yaml").read_text())
    assert described.files == ("out_0.mcap", "out_1.mcap")
    counts = {topic.topic: topic.count for topic in read_bag_info(tmp_path / "out").topics}
    assert counts == report.recovered
    assert report.recovered[POSE] > ROWS
    assert not report.complete
    assert "a_2.db3: expected a bag in SQLite, found an empty file" in report.lost[-1].reason
    with AnyReader([tmp_path / "out"]) as reader:
        assert reader.message_count == sum(counts.values())


def test_a_bag_that_was_never_closed_is_recovered_with_its_messages_compressed(
    tmp_path: Path,
) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    file = write_sqlite(bag / "a_0.db3", make_poses(20))
    connection = sqlite3.connect(file)
    connection.create_function("packed", 1, zstandard.compress)
    connection.execute("UPDATE messages SET data = packed(data)")
    connection.commit()
    connection.close()
    write_metadata(bag, ["a_0.db3"], storage="sqlite3", mode="MESSAGE")
    assert recover_recording(bag, tmp_path / "out").complete
    assert len(read_run(tmp_path / "out").poses) == 20
    text = (tmp_path / "out" / "metadata.yaml").read_text()
    assert parse_bag_metadata(text).compression == "message"


@pytest.mark.parametrize("suffix", [".db3", ".mcap"])
def test_of_a_compressed_file_that_is_cut_what_unpacks_is_recovered(
    suffix: str, tmp_path: Path
) -> None:
    write = write_sqlite if suffix == ".db3" else write_mcap
    content = write(tmp_path / f"a{suffix}", make_poses(2000)).read_bytes()
    compressor, packed = zstandard.ZstdCompressor().compressobj(), b""
    for start in range(0, len(content), PAGE // 4):
        packed += compressor.compress(content[start : start + PAGE // 4])
        packed += compressor.flush(zstandard.COMPRESSOBJ_FLUSH_BLOCK)
    file = tmp_path / f"a{suffix}.zstd"
    file.write_bytes(packed[: len(packed) // 2])
    report = recover_recording(file, tmp_path / "out.mcap")
    assert 400 < report.recovered[POSE] <= 2000
    assert any("found the end of the file within it" in loss.reason for loss in report.lost)


def test_a_bag_of_several_files_does_not_become_one(whole: Path, tmp_path: Path) -> None:
    for name in ("a.db3", "b.db3"):
        shutil.copy(whole, tmp_path / name)
    with pytest.raises(LogError, match=r"found a\.db3, b\.db3: name a new folder instead"):
        recover_recording(tmp_path, tmp_path / "out.mcap")


def test_a_bag_without_anything_to_recover_is_one_line(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    with pytest.raises(LogError, match=r"bag: no recordings in this folder"):
        recover_recording(bag, tmp_path / "out")
    (bag / "a.db3").touch()
    with pytest.raises(LogError, match=r"a\.db3: expected a bag in SQLite, found an empty file"):
        recover_recording(bag, tmp_path / "out")
    assert not (tmp_path / "out").exists()
