import re
import sqlite3
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import zstandard

from tests.log.ros2.bags import (
    START_NS,
    TICK_NS,
    make_command,
    make_poses,
    write_mcap,
    write_metadata,
    write_sqlite,
)
from tests.log.runs import find_shared
from turtlelog.errors import LogError
from turtlelog.log import read_columns, read_info, read_run, recover_recording
from turtlelog.log.any_file import read_file_info
from turtlelog.log.engine import limits
from turtlelog.log.read_choice import ReadChoice
from turtlelog.log.ros2 import list_bag_files, read_bag, read_bag_info
from turtlelog.log.ros2.bag_files import parse_bag_metadata
from turtlelog.log.ros2.bag_rows import open_bag

METADATA = "metadata.yaml"


def write_split(folder: Path, *names: str) -> Path:
    """Write three poses into each file, one after the other, as SQLite or MCAP."""
    poses = make_poses(3 * len(names))
    for number, name in enumerate(names):
        write = write_sqlite if name.endswith(".db3") else write_mcap
        write(folder / name, poses[3 * number : 3 * number + 3])
    return folder


def note(folder: Path) -> str | None:
    run = read_bag(folder)
    assert run.poses.time_ns.tolist() == [row * TICK_NS for row in range(len(run.poses))]
    assert run.notes["sorted_rows"] == "0"
    assert read_bag_info(folder).notes.get("bag_files") == run.notes.get("bag_files")
    return run.notes.get("bag_files")


@pytest.mark.parametrize("suffix", [".db3", ".mcap"])
def test_a_bag_without_metadata_is_read_in_the_order_of_numbers(
    suffix: str, tmp_path: Path
) -> None:
    names = [f"bag_{number}{suffix}" for number in (2, 9, 10)]
    write_split(tmp_path, *names)
    assert note(tmp_path) == f"metadata.yaml is missing; in order of name: {', '.join(names)}"
    assert read_bag_info(tmp_path).duration_s == pytest.approx(8 * 0.016)


@pytest.mark.skipif(sys.platform == "win32", reason="links need a right there")
def test_of_links_to_one_file_of_a_folder_the_first_is_read(tmp_path: Path) -> None:
    write_split(tmp_path, "a_0.mcap", "a_1.mcap")
    for name in ("a_2.mcap", "a_10.mcap"):
        (tmp_path / name).symlink_to("a_0.mcap")
    assert [file.name for file in list_bag_files(tmp_path)] == ["a_0.mcap", "a_1.mcap"]


def test_a_bag_of_several_files_in_sqlite_is_read_in_its_own_order(tmp_path: Path) -> None:
    write_metadata(write_split(tmp_path, "b.db3", "a.db3"), ["b.db3", "a.db3"], storage="sqlite3")
    assert note(tmp_path) is None


@pytest.mark.parametrize("text", ["", "rosbag2_bagfile_information:\n  ? x\n", "\x00", "{"])
def test_a_bag_whose_metadata_is_broken_is_read_and_says_so(text: str, tmp_path: Path) -> None:
    write_split(tmp_path, "a.db3")
    (tmp_path / METADATA).write_text(text)
    found = note(tmp_path)
    assert found is not None
    assert re.search(
        r"metadata\.yaml: .*(expected .*|is missing|only zero bytes.*); in order of name: a\.db3$",
        found,
    )


def test_a_file_that_was_renamed_is_read_and_named(tmp_path: Path) -> None:
    write_split(tmp_path, "z.db3", "b.db3", "c.db3")
    write_metadata(tmp_path, ["a.db3", "b.db3", "c.db3"], storage="sqlite3")
    assert note(tmp_path) == "metadata.yaml names a.db3, not in the folder; read instead: z.db3"


def test_a_robots_bag_with_a_renamed_file_says_so() -> None:
    [info] = open_bag(find_shared("robots", "amcl_pose")).infos.values()
    expected = (
        "names rosbag2_2024_12_16-11_24_20_0.db3, not in the folder; read instead: rosbag.db3"
    )
    assert info.notes["bag_files"] == f"metadata.yaml {expected}"


def test_files_that_were_all_renamed_are_read_in_order(tmp_path: Path) -> None:
    write_split(tmp_path, "new_9.db3", "new_10.db3")
    write_metadata(tmp_path, ["old_0.db3", "old_1.db3"], storage="sqlite3")
    expected = "names old_0.db3, old_1.db3, not in the folder; read instead: new_9.db3, new_10.db3"
    assert note(tmp_path) == f"metadata.yaml {expected}"


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (["a.db3", "b.db3", "c.db3"], "none; --partial reads the others"),
        (["c.db3"], "a.db3, b.db3"),
    ],
)
def test_a_file_that_may_be_any_is_missing(names: list[str], found: str, tmp_path: Path) -> None:
    write_metadata(write_split(tmp_path, "a.db3", "b.db3"), names, storage="sqlite3")
    with pytest.raises(LogError, match=f"expected the file c.db3, found {found}$"):
        read_bag(tmp_path)


@pytest.mark.parametrize("name", ["/home/robot/bag/a.db3", "../elsewhere/a.db3", "C:\\bag\\a.db3"])
def test_what_is_read_lies_in_the_folder(name: str, tmp_path: Path) -> None:
    for made in ("elsewhere", "bag"):
        (tmp_path / made).mkdir()
    write_split(tmp_path / "elsewhere", "a.db3")
    folder = write_metadata(tmp_path / "bag", [f"'{name}'"])
    with pytest.raises(LogError, match=r"metadata\.yaml: relative_file_paths: expected the file"):
        list_bag_files(folder)
    write_split(folder, "a.db3")
    assert list_bag_files(folder) == (folder / "a.db3",)
    assert note(folder) == f"metadata.yaml names {name}, not in the folder; read instead: a.db3"


def test_a_bag_of_two_storages_is_refused(tmp_path: Path) -> None:
    write_split(tmp_path, "a_0.db3", "a_1.mcap")
    line = r"expected files of one storage, found MCAP beside SQLite: a_0\.db3, a_1\.mcap$"
    with pytest.raises(LogError, match=line):
        read_bag(tmp_path)


@pytest.mark.parametrize(
    ("text", "files"),
    [
        ("[a.db3]", ("a.db3",)),
        ("[ 'a, b.db3' , \"c.db3\",d 1.db3 ] # two", ("a, b.db3", "c.db3", "d 1.db3")),
        ("[a.db3,]", ("a.db3",)),
    ],
)
def test_names_may_stand_within_brackets(text: str, files: tuple[str, ...]) -> None:
    lines = ["rosbag2_bagfile_information:", "  storage_identifier: sqlite3"]
    lines += [f"  relative_file_paths: {text}", "  duration: {nanoseconds: 5}"]
    found = parse_bag_metadata("\n".join(lines))
    assert (found.files, found.duration_ns) == (files, 5)


@pytest.mark.parametrize(
    "names", [("a.db3", "b.db3"), ("a_0.db3", "b_1.db3"), ("a1.db3", "a2.db3")]
)
def test_files_that_no_name_makes_one_bag_are_not_joined(
    names: tuple[str, str], tmp_path: Path
) -> None:
    write_split(tmp_path, *names)
    with pytest.raises(LogError, match="a folder of 2 recordings, not one bag") as caught:
        read_bag(tmp_path)
    assert str(caught.value).endswith(f": name one of them: {', '.join(names)}")


@pytest.mark.parametrize(("begin", "is_one"), [(6, True), (5, True), (4, False), (0, False)])
def test_parts_follow_each_other_in_time(begin: int, is_one: bool, tmp_path: Path) -> None:  # noqa: FBT001
    poses = make_poses(30)
    write_sqlite(tmp_path / "a_0.db3", poses[:11])
    write_mcap(tmp_path / "a_1.db3", poses[begin : begin + 11])
    if is_one:
        assert len(list_bag_files(tmp_path)) == 2
    else:
        with pytest.raises(LogError, match="a folder of 2 recordings, not one bag"):
            list_bag_files(tmp_path)


@pytest.mark.parametrize(
    ("gap_s", "every_s", "reason"),
    [
        (9.9, 0.016, None),
        (10.1, 0.016, "a_1.mcap begins 10 s after a_0.mcap ends"),
        (2 * 86_400.0, 0.016, "a_1.mcap begins 2 days after a_0.mcap ends"),
        (280.0, 3.0, None),  # slow topics alone
        (300.0, 3.0, "a_1.mcap begins 5 minutes after a_0.mcap ends"),
    ],
)
def test_parts_follow_each_other_closely(
    gap_s: float, every_s: float, reason: str | None, tmp_path: Path
) -> None:
    count = 30
    for number in range(2):
        start_s = number * ((count - 1) * every_s + gap_s)
        times_ns = [START_NS + round((start_s + row * every_s) * 1e9) for row in range(count)]
        said = [
            replace(pose, time_ns=at) for pose, at in zip(make_poses(count), times_ns, strict=True)
        ]
        write_mcap(tmp_path / f"a_{number}.mcap", said)
    if reason is None:
        assert len(read_bag(tmp_path).poses) == 2 * count
    else:
        with pytest.raises(LogError, match=f"not one bag .*; {reason}") as caught:
            read_bag(tmp_path)
        assert str(caught.value).endswith("): name one of them: a_0.mcap, a_1.mcap")


def test_a_folder_of_many_recordings_is_told_in_one_short_line(tmp_path: Path) -> None:
    write_split(tmp_path, *(f"{name}.db3" for name in "abcdefgh"))
    with pytest.raises(LogError) as caught:
        read_bag(tmp_path)
    assert str(caught.value).endswith(": a.db3, b.db3, c.db3, d.db3, e.db3, f.db3 and 2 more")


def test_a_topic_of_two_types_in_two_files_is_one_line(tmp_path: Path) -> None:
    write_sqlite(tmp_path / "a_0.db3", make_poses(3))
    write_sqlite(tmp_path / "a_1.db3", [make_command(topic="/turtle1/pose")])
    with pytest.raises(LogError, match="topic /turtle1/pose: expected messages of one type"):
        read_bag(tmp_path)


@pytest.mark.parametrize("suffix", [".db3", ".mcap"])
def test_a_lone_compressed_file_is_read(suffix: str, tmp_path: Path) -> None:
    plain = write_split(tmp_path, f"a{suffix}") / f"a{suffix}"
    packed = tmp_path / "packed" / f"a{suffix}.zstd"
    packed.parent.mkdir()
    data = plain.read_bytes()
    # Two frames, as parallel compressors write, the second without its size.
    first = zstandard.compress(data[:100])
    second = zstandard.ZstdCompressor(write_content_size=False).compress(data[100:])
    packed.write_bytes(first + second)
    run = read_run(packed)
    assert (len(run.poses), run.name, run.source) == (3, "a", f"rosbag2: a{suffix}.zstd")
    assert read_info(packed).topics == read_info(plain).topics
    assert note(packed.parent) is not None
    assert [*packed.parent.iterdir()] == [packed]
    packed.write_bytes((first + second)[:-3])
    with pytest.raises(LogError, match=r"zstd: expected sound zstd data, found the end of the"):
        read_info(packed)
    packed.write_bytes(first + b"\x28\xb5\x2f\xfd" + bytes(50))
    with pytest.raises(LogError, match=r"zstd: expected sound zstd data, found"):
        read_info(packed)


def test_a_file_that_unpacks_to_far_more_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = {**limits._BASES, limits.UNPACKED_FILE: (2**20, 64)}
    monkeypatch.setattr(limits, "_BASES", small)
    file = tmp_path / "a.db3.zstd"
    file.write_bytes(zstandard.compress(bytes(2**24)))
    most = 2**20 + 64 * file.stat().st_size
    line = f"expected up to {most} bytes in a compressed file of {file.stat().st_size}, found more"
    with pytest.raises(LogError, match=rf"a\.db3\.zstd: {line}$"):
        read_info(file)


@pytest.mark.parametrize(
    ("data", "line"),
    [
        (zstandard.compress(bytes(2**27)), "found"),
        (b"\x28\xb5\x2f\xfd" + bytes(30), "expected sound zstd data, found"),
        (zstandard.compress(b"\x00\x01\x00\x00" + bytes(8)), "expected 24 bytes, found 12"),
    ],
    ids=["bomb", "damaged", "short"],
)
def test_messages_that_unpack_to_something_else_are_one_line(
    data: bytes, line: str, tmp_path: Path
) -> None:
    file = write_sqlite(tmp_path / "a.db3", make_poses(2))
    connection = sqlite3.connect(file)
    connection.execute("UPDATE messages SET data = ?", (data,))
    connection.commit()
    connection.close()
    with pytest.raises(LogError, match=rf"a\.db3: rows from 1: topic /turtle1/pose: .*{line}"):
        read_columns(file)


def test_a_folder_with_a_bag_of_ros_1_names_that_file(tmp_path: Path) -> None:
    (tmp_path / "a b.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(50))
    with pytest.raises(LogError, match=r"a folder with the ROS 1 bag a b\.bag: name that file"):
        read_run(tmp_path)


def test_a_file_under_two_names_is_no_bag(tmp_path: Path) -> None:
    write_mcap(tmp_path / "a_0.mcap", make_poses(3))
    (tmp_path / "a_1.mcap").hardlink_to(tmp_path / "a_0.mcap")
    line = r"expected each file once, found a_0\.mcap and a_1\.mcap are one"
    with pytest.raises(LogError, match=line):
        read_bag_info(tmp_path)


def test_the_parts_of_a_bag_that_are_there_are_read_on_request(tmp_path: Path) -> None:
    write_metadata(
        write_split(tmp_path, "a.db3", "b.db3"), ["a.db3", "b.db3", "c.db3"], storage="sqlite3"
    )
    with pytest.warns(UserWarning, match="c.db3 is missing"):
        run = read_run(tmp_path, allow_partial=True)
    assert len(run.poses) > 1
    assert run.origin.lost == "rows"
    assert (
        recover_recording(tmp_path, tmp_path.parent / "copy").lost[0].reason == "c.db3 is missing"
    )
    info = read_file_info(tmp_path, ReadChoice(allow_partial=True))
    assert (info.file, info.complete) == (str(tmp_path), False)
    assert info.notes["recovered"] == "c.db3 is missing"
    assert sum(topic.count for topic in info.topics) >= len(run.poses)
