"""Decoding of protobuf messages into objects like those of JSON, with the file's descriptors.

An MCAP file defines a protobuf type by a FileDescriptorSet, which is a protobuf message itself
(protobuf.dev/programming-guides/encoding, descriptor.proto). The necessary parts of both messages
are read here, within limits and without a library. A stamp has the names of Foxglove's JSON: `sec`
and `nsec`.
"""

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Final

from turtlelog.errors import LogError
from turtlelog.log.engine.json_messages import LONGEST_MESSAGE, JsonField, JsonKind
from turtlelog.log.engine.message_types import DEEPEST, LONGEST_TEXT, MOST_FIELDS
from turtlelog.log.file_access import name_place

_VARINT, _EIGHT, _BYTES, _FOUR = 0, 1, 2, 5
"""Wire types; groups are refused, because proto3 does not have them."""

_LONGEST_VARINT: Final = 10

_MESSAGE: Final = 11
_REPEATED: Final = 3

_NUMBERS: Final[Mapping[int, tuple[int, str]]] = MappingProxyType(
    {
        1: (_EIGHT, "<d"),
        2: (_FOUR, "<f"),
        6: (_EIGHT, "<Q"),
        7: (_FOUR, "<I"),
        15: (_FOUR, "<i"),
        16: (_EIGHT, "<q"),
    }
)
"""Wire type and `struct` code of types with a fixed size, by their number in descriptor.proto."""

_KINDS: Final[Mapping[int, JsonKind]] = MappingProxyType(
    {
        1: "number",
        2: "number",
        **dict.fromkeys((3, 4, 5, 6, 7, 13, 14, 15, 16, 17, 18), "integer"),
        8: "boolean",
        9: "string",
    }
)
"""Kind of a field by the number of its type. Bytes and groups have no kind."""

_ZEROS: Final[Mapping[JsonKind, Any]] = MappingProxyType(
    {"number": 0.0, "integer": 0, "boolean": False, "string": ""}
)
"""Values of fields that were not written: numbers 0, texts empty; missing messages stay absent."""

_STAMPS: Final = frozenset({".google.protobuf.Timestamp", ".google.protobuf.Duration"})
_STAMP_NAMES: Final = MappingProxyType({"seconds": "sec", "nanos": "nsec"})


@dataclass(frozen=True, slots=True, kw_only=True)
class ProtobufField:
    """One field of a type.

    Attributes:
        name: Name in the file's definition. Fields of a stamp are named as in JSON.
        kind: Number of the field's type in descriptor.proto.
        of: Type of a nested message; None for other kinds.
        is_repeated: Whether the field may have several values.
    """

    name: str
    kind: int
    of: "ProtobufType | None" = None
    is_repeated: bool = False


@dataclass(slots=True, kw_only=True)
class ProtobufType:
    """A message type. Fields whose type may contain itself are left out.

    Attributes:
        fields: Fields by number.
        zeros: Values of an empty message.
    """

    fields: dict[int, ProtobufField] = field(default_factory=dict)
    zeros: dict[str, Any] = field(default_factory=dict)

    def decode(self, row: int, data: bytes) -> dict[str, Any]:
        """Return a message as an object."""
        if len(data) > LONGEST_MESSAGE:
            found = f"expected up to {LONGEST_MESSAGE} bytes, found {len(data)}"
            raise LogError(f"message {row}: {found}")
        try:
            return self._decode(data)
        except LogError as err:
            raise LogError(f"message {row}: {err}") from err

    def _decode(self, data: bytes) -> dict[str, Any]:
        found = dict(self.zeros)
        for number, wire, value in _iterate_fields(data):
            known = self.fields.get(number)
            if known is None:
                continue
            if known.of is not None:
                _require_wire(known.name, wire, _BYTES)
                part: Any = known.of._decode(value)
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
    if len(data) > LONGEST_TEXT:
        raise LogError(f"schema {name}: expected up to {LONGEST_TEXT} bytes, found {len(data)}")
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
            one = ProtobufField(
                name=_STAMP_NAMES.get(own, own) if name in _STAMPS else own,
                kind=kind,
                of=inner,
                is_repeated=is_repeated,
            )
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
    if kind in _NUMBERS:
        expected, code = _NUMBERS[kind]
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
