"""Messages in JSON, as columns by the schema in the file."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer

from tests.log.runs import find_shared
from turtlelog.errors import LogError
from turtlelog.log import TopicColumns, iter_columns, read_columns, read_info
from turtlelog.log.engine import object_messages
from turtlelog.log.engine.message_types import LONGEST_TEXT
from turtlelog.log.engine.topic_columns import read_some_columns

NUMBER: dict[str, Any] = {"type": "number"}
POSE = {
    "type": "object",
    "properties": {
        "timestamp": {
            "type": "object",
            "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
        },
        "frame_id": {"type": "string"},
        "pose": {
            "$ref": "#/$defs/Pose",
        },
        "is_valid": {"type": ["boolean", "null"]},
        "ranges": {"type": "array", "items": NUMBER},
        "gain": {"anyOf": [NUMBER, {"type": "null"}]},
    },
    "$defs": {
        "Pose": {
            "type": "object",
            "properties": {
                "position": {"type": "object", "properties": {"x": NUMBER, "y": NUMBER}},
            },
        },
    },
}


def write_json(
    path: Path, messages: list[Any], schema: Any = POSE, *, chunk_size: int = 2**20
) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size)
        writer.start("", "test")
        text = schema if isinstance(schema, bytes) else json.dumps(schema).encode()
        kind = writer.register_schema("foxglove.PoseInFrame", "jsonschema", text)
        channel = writer.register_channel("/pose", "json", kind)
        for row, message in enumerate(messages):
            data = message if isinstance(message, bytes) else json.dumps(message).encode()
            writer.add_message(channel, row * 10, data, row * 10 + 1, row)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def read(path: Path, messages: list[Any], schema: Any = POSE) -> TopicColumns:
    return read_columns(write_json(path / "a.mcap", messages, schema))["/pose"]


def make_pose(x: Any = 1.5, **more: Any) -> dict[str, Any]:
    stamp = {"sec": 1_740_566_235, "nsec": 448_000_000}
    return {"timestamp": stamp, "frame_id": "map", "pose": {"position": {"x": x, "y": 2}}, **more}


def test_fields_have_dotted_names_and_kinds(tmp_path: Path) -> None:
    found = read(tmp_path, [make_pose(is_valid=True, ranges=[1, 2.5], gain=3)] * 2)
    assert found.type == "foxglove.PoseInFrame"
    assert found.log_time_ns.tolist() == [0, 10]
    assert found.publish_time_ns.tolist() == [1, 11]
    assert found.sequence.tolist() == [0, 1]
    kinds = {name: column.dtype.kind for name, column in found.fields.items()}
    assert kinds == {
        "timestamp.sec": "i",
        "timestamp.nsec": "i",
        "frame_id": "O",
        "pose.position.x": "f",
        "pose.position.y": "f",
        "is_valid": "b",
        "ranges": "O",
        "gain": "f",
    }
    assert [column[0] for column in found.fields.values()] == [
        *(1_740_566_235, 448_000_000, "map", 1.5, 2.0, True, [1, 2.5], 3.0)
    ]


def test_what_a_message_lacks_is_nan_or_empty(tmp_path: Path) -> None:
    found = read(tmp_path, [make_pose(is_valid=False), {}, {"pose": None, "is_valid": None}]).fields
    assert found["pose.position.x"].tolist()[0] == 1.5
    assert np.isnan(found["pose.position.x"][1:]).all()
    assert found["timestamp.sec"].dtype == np.float64
    assert np.isnan(found["timestamp.sec"]).tolist() == [False, True, True]
    assert found["is_valid"].tolist()[0] == 0.0
    assert found["frame_id"].tolist() == ["map", "", ""]
    assert found["ranges"].tolist() == [None] * 3


def test_a_gap_in_a_later_chunk_turns_the_whole_column_into_floats(tmp_path: Path) -> None:
    messages = [make_pose() for _ in range(40)] + [{}]
    path = write_json(tmp_path / "a.mcap", messages, chunk_size=1000)
    seconds = read_columns(path)["/pose"].fields["timestamp.sec"]
    assert seconds.dtype == np.float64
    assert np.isnan(seconds).tolist() == [False] * 40 + [True]
    assert seconds[39] == 1_740_566_235
    batches = [batch["/pose"] for batch in iter_columns(path, rows=8)]
    assert sum(map(len, batches)) == 41


def test_numbers_that_json_lacks_are_read(tmp_path: Path) -> None:
    found = read(tmp_path, [make_pose(x) for x in (math.nan, math.inf, "-Infinity", 10**400)])
    assert found.fields["pose.position.x"][1:].tolist() == [math.inf, -math.inf, math.inf]
    assert math.isnan(found.fields["pose.position.x"][0])


def test_whole_numbers_beyond_64_bits_become_floats(tmp_path: Path) -> None:
    schema = {"type": "object", "properties": {"a": {"type": "integer"}}}
    assert read(tmp_path, [{"a": 2**62 + 1}], schema).fields["a"][0] == 2**62 + 1
    found = read(tmp_path, [{"a": 1}, {"a": 2**70}, {"a": 3.0}], schema).fields["a"]
    assert found.tolist() == [1.0, 2.0**70, 3.0]


def test_arrays_are_left_out_where_flat_columns_are_asked_for(tmp_path: Path) -> None:
    path = write_json(tmp_path / "a.mcap", [make_pose(ranges=[1])])
    assert {*read_columns(path)["/pose"].fields} - {
        *read_some_columns(path, ["/pose"], is_flat=True)["/pose"].fields
    } == {"ranges"}


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (b"{", "message 1: expected JSON, found b'{'"),
        (b"", "message 1: expected JSON, found b''"),
        (b"[1]", "message 1: expected a JSON object, found b'[1]'"),
        (b"[" * 100_000, "message 1: expected JSON, found b'[["),
        (b'{"a": "\xff"}', "message 1: expected JSON"),
        (make_pose("one"), "message 1: pose.position.x: expected a number, found 'one'"),
        (make_pose(x=True), "message 1: pose.position.x: expected a number, found True"),
        ({"pose": 3}, "message 1: pose: expected an object, found 3"),
        ({"pose": [1, 2]}, "message 1: pose: expected an object, found [1, 2]"),
        (make_pose(is_valid=1), "message 1: is_valid: expected true or false, found 1"),
        ({"frame_id": 5}, "message 1: frame_id: expected a text, found 5"),
        ({"timestamp": {"sec": 1.5}}, "message 1: timestamp.sec: expected a whole number"),
    ],
)
def test_wrong_message_is_one_line_with_its_number(
    message: Any, reason: str, tmp_path: Path
) -> None:
    with pytest.raises(LogError, match=r"a\.mcap: byte .*: topic /pose: ") as caught:
        read(tmp_path, [make_pose(), message])
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


def test_message_of_any_length_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    size = len(json.dumps(make_pose()))
    monkeypatch.setattr(object_messages, "LONGEST_MESSAGE", size)
    assert len(read(tmp_path, [make_pose()])) == 1
    monkeypatch.setattr(object_messages, "LONGEST_MESSAGE", size - 1)
    with pytest.raises(LogError, match=f"expected up to {size - 1} bytes of JSON, found {size}"):
        read(tmp_path, [make_pose()])


def nest(depth: int) -> dict[str, Any]:
    schema = NUMBER
    for _ in range(depth):
        schema = {"type": "object", "properties": {"a": schema}}
    return schema


@pytest.mark.parametrize(
    ("schema", "reason"),
    [
        (b"{", "expected JSON, found"),
        (b"", "expected JSON, found"),
        (b"[" * 100_000, "expected JSON, found"),
        ({"type": "array"}, "expected an object with named fields, found no field"),
        ([], "expected an object with named fields, found no field"),
        ({"properties": {"#log_time": NUMBER}}, "named fields, found '#log_time'"),
        ({"properties": {"a.b": NUMBER, "a": {"properties": {"b": NUMBER}}}}, "found a.b twice"),
        ({"properties": {"a": {"$ref": "#/$defs/B"}}}, "no definition at '#/$defs/B'"),
        ({"properties": {"a": {"$ref": "http://a/b"}}}, "no definition at 'http://a/b'"),
        ({"properties": {"a": {"$ref": "#/properties/a"}}}, "found one to itself"),
        ({"properties": {"a": {"$ref": "#"}}}, "found one that holds itself"),
        (nest(70), "found one that holds itself"),
        ({"properties": {f"f{n}": NUMBER for n in range(10_001)}}, "expected up to 10000 fields"),
        (b" " * (LONGEST_TEXT + 1), f"expected up to {LONGEST_TEXT} bytes"),
    ],
)
def test_schema_that_describes_no_object_is_not_understood(
    schema: Any, reason: str, tmp_path: Path
) -> None:
    info = read_info(write_json(tmp_path / "a.mcap", [{}], schema))
    assert len(info.not_understood) == 1
    assert reason in info.not_understood[0]


def double(depth: int) -> dict[str, Any]:
    """Return objects that each refer to the next one twice; the last has no fields."""
    parts: dict[str, Any] = {f"a{depth}": {"properties": {}}, "$ref": "#/a0"}
    for number in range(depth):
        inner = {"$ref": f"#/a{number + 1}"}
        parts[f"a{number}"] = {"properties": {"x": inner, "y": inner}}
    return parts


def choose(count: int) -> dict[str, Any]:
    """Return fields that all refer to one list of choices."""
    choices = {"anyOf": [{"type": "null"}] * 20_000}
    return {"a": choices, "properties": {f"f{n}": {"$ref": "#/a"} for n in range(count)}}


@pytest.mark.parametrize("schema", [double(60), choose(9000)], ids=["objects", "choices"])
def test_objects_that_refer_to_each_other_without_end_are_not_understood(
    schema: dict[str, Any], tmp_path: Path
) -> None:
    info = read_info(write_json(tmp_path / "a.mcap", [{}], schema))
    assert "its objects refer to each other more than 262,144 times" in str(info.not_understood)


@pytest.mark.parametrize("choices", [5, {"a": 1}, [5], None])
def test_choices_that_are_none_are_any_value(choices: Any, tmp_path: Path) -> None:
    schema = {"properties": {"a": {"anyOf": choices}, "x": NUMBER}}
    assert read(tmp_path, [{"x": 1.5}], schema).fields["x"].tolist() == [1.5]


def test_json_without_a_schema_is_not_understood(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("", "test")
        writer.add_message(writer.register_channel("/a", "json", 0), 0, b"{}", 0)
        writer.finish()  # type: ignore[no-untyped-call]
    assert read_info(path).not_understood == ("/a: it has no schema",)


def test_json_logs_of_another_program_are_read() -> None:
    path = find_shared("ros2", "lichtblick_example_logs.mcap")
    assert read_info(path).not_understood == ()
    found = read_columns(path)
    assert {topic: len(columns) for topic, columns in found.items()} == {
        "/rosout": 1000,
        "mouse": 111,
    }
    assert found["/rosout"].fields["message"][0] == "Debug: System started #1"
    assert found["mouse"].fields["clientX"][0] == 1511.0
