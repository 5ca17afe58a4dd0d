"""A few messages of a type that differs in size -> columns: one by one, cheaper than all at once.

A usual recording has one goal and three events: the some hundred calls of numpy that thousands of
messages are worth take longer than to read these.
"""

import struct
from collections.abc import Callable, Iterator, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.log.engine.message_types import TEXT, Column, Field

FEW_MESSAGES: Final = 16
"""Messages up to which this is quicker: both ways take alike at some 25."""

_MOST_KNOWN: Final = 256
"""Texts within a message that stand in memory once."""

_CODES: Final = dict(
    zip(
        ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8", "?"),
        "BbHhIiQqfd?",
        strict=True,
    )
)
"""Kinds of numbers as `struct` names them."""

_Number = tuple[str, int, Callable[[bytes, int], tuple[object, ...]] | None]
"""Name, size and how to read it; None of a text, whose size is that of its length."""

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


def take_few_lists(
    kind: str | tuple[Field, ...],
    data: bytes,
    starts: NDArray[np.int64],
    places: NDArray[np.int64],
    ends: NDArray[np.int64],
    lengths: NDArray[np.int64],
) -> tuple[list[list[object]], list[int]] | None:
    """Return the texts, or messages by dotted name, within little-endian messages; and their ends.

    None as of `decode_few`.

    Args:
        kind: Text, or the fields of the messages within.
        data: The bytes in which the messages stand.
        starts: Of the messages, which their padding counts from, shape (n,).
        places: Of the first message within each, shape (n,).
        ends: Of the messages, shape (n,).
        lengths: How many are within each, shape (n,).
    """
    try:
        parts = [("", TEXT, _LENGTH)] if isinstance(kind, str) else _list_numbers(kind, "")
        numbers = [
            (name, size, None if code == TEXT else _read_number(code)) for name, code, size in parts
        ]
        rows = zip(*(values.tolist() for values in (starts, places, ends, lengths)), strict=True)
        found = [_take_list(numbers, data, *row) for row in rows]
    except (_OtherKindError, struct.error, UnicodeDecodeError):
        return None
    return [values for values, _ in found], [place for _, place in found]


class _OtherKindError(Exception):
    """A type with more than numbers and texts."""


def _read_number(kind: str) -> Callable[[bytes, int], tuple[object, ...]]:
    return struct.Struct("<" + _CODES[kind]).unpack_from


def _take_list(
    numbers: Sequence[_Number], data: bytes, start: int, place: int, end: int, length: int
) -> tuple[list[object], int]:
    known: dict[bytes, str] = {}  # names of frames repeat
    values: list[object] = []
    is_text = numbers[0][0] == ""
    for _ in range(length):
        value: dict[str, object] = {}
        for name, size, read in numbers:
            place += (start - place) % size
            first, place = place, place + size
            if read is not None:
                value[name] = read(data, first)[0]
                continue
            first = place
            place += int.from_bytes(data[place - _LENGTH : place], "little")
            text = data[first:place]
            value[name] = known.get(text) or _keep_text(known, text)
        if place > end:
            raise _OtherKindError
        values.append(value[""] if is_text else value)
    return values, place


def _keep_text(known: dict[bytes, str], text: bytes) -> str:
    found = text.removesuffix(b"\x00").decode()
    if len(known) < _MOST_KNOWN:
        known[text] = found
    return found


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
