"""One message -> CDR bytes, field by field: the inverse of the reader's `decode_messages`."""

from collections.abc import Mapping
from struct import Struct
from types import MappingProxyType
from typing import Any, Final

from turtlelog.log.engine.message_types import TEXT, Field, name_parts

CODES: Final = MappingProxyType(
    {"?": "?", "f4": "f", "f8": "d"}
    | {"i1": "b", "i2": "h", "i4": "i", "i8": "q"}
    | {"u1": "B", "u2": "H", "u4": "I", "u8": "Q"}
)
"""How `struct` names the numbers that a field may hold, little-endian."""

_PACKERS: Final = MappingProxyType({kind: Struct(f"<{code}") for kind, code in CODES.items()})


def encode_fields(fields: tuple[Field, ...], values: Mapping[str, Any]) -> bytes:
    """Return the bytes of one message behind its encapsulation.

    Args:
        fields: Of the message type.
        values: By dotted name, as a row of `TopicColumns`; one left out is 0 or empty.

    Raises:
        struct.error, TypeError, ValueError: Where a value is not of its field's kind.
    """
    body = bytearray()
    _append_fields(body, fields, values, "")
    return bytes(body)


def _append_fields(
    body: bytearray, fields: tuple[Field, ...], values: Mapping[str, Any], prefix: str
) -> None:
    for field in fields:
        if not isinstance(field.kind, str) and not field.is_sequence:
            for part in name_parts(field):
                _append_fields(body, field.kind, values, f"{prefix}{part}.")
            continue
        value = values.get(prefix + field.name)
        if field.is_sequence or field.length is not None:
            _append_items(body, field, value)
        else:
            _append_item(body, field.kind, value)
    if not fields:  # ROS gives a type without fields one byte
        body.append(0)


def _append_items(body: bytearray, field: Field, items: Any) -> None:
    if items is None:
        items = [None] * (field.length or 0)
    if field.is_sequence:
        _append_item(body, "u4", len(items))
    elif len(items) != field.length:
        raise ValueError(f"{field.name}: {len(items)} values instead of {field.length}")
    for item in items:
        _append_item(body, field.kind, item)


def _append_item(body: bytearray, kind: str | tuple[Field, ...], value: Any) -> None:
    if not isinstance(kind, str):
        _append_fields(body, kind, value, "")
    elif kind == TEXT:
        text = ("" if value is None else value).encode() + b"\x00"
        _append_item(body, "u4", len(text))
        body += text
    else:
        packer = _PACKERS[kind]
        body += bytes(-len(body) % packer.size)
        body += packer.pack(0 if value is None else value)
