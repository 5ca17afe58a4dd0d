"""A few messages of a type that differs in size -> columns: one by one, cheaper than all at once.

A usual recording has one goal and three events: the some hundred calls of numpy that thousands of
messages are worth take longer than to read these.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.log.engine.message_types import TEXT, Column, Field

FEW_MESSAGES: Final = 16
"""Messages up to which this is quicker: both ways take alike at some 25."""

_LENGTH: Final = 4  # bytes before a text that say how long it is


def decode_few(
    fields: tuple[Field, ...],
    data: bytes,
    starts: NDArray[np.int64],
    ends: NDArray[np.int64],
    padding: int,
) -> dict[str, Column] | None:
    """Return the fields of little-endian messages, by dotted name.

    None where a type has arrays or sequences, and where a message is not sound: the general way
    says what is wrong with it.

    Args:
        fields: Of the message type.
        data: The bytes in which the messages stand.
        starts: Of the fields, behind the encapsulation, shape (n,).
        ends: Of the messages, shape (n,).
        padding: Bytes behind the fields from which on a message is too long.
    """
    try:
        numbers = list(_list_numbers(fields, ""))
    except _OtherKindError:
        return None
    values: list[list[bytes]] = [[] for _ in numbers]
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        place = start
        for (_, kind, size), column in zip(numbers, values, strict=True):
            place += (start - place) % size
            first, place = place, place + size
            if kind == TEXT and place <= end:
                first = place
                place += int.from_bytes(data[place - _LENGTH : place], "little")
            if place > end:
                return None
            column.append(data[first:place])
        if end - place >= padding or end > len(data):
            return None
    try:
        return {
            name: _join_texts(column) if kind == TEXT else _join_numbers(column, kind)
            for (name, kind, _), column in zip(numbers, values, strict=True)
        }
    except UnicodeDecodeError:
        return None


class _OtherKindError(Exception):
    """A type with more than numbers and texts."""


def _list_numbers(fields: tuple[Field, ...], prefix: str) -> Iterator[tuple[str, str, int]]:
    """Yield name, kind and size of every number and text; of a text that of its length."""
    for field in fields:
        if field.length is not None or field.is_sequence:
            raise _OtherKindError
        if not isinstance(field.kind, str):
            yield from _list_numbers(field.kind, f"{prefix}{field.name}.")
        else:
            size = _LENGTH if field.kind == TEXT else np.dtype(field.kind).itemsize
            yield prefix + field.name, field.kind, size
    if not fields:  # which ROS gives one byte
        raise _OtherKindError


def _join_texts(column: list[bytes]) -> Column:
    texts = np.empty(len(column), dtype=object)
    texts[:] = [text.removesuffix(b"\x00").decode() for text in column]
    return texts


def _join_numbers(column: list[bytes], kind: str) -> Column:
    code = np.dtype(kind.replace("?", "u1"))
    values = np.frombuffer(b"".join(column), code.newbyteorder("<"))
    return values != 0 if kind == "?" else values.astype(code)
