"""Decoding of messages that differ in size: field by field for many messages, one by one for few.

A typical recording has one goal and three events. For so few messages, about a hundred numpy calls
take longer than reading them one by one.
"""

import struct
from collections.abc import Callable, Iterator, Sequence
from types import MappingProxyType
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.blocks import Offsets
from turtlelog.log.engine.message_types import TEXT, Column, Field, name_parts
from turtlelog.log.engine.records import gather_bytes

Order = Literal["<", ">"]

PADDING: Final = 4
"""Some middlewares pad a message to a multiple of this size [bytes]."""

# ROS 2 with Fast DDS estimates the size of a message before it writes it. The estimate pads for the
# numbers of an empty sequence, and the surplus bytes are sent too. After a sequence's length, only
# numbers of this size need padding; the surplus may grow by this size [bytes].
_LARGEST_NUMBER: Final = 8


def decode_messages(
    fields: tuple[Field, ...], data: bytes, starts: Offsets, ends: Offsets, order: Order
) -> dict[str, Column]:
    """Return the fields of messages as columns, by dotted name.

    A sequence of numbers becomes an array per message, a sequence of texts a list, and a sequence
    of messages a list of dictionaries by dotted name. Messages start with their first field, after
    the encapsulation header; starts and ends in `data` have the shape (n,).

    Raises:
        LogError: If a message is longer or shorter than its type, or a text is not UTF-8.
    """
    if order == "<" and len(starts) <= FEW_MESSAGES:
        few = decode_few(fields, data, starts, ends)
        if few is not None:
            return few
    cursor = _Cursor(data, starts, ends, order)
    columns: dict[str, Column] = {}
    cursor.take_fields(fields, "", columns)
    is_long = ends - cursor.places >= PADDING + cursor.overestimates
    if is_long.any():
        number = int(is_long.argmax())
        expected, found = (cursor.places - starts)[number] + 4, (ends - starts)[number] + 4
        raise LogError(f"message {number}: expected {expected} bytes, found {found}")
    return columns


_MOST_STEPS: Final = 50_000
"""Largest number of values of one list that are read value by value from all messages; a list of
arrays takes 2 s."""

_MOST_KNOWN: Final = 256
"""Number of texts of a field that are stored only once. States and frames have few names."""


class _Cursor:
    """A reading position in every message, advanced by one field at a time.

    Attributes:
        places: Offset of the next field, or of the end of the previous one, shape (n,).
        overestimates: Number of surplus bytes that a writer may have allocated so far, shape (n,).
    """

    def __init__(self, data: bytes, starts: Offsets, ends: Offsets, order: Order) -> None:
        self.places, self.overestimates = starts.copy(), np.zeros_like(starts)
        self._data, self._starts, self._ends, self._order = data, starts, ends, order
        self._numbers = np.arange(len(starts))

    def take_fields(
        self, fields: tuple[Field, ...], prefix: str, columns: dict[str, Column]
    ) -> None:
        for field in fields:
            if not isinstance(field.kind, str) and not field.is_sequence:
                for part in name_parts(field):
                    self.take_fields(field.kind, f"{prefix}{part}.", columns)
                continue
            try:
                columns[prefix + field.name] = self._take(field)
            except LogError as err:
                raise LogError(f"{prefix}{field.name}: {err}") from err
        if not fields:  # ROS gives a type without fields one byte
            self._take_numbers("u1", 1)

    def _take(self, field: Field) -> Column:
        if field.is_sequence:
            lengths = self._take_numbers("u4", 1)[:, 0].astype(np.int64)
            # Each value takes at least a byte: values that cannot exist are not read.
            self._require(lengths)
        elif field.length is None:
            if field.kind == TEXT:
                return self._take_texts()
            return self._take_numbers(str(field.kind), 1)[:, 0]
        else:
            lengths = np.full(len(self.places), field.length)
            self._require(lengths)
            if field.kind != TEXT:
                return self._take_numbers(str(field.kind), field.length)
        if isinstance(field.kind, str) and field.kind != TEXT:
            return self._take_arrays(field.kind, lengths)
        return self._take_lists(field.kind, lengths)

    def _require(self, sizes: Offsets) -> None:
        short = self.places + sizes > self._ends
        if short.any():
            row = int(short.argmax())
            size = self._ends[row] - self._starts[row] + 4
            raise LogError(f"message {self._numbers[row]}: expected more than {size} bytes")

    def _take_numbers(self, kind: str, count: int) -> Column:
        """Read `count` numbers from every message, shape (n, count)."""
        code = np.dtype(kind.replace("?", "u1"))
        self.places += (self._starts - self.places) % code.itemsize
        size = code.itemsize * count
        self._require(np.full(len(self.places), size))
        values = gather_bytes(self._data, self.places, size).view(code.newbyteorder(self._order))
        self.places += size
        values = values.reshape(-1, count)
        return values != 0 if kind == "?" else values.astype(code)

    def _take_texts(self) -> Column:
        lengths = self._take_numbers("u4", 1)[:, 0].astype(np.int64)
        self._require(lengths)
        starts, self.places = self.places, self.places + lengths
        texts = np.empty(len(starts), dtype=object)
        data, row = self._data, 0
        known: dict[bytes, str] = {}  # names of frames repeat, and take 50 bytes each
        try:
            for row, (start, end) in enumerate(
                zip(starts.tolist(), self.places.tolist(), strict=True)
            ):
                # The length includes the final zero byte, which some middlewares leave out.
                text = data[start:end].removesuffix(b"\x00")
                found = known.get(text)
                if found is None:
                    found = text.decode()
                    if len(known) < _MOST_KNOWN:
                        known[text] = found
                texts[row] = found
        except UnicodeDecodeError as err:
            number = self._numbers[row]
            raise LogError(
                f"message {number}: expected UTF-8 text, found {err.object[:20]!r}"
            ) from err
        return texts

    def _take_arrays(self, kind: str, lengths: Offsets) -> Column:
        code = np.dtype(kind.replace("?", "u1"))
        # There is no padding after the length of an empty sequence.
        self.places += np.where(lengths > 0, (self._starts - self.places) % code.itemsize, 0)
        if code.itemsize == _LARGEST_NUMBER:
            self.overestimates += np.where(lengths > 0, 0, _LARGEST_NUMBER)
        self._require(lengths * code.itemsize)
        stored, arrays = code.newbyteorder(self._order), np.empty(len(lengths), dtype=object)
        rows = zip(self.places.tolist(), lengths.tolist(), strict=True)
        for row, (start, length) in enumerate(rows):
            values = np.frombuffer(self._data, stored, length, start)
            arrays[row] = values != 0 if kind == "?" else values.astype(code)
        self.places += lengths * code.itemsize
        return arrays

    def _take_lists(self, kind: str | tuple[Field, ...], lengths: Offsets) -> Column:
        """Read the k-th value of every message that has so many values, for k = 0, 1, ...

        If only a few messages have more values, their values are read message by message.
        """
        lists = np.empty(len(lengths), dtype=object)
        lists[:] = [[] for _ in range(len(lengths))]
        is_tried = False
        for number in range(int(lengths.max(initial=0))):
            rows = np.flatnonzero(lengths > number)
            if len(rows) <= FEW_MESSAGES and not is_tried:
                if self._take_rest(kind, lists, rows, lengths[rows] - number):
                    break
                is_tried = True
            if number >= _MOST_STEPS:
                raise LogError(
                    f"message {self._numbers[rows[0]]}: expected up to {_MOST_STEPS:,} values, each"
                    f" of any size, found {lengths[rows[0]]:,}"
                )
            inner = _Cursor(self._data, self._starts[rows], self._ends[rows], self._order)
            inner.places, inner._numbers = self.places[rows], self._numbers[rows]
            for row, value in zip(rows, inner.take_values(kind), strict=True):
                lists[row].append(value)
            self.places[rows] = inner.places
            self.overestimates[rows] += inner.overestimates
        return lists

    def _take_rest(
        self,
        kind: str | tuple[Field, ...],
        lists: NDArray[np.object_],
        rows: Offsets,
        lengths: Offsets,
    ) -> bool:
        """Read all remaining values of some messages; return whether this was possible."""
        if self._order != "<":
            return False
        within = self._starts[rows], self.places[rows], self._ends[rows], lengths
        found = take_few_lists(kind, self._data, *within)
        if found is None:
            return False
        for row, values in zip(rows.tolist(), found[0], strict=True):
            lists[row] += values
        self.places[rows] = found[1]
        return True

    def take_values(self, kind: str | tuple[Field, ...]) -> list[object]:
        """Read one text, or one message as a dictionary, from every message."""
        if isinstance(kind, str):
            return list(self._take_texts())
        columns: dict[str, Column] = {}
        self.take_fields(kind, "", columns)
        names = list(columns)
        if not names:
            return [{} for _ in self._numbers]
        values = [
            [*column] if column.dtype == object or column.ndim > 1 else column.tolist()
            for column in columns.values()
        ]
        return [dict(zip(names, row, strict=True)) for row in zip(*values, strict=True)]


FEW_MESSAGES: Final = 16
"""Largest number of messages decoded one by one. From about 25 on, the other way is faster."""

CODES: Final = MappingProxyType(
    {"?": "?", "f4": "f", "f8": "d"}
    | {"i1": "b", "i2": "h", "i4": "i", "i8": "q"}
    | {"u1": "B", "u2": "H", "u4": "I", "u8": "Q"}
)
"""`struct` codes of numbers by their type codes."""

_Number = tuple[str, int, Callable[[bytes, int], tuple[object, ...]] | None]
"""Name, size [bytes] and reader of a number. For a text: no reader, and the size of its length."""

_LENGTH: Final = 4  # bytes of the length before a text


def decode_few(
    fields: tuple[Field, ...], data: bytes, starts: Offsets, ends: Offsets
) -> dict[str, Column] | None:
    """Return the fields of little-endian messages, by dotted name.

    The result is None if the type has arrays or sequences, or if a message is invalid. Then
    `decode_messages` gives the reason.
    """
    lengths = np.ones_like(starts)
    found = take_few_lists(fields, data, starts, starts, ends, lengths)
    if found is None or ends.max(initial=0) > len(data):
        return None
    if (ends - np.array(found[1], np.int64) >= PADDING).any():
        return None
    rows: list[Any] = [row for (row,) in found[0]]
    columns: dict[str, Column] = {}
    for name, kind, _ in _list_numbers(fields, ""):
        dtype = object if kind == TEXT else np.dtype(kind)
        columns[name] = np.array([row[name] for row in rows], dtype)
    return columns


def take_few_lists(
    kind: str | tuple[Field, ...],
    data: bytes,
    starts: Offsets,
    places: Offsets,
    ends: Offsets,
    lengths: Offsets,
) -> tuple[list[list[object]], list[int]] | None:
    """Return the texts or messages nested in little-endian messages, and their ends.

    The result is None in the same cases as for `decode_few`. Each message has its start, from which
    alignment is counted, the offset and number of its nested values, and its end, shape (n,).
    """
    try:
        parts = [("", TEXT, _LENGTH)] if isinstance(kind, str) else _list_numbers(kind, "")
        numbers = [
            (name, size, None if code == TEXT else struct.Struct(f"<{CODES[code]}").unpack_from)
            for name, code, size in parts
        ]
        rows = zip(*(values.tolist() for values in (starts, places, ends, lengths)), strict=True)
        found = [_take_list(numbers, data, *row) for row in rows]
    except (_OtherKindError, struct.error, UnicodeDecodeError):
        return None
    return [values for values, _ in found], [place for _, place in found]


class _OtherKindError(Exception):
    """A type that contains more than numbers and texts."""


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
            if text not in known:
                if len(known) == _MOST_KNOWN:
                    known.clear()
                known[text] = text.removesuffix(b"\x00").decode()
            value[name] = known[text]
        if place > end:
            raise _OtherKindError
        values.append(value[""] if is_text else value)
    return values, place


def _list_numbers(fields: tuple[Field, ...], prefix: str) -> Iterator[tuple[str, str, int]]:
    """Yield name, kind and size of every number and text; for a text, the size of its length."""
    for field in fields:
        if field.length is not None or field.is_sequence:
            raise _OtherKindError
        if not isinstance(field.kind, str):
            yield from _list_numbers(field.kind, f"{prefix}{field.name}.")
        else:
            size = _LENGTH if field.kind == TEXT else np.dtype(field.kind).itemsize
            yield prefix + field.name, field.kind, size
    if not fields:  # ROS gives a type without fields one byte
        raise _OtherKindError
