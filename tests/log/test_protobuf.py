"""MCAP files with messages in protobuf, written by Google's library."""

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from hypothesis import given, settings, strategies as st
from mcap.writer import Writer

from turtlelog.errors import LogError
from turtlelog.log import read_columns, read_file_info, read_run, read_trajectory
from turtlelog.log.engine.object_messages import read_protobuf_type

START_S = 1_700_000_000
DOUBLE, TEXT, MESSAGE = 1, 9, 11
VECTOR = [("x", DOUBLE, ""), ("y", DOUBLE, ""), ("z", DOUBLE, "")]
TYPES = {
    "Vector3": VECTOR,
    "Quaternion": [*VECTOR, ("w", DOUBLE, "")],
    "Pose": [
        ("position", MESSAGE, ".foxglove.Vector3"),
        ("orientation", MESSAGE, ".foxglove.Quaternion"),
    ],
    "PoseInFrame": [
        ("timestamp", MESSAGE, ".google.protobuf.Timestamp"),
        ("frame_id", TEXT, ""),
        ("pose", MESSAGE, ".foxglove.Pose"),
    ],
    "FrameTransform": [
        ("timestamp", MESSAGE, ".google.protobuf.Timestamp"),
        ("parent_frame_id", TEXT, ""),
        ("child_frame_id", TEXT, ""),
        ("translation", MESSAGE, ".foxglove.Vector3"),
        ("rotation", MESSAGE, ".foxglove.Quaternion"),
    ],
}


def define(types: dict[str, list[tuple[str, int, str]]]) -> descriptor_pb2.FileDescriptorSet:
    """Return types with fields of a name, a kind and the type of a message."""
    own = descriptor_pb2.FileDescriptorProto(
        name="own.proto", package="foxglove", syntax="proto3",
        dependency=["google/protobuf/timestamp.proto"],
    )  # fmt: skip
    for name, fields in types.items():
        message = own.message_type.add(name=name)
        for number, (key, kind, of) in enumerate(fields, start=1):
            label = 3 if key.startswith("list_") else 1
            field = message.field.add(name=key, number=number, type=kind, label=label)
            if of:
                field.type_name = of
    stamps = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(stamps)
    return descriptor_pb2.FileDescriptorSet(file=[stamps, own])


def make_class(found: descriptor_pb2.FileDescriptorSet, name: str) -> Any:
    pool = descriptor_pool.DescriptorPool()
    for file in found.file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"foxglove.{name}"))


DEFINED = define(TYPES)


def say(
    name: str, count: int = 40, frames: tuple[str, ...] = ("base",)
) -> Iterable[tuple[int, bytes]]:
    """Yield log times, 2 ms after the stamps, and messages of a drive along x that turns."""
    kind = make_class(DEFINED, name)
    for row in range(count):
        nanos = row % 20 * 50_000_000
        values: dict[str, Any] = {"timestamp": {"seconds": START_S + row // 20, "nanos": nanos}}
        place = {"x": 0.1 * row, "y": 0.0, "z": 0.5}
        turn = {"z": math.sin(row / 100), "w": math.cos(row / 100)}
        if name == "PoseInFrame":
            values |= {"frame_id": "map", "pose": {"position": place, "orientation": turn}}
        else:
            values |= {"parent_frame_id": "map", "child_frame_id": frames[row % len(frames)]}
            values |= {"translation": place, "rotation": turn}
        message = kind(**values)
        yield (START_S + row // 20) * 10**9 + nanos + 2_000_000, message.SerializeToString()


def write(
    path: Path, name: str, messages: Iterable[tuple[int, bytes]], data: bytes | None = None
) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        text = DEFINED.SerializeToString() if data is None else data
        schema = writer.register_schema(f"foxglove.{name}", "protobuf", text)
        channel = writer.register_channel("/pose", "protobuf", schema)
        for time_ns, message in messages:
            writer.add_message(channel, time_ns, message, time_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


@pytest.mark.parametrize("name", ["PoseInFrame", "FrameTransform"])
def test_poses_of_foxglove_are_read(name: str, tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", name, say(name))
    run = read_run(path)
    assert run.poses.xy_m[:, 0] == pytest.approx([0.1 * row for row in range(40)])
    assert run.poses.heading_rad == pytest.approx([row / 50 for row in range(40)])
    assert run.clock is not None
    assert run.clock.used == "stamp"
    assert run.clock.offset_s == pytest.approx(0.002)
    assert not read_file_info(path).not_understood
    trajectory = read_trajectory(path)
    assert trajectory.space == "space"
    assert set(trajectory.xyz_m[:, 2].tolist()) == {0.5}
    assert trajectory.time_ns[1] - trajectory.time_ns[0] == 50_000_000


def test_transforms_of_several_frames_are_told_apart(tmp_path: Path) -> None:
    messages = say("FrameTransform", frames=("base_link", "camera"))
    path = write(tmp_path / "a.mcap", "FrameTransform", messages)
    run = read_run(path)
    assert run.notes["pose_topic"] == "/pose (foxglove.FrameTransform): map -> base_link"
    assert len(run.poses) == 20
    other = read_run(path, pose_frame="camera")
    assert other.poses.xy_m[:, 0] == pytest.approx([0.1 * row for row in range(1, 40, 2)])


def test_what_was_not_written_is_zero_or_absent(tmp_path: Path) -> None:
    kind = make_class(DEFINED, "PoseInFrame")
    empty = kind(pose={"position": {"x": 1.0}}).SerializeToString()
    fields = read_columns(write(tmp_path / "a.mcap", "PoseInFrame", [(1, empty)]))["/pose"].fields
    assert fields["pose.position.x"].tolist() == [1.0]
    assert fields["pose.position.y"].tolist() == [0.0]
    assert math.isnan(fields["pose.orientation.w"][0])
    assert fields["timestamp.sec"].tolist() == [0]
    assert fields["frame_id"].tolist() == [""]


_INTEGERS = {
    3: st.integers(-(2**63), 2**63 - 1),
    4: st.integers(0, 2**64 - 1),
    5: st.integers(-(2**31), 2**31 - 1),
    6: st.integers(0, 2**64 - 1),
    7: st.integers(0, 2**32 - 1),
    13: st.integers(0, 2**32 - 1),
    15: st.integers(-(2**31), 2**31 - 1),
    16: st.integers(-(2**63), 2**63 - 1),
    17: st.integers(-(2**31), 2**31 - 1),
    18: st.integers(-(2**63), 2**63 - 1),
}
_VALUES: dict[int, st.SearchStrategy[Any]] = {
    1: st.floats(allow_nan=False),
    2: st.floats(width=32, allow_nan=False),
    8: st.booleans(),
    9: st.text(),
    **_INTEGERS,
}
_ALL = define({"All": [(f"of_{kind}", kind, "") for kind in _VALUES]})


@settings(max_examples=60)
@given(st.fixed_dictionaries({f"of_{kind}": found for kind, found in _VALUES.items()}))
def test_every_type_of_number_comes_back(values: dict[str, Any]) -> None:
    data = make_class(_ALL, "All")(**values).SerializeToString()
    kind = read_protobuf_type("foxglove.All", _ALL.SerializeToString())
    assert kind.decode(data) == values


def test_lists_and_unknown_fields_are_passed_over() -> None:
    wide = define(
        {"A": [("x", DOUBLE, ""), ("list_y", DOUBLE, ""), ("list_z", MESSAGE, ".foxglove.A")]}
    )
    data = make_class(wide, "A")(x=2.0, list_y=[1.0, 2.0], list_z=[{"x": 1.0}]).SerializeToString()
    narrow = read_protobuf_type(
        "foxglove.A", define({"A": [("x", DOUBLE, "")]}).SerializeToString()
    )
    assert narrow.decode(data) == {"x": 2.0}
    whole = read_protobuf_type("foxglove.A", wide.SerializeToString())
    assert whole.decode(data) == {"x": 2.0}
    assert [field.kind for field in whole.list_fields()] == ["number", "any", "any"]


def test_a_type_that_holds_itself_ends() -> None:
    loop = define({"A": [("x", DOUBLE, ""), ("a", MESSAGE, ".foxglove.A")]})
    found = read_protobuf_type("foxglove.A", loop.SerializeToString())
    assert [field.name for field in found.list_fields()] == ["x"]


def test_types_that_multiply_are_refused() -> None:
    types = {"T0": VECTOR}
    types |= {
        f"T{level}": [(f"f{n}", MESSAGE, f".foxglove.T{level - 1}") for n in range(10)]
        for level in range(1, 9)
    }
    with pytest.raises(LogError, match="expected up to 10000 fields, found more"):
        read_protobuf_type("foxglove.T8", define(types).SerializeToString())


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"\xff" * 20, "expected a number of up to 10 bytes"),
        (b"\x1a\xff\xff", "expected a number, found the end"),
        (b"\x1a\x7f", "expected 127 bytes more, found 0"),
        (b"\x0b", "expected a wire type of proto3, found 3"),
        (b"\x19" + bytes(8), "pose: expected the wire type 2, found 1"),
        (b"\x12\x00\x1a\x04\x0a\x02\x08\x01", "x: expected the wire type 1, found 0"),
    ],
)
def test_a_message_that_is_wrong_is_refused_in_one_line(
    data: bytes, expected: str, tmp_path: Path
) -> None:
    path = write(tmp_path / "a.mcap", "PoseInFrame", [*say("PoseInFrame", 1), (9, data)])
    with pytest.raises(LogError) as caught:
        read_columns(path)
    assert "topic /pose: message 1: " in str(caught.value)
    assert expected in str(caught.value)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"", "expected its definition, found none"),
        (b"\x08\x01", "expected descriptors, found a number"),
        (b"\x0a\x7f", "expected 127 bytes more"),
        (b"text", "schema foxglove.PoseInFrame: "),
        (define({"Other": VECTOR}).SerializeToString(), "found foxglove.Other"),
    ],
)
def test_a_definition_that_is_wrong_is_told_as_the_reason(
    data: bytes, expected: str, tmp_path: Path
) -> None:
    path = write(tmp_path / "a.mcap", "PoseInFrame", say("PoseInFrame", 2), data)
    with pytest.raises(LogError) as caught:
        read_run(path)
    assert expected in str(caught.value)
