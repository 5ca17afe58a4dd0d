import json
import re
import zlib
from io import BytesIO
from pathlib import Path
from random import Random

import pytest
from mcap.reader import make_reader
from mcap.records import ChunkIndex
from mcap.writer import Writer

from tests.log.runs import find_shared, simulate_short_run
from turtlelog.errors import LogError
from turtlelog.log import import_log, read_info, read_recording, recover_recording, write_recording

HEAD = {
    "format_version": "1",
    "source": "test",
    "name": "test",
    "absent": "[]",
    "nan_columns": "[]",
    "notes": "{}",
}


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("recordings") / "run.mcap"
    write_recording(simulate_short_run(), path)
    return path.read_bytes()


def sum_up(entries: dict[str, str]) -> str:
    text = json.dumps(dict(sorted(entries.items())), separators=(",", ":"), ensure_ascii=False)
    return f"{zlib.crc32(text.encode()):08x}"


def write_mcap(path: Path, entries: dict[str, str], message: bytes | None = None) -> Path:
    """Write an MCAP with a metadata record of these entries, and one message on the pose topic."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        if entries:
            writer.add_metadata("turtlelog", {**entries, "checksum": sum_up(entries)})
        if message is not None:
            schema = writer.register_schema("turtlesim/msg/Pose", "ros2msg", b"int32 x\n")
            channel = writer.register_channel("/turtle1/pose", "cdr", schema)
            writer.add_message(channel, 0, message, 0)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


NO_ADVICE = "no message can be recovered: copy the file again from its source"
BUGS = ("TypeError", "AttributeError", "NameError", "AssertionError", "UnboundLocalError")


def advise(path: Path) -> str:
    return f": turtlelog convert --recover {path} -o OUT rewrites what can be read"


def read_damaged(path: Path, data: bytes) -> str:
    path.write_bytes(data)
    with pytest.raises(LogError, match=r"\A[^\n]+\Z") as caught:
        read_recording(path)
    assert not any(bug in str(caught.value) for bug in BUGS)
    return str(caught.value)


def can_recover(path: Path) -> bool:
    try:
        recover_recording(path, path.with_name("whole.mcap"))
    except LogError:
        return False
    return True


@pytest.mark.parametrize("length", [0, 1, 7, 8, 9, 40, 44, 45, 46, 500, -1, -8, -9, -37, -38])
def test_a_file_cut_short_is_one_line(length: int, sound: bytes, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    found = "byte |truncated or unfinished .no end of an MCAP file at byte "
    line = read_damaged(path, sound[:length])
    assert re.match(rf"{re.escape(str(path))}: ({found})\d+\b", line)


def test_a_file_cut_short_anywhere_is_one_line(sound: bytes, tmp_path: Path) -> None:
    for length in Random(0).sample(range(len(sound)), 150):
        message = read_damaged(tmp_path / "run.mcap", sound[:length])
        assert "\n" not in message
        if length >= 8:
            path = tmp_path / "run.mcap"
            assert message.endswith(advise(path) if can_recover(path) else f": {NO_ADVICE}")


def test_any_flipped_bit_is_found(sound: bytes, tmp_path: Path) -> None:
    for place in Random(0).sample(range(len(sound)), 300):
        data = bytearray(sound)
        data[place] ^= 1 << place % 8
        message = read_damaged(tmp_path / "run.mcap", bytes(data))
        assert message.startswith(f"{tmp_path / 'run.mcap'}: byte ")
        assert place < 8 or message.endswith(advise(tmp_path / "run.mcap"))


def test_a_flipped_bit_never_makes_info_fail_otherwise(sound: bytes, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    messages = []
    for place in Random(1).sample(range(len(sound)), 200):
        data = bytearray(sound)
        data[place] ^= 1 << place % 8
        path.write_bytes(data)
        try:
            read_info(path)
        except LogError as err:
            messages.append(str(err))
    assert messages
    assert all(message.startswith(f"{path}: ") for message in messages)
    assert not any("\n" in message for message in messages)


def find_chunk(data: bytes) -> ChunkIndex:
    summary = make_reader(BytesIO(data)).get_summary()
    assert summary is not None
    return summary.chunk_indexes[0]


def test_the_damaged_chunk_is_named(sound: bytes, tmp_path: Path) -> None:
    chunk, data = find_chunk(sound), bytearray(sound)
    data[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 1
    message = read_damaged(tmp_path / "run.mcap", bytes(data))
    assert f"byte {chunk.chunk_start_offset}: chunk: expected" in message


def test_an_index_that_leaves_a_message_out_is_found(sound: bytes, tmp_path: Path) -> None:
    """Another offset may hit another sound message: the checksum of the chunk does not tell."""
    chunk = find_chunk(sound)
    # Of the channels that have more than a few messages.
    index = next(
        place for place in chunk.message_index_offsets.values() if sound[place + 1] > 6 + 16 * 3
    )
    for entry in range(2):
        data = bytearray(sound)
        offset = index + 15 + 16 * entry + 8
        data[offset : offset + 8] = data[offset + 16 : offset + 24]
        message = read_damaged(tmp_path / "run.mcap", bytes(data))
        assert f"byte {chunk.chunk_start_offset}: chunk: expected what its message index" in message


@pytest.mark.parametrize("data", [b"", b"\0\1" * 2000, b"time,x\n0,1\n" * 300, b"{}"])
def test_other_files_are_no_recordings(data: bytes, tmp_path: Path) -> None:
    message = read_damaged(tmp_path / "run.mcap", data)
    assert "byte 0: not an MCAP file: " in message


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    for read in (read_recording, read_info, import_log):
        with pytest.raises(LogError, match=r"^\S+none\.mcap: no such file"):
            read(tmp_path / "none.mcap")


def test_a_folder_is_one_line(tmp_path: Path) -> None:
    for read in (read_recording, read_info, import_log):
        with pytest.raises(LogError, match="expected"):
            read(tmp_path)


@pytest.mark.parametrize("version", [3, 7])
def test_a_newer_format_is_refused_by_name(version: int, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "new.mcap", {"format_version": f"{version}"}, b"unknown")
    for read in (read_recording, read_info):
        with pytest.raises(LogError, match=f"version {version}: this turtlelog reads up to 2"):
            read(path)


@pytest.mark.parametrize("version", ["0", "-1", "one", "1.5", "", "null"])
def test_a_format_that_never_was_is_refused(version: str, tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "odd.mcap", {"format_version": version})
    with pytest.raises(LogError, match=r"format.version"):
        read_recording(path)


def test_an_mcap_without_our_record_is_no_recording(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "other.mcap", {})
    with pytest.raises(LogError, match="it has no metadata record turtlelog"):
        read_recording(path)


def test_a_recording_without_poses_is_refused(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "empty.mcap", HEAD)
    with pytest.raises(LogError, match="topic /turtle1/pose: no messages"):
        read_recording(path)


def test_a_topic_of_ours_with_other_fields_is_named(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "odd.mcap", HEAD, b"\0\1\0\0" + b"\0" * 4)
    with pytest.raises(LogError, match=r"/turtle1/pose: expected turtlesim/msg/Pose as ROS 2"):
        read_recording(path)


def test_a_changed_entry_is_told_by_its_checksum(tmp_path: Path, sound: bytes) -> None:
    path = tmp_path / "changed.mcap"
    path.write_bytes(sound.replace(b"simulation", b"simulatiom", 1))
    with pytest.raises(LogError, match=r"metadata turtlelog: expected checksum [0-9a-f]{8}"):
        read_info(path)


def test_a_missing_or_wrong_entry_is_named(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "odd.mcap", {"format_version": "1", "source": "test"})
    with pytest.raises(LogError, match="the entry name is missing"):
        read_recording(path)
    path = write_mcap(tmp_path / "odd.mcap", HEAD | {"notes": "[1]"})
    with pytest.raises(LogError, match=r"notes: Expected `object`, got `array`, found '\[1\]'"):
        read_recording(path)


@pytest.mark.parametrize(
    "name",
    [
        "eprosima_ros2_talker.mcap",
        "lichtblick_example_logs.mcap",
        "rosbag2_talker.mcap",
        "rosbag2_wbag_0.mcap",
        "service_events.mcap",
        "turtlesim_jazzy/subset_0.mcap",
    ],
)
def test_other_peoples_recordings_are_no_runs(name: str) -> None:
    with pytest.raises(LogError, match="not a recording of turtlelog"):
        read_recording(find_shared("ros2", *name.split("/")))
