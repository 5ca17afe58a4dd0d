"""What a file may ask for: by the bytes that it takes, packed, and counted before it is read."""

from pathlib import Path

import pytest
import zstandard

from tests.log.ros2.bags import make_poses, write_mcap, write_sqlite
from tests.torture.bombs import channel, chunk, cut, describe, message, pose_messages, schema, whole
from turtlelog.errors import LogError
from turtlelog.log import read_columns, read_info, read_run, recover_recording
from turtlelog.log.engine import limits
from turtlelog.log.engine.limits import Allowance, measure_stored

POSE_ROW = 44
"""Bytes of a pose of turtlesim: 24 of the message, two times and a number."""


@pytest.mark.parametrize("write", [write_mcap, write_sqlite])
@pytest.mark.parametrize("spare", [0, -1])
def test_columns_of_a_run_are_counted_before_they_are_read(
    write: object, spare: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "_COLUMNS", 100 * POSE_ROW + spare)
    file = tmp_path / ("a.mcap" if write is write_mcap else "a.db3")
    write(file, make_poses(100))  # type: ignore[operator]
    if spare == 0:
        assert len(read_run(file).poses) == 100
        return
    with pytest.raises(LogError, match=r"more than 4,399 bytes as columns, the most for"):
        read_run(file)
    assert len(read_columns(file)["/turtle1/pose"]) == 100


def test_a_file_without_compression_is_read_as_the_error_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "_COLUMNS", 1000 * POSE_ROW)
    monkeypatch.setattr(limits, "SMALL_FILE", 40_000)
    file, rows = tmp_path / "a.mcap", pose_messages(1, 2000)
    file.write_bytes(whole(chunk([describe("/turtle1/pose"), rows])))
    advice = r"Cut the file into parts, or store it without compression \(mcap decompress FILE\)$"
    with pytest.raises(LogError, match=advice):
        read_run(file)
    file.write_bytes(whole(describe("/turtle1/pose") + rows))
    assert len(read_columns(file)["/turtle1/pose"]) == 2000
    assert len(read_run(file).poses) == 1


@pytest.mark.parametrize(("size", "most"), [(0, 40), (10_000_000, 40), (11_000_000, 56)])
def test_columns_may_grow_with_files_that_are_not_small(size: int, most: int) -> None:
    assert Allowance(size).count_left(limits.COLUMNS) == most * 1_000_000


def test_texts_and_sequences_count_as_objects(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "_COLUMNS", 100 * POSE_ROW)
    definition = "float64 x\nfloat64 y\nfloat64 yaw\nstring s\nuint8[] b\n"
    rows = message(1, b"\0\1\0\0" + bytes(24) + b"\1\0\0\0" + bytes(8)) * 100
    file = tmp_path / "a.mcap"
    file.write_bytes(whole(chunk([describe("/pose", kind="a/Pose", definition=definition), rows])))
    with pytest.raises(LogError, match="bytes as columns"):
        read_run(file, pose_topic="/pose")


@pytest.mark.parametrize("poses", [130, 145])
def test_messages_within_messages_count_by_their_bytes(
    poses: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "_COLUMNS", 20_000)
    plan = b"\0\1\0\0" + bytes(8) + b"\1\0\0\0" + bytes(4) + poses.to_bytes(4, "little")
    front = schema(2, "nav_msgs/msg/Path", "") + channel(2, "/plan", 2)
    file = tmp_path / "a.mcap"
    rows = pose_messages(1, 1) + message(2, plan + bytes(poses * 72 - 4))
    file.write_bytes(whole(chunk([describe("/turtle1/pose"), front, rows])))
    if poses == 130:
        assert len(read_run(file).poses) == 1
    else:
        with pytest.raises(LogError, match="more than 20,000 bytes as columns"):
            read_run(file)


def list_schemas(count: int) -> bytes:
    return b"".join(schema(number, f"a/{number:0100000}", "") for number in range(2, count))


def list_channels(count: int) -> bytes:
    long = "c" * 100_000
    return b"".join(channel(number, f"/{number}{long}") for number in range(2, count))


@pytest.mark.parametrize("kind", [limits.SCHEMA_BYTES, limits.CHANNEL_BYTES])
def test_long_names_count(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "_BASES", {**limits._BASES, kind: (10**6, 0)})
    more = list_schemas(20) if kind == limits.SCHEMA_BYTES else list_channels(20)
    file = tmp_path / "a.mcap"
    file.write_bytes(cut(chunk([describe("/turtle1/pose"), pose_messages(1, 9)]) + chunk([more])))
    assert f"expected up to 1000000 {kind}" in read_info(file).notes["partial"]
    report = recover_recording(file, tmp_path / "out.mcap")
    assert report.recovered == {"/turtle1/pose": 9}
    assert f"expected up to 1000000 {kind}" in report.lost[0].reason


def test_a_file_that_was_packed_may_ask_for_what_its_packed_bytes_allow(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "_BASES", {**limits._BASES, limits.RECORDS: (0, 1)})
    content = whole(describe("/turtle1/pose") + pose_messages(1, 2000))
    (tmp_path / "a.mcap").write_bytes(content)
    packed = tmp_path / "a.mcap.zstd"
    packed.write_bytes(zstandard.compress(content))
    assert read_info(tmp_path / "a.mcap").topics[0].count == 2000
    with pytest.raises(LogError, match=r"expected up to 18\d records more, found"):
        read_info(packed)
    report = recover_recording(packed, tmp_path / "out.mcap")
    assert 0 < report.recovered["/turtle1/pose"] < packed.stat().st_size


SKIPPED = bytes.fromhex("502a4d1800000000")


@pytest.mark.parametrize("frame", [zstandard.compress(b""), SKIPPED], ids=["empty", "skipped"])
def test_a_packed_file_has_a_bounded_number_of_frames(
    frame: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limits, "_BASES", {**limits._BASES, limits.FRAMES: (50, 0)})
    content = whole(describe("/turtle1/pose") + pose_messages(1, 20))
    packed = tmp_path / "a.mcap.zstd"
    packed.write_bytes(zstandard.compress(content) + frame * 50)
    assert read_info(packed).topics[0].count == 20
    packed.write_bytes(zstandard.compress(content) + frame * 51)
    with pytest.raises(LogError, match="expected up to 50 frames of a file that is compressed as"):
        read_info(packed)


def test_a_stream_is_measured_where_it_stands(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(bytes(10))
    with (tmp_path / "a").open("rb") as stream:
        stream.seek(3)
        assert (measure_stored(stream), stream.tell()) == (10, 3)
