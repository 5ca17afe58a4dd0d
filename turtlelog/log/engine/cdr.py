"""CDR messages that differ in size: decoded by fields or, if few, one by one, and encoded."""

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final, Literal

import numpy as np
from mcap.opcode import Opcode
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.blocks import Offsets, fit_numbers
from turtlelog.log.engine.message_types import (
    LITTLE_ENDIAN,
    MESSAGE,
    TEXT,
    AlikeLayout,
    Column,
    Field,
    Layout,
    PackedItems,
    name_parts,
)
from turtlelog.log.engine.records import FRONT, RECORD, gather_bytes

Order = Literal["<", ">"]

PADDING: Final = 4
"""Some middlewares pad a message to a multiple of this size [bytes]."""

# Fast DDS estimates the size of a message before it writes it, pads for the numbers of an empty
# sequence, and sends the surplus. Only numbers of this size [bytes] need padding there.
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
    is_few = order == "<" and len(starts) <= FEW_MESSAGES
    if is_few and (few := decode_few(fields, data, starts, ends)) is not None:
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
"""Largest number of values of one list that are read value by value; a list of arrays takes 2 s."""

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
        """Read the k-th value of every message with so many values, of few messages all values."""
        lists = np.empty(len(lengths), dtype=object)
        lists[:] = [[] for _ in range(len(lengths))]
        is_tried = False
        for number in range(int(lengths.max(initial=0))):
            rows = np.flatnonzero(lengths > number)
            if len(rows) <= FEW_MESSAGES and self._order == "<" and not is_tried:
                is_tried = True
                within = self._starts[rows], self.places[rows], self._ends[rows]
                found = take_few_lists(kind, self._data, *within, lengths[rows] - number)
                if found is not None:
                    for row, values in zip(rows.tolist(), found[0], strict=True):
                        lists[row] += values
                    self.places[rows] = found[1]
                    break
            if number >= _MOST_STEPS:
                raise LogError(
                    f"message {self._numbers[rows[0]]}: expected up to {_MOST_STEPS:,} values, each"
                    f" of any size, found {lengths[rows[0]]:,}"
                )
            inner = _Cursor(self._data, self._starts[rows], self._ends[rows], self._order)
            inner.places, inner._numbers = self.places[rows], self._numbers[rows]
            for row, value in zip(rows.tolist(), inner.take_values(kind), strict=True):
                lists[row].append(value)
            self.places[rows] = inner.places
            self.overestimates[rows] += inner.overestimates
        return lists

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

CODES: Final = (
    {"?": "?", "f4": "f", "f8": "d"}
    | {"i1": "b", "i2": "h", "i4": "i", "i8": "q"}
    | {"u1": "B", "u2": "H", "u4": "I", "u8": "Q"}
)
"""`struct` codes of numbers by their type codes."""

_PACKERS: Final = {kind: struct.Struct(f"<{code}") for kind, code in CODES.items()}

_Number = tuple[str, int, Callable[[bytes, int], tuple[object, ...]] | None]
"""Name, size [bytes] and reader of a number. For a text: no reader, and the size of its length."""

_LENGTH: Final = 4  # bytes of the length before a text


def decode_few(
    fields: tuple[Field, ...], data: bytes, starts: Offsets, ends: Offsets
) -> dict[str, Column] | None:
    """Return the fields of little-endian messages; None if `decode_messages` is needed."""
    lengths = np.ones_like(starts)
    found = take_few_lists(fields, data, starts, starts, ends, lengths)
    if found is None or ends.max(initial=0) > len(data):
        return None
    if (ends - np.array(found[1], np.int64) >= PADDING).any():
        return None
    rows: list[Any] = [row for (row,) in found[0]]
    return {
        name: np.array([row[name] for row in rows], object if kind == TEXT else kind)
        for name, kind, _ in _list_numbers(fields, "")
    }


def take_few_lists(
    kind: str | tuple[Field, ...],
    data: bytes,
    starts: Offsets,
    places: Offsets,
    ends: Offsets,
    lengths: Offsets,
) -> tuple[list[list[object]], list[int]] | None:
    """Return the texts or messages nested in little-endian messages, and their ends, or None.

    Each message has its start, from which alignment is counted, the offset and number of its nested
    values, and its end, shape (n,).
    """
    try:
        parts = [("", TEXT, _LENGTH)] if isinstance(kind, str) else _list_numbers(kind, "")
        numbers = [
            (name, size, None if code == TEXT else _PACKERS[code].unpack_from)
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


ENCAPSULATION: Final = b"\x00\x01\x00\x00"
"""Encapsulation of plain CDR, little-endian."""


def encode_fixed(
    layout: Layout, columns: Mapping[str, Column], stamps: Mapping[str, Column], channel: int
) -> tuple[NDArray[np.uint8], Offsets]:
    """Return the records of messages of one size, and the size of each record [bytes]."""
    rows = len(stamps["log_time"])
    records = np.zeros(rows, dtype=layout.little)
    _fill_front(records, records.itemsize, stamps, channel)
    for name, values in columns.items():
        column = layout.little[name]
        if values.shape[1:] != column.shape:
            shape = (rows, *column.shape)
            raise LogError(f"{name}: expected shape {shape}, found {values.shape}")
        records[name] = fit_numbers(name, values, column.base.str)
    return records.view(np.uint8), np.full(rows, records.itemsize)


def encode_alike(
    layout: AlikeLayout, columns: Mapping[str, Column], stamps: Mapping[str, Column], channel: int
) -> tuple[NDArray[np.uint8], Offsets]:
    """Return the records of messages that differ only in numbers, and their sizes [bytes]."""
    rows = len(stamps["log_time"])
    numbers = {
        name: fit_numbers(name, columns[name], f"<{kind.replace('?', 'u1')}")
        for name, kind, *_ in layout.numbers
        if name in columns
    }
    fronts = np.zeros(rows, dtype=MESSAGE)
    _fill_front(fronts, MESSAGE.itemsize + layout.size, stamps, channel)
    parts = fronts.view(np.uint8).reshape(rows, -1), layout.fill(rows, numbers)
    found = np.concatenate(parts, axis=1)
    return found.reshape(-1), np.full(rows, found.shape[1], dtype=np.int64)


def _fill_front(
    records: NDArray[np.void], size: int, stamps: Mapping[str, Column], channel: int
) -> None:
    records["#opcode"], records["#length"] = Opcode.MESSAGE, size - RECORD.size
    records["#channel"], records["#encapsulation"] = channel, LITTLE_ENDIAN
    for name, values in stamps.items():
        records[f"#{name}"] = values


def encode_varied(
    fields: tuple[Field, ...],
    columns: Mapping[str, Column],
    stamps: Mapping[str, Column],
    channel: int,
) -> tuple[NDArray[np.uint8], Offsets]:
    """Return the records of messages one by one, because messages with texts are rarely many."""
    data, sizes = bytearray(), []
    times = zip(*(values.tolist() for values in stamps.values()), strict=True)
    for row, (log_time, publish_time, sequence) in enumerate(times):
        values = {name: column[row] for name, column in columns.items()}
        try:
            record = encode_message(fields, values, channel, (sequence, log_time, publish_time))
        except UnicodeEncodeError:
            raise
        except (struct.error, TypeError, ValueError, AttributeError) as err:
            raise LogError(f"row {row}: expected values of the type's kinds, found: {err}") from err
        data += record
        sizes.append(len(record))
    return np.frombuffer(data, np.uint8), np.array(sizes, dtype=np.int64)


def encode_message(
    fields: tuple[Field, ...], values: Mapping[str, Any], channel: int, stamp: tuple[int, int, int]
) -> bytes:
    """Return the record of one message; `stamp` is its sequence, log and publish time [ns].

    Values have dotted names, like a row of `TopicColumns`. Missing values are 0 or empty.
    """
    body = bytearray()
    _append_fields(body, fields, values, "")
    length = FRONT.size - RECORD.size + len(body)
    return FRONT.pack(Opcode.MESSAGE, length, channel, *stamp, ENCAPSULATION) + body


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
    if isinstance(items, PackedItems):
        _append_item(body, "u4", items.count)
        body += bytes(-len(body) % 8) + items.data
        return
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
