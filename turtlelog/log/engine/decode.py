"""Decoding of a topic's messages in a block: all at once if their size is fixed, else by fields."""

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from threading import Lock
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import zstandard
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.blocks import Block, Offsets
from turtlelog.log.engine.cdr import PADDING, Order, decode_messages
from turtlelog.log.engine.channels import Catalogue, Decode, TopicPlan, measure_object
from turtlelog.log.engine.limits import COLUMNS, UNPACKED, ZSTD_MAGIC, Allowance, unpack_chunk
from turtlelog.log.engine.message_types import (
    BIG_ENDIAN,
    ENCAPSULATION,
    LITTLE_ENDIAN,
    MESSAGE,
    Column,
    Layout,
    fill_columns,
)
from turtlelog.log.engine.object_messages import JsonField, decode_objects
from turtlelog.log.engine.records import (
    COUNTED_HEAD,
    MESSAGE_HEAD,
    RECORD,
    gather_bytes,
    gather_heads,
)
from turtlelog.log.file_access import name_place

Rows = dict[str, Column]

LOG_TIME: Final = "#log_time"
PUBLISH_TIME: Final = "#publish_time"
SEQUENCE: Final = "#sequence"

_KINDS: Final = {LOG_TIME: "i8", PUBLISH_TIME: "i8", SEQUENCE: "u4"}

# For arrays of this size [bytes] numpy asks Linux for large pages, which take a tenth of the time
# to fill at first. Smaller columns of a topic share an array.
_LARGE: Final = 2**22
_LINE: Final = 64  # bytes; columns start at a multiple of it


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """A segment of consecutive messages.

    Attributes:
        rows: Rows of requested topics.
        size: Number of bytes read.
        counts: Number of messages by channel, requested or not.
        rest: Other records of the block; only in the first piece of a block.
    """

    rows: Mapping[str, Rows]
    size: int
    counts: Mapping[int, int]
    rest: tuple[Any, ...] = ()


_MOST_REASONS: Final = 3
"""Largest number of topics that an error lists with their reasons."""

EVER: Final = 2**64
"""A log time after all others [ns]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """The requested messages.

    Attributes:
        topics: Names of the topics to read. None: every topic that can be decoded.
        start_ns: Earliest log time [ns], inclusive.
        end_ns: End of the log time [ns], exclusive.
        is_lenient: Whether topics may be missing or undecodable; all chunks are then checked.
        is_flat: Whether only numbers and texts are allowed as fields; lists take much memory.
        is_counted: Whether the memory of rows is limited in proportion to the file's size.
        kept: Columns to keep, by topic, including the log time. Default of a topic: all.
    """

    topics: frozenset[str] | None = None
    start_ns: int = 0
    end_ns: int = EVER
    is_lenient: bool = False
    is_flat: bool = False
    is_counted: bool = False
    kept: Mapping[str, Collection[str]] = field(default_factory=dict)

    @property
    def is_ever(self) -> bool:
        """Whether no message is left out because of its time."""
        return self.start_ns <= 0 and self.end_ns >= EVER

    def choose_plans(self, catalogue: Catalogue) -> dict[str, TopicPlan]:
        """Return the plans of the requested topics that are known so far."""
        known = catalogue.topics
        names = sorted(known if self.topics is None else self.topics.intersection(known))
        plans = ((topic, self.choose_plan(catalogue, topic)) for topic in names)
        return {topic: plan for topic, plan in plans if plan is not None}

    def choose_plan(self, catalogue: Catalogue, topic: str) -> TopicPlan | None:
        """Return the plan of a topic; None if it is not requested."""
        if self.topics is not None and topic not in self.topics:
            return None
        plan = catalogue.find_plan(topic)
        if plan.reason and self.topics is not None and not self.is_lenient:
            raise LogError(plan.describe_reason())
        if self.is_flat and plan.sequence is not None:
            raise LogError(
                f"topic {topic}: expected fields of numbers and texts, found the sequence"
                f" {plan.sequence}"
            )
        if self.is_flat and plan.json is not None:
            flat = tuple(field for field in plan.json if field.kind != "any")
            plan = replace(plan, json=flat, row_size=measure_object(flat))
        return None if plan.reason else plan

    def require_topics(self, catalogue: Catalogue) -> None:
        """Check that every topic requested by name exists, or that any topic can be decoded."""
        if self.topics is None and not self.is_lenient:
            plans = [catalogue.find_plan(topic) for topic in sorted(catalogue.topics)]
            if plans and all(plan.reason for plan in plans):
                raise LogError("; ".join(plan.describe_reason() for plan in plans[:_MOST_REASONS]))
        missing = (self.topics or frozenset()).difference(catalogue.topics)
        for topic in () if self.is_lenient else sorted(missing):
            raise LogError(f"topic {topic}: expected it in the file, found no such topic")


def decode_rows(plan: TopicPlan, block: Block, starts: Offsets) -> Rows:
    """Return the messages at these offsets as columns: fields, times and sequence number."""
    if plan.json is not None:
        return _read_objects(plan.json, plan.decode, block, starts)
    if plan.layout is None:
        return _read_differing(plan, block, starts)
    columns = FixedColumns(plan.layout, len(starts))
    columns.fill(block.data, starts, 0)
    return columns.finish()


def _unpack_messages(block: Block, starts: Offsets, allowance: Allowance) -> tuple[Block, Offsets]:
    """Decompress messages that rosbag2 compressed one by one (plain CDR begins with 0)."""
    if not len(starts) or not block.data.startswith(ZSTD_MAGIC, int(starts[0]) + MESSAGE_HEAD):
        return block, starts
    largest, spend = allowance.largest_chunk, partial(allowance.spend, UNPACKED)

    def unpack(packed: bytes) -> bytes:
        # The size is requested only from zstd frames; for other data, unpacking gives the error.
        is_frame = packed.startswith(ZSTD_MAGIC)
        size = max(zstandard.frame_content_size(packed), 0) if is_frame else 0
        return unpack_chunk("zstd", packed, size, largest=largest, spend=spend)

    return _rewrite_messages(block, starts, unpack)


def _convert_ros1(plan: TopicPlan, block: Block, starts: Offsets) -> tuple[Block, Offsets]:
    """Return ROS 1 messages as CDR, others unchanged."""
    if not plan.is_ros1:
        return block, starts
    from turtlelog.log.ros1 import build_converter  # only files of ROS 1 need it

    return _rewrite_messages(block, starts, build_converter(plan.fields))


def _rewrite_messages(
    block: Block, starts: Offsets, change: Callable[[bytes], bytes]
) -> tuple[Block, Offsets]:
    """Return messages with changed data after their headers."""
    heads, messages = _cut_messages(block, starts)
    data, places = bytearray(), np.empty_like(starts)
    for number, message in enumerate(messages):
        try:
            changed = change(message)
        except LogError as err:
            raise LogError(f"message {number}: {err}") from err
        heads["length"][number] = COUNTED_HEAD + len(changed)
        places[number] = len(data)
        data += heads[number].tobytes()
        data += changed
    return replace(block, data=bytes(data), offsets={}, rest=()), places


def _cut_messages(block: Block, starts: Offsets) -> tuple[NDArray[np.void], Iterator[bytes]]:
    """Return the `HEADING` fields of messages, and the data of each."""
    heads = gather_heads(block.data, starts)
    ends = starts + RECORD.size + heads["length"].astype(np.int64)
    spans = zip((starts + MESSAGE_HEAD).tolist(), ends.tolist(), strict=True)
    return heads, (block.data[start:end] for start, end in spans)


class FixedColumns:
    """Columns of a topic whose messages have one size."""

    def __init__(self, layout: Layout, count: int, kept: Collection[str] | None = None) -> None:
        """Allocate `count` rows for the columns named in `kept`; None: all columns."""
        self._layout, self._count, self._used = layout, count, 0
        self._lock, self._columns = Lock(), Rows()
        codes = {**_KINDS, **{name: code.replace("?", "u1") for name, code in layout.kinds.items()}}
        kinds = {name: np.dtype(codes[name]) for name in codes if kept is None or name in kept}
        shapes = {name: (count, *layout.little[name].shape) for name in kinds}
        sizes = {name: kind.itemsize * math.prod(shapes[name]) for name, kind in kinds.items()}
        # Small columns share one array.
        shared_size = sum(size + _LINE for size in sizes.values() if size < _LARGE)
        shared, end = np.empty(shared_size, "u1"), 0
        for name, kind in kinds.items():
            if sizes[name] < _LARGE:
                self._columns[name] = np.ndarray(shapes[name], kind, shared, end)
                end += sizes[name] + -sizes[name] % _LINE
            else:
                self._columns[name] = np.empty(shapes[name], kind)

    def fill(self, data: bytes, starts: Offsets, first: int) -> bool:
        """Copy messages into the rows from `first` on; return whether there was room."""
        end = first + len(starts)
        if end > self._count:
            return False
        with self._lock:
            self._used = max(self._used, end)
        if len(starts):
            size = self._layout.little.itemsize
            if starts[-1] > len(data) - size:
                # The last message is too short; the check needs only the header and reports it.
                _check_sizes(gather_heads(data, starts)["length"], self._layout)
            records = gather_bytes(data, starts, size)
            heads = records.view(self._layout.little)
            _check_sizes(heads["#length"], self._layout)
            _check_heads(heads)
            rows = {name: column[first:end] for name, column in self._columns.items()}
            fill_columns(rows, self._layout, records)
        return True

    @property
    def has_rows(self) -> bool:
        """Whether any rows are filled."""
        return self._used > 0

    def finish(self) -> Rows:
        """Return the filled rows."""
        # A byte other than 0 and 1 is not a valid bool in numpy.
        return {
            name: column[: self._used] != 0
            if self._layout.kinds.get(name) == "?"
            else column[: self._used]
            for name, column in self._columns.items()
        }


def make_empty_rows(plan: TopicPlan) -> Rows:
    """Return the columns of a topic without messages."""
    block = Block(data=b"", byte=0, offsets={}, rest=())
    return decode_rows(plan, block, np.empty(0, np.int64))


def pick_rows(
    rows: Mapping[str, Column], chosen: NDArray[np.bool_] | NDArray[np.int64] | slice
) -> Rows:
    """Return some of the rows."""
    return {name: values[chosen] for name, values in rows.items()}


def _check_sizes(lengths: NDArray[np.uint64], layout: Layout) -> None:
    extra = lengths - np.uint64(COUNTED_HEAD + layout.size)  # wraps if below 0
    if len(extra) and extra.max() >= PADDING:
        number = int((extra >= PADDING).argmax())
        found = int(lengths[number]) - COUNTED_HEAD
        raise LogError(f"message {number}: expected {layout.size} bytes, found {found}")


def _read_differing(plan: TopicPlan, block: Block, starts: Offsets) -> Rows:
    lengths = gather_heads(block.data, starts)["length"].astype(np.int64)
    is_short = lengths < COUNTED_HEAD + ENCAPSULATION
    if is_short.any():
        number = int(is_short.argmax())
        found = lengths[number] - COUNTED_HEAD
        raise LogError(f"message {number}: expected at least 4 bytes, found {found}")
    heads = gather_bytes(block.data, starts, MESSAGE.itemsize).view(MESSAGE)
    _check_heads(heads)
    firsts, ends = starts + MESSAGE.itemsize, starts + RECORD.size + lengths
    columns = {name: heads[name].astype(kind) for name, kind in _KINDS.items()}
    is_big = heads["#encapsulation"] == BIG_ENDIAN
    if not is_big.any():
        return columns | decode_messages(plan.fields, block.data, firsts, ends, "<")
    orders: tuple[tuple[Order, NDArray[np.bool_]], ...] = (("<", ~is_big), (">", is_big))
    for order, rows in orders:
        found = decode_messages(plan.fields, block.data, firsts[rows], ends[rows], order)
        for name, values in found.items():
            shape = (len(starts), *values.shape[1:])
            columns.setdefault(name, np.empty(shape, values.dtype))[rows] = values
    return columns


def _read_objects(
    fields: Sequence[JsonField], decode: Decode | None, block: Block, starts: Offsets
) -> Rows:
    heads, messages = _cut_messages(block, starts)
    _check_times(heads["log_time"], heads["publish_time"])
    stamps = {name: heads[name.removeprefix("#")].astype(kind) for name, kind in _KINDS.items()}
    return stamps | decode_objects(fields, messages, decode)


def _check_heads(heads: NDArray[np.void]) -> None:
    """Check that every message is plain CDR, and that its times fit into 63 bits."""
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


def read_piece(
    catalogue: Catalogue,
    selection: Selection,
    block: Block,
    offsets: Mapping[int, Offsets],
    wholes: Mapping[str, FixedColumns] = MappingProxyType({}),
) -> Piece:
    """Return the requested messages among those at some offsets of a block."""
    found = {}
    for topic, channels in catalogue.group_channels(offsets, block.byte).items():
        parts = [offsets[channel] for channel in channels]
        starts = parts[0] if len(parts) == 1 else np.sort(np.concatenate(parts))
        plan = selection.choose_plan(catalogue, topic)
        if plan is None or not len(starts):
            continue
        whole = None if block.before is None else wholes.get(topic)
        rows = _read_topic(plan, block, starts, selection, catalogue.allowance, whole)
        if rows and len(rows[LOG_TIME]):
            found[topic] = rows
    counts = {channel: len(starts) for channel, starts in offsets.items()}
    share = sum(counts.values()) / max(sum(map(len, block.offsets.values())), 1)
    return Piece(rows=found, size=int(len(block.data) * share), counts=counts)


def _read_topic(
    plan: TopicPlan,
    block: Block,
    starts: Offsets,
    selection: Selection,
    allowance: Allowance,
    whole: FixedColumns | None,
) -> Rows:
    """Return the requested messages of a topic; empty if they went into the columns `whole`."""
    place = f"{block.unit} {block.byte}: topic {plan.topic}"
    with name_place(place):
        messages = _unpack_messages(block, starts, allowance)
        unpacked, starts = _convert_ros1(plan, *messages)
    if selection.is_counted:
        allowance.spend(COLUMNS, _measure_rows(plan, unpacked.data, starts))
    with name_place(place):
        first = 0 if block.before is None else block.before.get(plan.topic, 0)
        if whole is not None and whole.fill(unpacked.data, starts, first):
            return {}
        rows = decode_rows(plan, unpacked, starts)
    kept = selection.kept.get(plan.topic)
    if kept is not None:
        rows = {name: rows[name] for name in rows if name in kept}
    if selection.is_ever:
        return rows
    times = rows[LOG_TIME]
    return pick_rows(rows, (times >= selection.start_ns) & (times < selection.end_ns))


_LISTS: Final = 2
"""Memory factor for lists: nested messages take ten times their bytes, columns five times."""


def _measure_rows(plan: TopicPlan, data: bytes, starts: Offsets) -> int:
    size = len(starts) * plan.row_size
    if plan.layout is None:
        share = 1 if plan.sequence is None else _LISTS
        size += share * int(gather_heads(data, starts)["length"].sum())
    return size
