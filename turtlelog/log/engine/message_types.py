"""Parsing of `ros2msg` schemas: the fields of a type, and its layout if its size is fixed."""

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from threading import Lock
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.records import HEADING_FIELDS

TEXT: Final = "text"
"""Kind of a text; every other kind is a type code of numpy, or the fields of a nested message."""

MOST_FIELDS: Final = 10_000
"""Largest number of fields of a message. Nested types multiply fields; common types have far
fewer."""

DEEPEST: Final = 64
"""Largest nesting depth of types."""

LONGEST_TEXT: Final = 2**20
"""Largest size of a definition with all its types [bytes]; the longest known is a tenth of this."""

MOST_KEPT_FIELDS: Final = 200
"""Largest number of fields of a cached type, about 1 kB each; ROS messages have fewer."""

LONGEST_KEPT: Final = 2**14
"""Largest length of a cached definition [letters of up to 4 bytes]; a point cloud's has 6,000."""

_MOST_KEPT: Final = 128  # types; the cache stays below 40 MB, whatever the files contain

_KINDS: Final[Mapping[str, str]] = {
    "bool": "?",
    "byte": "u1",
    "char": "u1",
    "float32": "f4",
    "float64": "f8",
    **{f"int{8 * size}": f"i{size}" for size in (1, 2, 4, 8)},
    **{f"uint{8 * size}": f"u{size}" for size in (1, 2, 4, 8)},
    "string": TEXT,
}

_BUILTIN: Final[Mapping[str, str]] = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec\n",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
}
_SHORT: Final = {
    "time": "builtin_interfaces/Time",
    "duration": "builtin_interfaces/Duration",
    "Header": "std_msgs/Header",
}


_SEPARATOR: Final = re.compile(r"^={3,}[ \t\r]*\n", re.MULTILINE)
_HEADING: Final = re.compile(r"\s*MSG:[ \t]*(\S+)[ \t\r]*(?:\n|\Z)")
_LINE: Final = re.compile(
    r"(?P<type>[A-Za-z][\w/]*)(?:<=\d{1,9})?"
    r"(?P<brackets>\[(?P<bound><=)?(?P<length>\d{0,9})\])?"
    r"\s+(?P<name>[A-Za-z]\w*)\s*(?P<constant>=)?",
    re.ASCII,
)

Column = NDArray[Any]

MESSAGE: Final = np.dtype(
    [
        *((f"#{name}", kind) for name, kind in HEADING_FIELDS),
        *(("#encapsulation", "<u2"), ("#options", "<u2")),
    ]
)
"""Bytes before the fields of a CDR message, from the record's opcode on.

The names begin with #; no ROS field has such a name."""

LITTLE_ENDIAN: Final = 0x0100
"""Encapsulation of plain CDR: its first two bytes, read as a little-endian number."""

BIG_ENDIAN: Final = 0x0000

ENCAPSULATION: Final = 4
"""Size of the encapsulation header [bytes]; alignment is counted from its end."""

_LARGEST_RECORD: Final = 2**28  # bytes; a schema may claim arrays of any length


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """One field of a message type.

    Attributes:
        name: Name of the field alone, without the names of enclosing messages.
        kind: A type code of numpy without byte order, `TEXT`, or the fields of a nested message.
        length: Length of a fixed array; None for single values and sequences.
        is_sequence: Whether the field is a sequence of any length.
    """

    name: str
    kind: "str | tuple[Field, ...]"
    length: int | None = None
    is_sequence: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """The bytes of a message type of fixed size.

    Attributes:
        little: Record from the opcode to the last field, little-endian.
        big: The same record with big-endian fields.
        size: Size of the message including the encapsulation header [bytes].
        kinds: The type code of every field, by dotted name in order.
    """

    little: np.dtype[np.void]
    big: np.dtype[np.void]
    size: int
    kinds: dict[str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class MessageType:
    """A type of messages.

    Attributes:
        fields: Fields of the type, nested fields within their messages.
        layout: Layout of the type; None if its messages differ in size.
        size: Total size of the fields, counted in numbers, texts and sequences.
        sequence: Dotted name of a sequence of texts or messages in the type; None without one.
        row_size: Memory of a message as a row [bytes]; long texts and sequences need more.
    """

    fields: tuple[Field, ...]
    layout: Layout | None
    size: int
    sequence: str | None
    row_size: int


ROW_HEAD: Final = 20
"""Memory of two times and a sequence number [bytes]."""

NUMBER_SIZE: Final = 8
TEXT_SIZE: Final = 72
_SEQUENCE_SIZE: Final = 200
"""Memory of a value [bytes]; texts and sequences are objects."""

_KEPT: Final[dict[tuple[str, str], MessageType]] = {}
_KEEPING: Final = Lock()


def read_type(name: str, definition: str) -> MessageType:
    """Return a message type. Common types are parsed only once per process."""
    known = _KEPT.get((name, definition))
    if known is not None:
        return known
    fields, size = _parse_schema(name, definition)
    alike, layout = lay_out_alike(fields, {}), None
    if alike is not None and not alike.constants and alike.size <= _LARGEST_RECORD:
        kinds = {name: kind for name, kind, *_ in alike.numbers}
        little, big = (_join(alike, order) for order in "<>")
        layout = Layout(little=little, big=big, size=ENCAPSULATION + alike.size, kinds=kinds)
    row_size = ROW_HEAD + (_measure(fields) if layout is None else layout.size)
    sequence = _find_sequence(fields)
    found = MessageType(
        fields=fields, layout=layout, size=size, sequence=sequence, row_size=row_size
    )
    if size <= MOST_KEPT_FIELDS and len(definition) <= LONGEST_KEPT:
        with _KEEPING:
            if len(_KEPT) == _MOST_KEPT:  # the oldest type is removed
                del _KEPT[next(iter(_KEPT))]
            _KEPT[name, definition] = found
    return found


def _measure(fields: tuple[Field, ...]) -> int:
    """Return the approximate memory of the values of a message [bytes]."""
    size = 0
    for field in fields:
        if field.is_sequence:
            size += _SEQUENCE_SIZE
        elif isinstance(field.kind, str):
            size += (TEXT_SIZE if field.kind == TEXT else NUMBER_SIZE) * (field.length or 1)
        else:
            size += _measure(field.kind) * (field.length or 1)
    return size


def _parse_schema(name: str, text: str) -> tuple[tuple[Field, ...], int]:
    """Return the fields of the message type `name` with nested types, and their total size."""
    first, *others = _SEPARATOR.split(text.removesuffix("\n") + "\n")
    definitions = dict(_BUILTIN)
    for part in others:
        heading = _HEADING.match(part)
        if heading is None:
            raise LogError(
                f"schema {name}: after =====, expected MSG: and a type, as in MSG: std_msgs/Header"
            )
        definitions[shorten_type(heading[1])] = part[heading.end() :]
    # The first definition may have a heading of its own.
    own = _HEADING.match(first)
    definitions[shorten_type(name)] = first[own.end() :] if own else first
    return _Resolver(definitions).resolve(shorten_type(name), ())


class _Resolver:
    """Resolver of nested types, which reads each type once and counts the size of all fields."""

    def __init__(self, definitions: Mapping[str, str]) -> None:
        self._definitions = definitions
        self._known: dict[str, tuple[tuple[Field, ...], int]] = {}

    def resolve(self, name: str, inside: tuple[str, ...]) -> tuple[tuple[Field, ...], int]:
        if name in self._known:
            return self._known[name]
        if name in inside or len(inside) > DEEPEST:
            raise LogError(f"schema {name}: expected types that end, found one that holds itself")
        if name not in self._definitions:
            raise LogError(f"schema {name}: its definition is missing")
        fields, count = [], 0
        for found in _parse_lines(name, self._definitions[name]):
            length = int(found["length"]) if found["length"] and not found["bound"] else None
            kind, size = self._find_kind(name, found["type"], inside)
            count += max(size, 1) * (1 if isinstance(kind, str) else length or 1)
            is_sequence = found["brackets"] is not None and length is None
            field = Field(name=found["name"], kind=kind, length=length, is_sequence=is_sequence)
            fields.append(field)
            if count > MOST_FIELDS:
                raise LogError(
                    f"schema {name}: expected up to {MOST_FIELDS} fields, found {count} or more"
                )
        if len({field.name for field in fields}) < len(fields):
            raise LogError(f"schema {name}: expected names that differ, found one twice")
        self._known[name] = tuple(fields), count
        return self._known[name]

    def _find_kind(
        self, name: str, kind: str, inside: tuple[str, ...]
    ) -> tuple[str | tuple[Field, ...], int]:
        if kind in _KINDS:
            return _KINDS[kind], 1
        if kind == "wstring":
            raise LogError(f"schema {name}: wstring: ROS's middlewares do not agree on its bytes")
        nested = _SHORT.get(kind) or shorten_type(kind, package=name.split("/")[0])
        return self.resolve(nested, (*inside, name))


def _parse_lines(name: str, text: str) -> Iterator[re.Match[str]]:
    for line in text.splitlines():
        stripped = line.strip()
        if not stripped or stripped.startswith("#"):
            continue
        found = _LINE.match(stripped)
        if found is None:
            raise LogError(f"schema {name}: expected a type and a name, found {stripped[:60]!r}")
        if not found["constant"]:
            yield found


def shorten_type(name: str, package: str = "") -> str:
    """Return `package/Type` without names in between or, as eProsima writes them, in front."""
    *before, last = name.split("/")
    if before and before[-1] in {"msg", "srv", "action"}:
        before.pop()
    return f"{before[-1] if before else package}/{last}"


def widen_number(value: float) -> float:
    """Return a number in double precision; one that is too large is infinite."""
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def name_parts(field: Field) -> Iterator[str]:
    """Yield the parts of dotted names for a nested message: one part, or one per array element."""
    if field.length is None:
        yield field.name
    else:
        yield from (f"{field.name}.{number}" for number in range(field.length))


def fill_columns(columns: Mapping[str, Column], layout: Layout, rows: NDArray[np.void]) -> None:
    """Write records with the fields of `MESSAGE` into columns in the machine's byte order."""
    little = rows.view(layout.little)
    for name, column in columns.items():
        column[...] = little[name]
    is_big = little["#encapsulation"] == BIG_ENDIAN
    if is_big.any():
        big = rows[is_big].view(layout.big)
        for name in layout.kinds.keys() & columns.keys():
            columns[name][is_big] = big[name]


def _find_sequence(fields: tuple[Field, ...]) -> str | None:
    """Return the dotted name of the first sequence of texts or messages."""
    for part in fields:
        is_plain = isinstance(part.kind, str) and part.kind != TEXT
        if not is_plain and (part.is_sequence or (part.length and part.kind == TEXT)):
            return part.name
        if not isinstance(part.kind, str) and (found := _find_sequence(part.kind)) is not None:
            return f"{part.name}.{found}"
    return None


def _join(alike: "AlikeLayout", order: str) -> np.dtype[np.void]:
    codes = ((f"{order}{kind.replace('?', 'u1')}", length) for _, kind, length, _ in alike.numbers)
    formats = [code if length is None else f"({length},){code}" for code, length in codes]
    assert MESSAGE.names is not None
    layout = {
        "names": [*MESSAGE.names, *(name for name, *_ in alike.numbers)],
        "formats": [*(MESSAGE[name] for name in MESSAGE.names), *formats],
        "offsets": [
            *(MESSAGE.fields[name][1] for name in MESSAGE.names if MESSAGE.fields),
            *(MESSAGE.itemsize + place for *_, place in alike.numbers),
        ],
        "itemsize": MESSAGE.itemsize + alike.size,
    }
    return np.dtype(layout)  # type: ignore[call-overload,no-any-return]


class _UnlikeError(Exception):
    """Messages that differ in more than numbers."""


class AlikeLayout:
    """The offsets of fields in messages that differ only in numbers.

    A type with texts or sequences has no fixed layout. If every text is the same in all messages
    and every sequence has the same length, fields nevertheless have fixed offsets. CDR aligns a
    number to its own size; nothing else is aligned.

    Attributes:
        size: Size of a message [bytes].
        numbers: Name, type code, array length and offset [bytes] of each number.
        constants: Bytes that are the same in all messages, with their offsets.
        names: Names of all fields.
    """

    def __init__(self, fields: tuple[Field, ...], columns: Mapping[str, Column]) -> None:
        self.size = 0
        self.numbers: list[tuple[str, str, int | None, int]] = []
        self.constants: list[tuple[bytes, int]] = []
        self.names: list[str] = []
        self._columns = columns
        self._place(fields, "")

    def fill(self, rows: int, columns: Mapping[str, Column]) -> NDArray[np.uint8]:
        """Return messages, shape (rows, size); numbers are little-endian, missing fields 0."""
        found = np.zeros((rows, self.size), dtype=np.uint8)
        for data, place in self.constants:
            found[:, place : place + len(data)] = np.frombuffer(data, dtype=np.uint8)
        for name, *_, place in self.numbers:
            if name in columns:
                part = np.ascontiguousarray(columns[name]).view(np.uint8).reshape(rows, -1)
                found[:, place : place + part.shape[1]] = part
        return found

    def _place(self, fields: tuple[Field, ...], prefix: str) -> None:
        for one in fields:
            name = prefix + one.name
            self.names.append(name)
            if one.is_sequence:
                self._place_items(one, name)
            elif one.kind == TEXT:
                self._place_text(one, self._columns.get(name))
            elif isinstance(one.kind, str):
                self._place_number(name, one.kind, one.length)
            else:
                for part in name_parts(one):
                    self._place(one.kind, f"{prefix}{part}.")
        if not fields:  # ROS gives a type without fields one byte
            self.size += 1

    def _place_number(self, name: str, kind: str, length: int | None) -> None:
        column, shape = self._columns.get(name), () if length is None else (length,)
        # Objects are checked one by one where they are encoded.
        if column is not None and (column.dtype == object or column.shape[1:] != shape):
            raise _UnlikeError
        size = np.dtype(kind).itemsize
        self.size += -self.size % size
        self.numbers.append((name, kind, length, self.size))
        self.size += size * (1 if length is None else length)

    def _place_text(self, one: Field, column: Column | None) -> None:
        text: Any = "" if column is None or not len(column) else column[0]
        is_same = isinstance(text, str) and (
            column is None or all(text == other for other in column)
        )
        if one.length is not None or not is_same:
            raise _UnlikeError
        data = text.encode() + b"\x00"
        self._place_count(len(data))
        self.constants.append((data, self.size))
        self.size += len(data)

    def _place_items(self, one: Field, name: str) -> None:
        keys = [key.removeprefix(f"{name}.") for key in self._columns if key.startswith(f"{name}.")]
        numbers = {key.split(".")[0] for key in keys}
        is_listed = numbers == {str(number) for number in range(len(numbers))}
        if name in self._columns or (isinstance(one.kind, str) and numbers) or not is_listed:
            raise _UnlikeError
        self._place_count(len(numbers))
        for number in range(len(numbers)):
            assert not isinstance(one.kind, str)
            self._place(one.kind, f"{name}.{number}.")

    def _place_count(self, count: int) -> None:
        self.size += -self.size % 4
        self.constants.append((count.to_bytes(4, "little"), self.size))
        self.size += 4


def lay_out_alike(fields: tuple[Field, ...], columns: Mapping[str, Column]) -> AlikeLayout | None:
    """Return the layout of messages; None if the messages differ in more than numbers.

    Columns have dotted field names, with an index for items as in `transforms.0.child_frame_id`.
    """
    try:
        return AlikeLayout(fields, columns)
    except _UnlikeError:
        return None


@dataclass(frozen=True, slots=True)
class PackedItems:
    """Items of a sequence, encoded one after another from a multiple of 8 bytes on."""

    count: int
    data: bytes
