"""IDL against `ros2msg` of the same types, and against what rosbags makes of it."""

import time
from pathlib import Path

import pytest
from mcap.writer import Writer
from rosbags.typesys import get_types_from_idl

from tests.log.engine.files import pack
from turtlelog.errors import LogError
from turtlelog.log import read_columns, read_info
from turtlelog.log.engine.channels import KNOWN_TYPES, find_definition
from turtlelog.log.engine.idl import LONGEST_TEXT, convert_idl
from turtlelog.log.engine.message_types import Field, read_type

LINE = "=" * 80 + "\n"

# Every way in which IDL says something that ros2msg says, too.
PART = (
    LINE
    + """\
IDL: test_msgs/msg/Robot
// generated from rosidl_adapter/resource/msg.idl.em
#include "test_msgs/msg/Wheel.idl"
/* over
   lines: struct Nothing { */

module test_msgs {
  module msg {
    typedef double double__36[36];
    typedef test_msgs::msg::Wheel Wheels[2];
    typedef sequence<long> Counts;
    module Robot_Constants {
      const string NAME = "a " "b; // c";
      @verbatim (language="comment", text="with (brackets) }" "\\n")
      const unsigned long SIZE = 3;
      const octet FLAG = (1 << 2);
    };
    @verbatim (language="comment", text=
      "A robot.")
    struct Robot {
      @default (value=0.5)
      @unit (value="rad")
      double theta;
      double__36 covariance;
      Wheels wheels;
      Counts counts;
      sequence<test_msgs::msg::Wheel, 4> spare;
      sequence<string<10>> names;
      float matrix[Robot_Constants::SIZE], other;
      @key boolean on;
      unsigned long long stamp;
      long long left;
      short a; unsigned short b; octet c; int8 d; uint8 e; uint64 f;
      string<5> label;
      ::test_msgs::msg::State state;
      char letter;
    };
  };
};
"""
)
OTHERS = f"""\
{LINE}IDL: test_msgs/msg/Wheel
module test_msgs {{ module msg {{ struct Wheel {{
  float radius; builtin_interfaces::msg::Time at; }}; }}; }};
{LINE}IDL: builtin_interfaces/msg/Time
module builtin_interfaces {{ module msg {{ struct Time {{ int32 sec; uint32 nanosec; }}; }}; }};
{LINE}IDL: test_msgs/msg/State
module test_msgs {{ module msg {{ enum State {{ IDLE, @value(7) MOVING }}; }}; }};
"""
SAME = f"""\
float64 theta
float64[36] covariance
Wheel[2] wheels
int32[] counts
Wheel[<=4] spare
string[] names
float32[3] matrix
float32 other
bool on
uint64 stamp
int64 left
int16 a
uint16 b
byte c
int8 d
uint8 e
uint64 f
string label
uint32 state
char letter
{LINE}MSG: test_msgs/Wheel
float32 radius
builtin_interfaces/Time at
{LINE}MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""


def read_idl(text: str, kind: str = "test_msgs/msg/Robot") -> tuple[Field, ...]:
    return read_type(kind, convert_idl(kind, text)).fields


def wrap(body: str) -> str:
    return f"module test_msgs {{ module msg {{ {body} }}; }};"


def test_idl_gives_the_fields_of_ros2msg() -> None:
    assert read_idl(PART + OTHERS) == read_type("test_msgs/msg/Robot", SAME).fields


def write_as_rosidl(kind: str, known: str) -> str:
    """Return a type and those it needs in IDL, each array by a typedef of its own."""
    codes = {"bool": "boolean", "byte": "octet", "float32": "float", "float64": "double"}
    parts = []
    for part in f"MSG: {kind}\n{known}".replace(LINE, "").split("MSG: ")[1:]:
        heading, *lines = part.splitlines()
        package, *_, short = heading.split("/")
        members, typedefs = [], []
        for written, name in (line.split()[:2] for line in lines if "=" not in line):
            base, bracket, length = written.rstrip("]").partition("[")
            base = codes.get(base, base.replace("/", "::msg::"))
            if bracket and not length:
                base = f"sequence<{base}>"
            elif bracket:
                typedefs.append(f"typedef {base} {base}__{length}[{length}];")
                base = f"{base}__{length}"
            members.append(f"{base} {name};")
        members = members or ["uint8 structure_needs_at_least_one_member;"]
        body = f"{' '.join(dict.fromkeys(typedefs))} struct {short} {{ {' '.join(members)} }};"
        name = f"{package}/msg/{short}"
        parts.append(f"{LINE}IDL: {name}\nmodule {package} {{ module msg {{ {body} }}; }};\n")
    return "".join(parts)


def test_every_known_type_reads_the_same_from_idl() -> None:
    for kind in KNOWN_TYPES:
        known = find_definition(kind)
        assert known is not None
        text = write_as_rosidl(kind, known)
        own = read_type(kind, known).fields
        assert read_idl(text, kind) == own
        # What was written is IDL to others, too.
        part = text.split(LINE)[1].partition("\n")[2]
        names = [name for name, _ in get_types_from_idl(part)[kind][1]]
        assert names == [field.name for field in own] or kind == "std_msgs/msg/Empty"


def write_lone(path: Path, encoding: str, name: str, text: str, data: bytes) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", "test")
        schema = writer.register_schema(name, encoding, text.encode())
        channel = writer.register_channel("/a", "cdr", schema)
        writer.add_message(channel, 0, data, 0)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def test_messages_of_an_idl_schema_are_read(tmp_path: Path) -> None:
    kind = "geometry_msgs/msg/Twist"
    text = write_as_rosidl(kind, str(find_definition(kind)))
    data = pack([("float64", number) for number in range(6)])
    for encoding in ("ros2idl", "omgidl"):
        path = write_lone(tmp_path / f"{encoding}.mcap", encoding, kind, text, data)
        found = read_columns(path)["/a"].fields
        assert [values[0] for values in found.values()] == [*range(6)]
        assert [*found][3:] == ["angular.x", "angular.y", "angular.z"]


@pytest.mark.parametrize("encoding", ["", "ros2msg", "ros2idl"])
def test_known_type_without_a_definition_is_read(encoding: str, tmp_path: Path) -> None:
    data = pack([("int32", 5), ("uint32", 6)])
    path = write_lone(tmp_path / "a.mcap", encoding, "rosgraph_msgs/msg/Clock", "", data)
    assert read_columns(path)["/a"].fields["clock.nanosec"] == [6]


def test_known_type_with_a_definition_that_cannot_be_read_is_read(tmp_path: Path) -> None:
    data = pack([("int32", 5), ("uint32", 6)])
    path = write_lone(tmp_path / "a.mcap", "ros2msg", "rosgraph_msgs/msg/Clock", "Time\n", data)
    assert read_columns(path)["/a"].fields["clock.sec"] == [5]


def test_own_definition_goes_before_the_known_one(tmp_path: Path) -> None:
    path = write_lone(
        tmp_path / "a.mcap", "ros2msg", "std_msgs/msg/Bool", "int16 value\n", pack([("int16", -3)])
    )
    assert read_columns(path)["/a"].fields["value"] == [-3]


@pytest.mark.parametrize(
    ("encoding", "reason"),
    [
        ("", "its type other/msg/Kind is not known and the file holds no definition"),
        ("ros2idl", "its type other/msg/Kind is not known and the file holds no definition"),
        ("flatbuffer", "a schema in ros2msg or ros2idl expected, found 'flatbuffer'"),
    ],
)
def test_unknown_type_without_a_definition_is_not_understood(
    encoding: str, reason: str, tmp_path: Path
) -> None:
    path = write_lone(tmp_path / "a.mcap", encoding, "other/msg/Kind", "", b"\0\1\0\0\0")
    assert read_info(path).not_understood == (f"/a: {reason}",)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (wrap("union U switch (long) { case 1: long x; };"), "union is not read"),
        (wrap("struct Robot : Base { long x; };"), "a struct of a struct is not read"),
        (wrap("struct Robot { @optional long x; };"), "@optional is not read"),
        (wrap("@mutable struct Robot { long x; };"), "@mutable is not read"),
        (wrap("struct Robot { map<string, long> x; };"), "map is not read"),
        (wrap("struct Robot { long x[2][2]; };"), "x: arrays of arrays are not read"),
        (wrap("typedef long Row[2]; struct Robot { Row x[2]; };"), "arrays of arrays are not read"),
        (wrap("struct Robot { sequence<sequence<long>> x; };"), "sequences of sequences"),
        (wrap("struct Robot { " + "sequence<" * 5_000), "sequences of sequences"),
        (wrap("struct Robot { wstring x; };"), "wstring: ROS's middlewares do not agree"),
        (wrap("struct Robot { long double x; };"), "expected a type, found 'long double'"),
        (wrap("struct Robot { Other x; };"), "no definition of Other"),
        (wrap("typedef A B; typedef B A; struct Robot { A x; };"), "found one that is itself"),
        (wrap("struct Robot { Robot x; };"), "found one that holds itself"),
        (wrap("struct Robot { long x[SIZE]; };"), "expected a length, found 'SIZE'"),
        (wrap("struct Robot { long x "), "expected ;, found '}'"),
        (wrap("struct Other { long x; };"), "is missing; there is test_msgs::msg::Other"),
        ("module a { " * 9, "expected up to 8 modules in each other"),
        ("struct Robot { long x;", "expected more, found 'the end'"),
        ("hello", "expected module, struct, typedef, enum or const, found 'hello'"),
        ('struct "', "expected a name"),
        ("", "its definition is missing"),
        (f"module {'x' * 1025}", "expected shorter names"),
        (" " * (LONGEST_TEXT + 1), f"expected up to {LONGEST_TEXT} bytes"),
    ],
)
def test_what_is_not_understood_has_its_reason(text: str, reason: str) -> None:
    with pytest.raises(LogError, match=r"^schema test_msgs/(msg/)?Robot: ") as caught:
        read_idl(text)
    assert reason in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.thorough
def test_long_texts_take_no_long_time() -> None:
    """Texts of the greatest length are read, to bound their time."""
    size = LONGEST_TEXT // 4
    texts = [
        wrap("struct Robot { " + "long x; " * 15_000 + "};"),
        wrap("".join(f"struct S{n} {{ long x; }};" for n in range(4_500))),
        "@" * size,
        "/*" * (size // 2),
        '"' + "\\" * (size - 1),
        "1e+" * (size // 3),
        "module m { " * 8 + "typedef long T; struct S { T x;" + "T y;" * 100_000,
    ]
    start = time.process_time()
    for text in texts:
        with pytest.raises(LogError):
            read_idl(text)
    assert time.process_time() - start < 5.0
