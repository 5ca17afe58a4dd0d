"""Messages as objects: JSON by the JSON schema in the file, and protobuf in the same form.

A FileDescriptorSet defines a protobuf type and is a protobuf message itself. Both
(protobuf.dev/programming-guides/encoding, descriptor.proto) are read without a library. A stamp has
the names of Foxglove's JSON: `sec` and `nsec`.
"""

import json
import math
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal, NamedTuple

import msgspec
import numpy as np

from turtlelog.errors import LogError
from turtlelog.log.engine.limits import LONGEST_MESSAGE, MOST_PARTS
from turtlelog.log.engine.message_types import DEEPEST, MOST_FIELDS, Column, widen_number
from turtlelog.log.file_access import name_place

JsonKind = Literal["number", "integer", "boolean", "string", "any"]


_EXPECTED: Final[Mapping[JsonKind, str]] = {
    "number": "a number", "integer": "a whole number", "boolean": "true or false",
    "string": "a text",
}  # fmt: skip
"""Kinds of values in words."""
_NAMED_NUMBERS: Final = {name: float(name) for name in ("NaN", "Infinity", "-Infinity")}
"""Texts that represent numbers missing in JSON, in protobuf's JSON."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JsonField:
    """One value in each message.

    Attributes:
        path: Names of the enclosing objects, then the name of the value.
        kind: Kind in the schema; `any` for arrays, free objects and several allowed kinds.
    """

    path: tuple[str, ...]
    kind: JsonKind

    @property
    def name(self) -> str:
        """The path as a dotted name."""
        return ".".join(self.path)


def read_json_schema(name: str, data: bytes) -> tuple[JsonField, ...]:
    """Return the fields of messages that a schema in `jsonschema` describes."""
    try:
        schema = json.loads(data)
    except (ValueError, RecursionError) as err:
        raise LogError(f"schema {name}: expected JSON, found: {err}") from err
    fields: dict[str, JsonField] = {}
    for field in _Schema(name, schema).list_fields(schema, ()):
        if not field.path or field.name.startswith("#"):
            found = repr(field.name[:40]) if field.path else "no field"
            raise LogError(f"schema {name}: expected an object with named fields, found {found}")
        if field.name in fields:
            raise LogError(f"schema {name}: expected names that differ, found {field.name} twice")
        fields[field.name] = field
        if len(fields) > MOST_FIELDS:
            raise LogError(f"schema {name}: expected up to {MOST_FIELDS} fields, found more")
    return tuple(fields.values())


def decode_objects(
    fields: Sequence[JsonField],
    messages: Iterable[bytes],
    decode: Callable[[bytes], dict[str, Any]] | None = None,
) -> dict[str, Column]:
    """Return the fields of messages as columns, by dotted name.

    Without `decode`, a function from the bytes of a message to an object, messages are JSON.
    Missing numbers are NaN, missing texts empty, other missing values None. Columns of integers or
    truth values with missing values become float columns.
    """
    columns: list[list[Any]] = [[] for _ in fields]
    kind, decode = ("JSON", _decode_json) if decode is None else ("protobuf", decode)
    for row, data in enumerate(messages):  # one at a time: objects are larger than their text
        if (size := len(data)) > LONGEST_MESSAGE:
            most = f"{LONGEST_MESSAGE} bytes of {kind}"
            raise LogError(f"message {row}: expected up to {most}, found {size}")
        try:
            found = decode(data)
            for field, column in zip(fields, columns, strict=True):
                value = _take(field, found)
                column.append(None if value is None else _convert(field, value))
        except LogError as err:
            raise LogError(f"message {row}: {err}") from err
    pairs = zip(fields, columns, strict=True)
    return {field.name: _build_column(field.kind, column) for field, column in pairs}


class _Schema:
    """A schema with a limited number of look-ups."""

    def __init__(self, name: str, root: Any) -> None:
        self._name, self._root, self._left = name, root, MOST_PARTS

    def list_fields(self, schema: Any, path: tuple[str, ...]) -> Iterator[JsonField]:
        """Yield the fields of messages, including those of nested objects."""
        schema = self._resolve(schema)
        properties = schema.get("properties")
        if not isinstance(properties, dict):
            yield JsonField(path=path, kind=_find_kind(schema))
            return
        if len(path) > DEEPEST:
            raise LogError(
                f"schema {self._name}: expected types that end, found one that holds itself"
            )
        for key, inner in properties.items():
            yield from self.list_fields(inner, (*path, key))

    def _resolve(self, schema: Any) -> dict[str, Any]:
        """Resolve a schema: the target of a reference, or the only kind apart from null."""
        for _ in range(DEEPEST):
            if not isinstance(schema, dict):
                return {}
            listed = schema.get("anyOf") or schema.get("oneOf")
            listed = listed if isinstance(listed, list) else []
            self._spend(1 + len(listed))
            choices = [choice for choice in listed if choice != {"type": "null"}]
            if "$ref" in schema:
                schema = self._follow(str(schema["$ref"]))
            elif len(choices) == 1:
                schema = choices[0]
            else:
                return schema
        raise LogError(f"schema {self._name}: expected references that end, found one to itself")

    def _spend(self, count: int) -> None:
        self._left -= count
        if self._left < 0:
            raise LogError(
                f"schema {self._name}: its objects refer to each other more than {MOST_PARTS:,}"
                " times; write a schema with fewer objects"
            )

    def _follow(self, reference: str) -> Any:
        parts = reference.removeprefix("#").split("/")[1:]
        self._spend(len(parts))
        found = self._root
        for part in parts:
            found = found.get(part) if isinstance(found, dict) else None
        if found is None or not reference.startswith("#"):
            raise LogError(f"schema {self._name}: no definition at {reference[:60]!r}")
        return found


def _find_kind(schema: Mapping[str, Any]) -> JsonKind:
    named = schema.get("type")
    kinds = [kind for kind in (named if isinstance(named, list) else [named]) if kind != "null"]
    if set(kinds) == {"integer", "number"}:
        kinds = ["number"]
    return next((kind for kind in _EXPECTED if kinds == [kind]), "any")


def _decode_json(data: bytes) -> dict[str, Any]:
    try:
        try:
            found = msgspec.json.decode(data)
        except msgspec.DecodeError:
            # Python writes NaN and Infinity, which JSON does not have.
            found = json.loads(data)
    except (ValueError, RecursionError) as err:
        raise LogError(f"expected JSON, found {data[:40]!r}: {err}") from err
    if not isinstance(found, dict):
        raise LogError(f"expected a JSON object, found {data[:40]!r}")
    return found


def _take(field: JsonField, found: Any) -> Any:
    """Return a field's value; None if it, or an object on its path, is absent or null."""
    for depth, key in enumerate(field.path):
        if found is None:
            return None
        if not isinstance(found, dict):
            place = ".".join(field.path[:depth])
            raise LogError(f"{place}: expected an object, found {repr(found)[:40]}")
        found = found.get(key)
    return found


def _convert(field: JsonField, value: Any) -> Any:
    """Convert a value, which must have the kind of the field, for its column."""
    kind, is_number = field.kind, isinstance(value, int | float) and not isinstance(value, bool)
    if kind == "any":
        return value
    if kind == "number":
        if is_number:
            return widen_number(value)
        if isinstance(value, str) and value in _NAMED_NUMBERS:
            return _NAMED_NUMBERS[value]
    elif kind == "integer":
        if is_number and value == value // 1 and abs(value) < math.inf:
            return int(value)
    elif isinstance(value, bool if kind == "boolean" else str):
        return value
    found = repr(value)[:40]
    raise LogError(f"{field.name}: expected {_EXPECTED[kind]}, found {found}")


def _build_column(kind: JsonKind, values: list[Any]) -> Column:
    if kind in {"any", "string"}:
        column = np.empty(len(values), dtype=object)
        for row, value in enumerate(values):
            column[row] = "" if value is None and kind == "string" else value
        return column
    has_gaps = any(value is None for value in values)
    if kind == "number" or has_gaps:
        return np.array(
            [math.nan if v is None else widen_number(v) for v in values], dtype=np.float64
        )
    try:
        return np.array(values, dtype=np.bool_ if kind == "boolean" else np.int64)
    except OverflowError:
        return np.array([widen_number(value) for value in values], dtype=np.float64)


_VARINT, _EIGHT, _BYTES, _FOUR = 0, 1, 2, 5
"""Wire types; groups are refused, because proto3 does not have them."""

_LONGEST_VARINT: Final = 10

_MESSAGE: Final = 11
_REPEATED: Final = 3

_FIXED: Final[Mapping[int, tuple[int, str]]] = {
    1: (_EIGHT, "<d"),
    6: (_EIGHT, "<Q"),
    16: (_EIGHT, "<q"),
} | {2: (_FOUR, "<f"), 7: (_FOUR, "<I"), 15: (_FOUR, "<i")}
"""Wire type and `struct` code of types with a fixed size, by their number in descriptor.proto."""

_KINDS: Final[Mapping[int, JsonKind]] = {
    1: "number", 2: "number", 8: "boolean", 9: "string",
    **dict.fromkeys((3, 4, 5, 6, 7, 13, 14, 15, 16, 17, 18), "integer"),
}  # fmt: skip
"""Kind of a field by the number of its type. Bytes and groups have no kind."""

_ZEROS: Final[Mapping[JsonKind, Any]] = {
    "number": 0.0,
    "integer": 0,
    "boolean": False,
    "string": "",
}
"""Values of fields that were not written: numbers 0, texts empty; missing messages stay absent."""

_STAMPS: Final = frozenset({".google.protobuf.Timestamp", ".google.protobuf.Duration"})
_STAMP_NAMES: Final = {"seconds": "sec", "nanos": "nsec"}


class ProtobufField(NamedTuple):
    """One field of a type: name as in JSON, type in descriptor.proto, type of a nested message."""

    name: str
    kind: int
    of: "ProtobufType | None" = None
    is_repeated: bool = False


class ProtobufType:
    """A message type. Fields whose type may contain itself are left out.

    Attributes:
        fields: Fields by number.
        zeros: Values of an empty message.
    """

    def __init__(self) -> None:
        self.fields: dict[int, ProtobufField] = {}
        self.zeros: dict[str, Any] = {}

    def decode(self, data: bytes) -> dict[str, Any]:
        """Return a message as an object."""
        found = dict(self.zeros)
        for number, wire, value in _iterate_fields(data):
            known = self.fields.get(number)
            if known is None:
                continue
            if known.of is not None:
                _require_wire(known.name, wire, _BYTES)
                part: Any = known.of.decode(value)
            elif known.is_repeated or known.kind not in _KINDS:
                continue  # a run needs no lists and no bytes
            else:
                part = _read_scalar(known, wire, value)
            if known.is_repeated:
                found.setdefault(known.name, []).append(part)
            elif isinstance(part, dict) and isinstance(found.get(known.name), dict):
                found[known.name] = {**found[known.name], **part}  # two parts are one message
            else:
                found[known.name] = part
        return found

    def list_fields(self, path: tuple[str, ...] = ()) -> Iterator[JsonField]:
        """Yield the fields of messages, including those of nested messages."""
        for one in self.fields.values():
            inner = (*path, one.name)
            if one.is_repeated or (one.of is None and one.kind not in _KINDS):
                yield JsonField(path=inner, kind="any")
            elif one.of is None:
                yield JsonField(path=inner, kind=_KINDS[one.kind])
            else:
                yield from one.of.list_fields(inner)


def read_protobuf_type(name: str, data: bytes) -> ProtobufType:
    """Return a type from the FileDescriptorSet that defines the type."""
    described: dict[str, list[Mapping[int, list[Any]]]] = {}
    with name_place(f"schema {name}"):
        for file in _collect(data).get(1, []):
            parts = _collect(file)
            package = _read_text(parts, 2)
            for message in parts.get(4, []):
                _describe(described, f".{package}" if package else "", message, 0)
        found = _Builder(described).build(f".{name}", ())
    if f".{name}" not in described:
        known = ", ".join(one[1:] for one in sorted(described))[:160] or "none"
        raise LogError(f"schema {name}: expected its definition, found {known}")
    return found


def _describe(
    described: dict[str, list[Mapping[int, list[Any]]]], prefix: str, message: Any, depth: int
) -> None:
    """Collect the fields of a message type and of the types that it defines."""
    if depth > DEEPEST:
        raise LogError("expected types within types that end, found more")
    parts = _collect(message)
    name = f"{prefix}.{_read_text(parts, 1)}"
    described[name] = [_collect(found) for found in parts.get(2, [])]
    for inner in parts.get(3, []):
        _describe(described, name, inner, depth + 1)


class _Builder:
    """Builder of types that counts their fields, because nested types multiply fields."""

    def __init__(self, described: Mapping[str, Sequence[Mapping[int, list[Any]]]]) -> None:
        self._described, self._left = described, MOST_FIELDS

    def build(self, name: str, inside: tuple[str, ...]) -> ProtobufType:
        found = ProtobufType()
        for parts in self._described.get(name, ()):
            self._left -= 1
            if self._left < 0:
                raise LogError(f"expected up to {MOST_FIELDS} fields, found more")
            number, kind = _read_number(parts, 3), _read_number(parts, 5)
            own, of = _read_text(parts, 1), _read_text(parts, 6)
            is_repeated = _read_number(parts, 4) == _REPEATED
            # Lists of messages are not decoded: a run has none.
            is_inner = kind == _MESSAGE and not is_repeated
            if is_inner and (of in inside or of == name or len(inside) > DEEPEST):
                continue
            inner = self.build(of, (*inside, name)) if is_inner else None
            own = _STAMP_NAMES.get(own, own) if name in _STAMPS else own
            one = ProtobufField(own, kind, inner, is_repeated)
            found.fields[number] = one
            if one.is_repeated:
                continue
            if one.of is not None and of in _STAMPS:  # the year 1970 is not written
                found.zeros[one.name] = dict(one.of.zeros)
            elif one.of is None and one.kind in _KINDS:
                found.zeros[one.name] = _ZEROS[_KINDS[one.kind]]
        return found


def _collect(data: Any) -> dict[int, list[Any]]:
    """Return the values of a message's fields by their numbers."""
    if not isinstance(data, bytes):
        raise LogError("expected descriptors, found a number in the place of one")
    found: dict[int, list[Any]] = {}
    for number, _, value in _iterate_fields(data):
        found.setdefault(number, []).append(value)
    return found


def _read_text(parts: Mapping[int, list[Any]], number: int) -> str:
    value = parts.get(number, [b""])[-1]
    return value.decode(errors="replace") if isinstance(value, bytes) else ""


def _read_number(parts: Mapping[int, list[Any]], number: int) -> int:
    value = parts.get(number, [0])[-1]
    return value if isinstance(value, int) else 0


def _iterate_fields(data: bytes) -> Iterator[tuple[int, int, Any]]:
    """Yield number, wire type and value of each field of a message. Values are numbers or bytes."""
    place, end = 0, len(data)
    while place < end:
        key, place = _read_varint(data, place)
        number, wire = key >> 3, key & 7
        if wire == _VARINT:
            value, place = _read_varint(data, place)
            yield number, wire, value
            continue
        if wire == _BYTES:
            size, place = _read_varint(data, place)
        elif wire in {_EIGHT, _FOUR}:
            size = 8 if wire == _EIGHT else 4
        else:
            raise LogError(f"byte {place}: expected a wire type of proto3, found {wire}")
        if place + size > end:
            raise LogError(f"byte {place}: expected {size} bytes more, found {end - place}")
        yield number, wire, data[place : place + size]
        place += size


def _read_varint(data: bytes, place: int) -> tuple[int, int]:
    value = 0
    for count in range(_LONGEST_VARINT):
        if place + count >= len(data):
            raise LogError(f"byte {place}: expected a number, found the end")
        byte = data[place + count]
        value |= (byte & 0x7F) << (7 * count)
        if byte < 0x80:
            return value & 0xFFFF_FFFF_FFFF_FFFF, place + count + 1
    raise LogError(f"byte {place}: expected a number of up to {_LONGEST_VARINT} bytes")


def _require_wire(name: str, found: int, expected: int) -> None:
    if found != expected:
        raise LogError(f"{name}: expected the wire type {expected}, found {found}")


def _read_scalar(known: ProtobufField, wire: int, value: Any) -> Any:
    kind = known.kind
    if kind in _FIXED:
        expected, code = _FIXED[kind]
        _require_wire(known.name, wire, expected)
        return struct.unpack(code, value)[0]
    if kind == 9:
        _require_wire(known.name, wire, _BYTES)
        return value.decode(errors="replace")
    _require_wire(known.name, wire, _VARINT)
    if kind == 8:
        return bool(value)
    if kind in {17, 18}:  # zigzag: numbers slightly below 0 are short
        return (value >> 1) ^ -(value & 1)
    if kind in {3, 5, 14} and value >= 2**63:
        return value - 2**64
    return value
