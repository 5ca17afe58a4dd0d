"""The messages of a topic in a block -> rows: one size all at once, others field by field."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from threading import Lock
from types import MappingProxyType
from typing import Any, Final, Literal

import numpy as np
import zstandard
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.blocks import Block, Offsets
from turtlelog.log.engine.channels import TopicPlan
from turtlelog.log.engine.chunks import ZSTD_MAGIC, unpack_chunk
from turtlelog.log.engine.compiled import find_kernels
from turtlelog.log.engine.few_messages import MOST, decode_few
from turtlelog.log.engine.framing import RECORD
from turtlelog.log.engine.json_messages import JsonField, decode_json
from turtlelog.log.engine.limits import UNPACKED, Allowance
from turtlelog.log.engine.message_types import (
    BIG_ENDIAN,
    ENCAPSULATION,
    LITTLE_ENDIAN,
    MESSAGE,
    TEXT,
    Column,
    Field,
    Layout,
    fill_columns,
    name_parts,
)
from turtlelog.log.engine.parsing import COUNTED_HEAD, MESSAGE_HEAD, gather_bytes, gather_heads

Rows = dict[str, Column]
Order = Literal["<", ">"]

LOG_TIME: Final = "#log_time"
PUBLISH_TIME: Final = "#publish_time"
SEQUENCE: Final = "#sequence"

_KINDS: Final = MappingProxyType({LOG_TIME: "i8", PUBLISH_TIME: "i8", SEQUENCE: "u4"})

# numpy asks Linux for large pages for arrays of this size [bytes], which take a tenth of the time
# to fill for the first time. What is smaller of a topic shares an array.
_LARGE: Final = 2**22
_LINE: Final = 64  # bytes; columns start at a multiple

_PADDING: Final = 4  # some middlewares fill a message up to a multiple of this [bytes]

# Before it writes a message, ROS 2 with Fast DDS estimates its size as if an empty sequence were
# padded for the numbers that it lacks, and hands on what is left over. After a sequence's length
# only numbers of this size need padding, and it may carry more with it [bytes].
_LARGEST_NUMBER: Final = 8


def read_rows(plan: TopicPlan, block: Block, starts: Offsets) -> Rows:
    """Return the messages that start at these places as columns: fields, times and sequence.

    Raises:
        LogError: Where a message is not of the topic's type.
    """
    try:
        if plan.json is not None:
            return _read_json(plan.json, block, starts)
        if plan.layout is None:
            return _read_differing(plan, block, starts)
        return _read_fixed(plan.layout, block.data, starts)
    except LogError as err:
        raise LogError(f"{block.unit} {block.byte}: topic {plan.topic}: {err}") from err


def unpack_messages(
    block: Block, starts: Offsets, allowance: Allowance, topic: str
) -> tuple[Block, Offsets]:
    """Return messages unpacked that rosbag2 compressed one by one; others as they are.

    What is compressed tells itself: CDR begins with a zero, zstd does not.

    Raises:
        LogError: Where one is not sound, or they hold far more than the file lets expect.
    """
    if not len(starts) or not block.data.startswith(ZSTD_MAGIC, int(starts[0]) + MESSAGE_HEAD):
        return block, starts
    heads = gather_heads(block.data, starts)
    ends = starts + RECORD.size + heads["length"].astype(np.int64)
    unpacked = bytearray()
    new_starts = np.empty_like(starts)
    spend = partial(allowance.spend, UNPACKED)
    for number, (start, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
        packed = block.data[start + MESSAGE_HEAD : end]
        try:
            # Of data that is no frame its size is not asked: unpacking says what is wrong.
            is_frame = packed.startswith(ZSTD_MAGIC)
            size = max(zstandard.frame_content_size(packed), 0) if is_frame else 0
            largest = allowance.largest_chunk
            data = unpack_chunk("zstd", packed, size, largest=largest, spend=spend)
        except LogError as err:
            place = f"{block.unit} {block.byte}: topic {topic}: message {number}"
            raise LogError(f"{place}: {err}") from err
        heads["length"][number] = COUNTED_HEAD + len(data)
        new_starts[number] = len(unpacked)
        unpacked += heads[number].tobytes()
        unpacked += data
    return replace(block, data=bytes(unpacked), offsets={}, rest=()), new_starts


class FixedColumns:
    """Columns of a topic whose messages have one size."""

    def __init__(self, layout: Layout, count: int, kept: Collection[str] | None = None) -> None:
        """Set columns of so many rows aside: those of these names, None for all."""
        self._layout, self._count, self._used = layout, count, 0
        self._lock = Lock()
        kinds: dict[str, tuple[np.dtype[Any], tuple[int, ...]]] = {}
        for name in (*_KINDS, *layout.kinds):
            if kept is not None and name not in kept:
                continue
            stored = layout.little.fields[name][0]  # type: ignore[index]
            kind = _KINDS.get(name) or layout.kinds[name].replace("?", "u1")
            kinds[name] = np.dtype(kind), (count, *stored.shape)
        self._columns = _allocate(kinds)

    def fill(self, data: bytes, starts: Offsets, first: int) -> bool:
        """Copy messages into the rows from `first` on; return whether there is room for them.

        Several threads may fill rows at once, each its own.

        Raises:
            LogError: Where one is not of the topic's type.
        """
        end = first + len(starts)
        if end > self._count:
            return False
        with self._lock:
            self._used = max(self._used, end)
        if len(starts) and not self._scatter(data, starts, first):
            rows = {name: column[first:end] for name, column in self._columns.items()}
            fill_columns(rows, self._layout, _gather_fixed(self._layout, data, starts))
        return True

    def _scatter(self, data: bytes, starts: Offsets, first: int) -> bool:
        """Return whether the compiled loops are there and met only usual messages."""
        kernels, size = find_kernels(), self._layout.size
        if kernels is None or starts.min() < 0 or starts.max() > len(data) - MESSAGE_HEAD - size:
            return False
        octets = np.frombuffer(data, np.uint8)
        done = kernels.scatter(octets, starts, COUNTED_HEAD + size, *self._tables, first)
        return bool(done == len(starts))

    @property
    def has_rows(self) -> bool:
        """Whether any are filled."""
        return self._used > 0

    @cached_property
    def _tables(self) -> tuple[Offsets, Offsets]:
        """Offset, size and count of the numbers of each column in a message; where columns are."""
        numbers = []
        for name in self._columns:
            stored, offset = self._layout.little.fields[name][:2]  # type: ignore[index]
            together = stored.itemsize // stored.base.itemsize
            numbers.append((offset, stored.base.itemsize, together))
        addresses = [column.ctypes.data for column in self._columns.values()]
        return np.array(numbers, np.int64), np.array(addresses, np.int64)

    def finish(self) -> Rows:
        """Return the rows that are filled."""
        # A byte that is neither 0 nor 1 is no bool of numpy's.
        return {
            name: column[: self._used] != 0
            if self._layout.kinds.get(name) == "?"
            else column[: self._used]
            for name, column in self._columns.items()
        }


def _allocate(kinds: Mapping[str, tuple[np.dtype[Any], tuple[int, ...]]]) -> Rows:
    """Return columns of these types and shapes; small ones stand in one array together."""
    sizes = {name: kind.itemsize * math.prod(shape) for name, (kind, shape) in kinds.items()}
    places, end = {}, 0
    for name, size in sizes.items():
        if size < _LARGE:
            places[name] = end
            end += size + -size % _LINE
    shared = np.empty(end, np.uint8)
    return {
        name: np.ndarray(shape, kind, shared, places[name])
        if name in places
        else np.empty(shape, kind)
        for name, (kind, shape) in kinds.items()
    }


def fill_rows(
    plan: TopicPlan, block: Block, starts: Offsets, columns: FixedColumns, first: int
) -> bool:
    """Copy messages of a topic into its columns, as `FixedColumns.fill` does.

    Raises:
        LogError: As `read_rows`.
    """
    try:
        return columns.fill(block.data, starts, first)
    except LogError as err:
        raise LogError(f"{block.unit} {block.byte}: topic {plan.topic}: {err}") from err


def make_empty_rows(plan: TopicPlan) -> Rows:
    """Return the columns of a topic without messages."""
    block = Block(data=b"", byte=0, offsets={}, rest=())
    return read_rows(plan, block, np.empty(0, np.int64))


def select_rows(
    rows: Mapping[str, Column], chosen: NDArray[np.bool_] | NDArray[np.int64] | slice
) -> Rows:
    """Return some of the rows."""
    return {name: values[chosen] for name, values in rows.items()}


def keep_columns(rows: Rows, kept: Collection[str] | None) -> Rows:
    """Return the columns of some names, None for all."""
    return rows if kept is None else {name: rows[name] for name in rows if name in kept}


def _read_fixed(layout: Layout, data: bytes, starts: Offsets) -> Rows:
    columns = FixedColumns(layout, len(starts))
    columns.fill(data, starts, 0)
    return columns.finish()


def _gather_fixed(layout: Layout, data: bytes, starts: Offsets) -> NDArray[np.void]:
    """Return messages with their heads, one after the other.

    Raises:
        LogError: Where one is not of the topic's type.
    """
    size = layout.little.itemsize
    if starts[-1] > len(data) - size:
        # The last one is too short: found by the check, which needs no more than its head.
        _check_sizes(gather_heads(data, starts)["length"], layout)
    rows = gather_bytes(data, starts, size)
    heads = rows.view(layout.little)
    _check_sizes(heads["#length"], layout)
    _check_heads(heads)
    return rows


def _check_sizes(lengths: NDArray[np.uint64], layout: Layout) -> None:
    extra = lengths - np.uint64(COUNTED_HEAD + layout.size)  # wraps where it is below
    if len(extra) and extra.max() >= _PADDING:
        number = int((extra >= _PADDING).argmax())
        found = int(lengths[number]) - COUNTED_HEAD
        raise LogError(f"message {number}: expected {layout.size} bytes, found {found}")


def _read_differing(plan: TopicPlan, block: Block, starts: Offsets) -> Rows:
    lengths = gather_heads(block.data, starts)["length"].astype(np.int64)
    if (lengths < COUNTED_HEAD + ENCAPSULATION).any():
        number = int((lengths < COUNTED_HEAD + ENCAPSULATION).argmax())
        found = lengths[number] - COUNTED_HEAD
        raise LogError(f"message {number}: expected at least 4 bytes, found {found}")
    heads = gather_bytes(block.data, starts, MESSAGE.itemsize).view(MESSAGE)
    _check_heads(heads)
    firsts, ends = starts + MESSAGE.itemsize, starts + RECORD.size + lengths
    columns: Rows = {
        LOG_TIME: heads[LOG_TIME].astype(np.int64),
        PUBLISH_TIME: heads[PUBLISH_TIME].astype(np.int64),
        SEQUENCE: heads[SEQUENCE].astype(np.uint32),
    }
    is_big = heads["#encapsulation"] == BIG_ENDIAN
    if not is_big.any():
        return columns | _decode_messages(plan.fields, block.data, firsts, ends, "<")
    orders: tuple[tuple[Order, NDArray[np.bool_]], ...] = (("<", ~is_big), (">", is_big))
    for order, rows in orders:
        found = _decode_messages(plan.fields, block.data, firsts[rows], ends[rows], order)
        for name, values in found.items():
            shape = (len(starts), *values.shape[1:])
            columns.setdefault(name, np.empty(shape, values.dtype))[rows] = values
    return columns


def _read_json(fields: Sequence[JsonField], block: Block, starts: Offsets) -> Rows:
    heads = gather_heads(block.data, starts)
    ends = starts + RECORD.size + heads["length"].astype(np.int64)
    _check_times(heads["log_time"], heads["publish_time"])
    messages = [
        block.data[start + MESSAGE_HEAD : end]
        for start, end in zip(starts.tolist(), ends.tolist(), strict=True)
    ]
    return {
        LOG_TIME: heads["log_time"].astype(np.int64),
        PUBLISH_TIME: heads["publish_time"].astype(np.int64),
        SEQUENCE: heads["sequence"].astype(np.uint32),
        **decode_json(fields, messages),
    }


def _check_heads(heads: NDArray[np.void]) -> None:
    """Check that every message is plain CDR, and of a time that 63 bits hold."""
    kinds = heads["#encapsulation"]
    wrong = kinds != LITTLE_ENDIAN
    if wrong.any() and (wrong := wrong & (kinds != BIG_ENDIAN)).any():
        number = int(wrong.argmax())
        found = kinds[number].tobytes().hex()
        raise LogError(f"message {number}: expected the CDR header 0001 or 0000, found {found}")
    _check_times(heads[LOG_TIME], heads[PUBLISH_TIME])


def _check_times(*columns: NDArray[np.uint64]) -> None:
    for times in columns:
        if len(times) and times.max() >= 2**63:
            raise LogError(f"expected times below 2^63 ns, found {times.max()}")


def _decode_messages(
    fields: tuple[Field, ...], data: bytes, starts: Offsets, ends: Offsets, order: Order
) -> dict[str, Column]:
    """Return the fields of messages as columns, by dotted name.

    A sequence of numbers is an array per message; one of texts a list; one of messages a list of
    dictionaries by dotted name.

    Args:
        fields: Of the message type.
        data: The bytes in which the messages stand.
        starts: Of the fields, behind the encapsulation, shape (n,).
        ends: Of the messages, shape (n,).
        order: `<` for little-endian, `>` for big-endian.

    Raises:
        LogError: Where a message is longer or shorter than its type, or a text no UTF-8.
    """
    if order == "<" and len(starts) <= MOST:
        few = decode_few(fields, data, starts, ends, _PADDING)
        if few is not None:
            return few
    cursor = _Cursor(data, starts, ends, order)
    columns: dict[str, Column] = {}
    cursor.take_fields(fields, "", columns)
    is_long = ends - cursor.places >= _PADDING + cursor.overestimates
    if is_long.any():
        number = int(is_long.argmax())
        expected, found = (cursor.places - starts)[number] + 4, (ends - starts)[number] + 4
        raise LogError(f"message {number}: expected {expected} bytes, found {found}")
    return columns


class _Cursor:
    """A place in every message, moved over one field at a time.

    Attributes:
        places: Where the next field starts, or the one before ends, shape (n,).
        overestimates: How many bytes too many a writer may have set aside so far, shape (n,).
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
            # Nothing takes less than a byte: what cannot be there is not asked for.
            self._require(lengths)
        elif field.length is None:
            return self._take_texts() if field.kind == TEXT else self._take_one(field)
        else:
            lengths = np.full(len(self.places), field.length)
            self._require(lengths)
            if field.kind != TEXT:
                return self._finish(self._take_numbers(str(field.kind), field.length), field)
        if isinstance(field.kind, str) and field.kind != TEXT:
            return self._take_arrays(field.kind, lengths)
        return self._take_lists(field.kind, lengths)

    def _take_one(self, field: Field) -> Column:
        return self._finish(self._take_numbers(str(field.kind), 1)[:, 0], field)

    def _finish(self, values: Column, field: Field) -> Column:
        return values != 0 if field.kind == "?" else np.ascontiguousarray(values)

    def _require(self, sizes: Offsets) -> None:
        short = self.places + sizes > self._ends
        if short.any():
            row = int(short.argmax())
            size = self._ends[row] - self._starts[row] + 4
            raise LogError(f"message {self._numbers[row]}: expected more than {size} bytes")

    def _align(self, size: int) -> None:
        self.places += (self._starts - self.places) % size

    def _take_numbers(self, kind: str, count: int) -> Column:
        """Return `count` numbers of every message, shape (n, count)."""
        code = np.dtype(kind.replace("?", "u1"))
        self._align(code.itemsize)
        size = code.itemsize * count
        self._require(np.full(len(self.places), size))
        values = gather_bytes(self._data, self.places, size).view(code.newbyteorder(self._order))
        self.places += size
        return values.reshape(-1, count).astype(code)

    def _take_texts(self) -> Column:
        lengths = self._take_numbers("u4", 1)[:, 0].astype(np.int64)
        self._require(lengths)
        starts, self.places = self.places, self.places + lengths
        texts = np.empty(len(starts), dtype=object)
        data, row = self._data, 0
        try:
            for row, (start, end) in enumerate(
                zip(starts.tolist(), self.places.tolist(), strict=True)
            ):
                # The closing zero is counted; some middlewares leave it out.
                texts[row] = data[start:end].removesuffix(b"\x00").decode()
        except UnicodeDecodeError as err:
            number = self._numbers[row]
            raise LogError(
                f"message {number}: expected UTF-8 text, found {err.object[:20]!r}"
            ) from err
        return texts

    def _take_arrays(self, kind: str, lengths: Offsets) -> Column:
        code = np.dtype(kind.replace("?", "u1"))
        # An empty sequence is not padded.
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
        """Take the k-th value of every message that has one, for k = 0, 1, ..."""
        lists = np.empty(len(lengths), dtype=object)
        lists[:] = [[] for _ in range(len(lengths))]
        for number in range(int(lengths.max(initial=0))):
            rows = np.flatnonzero(lengths > number)
            inner = _Cursor(self._data, self._starts[rows], self._ends[rows], self._order)
            inner.places, inner._numbers = self.places[rows], self._numbers[rows]
            for row, value in zip(rows, inner.take_values(kind), strict=True):
                lists[row].append(value)
            self.places[rows] = inner.places
            self.overestimates[rows] += inner.overestimates
        return lists

    def take_values(self, kind: str | tuple[Field, ...]) -> list[object]:
        """Return one text, or one message as a dictionary, of every message."""
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
