from pathlib import Path
from typing import Any

import pytest

from tests.log.engine.files import CODES, Row, pack, write_rows
from turtlelog.errors import LogError
from turtlelog.log import TopicColumns, read_columns, read_info
from turtlelog.log.engine import message_types
from turtlelog.log.engine.message_types import LONGEST_KEPT, MOST_KEPT_FIELDS, read_type

LINE = "=" * 80 + "\n"


def read_message(path: Path, text: str, data: bytes, kind: str = "test/msg/Kind") -> TopicColumns:
    write_rows(path / "a.mcap", {"/a": (kind, text)}, [Row(topic="/a", time_ns=0, data=data)])
    return read_columns(path / "a.mcap", topics=["/a"])["/a"]


def read_values(path: Path, text: str, values: list[tuple[str, Any]]) -> dict[str, Any]:
    found = read_message(path, text, pack(values))
    return {name: column[0] for name, column in found.fields.items()}


def test_every_number_is_aligned_to_its_own_size(tmp_path: Path) -> None:
    kinds = [*CODES, "float64", "int8", "uint64", "int8", "int16", "uint8", "uint32"]
    text = "".join(f"{kind} f{number}\n" for number, kind in enumerate(kinds))
    values = [(kind, number % 2) for number, kind in enumerate(kinds, start=1)]
    found = read_values(tmp_path, text, values)
    assert list(found.values()) == [value for _, value in values]
    assert list(found) == [f"f{number}" for number in range(len(kinds))]


def test_nested_messages_have_dotted_names(tmp_path: Path) -> None:
    text = (
        "Header header\nPoint point\nother/msg/Point point2\n"
        f"{LINE}MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
        f"{LINE}MSG: test/Point\nfloat64 x\n{LINE}MSG: other/Point\nuint8 x\n"
    )
    values = [("int32", -7), ("uint32", 8), ("string", "map"), ("float64", 0.5), ("uint8", 9)]
    found = read_values(tmp_path, text, values)
    names = ["header.stamp.sec", "header.stamp.nanosec", "header.frame_id", "point.x", "point2.x"]
    assert found == dict(zip(names, [-7, 8, "map", 0.5, 9], strict=True))


def test_time_and_duration_need_no_definition(tmp_path: Path) -> None:
    text = "time a\nduration b\nbuiltin_interfaces/Duration c\n"
    values = [("int32", -1), ("uint32", 2), ("int32", -3), ("uint32", 4), ("int32", -5)]
    found = read_values(tmp_path, text, [*values, ("uint32", 6)])
    assert list(found) == ["a.sec", "a.nanosec", "b.sec", "b.nanosec", "c.sec", "c.nanosec"]
    assert list(found.values()) == [-1, 2, -3, 4, -5, 6]


def test_constants_comments_and_defaults_are_no_fields(tmp_path: Path) -> None:
    text = (
        '# a comment with int32 x\n\nint32 X=1\nint32 Y = 2 # two\nstring S="a=b # c"\n'
        "  int32 a 5  # default\nstring<=10 b 'x=y'\nfloat64 c# d\n"
    )
    found = read_values(tmp_path, text, [("int32", 3), ("string", "t"), ("float64", 4.0)])
    assert found == {"a": 3, "b": "t", "c": 4.0}


def test_a_fixed_array_is_one_column_of_rows(tmp_path: Path) -> None:
    text = "uint8 a\nfloat64[36] covariance\nbool[3] flags\n"
    values = [("uint8", 1), *(("float64", number) for number in range(36))]
    data = pack([*values, ("bool", True), ("bool", False), ("bool", True)])
    found = read_message(tmp_path, text, data).fields
    assert found["covariance"].shape == (1, 36)
    assert found["covariance"][0].tolist() == list(range(36))
    assert found["flags"].dtype.kind == "b"
    assert found["flags"].tolist() == [[True, False, True]]


def test_an_array_of_messages_has_numbered_names(tmp_path: Path) -> None:
    text = f"Pair[2] p\nuint8 z\n{LINE}MSG: test/Pair\nuint8 a\nint32 b\n"
    values = [("uint8", 1), ("int32", 2), ("uint8", 3), ("int32", 4), ("uint8", 5)]
    found = read_values(tmp_path, text, values)
    assert found == {"p.0.a": 1, "p.0.b": 2, "p.1.a": 3, "p.1.b": 4, "z": 5}


def test_a_type_without_fields_is_one_byte(tmp_path: Path) -> None:
    found = read_message(
        tmp_path,
        f"Empty e\nuint8 a\n{LINE}MSG: test/Empty\n# none\n",
        pack([("uint8", 0), ("uint8", 7)]),
    )
    assert {name: column.tolist() for name, column in found.fields.items()} == {"a": [7]}


@pytest.mark.parametrize("name", ["test/Kind", "test/msg/Kind", "ns/test/msg/Kind"])
def test_a_type_may_be_named_in_several_ways(name: str, tmp_path: Path) -> None:
    text = f"Inner inner\n{LINE}MSG: {name.replace('Kind', 'Inner')}\r\nuint8 a\r\n"
    found = read_message(tmp_path, text, pack([("uint8", 7)]), kind=name)
    assert (found.type, found.fields["inner.a"].tolist()) == (name, [7])


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("Missing a\n", "schema test/Missing: its definition is missing"),
        (f"A a\n{LINE}MSG: test/A\nKind b\n", "found one that holds itself"),
        ("int32\n", "expected a type and a name, found 'int32'"),
        ("int32 a\nint32 a\n", "expected names that differ, found one twice"),
        ("wstring a\n", "wstring: ROS's middlewares do not agree on its bytes"),
        ("{}", "expected a type and a name, found '{}'"),
        (
            f"int32 a\n{LINE}SRV: test/A\nint32 a\n",
            "after =====, expected MSG: and a type",
        ),
        (f"A[9999] a\n{LINE}MSG: test/A\nint32 a\nint32 b\n", "expected up to 10000 fields"),
        (f"A[999999999] a\n{LINE}MSG: test/A\n", "expected up to 10000 fields"),
        ("uint8[99999999999] a\n", "expected a type and a name"),
    ],
)
def test_a_topic_that_is_not_understood_says_why(text: str, reason: str, tmp_path: Path) -> None:
    schemas = {"/a": ("test/msg/Kind", text), "/b": ("test/msg/Byte", "uint8 a\n")}
    rows = [Row(topic=topic, time_ns=0, data=pack([("uint8", 1)])) for topic in schemas]
    path = write_rows(tmp_path / "a.mcap", schemas, rows)
    assert list(read_columns(path)) == ["/b"]
    assert reason in next(iter(read_info(path).not_understood))
    with pytest.raises(LogError, match=r"^\S+a\.mcap: topic /a: not understood: ") as caught:
        read_columns(path, topics=["/a", "/b"])
    assert reason in str(caught.value)


def test_types_nested_too_deeply_are_not_understood(tmp_path: Path) -> None:
    parts = [f"{LINE}MSG: test/T{number}\nT{number + 1} a\n" for number in range(2000)]
    with pytest.raises(LogError, match="not understood: schema test/T"):
        read_message(tmp_path, "T0 a\n" + "".join(parts), b"\0\1\0\0")


@pytest.mark.parametrize(("more", "is_kept"), [(0, True), (1, False)])
def test_types_of_usual_size_are_parsed_once(more: int, *, is_kept: bool) -> None:
    text = "".join(f"float64 f{number}\n" for number in range(MOST_KEPT_FIELDS + more))
    found = read_type("test/msg/Wide", text)
    assert found.size == MOST_KEPT_FIELDS + more
    assert (read_type("test/msg/Wide", text) is found) == is_kept
    assert read_type("test/msg/Wide", f"int8 a\n{text}").size == found.size + 1


@pytest.mark.parametrize(("more", "is_kept"), [(0, True), (1, False)])
def test_types_of_usual_text_are_parsed_once(more: int, *, is_kept: bool) -> None:
    text = f"int8 a  # {'x' * (LONGEST_KEPT + more - 10)}"
    assert len(text) == LONGEST_KEPT + more
    found = read_type("test/msg/Long", text)
    assert (read_type("test/msg/Long", text) is found) == is_kept


def test_what_is_kept_of_types_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    kept: dict[tuple[str, str], message_types.MessageType] = {}
    monkeypatch.setattr(message_types, "_KEPT", kept)
    for number in range(300):
        read_type("test/msg/Kind", f"int8 a{number}\n")
    assert len(kept) == 128
    assert ("test/msg/Kind", "int8 a299\n") in kept
