from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer

from tests.log.engine.files import POINT, Row, pack, write_rows
from tests.log.runs import find_shared
from turtlelog.errors import LogError
from turtlelog.log import read_columns

LINE = "=" * 80 + "\n"
JOINTS = (
    "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat32[<=9] effort\nbool[] on\n"
    f"Point[] points\nbyte[] data\nstring[2] ends\n{LINE}MSG: std_msgs/Header\n"
    f"builtin_interfaces/Time stamp\nstring frame_id\n{LINE}MSG: test/Point\nuint8 n\n"
    f"string s\nfloat64 x\n{LINE}MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
)
MESSAGES: list[dict[str, Any]] = [
    {
        "header": {"stamp": {"sec": 7, "nanosec": 9}, "frame_id": "base"},
        "name": ["a", "", "\u00fcber"],
        "position": [0.1, -2.0, 3.5],
        "effort": [0.5],
        "on": [True, False],
        "points": [{"n": 3, "s": "x", "x": 0.25}, {"n": 4, "s": "", "x": -1.0}],
        "data": [1, 2, 255],
        "ends": ["l", "right"],
    },
    {
        "header": {"stamp": {"sec": 8, "nanosec": 0}, "frame_id": ""},
        "name": [],
        "position": [],
        "effort": [],
        "on": [],
        "points": [],
        "data": [],
        "ends": ["", ""],
    },
]


@pytest.fixture
def joints(tmp_path: Path) -> Path:
    with (tmp_path / "a.mcap").open("wb") as stream:
        writer = Writer(stream)
        schema = writer.register_msgdef("test/msg/Joints", JOINTS)
        for number, message in enumerate([*MESSAGES, MESSAGES[0]]):
            writer.write_message("/a", schema, message, log_time=number, publish_time=number)
        writer.finish()  # type: ignore[no-untyped-call]
    return tmp_path / "a.mcap"


def test_sequences_and_texts_come_as_mcap_ros2_wrote_them(joints: Path) -> None:
    found = read_columns(joints)["/a"].fields
    assert list(found["header.frame_id"]) == ["base", "", "base"]
    for row, message in enumerate([*MESSAGES, MESSAGES[0]]):
        assert found["header.stamp.sec"][row] == message["header"]["stamp"]["sec"]
        for name in ("name", "points", "ends"):
            assert found[name][row] == message[name]
        for name, kind in {"position": "f8", "effort": "f4", "on": "?", "data": "u1"}.items():
            assert found[name][row].dtype == np.dtype(kind)
            assert found[name][row].tolist() == message[name]


@pytest.mark.parametrize("name", ["rosbag2_talker.mcap", "rosbag2_wbag_0.mcap"])
def test_other_peoples_texts_are_read_as_mcap_ros2_reads_them(name: str) -> None:
    path = find_shared("ros2", name)
    expected: dict[str, list[Any]] = {}
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for found in reader.iter_decoded_messages():
            expected.setdefault(found.channel.topic, []).append(found.decoded_message)
    columns = read_columns(path, topics=expected)
    for topic, messages in expected.items():
        for field, values in columns[topic].fields.items():
            if "." not in field:
                assert list(values) == [getattr(message, field) for message in messages]


def write_texts(path: Path, *messages: bytes) -> Path:
    rows = [Row(topic="/a", time_ns=number, data=data) for number, data in enumerate(messages)]
    return write_rows(path / "a.mcap", {"/a": ("test/msg/Text", "uint8 n\nstring s\n")}, rows)


def test_big_endian_messages_are_read_among_others(tmp_path: Path) -> None:
    values = [("uint8", 7), ("string", "text")]
    path = write_texts(tmp_path, pack(values), pack(values, ">"), pack(values))
    assert list(read_columns(path)["/a"].fields["s"]) == ["text"] * 3


def test_big_endian_numbers_are_read_among_others(tmp_path: Path) -> None:
    rows = [
        Row(topic="/p", time_ns=0, data=pack([("float64", 0.5), ("float64", -3.0)], order))
        for order in "<><"
    ]
    write_rows(tmp_path / "a.mcap", {"/p": ("test/msg/Point", POINT)}, rows)
    found = read_columns(tmp_path / "a.mcap")["/p"].fields
    assert (found["x"].tolist(), found["y"].tolist()) == ([0.5] * 3, [-3.0] * 3)
    assert found["x"].dtype == np.dtype("=f8")


def test_a_text_may_lack_its_closing_zero(tmp_path: Path) -> None:
    data = b"\0\1\0\0" + b"\7\0\0\0" + b"\2\0\0\0ab"
    path = write_texts(tmp_path, data, data[:8] + b"\0\0\0\0")
    assert list(read_columns(path)["/a"].fields["s"]) == ["ab", ""]


def test_padding_up_to_four_bytes_does_no_harm(tmp_path: Path) -> None:
    path = write_texts(tmp_path, pack([("uint8", 1), ("string", "abcd")]) + b"\0\0\0")
    assert list(read_columns(path)["/a"].fields["s"]) == ["abcd"]


# As ROS 2 with Fast DDS serialises it; behind the fields are 8 bytes that nothing was written to.
PARAMETER = (
    "uint8 type\nbool bool_value\nint64 integer_value\nfloat64 double_value\nstring string_value\n"
    "byte[] byte_array_value\nbool[] bool_array_value\nint64[] integer_array_value\n"
    "float64[] double_array_value\nstring[] string_array_value\n"
)
OVERESTIMATED = bytes.fromhex(
    "00010000 00000000 a0e84b51 00000000 00000000 00000000 00000000 02000000 6100552e 01000000"
    "016e552e 02000000 0100552e 00000000 00000000 00000000 706f552e 1f7f0000"
)


def write_parameter(path: Path, data: bytes) -> Path:
    rows = [Row(topic="/a", time_ns=0, data=data)]
    return write_rows(path / "a.mcap", {"/a": ("test/msg/Parameter", PARAMETER)}, rows)


def test_what_ros_2_sets_aside_for_empty_sequences_does_no_harm(tmp_path: Path) -> None:
    found = read_columns(write_parameter(tmp_path, OVERESTIMATED))["/a"].fields
    assert found["string_value"].tolist() == ["a"]
    assert found["bool_array_value"][0].tolist() == [True, False]
    for kind in ("integer", "double", "string"):
        assert list(found[f"{kind}_array_value"][0]) == []


def test_more_than_ros_2_sets_aside_is_refused(tmp_path: Path) -> None:
    path = write_parameter(tmp_path, OVERESTIMATED + bytes(12))
    with pytest.raises(LogError, match="message 0: expected 64 bytes, found 84"):
        read_columns(path)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "message 1: expected at least 4 bytes, found 0"),
        (b"\0\1\0\0", "n: message 1: expected more than 4 bytes"),
        (b"\0\1\0\0\1\0\0\0\2\0\0\0a", "s: message 1: expected more than 13 bytes"),
        (b"\0\1\0\0\1\0\0\0\xff\xff\xff\xffa", "s: message 1: expected more than 13 bytes"),
        (b"\0\1\0\0\1\0\0\0\1\0\0\0\xff", "s: message 1: expected UTF-8 text"),
        (pack([("uint8", 1), ("string", "a")]) + b"1234", "message 1: expected 14 bytes, found 18"),
        (b"\0\3\0\0\1\0\0\0\0\0\0\0", "message 1: expected the CDR header 0001 or 0000"),
    ],
)
def test_a_message_that_is_not_of_its_type_is_named(
    data: bytes, message: str, tmp_path: Path
) -> None:
    path = write_texts(tmp_path, pack([("uint8", 1), ("string", "a")]), data)
    with pytest.raises(LogError, match=rf"^\S+a\.mcap: byte \d+: topic /a: {message}"):
        read_columns(path)


def test_a_sequence_that_claims_too_much_is_refused_at_once(tmp_path: Path) -> None:
    rows = [Row(topic="/a", time_ns=0, data=b"\0\1\0\0\xff\xff\xff\xff1234")]
    for text in ("uint8[] a\n", "float64[] a\n", "string[] a\n", f"E[] a\n{LINE}MSG: test/E\n"):
        write_rows(tmp_path / "a.mcap", {"/a": ("test/msg/A", text)}, rows)
        with pytest.raises(LogError, match="a: message 0: expected more than 12 bytes"):
            read_columns(tmp_path / "a.mcap")
