"""Encoding of messages that differ only in numbers, all at once.

A type with texts or sequences has no fixed layout. If every text is the same in all messages and
every sequence has the same length, fields nevertheless have fixed offsets.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.log.engine.message_types import TEXT, Column, Field, name_parts


@dataclass(frozen=True, slots=True)
class PackedItems:
    """Items of a sequence, encoded one after another.

    The first item starts at a multiple of 8 bytes.
    """

    count: int
    data: bytes


@dataclass(slots=True)
class AlikeLayout:
    """The offsets of fields in messages that differ only in numbers.

    Attributes:
        size: Size of a message [bytes].
        numbers: Name, type code, array length and offset [bytes] of each number.
        constants: Bytes that are the same in all messages, with their offsets.
        names: Names of all fields.
    """

    size: int = 0
    numbers: list[tuple[str, str, int | None, int]] = field(default_factory=list)
    constants: list[tuple[bytes, int]] = field(default_factory=list)
    names: list[str] = field(default_factory=list)

    def fill(self, rows: int, columns: Mapping[str, Column]) -> NDArray[np.uint8]:
        """Return the bytes of messages, shape (rows, size).

        Args:
            rows: Number of messages.
            columns: Numbers by field name, little-endian and of the field's type. Missing fields
                are 0.
        """
        found = np.zeros((rows, self.size), dtype=np.uint8)
        for data, place in self.constants:
            found[:, place : place + len(data)] = np.frombuffer(data, dtype=np.uint8)
        for name, _, _, place in self.numbers:
            if name in columns:
                part = np.ascontiguousarray(columns[name]).view(np.uint8).reshape(rows, -1)
                found[:, place : place + part.shape[1]] = part
        return found


def lay_out_alike(fields: tuple[Field, ...], columns: Mapping[str, Column]) -> AlikeLayout | None:
    """Return the layout of messages; None if the messages differ in more than numbers.

    Args:
        fields: Fields of the type.
        columns: Columns by dotted field name. Items of a sequence of messages have names with an
            index, as in `transforms.0.child_frame_id`.
    """
    layout = AlikeLayout()
    try:
        _place(layout, fields, "", columns)
    except _UnlikeError:
        return None
    return layout


class _UnlikeError(Exception):
    pass


_COUNT: Final = np.dtype("<u4")


def _place(
    layout: AlikeLayout, fields: tuple[Field, ...], prefix: str, columns: Mapping[str, Column]
) -> None:
    for one in fields:
        name = prefix + one.name
        layout.names.append(name)
        if one.is_sequence:
            _place_items(layout, one, name, columns)
        elif one.kind == TEXT:
            if one.length is not None:
                raise _UnlikeError
            _place_text(layout, _find_text(columns.get(name)))
        elif isinstance(one.kind, str):
            _require_numbers(columns.get(name), one.length)
            size = np.dtype(one.kind).itemsize
            layout.size += -layout.size % size
            layout.numbers.append((name, one.kind, one.length, layout.size))
            layout.size += size * (1 if one.length is None else one.length)
        else:
            for part in name_parts(one):
                _place(layout, one.kind, f"{prefix}{part}.", columns)
    if not fields:  # ROS gives a type without fields one byte
        layout.size += 1


def _require_numbers(column: Column | None, length: int | None) -> None:
    # Objects are checked one by one where they are encoded.
    shape = () if length is None else (length,)
    if column is not None and (column.dtype == object or column.shape[1:] != shape):
        raise _UnlikeError


def _place_items(layout: AlikeLayout, one: Field, name: str, columns: Mapping[str, Column]) -> None:
    start = f"{name}."
    numbers = {key.removeprefix(start).split(".")[0] for key in columns if key.startswith(start)}
    if name in columns or (isinstance(one.kind, str) and numbers):
        raise _UnlikeError
    if numbers != {str(number) for number in range(len(numbers))}:
        raise _UnlikeError
    _place_constant(layout, _COUNT.type(len(numbers)).tobytes())
    for number in range(len(numbers)):
        assert not isinstance(one.kind, str)
        _place(layout, one.kind, f"{start}{number}.", columns)


def _find_text(column: Column | None) -> str:
    if column is None or not len(column):
        return ""
    text: Any = column[0]
    if not isinstance(text, str) or any(other != text for other in column):
        raise _UnlikeError
    return text


def _place_text(layout: AlikeLayout, text: str) -> None:
    data = text.encode() + b"\x00"
    _place_constant(layout, _COUNT.type(len(data)).tobytes())
    layout.constants.append((data, layout.size))
    layout.size += len(data)


def _place_constant(layout: AlikeLayout, data: bytes) -> None:
    layout.size += -layout.size % len(data)
    layout.constants.append((data, layout.size))
    layout.size += len(data)
