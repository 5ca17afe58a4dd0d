"""The messages of a topic, block by block -> rows -> its columns."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from turtlelog.errors import LogError
from turtlelog.log.engine.blocks import Block, Offsets
from turtlelog.log.engine.channels import TopicPlan
from turtlelog.log.engine.decode import Order, decode_messages
from turtlelog.log.engine.message_types import (
    BIG_ENDIAN,
    ENCAPSULATION,
    LITTLE_ENDIAN,
    MESSAGE,
    Column,
    Layout,
    split_rows,
)
from turtlelog.log.engine.parsing import HEADING, MESSAGE_HEAD, gather_bytes

Rows = dict[str, Column]

LOG_TIME: Final = "#log_time"
PUBLISH_TIME: Final = "#publish_time"
SEQUENCE: Final = "#sequence"

_PADDING: Final = 4  # some middlewares fill a message up to a multiple of this [bytes]
_LENGTH: Final = 22  # bytes of a message record that its length counts, before its data


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TopicColumns:
    """The messages of one topic, as columns in order of log time; equal times as in the file.

    Attributes:
        topic: Its name.
        type: Of its messages, as its schema calls it.
        log_time_ns: When each was recorded [ns], shape (n,).
        publish_time_ns: When each was published [ns], shape (n,).
        sequence: Number that the publisher gave each, shape (n,).
        fields: By dotted name in the order of the schema. A fixed array of k numbers has shape
            (n, k); a text is a `str`, a sequence of numbers an array, a sequence of texts a list,
            one of messages a list of dictionaries by dotted name, each in a column of objects.
    """

    topic: str
    type: str
    log_time_ns: NDArray[np.int64]
    publish_time_ns: NDArray[np.int64]
    sequence: NDArray[np.uint32]
    fields: Mapping[str, Column]

    def __len__(self) -> int:
        return len(self.log_time_ns)


def read_rows(plan: TopicPlan, block: Block, starts: Offsets) -> Rows:
    """Return the messages that start at these places as columns: fields, times and sequence.

    Raises:
        LogError: Where a message is not of the topic's type.
    """
    try:
        if plan.layout is None:
            return _read_differing(plan, block, starts)
        return _read_fixed(plan.layout, block, starts)
    except LogError as err:
        raise LogError(f"byte {block.byte}: topic {plan.topic}: {err}") from err


def make_empty_rows(plan: TopicPlan) -> Rows:
    """Return the columns of a topic without messages."""
    block = Block(data=b"", byte=0, offsets={}, rest=())
    return read_rows(plan, block, np.empty(0, np.int64))


def select_rows(
    rows: Mapping[str, Column], chosen: NDArray[np.bool_] | NDArray[np.int64] | slice
) -> Rows:
    """Return some of the rows."""
    return {name: values[chosen] for name, values in rows.items()}


class RowStore:
    """Rows of one topic, part by part; where their number is known, each is copied only once."""

    def __init__(self, expected: int) -> None:
        self._expected, self._used = expected, 0
        self._whole: Rows = {}
        self._others: list[Rows] = []

    def take(self, part: Rows) -> None:
        """Add rows behind those that are there."""
        end = self._used + len(part[LOG_TIME])
        if self._others or end > self._expected:
            self._others.append(part)
            return
        if not self._whole:
            self._whole = {
                name: np.empty((self._expected, *values.shape[1:]), values.dtype)
                for name, values in part.items()
            }
        for name, values in part.items():
            self._whole[name][self._used : end] = values
        self._used = end

    @property
    def parts(self) -> list[Rows]:
        """All rows, in one part where their number was right."""
        whole = [select_rows(self._whole, slice(self._used))] if self._used else []
        return [*whole, *self._others]


def join_rows(parts: list[Rows]) -> Rows:
    """Return the rows of all parts in order of log time; those of one time keep their order."""
    if len(parts) == 1:
        rows = parts[0]
    else:
        rows = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    times = rows[LOG_TIME]
    if len(times) > 1 and (times[1:] < times[:-1]).any():
        rows = select_rows(rows, np.argsort(times, kind="stable"))
    return rows


def build_columns(
    parts: Mapping[str, list[Rows]], types: Mapping[str, str]
) -> Mapping[str, TopicColumns]:
    """Return rows of topics as columns, in order of the topics' names; `types` says theirs."""
    topics = {}
    for topic in sorted(parts):
        rows = join_rows(parts[topic])
        topics[topic] = TopicColumns(
            topic=topic,
            type=types[topic],
            log_time_ns=rows.pop(LOG_TIME),
            publish_time_ns=rows.pop(PUBLISH_TIME),
            sequence=rows.pop(SEQUENCE),
            fields=MappingProxyType(rows),
        )
    return MappingProxyType(topics)


def _read_fixed(layout: Layout, block: Block, starts: Offsets) -> Rows:
    size = layout.little.itemsize
    if len(starts) and starts[-1] > len(block.data) - size:
        # The last one is too short: found by the check, which needs no more than its head.
        _check_sizes(_read_lengths(block, starts), layout)
    rows = gather_bytes(block.data, starts, size)
    heads = rows.view(layout.little)
    _check_sizes(heads["#length"], layout)
    _check_heads(heads)
    return split_rows(layout, rows)


def _read_lengths(block: Block, starts: Offsets) -> NDArray[np.uint64]:
    lengths: NDArray[np.uint64] = gather_bytes(block.data, starts, MESSAGE_HEAD).view(HEADING)[
        "length"
    ]
    return lengths


def _check_sizes(lengths: NDArray[np.uint64], layout: Layout) -> None:
    extra = lengths - np.uint64(_LENGTH + layout.size)  # wraps where it is below
    if len(extra) and extra.max() >= _PADDING:
        number = int((extra >= _PADDING).argmax())
        found = int(lengths[number]) - _LENGTH
        raise LogError(f"message {number}: expected {layout.size} bytes, found {found}")


def _read_differing(plan: TopicPlan, block: Block, starts: Offsets) -> Rows:
    lengths = _read_lengths(block, starts).astype(np.int64)
    if (lengths < _LENGTH + ENCAPSULATION).any():
        number = int((lengths < _LENGTH + ENCAPSULATION).argmax())
        found = lengths[number] - _LENGTH
        raise LogError(f"message {number}: expected at least 4 bytes, found {found}")
    heads = gather_bytes(block.data, starts, MESSAGE.itemsize).view(MESSAGE)
    _check_heads(heads)
    firsts, ends = starts + MESSAGE.itemsize, starts + 9 + lengths
    columns: Rows = {
        LOG_TIME: heads[LOG_TIME].astype(np.int64),
        PUBLISH_TIME: heads[PUBLISH_TIME].astype(np.int64),
        SEQUENCE: heads[SEQUENCE].astype(np.uint32),
    }
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


def _check_heads(heads: NDArray[np.void]) -> None:
    """Check that every message is plain CDR, and of a time that 63 bits hold."""
    kinds = heads["#encapsulation"]
    wrong = kinds != LITTLE_ENDIAN
    if wrong.any() and (wrong := wrong & (kinds != BIG_ENDIAN)).any():
        number = int(wrong.argmax())
        found = kinds[number].tobytes().hex()
        raise LogError(f"message {number}: expected the CDR header 0001 or 0000, found {found}")
    for name in (LOG_TIME, PUBLISH_TIME):
        if len(heads) and heads[name].max() >= 2**63:
            raise LogError(f"expected times below 2^63 ns, found {heads[name].max()}")
