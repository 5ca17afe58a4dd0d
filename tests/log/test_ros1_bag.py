"""Bags of ROS 1, and MCAP files with their messages."""

import bz2
import struct
from pathlib import Path

import pytest
from mcap.writer import Writer

import turtlelog as tl
from tests.cli.conftest import Call, call as call
from tests.log.ros1_bags import COMPRESSIONS, KINDS, STORE, say_drive, write_ros1, write_ros1_mcap
from turtlelog.errors import LogError
from turtlelog.log import read_columns, read_file_info, read_run, read_trajectory
from turtlelog.log.ros1 import build_converter, name_as_ros2, read_ros1_type


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_ros1(tmp_path_factory.mktemp("ros1") / "drive.bag")


def pack(fields: dict[str, bytes], data: bytes = b"") -> bytes:
    """Return a record of a bag of ROS 1."""
    parts = [name.encode() + b"=" + value for name, value in fields.items()]
    header = b"".join(struct.pack("<I", len(part)) + part for part in parts)
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


START = b"#ROSBAG V2.0\n"
CONNECTION = pack(
    {"op": b"\x07", "conn": struct.pack("<I", 0), "topic": b"/cmd_vel"},
    pack({"type": b"std_msgs/Int8", "md5sum": b"*", "message_definition": b"int8 data"})[4:-4],
)


def say(data: bytes = b"\x05", *, conn: int = 0) -> bytes:
    fields = {"op": b"\x02", "conn": struct.pack("<I", conn), "time": struct.pack("<II", 7, 9)}
    return pack(fields, data)


def write_bag(path: Path, *records: bytes, index: int | None = None) -> Path:
    body = b"".join(records)
    head = {"op": b"\x03", "index_pos": struct.pack("<Q", 0), "conn_count": bytes(4)}
    size = len(START) + len(pack(head)) + len(body)
    head["index_pos"] = struct.pack("<Q", size if index is None else index)
    path.write_bytes(START + pack(head) + body)
    return path


def chunk(data: bytes, compression: str = "none", *, size: int | None = None) -> bytes:
    packed = bz2.compress(data) if compression == "bz2" else data
    claimed = struct.pack("<I", len(data) if size is None else size)
    return pack({"op": b"\x05", "compression": compression.encode(), "size": claimed}, packed)


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_every_compression_gives_the_same_run(compression: str, bag: Path, tmp_path: Path) -> None:
    run = read_run(write_ros1(tmp_path / "drive.bag", compression=compression))
    assert run.source == "rosbag1: drive.bag"
    assert (len(run.poses), len(run.commands)) == (60, 60)
    assert run.poses.xy_m[:, 0] == pytest.approx([0.01 * row for row in range(60)])
    assert run.poses.measured_speed_m_s is not None
    assert set(run.poses.measured_speed_m_s.tolist()) == {0.2}
    assert run.clock is not None
    assert run.clock.used == "stamp"
    assert run.clock.offset_s == pytest.approx(0.003)


def test_an_mcap_file_of_ros_1_gives_the_same_run(bag: Path, tmp_path: Path) -> None:
    run, other = read_run(bag), read_run(write_ros1_mcap(tmp_path / "drive.mcap"))
    assert run.poses.xy_m.tolist() == other.poses.xy_m.tolist()
    assert run.poses.time_ns.tolist() == other.poses.time_ns.tolist()
    assert run.commands.speed_m_s.tolist() == other.commands.speed_m_s.tolist()


def test_transforms_and_heights_are_read_as_of_ros_2(bag: Path) -> None:
    odometry, transforms = (read_trajectory(f"{bag}:{topic}") for topic in ("/odom", "/tf"))
    assert odometry.xyz_m[:, 2].tolist() == [0.25] * 60
    assert transforms.xyz_m[:, :2].tolist() == odometry.xyz_m[:, :2].tolist()
    assert odometry.time_ns[0] == 1_600_000_000 * 10**9


def test_info_names_the_topics_as_ros_2_does(bag: Path) -> None:
    info = read_file_info(bag)
    assert {topic.topic: topic.type for topic in info.topics} == KINDS
    assert {topic.count for topic in info.topics} == {60}
    assert not info.not_understood


def test_info_tells_messages_of_ros_1_whatever_the_file(
    call: Call, bag: Path, tmp_path: Path
) -> None:
    copied = write_ros1_mcap(tmp_path / "drive.mcap")
    for file in (bag, copied):
        assert read_file_info(file).source == "ros1"
        assert "ROS 1 bag of a robot" in call("info", file).out


def test_messages_become_the_cdr_that_rosbags_makes_of_them() -> None:
    for topic, _, data in say_drive(7):
        kind = KINDS[topic]
        text, _ = STORE.generate_msgdef(kind)
        fields = read_ros1_type(kind, text).fields
        body = build_converter(fields)(data)
        # Its own way from ROS 1 to CDR leaves the number of the header out.
        expected = bytes(STORE.serialize_cdr(STORE.deserialize_ros1(data, kind), kind))
        # Both may end with bytes that only fill up.
        assert expected.rstrip(b"\0") == body.rstrip(b"\0")


def test_texts_and_lists_come_back(bag: Path) -> None:
    columns = read_columns(bag, ["/joint_states", "/scan"])
    joints = columns["/joint_states"].fields
    assert joints["name"][4] == ["left", "aaaa"]
    assert joints["effort"][4].tolist() == [0.0, 1.0, 2.0]
    assert joints["header.seq"].tolist() == [*range(60)]
    assert columns["/scan"].fields["ranges"][7].tolist() == [0.0, 1.0, 2.0]


def test_a_bag_is_converted_and_compared_like_any_other(bag: Path, tmp_path: Path) -> None:
    run = read_run(bag)
    tl.write_recording(run, tmp_path / "new.mcap")
    assert read_run(tmp_path / "new.mcap").poses.xy_m.tolist() == run.poses.xy_m.tolist()


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("nav_msgs/Odometry", "nav_msgs/msg/Odometry"),
        ("nav_msgs/msg/Odometry", "nav_msgs/msg/Odometry"),
        ("tf/tfMessage", "tf2_msgs/msg/TFMessage"),
        ("Odd", "Odd"),
    ],
)
def test_types_are_called_as_in_ros_2(name: str, expected: str) -> None:
    assert name_as_ros2(name) == expected


def test_messages_outside_of_chunks_are_read(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "a.bag", CONNECTION, say(), say(b"\xfb"))
    columns = read_columns(path)["/cmd_vel"]
    assert columns.fields["data"].tolist() == [5, -5]
    assert columns.log_time_ns.tolist() == [7_000_000_009] * 2


@pytest.mark.parametrize(
    ("records", "expected"),
    [
        ([CONNECTION, say(b"")], "message 0: expected 1 bytes more at byte 0, found 0"),
        ([CONNECTION, say(b"12")], "message 0: expected 1 bytes, found 2"),
        ([say()], "connection 0: expected its record, found messages only"),
        ([CONNECTION, pack({"op": b"\x02"})], "expected a field conn of 4 bytes, found none"),
        ([CONNECTION[:-9]], "the bag is cut or was never finished"),
        ([pack({"a": b""})], "expected a field op of 1 bytes, found none"),
        ([struct.pack("<I", 2**31)], "expected a header of up to 1048576 bytes"),
        ([chunk(CONNECTION + say()[:-3])], "expected whole records in a chunk"),
        ([chunk(CONNECTION, "zip")], "expected the compression none, bz2 or lz4, found 'zip'"),
        ([pack({"op": b"\x05", "compression": b"bz2", "size": bytes(4)}, b"no")], "sound bz2 data"),
        ([pack({"op": b"\x05", "compression": b"lz4", "size": bytes(4)}, b"no")], "sound lz4 data"),
    ],
)
def test_a_bag_that_is_wrong_is_refused_in_one_line(
    records: list[bytes], expected: str, tmp_path: Path
) -> None:
    path = write_bag(tmp_path / "a.bag", *records)
    with pytest.raises(LogError) as caught:
        read_columns(path)
    assert expected in str(caught.value)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.9])
def test_a_bag_that_is_cut_is_refused_with_what_repairs_it(
    share: float, bag: Path, tmp_path: Path
) -> None:
    cut = tmp_path / "cut.bag"
    data = bag.read_bytes()
    cut.write_bytes(data[: max(len(START), int(share * len(data)))])
    with pytest.raises(LogError, match="cut or was never finished: rosbag reindex FILE"):
        read_run(cut)


@pytest.mark.parametrize(("share", "is_read"), [(0.02, False), (0.6, True)])
def test_the_messages_before_the_cut_of_a_bag_are_read_on_request(
    share: float, bag: Path, tmp_path: Path, *, is_read: bool
) -> None:
    cut = tmp_path / "cut.bag"
    data = bag.read_bytes()
    cut.write_bytes(data[: max(len(START), int(share * len(data)))])
    if not is_read:
        with pytest.raises(LogError, match="the bag is cut"):
            read_run(cut, allow_partial=True)
        return
    with pytest.warns(UserWarning, match="the number of lost messages is unknown .* is cut"):
        part = read_run(cut, allow_partial=True)
    whole = read_run(bag)
    assert 1 < len(part.poses) < len(whole.poses)
    assert (part.poses.xy_m == whole.poses.xy_m[: len(part.poses)]).all()
    assert part.origin.lost == "rows"


def test_a_bag_that_was_never_finished_is_told(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "a.bag.active", CONNECTION, say(), index=0)
    with pytest.raises(LogError, match="the bag is cut or was never finished"):
        read_columns(path)


def test_another_version_is_told(tmp_path: Path) -> None:
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V1.2\n" + bytes(50))
    with pytest.raises(LogError, match=r"expected a bag of ROS 1 in version 2\.0"):
        read_run(tmp_path / "a.bag")


@pytest.mark.parametrize(
    ("chunks", "expected"),
    [
        ([chunk(bytes(2**26), "bz2")], "found more, which a bag of this size may not hold"),
        ([chunk(CONNECTION + say() * 2**17, "bz2")] * 3, "may not hold so many messages"),
    ],
    ids=["bytes", "messages"],
)
def test_a_small_bag_that_unpacks_to_too_much_is_refused(
    chunks: list[bytes], expected: str, tmp_path: Path
) -> None:
    """Half as many messages as are allowed, and more, are unpacked."""
    path = write_bag(tmp_path / "a.bag", *chunks)
    assert path.stat().st_size < 50_000
    with pytest.raises(LogError, match=expected):
        read_columns(path)


def test_a_definition_that_is_missing_is_told(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros1")
        number = writer.register_schema("nav_msgs/Odometry", "ros1msg", b"")
        channel = writer.register_channel("/odom", "ros1", number)
        writer.add_message(channel, 1, b"1234", 1)
        writer.finish()  # type: ignore[no-untyped-call]
    with pytest.raises(LogError, match="the file holds no definition"):
        read_run(path)


def test_lengths_that_no_message_has_room_for_are_refused() -> None:
    for text in (
        "float64[] values",
        "string text",
        "std_msgs/Empty[] nothing\n" + "=" * 80 + "\nMSG: std_msgs/Empty\n",
    ):
        fields = read_ros1_type("a/B", text).fields
        data = struct.pack("<I", 2**32 - 1)
        with pytest.raises(LogError, match="expected at most 0 items at byte 4"):
            build_converter(fields)(data)
