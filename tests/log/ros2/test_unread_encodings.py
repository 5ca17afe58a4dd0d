"""What is said where messages are in an encoding that turtlelog does not read."""

from pathlib import Path

import pytest
from mcap.writer import Writer

import turtlelog as tl
from tests.log.ros2.bags import START_NS, make_command, make_poses, write_mcap
from turtlelog.errors import LogError
from turtlelog.log import iter_columns, read_columns, read_file_info, read_info, read_run

FLAT = (
    "its messages are in the encoding flatbuffer, and turtlelog reads cdr, json, ros1 and protobuf"
)
KINDS = pytest.mark.parametrize(
    ("encoding", "schema", "kind", "reason"),
    [
        ("flatbuffer", "flatbuffer", "nav_msgs/Odometry", FLAT),
        ("flatbuffer", "flatbuffer", "nav_msgs/msg/Odometry", FLAT),
    ],
)


def write_encoded(
    path: Path, encoding: str, schema: str, kind: str, topic: str = "/odom", count: int = 3
) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        number = writer.register_schema(kind, schema, b"")
        channel = writer.register_channel(topic, encoding, number)
        for row in range(count):
            time_ns = START_NS + 1_000_000_000 + row  # after what the other file of a bag holds
            writer.add_message(channel, time_ns, b"1234", time_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def add_topic(path: Path, other: Path) -> Path:
    """Return a bag of two files: what the second holds is in an encoding of its own."""
    folder = path.parent / "bag"
    folder.mkdir()
    path.rename(folder / "bag_0.mcap")
    other.rename(folder / "bag_1.mcap")
    return folder


@KINDS
def test_poses_in_another_encoding_are_refused_with_that_reason(
    encoding: str, schema: str, kind: str, reason: str, tmp_path: Path
) -> None:
    path = write_encoded(tmp_path / "a.mcap", encoding, schema, kind)
    for read in (read_run, read_columns, lambda one: [*iter_columns(one)]):
        with pytest.raises(LogError) as error:
            read(path)
        assert str(error.value).startswith(f"{path}: topic /odom: not understood: {reason}")
    assert read_info(path).not_understood[0].startswith(f"/odom: {reason}")


@KINDS
def test_a_topic_that_is_asked_for_is_refused_with_that_reason(
    encoding: str, schema: str, kind: str, reason: str, tmp_path: Path
) -> None:
    path = write_encoded(tmp_path / "a.mcap", encoding, schema, kind)
    with pytest.raises(LogError, match=reason):
        read_run(path, pose_topic="/odom")
    with pytest.raises(LogError, match=reason):
        read_columns(path, ["/odom"])


def test_what_to_do_is_told_with_the_encoding(tmp_path: Path) -> None:
    other = write_encoded(tmp_path / "b.mcap", "flatbuffer", "flatbuffer", "Pose")
    (reason,) = read_info(other).not_understood
    assert reason.endswith("cdr, json, ros1 and protobuf; record the topic in one of these")


def test_messages_that_name_no_encoding_are_refused_with_that_reason(tmp_path: Path) -> None:
    path = write_encoded(tmp_path / "a.mcap", "", "ros2msg", "nav_msgs/msg/Odometry")
    with pytest.raises(LogError, match="its messages name no encoding"):
        read_run(path)


def test_commands_in_another_encoding_are_named_beside_the_poses(tmp_path: Path) -> None:
    poses = write_mcap(tmp_path / "a.mcap", make_poses())
    other = write_encoded(
        tmp_path / "b.mcap", "flatbuffer", "flatbuffer", "geometry_msgs/Twist", "/turtle1/cmd_vel"
    )
    run = read_run(add_topic(poses, other))
    told = f"topic /turtle1/cmd_vel: not understood: {FLAT}"
    assert "commands" in run.absent
    assert run.notes["not_understood"].startswith(told)
    assert f"no commands; {told}" in run.notes["chosen"]


def test_poses_that_can_be_read_go_before_those_that_cannot(tmp_path: Path) -> None:
    poses = write_mcap(tmp_path / "a.mcap", [*make_poses(), make_command()])
    other = write_encoded(tmp_path / "b.mcap", "flatbuffer", "flatbuffer", "nav_msgs/msg/Odometry")
    run = read_run(add_topic(poses, other))
    assert run.notes["pose_topic"].startswith("/turtle1/pose")
    assert run.notes["not_understood"].startswith("topic /odom")


def test_an_image_that_cannot_be_read_is_no_matter_of_a_run(tmp_path: Path) -> None:
    poses = write_mcap(tmp_path / "a.mcap", [*make_poses(), make_command()])
    other = write_encoded(
        tmp_path / "b.mcap", "flatbuffer", "flatbuffer", "sensor_msgs/Image", "/image"
    )
    assert "not_understood" not in read_run(add_topic(poses, other)).notes


def test_what_can_be_read_is_read_beside_what_cannot(tmp_path: Path) -> None:
    folder = add_topic(
        write_mcap(tmp_path / "a.mcap", make_poses()),
        write_encoded(tmp_path / "b.mcap", "flatbuffer", "flatbuffer", "nav_msgs/Odometry"),
    )
    assert [*read_columns(folder / "bag_0.mcap")] == ["/turtle1/pose"]
    assert len(read_file_info(folder).not_understood) == 1
    assert tl.log.read_columns(write_mcap(tmp_path / "none.mcap", [])) == {}
